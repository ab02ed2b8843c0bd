"""What comes out goes on: datum, tables of states, and CSV, Parquet and GeoJSON of them."""

from __future__ import annotations

import dataclasses
import json
import pickle
from datetime import UTC, datetime

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from twin import Log, Particulars, Twin, TwinError, recorded_runs
from twin.channels import COMMANDS, MEASUREMENTS, STATE
from twin.checkpoint import StateError
from twin.cli.main import app
from twin.logs.datum import DATUM, Datum, Plane
from twin.logs.errors import LogError
from twin.logs.tables import ExportError, StateTable

PLACE = 63.4401, 10.3967
EPOCH = datetime(2024, 4, 23, 12, 22, 10, 250000, UTC).timestamp()
HERE = Datum(latitude=PLACE[0], longitude=PLACE[1], epoch=EPOCH)


def run(count=120, datum=HERE):
    t = 0.1 * np.arange(count)
    z = np.full((count, len(MEASUREMENTS)), np.nan)
    heading = 0.3 + 0.02 * t
    z[:, 0], z[:, 1] = 1.0 + 1.5 * t * np.cos(heading), 2.0 + 1.5 * t * np.sin(heading)
    z[:, 2], z[:, 3] = 1.5 * np.cos(heading), 1.5 * np.sin(heading)
    z[:, 4], z[:, 5] = heading, 0.02 + 1e-4 * np.sin(t)
    z[:3, :5] = np.nan
    cmd = np.tile([10.0, 10.5, 0.01, 0.01], (count, 1)) + 1e-3 * t[:, None]
    return Log(t, z, cmd, name="run", datum=datum)


@pytest.fixture(scope="module")
def boat():
    path = recorded_runs()["boat1_usv_circle"]
    return Particulars.load(path.with_name("boat1_usv_circle.toml"))


@pytest.fixture
def files(tmp_path, boat):
    """A log with a datum and its boat, in files."""
    run().write(tmp_path / "run.csv")
    (tmp_path / "run.toml").write_text(boat.to_toml(), encoding="utf-8")
    return tmp_path


def command(*arguments):
    result = CliRunner().invoke(app, [str(each) for each in arguments])
    return result.exit_code, " ".join(result.output.split())


# --- places and times -------------------------------------------------------------------------


@given(
    latitude=st.floats(-85.0, 85.0),
    longitude=st.floats(-180.0, 180.0),
    north=st.floats(-2e4, 2e4),
    east=st.floats(-2e4, 2e4),
)
def test_places_survive_metres_and_back(latitude, longitude, north, east):
    plane = Plane(latitude, longitude)
    place = plane.degrees(north, east)
    assert abs(place[0]) <= 90.0 and -180.0 <= place[1] < 180.0
    np.testing.assert_allclose(plane.metres(*place), (north, east), atol=1e-6)
    again = plane.degrees(*plane.metres(*place))
    apart = np.remainder(again[1] - place[1] + 180.0, 360.0) - 180.0
    assert abs(again[0] - place[0]) < 1e-9 and abs(apart) < 1e-9


def east_north_up(place, origin):
    """Turn places (latitude, longitude in degrees, height in m) into the plane, by matrices."""

    def geocentric(latitude, longitude, height):
        a, f = 6378137.0, 1.0 / 298.257223563
        phi, lam = np.radians(latitude), np.radians(longitude)
        e2 = f * (2.0 - f)
        n = a / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
        return np.array(
            [
                (n + height) * np.cos(phi) * np.cos(lam),
                (n + height) * np.cos(phi) * np.sin(lam),
                (n * (1.0 - e2) + height) * np.sin(phi),
            ]
        )

    phi, lam = np.radians(origin[:2])
    turn = np.array(
        [
            [-np.sin(lam), np.cos(lam), 0.0],
            [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)],
            [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)],
        ]
    )
    return turn @ (geocentric(*place) - geocentric(*origin))


def test_the_formula_of_these_tests_gives_published_values():
    # from Zermatt to the summit of the Matterhorn: MathWorks, geodetic2enu
    found = east_north_up((45.976, 7.658, 4531.0), (46.017, 7.750, 1673.0))
    np.testing.assert_allclose(found, [-7134.8, -4556.3, 2852.4], atol=0.05)


