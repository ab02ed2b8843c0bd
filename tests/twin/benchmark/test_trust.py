"""Whether a twin may be trusted: scores, grades, and the faults that they are for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from twin import Log, Particulars, Prediction, Twin
from twin.benchmark import trust
from twin.benchmark.trust import (
    BAD,
    DOUBTFUL,
    OK,
    Answer,
    GpsLoss,
    ScoredForecast,
    TrustMeter,
    Verdict,
    judge,
    parameter_answer,
    position_bound,
    sensor_answer,
    speed_ratio,
)
from twin.identification.data_weight import CHOSEN, PRIOR
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.predictors.base import ParametersInUse
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.ukf import UKFPredictor
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel


@pytest.fixture(scope="module")
def boat() -> Particulars:
    return dataclasses.replace(particulars_of(Vessel.load("usv75")), design="")


@pytest.fixture(scope="module")
def log() -> Log:
    """Return 150 s of random commands in a slight sea, without truth."""
    return simulate(
        "random",
        vessel=Vessel.load("usv75"),
        sea=SeaState(hs=0.3, wind=3.0),
        duration=150.0,
        seed=6,
    ).without_truth()


def verdict_of(about: Particulars, log: Log, predictor: str = "ukf") -> Verdict:
    return judge(log, about, predictor)


@pytest.fixture(scope="module")
def good(boat: Particulars, log: Log) -> Verdict:
    return verdict_of(boat, log, "dsw-ukf-plus")


@pytest.fixture
def ran(boat: Particulars, log: Log) -> TrustMeter:
    """Return the meter of a twin that ran over the log, whose candidate in use is the prior."""
    twin = Twin(boat, "dsw-ukf-plus")
    meter = TrustMeter(twin, log)
    twin.run(log, meter)
    assert isinstance(twin.predictor, PlusPredictor)
    twin.predictor.selector.state.count[CHOSEN] = PRIOR
    return meter


def test_a_good_twin_is_ok_in_five_answers(good: Verdict) -> None:
    abouts = ["forecast", "coverage", "without GPS", "parameters", "sensors"]
    assert [answer.about for answer in good.answers] == abouts
    assert [answer.grade for answer in good.answers] == [OK] * 5
    assert good.grade == OK
    numbers = good.answers[0].numbers
    assert numbers["displacement_m"] < 0.5 * numbers["persistence_displacement_m"]
    assert numbers["n"] == len(good.forecasts) == 41
    assert len(good.losses) == 8 and all(loss.t >= 74.0 for loss in good.losses)
    assert all(loss.after[-1] == pytest.approx(60.0, abs=1.0) for loss in good.losses)


def test_scoring_changes_nothing_in_the_twin(boat: Particulars, log: Log) -> None:
    alone, watched = Twin(boat), Twin(boat)
    alone.run(log)
    watched.run(log, TrustMeter(watched, log))
    np.testing.assert_array_equal(alone.estimate().params, watched.estimate().params)
    np.testing.assert_array_equal(alone.estimate().state, watched.estimate().state)


def test_the_bound_is_length_or_five_metres_or_noise(boat: Particulars) -> None:
    assert position_bound(boat) == boat.length
    small = dataclasses.replace(boat, length=2.0, beam=1.0, draft=0.2, mass=150.0)
    assert position_bound(small) == 5.0
    rough = dataclasses.replace(boat.instruments, gps_sd=3.0)
    assert position_bound(dataclasses.replace(small, instruments=rough)) == 15.0


class Sure(UKFPredictor):
    """Claims to be as good as certain."""

    def predict(self, plan: np.ndarray, dt: float) -> Prediction:
        made = super().predict(plan, dt)
        off = np.array([30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        cov = 1e-8 * np.broadcast_to(np.eye(6), made.cov.shape)
        return Prediction(made.t0, made.start, 1e-8 * np.eye(6), made.t, made.mean + off, cov)


def test_wrong_and_certain_forecasts_are_bad(boat: Particulars, log: Log) -> None:
    twin = Twin(boat, Sure(boat))
    meter = TrustMeter(twin, log)
    twin.run(log, meter)
    answers = {answer.about: answer for answer in meter.verdict().answers}
    assert answers["coverage"].grade == BAD
    assert answers["coverage"].numbers["position"] < 0.1
    assert answers["forecast"].numbers["displacement_m"] > 20.0
    assert meter.verdict().grade == BAD


def test_another_boat_shows_in_the_parameters(boat: Particulars, log: Log, good: Verdict) -> None:
    other = dataclasses.replace(
        boat,
        length=4.0 * boat.length,
        beam=4.0 * boat.beam,
        draft=4.0 * boat.draft,
        mass=64.0 * boat.mass,
    )
    found = verdict_of(other, log, "dsw-ukf-plus")
    assert len(found.answers[3].numbers["far"]) > 0
    assert found.answers[3].grade in (DOUBTFUL, BAD)
    assert "wrong boat" in found.answers[3].text
    assert good.answers[3].numbers["far"] == {}


def test_parameters_alone_are_never_bad(boat: Particulars, log: Log) -> None:
    twin = Twin(boat, "dsw-ukf-plus")
    meter = TrustMeter(twin, log)
    meter.prior = dataclasses.replace(meter.prior, params_sd=0.02 * meter.prior.params_sd)
    twin.run(log, meter)
    found = meter.verdict()
    assert [answer.grade for answer in found.answers[:3]] == [OK] * 3
    assert len(found.answers[3].numbers["far"]) > 4
    assert found.answers[3].grade == DOUBTFUL


def clean(vessel: str, manoeuvre: str, seed: int, hs: float = 0.1) -> Verdict:
    """Return the verdict on 200 s of a simulated boat whose particulars are right."""
    ship = Vessel.load(vessel)
    sea = SeaState(hs=hs, wind=3.0 if hs else 0.0)
    run = simulate(manoeuvre, vessel=ship, sea=sea, duration=200.0, seed=seed)
    return verdict_of(particulars_of(ship), run.without_truth(), "dsw-ukf-plus")


@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
def test_a_clean_catamaran_is_ok(vessel: str, manoeuvre: str) -> None:
    """Its drag over displacement is several times that of the rough prior."""
    found = clean(vessel, manoeuvre, 1)
    assert found.answers[3].numbers["drag"] > 2.0
    assert "times the drag" in found.answers[3].text
    assert found.grade == OK, [answer.text for answer in found.answers]


def test_a_steady_turn_in_calm_water_is_ok() -> None:
    """There persistence is as good as the sensors, and no twin can be better."""
    found = clean("otter", "turn", 1, hs=0.0)
    numbers = found.answers[0].numbers
    assert numbers["displacement_m"] > 0.9 * numbers["persistence_displacement_m"]
    assert found.grade == OK, [answer.text for answer in found.answers]


def test_effect_and_damping_reversed_together_are_no_sign(boat: Particulars, log: Log) -> None:
    """A steady turn tells their ratio only."""
    twin = Twin(dataclasses.replace(boat, steering="differential"), "dsw-ukf-plus")
    meter = TrustMeter(twin, log)
    names = twin.predictor.parameter_names
    last = twin.estimate()
    params, sd = last.params.copy(), 0.1 * last.params_sd
    params[names.index("N_dn")] *= -1.0
    for damping in (1.0, -1.0):
        params[names.index("N_|u|r")] *= damping
        turned = dataclasses.replace(last, params=params, params_sd=sd, ready=True)
        twin.estimate = lambda turned=turned: turned  # type: ignore[method-assign]
        assert meter.verdict().answers[3].numbers["sign"] == (["N_dn"] if damping > 0.0 else [])


def test_short_logs_may_cover_less_by_chance(boat: Particulars, log: Log) -> None:
    meter = TrustMeter(Twin(boat, "ukf"), log)

    def grade(seconds: float, share: float) -> str:
        count = int(seconds / 2.0)
        inside = np.arange(count) < share * count
        meter.forecasts = [
            ScoredForecast(2.0 * k, np.zeros((1, 2)), (0.1, 0.1), (9.0, 9.0), (bool(ok), True))
            for k, ok in enumerate(inside)
        ]
        return meter.verdict().answers[1].grade

    assert grade(130.0, 0.71) == OK
    assert grade(130.0, 0.6) == DOUBTFUL
    assert grade(1300.0, 0.71) == DOUBTFUL
    assert grade(130.0, 0.4) == BAD


def test_reversed_steering_shows_in_a_sign(boat: Particulars, log: Log) -> None:
    cmd = log.cmd.copy()
    cmd[:, 2:] *= -1.0
    found = verdict_of(boat, dataclasses.replace(log, cmd=cmd), "dsw-ukf-plus")
    answer = found.answers[3]
    assert answer.numbers["sign"] or answer.numbers["far"]
    assert answer.grade != OK


def test_short_logs_cannot_tell(boat: Particulars, log: Log) -> None:
    found = verdict_of(boat, log.slice(0.0, 9.0))
    assert [answer.grade for answer in found.answers[:3]] == [DOUBTFUL] * 3
    assert all("cannot tell" in answer.text for answer in found.answers[:3])
    assert found.grade == DOUBTFUL
    found.to_json()


def test_few_bad_forecasts_are_doubtful_not_bad(boat: Particulars, log: Log) -> None:
    twin = Twin(boat, Sure(boat))
    short = log.slice(0.0, 20.0)
    meter = TrustMeter(twin, short)
    twin.run(short, meter)
    forecast, coverage, losses = meter.verdict().answers[:3]
    assert coverage.numbers["position"] == 0.0
    assert [forecast.grade, coverage.grade, losses.grade] == [DOUBTFUL] * 3
    assert "too short" in losses.text


def test_logs_without_fixes_cannot_tell(boat: Particulars, log: Log) -> None:
    z = log.z.copy()
    z[:, :4] = np.nan
    found = verdict_of(boat, dataclasses.replace(log, z=z))
    assert [answer.grade for answer in found.answers[:4]] == [DOUBTFUL] * 4
    assert all("cannot tell" in answer.text for answer in found.answers[:4])
    assert "too few fixes" in found.answers[2].text


def test_seconds_without_gps_are_the_lower_median_of_all_losses(
    boat: Particulars, log: Log
) -> None:
    meter = TrustMeter(Twin(boat, "ukf"), log)
    after = np.arange(1.0, 61.0)

    def answer(*leaves_at: float) -> Answer:
        meter.losses = [
            GpsLoss(80.0, after, np.where(after < s, 0.0, 2.0 * meter.bound)) for s in leaves_at
        ]
        return meter.verdict().answers[2]

    assert "within 6.34 m for 20 s" in answer(5.0, 20.0, 99.0, 99.0).text
    assert answer(5.0, 20.0, 99.0, 99.0).grade == DOUBTFUL
    assert "within 6.34 m for at least 60 s" in answer(5.0, 99.0, 99.0).text
    assert answer(5.0, 99.0, 99.0).grade == OK
    assert answer(5.0, 8.0, 99.0).grade == BAD


def test_twins_without_parameters_are_scored_too(boat: Particulars, log: Log) -> None:
    found = verdict_of(boat, log, "persistence")
    numbers = found.answers[0].numbers
    assert numbers["displacement_m"] == pytest.approx(numbers["persistence_displacement_m"])
    assert found.answers[3].numbers["count"] == 0


@pytest.fixture(scope="module")
def rolling_log() -> Log:
    """Return a log of a boat that rolls in waves from its bow."""
    vessel = Vessel.load("usv75")
    log = simulate(
        "heading135", vessel=vessel, sea=SeaState.named("2"), duration=180.0, seed=3, dof=6
    )
    return log.without_truth()


@pytest.fixture(scope="module")
def rolling_boat() -> Particulars:
    """Return its particulars."""
    return particulars_of(Vessel.load("usv75"), dof=6)


@pytest.fixture(scope="module")
def rolling(rolling_boat: Particulars, rolling_log: Log) -> Verdict:
    """Return the verdict on it."""
    return verdict_of(rolling_boat, rolling_log)


def test_forecasts_of_roll_and_pitch_are_a_sixth_answer(rolling: Verdict) -> None:
    answer = rolling.answers[-1]
    assert (answer.about, answer.grade) == ("attitude", OK)
    numbers = answer.numbers
    assert (np.array(numbers["error"]) < 0.9 * np.array(numbers["held"])).all()
    assert 0.7 < min(numbers["inside"]) <= 1.0
    assert numbers["n"] > 20


def test_a_prior_in_use_confirms_no_parameters(ran: TrustMeter) -> None:
    found = ran.verdict()
    answer = found.answers[3]
    assert answer.grade == DOUBTFUL and answer.numbers["prior_in_use"]
    assert answer.numbers["in_use"].startswith("the prior")
    off = max(answer.numbers["deviations_in_prior_sd"].values())
    assert off > 0.1, "of the best refit, not of the prior from itself"
    near, prior = [("X_nu", 1.0)], ParametersInUse("the prior", True)
    assert parameter_answer(near, in_use=prior).grade == DOUBTFUL
    assert parameter_answer(near, in_use=prior, own_prior=True).grade == OK
    assert parameter_answer(near, in_use=ParametersInUse("a refit", False)).grade == OK


def test_parameters_are_graded_by_number_sign_and_speed() -> None:
    def grade(far: int, **more: object) -> str:
        return parameter_answer([("X_u", 4.4)] * far + [("N_r", 1.0)], **more).grade  # type: ignore[arg-type]

    assert [grade(0), grade(1), grade(4), grade(5)] == [OK, DOUBTFUL, DOUBTFUL, BAD]
    assert grade(0, turned=["N_F"]) == DOUBTFUL
    assert [grade(0, speed=ratio) for ratio in (0.3, 0.5, 1.6, 1.8)] == [DOUBTFUL, OK, OK, DOUBTFUL]


def test_the_speed_straight_ahead_tells_another_boat(boat: Particulars, log: Log) -> None:
    assert speed_ratio(log, boat) == pytest.approx(1.0, abs=0.2)
    wrong = dataclasses.replace(boat, speed=3.0 * boat.speed)
    assert speed_ratio(log, wrong) == pytest.approx(speed_ratio(log, boat) / 3.0, rel=0.1)  # type: ignore[operator]
    assert speed_ratio(log.slice(0.0, 10.0), boat) is None


@pytest.mark.parametrize(("severity", "grade"), [(NOTE, OK), (WARNING, DOUBTFUL), (ERROR, BAD)])
def test_findings_grade_the_sensors(severity: str, grade: str) -> None:
    assert sensor_answer([Finding(severity, "gyro-sign", "mirrored", "")], {}, 9.0).grade == grade


@pytest.mark.parametrize(
    ("sensor", "status", "seconds", "grade"),
    [
        ("commands", "excluded", 100.0, BAD),
        ("commands", "excluded", 30.0, DOUBTFUL),
        ("gyro", "excluded", 100.0, DOUBTFUL),
        ("compass", "excluded", 3.0, OK),
        ("commands", "doubtful", 30.0, DOUBTFUL),
        ("gps", "doubtful", 10.0, OK),
    ],
)
def test_sensors_that_the_twin_left_out_are_graded(
    sensor: str, status: str, seconds: float, grade: str
) -> None:
    answer = sensor_answer((), {(sensor, status): seconds}, 100.0)
    assert answer.grade == grade and sensor in answer.text


def test_pulse_widths_that_nobody_converted_are_bad(boat: Particulars, log: Log) -> None:
    cmd = log.cmd.copy()
    cmd[:, :2] = 1500.0 + 20.0 * cmd[:, :2]
    found = verdict_of(boat, dataclasses.replace(log, cmd=cmd))
    assert found.answers[4].grade == BAD and "commands excluded" in found.answers[4].text


@pytest.mark.parametrize(("aside", "begin"), [((11.0, 0.0), 90.0), ((-9.0, 9.0), 70.0)])
def test_fixes_that_the_twin_left_out_are_no_truth(
    boat: Particulars, log: Log, good: Verdict, aside: tuple[float, float], begin: float
) -> None:
    """A glitch of the receiver that the twin sees through spoils neither forecasts nor losses."""
    z = log.z.copy()
    z[(log.t >= begin) & (log.t < begin + 20.0), :2] += aside
    found = verdict_of(boat, dataclasses.replace(log, z=z), "dsw-ukf-plus")
    assert any("gps excluded" in note for note in found.notes)
    forecast, coverage, losses = found.answers[:3]
    assert BAD not in (forecast.grade, coverage.grade, losses.grade)
    # the glitch itself would be an error of its size
    assert forecast.numbers["displacement_m"] < good.answers[0].numbers["displacement_m"] + 2.0
    inside = [f for f in found.forecasts if begin < f.t < begin + 20.0]
    assert len(found.forecasts) < len(good.forecasts) and not inside


def test_a_long_log_has_evenly_spread_forecasts_of_a_bounded_number(
    boat: Particulars, log: Log, good: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log that reaches the bound just so keeps its forecasts; a longer one has the bound."""
    monkeypatch.setattr(trust, "FORECASTS_MAX", len(good.forecasts))
    assert verdict_of(boat, log, "dsw-ukf-plus").to_json() == good.to_json()
    monkeypatch.setattr(trust, "FORECASTS_MAX", 10)
    few = [each.t for each in verdict_of(boat, log, "dsw-ukf-plus").forecasts]
    assert 10 <= len(few) <= 11
    assert np.ptp(np.diff(few)) <= 2.0 * log.dt
    assert few[-1] >= good.forecasts[-1].t - 2.0
