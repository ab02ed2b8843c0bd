"""Recorded runs of others as logs; the real folders where they are, small ones made here else."""

from __future__ import annotations

import gzip
import os
import shlex
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

import usv_gym.vessel
from twin import Twin
from twin.channels import COMMANDS, MEASUREMENTS
from twin.cli.main import app
from twin.logs import datasets as archive
from twin.logs.datasets import ArchiveError
from twin.logs.log import Log, recorded_runs
from twin.particulars import Particulars, ParticularsError
from twin.sim.recorded import particulars_for_log

SHARED = Path(
    os.environ.get("USV_TWIN_SHARED") or Path(__file__).resolve().parents[3].parent / "shared"
)
NAMES = {"esso_osaka_frt": 24, "kvlcc2_simman2008": 9, "boat1_usv": 1}
COLUMN = {name: i for i, name in enumerate(MEASUREMENTS)}

HEADERS = {
    "esso_osaka_frt": "t_s,x_m,y_m,psi_rad,u_mps,v_mps,r_radps,n_rps,delta_rad,wind_true_mps,"
    "wind_true_from_rad,wind_app_mps,wind_app_from_rad",
    "kvlcc2_simman2008": "t_s,x_m,y_m,psi_rad,u_mps,v_mps,r_radps,phi_rad,delta_rad,n_rps,"
    "xdot_mps,ydot_mps,x_int_m,y_int_m,psi_int_rad",
}