@pytest.mark.parametrize("latitude", [-89.9, -33.9, 0.0, 60.0, 78.2, 90.0])
@pytest.mark.parametrize("longitude", [10.0, 179.99])
def test_metres_are_those_of_the_ellipsoid_as_far_as_50_km(latitude, longitude):
    plane, angle = Plane(latitude, longitude), np.linspace(0.0, 6.0, 9)
    for way in (10.0, 1e4, 5e4):
        north, east = way * np.cos(angle), way * np.sin(angle)
        places = plane.degrees(north, east)
        for k, place in enumerate(zip(*places, strict=True)):
            there = east_north_up((*place, 0.0), (latitude, longitude, 0.0))
            np.testing.assert_allclose(there[:2], (east[k], north[k]), atol=1e-6)
            np.testing.assert_allclose(plane.metres(*place), (north[k], east[k]), atol=1e-6)


def test_times_become_dates():
    dates = HERE.utc(np.array([0.0, 1.5, np.nan]))
    assert [str(date) for date in dates] == [
        "2024-04-23T12:22:10.250000",
        "2024-04-23T12:22:11.750000",
        "NaT",
    ]
    assert Datum(latitude=1.0, longitude=2.0).utc(np.zeros(1)) is None


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"latitude": 95.0, "longitude": 0.0}, "latitude = 95.0"),
        ({"latitude": "63 N", "longitude": 0.0}, "latitude = '63 N'"),
        ({"latitude": 5.0, "longitude": float("nan")}, "longitude = nan"),
        ({"latitude": 5.0}, "give both or none"),
        ({"epoch": 1e300}, "epoch = 1e[+]300"),
    ],
)
def test_impossible_datums_are_refused(fields, words):
    with pytest.raises(LogError, match=words):
        Datum(**fields)


# --- logs -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.parquet"])
def test_a_log_keeps_its_datum(tmp_path, name):
    run().write(tmp_path / name)
    again = Log.read(tmp_path / name)
    assert again.datum == HERE
    assert again.slice(1.0, 5.0).datum == HERE and again.without_truth().datum == HERE
    run(datum=None).write(tmp_path / name)
    assert Log.read(tmp_path / name).datum is None
    place = Datum(latitude=PLACE[0], longitude=PLACE[1])
    run(datum=place).write(tmp_path / name)
    assert Log.read(tmp_path / name).datum == place


def test_a_log_of_two_datums_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    run().write(path)
    frame = pl.read_csv(path)
    frame = frame.with_columns(pl.when(pl.col("t_s") < 3).then(1.0).otherwise(2.0).alias(DATUM[0]))
    frame.write_csv(path)
    with pytest.raises(LogError, match=r"run.csv: column datum_latitude_deg holds 2 values"):
        Log.read(path)


@pytest.mark.parametrize("stated", [True, False])
def test_latitude_longitude_and_date_become_the_datum(tmp_path, stated):
    log = run()
    north, east = log.z[:, 0], log.z[:, 1]
    latitude, longitude = HERE.plane.degrees(north, east)
    dates = [f"2024-04-23 12:22:{10.25 + t:09.6f}" for t in log.t[:400]]
    columns = dict(zip(COMMANDS, log.cmd.T, strict=True))
    frame = {"when": dates, "lat": latitude, "lon": longitude, "hdg": log.z[:, 4], **columns}
    path = tmp_path / "foreign.csv"
    pl.DataFrame(frame).fill_nan(None).write_csv(path)
    (tmp_path / "foreign.mapping.toml").write_text(
        '[columns]\nt_s = { from = "when", unit = "datetime" }\ncompass_rad = "hdg"\n'
        + "".join(f'{name} = "{name}"\n' for name in COMMANDS)
        + '[position]\nlatitude = "lat"\nlongitude = "lon"\n'
        + (f"datum = [{PLACE[0]}, {PLACE[1]}]\n" if stated else ""),
        encoding="utf-8",
    )
    again = Log.read(path)
    assert again.datum.epoch == pytest.approx(EPOCH, abs=1e-6)
    expected = PLACE if stated else (latitude[3], longitude[3])
    assert (again.datum.latitude, again.datum.longitude) == pytest.approx(expected, abs=1e-12)
    there = again.datum.plane.degrees(again.z[:, 0], again.z[:, 1])
    np.testing.assert_allclose(there, (latitude, longitude), atol=1e-9)
    if stated:
        np.testing.assert_allclose(again.z[3:, :2], log.z[3:, :2], atol=1e-6)


