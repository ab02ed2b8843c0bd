"""What docstrings cite exists: each page, each section of it, and no specification file."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [
    path
    for folder in ("usv_kernel", "usv_gym", "twin", "examples", "tests", "docs")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in (".py", ".toml", ".md") and "_build" not in path.parts
]
PAGE = re.compile(r"(docs/[\w/-]+\.md)(?:,\s+\"?([A-Z][\w\s-]*?)\"?(?=[.,;:)\n\"*`]|$))?")
OLD = re.compile(r"(?<![\w/])(physics|twin|performance|field|design|seakeeping)\.md\b")


def titles(page: Path) -> set[str]:
    """Return the titles of a page's sections."""
    return set(re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE))


def citations() -> list[tuple[str, str, str]]:
    """Return file, page and section (or nothing) of each citation of a page."""
    found = []
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        # a citation may go on in the next line of a docstring or comment
        text = re.sub(r"\n[ \t]*(?:#:?[ \t]*)?", " ", text) if path.suffix != ".md" else text
        found += [(str(path.relative_to(ROOT)), *match) for match in PAGE.findall(text)]
    return found


def test_cited_pages_and_sections_exist():
    wrong = []
    for path, page, section in citations():
        if not (ROOT / page).is_file():
            wrong.append(f"{path}: {page}")
        elif section:
            known = titles(ROOT / page)
            if not any(" ".join(section.split()).startswith(title) for title in known):
                wrong.append(f"{path}: {page} has no section {section!r}")
    assert not wrong


def test_links_have_a_text():
    """GitHub shows nothing for a link without one."""
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    assert not [str(path) for path in pages if "[](" in path.read_text(encoding="utf-8")]


def test_no_specification_file_is_cited():
    code = [path for path in SOURCES if path.suffix != ".md" and path.name != Path(__file__).name]
    wrong = {str(path.relative_to(ROOT)) for path in code if OLD.search(path.read_text("utf-8"))}
    assert not wrong
