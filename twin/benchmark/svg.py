"""A matplotlib picture as a small SVG that can stand in a page with others.

matplotlib writes each number with six decimals, each point of a curve, and names that are the same
in every picture. Here points that do not show are left out, and numbers keep one or two decimals.
Equal styles are written once. Only what is referred to has a name, which is unique.
"""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "FONTS",
    "pdf_of",
    "sheet_of",
    "standalone",
    "svg_of",
    "with_styles",
]

FONTS = "Verdana, 'DejaVu Sans', Roboto, 'Helvetica Neue', Arial, sans-serif"
"""The first two are as wide as the letters that matplotlib measures, the others narrower."""

NEAR = 0.25
"""A curve may pass its points at this distance, pt: a pixel of a phone is larger."""

_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")

_REFERENCE = re.compile(r"#([\w.-]+)")

_FONT = re.compile(r"font-family:[^;]*;?")


def svg_of(fig: Figure, prefix: str, label: str, styles: dict[str, str]) -> str:
    """Return a picture as an SVG element of its size; equal pictures are equal texts.

    ``prefix`` begins each name in it: a word that no other picture of the page has. ``label`` is
    what is to be seen, for those who hear the page. ``styles`` are the classes by style of all
    pictures of the page; those of this one are added.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    FigureCanvasSVG(fig)
    if (layout := fig.get_layout_engine()) is not None:
        # matplotlib would draw the whole picture once more to lay it out
        layout.execute(fig)
        with matplotlib.rc_context(
            {"figure.autolayout": False, "figure.constrained_layout.use": False}
        ):
            fig.set_layout_engine(None)  # "none" would still have it drawn twice
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "usv-twin"}):
        fig.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    root = ET.fromstring(buffer.getvalue())
    text = ET.tostring(root, encoding="unicode")
    used = {name: f"{prefix}-{k}" for k, name in enumerate(dict.fromkeys(_references(text)))}
    _tidy(root, used, styles)
    width, height = (float(72.0 * inch) for inch in fig.get_size_inches())
    root.attrib.clear()
    root.attrib.update(
        {"viewBox": f"0 0 {width:g} {height:g}", "role": "img", "aria-label": label},
    )
    return ET.tostring(root, encoding="unicode", short_empty_elements=True)


def pdf_of(fig: Figure) -> bytes:
    """Return a picture as PDF, with TrueType letters as journals ask for; equal ones are equal."""
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        fig.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()


def with_styles(svg: str, own: Sequence[str], styles: dict[str, str]) -> str:
    """Return a picture whose classes are those of a page.

    ``own`` are its styles, of the classes s0, s1 and so on; ``styles`` the page's classes by
    style, to which they are added.
    """
    names = [styles.setdefault(style, f"s{len(styles)}") for style in own]
    return re.sub(r'class="s(\d+)"', lambda match: f'class="{names[int(match[1])]}"', svg)


def sheet_of(styles: Mapping[str, str], inside: str = "") -> str:
    """Return a style sheet for pictures, or for those ``inside`` other elements."""
    rules = [f"{inside}*{{stroke-linejoin:round;stroke-linecap:butt}}"]
    rules += [f"{inside}.{name}{{{style}}}" for style, name in styles.items()]
    return "\n".join(rules)


def standalone(svg: str, styles: Mapping[str, str]) -> str:
    """Return an SVG element as a file of its own."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" font-family="{FONTS}"'
    there = set(re.findall(r'class="(\w+)"', svg))
    sheet = sheet_of({style: name for style, name in styles.items() if name in there})
    return svg.replace("<svg", head, 1).replace(">", f"><style>{sheet}</style>", 1) + "\n"


def _references(text: str) -> list[str]:
    """Return the names that are referred to, in order."""
    return re.findall(r'(?:href="|url\()#([\w.-]+)', text)


def _tidy(element: ET.Element, used: dict[str, str], styles: dict[str, str]) -> None:
    """Simplify an element and all in it."""
    element.tag = element.tag.rpartition("}")[2]
    element.text = element.text if element.tag == "text" else None
    element.tail = None
    values = {}
    for key, value in element.attrib.items():
        name = key.rpartition("}")[2]
        if name == "id":
            value = used.get(value, "")
        elif name == "d":
            value = _curve(value)
        elif name == "style":
            value = _FONT.sub("", value).replace(": ", ":").replace("; ", ";").strip(" ;")
        elif name == "transform" and value.startswith("rotate(-0"):
            value = ""
        if name not in ("d", "id"):
            value = _NUMBER.sub(_short, value)
            value = _REFERENCE.sub(lambda m: f"#{used.get(m[1], m[1])}", value)
        if name == "style" and value:
            name, value = "class", styles.setdefault(value, f"s{len(styles)}")
        if value:
            values[name] = value
    element.attrib.clear()
    element.attrib.update(values)
    children: list[ET.Element] = []
    for child in list(element):
        _tidy(child, used, styles)
        if child.tag in ("metadata", "style") or (child.tag in ("g", "defs") and not len(child)):
            continue
        bare = child.tag == "g" and not child.attrib
        children += list(child) if bare else [child]
    element[:] = children


def _short(match: re.Match[str]) -> str:
    """Return a number with two decimals at most."""
    return f"{float(match[0]) + 0.0:.2f}".rstrip("0").rstrip(".").replace("-0.", "-.") or "0"


def _curve(data: str) -> str:
    """Return the data of a path in steps of a tenth, without points that do not show."""
    from matplotlib.path import Path

    if re.search("[QC]", data):
        return _NUMBER.sub(_short, " ".join(data.split()))
    out = []
    for piece in data.split("M")[1:]:
        closed = "z" in piece
        points = np.array([float(v) for v in re.findall(r"-?[\d.]+", piece)]).reshape(-1, 2)
        if len(points) > 8:
            path = Path(points)
            path.simplify_threshold = NEAR
            path = path.cleaned(simplify=True)
            points = np.asarray(path.vertices)[np.asarray(path.codes) != Path.STOP]
        whole = np.rint(10.0 * points).astype(np.int64)
        steps = np.diff(whole, axis=0, prepend=np.zeros((1, 2), dtype=np.int64)).tolist()
        pairs = [_tenths(x) + _joined(_tenths(y)) for x, y in steps]
        line = pairs[1] + "".join(map(_joined, pairs[2:])) if len(pairs) > 1 else ""
        out.append(f"M{pairs[0]}{line and 'l'}{line}{'z' * closed}")
    return "".join(out)


def _tenths(value: int) -> str:
    """Return tenths as a number."""
    whole, part = divmod(abs(value), 10)
    digits = f"{whole or ''}.{part}" if part else str(whole)
    return "-" * (value < 0) + digits


def _joined(text: str) -> str:
    """Return a number to follow another, separated by its sign or by a space."""
    return text if text[0] == "-" else f" {text}"
