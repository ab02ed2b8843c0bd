"""Files of any bytes: each loads, or gives one sentence that names the file."""

import gzip
import io
import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.twin.agents.drawn_policy import drawn_policy
from tests.twin.logs.autopilot_logs import RUDDER, SKID, dataflash, telemetry
from tests.twin.logs.foreign import EXAMPLE, FOREIGN, MAPPINGS, record, run
from twin import Log, Particulars
from twin.agents.hyperparameters import hyperparameters
from twin.agents.policy import Policy
from twin.boat_prior import BoatPrior
from twin.channels import COMMANDS
from twin.files import keep, kept
from twin.logs.mapping import Layout
from twin.logs.plan import read_plan
from twin.predictors.learned.pretrained import Weights
from usv_gym.hydro.netcdf import read_table
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.recorded_spectrum import Spectrum
from usv_kernel.errors import UsvTwinError

ROOT = Path(__file__).resolve().parents[2]

ODD = (None, -1, 0, 0.5, 1e300, float("nan"), float("inf"), 2**70, True, "x", [], {}, [[1]])

ODD_TEXTS = [
    *(b"nan", b"-inf", b"1e308", b"-1e-308", b"0", b"-1", b"9" * 5000, b"[" * 3000, b"a." * 2000),
    *(b"true", b"''", b"\n\n", b"\0", b"\xff\xfe", b"=", b",", b'"', b"[x]\n", b"1979-05-27"),
]


SPECTRUM = b"frequency_hz,density_m2_per_hz\n0.1,0\n0.2,3\n0.3,1\n0.4,0\n"

WEIGHTS = "twin/predictors/learned/weights/fleet-lstm.npz"


class Kind(NamedTuple):
    """A kind of file: its name, a whole one, and what reads it."""

    name: str
    whole: Callable[[Path], bytes]  # makes it in a folder
    read: Callable[[Path], Any]


def shipped(name: str) -> Callable[[Path], bytes]:
    return lambda folder: (ROOT / name).read_bytes()


def written(log: Log, name: str) -> Callable[[Path], bytes]:
    def make(folder: Path) -> bytes:
        log.write(folder / name)
        return (folder / name).read_bytes()

    return make


def bag(storage: str, name: str) -> Callable[[Path], bytes]:
    def make(folder: Path) -> bytes:
        record(folder / "bag", run(40), storage)
        return next((folder / "bag").glob(name)).read_bytes()

    return make


def telemetry_log(folder: Path) -> bytes:
    pytest.importorskip("pymavlink")
    return telemetry(run(60), RUDDER)


def drawn(observation: str, **options: Any) -> Callable[[Path], bytes]:
    def make(folder: Path) -> bytes:
        drawn_policy(observation, **options).save(folder / "drawn.npz")
        return (folder / "drawn.npz").read_bytes()

    return make


def own_prior(folder: Path) -> bytes:
    names = ("X_u", "N_r", "Y_v")
    table = {"boat": "test", "model": "mmg", "steering": "rudder", "length": 3.0, "beam": 1.0}
    table |= {
        "mass": 900.0,
        "speed": 2.0,
        "shaft_speed": 10.0,
        "runs": 2,
        "parameters": names,
        "mean": (1.0, 2.0, 3.0),
    }
    covariance = ((1.0, 0.0, 0.1), (0.0, 2.0, 0.0), (0.1, 0.0, 3.0))
    return BoatPrior(**table, covariance=covariance).file_text().encode()


def acts(path: Path) -> None:
    policy = Policy.load(path)
    policy.forget(3)
    seen = np.random.default_rng(0).normal(0.0, 10.0, (3, len(policy.names))).astype(np.float32)
    for _ in range(3):
        assert np.isfinite(policy.act(seen)).all()


def reads_log(path: Path) -> None:
    log = Log.read(path)
    assert np.isfinite(log.t).all() and np.isfinite(log.cmd).all()
    assert not np.isinf(log.z).any()


