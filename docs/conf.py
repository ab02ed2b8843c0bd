"""Settings of the documentation: sphinx-build -W -b html docs docs/_build."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
os.environ.setdefault("USV_TWIN_QUIET", "1")

warnings.filterwarnings("ignore", message="Unknown section")  # see keep_own_sections

from docutils import nodes  # noqa: E402
from docutils.utils.math.latex2mathml import tex2mathml  # noqa: E402

import usv_kernel  # noqa: E402

project = "usv-twin"
author = "usv-twin contributors"
copyright = "2026, usv-twin contributors, MIT licence"
version = release = usv_kernel.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
]
exclude_patterns = ["_build"]
source_suffix = {".md": "markdown"}
nitpicky = False

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc sections state types, shapes and units
autodoc_mock_imports = ["stable_baselines3"]
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

smartquotes = False  # they would turn --options into dashes
html_theme = "furo"
html_title = f"usv-twin {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_theme_options = {
    "navigation_with_keys": True,
    "source_repository": "https://github.com/usv-twin/usv-twin/",
    "source_branch": "main",
    "source_directory": "docs/",
}
autosummary_generate = False
suppress_warnings = ["config.cache"]

# Sections that numpydoc reads itself; it drops all others.
SECTIONS = {
    "Attributes",
    "Examples",
    "Keyword Arguments",
    "Methods",
    "Notes",
    "Other Parameters",
    "Parameters",
    "Raises",
    "Receives",
    "References",
    "Returns",
    "See Also",
    "Warnings",
    "Warns",
    "Yields",
}


def keep_own_sections(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Turn underlined titles that numpydoc does not know into rubrics, so that it keeps them."""
    for i in range(len(lines) - 1):
        title, line = lines[i].strip(), lines[i + 1].strip()
        if title and title not in SECTIONS and line and set(line) <= {"-"} | {"="}:
            if " " in line or len(line) < len(title):
                continue  # the edge of a table
            lines[i], lines[i + 1] = f".. rubric:: {title}", ""


def write_command_line(app: Any) -> None:
    """Write the page of the command line from the commands themselves."""
    import typer
    from typer.cli import get_docs_for_click

    from twin.cli.main import app as commands

    command = typer.main.get_command(commands)
    context = typer.Context(command, info_name="usv-twin")
    text = get_docs_for_click(obj=command, ctx=context, name="usv-twin", title="Command line")
    head = "% Written by docs/conf.py from the commands' own help: edit twin/cli instead.\n\n"
    page = Path(app.srcdir) / "reference" / "command_line.md"
    page.write_text(head + text.replace("[required]", "(required)").rstrip() + "\n", "utf-8")


def write_mathml(self: Any, node: Any) -> None:
    """Write a formula as MathML, which browsers read without a script or a network."""
    text, block = node.astext(), node.tagname == "math_block"
    if block and "&" in text and "\\begin" not in text:
        text = rf"\begin{{aligned}}{text}\end{{aligned}}"
    self.body.append(tex2mathml(text, as_block=block))
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Connect the hooks above."""
    app.add_html_math_renderer("mathml", (write_mathml, None), (write_mathml, None))
    app.connect("builder-inited", write_command_line)
    app.connect("autodoc-process-docstring", keep_own_sections, priority=100)