def test_seconds_since_1970_are_a_date(tmp_path):
    log = run(datum=None)
    path = tmp_path / "run.csv"
    dataclasses.replace(log, t=log.t + 1.7e9).write(path)
    again = Log.read(path)
    assert again.datum == Datum(epoch=0.0)
    assert str(again.datum.utc(again.t[:1])[0]) == "2023-11-14T22:13:20.000000"
    assert any("seconds since 1970" in note for note in again.notes)


def test_latitude_and_longitude_place_a_log_in_metres():
    plane = HERE.plane
    x, y = np.linspace(-50.0, 80.0, 30), np.linspace(0.0, 60.0, 30)
    fixes = plane.degrees(x, y)
    found = Plane.through(fixes, (x, y), "a.csv")
    assert vars(found) == pytest.approx(vars(plane), abs=1e-9)
    far = Plane(-10.0, 180.0 - 1e-4)
    assert vars(Plane.through(far.degrees(x, y), (x, y), "a.csv")) == pytest.approx(vars(far))
    # of 40 km; and as a logger has them that takes the Earth for a cylinder along its meridian
    north, east = np.linspace(-2e4, 2e4, 30), 1e4 * np.sin(np.arange(30.0))
    fixes = plane.degrees(north, east)
    assert vars(Plane.through(fixes, (north, east), "a.csv")) == pytest.approx(vars(plane))
    across = 6.38e6 * np.cos(np.radians(PLACE[0])) * np.radians(fixes[1] - PLACE[1])
    along = 6.38e6 * np.radians(fixes[0] - PLACE[0])
    found = Plane.through(fixes, (along, across), "a.csv")
    assert np.hypot(*plane.metres(found.latitude, found.longitude)) < 200.0
    fixes = plane.degrees(x, y)
    for metres in ((1.2 * x, 1.2 * y), (y, x)):
        with pytest.raises(LogError, match="move otherwise than gps_x_m"):
            Plane.through(fixes, metres, "a.csv")
    with pytest.raises(LogError, match="no row has latitude"):
        Plane.through(fixes, (x * np.nan, y), "a.csv")


# --- the twin ---------------------------------------------------------------------------------


def test_run_returns_named_columns(boat):
    log = run()
    twin, other = Twin(boat, "ukf"), Twin(boat, "ukf")
    table = twin.run(log)
    names = twin.predictor.parameter_names
    assert table.dtype.names == (
        *("t_s", "time_utc", "latitude_deg", "longitude_deg", *STATE),
        *(f"sd_{name}" for name in STATE),
        *names,
        *(f"sd_{name}" for name in names),
    )
    assert table.shape == (len(log),) and type(table["x_m"]) is np.ndarray
    assert np.isnan(table["x_m"][:3]).all()
    for k, row in enumerate(log):
        other.step(*row)
        if k >= 3:
            now = other.estimate()
            np.testing.assert_array_equal([table[k][name] for name in STATE], now.state)
            np.testing.assert_array_equal([table[k][name] for name in names], now.params)
            np.testing.assert_array_equal([table[k][f"sd_{name}"] for name in STATE], now.sd)
            sds = [table[k][f"sd_{name}"] for name in names]
            np.testing.assert_array_equal(sds, now.params_sd)
    north, east = HERE.plane.metres(table["latitude_deg"][3:], table["longitude_deg"][3:])
    np.testing.assert_allclose((north, east), (table["x_m"][3:], table["y_m"][3:]), atol=1e-6)
    assert str(table["time_utc"][5]) == "2024-04-23T12:22:10.750000"
    piece = table[5:9]
    assert piece.datum == HERE and pickle.loads(pickle.dumps(piece)).datum == HERE
    plain = Twin(boat, "ukf").run(run(datum=None))
    assert plain.dtype.names[:2] == ("t_s", "x_m")
    np.testing.assert_array_equal(plain["x_m"], table["x_m"])


@pytest.mark.parametrize("name", ["persistence", "ukf", "dsw-ukf", "dsw-ukf-plus"])
def test_standard_deviations_of_a_table_are_those_a_forecast_starts_with(boat, name):
    twin = Twin(boat, name)
    table = twin.run(run())
    start = np.sqrt(np.diag(twin.predict("hold").start_cov))
    sd = [table[f"sd_{channel}"][-1] for channel in STATE]
    np.testing.assert_array_equal(sd, twin.estimate().sd)
    if name == "ukf":  # others start a forecast from another filter
        np.testing.assert_allclose(sd, start, rtol=1e-12)


