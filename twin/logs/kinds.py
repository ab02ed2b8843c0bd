"""Files of other kinds than a log of columns: what they are, and what to do with them."""

from __future__ import annotations

import re

__all__ = ["is_nmea", "kind_of", "mcap_kind"]

_NMEA_LINE = re.compile(
    rb"^[-\d:.TZ+,; \t]*([A-Z][,; ])?(\\[^\\\r\n]*\\)?[$!][A-Z][A-Z0-9]{3,5},[^\r\n]*",
    re.MULTILINE,
)
"""A sentence of NMEA 0183, behind a TAG block, the time of a logger, or nothing."""

_MAGIC = {
    b"#ROSBAG V": "a ROS 1 bag; give it the ending .bag",
    b"PAR1": "a Parquet file; give it the ending .parquet",
    b"ULog": "a log of PX4; make CSV of its topics: ulog2csv FILE, and join them by their time",
    b"\xa3\x95": "a DataFlash log of ArduPilot; give it the ending .bin",
    b"PK\3\4": "a spreadsheet or another packed file; save it as CSV in UTF-8",
    **dict.fromkeys((b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf"), "a packed file; unpack it, or use gzip"),
    b"\x89HDF": "an HDF5 or MATLAB file; write its columns as CSV",
    b"\x93NUMPY": "a NumPy array; write its columns as CSV, with numpy.savetxt",
    b"ARROW1": "an Arrow or Feather file; write it as Parquet, with pyarrow",
    b"\xb5b": "a record of a u-blox receiver; make NMEA 0183 of it, in u-center or with pyubx2",
    b"MATLAB 5.0": "a MATLAB file; write its columns as CSV, with writetable",
    b"SQLite format 3": "a database, as ROS 2 bags are; of these give it the ending .db3",
    b"\x89MCAP0": "an MCAP; give it the ending .mcap",
}
"""How binary files begin."""

_BY_HAND = "make CSV of it, with a column each for time, place, heading and commands"

_TEXTS = {
    rb"\s*<(\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<?gpx\b|.{8}\.FIT"
    rb"|A[A-Z0-9]{3}[^\n]*\n(H[^\n]*\n)*B\d{13}[NS]": (
        "a GPX track or one of its kind (FIT, IGC): places and times, but neither "
        "headings nor commands; make CSV of it (gpsbabel -t -i gpx -f IN -o unicsv -F OUT.csv) and "
        "join those of another log"
    ),
    rb"\s*<": f"XML; {_BY_HAND}",
    rb"\s*(\([-\d :.]+\)\s+)?v?s?l?can\d+\s+([RT]X[-\s]+)?[0-9A-Fa-f]+(#|\s+\[\d)"
    rb"|date [^\n]*\nbase (hex|dec)|[-\d:.TZ]+,\d,\d{5,6},\d+,\d+,\d+,[0-9A-Fa-f]{2}"
    rb"|[\d:.]+ [RT] [0-9A-F]{8}( [0-9A-F]{2})+\s|A\d{6}\.\d+ ([0-9A-F]{5} ){2}[0-9A-F]+\s": (
        "a record of a CAN bus, such as candump writes; decode it (for NMEA 2000: candump2analyzer "
        "< IN | analyzer -json) and make CSV of that"
    ),
    rb"(\d+;\w;)?[\s\[]*\{.{0,2000}\"(updates|context)\"\s*:": (
        f"a file of Signal K deltas, one JSON object a line; {_BY_HAND}"
    ),
    rb"\s*((#|\w+ *=)[^\n]*\n\s*)*\[\[?(particulars|instruments|deck|ship|hull|vessel)\]": (
        "TOML of a boat, not a log; name the log, and this with --ship"
    ),
    rb"\s*((#|\w+ *=)[^\n]*\n\s*)*\[\[?[\w.]+\]\]?\s*(#|\n)": (
        "TOML, as mappings are, not a log; name the log, and this with --mapping"
    ),
    rb"\s*[\[{]": f"JSON; {_BY_HAND}",
    rb"(---\n)?[a-z_]+:[^\n]*\n(.*\n)?---\n": (
        "YAML, as ros2 topic echo prints it; record the topics in its place: ros2 bag record"
    ),
    rb"[^\n]*\braw_data\b[^\n]*\n[^\n]*[$!][A-Z]{5},": (
        "CSV of NMEA 0183 sentences, as the VDR of OpenCPN writes it; write those alone, one a "
        "line, to a file that ends in .nmea"
    ),
    rb"[\d-]+ [\d:.]+: [A-Z_0-9]+ \{": (
        "a telemetry log of MAVLink as text; give the .tlog that it was made of, whose messages "
        "are known"
    ),
    rb"FMT,\s*\d+,\s*\d+,|([A-Z][A-Z0-9]{2,3}, [^\n]*\n){2}": (
        "a DataFlash log of ArduPilot as text; give the .bin that it was made of, whose messages "
        "are known"
    ),
    rb"!(Boat|boat|v\d)": (
        "a log of Expedition: pairs of number and value; export it there as CSV, with a column "
        "for each channel"
    ),
    rb"(\s*[A-Za-z_ ]+:\s*-?\d[\d.]*\s*([,;]\s*|\r?$)){2,}": (
        "a file of lines of names and values; write the names once, as a header, and the values "
        "alone below it"
    ),
}
"""How texts begin, and what they are."""


def is_nmea(start: bytes) -> bool:
    """Return whether most lines of a start are sentences; the first and the last may be cut."""
    lines = sum(1 for line in start.splitlines() if line.strip())
    sentences = len(_NMEA_LINE.findall(start))
    return sentences > 0 and sentences >= 0.5 * (lines - 2)


def kind_of(start: bytes) -> str:
    """Return what a file that begins so is, and the way from it to a log; nothing of CSV."""
    for magic, what in _MAGIC.items():
        if start.startswith(magic):
            return what
    if is_nmea(start):
        return (
            "a log of NMEA 0183, whose sentences are known: it needs no mapping, or one with "
            "constants for commands that it lacks, such as n_rps = 0.0 and delta_rad = 0.0"
        )
    for pattern, what in _TEXTS.items():
        if re.match(pattern, start.removeprefix(b"\xef\xbb\xbf"), re.MULTILINE | re.DOTALL):
            return what
    return ""


def mcap_kind(start: bytes) -> str:
    """Return what an MCAP holds that is no bag of ROS, and the way from it to a log."""
    for encoding in (b"jsonschema", b"json", b"protobuf", b"flatbuffer", b"ros1"):
        if encoding in start:
            name = {b"jsonschema": "JSON", b"json": "JSON"}.get(encoding, encoding.decode())
            return (
                f"an MCAP of {name} messages, as of Foxglove or BlueOS, not of ROS 2; make CSV of "
                "its topics (mcap cat --json IN.mcap) and name their columns in a mapping"
            )
    return ""
