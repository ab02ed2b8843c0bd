"""Logs of autopilots: what is taken as a measurement, what the outputs stand for, damage."""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.twin.logs.autopilot_logs import (
    EPOCH,
    FORMATS,
    HOME,
    RUDDER,
    SKID,
    close,
    dataflash,
    description,
    message,
    telemetry,
    written,
)
from tests.twin.logs.foreign import COLUMN, run
from twin.channels import MOTION_AT
from twin.cli.main import app
from twin.logs.autopilot.dataflash import DataFlash
from twin.logs.autopilot.outputs import Output
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.sim.recorded import particulars_for_log

RUN = run(120)
KINDS = {"BIN": dataflash, "tlog": telemetry}

TOLERANCES = {"gps_x_m": 0.02, "gps_y_m": 0.02, "gps_vx_mps": 0.02, "gps_vy_mps": 0.02}
TOLERANCES |= {"compass_rad": 1e-5, "gyro_radps": 1e-5, "accel_x_mps2": 0.006, "gps_z_m": 0.006}
TOLERANCES |= {"ahrs_roll_rad": 1e-5, "gyro_y_radps": 1e-5, "accel_z_mps2": 0.006}


def wrapped(angles: np.ndarray) -> np.ndarray:
    return np.remainder(angles + math.pi, 2.0 * math.pi) - math.pi


def moved(log: Log, north: float, east: float) -> np.ndarray:
    z = log.z.copy()
    z[:, 0] += north
    z[:, 1] += east
    return z


def refused(path: Path, **options: Path) -> str:
    with pytest.raises(LogError) as caught:
        Log.read(path, **options)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message
    return message


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("parameters", [SKID, RUDDER], ids=["skid", "rudder"])
def test_a_run_reads_back(kind, parameters, tmp_path):
    pytest.importorskip("pymavlink")
    path = written(tmp_path / f"a.{kind}", KINDS[kind](RUN, parameters))
    log = Log.read(path)
    assert len(log) == len(RUN)
    assert np.allclose(log.t, RUN.t, atol=2e-3)
    first = RUN.z[0]
    z = moved(RUN, -first[0], -first[1])  # the first fix is the origin
    for name, tolerance in TOLERANCES.items():
        one, two = log.z[:, COLUMN[name]], z[:, COLUMN[name]]
        assert close(one, one + wrapped(one - two), tolerance), name
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH, abs=0.02)
    assert (log.datum.latitude, log.datum.longitude) == pytest.approx(HOME, abs=1e-4)
    right = RUN.cmd[2:-1, 1] / 20.0
    assert np.allclose(log.cmd[2:-1, 1], right, atol=0.002)
    if parameters is RUDDER:
        assert np.allclose(log.cmd[2:-1, 0], right, atol=0.002)  # one throttle for both sides
        assert np.allclose(log.cmd[2:-1, 2:], RUN.cmd[2:-1, 2:], atol=0.002)
    else:
        assert np.allclose(log.cmd[2:-1, 0], RUN.cmd[2:-1, 0] / 20.0, atol=0.002)
        assert not log.cmd[:, 2:].any()


@pytest.mark.parametrize("kind", KINDS)
def test_without_gps_the_autopilot_own_estimate_is_no_measurement(kind, tmp_path):
    pytest.importorskip("pymavlink")
    z = RUN.z.copy()
    z[40:90, :4] = np.nan
    path = written(tmp_path / f"a.{kind}", KINDS[kind](dataclasses.replace(RUN, z=z), SKID))
    log = Log.read(path)
    lost = (log.t > RUN.t[40] - 0.05) & (log.t < RUN.t[89] + 0.05)
    assert np.isnan(log.z[lost, :4]).all()
    assert np.isfinite(log.z[~lost, 0]).sum() > 60
    assert any("not the autopilot's estimate" in note for note in log.notes)


def test_a_log_without_any_fix_is_refused(tmp_path):
    path = written(tmp_path / "a.BIN", dataflash(RUN, SKID, status=1))
    assert "never had a fix" in refused(path)


def test_telemetry_without_a_receiver_says_that_its_position_is_an_estimate(tmp_path):
    pytest.importorskip("pymavlink")
    log = Log.read(written(tmp_path / "a.tlog", telemetry(RUN, SKID, receiver=False)))
    assert any("the autopilot's own estimate" in note for note in log.notes)


def test_dataflash_fields_equal_those_of_pymavlink(tmp_path):
    reader = pytest.importorskip("pymavlink.DFReader")
    path = written(tmp_path / "a.BIN", dataflash(RUN, SKID))
    ours = DataFlash(path, tuple(FORMATS)).messages
    theirs: dict[str, list] = {}
    other = reader.DFReader_binary(str(path))
    try:
        while (item := other.recv_match(type=list(ours), strict=True)) is not None:
            theirs.setdefault(item.get_type(), []).append(item)
    finally:
        other.close()
    assert {"GPS", "ATT", "IMU", "RCOU", "PARM"} <= set(ours) & set(theirs)
    for name, items in theirs.items():
        numbers = [field for field in items[0].get_fieldnames() if field in ours[name]]
        assert numbers
        for field in numbers:
            expected = [float(getattr(item, field)) for item in items]
            assert np.allclose(ours[name][field], expected, rtol=1e-12), (name, field)