def test_the_datum_is_kept_in_the_twin_file(tmp_path, boat):
    twin, path = Twin(boat, "ukf"), tmp_path / "boat.twin"
    twin.run(run())
    twin.save(path)
    again = Twin.load(path)
    assert again.datum == HERE
    ahead = again.predict("hold").table(again.datum)
    assert ahead.datum == HERE and {"time_utc", "low_x_m"} <= set(ahead.dtype.names)
    later = run(200).slice(t0=12.0)
    moved = dataclasses.replace(HERE, latitude=PLACE[0] + 0.01)
    with pytest.raises(TwinError, match=r"datum = \[latitude, longitude\]"):
        again.run(dataclasses.replace(later, datum=moved))
    late = dataclasses.replace(HERE, epoch=HERE.epoch + 60.0)
    with pytest.raises(TwinError, match="t = 0 is 2024-04-23T12:23"):
        again.run(dataclasses.replace(later, datum=late))
    again.run(later)
    fresh = Twin(boat, "ukf")
    fresh.run(run(datum=None))
    fresh.save(path)
    assert Twin.load(path).datum is None


def test_a_damaged_datum_of_a_twin_file_is_refused(tmp_path, boat, monkeypatch):
    twin, path = Twin(boat, "persistence"), tmp_path / "boat.twin"
    twin.run(run())
    monkeypatch.setattr(Datum, "to_json", lambda self: {"latitude": "north"})
    twin.save(path)
    with pytest.raises(StateError, match="latitude = 'north'"):
        Twin.load(path)


# --- files ------------------------------------------------------------------------------------


def small(datum=HERE):
    columns = {"t_s": [0.0, 0.5, 1.0], "x_m": [0.0, np.nan, 5.0], "y_m": [0.0, np.nan, -3.0]}
    return StateTable.of({**columns, "u_mps": [1.0, np.nan, 1.1]}, datum)


def test_csv_and_parquet_hold_the_same_table(tmp_path):
    small().write(tmp_path / "a.csv")
    small().write(tmp_path / "a.parquet")
    text = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    assert text[0] == "t_s,time_utc,latitude_deg,longitude_deg,x_m,y_m,u_mps"
    assert text[2] == "0.5,2024-04-23T12:22:10.750000Z,,,,,"
    frame = pl.read_parquet(tmp_path / "a.parquet")
    assert frame.schema["time_utc"] == pl.Datetime("us", "UTC")
    assert frame["x_m"].to_list() == [0.0, None, 5.0]
    again = pl.read_csv(tmp_path / "a.csv", try_parse_dates=True)
    for name in ("t_s", "latitude_deg", "longitude_deg", "x_m"):
        assert frame[name].to_list() == again[name].to_list()


@pytest.mark.parametrize("ending", [".csv", ".geojson"])
def test_text_files_have_times_without_digits_of_chance(tmp_path, ending):
    table = StateTable.of({"t_s": [0.0, 120.09000000953674], "x_m": [0, 1], "y_m": [0, 1]}, HERE)
    table.write(tmp_path / f"ahead{ending}")
    text = (tmp_path / f"ahead{ending}").read_text(encoding="utf-8")
    assert "120.09" in text and "120.0900000" not in text
    assert table["t_s"][1] == 120.09000000953674


def check_geojson(content):
    """Check a collection against RFC 7946, and with parsers where they are installed."""
    assert content["type"] == "FeatureCollection" and "crs" not in content
    depth = {"Point": 0, "LineString": 1, "MultiLineString": 2}
    for feature in content["features"]:
        assert set(feature) == {"type", "geometry", "properties"} and feature["type"] == "Feature"
        places = np.array(feature["geometry"]["coordinates"])
        assert places.ndim == depth[feature["geometry"]["type"]] + 1 and places.shape[-1] == 2
        assert (np.abs(places) <= [180.0, 90.0]).all()


