"""Columns whose names mislead: yaw rates, two of a pair, degrees, swapped places, units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.channels import MEASUREMENTS
from twin.cli.main import app
from twin.integrity.log_check import check_log
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.marks import marks_of
from twin.logs.proposal.header_words import (
    AT_THE_COMPASS,
    NAMES,
    OVER_GROUND,
    is_shaft,
    is_turn_rate,
    means,
    other_side,
    sides_of,
)
from twin.logs.proposal.propose import propose

ROWS = 1200
Columns = dict[str, np.ndarray]
LATITUDE, LONGITUDE = 59.9, 10.7


def boat() -> Columns:
    """Return a boat with two fixed thrusters whose difference turns it to either side, at 5 Hz."""
    t = 0.2 * np.arange(ROWS)
    turn = np.sign(np.sin(0.21 * t) + 0.4 * np.sin(0.083 * t))
    left, right = 10.0 + 2.0 * turn, 10.0 - 2.0 * turn
    rate = np.zeros(ROWS)
    for k in range(1, ROWS):
        rate[k] = rate[k - 1] + 0.2 * (0.4 * turn[k] - rate[k - 1])
    psi = 0.5 + 0.2 * np.cumsum(rate)
    x, y = 0.2 * np.cumsum(1.5 * np.cos(psi)), 0.2 * np.cumsum(1.5 * np.sin(psi))
    return {
        "time_s": t,
        "lat": LATITUDE + x / 111_400.0,
        "lon": LONGITUDE + y / (111_400.0 * math.cos(math.radians(LATITUDE))),
        "heading_deg": np.degrees(psi) % 360.0,
        "yaw_rate_dps": np.degrees(rate),
        "rpm_left": 60.0 * left,
        "rpm_right": 60.0 * right,
    }


def renamed(columns: Columns, **names: str) -> Columns:
    return {names.get(name, name): values for name, values in columns.items()}


def write(path: Path, columns: Columns, more: Callable[[list[str]], list[str]] = list) -> Path:
    lines = [",".join(columns)]
    lines += [",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(more(lines)) + "\n", encoding="utf-8")
    return path


def mapped(path: Path) -> tuple[str, Log]:
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 0, result.output
    return " ".join(result.output.split()), Log.read(path)


@pytest.mark.parametrize(
    "name",
    [
        *("YawRate", "yaw_rate", "yaw_rate_dps", "Yaw rate [deg/s]", "yawspeed", "yaw_speed"),
        *("heading rate", "rate_of_turn", "ROT", "gyro_z", "psi_dot", "yaw [rad/s]", "turn_rate"),
    ],
)
def test_a_yaw_rate_is_no_heading(tmp_path: Path, name: str) -> None:
    columns = boat()
    del columns["heading_deg"]
    found = propose(write(tmp_path / "a.csv", renamed(columns, yaw_rate_dps=name)))
    lines = found.lines["columns"]
    assert "compass_rad" in found.missing
    assert not any(line.startswith("compass_rad") for line in lines)
    assert any(line.startswith("gyro_radps") and name in line for line in lines)


@pytest.mark.parametrize(
    "names",
    [
        *(
            ("steering_pwm", "throttle_pwm"),
            ("Steering", "Throttle"),
            ("rudder servo", "motor pwm"),
        ),
        *(("servo_helm", "esc"), ("delta_us", "pwm"), ("str_out", "thr_out"), ("Lenkung", "Gas")),
        *(("Ruderlage", "Gashebel"), ("timón", "acelerador"), ("barre", "moteur")),
        *(("pwm_timon", "pwm_acelerador"), ("timon_us", "hélice_us"), ("leme_pwm", "propulsor")),
        *(("gouvernail_pwm", "manette_pwm"), ("timone", "elica"), ("roer", "schroef")),
    ],
)
def test_pulses_of_steering_and_throttle_are_both(tmp_path: Path, names: tuple[str, str]) -> None:
    """Pulse widths become an angle and a shaft speed by what their columns move."""
    columns = boat()
    shaft, angle = columns.pop("rpm_left"), columns.pop("rpm_right")
    columns |= {names[0]: 1500.0 + 500.0 * np.sin(angle), names[1]: 1500.0 + 0.1 * shaft}
    text, log = mapped(write(tmp_path / "a.csv", columns))
    assert "left out" not in text and "2000 us is taken as 0.5 rad" in text
    assert log.cmd[:, 0] == pytest.approx(0.02 * 0.1 * shaft, abs=1e-6)
    assert log.cmd[:, 2] == pytest.approx(0.5 * np.sin(angle), abs=1e-6)


@pytest.mark.parametrize(
    ("names", "size"),
    [(("throttle", "turn"), 1.0), (("Throttle", "Turn"), 100.0), (("speed_cmd", "turn_cmd"), 1.0),
     (("cmd_vel.linear.x", "cmd_vel.angular.z"), 1.0)],
)  # fmt: skip
def test_a_turn_beside_a_throttle_is_a_command(
    tmp_path: Path, names: tuple[str, str], size: float
) -> None:
    columns = boat()
    rate = np.radians(columns["yaw_rate_dps"])
    throttle, turn = size * np.abs(np.sin(columns["time_s"] / 20.0)), size * np.tanh(3.0 * rate)
    kept = {name: columns[name] for name in ("time_s", "lat", "lon", "heading_deg")}
    found = propose(
        write(tmp_path / "a.csv", kept | dict(zip(names, (throttle, turn), strict=True)))
    )
    text = found.text("a.csv")
    assert "gyro_radps" not in text and f'n_rps = "{names[0]}"' in text
    assert re.search(rf'delta_rad = .*"{re.escape(names[1])}"', text)
    assert any(f"{names[1]}: deg, rad or a share" in each for each in found.questions)


@pytest.mark.parametrize("unit", [1.0, 180.0 / math.pi])
def test_a_turn_beside_two_shafts_is_a_yaw_rate_where_the_heading_says_so(
    tmp_path: Path, unit: float
) -> None:
    columns = boat()
    rate = unit * np.radians(columns.pop("yaw_rate_dps"))
    text = propose(write(tmp_path / "a.csv", columns | {"turn": rate})).text("a.csv")
    assert re.search(r'gyro_radps = .*"turn"', text) and "delta_rad = 0.0" in text
    text = propose(write(tmp_path / "a.csv", columns | {"turn": np.sign(rate)})).text("a.csv")
    assert "gyro_radps" not in text and "left out: turn" in text


@pytest.mark.parametrize(
    "names",
    [
        *(("propulsor_izq_pwm", "propulsor_der_pwm"), ("motor_izquierdo", "motor_derecho")),
        *(("elica_sx", "elica_dx"), ("schroef_bakboord", "schroef_stuurboord")),
        *(("propulsor esquerdo", "propulsor direito"), ("propell_babord", "propell_styrbord")),
    ],
)
def test_pulses_of_two_sides_are_left_and_right(tmp_path: Path, names: tuple[str, str]) -> None:
    columns = boat()
    left, right = columns.pop("rpm_left"), columns.pop("rpm_right")
    columns |= {names[1]: 1500.0 + 0.1 * right, names[0]: 1520.0 + 0.1 * left}
    assert (is_shaft(names[0]), sides_of(sorted(names))) == (True, names)
    text = propose(write(tmp_path / "a.csv", columns)).text("a.csv")
    assert re.search(rf'(?m)^n_left_rps = .*"{names[0]}"', text)
    assert re.search(rf'(?m)^n_right_rps = .*"{names[1]}"', text)


def skid_boat() -> Columns:
    """Return the boat with two columns that are mixed into its thrusters."""
    columns = boat()
    left, right = columns.pop("rpm_left") / 60.0, columns.pop("rpm_right") / 60.0
    columns["steering_pwm"] = 1500.0 + 25.0 * (left - right)
    columns["throttle_pwm"] = 1500.0 + 25.0 * (left + right)
    return columns


def test_throttle_and_steering_of_two_thrusters_are_mixed(tmp_path: Path) -> None:
    """What is asked can be pasted: left is throttle plus steering, right throttle minus it."""
    columns = skid_boat()
    columns["throttle_pwm"][-30:] = columns["steering_pwm"][-30:] = 0.0  # disarmed
    path = write(tmp_path / "a.csv", columns)
    text, log = mapped(path)
    assert np.ptp(log.cmd[:, 2]) > 0.0
    lines = re.findall(r"(throttle|steering) = (\{[^}]*\})", text)
    assert {name for name, _ in lines} == {"throttle", "steering"}
    mapping = tmp_path / "a.mapping.toml"
    kept = [line for line in mapping.read_text().split("\n") if line[:5] not in ("n_rps", "delta")]
    table = [f"{name} = {value}" for name, value in dict(lines).items()]
    mapping.write_text("\n".join([*kept, "[skid_steering]", *table]))
    log, truth = Log.read(path), boat()
    for side, name in enumerate(("rpm_left", "rpm_right")):
        assert log.cmd[:-30, side] == pytest.approx(truth[name][:-30] / 60.0, abs=1e-6)
        assert (log.cmd[-30:, side] == log.cmd[-31, side]).all()
    assert not log.cmd[:, 2:].any()
    found = check_log(path)
    assert not any(finding.severity == "error" for finding in found.findings)


def test_one_column_of_both_shafts_has_no_wrong_side(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", skid_boat())
    mapped(path)
    assert {finding.sensor for finding in check_log(path).findings}.isdisjoint(("left", "right"))


def test_a_boat_with_a_rudder_is_not_asked_for_two_thrusters(tmp_path: Path) -> None:
    columns = renamed(boat(), rpm_left="shaft_rpm", rpm_right="rudder_deg")
    columns["rudder_deg"] = 0.01 * columns["rudder_deg"]
    assert "skid" not in mapped(write(tmp_path / "a.csv", columns))[0]


PAIRS = [
    ("servo1", "servo3"),
    ("SERVO_OUTPUT_RAW.servo1_raw", "SERVO_OUTPUT_RAW.servo3_raw"),
    ("motor_a", "motor_b"),
    ("motorA", "motorB"),
    ("thrust1", "thrust2"),
    ("esc0", "esc1"),
    ("thruster_0_rpm", "thruster_1_rpm"),
]

SIDED = [
    *(("motor_bb", "motor_sb"), ("esc_lf", "esc_rt"), ("moteur_bâbord", "moteur_tribord")),
    *(("motore_sinistra", "motore_destra"), ("gauche", "droite"), ("thr_lh", "thr_rh")),
]


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("pair", SIDED)
def test_sides_in_other_words_are_known(
    tmp_path: Path, pair: tuple[str, str], reverse: bool
) -> None:
    columns = boat()
    both = dict(zip(pair, (columns.pop("rpm_left"), columns.pop("rpm_right")), strict=True))
    columns |= dict(reversed(both.items())) if reverse else both
    _, log = mapped(write(tmp_path / "a.csv", columns))
    truth = boat()
    for side, name in enumerate(("rpm_left", "rpm_right")):
        assert log.cmd[:, side] == pytest.approx(truth[name] / 60.0, abs=1e-3)


@pytest.mark.parametrize("names", [("Breite", "Länge"), ("latitud", "longitud")])
def test_places_in_other_languages_are_known(tmp_path: Path, names: tuple[str, str]) -> None:
    columns = renamed(boat(), lat=names[0], lon=names[1])
    _, log = mapped(write(tmp_path / "a.csv", columns))
    assert log.datum is not None and log.datum.latitude == pytest.approx(LATITUDE, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rudder", 12.0),
        ("rudder", 0.4),
        ("p", 2.0),
        ("gyro_x", 0.1),
        ("AccX", 0.3),
    ],
)
def test_a_unit_that_the_values_leave_open_is_asked(
    tmp_path: Path, name: str, values: float
) -> None:
    columns = boat()
    columns[name] = values * np.sin(0.1 * columns["time_s"])
    found = propose(write(tmp_path / "a.csv", columns))
    asked = rf"{re.escape(name)}: (deg|g or ).* taken"
    assert any(re.match(asked, text) for text in found.questions)


@pytest.mark.parametrize("name", ["Lenkung (%)", "steering_pct", "Timone [%]", "rudder percent"])
@pytest.mark.parametrize("full", [1.0, 100.0])
def test_steering_in_per_cent_is_a_share_of_full_helm(
    tmp_path: Path, name: str, full: float
) -> None:
    columns = boat()
    columns[name] = full * np.sin(0.1 * columns["time_s"])
    text, log = mapped(write(tmp_path / "a.csv", columns))
    assert f"{name}: {full:g} is taken as 0.5 rad" in text
    assert log.cmd[:, 2] == pytest.approx(0.5 * np.sin(0.1 * log.t), abs=1e-6)


@pytest.mark.parametrize(
    "name", ["Ruder (gr)", "Ruder_grad", "ror (grader)", "roer [graden]", "ster (stopnie)"]
)
def test_small_angles_in_degrees_of_other_languages_are_degrees(tmp_path: Path, name: str) -> None:
    columns = boat()
    columns[name] = np.sin(0.1 * columns["time_s"])
    _, log = mapped(write(tmp_path / "a.csv", columns))
    assert log.cmd[:, 2] == pytest.approx(np.radians(columns[name]), abs=1e-6)


@pytest.mark.parametrize("name", ["TWS", "TWD", "AWS", "AWA"])
def test_marks_of_wind_are_no_values(tmp_path: Path, name: str) -> None:
    columns = boat()
    columns[name] = np.where(np.arange(ROWS) % 9, 5.0 + np.sin(columns["time_s"]), -9999.0)
    found = propose(write(tmp_path / "a.csv", columns))
    assert any("empty = [-9999]" in line for line in found.lines["columns"])


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("pair", PAIRS)
def test_neither_of_two_like_columns_is_dropped(
    tmp_path: Path, pair: tuple[str, str], reverse: bool
) -> None:
    assert other_side(pair[0], [pair[1]]) == other_side(pair[1], [pair[0]]) == pair
    columns = boat()
    left, right = columns.pop("rpm_left"), columns.pop("rpm_right")
    if "servo" in pair[0]:
        left, right = (1500.0 + each for each in (left / 2.0, right / 2.0))
    both = {pair[0]: left, pair[1]: right}
    columns |= dict(reversed(both.items())) if reverse else both
    output, log = mapped(write(tmp_path / "a.csv", columns))
    assert f"{pair[0]}, {pair[1]}: taken as left and right" in output
    scale = 0.02 * 30.0 if "servo" in pair[0] else 1.0
    truth = boat()
    np.testing.assert_allclose(log.cmd[:, 0], scale * truth["rpm_left"] / 60.0, atol=1e-3)
    np.testing.assert_allclose(log.cmd[:, 1], scale * truth["rpm_right"] / 60.0, atol=1e-3)


def test_unlike_commands_are_asked(tmp_path: Path) -> None:
    columns = renamed(boat(), rpm_left="throttle", rpm_right="shaft_rpm")
    output, _ = mapped(write(tmp_path / "a.csv", columns))
    assert "n_rps is taken from throttle alone" in output


def test_shafts_tell_swapped_places_from_a_heading_from_east(tmp_path: Path) -> None:
    swapped = renamed(boat(), lat="lon", lon="lat")
    output, log = mapped(write(tmp_path / "a.csv", swapped))
    assert "longitude are swapped, and they are taken so" in output
    text = (tmp_path / "a.mapping.toml").read_text()
    assert "enu" not in text and "scale = -1.0" not in text and 'latitude = "lon"' in text
    assert log.datum is not None and log.datum.latitude == pytest.approx(LATITUDE, abs=1e-3)
    east = boat()
    east["heading_deg"] = (90.0 - east["heading_deg"]) % 360.0
    output, _ = mapped(write(tmp_path / "b.csv", east))
    text = (tmp_path / "b.mapping.toml").read_text()
    assert 'frame = "enu"' in text and 'latitude = "lat"' in text


def test_positions_in_degrees_are_no_metres(tmp_path: Path) -> None:
    columns = renamed(boat(), lat="gps_x_m", lon="gps_y_m")
    output, log = mapped(write(tmp_path / "a.csv", columns))
    assert "gps_x_m, gps_y_m: degrees of latitude and longitude" in output
    assert np.ptp(log.z[:, 0]) > 10.0


def test_a_row_of_units_is_named(tmp_path: Path) -> None:
    units = ["s", "deg", "deg", "deg", "deg/s", "rpm", "rpm"]
    path = write(tmp_path / "a.csv", boat(), lambda lines: [lines[0], ",".join(units), *lines[1:]])
    with pytest.raises(LogError, match=r"line 2 holds units.*remove this line"):
        propose(path)
    path.with_name("a.mapping.toml").write_text('[columns]\nt_s = "time_s"\nn_rps = "rpm_left"\n')
    with pytest.raises(LogError, match=r"line 2 holds units.*remove this line"):
        Log.read(path)


def test_a_column_that_stands_twice_is_named(tmp_path: Path) -> None:
    def doubled(lines: list[str]) -> list[str]:
        return [f"{line},{line.split(',')[1]}" for line in lines]

    with pytest.raises(LogError, match="column lat stands twice in line 1"):
        propose(write(tmp_path / "a.csv", boat(), doubled))


@pytest.mark.parametrize("cell", ["NaN", "-", "--", "", "N/A"])
def test_cells_without_a_value_hide_no_column(tmp_path: Path, cell: str) -> None:
    def holes(lines: list[str]) -> list[str]:
        cells = [line.split(",") for line in lines]
        for row in cells[3::4]:
            row[1] = row[2] = cell
        return [",".join(row) for row in cells]

    _, log = mapped(write(tmp_path / "a.csv", boat(), holes))
    assert np.isfinite(log.z[:, 0]).sum() == ROWS - len(range(2, ROWS, 4))


HEMISPHERES = {
    # signs of latitude and longitude, and what the columns say
    "north and west": (1.0, -1.0, "N", "W"),
    "south and east": (-1.0, 1.0, "South", "east"),
    "south and west": (-1.0, -1.0, "s", "w"),
}


CELLS: list[Callable[[float, str], str]] = [
    lambda size, side: f"{size:.9f} {side[0]}",
    lambda size, side: f"{side}{size:.9f}",
    lambda size, side: f"{size:.9f}°{side}",
    lambda size, side: f"{int(size)}° {size % 1.0 * 60.0:.8f}' {side}",
    lambda size, side: f"{int(size) - 1} 60 {size % 1.0 * 3600.0:.6f} {side}",
    lambda size, side: f"{100 * int(size) + size % 1.0 * 60.0:.8f}{side[0]}",
    lambda size, side: f"{int(size) - 1}-60-{size % 1.0 * 3600.0:.6f}{side}",
    lambda size, side: f"{side[0]} {int(size)}:{size % 1.0 * 60.0:.8f}",
]


@pytest.mark.parametrize("name", HEMISPHERES)
@pytest.mark.parametrize("cell", CELLS)
def test_hemispheres_in_the_cells_are_read(
    tmp_path: Path, name: str, cell: Callable[[float, str], str]
) -> None:
    north, east, *letters = HEMISPHERES[name]
    lines = ["time,lat,lon,heading_deg,n_left_rps,n_right_rps"]
    for k in range(200):
        lat, lon = abs(north * 41.5 + 1e-5 * k), abs(east * 70.6 + 2e-5 * k)
        place = f"{cell(lat, letters[0])},{cell(lon, letters[1])}"
        lines.append(f"{0.2 * k:.1f},{place},{60 + k % 5},5,{k % 7}")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert CliRunner().invoke(app, ["mapping", str(path)]).exit_code == 0
    log = Log.read(path)
    assert log.datum is not None
    place = log.datum.latitude, log.datum.longitude
    assert place == pytest.approx((north * 41.5, east * 70.6), abs=1e-8)
    assert log.z[-1, 0] > 200.0 and log.z[-1, 1] > 300.0


@pytest.mark.parametrize("name", HEMISPHERES)
@pytest.mark.parametrize("unsigned", [True, False])
def test_columns_of_hemispheres_are_read(tmp_path: Path, name: str, unsigned: bool) -> None:
    north, east, *letters = HEMISPHERES[name]
    lines = ["time,LATITUDE,N/S,LONGITUDE,E/W,heading_deg,n_left_rps,n_right_rps"]
    for k in range(200):
        lat, lon = north * 41.5 + 1e-5 * k, east * 70.6 + 2e-5 * k
        if unsigned:
            lat, lon = abs(lat), abs(lon)
        lines.append(
            f"{0.2 * k:.1f},{lat:.7f},{letters[0]},{lon:.7f},{letters[1]},{60 + k % 5},5,{k % 7}"
        )
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines) + "\n")
    assert CliRunner().invoke(app, ["mapping", str(path)]).exit_code == 0
    assert 'hemisphere = "N/S"' in (tmp_path / "a.mapping.toml").read_text()
    log = Log.read(path)
    assert log.datum is not None
    assert (log.datum.latitude, log.datum.longitude) == (north * 41.5, east * 70.6)
    assert log.z[-1, 0] > 200.0 and log.z[-1, 1] > 300.0


def test_a_mapping_scales_longitude_alone(tmp_path: Path) -> None:
    rows = [f"{0.2 * k:.1f},{41.5 + 1e-5 * k:.7f},{70.6 - 1e-5 * k:.7f},{k % 9}" for k in range(50)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t_s,lat,lon,compass_deg", *rows]) + "\n")
    mapping = tmp_path / "a.mapping.toml"
    text = '[columns]\nn_rps = 1.0\ndelta_rad = 0.0\n[position]\nlatitude = "lat"\nlongitude = '
    mapping.write_text(text + '{ from = "lon", scale = -1.0 }\n')
    log = Log.read(path)
    assert log.datum is not None and log.datum.longitude == -70.6
    assert log.z[-1, 1] > 30.0
    mapping.write_text(text + '{ from = "lon", unit = "deg" }\n')
    with pytest.raises(LogError, match="unknown key 'unit'"):
        Log.read(path)


# --- numbers that are no values, and units that neither name nor values tell ----------------------


def foreign(path: Path, **cells: Callable[[int], str]) -> Path:
    """Write 600 rows of a boat in circles at 5 Hz, with columns in place of others or beside."""
    lines = []
    for k in range(600):
        course = 0.01 * k
        row = {
            "time": f"{0.2 * k:.1f}",
            "lat": f"{59.9 + 40.0 * math.sin(course) / 111_400.0:.8f}",
            "lon": f"{10.7 - 40.0 * math.cos(course) / 55_900.0:.8f}",
            "sog_kn": f"{2.0 * 3600.0 / 1852.0 + 1e-3 * (k % 9):.3f}",
            "cog": f"{math.degrees(course) % 360.0:.1f}",
            "heading_deg": f"{math.degrees(course) % 360.0:.1f}",
            "pwm_left": str(1700 + k % 7),
            "pwm_right": str(1600 + k % 5),
        }
        row |= {name: of(k) for name, of in cells.items()}
        lines.append(",".join(row.values()))
    path.write_text("\n".join([",".join(row), *lines]) + "\n")
    return path


def proposed(path: Path) -> tuple[str, Log]:
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 0, result.output
    return " ".join(result.output.split()), Log.read(path)


@pytest.mark.parametrize("mark", ["0", "65535", "-1"])
@pytest.mark.parametrize("rows", [range(60), range(200, 260), range(5, 600, 50)])
def test_pulses_of_no_width_are_no_commands(tmp_path: Path, mark: str, rows: range) -> None:
    path = foreign(tmp_path / "a.csv", pwm_left=lambda k: mark if k in rows else str(1700 + k % 7))
    said, log = proposed(path)
    assert f"empty = [{mark}]" in said and "pulse width" in said
    assert log.cmd[:, 0].min() >= 0.0 and log.cmd[:, 0].max() < 4.2
    first = 0.0 if rows[0] == 0 else 4.0
    assert log.cmd[rows[0], 0] == pytest.approx(first, abs=0.2)


@pytest.mark.parametrize("mark", ["65535", "-32768", "9999", "16383.75"])
def test_a_shaft_speed_that_is_not_available_is_no_command(tmp_path: Path, mark: str) -> None:
    def turns(k: int) -> str:
        return mark if k % 50 == 5 else f"{800 + k % 7}"

    path = foreign(tmp_path / "a.csv", pwm_left=turns, pwm_right=turns)
    path.write_text(path.read_text().replace("pwm_left,pwm_right", "port_rpm,stbd_rpm"))
    said, log = proposed(path)
    assert f"empty = [{mark}]" in said
    assert log.cmd[:, :2].min() >= 13.0 and log.cmd[:, :2].max() < 13.5


@pytest.mark.parametrize(
    ("course", "heading", "rate"),
    [
        ("Rumbo sobre el fondo", "Rumbo aguja", "Velocidad de giro (grados/s)"),
        ("cap fond", "cap compas", "Vitesse de lacet (deg/s)"),
        ("Kurs über Grund", "Kompasskurs", "Drehrate (°/s)"),
        ("grondkoers", "voorliggende koers", "giersnelheid"),
        ("koers over grond", "kompas", "draaisnelheid"),
        ("Rotta", "Bussola", "Velocità angolare (°/s)"),
        ("kurs nad dnem", "kurs kompasowy", "prędkość kątowa"),
    ],
)
def test_course_and_heading_are_told_apart_in_five_languages(
    course: str, heading: str, rate: str
) -> None:
    assert means(heading, NAMES["heading"]) and not means(heading, OVER_GROUND)
    assert means(course, NAMES["course"]) and not means(course, AT_THE_COMPASS)
    assert is_turn_rate(rate) or means(rate, NAMES["gyro"])


@pytest.mark.parametrize("mark", ["0", "65535"])
def test_a_pulse_of_no_width_is_named_where_a_mapping_leaves_it_out(
    tmp_path: Path, mark: str
) -> None:
    path = foreign(tmp_path / "a.csv", pwm_left=lambda k: mark if k == 300 else "1700")
    mapping = path.with_suffix(".mapping.toml")
    _, log = proposed(path)
    mapping.write_text(mapping.read_text().replace(f", empty = [{mark}]", ""))
    named = Log.read(path)
    assert any(f"pwm_left: 1 of 600 pulses are {mark} us" in note for note in named.notes)
    assert np.array_equal(named.cmd, log.cmd)


@pytest.mark.parametrize(
    ("mark", "rows"),
    [
        (511.0, [300]),
        (999.0, [300]),
        *((m, [*range(5, 600, 30)]) for m in (511.0, -1.0, 360.0, 0.0)),
    ],
)
def test_marks_of_a_heading_in_a_native_log_are_one_finding(
    tmp_path: Path, mark: float, rows: list[int]
) -> None:
    lines = ["t_s,n_rps,delta_rad,gps_x_m,gps_y_m,compass_deg"]
    for k in range(600):
        course = math.radians(80.0) + 0.4 * math.sin(0.02 * k)
        heading = mark if k in rows else math.degrees(course)
        north, east = 0.4 * k * math.cos(1.4), 0.4 * k * math.sin(1.4)
        lines.append(f"{0.2 * k:.1f},5,0,{north:.3f},{east:.3f},{heading:.6f}")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    log, check = Log.read(path), check_log(path)
    assert np.flatnonzero(np.isnan(log.z[:, 4])).tolist() == rows
    (found,) = (each for each in check.findings if each.sensor == "compass_rad")
    assert found.code == "mark" and f"({mark:g} deg)" in found.what
    assert found.what.startswith(f"compass_deg: {len(rows)} of 600")
    assert any(f"({mark:g} degrees)" in note for note in log.notes)


UNKNOWN = {
    "heading 511": ("heading_deg", "511.0"),
    "heading 999": ("heading_deg", "999"),
    "heading 655.35": ("heading_deg", "655.35"),
    "course -1": ("cog", "-1"),
    "speed 655.35": ("sog_kn", "655.35"),
    "speed 102.3": ("sog_kn", "102.3"),
    "course 360": ("cog", "360.0"),
    "speed -999": ("sog_kn", "-999"),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_numbers_of_what_is_not_known_are_no_values(tmp_path: Path, name: str) -> None:
    column, mark = UNKNOWN[name]
    usual = foreign(tmp_path / "b.csv").read_text().splitlines()
    place = usual[0].split(",").index(column)
    cells = [line.split(",")[place] for line in usual[1:]]
    of = {column: lambda k: mark if 100 <= k < 110 or k in (300, 420) else cells[k]}
    _, log = proposed(foreign(tmp_path / "a.csv", **of))
    values = log.z[:, 4] if column == "heading_deg" else np.hypot(log.z[:, 2], log.z[:, 3])
    assert np.isnan(values).sum() >= 12 and not np.isfinite(values[100:110]).any()
    assert np.nanmax(values) < 2.0 * math.pi


@pytest.mark.parametrize("parts", [1, 10, 100])
def test_parts_of_degrees_are_told_by_the_track(tmp_path: Path, parts: int) -> None:
    tenths = foreign(
        tmp_path / "a.csv",
        heading_deg=lambda k: f"{parts * (math.degrees(0.01 * k) % 360.0):.0f}",
    )
    tenths.write_text(tenths.read_text().replace("heading_deg", "heading", 1))
    _, log = proposed(tenths)
    assert np.nanmax(log.z[:, 4]) == pytest.approx(6.0, abs=0.02)


def test_places_in_radians_and_places_that_are_none_are_asked_or_named(tmp_path: Path) -> None:
    _, usual = proposed(foreign(tmp_path / "a.csv"))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    places = [[math.radians(float(x)) for x in line.split(",")[1:3]] for line in lines[1:]]
    of = {"lat": lambda k: f"{places[k][0]:.12f}", "lon": lambda k: f"{places[k][1]:.12f}"}
    said, log = proposed(foreign(tmp_path / "b.csv", **of))
    assert "lat, lon: radians" in said
    assert log.z[:, :2] == pytest.approx(usual.z[:, :2], abs=0.01, nan_ok=True)
    cells = {
        name: [line.split(",")[j] for line in lines[1:]] for j, name in ((1, "lat"), (2, "lon"))
    }
    of = {
        "lat": lambda k: "91" if k == 7 else cells["lat"][k],
        "lon": lambda k: "181" if k == 7 else cells["lon"][k],
    }
    _, log = proposed(foreign(tmp_path / "c.csv", **of))
    assert np.isnan(log.z[7, 0]) and any("are (91, 181), as of" in note for note in log.notes)


def test_x_to_the_east_is_told_by_the_course(tmp_path: Path) -> None:
    columns = boat()
    psi = np.radians(columns["heading_deg"])
    north, east = (0.2 * np.cumsum(1.5 * f(psi)) for f in (np.cos, np.sin))
    del columns["lat"], columns["lon"]
    columns |= {"sog_mps": np.full(ROWS, 1.5), "cog": columns["heading_deg"]}
    found = propose(write(tmp_path / "a.csv", columns | {"x": east, "y": north}))
    assert 'gps_x_m = "y"' in found.text("a") and "enu" not in found.text("a")
    assert any("x is east and y north" in each for each in found.questions)
    found = propose(write(tmp_path / "a.csv", columns | {"x": north, "y": east}))
    assert 'gps_x_m = "x"' in found.text("a")


def test_revolutions_a_minute_are_no_pulses_and_a_motor_without_a_neutral_is_asked(
    tmp_path: Path,
) -> None:
    def idles(k: int) -> str:
        return "0" if k % 100 < 50 else str(850 + k)

    named = foreign(tmp_path / "a.csv", pwm_left=idles, pwm_right=idles)
    text = named.read_text()
    named.write_text(text.replace("pwm_left", "rpm_left", 1).replace("pwm_right", "rpm_right", 1))
    said, log = proposed(named)
    assert "empty" not in said and log.cmd[:, 0].max() == pytest.approx((850 + 599) / 60.0)
    said, _ = proposed(foreign(tmp_path / "b.csv"))
    assert "pwm_left: pulse widths, and stopped at 1500 us?" in said


LANGUAGES = [
    "Zeit (s);Breite (°);Länge (°);Fahrt (kn);Kurs (°);Kompasskurs (°);Drehzahl links (1/min);x",
    "Temps (s);Latitude;Longitude;Vitesse (nds);Route (deg);Cap (deg);Régime gauche (tr/min);x",
    "Tid;Breddegrad;Lengdegrad;Fart (knop);Kurs;Heading;Turtall babord;x",
    "time|lat|lon|speed (kn)|course|heading_deg|rpm port|x",
    "Czas;Szerokość (°);Długość;Prędkość (w);Kurs nad dnem;Kurs kompasowy (gr);Obroty lewy;x",
    "Ora;Latitudine;Longitudine;Velocità (nodi);Rotta;Prua (gradi);Giri/min;x",
    "Tid;Bredde;Længde;Fart (knob);Kurs over grund;Styrekurs (grader);Omdr/min bagbord;x",
    "Tijd;Breedte;Lengte;Snelheid (knopen);Grondkoers;Voorliggende koers;Toeren bakboord;x",
]


@pytest.mark.parametrize("head", LANGUAGES)
def test_headers_of_other_languages_are_read(tmp_path: Path, head: str) -> None:
    mark = "|" if "|" in head else ";"
    lines = foreign(tmp_path / "a.csv").read_text().splitlines()[1:]
    path = tmp_path / "b.csv"
    path.write_text("\n".join([head, *(line.replace(",", mark) for line in lines)]), "utf-8")
    text = propose(path).text("b.csv")
    names = head.split(mark)
    for key, name in (("latitude", 1), ("longitude", 2), ("speed", 3), ("course", 4)):
        assert re.search(rf'{key} = .*"{re.escape(names[name])}"', text)
    assert re.search(rf'compass_rad = .*"{re.escape(names[5])}"', text)
    assert re.search(rf'n_(left_)?rps = .*"{re.escape(names[6])}"', text)


def test_a_heading_of_360_is_north(tmp_path: Path) -> None:
    of = {name: lambda k: f"{(0.5 * k) % 360.0 or 360.0:.1f}" for name in ("heading_deg", "cog")}
    said, log = proposed(foreign(tmp_path / "a.csv", **of))
    assert "empty" not in said and np.isfinite(log.z[:, 4]).all()


@pytest.mark.parametrize(("heading", "unit"), [("heading_deg", math.pi / 180.0), ("psi", 1.0)])
def test_the_unit_of_small_angles_is_that_of_the_heading_and_asked(
    tmp_path: Path, heading: str, unit: float
) -> None:
    of = {
        heading: lambda k: f"{(0.01 * k) % (2.0 * math.pi) / unit:.4f}",
        "roll": lambda k: f"{0.5 * math.sin(0.3 * k):.3f}",
        "pitch": lambda k: f"{0.4 * math.sin(0.2 * k):.3f}",
    }
    path = foreign(tmp_path / "a.csv", **of)
    if heading == "psi":
        path.write_text(path.read_text().replace("heading_deg", "remark"))
    said, log = proposed(path)
    assert "roll: deg or rad?" in said and "pitch: deg or rad?" in said
    assert np.nanmax(np.abs(log.z[:, MEASUREMENTS.index("ahrs_roll_rad")])) == pytest.approx(
        0.5 * unit, rel=0.02
    )


def with_places(path: Path, lat: Callable[[int], str], side: str, heading: str = "hdg") -> Path:
    """Write a log of degrees and minutes, with a column of hemispheres."""
    lines = [f"time,lat,lon,E/W,{heading},n_left_rps,n_right_rps"]
    lines += [
        f"{0.2 * k:.1f},{lat(k)},{1008.0 + 1e-4 * k:.6f},{side},{60 + k % 200},5,{k % 7}"
        for k in range(200)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("odd", ["9959.000000", "5475.000000"])
def test_one_odd_latitude_does_not_decide_the_unit(tmp_path: Path, odd: str) -> None:
    path = with_places(
        tmp_path / "a.csv", lambda k: odd if k == 50 else f"{5419.0 + 1e-4 * k:.6f}", "E"
    )
    said = propose(path).text("a.csv")
    assert (
        'unit = "ddmm"' in said and f"1 cell(s) are no degrees and minutes (row 51: {odd})" in said
    )
    assert CliRunner().invoke(app, ["mapping", str(path)]).exit_code == 0
    log = Log.read(path)
    assert np.nanmax(np.abs(log.z[:, 0])) < 100.0 and np.isnan(log.z[50, 0])


def test_an_east_of_german_that_is_a_west_of_french_is_asked(tmp_path: Path) -> None:
    path = with_places(tmp_path / "a.csv", lambda k: f"{5419.0 + 1e-4 * k:.6f}", "O")
    said = propose(path).text("a.csv")
    assert '# ? E/W: is "O" east, as in German, or west, as in French?' in said
    assert "left out" not in said


@pytest.mark.parametrize(
    ("heading", "asked"),
    [
        *((name, True) for name in ("heading_mag", "heading_magnetic", "Heading (mag)")),
        *(("magnetic heading", True), ("heading_true", False), ("hdg", False)),
    ],
)
def test_a_magnetic_heading_is_asked_for_its_variation(
    tmp_path: Path, heading: str, asked: bool
) -> None:
    path = with_places(tmp_path / "a.csv", lambda k: f"{5419.0 + 1e-4 * k:.6f}", "E", heading)
    said = propose(path).text("a.csv")
    assert (f"# ? {heading}: from magnetic north?" in said) == asked


@pytest.mark.parametrize("times", [2, 5, 40])
def test_a_rare_mark_of_a_speed_is_no_value_and_noise_at_rest_is_one(
    tmp_path: Path, times: int
) -> None:
    usual = foreign(tmp_path / "b.csv").read_text().splitlines()
    place = usual[0].split(",").index("sog_kn")
    cells = [line.split(",")[place] for line in usual[1:]]
    rows = range(100, 100 + 3 * times, 3)
    cells[7] = "-0.1"
    file = foreign(tmp_path / "a.csv", sog_kn=lambda k: "1273.9" if k in rows else cells[k])
    _, log = proposed(file)
    lost = np.flatnonzero(np.isnan(log.z[:, 2]))
    assert list(lost) == list(rows)


@pytest.mark.parametrize("marks", [{511.0: 40}, {999.0: 9}, {511.0: 5, 999.0: 30}])
def test_marks_of_a_heading_are_found_beside_one_that_is_rounded_to_a_turn(marks) -> None:
    rng = np.random.default_rng(0)
    heading = np.round(np.cumsum(rng.normal(0.5, 0.3, 3000)) % 360.0, 2)
    heading[7] = 360.0
    at = iter(rng.permutation(np.arange(10, 3000)).tolist())
    for mark, times in marks.items():
        heading[[next(at) for _ in range(times)]] = mark
    assert marks_of(heading, 360.0) == sorted(marks)
    assert marks_of(np.unwrap(heading, period=360.0) * 3.0, 360.0) == []