def reads_bag(path: Path) -> None:
    Log.read(path, MAPPINGS / "ros2_example.toml")


KINDS = [
    Kind("usv75.toml", shipped("usv_gym/vessel/vessels/usv75.toml"), Vessel.load),
    Kind("otter.toml", shipped("usv_gym/vessel/vessels/otter.toml"), Vessel.load),
    Kind("hull.nc", shipped("usv_gym/vessel/vessels/usv75.nc"), read_table),
    Kind("boat.toml", shipped("twin/logs/recorded/boat1_usv_circle.toml"), Particulars.load),
    Kind("boat.prior", own_prior, BoatPrior.load),
    Kind("a.mapping.toml", lambda folder: FOREIGN.encode(), Layout.load),
    Kind("b.mapping.toml", lambda folder: EXAMPLE.encode(), Layout.load),
    Kind("ppo.toml", shipped("twin/agents/hyper/ppo.toml"), lambda p: hyperparameters("ppo", p)),
    Kind("log.csv", written(run(60), "whole.csv"), reads_log),
    Kind("log.csv.gz", written(run(60), "whole.csv.gz"), reads_log),
    Kind("log.parquet", written(run(60), "whole.parquet"), reads_log),
    Kind("bag.mcap", bag("MCAP", "*.mcap"), reads_bag),
    Kind("bag.db3", bag("SQLITE3", "*.db3"), reads_bag),
    Kind("flight.BIN", lambda folder: dataflash(run(60), SKID), reads_log),
    Kind("flight.tlog", telemetry_log, reads_log),
    Kind("plan.csv", written(run(60), "whole.csv"), lambda p: read_plan(p, 10.0, 0.1)),
    Kind("sea.csv", lambda folder: SPECTRUM, Spectrum.read),
    Kind("policy.npz", drawn("twin"), acts),
    Kind("lstm.npz", drawn("raw", recurrent=True), acts),
    Kind("weights.npz", shipped(WEIGHTS), lambda p: Weights.read(p, "lstm")),
]


