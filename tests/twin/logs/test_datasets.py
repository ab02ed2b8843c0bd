"""Recorded runs of others as logs; the real files where they are, small ones made here else."""

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
from twin.channels import MEASUREMENTS
from twin.cli.main import app
from twin.logs.datasets import known_ship
from twin.logs.log import Log, recorded_runs
from twin.particulars import Particulars, ParticularsError
from twin.sim.recorded import particulars_for_log

SHARED = Path(
    os.environ.get("USV_TWIN_SHARED") or Path(__file__).resolve().parents[3].parent / "shared"
)
NAMES = {"esso_osaka_frt": 24, "kvlcc2_simman2008": 8, "boat1_usv": 1}
COLUMN = {name: i for i, name in enumerate(MEASUREMENTS)}

ESSO = (
    "t_s,x_m,y_m,psi_rad,u_mps,v_mps,r_radps,n_rps,delta_rad,wind_true_mps,wind_true_from_rad,"
    "wind_app_mps,wind_app_from_rad"
)
KVLCC2 = "t_s,x_m,y_m,psi_rad,u_mps,v_mps,r_radps,phi_rad,delta_rad,n_rps,xdot_mps,ydot_mps"


def made(path: Path, header: str, rows: list[list[float]]) -> Path:
    """Write a small run with the header of a data set."""
    lines = [header, *(",".join(map(repr, row)) for row in rows)]
    path.write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))
    return path


def esso_rows(count: int = 30) -> list[list[float]]:
    return [
        [
            *(0.1 * k, 0.03 * k, 0.01 * k, 0.02 * k, 9.0, 9.0, 0.2 + 1e-4 * k, 10, 0.1),
            *(2.0 + 1e-3 * k, 5.5 + 1e-3 * k, 9.0, 9.0),
        ]
        for k in range(count)
    ]


def test_esso_rows_are_as_its_readme_advises(tmp_path: Path) -> None:
    rows = esso_rows()
    rows[6][1:3] = rows[5][1:3]  # a freeze
    log = Log.read(made(tmp_path / "zigzag_1.csv.gz", ESSO, rows))
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
    # the yaw rate of these is late
    late = Log.read(made(tmp_path / "berthing_1.csv.gz", ESSO, esso_rows()))
    assert np.isnan(late.z[:, COLUMN["gyro_radps"]]).all()


def test_basin_columns_are_converted(tmp_path: Path) -> None:
    row = [0.0, 1.0, 2.0, 3.0, 9.0, 9.0, 6.0, 9.0, 0.3, 10.2, 7.0, 8.0, 11.0, 12.0, 9.0]
    rows = [row, [value + 0.5 for value in row]]
    path = made(tmp_path / "marin_1.csv.gz", f"{KVLCC2},x_int_m,y_int_m,psi_int_rad", rows)
    marin, ship = Log.read(path), known_ship(path)
    np.testing.assert_array_equal(marin.z[0, :6], [11.0, 12.0, 7.0, 8.0, 3.0, 6.0])
    np.testing.assert_array_equal(marin.cmd[0], [10.2, 10.2, 0.3, 0.3])
    path = made(tmp_path / "hsva_1.csv.gz", KVLCC2, [each[:12] for each in rows])
    hsva, other = Log.read(path), known_ship(path)
    np.testing.assert_array_equal(hsva.z[0, :2], [1.0, 2.0])
    assert np.isnan(hsva.z[:, 6:]).all()
    assert (ship.name, other.name) == ("KVLCC2, 7 m model, MARIN", "KVLCC2, 7 m model, HSVA")


@pytest.mark.parametrize("name", NAMES)
def test_recorded_folders_are_read(name: str) -> None:
    paths = sorted((SHARED / "data" / name).glob("*.csv.gz"))
    if not paths:
        pytest.skip("the recorded runs are not here")
    assert len(paths) >= NAMES[name]
    for path in {paths[0], paths[-1]}:
        log, particulars = Log.read(path), known_ship(path)
        # the fixes are of one motion with the particulars' speed
        x, y = log.z[np.isfinite(log.z[:, 0])][:, :2].T
        length = float(np.hypot(np.diff(x), np.diff(y)).sum())
        assert 0.05 < length / (log.t[-1] - log.t[0]) / particulars.speed < 1.5


def test_a_run_is_known_by_its_header_in_any_kind_of_table(tmp_path):
    packed = made(tmp_path / "elsewhere.csv.gz", ESSO, esso_rows())
    plain, table = tmp_path / "mine.csv", tmp_path / "mine.parquet"
    plain.write_bytes(b"\xef\xbb\xbf" + gzip.decompress(packed.read_bytes()))
    pl.read_csv(plain).write_parquet(table)
    for path in (packed, plain, table):
        assert particulars_for_log(path).name == "Esso Osaka, 3 m model"
    plain.write_text("x_m,y_m,psi_rad,sog_mps,cog_rad,pwm_l_us,pwm_r_us\n", encoding="utf-8")
    assert particulars_for_log(plain).name == "boat1 USV"
    for path in (tmp_path, tmp_path / "absent.csv", tmp_path / "absent.parquet"):
        assert known_ship(path) is None
    assert known_ship(recorded_runs()["boat1_usv_circle"]) is None
    for content in (b"", b"t_s,x_m\n", gzip.compress(b"t_s\n1\n"), b"\x1f\x8b\x08broken"):
        packed.write_bytes(content)
        assert known_ship(packed) is None


@pytest.mark.parametrize("kind", ["identify", "predict", "view", "benchmark"])
def test_each_command_refuses_a_log_without_particulars(tmp_path, kind):
    path = tmp_path / "mine.csv"
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    log.write(path)
    options = {
        "benchmark": ["--predictors", "persistence", "--out", str(tmp_path / "out"), "--jobs=1"],
    }
    first = [str(path)]
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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '[columns]\nt_s = "time"\n',
            r"\[columns\].*mapping is mine\.mapping\.toml.*--ship",
        ),
        ('[position]\nlatitude = "lat"\nlongitude = "lon"\n', r"\[position\].*mapping"),
        ("[tool.logger]\nrate = 3\n[a]\n", r"\[a\], \[tool\]: give it another name"),
    ],
)
def test_another_file_with_the_name_of_a_log_is_named(tmp_path, text, words):
    path = tmp_path / "mine.csv"
    path.write_text("t_s\n", encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ParticularsError, match=rf"mine\.toml: has the name of .*{words}"):
        particulars_for_log(path)


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
