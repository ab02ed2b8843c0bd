"""No deadlines, and a headless browser for the pages and views that people open in theirs."""

import shutil
from collections.abc import Callable, Iterator
from typing import Any

import hypothesis
import pytest

# no test asserts a time: a busy machine must not fail one
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    # WebGL without a graphics card
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


@pytest.fixture
def browser() -> Iterator[Callable[..., Any]]:
    """Return a function that opens a browser of a size in CSS pixels; all are closed at the end.

    ``browser(390, 844, scale=2)`` is a phone; ``flags`` are further ones of Chromium.
    What the page says on its console is at ``driver.get_log("browser")``.
    """
    selenium = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("needs chromium and chromedriver (Debian: chromium, chromium-driver)")
    opened = []

    def open_one(
        width: int = 1280, height: int = 720, scale: float = 1.0, flags: tuple[str, ...] = ()
    ) -> Any:
        options = selenium.ChromeOptions()
        options.binary_location = chromium
        for flag in (*FLAGS, *flags, f"--window-size={width},{height}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        service = selenium.ChromeService(executable_path=driver)
        one = selenium.Chrome(options=options, service=service)
        opened.append(one)
        # a window cannot be as narrow as a phone, nor its inside as large as it is
        size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 500}
        one.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        return one

    yield open_one
    for one in opened:
        one.quit()