@pytest.mark.parametrize("change", ["cut", "flip", "insert"])
def test_damage_costs_the_messages_that_it_hits(change, tmp_path):
    whole = dataflash(RUN, SKID)
    middle = whole.index(message("RCOU", 0, 0, 0, 0, 0)[:3], len(whole) // 2) + 2
    damaged = {
        "cut": whole[:middle] + whole[middle + 5 :],
        "flip": whole[:middle] + b"\xff" + whole[middle + 1 :],
        "insert": whole[:middle] + b"\xa3\x95\x41\x00\xa3" + whole[middle:],
    }
    path = written(tmp_path / "a.BIN", damaged[change])
    log = Log.read(path)
    assert len(RUN) - 3 <= len(log) <= len(RUN) + 1
    assert log.t[-1] == pytest.approx(RUN.t[-1], abs=0.01)
    assert any("bytes of damaged or torn messages" in note for note in log.notes)


def test_a_format_of_no_length_is_left_out(tmp_path):
    """The reader of pymavlink runs for ever on it."""
    void = description("POS", length=0) + b"\xa3\x95\x45"
    whole = dataflash(RUN, SKID).replace(description("POS"), void)
    log = Log.read(written(tmp_path / "a.BIN", whole))
    assert len(log) == len(RUN)


@pytest.mark.parametrize(
    ("output", "widths", "shares"),
    [
        (Output(1), [1100, 1500, 1700, 1900], [-1.0, 0.0, 0.5, 1.0]),
        (Output(1, 1000.0, 1400.0, 2000.0), [1000, 1200, 1700, 2000], [-1.0, -0.5, 0.5, 1.0]),
        (Output(1, reversed=True), [1100, 1600, 1900], [1.0, -0.25, -1.0]),
        (Output(1, 1000.0, 1000.0, 2000.0), [900, 1000, 1500], [0.0, 0.0, 0.5]),
        (Output(1), [0, 65535], [math.nan, math.nan]),
    ],
)
def test_pulse_widths_are_shares_by_the_limits_of_the_output(output, widths, shares):
    found = output.share(np.array(widths, dtype=float))
    assert np.allclose(found, shares, equal_nan=True)


def test_a_throttle_without_pulses_stands_still(tmp_path):
    whole = dataflash(RUN, SKID)
    start = message("RCOU", 0, 0, 0, 0, 0)[:3]
    at = whole.index(start, len(whole) // 2)
    size = len(message("RCOU", 0, 0, 0, 0, 0))
    silent = whole[: at + 11] + bytes(8) + whole[at + size :]
    log = Log.read(written(tmp_path / "a.BIN", silent))
    assert (log.cmd[2:, 0] == 0.0).sum() == 1


def test_mapping_names_outputs_and_full_values(tmp_path):
    path = written(tmp_path / "a.BIN", dataflash(RUN, {"CRUISE_SPEED": 2.0}))
    assert "SERVOx_FUNCTION" in refused(path)
    mapping = tmp_path / "m.toml"
    mapping.write_text("[servos]\nleft = 1\nright = 3\nshaft_speed = 20.0\n[rows]\nstart_s = 5.0\n")
    log = Log.read(path, mapping)
    assert 65 <= len(log) <= 71
    later = np.interp(log.t, RUN.t, np.arange(len(RUN))).round().astype(int)
    assert np.allclose(log.cmd[2:-1, :2], RUN.cmd[later][2:-1, :2], atol=0.04)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[servos]\nleft = 1.5\n", "output from 1 to 32"),
        ("[servos]\nangle_deg = 0\n", "above 0, up to 180"),
        ("[servos]\nrudder = 2\n", "unknown key 'rudder'"),
        ('[columns]\ngyro_radps = "GyrZ"\n', "only [rows] and [servos]"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused(text, complaint, tmp_path):
    path = written(tmp_path / "a.BIN", dataflash(RUN, SKID))
    mapping = tmp_path / "m.toml"
    mapping.write_text(text)
    with pytest.raises(LogError) as caught:
        Log.read(path, mapping)
    assert complaint in str(caught.value) and str(mapping) in str(caught.value)


def test_servos_of_a_mapping_are_for_autopilots_only(tmp_path):
    RUN.write(tmp_path / "a.csv")
    (tmp_path / "a.mapping.toml").write_text("[servos]\nleft = 1\n")
    with pytest.raises(LogError, match=r"\[servos\] is for logs of an autopilot"):
        Log.read(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"SERVO1_FUNCTION": 1.0}, "no SERVOx_FUNCTION is 70"),
        ({"SERVO1_FUNCTION": 33.0}, "moves sideways"),
        ({**SKID, "SERVO3_TRIM": 2000.0}, "must rise"),
        ({**SKID, "SERVO3_FUNCTION": 0.0, "SERVO9_FUNCTION": 74.0}, "servo output 9"),
    ],
)
def test_outputs_that_drive_no_boat_are_refused(parameters, complaint, tmp_path):
    assert complaint in refused(written(tmp_path / "a.BIN", dataflash(RUN, parameters)))