def mutant(content: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with one to three things changed at random."""
    if content.startswith(b"PK") and rng.random() < 0.7:
        return archive_mutant(content, rng)
    if content.startswith(b"\x1f\x8b") and rng.random() < 0.7:
        return gzip.compress(mutant(gzip.decompress(content), rng), 1)
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at, way = int(rng.integers(len(changed) + 1)), rng.integers(6)
        length = int(rng.integers(1, 40))
        if way == 0:
            del changed[at:]
        elif way == 1:
            del changed[at : at + length]
        elif way == 2:
            changed[at : at + 1] = rng.bytes(length % 4 + 1)
        elif way == 3:
            begin = int(rng.integers(len(changed) + 1))
            changed[at:at] = changed[begin : begin + 10 * length]
        else:  # a word, or a number
            starts = [m for m in range(at, len(changed)) if chr(changed[m]) in "0123456789 =,\n"][
                :1
            ]
            first = starts[0] if starts else at
            changed[first : first + int(rng.integers(3))] = ODD_TEXTS[
                int(rng.integers(len(ODD_TEXTS)))
            ]
    return bytes(changed)


def archive_mutant(content: bytes, rng: np.random.Generator) -> bytes:
    """Return an archive with one array or one of its notes changed, whose checksums are right."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = str(rng.choice(sorted(parts)))
    array, way = np.load(io.BytesIO(parts[name])), rng.integers(6)
    if way == 0:
        del parts[name]
    elif way == 1:
        parts[name] = mutant(parts[name], rng)
    elif way == 2:
        parts[name] = parts[str(rng.choice(sorted(parts)))]
    else:
        if array.dtype.kind == "U":
            notes = json.loads(str(array))
            notes[str(rng.choice(sorted(notes)))] = ODD[int(rng.integers(len(ODD)))]
            array = np.array(json.dumps(notes))
        elif way == 3:
            array = array.copy()
            array.flat[rng.integers(array.size)] = rng.choice([np.nan, np.inf, 3e4, -1.0])
        else:
            ways = [array[:-1], array[None], array.astype("U9"), array > 0.0, np.zeros((0, 3))]
            array = [*ways, array.astype(np.float64), np.zeros((40, *array.shape))][
                int(rng.integers(len(ways) + 2))
            ]
        entry = io.BytesIO()
        np.save(entry, array)
        parts[name] = entry.getvalue()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return packed.getvalue()


def outcome(kind: Kind, path: Path) -> bool:
    """Return whether a file loads; if not, its error must be one sentence that names it."""
    try:
        with np.errstate(all="ignore"):
            kind.read(path)
    except UsvTwinError as error:
        message = str(error)
        assert str(path) in message and "\n" not in message and len(message) < 2000, message
        return False
    return True


def read_mutants(kind: Kind, folder: Path, count: int, seed: int) -> None:
    rng = np.random.default_rng([seed, len(kind.name)])
    whole, path = kind.whole(folder), folder / kind.name
    path.write_bytes(whole)
    assert outcome(kind, path)
    loaded = 0
    for _ in range(count):
        path.write_bytes(mutant(whole, rng))
        loaded += outcome(kind, path)
    assert loaded < count


@pytest.mark.parametrize("count", [60, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_damaged_files_give_a_sentence_or_load(kind, count, tmp_path):
    read_mutants(kind, tmp_path, count, seed=1)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_any_bytes_give_a_sentence_or_load(kind, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bytes")

    @settings(max_examples=30, derandomize=True)
    @example(b"")
    @example(b"PK\x03\x04")
    @example(b"\x1f\x8b")
    @example(b"PAR1")
    @example(b"\xa3\x95\x80")
    @example(b"SQLite format 3\0")
    @example(b"a = " + b"[" * 3000)
    @example(b"a" + b".a" * 3000 + b" = 1")
    @example(b"a = " + b"9" * 5000)
    @example(b"[particulars]\nlength = " + b"9" * 400)
    @given(st.binary(max_size=200) | st.text(max_size=100).map(str.encode))
    def check(content):
        (folder / kind.name).write_bytes(content)
        outcome(kind, folder / kind.name)

    check()


def test_a_kept_result_is_whole_or_forgotten(tmp_path):
    content = {"rows": [{"error": 0.5, "name": "é"}, {"error": float("inf"), "name": None}]}
    path, rng, found = tmp_path / "kept.json", np.random.default_rng(3), 0
    keep(path, ["program", 1], content)
    assert kept(path, ["program", 1]) == content
    assert kept(path, ["program", 2]) is None
    whole = path.read_bytes()
    for _ in range(500):
        path.write_bytes(mutant(whole, rng))
        now = kept(path, ["program", 1])
        assert now is None or now == content
        found += now is not None
    assert found < 100
    assert kept(tmp_path / "none.json", 1) is None


BOMB = """
import resource, sys
from twin import Log
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    Log.read(sys.argv[1])
except ValueError as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3)
"""


@pytest.mark.parametrize("line", ["", ",", "0,0,0,0,0,0,0,0"])
def test_a_small_file_that_unpacks_to_much_takes_little_memory(tmp_path, line):
    """Field study: 652 kB of packed blank lines took 7 GB."""
    pytest.importorskip("resource")
    path = tmp_path / "a.csv.gz"
    names = ("t_s", *COMMANDS, "gps_x_m", "gps_y_m", "compass_rad")
    text = ",".join(names) + "\n" + f"{line}\n" * 4_100_000
    path.write_bytes(gzip.compress(text.encode(), 1))
    command = [sys.executable, "-c", BOMB, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert not done.returncode, done.stderr
    said, megabytes = done.stdout.splitlines()
    assert said.startswith(f"{path}: ") and ("no row" in said or "4,000,000 rows" in said)
    assert float(megabytes) < 900.0