def made(folder: Path, name: str, rows: list[list[float]]) -> Path:
    """Write a small run under the real folder's name and header; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [HEADERS[folder.name], *(",".join(map(repr, row)) for row in rows)]
    (folder / f"{name}.csv.gz").write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))
    return folder


def esso_rows(count: int = 30) -> list[list[float]]:
    return [
        [
            *(0.1 * k, 0.03 * k, 0.01 * k, 0.02 * k, 9.0, 9.0, 0.2 + 1e-4 * k, 10, 0.1),
            *(2.0 + 1e-3 * k, 5.5 + 1e-3 * k, 9.0, 9.0),
        ]
        for k in range(count)
    ]


def shared(folder: str) -> Path:
    path = SHARED / "data" / folder
    if not path.is_dir():
        pytest.skip(f"{path} is not here")
    return path


def test_esso_rows_are_as_its_readme_advises(tmp_path: Path) -> None:
    rows = esso_rows()
    rows[6][1:3] = rows[5][1:3]  # a freeze
    folder = made(tmp_path / "esso_osaka_frt", "zigzag_1", rows)
    assert archive.runs(folder) == ["zigzag_1"]
    log, particulars = archive.load(folder, "zigzag_1")
    z = dict(zip(MEASUREMENTS, log.z.T, strict=True))
    for name, index in {
        "compass_rad": 3,
        "gyro_radps": 6,
        "wind_mps": 9,
        "wind_from_rad": 10,
    }.items():
        np.testing.assert_array_equal(z[name], [row[index] for row in rows])
    assert np.isnan(z["gps_x_m"][6])
    assert np.isfinite(np.delete(z["gps_x_m"], 6)).all()
    # u and v come late and filtered: not used
    for name in ("gps_vx_mps", "gps_vy_mps", "accel_x_mps2", "accel_y_mps2"):
        assert np.isnan(z[name]).all()
    np.testing.assert_array_equal(log.cmd, np.tile([10.0, 10.0, 0.1, 0.1], (30, 1)))
    assert log.truth is None
    assert any("1 of 30 fixes repeat" in note for note in log.notes)
    assert (particulars.length, particulars.mass) == (3.0, 244.6)


def test_late_yaw_rate_of_berthing_is_left_out(tmp_path: Path) -> None:
    folder = made(tmp_path / "esso_osaka_frt", "berthing_1", esso_rows())
    assert np.isnan(archive.load(folder, "berthing_1")[0].z[:, COLUMN["gyro_radps"]]).all()


def test_basin_columns_are_converted(tmp_path: Path) -> None:
    row = [0.0, 1.0, 2.0, 3.0, 9.0, 9.0, 6.0, 9.0, 0.3, 10.2, 7.0, 8.0, 11.0, 12.0, 9.0]
    later = [value + 0.5 for value in row]
    folder = made(tmp_path / "kvlcc2_simman2008", "marin_1", [row, later])
    lines = [
        "t_s,x_m,y_m,psi_rad,u_mps,v_mps,r_radps,phi_rad,delta_rad,n_rps,xdot_mps,ydot_mps",
        *(",".join(map(repr, values[:12])) for values in (row, later)),
    ]
    (folder / "hsva_1.csv.gz").write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))
    (folder / "propeller_open_water_raw.csv").write_text("J,KT", encoding="ascii")
    assert archive.runs(folder) == ["hsva_1", "marin_1"]
    marin, ship = archive.load(folder, "marin_1")
    np.testing.assert_array_equal(marin.z[0, :6], [11.0, 12.0, 7.0, 8.0, 3.0, 6.0])
    np.testing.assert_array_equal(marin.cmd[0], [10.2, 10.2, 0.3, 0.3])
    hsva, other = archive.load(folder, "hsva_1")
    np.testing.assert_array_equal(hsva.z[0, :2], [1.0, 2.0])
    assert np.isnan(hsva.z[:, 6:]).all()
    assert (ship.length, ship.instruments != other.instruments) == (7.0, True)


def test_export_is_what_the_benchmark_reads(tmp_path: Path) -> None:
    folder = made(tmp_path / "esso_osaka_frt", "turn_1", esso_rows())
    (path,) = archive.export(folder, tmp_path / "out")
    log, particulars = archive.load(folder, "turn_1")
    text = path.read_text(encoding="ascii")
    assert text.startswith("t_s," + ",".join(COMMANDS))
    # constant yaw rate and wind are what Log.read takes for dead sensors: not in real runs
    assert Particulars.load(path.with_suffix(".toml")) == particulars
    assert len(text.splitlines()) == len(log) + 1


def test_missing_folder_or_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match="known by name: esso_osaka_frt, kvlcc2_simman2008"):
        archive.runs(tmp_path / "elsewhere")
    with pytest.raises(ArchiveError, match="no recorded run there; the data is not part of"):
        archive.runs(tmp_path / "boat1_usv")
    folder = made(tmp_path / "esso_osaka_frt", "turn_1", esso_rows())
    with pytest.raises(ArchiveError, match="no run is called 'turn_2'; known: turn_1"):
        archive.load(folder, "turn_2")


@pytest.mark.parametrize("name", NAMES)
def test_recorded_folders_are_read(tmp_path: Path, name: str) -> None:
    folder = shared(name)
    names = archive.runs(folder)
    assert len(names) >= NAMES[name]
    for run in {names[0], names[-1]}:
        log, particulars = archive.load(folder, run)
        # the fixes are of one motion with the particulars' speed
        x, y = log.z[np.isfinite(log.z[:, 0])][:, :2].T
        length = float(np.hypot(np.diff(x), np.diff(y)).sum())
        assert 0.05 < length / (log.t[-1] - log.t[0]) / particulars.speed < 1.5
        path = tmp_path / f"{run}.csv"
        log.write(path)
        np.testing.assert_array_equal(Log.read(path).z, log.z)


def test_the_field_run_is_the_one_that_ships(tmp_path: Path) -> None:
    folder = shared("boat1_usv")
    log, particulars = archive.load(folder, "boat1_2_circle")
    path = recorded_runs()["boat1_usv_circle"]
    shipped = Log.read(path)
    assert particulars == Particulars.load(path.with_name("boat1_usv_circle.toml"))
    np.testing.assert_allclose(log.cmd, shipped.cmd, atol=1e-12)
    both = np.isfinite(log.z) & np.isfinite(shipped.z)
    # rounded to four decimals when it was packed, so that a repeat may have been made by it
    assert both.sum() > 0.99 * np.isfinite(log.z).sum()
    np.testing.assert_allclose(log.z[both], shipped.z[both], atol=6e-5)


@pytest.mark.parametrize(
    ("name", "run"), [("esso_osaka_frt", "turn_14-Oct"), ("kvlcc2_simman2008", "hsva_z_20")]
)
def test_a_twin_follows_a_recorded_ship(name: str, run: str) -> None:
    folder = shared(name)
    found = next(item for item in archive.runs(folder) if item.startswith(run))
    log, particulars = archive.load(folder, found)
    twin = Twin(particulars, "ukf")
    for t, z, cmd in log.slice(t1=60.0):
        twin.step(t, z, cmd)
    last = np.flatnonzero(np.isfinite(log.z[:, 0]) & (log.t < 60.0))[-1]
    # metres; the receivers jitter by millimetres and stand still for up to a second
    assert np.hypot(*(twin.estimate().state[:2] - log.z[last, :2])) < 0.3


def test_a_run_is_known_by_its_header_wherever_it_lies(tmp_path: Path) -> None:
    folder = made(tmp_path / "esso_osaka_frt", "zigzag_1", esso_rows())
    there = tmp_path / "elsewhere.csv.gz"
    there.write_bytes((folder / "zigzag_1.csv.gz").read_bytes())
    assert archive.ship(there) == archive.ESSO
    np.testing.assert_array_equal(Log.read(there).z, archive.load(folder, "zigzag_1")[0].z)
    other = recorded_runs()["boat1_usv_circle"]
    assert archive.known(there) and not archive.known(other)
    for content in (b"", b"t_s,x_m\n", gzip.compress(b"t_s\n1\n"), b"\x1f\x8b\x08broken"):
        there.write_bytes(content)
        assert not archive.known(there)
    with pytest.raises(ArchiveError, match="its header is that of no archive"):
        archive.ship(there)


def test_a_run_is_known_by_its_header_in_any_kind_of_table(tmp_path):
    folder = made(tmp_path / "esso_osaka_frt", "turn_1", esso_rows())
    packed = folder / "turn_1.csv.gz"
    plain, table = tmp_path / "mine.csv", tmp_path / "mine.parquet"
    plain.write_bytes(b"\xef\xbb\xbf" + gzip.decompress(packed.read_bytes()))
    pl.read_csv(plain).write_parquet(table)
    for path in (packed, plain, table):
        assert archive.known(path)
        assert particulars_for_log(path) == archive.ESSO
    for path in (tmp_path, tmp_path / "absent.csv", tmp_path / "absent.parquet"):
        assert not archive.known(path)
    boats = {"kvlcc2_simman2008": archive.KVLCC2["hsva"].name, "boat1_usv": "boat1 USV"}
    for archived, boat in boats.items():
        plain.write_text(",".join(archive._HEADERS[archived]) + "\n", encoding="utf-8")
        assert particulars_for_log(plain).name == boat


@pytest.mark.parametrize("kind", ["identify", "predict", "view", "benchmark"])
def test_each_command_refuses_a_log_without_particulars(tmp_path, kind):
    path = tmp_path / "mine.csv"
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    log.write(path)
    options = {
        "benchmark": ["--predictors", "persistence", "--out", str(tmp_path / "out"), "--jobs=1"],
    }
    first = [str(path)] if kind != "benchmark" else ["--log", str(path)]
    result = CliRunner().invoke(app, [kind, *first, *options.get(kind, [])])
    said = " ".join(result.output.split())
    assert result.exit_code == 2
    assert f"{path}: no particulars of the boat" in said
    particulars = tmp_path / "mine.toml"
    assert f"usv-twin check {path} --write {particulars}. Then fill in length, beam" in said


@pytest.mark.parametrize("name", ["mine.csv", "my own.csv"])
def test_the_command_that_missing_particulars_name_works(tmp_path, name):
    path = tmp_path / name
    Log.read(recorded_runs()["boat1_usv_circle"]).write(path)
    with pytest.raises(ParticularsError, match=r"--mapping map.toml --write .*Then fill in"):
        particulars_for_log(path, mapping="map.toml")
    with pytest.raises(ParticularsError, match="no particulars") as error:
        particulars_for_log(path)
    command = str(error.value).partition("usv-twin ")[2].partition(". Then")[0]
    result = CliRunner().invoke(app, [*shlex.split(command), "--no-picture"])
    assert result.exit_code == 0, result.output
    written = path.with_suffix(".toml")
    stated = "length = 2\nbeam = 1\ndraft = 0.2\nmass = 60\n"
    text = written.read_text(encoding="utf-8").replace("# length = ?", stated)
    written.write_text(text, encoding="utf-8")
    assert particulars_for_log(path).length == 2.0


def test_particulars_next_to_a_log_may_be_a_vessel_file(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("t_s\n", encoding="utf-8")
    vessels = Path(usv_gym.vessel.__file__).with_name("vessels")
    (tmp_path / "mine.toml").write_bytes((vessels / "otter.toml").read_bytes())
    assert particulars_for_log(path).mass == 55.0
    with pytest.raises(
        ParticularsError, match=r"is a vessel file.*--ship.*particulars_of\(usv_gym"
    ):
        Particulars.load(tmp_path / "mine.toml")
    (tmp_path / "mine.toml").write_text("[instruments]\n", encoding="utf-8")
    with pytest.raises(ParticularsError, match=r"mine.toml: expected the tables \[particulars\]"):
        particulars_for_log(path)