def test_geojson_has_longitude_before_latitude(tmp_path):
    path = tmp_path / "a.geojson"
    small().write(path, boat="cat")
    content = json.loads(path.read_text(encoding="utf-8"))
    check_geojson(content)
    track, first, last = content["features"]
    assert first["geometry"]["coordinates"] == pytest.approx([PLACE[1], PLACE[0]], abs=1e-12)
    assert track["geometry"]["type"] == "MultiLineString"
    assert track["properties"] == {"datum": HERE.to_json(), "boat": "cat"}
    assert last["properties"]["time_utc"] == "2024-04-23T12:22:11.250000Z"
    assert last["properties"]["u_mps"] == 1.1 and "latitude_deg" not in last["properties"]
    north, east = HERE.plane.metres(*last["geometry"]["coordinates"][::-1])
    assert (north, east) == pytest.approx((5.0, -3.0), abs=1e-6)


def test_a_track_is_cut_at_the_date_line(tmp_path):
    table = StateTable.of(
        {"t_s": np.arange(4.0), "x_m": np.zeros(4), "y_m": [-200.0, -100.0, 100.0, 200.0]},
        Datum(latitude=0.0, longitude=180.0),
    )
    table.write(tmp_path / "a.geojson")
    content = json.loads((tmp_path / "a.geojson").read_text(encoding="utf-8"))
    lines = content["features"][0]["geometry"]["coordinates"]
    assert [len(line) for line in lines] == [2, 2]
    assert min(place[0] for place in lines[0]) > 179.0 > -179.0 > max(p[0] for p in lines[1])


def test_files_that_cannot_be_written_are_refused(tmp_path):
    with pytest.raises(ExportError, match=r"a.xlsx: unknown kind of file.*\.csv, \.parquet"):
        small().write(tmp_path / "a.xlsx")
    for datum in (None, Datum(epoch=0.0)):
        with pytest.raises(ExportError, match=r"a.geojson: GeoJSON needs latitude and longitude"):
            small(datum).write(tmp_path / "a.geojson")
    assert not list(tmp_path.iterdir())


def test_pandas_gets_the_table_where_it_is_installed():
    pandas = pytest.importorskip("pandas")
    frame = small().to_pandas()
    assert list(frame.columns) == list(small().dtype.names)
    assert frame["time_utc"][0] == pandas.Timestamp("2024-04-23T12:22:10.25", tz="UTC")
    assert frame["x_m"].isna().tolist() == [False, True, False]


# --- commands ---------------------------------------------------------------------------------


def test_commands_write_each_kind_of_file(files):
    kinds = ("csv", "parquet", "geojson")
    for kind in kinds:
        out = files / f"state.{kind}"
        code, said = command("identify", files / "run.csv", "-p", "ukf", "--out", out)
        assert code == 0, said
        ahead = files / f"ahead.{kind}"
        code, said = command("predict", files / "run.csv", "-p", "ukf", "--out", ahead)
        assert code == 0, said
    state, ahead = (pl.read_parquet(files / f"{name}.parquet") for name in ("state", "ahead"))
    assert len(state) == 120 and len(ahead) == 100
    assert ahead["time_utc"][-1] == datetime(2024, 4, 23, 12, 22, 32, 150000, UTC)
    assert {"low_x_m", "high_psi_rad", "sd_u_mps", "latitude_deg"} <= set(ahead.columns)
    for name, points in (("state", 117), ("ahead", 100)):
        content = json.loads((files / f"{name}.geojson").read_text(encoding="utf-8"))
        check_geojson(content)
        assert len(content["features"]) == 1 + points
        assert content["features"][0]["properties"]["predictor"] == "ukf"
    code, said = command("identify", files / "run.csv", "-p", "ukf", "--json", files / "end.json")
    assert json.loads((files / "end.json").read_text())["datum"] == HERE.to_json()


def test_commands_refuse_a_file_before_they_run(files):
    run(datum=None).write(files / "run.csv")
    for name in ("identify", "predict"):
        code, said = command(name, files / "run.csv", "--out", files / "a.geojson")
        assert code == 2 and "GeoJSON needs latitude and longitude" in said
        code, said = command(name, files / "run.csv", "--out", files / "a.txt")
        assert code == 2 and "unknown kind of file" in said


def test_benchmark_report_names_the_datum(files):
    run(600).write(files / "run.csv")
    options = ("--predictors", "persistence", "--jobs", "1", "--out", files / "out")
    code, said = command("benchmark", files / "run.csv", *options)
    assert code == 0, said
    results = json.loads((files / "out" / "results.json").read_text(encoding="utf-8"))
    assert results["logs"]["run"]["datum"] == HERE.to_json()
    assert f"latitude {PLACE[0]}" in (files / "out" / "report.html").read_text(encoding="utf-8")