def test_telemetry_without_pymavlink_says_how_to_install_it(tmp_path, monkeypatch):
    path = written(tmp_path / "a.tlog", b"\0" * 100)
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.common", None)
    assert "pip install 'usv-twin[view]'" in refused(path)


def test_telemetry_after_a_restart_reads_the_longest_piece(tmp_path):
    pytest.importorskip("pymavlink")
    short = telemetry(run(30), SKID, boot=500.0)
    log = Log.read(written(tmp_path / "a.tlog", short + telemetry(RUN, SKID)))
    assert len(log) == len(RUN)
    assert any("started 2 times" in note for note in log.notes)


def test_telemetry_keeps_its_clock_where_microseconds_wrap(tmp_path):
    pytest.importorskip("pymavlink")
    boot = 2**32 * 1e-6 - 5.0
    log = Log.read(written(tmp_path / "a.tlog", telemetry(RUN, SKID, boot=boot)))
    assert np.allclose(log.t, RUN.t, atol=2e-3)
    assert np.allclose(log.cmd[2:-1, 1], RUN.cmd[2:-1, 1] / 20.0, atol=0.002)


def test_accelerations_that_an_imu_does_not_flag_are_missing(tmp_path):
    pytest.importorskip("pymavlink")
    log = Log.read(written(tmp_path / "a.tlog", telemetry(RUN, SKID, flags=0b101)))
    there = [bool(np.isfinite(log.z[:, COLUMN[f"accel_{axis}_mps2"]]).any()) for axis in "xyz"]
    assert there == [True, False, True]


def test_broken_packets_are_left_out(tmp_path):
    pytest.importorskip("pymavlink")
    whole = bytearray(telemetry(RUN, SKID))
    for at in range(len(whole) // 2, len(whole), 4001):
        whole[at] ^= 0xFF
    log = Log.read(written(tmp_path / "a.tlog", bytes(whole[:-7])))
    assert len(log) > 0.8 * len(RUN)
    assert any("broken packet(s)" in note for note in log.notes)


@pytest.mark.parametrize("name", ["a.BIN", "a.bin", "a.tlog"])
@pytest.mark.parametrize("content", [b"", b"t_s,x\n1,2\n" * 40, bytes(200_000)])
def test_other_files_under_these_names_are_refused(name, content, tmp_path):
    pytest.importorskip("pymavlink")
    refused(written(tmp_path / name, content))


def test_a_vessel_gets_shaft_speed_and_places_of_sensors_from_the_parameters(tmp_path):
    more = {"GPS1_POS_X": 0.5, "GPS1_POS_Z": -0.4, "INS_POS1_Y": 0.1}
    path = written(tmp_path / "a.BIN", dataflash(RUN, {**SKID, **more}))
    boat = particulars_for_log(path, "otter")
    # 70 % throttle drives it at 1.5 m/s
    assert boat.shaft_speed / boat.speed == pytest.approx(0.7 / 1.5)
    assert boat.instruments.gps_arm == pytest.approx((0.5, 0.0, -0.4), rel=1e-6)
    assert boat.instruments.imu_arm == pytest.approx((0.0, 0.1, 0.0), rel=1e-6)
    assert boat.instruments.tilt_sd > 0.0
    mapping = tmp_path / "m.toml"
    mapping.write_text("[servos]\nshaft_speed = 16.5\n")
    own = particulars_for_log(path, "otter", mapping)
    assert own.shaft_speed == particulars_for_log(tmp_path / "a.csv", "otter").shaft_speed


@pytest.mark.parametrize(("ship", "parameters"), [("usv75", SKID), ("otter", RUDDER)])
def test_a_vessel_that_steers_otherwise_is_refused(ship, parameters, tmp_path):
    path = written(tmp_path / "a.BIN", dataflash(RUN, parameters))
    with pytest.raises(LogError, match=f"{ship} steers by"):
        particulars_for_log(path, ship)


@pytest.mark.parametrize("kind", KINDS)
def test_log_check_takes_shares_of_throttle_for_what_they_are(kind, tmp_path):
    pytest.importorskip("pymavlink")
    log = dataclasses.replace(RUN, z=np.hstack([RUN.z[:, :MOTION_AT], 0.01 * RUN.z[:, MOTION_AT:]]))
    path = written(tmp_path / f"a.{kind}", KINDS[kind](log, SKID))
    command = ["check", str(path), "--ship", "otter", "--no-picture"]
    found = CliRunner().invoke(app, command).output
    assert "rpm" not in found and "rev/s" not in found.partition("samples/s")[2]
