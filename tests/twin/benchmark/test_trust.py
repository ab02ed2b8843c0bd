"""Whether a twin may be trusted: scores, colours, and the faults that they are for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from twin import Log, Particulars, Prediction, Twin
from twin.benchmark.trust import (
    AMBER,
    GREEN,
    RED,
    Answer,
    GpsLoss,
    ScoredForecast,
    TrustMeter,
    Verdict,
    position_bound,
    worst_of,
)
from twin.benchmark.trust_answers import (
    HealthCount,
    other_boat,
    parameter_answer,
    sensor_answer,
    speed_ratio,
    with_parameters_in_use,
)
from twin.cli.logs.judge_picture import draw_verdict
from twin.identification.data_weight import CHOSEN, PRIOR
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.integrity.log_check import check_recording
from twin.integrity.monitor import SensorStatus
from twin.logs.recording import Recording
from twin.motion.tilt_meter import TiltScore
from twin.predictors.base import ParametersInUse
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.ukf import UKFPredictor
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel


@pytest.fixture(scope="module")
def boat() -> Particulars:
    return dataclasses.replace(particulars_of(Vessel.load("usv75")), design="")


def simulated(seed: int) -> Log:
    """Return 150 s of random commands in a slight sea, without truth."""
    return simulate(
        "random",
        vessel=Vessel.load("usv75"),
        sea=SeaState(hs=0.3, wind=3.0),
        duration=150.0,
        seed=seed,
    ).without_truth()


@pytest.fixture(scope="module")
def log() -> Log:
    return simulated(6)


def verdict_of(about: Particulars, log: Log, predictor: str = "ukf") -> Verdict:
    twin = Twin(about, predictor)
    meter = TrustMeter(twin, log)
    twin.run(log, meter)
    return meter.verdict()


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


def test_a_prior_in_use_is_amber_and_names_itself(ran: TrustMeter, log: Log) -> None:
    found = ran.verdict()
    answer = found.answers[3]
    assert answer.colour == AMBER
    assert answer.text.startswith(
        "in use: the prior, as no refit forecasts better; the best refit: all within 4"
    )
    assert found.deviations[0][1] > 0.1, "of the best refit, not of the prior from itself"
    assert found.to_json()["parameters_in_use"].startswith("the prior")
    predictor = ran.twin.predictor
    assert predictor.identifiability().informed == ()  # type: ignore[union-attr]
    assert draw_verdict(found, log).startswith(b"\x89PNG")
    untried = dataclasses.replace(found, in_use=ParametersInUse("the prior", True))
    assert draw_verdict(untried, log) != draw_verdict(found, log)


def test_the_boats_own_prior_in_use_may_be_green(ran: TrustMeter) -> None:
    in_use, green = ran.twin.predictor.parameters_in_use(), Answer("parameters", GREEN, "fine")
    assert with_parameters_in_use(green, in_use, own_prior=True).colour == GREEN
    assert with_parameters_in_use(green, in_use, own_prior=False).colour == AMBER
    assert with_parameters_in_use(green, None, own_prior=False) is green


def test_a_twin_before_its_first_refit_says_so(boat: Particulars, log: Log) -> None:
    answer = verdict_of(boat, log.slice(0.0, 5.0), "dsw-ukf-plus").answers[3]
    assert (
        answer.colour == AMBER and "too little usable data for a refit; no refit yet" in answer.text
    )


def test_the_candidate_in_use_is_named(good: Verdict) -> None:
    assert good.in_use is not None and not good.in_use.is_prior
    assert good.answers[3].text.endswith(f"; in use: {good.in_use.name}")


def test_far_from_its_own_prior_the_boat_has_changed() -> None:
    far = [("X_nu", 4.4)]
    assert "wrong boat" in parameter_answer(far, []).text
    text = parameter_answer(far, [], own_prior=True).text
    assert "wrong boat" not in text and "has the boat changed (load, hull" in text


def test_of_runs_of_one_colour_the_worst_number_is_shown(good: Verdict) -> None:
    def run(log: str, ratio: float, colour: str = GREEN) -> Verdict:
        answer = Answer("forecast", colour, f"ratio {ratio}", {}, (ratio,))
        return dataclasses.replace(good, log=log, answers=(answer,))

    runs = [run("a", 0.2), run("b", 0.8), run("c", 0.5)]
    assert worst_of(runs).answers[0].text == "ratio 0.8 [of b; all 3 runs green]"
    amber = worst_of([*runs, run("d", 0.1, AMBER)]).answers[0]
    assert amber.text == "ratio 0.1 [of d; 1 of 4 runs amber]"


def test_what_made_a_forecast_amber_is_said(boat: Particulars, log: Log) -> None:
    meter = TrustMeter(Twin(boat, "ukf"), log)

    def text(seconds: float, heading: float) -> str:
        times = np.arange(0.0, seconds + 1.0, 2.0)
        errors = (1.0, heading), (9.0, 1.0), (True, heading < 2.0)
        meter.forecasts = [ScoredForecast(t, np.zeros((1, 2)), *errors) for t in times]
        return "; ".join(answer.text for answer in meter.verdict().answers[:2])

    assert "times persistence" not in text(100.0, 0.5)
    assert "heading 1.050 times persistence (green up to 0.9, red above 1.1);" in text(100.0, 1.05)
    short = text(24.0, 2.5)
    assert "heading 2.500 times persistence (green up to 0.9, red above 1.1), over 24 s" in short
    assert "24 s: too few to judge" in short and "headings below 50%, over 24 s: too few" in short


def test_a_good_twin_is_green_in_five_answers(good: Verdict) -> None:
    abouts = ["forecast", "coverage", "without GPS", "parameters", "sensors"]
    assert [answer.about for answer in good.answers] == abouts
    assert [answer.colour for answer in good.answers] == [GREEN] * 5
    assert good.colour == GREEN
    numbers = good.answers[0].numbers
    assert numbers["displacement_m"] < 0.5 * numbers["persistence_displacement_m"]
    assert numbers["n"] == len(good.forecasts) == 41
    assert len(good.losses) == 8 and all(loss.t >= 74.0 for loss in good.losses)
    assert all(loss.after[-1] == pytest.approx(60.0, abs=1.0) for loss in good.losses)


def test_good_twins_are_never_red_and_mostly_green(boat: Particulars) -> None:
    colours = [verdict_of(boat, simulated(seed), "dsw-ukf-plus").colour for seed in range(4, 12)]
    assert RED not in colours and colours.count(GREEN) >= 6, colours


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


def test_wrong_and_certain_forecasts_are_red(boat: Particulars, log: Log) -> None:
    twin = Twin(boat, Sure(boat))
    meter = TrustMeter(twin, log)
    twin.run(log, meter)
    answers = {answer.about: answer for answer in meter.verdict().answers}
    assert answers["coverage"].colour == RED
    assert answers["coverage"].numbers["position"] < 0.1
    assert answers["forecast"].numbers["displacement_m"] > 20.0
    assert meter.verdict().colour == RED


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
    assert found.answers[3].colour in (AMBER, RED)
    assert "wrong boat" in found.answers[3].text
    assert good.answers[3].numbers["far"] == {}


def test_parameters_alone_are_never_red(boat: Particulars, log: Log) -> None:
    twin = Twin(boat, "dsw-ukf-plus")
    meter = TrustMeter(twin, log)
    meter.prior = dataclasses.replace(meter.prior, params_sd=0.02 * meter.prior.params_sd)
    twin.run(log, meter)
    found = meter.verdict()
    assert [answer.colour for answer in found.answers[:3]] == [GREEN] * 3
    assert len(found.answers[3].numbers["far"]) > 4
    assert found.answers[3].colour == AMBER


def clean(vessel: str, manoeuvre: str, seed: int, hs: float = 0.1) -> Verdict:
    """Return the verdict on 200 s of a simulated boat whose particulars are right."""
    ship = Vessel.load(vessel)
    sea = SeaState(hs=hs, wind=3.0 if hs else 0.0)
    run = simulate(manoeuvre, vessel=ship, sea=sea, duration=200.0, seed=seed)
    return verdict_of(particulars_of(ship), run.without_truth(), "dsw-ukf-plus")


@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
def test_a_clean_catamaran_is_green(vessel: str, manoeuvre: str) -> None:
    """Its drag over displacement is several times that of the rough prior."""
    found = clean(vessel, manoeuvre, 1)
    assert found.answers[3].numbers["drag"] > 2.0
    assert "times the drag" in found.answers[3].text
    assert found.colour == GREEN, [answer.text for answer in found.answers]


def test_a_steady_turn_in_calm_water_is_green() -> None:
    """There persistence is as good as the sensors, and no twin can be better."""
    found = clean("otter", "turn", 1, hs=0.0)
    numbers = found.answers[0].numbers
    assert numbers["displacement_m"] > 0.9 * numbers["persistence_displacement_m"]
    assert found.colour == GREEN, [answer.text for answer in found.answers]


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

    def colour(seconds: float, share: float) -> str:
        count = int(seconds / 2.0)
        inside = np.arange(count) < share * count
        meter.forecasts = [
            ScoredForecast(2.0 * k, np.zeros((1, 2)), (0.1, 0.1), (9.0, 9.0), (bool(ok), True))
            for k, ok in enumerate(inside)
        ]
        return meter.verdict().answers[1].colour

    assert colour(130.0, 0.71) == GREEN
    assert colour(130.0, 0.6) == AMBER
    assert colour(1300.0, 0.71) == AMBER
    assert colour(130.0, 0.4) == RED


def test_reversed_steering_shows_in_a_sign(boat: Particulars, log: Log) -> None:
    cmd = log.cmd.copy()
    cmd[:, 2:] *= -1.0
    found = verdict_of(boat, dataclasses.replace(log, cmd=cmd), "dsw-ukf-plus")
    answer = found.answers[3]
    assert answer.numbers["sign"] or answer.numbers["far"]
    assert answer.colour != GREEN


def test_findings_of_the_log_check_colour_the_sensors(boat: Particulars, log: Log) -> None:
    meter = TrustMeter(Twin(boat, "ukf"), log)
    for severity, colour in ((NOTE, GREEN), (WARNING, AMBER), (ERROR, RED)):
        answer = meter.verdict([Finding(severity, "gyro-sign", "mirrored", "")]).answers[4]
        assert answer.colour == colour
        assert ("mirrored; see usv-twin log check" in answer.text) == (severity != NOTE)


def test_findings_are_said_in_words_sorted_by_consequence() -> None:
    late = [Finding(WARNING, code, f"{code} in words", "") for code in ("jitter", "lost")]
    offset = Finding(WARNING, "offset", "compass is off", "", "compass")
    moment = Finding(WARNING, "contradiction", "gyro disagrees", "", "gyro")
    error = Finding(ERROR, "unit", "wrong unit", "", "shafts")
    said = sensor_answer([*late, moment, offset]).text
    assert said == "compass is off; gyro disagrees; and 2 more: see usv-twin log check"
    said = sensor_answer([*late, moment, offset, error]).text
    assert said == "wrong unit; compass is off; and 3 more: see usv-twin log check"
    assert sensor_answer(late[:1]).text == "jitter in words; see usv-twin log check"


def test_an_unknown_compass_offset_is_said(boat: Particulars, log: Log) -> None:
    def said(until: float) -> tuple[Answer, list[Finding]]:
        some = log.slice(0.0, until)
        found = check_recording(Recording(some.t, some.z, some.cmd, some.t), boat).findings
        unknown = [f for f in found if f.code == "unchecked" and f.sensor == "compass"]
        return sensor_answer(found), unknown

    answer, unknown = said(20.0)
    assert len(unknown) == 1 and unknown[0].what in answer.text
    assert answer.colour == GREEN, answer.text
    assert said(150.0)[1] == []


def test_sensors_that_the_twin_left_out_colour_the_sensors(boat: Particulars, log: Log) -> None:
    def colour(sensor: str, status: str, seconds: float) -> str:
        health = HealthCount()
        for k in range(100):
            now = SensorStatus(status if k < seconds else "ok", 0.0, f"{sensor} why")
            health.take(1.0, {sensor: now})
        answer = sensor_answer((), health)
        assert (f"{sensor} {status} for {seconds:.0f} s" in answer.text) and "why" in answer.text
        return answer.colour

    assert colour("commands", "excluded", 100.0) == RED
    assert colour("commands", "excluded", 30.0) == AMBER
    assert colour("gyro", "excluded", 100.0) == AMBER
    assert colour("compass", "excluded", 3.0) == GREEN
    assert colour("commands", "doubtful", 30.0) == AMBER
    # pulse widths that nobody converted
    cmd = log.cmd.copy()
    cmd[:, :2] = 1500.0 + 20.0 * cmd[:, :2]
    found = verdict_of(boat, dataclasses.replace(log, cmd=cmd))
    assert found.answers[4].colour == RED and "commands excluded for" in found.answers[4].text
    assert "commands excluded" in found.fault


def test_boats_of_other_speed_or_steering_are_found(boat: Particulars, log: Log) -> None:
    assert other_boat(log, boat) == []
    assert speed_ratio(log, boat) == pytest.approx(1.0, abs=0.2)
    for factor in (0.2, 3.0):
        wrong = dataclasses.replace(boat, speed=factor * boat.speed)
        (said,) = other_boat(log, wrong)
        assert f"goes {speed_ratio(log, wrong):.2g} times as fast" in said
        assert parameter_answer([("X_u", 1.0)], [], 1.0, [said]).colour == AMBER
    cmd = log.cmd.copy()
    cmd[:, 2:], cmd[:, 0] = 0.0, 0.5 * cmd[:, 0]
    (said,) = other_boat(dataclasses.replace(log, cmd=cmd), boat)
    assert "no angle moves" in said
    assert speed_ratio(log.slice(0.0, 10.0), boat) is None


def test_short_logs_cannot_tell(boat: Particulars, log: Log) -> None:
    found = verdict_of(boat, log.slice(0.0, 9.0))
    assert [answer.colour for answer in found.answers[:3]] == [AMBER] * 3
    assert all("cannot tell" in answer.text for answer in found.answers[:3])
    assert found.colour == AMBER
    found.to_json()


def test_few_bad_forecasts_are_amber_not_red(boat: Particulars, log: Log) -> None:
    twin = Twin(boat, Sure(boat))
    short = log.slice(0.0, 20.0)
    meter = TrustMeter(twin, short)
    twin.run(short, meter)
    forecast, coverage, losses = meter.verdict().answers[:3]
    assert coverage.numbers["position"] == 0.0 and "1 forecast)" in coverage.text
    assert [forecast.colour, coverage.colour, losses.colour] == [AMBER] * 3
    assert "too short" in losses.text


def test_logs_without_fixes_cannot_tell(boat: Particulars, log: Log) -> None:
    z = log.z.copy()
    z[:, :4] = np.nan
    found = verdict_of(boat, dataclasses.replace(log, z=z))
    assert [answer.colour for answer in found.answers[:4]] == [AMBER] * 4
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
    assert answer(5.0, 20.0, 99.0, 99.0).colour == AMBER
    assert "within 6.34 m for at least 60 s" in answer(5.0, 99.0, 99.0).text
    assert answer(5.0, 99.0, 99.0).colour == GREEN
    assert answer(5.0, 8.0, 99.0).colour == RED


def test_twins_without_parameters_are_scored_too(boat: Particulars, log: Log) -> None:
    found = verdict_of(boat, log, "persistence")
    numbers = found.answers[0].numbers
    assert numbers["displacement_m"] == pytest.approx(numbers["persistence_displacement_m"])
    assert found.answers[3].text == "the predictor has none"


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


def test_few_bad_forecasts_of_roll_are_amber_and_many_are_red(
    rolling_boat: Particulars, rolling_log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = np.array([0.3, 0.3])
    twin = Twin(rolling_boat, "persistence")
    twin.run(rolling_log.slice(0.0, 1.0))
    for seconds, colour in ((6.0, AMBER), (59.0, AMBER), (61.0, RED)):
        meter = TrustMeter(twin, rolling_log)
        score = TiltScore(9, seconds, bad, 0.5 * bad, 0.01 * bad, 0.2 * bad)
        monkeypatch.setattr(meter._tilt, "score", lambda score=score: score)
        answer = meter.verdict().answers[-1]
        assert (answer.about, answer.colour) == ("attitude", colour)
        assert ("too few to judge" in answer.text) == (colour == AMBER)


def test_forecasts_of_roll_and_pitch_are_a_sixth_answer(rolling: Verdict) -> None:
    answer = rolling.answers[-1]
    assert (answer.about, answer.colour) == ("attitude", GREEN)
    numbers = answer.numbers
    assert (np.array(numbers["error"]) < 0.9 * np.array(numbers["held"])).all()
    assert 0.7 < min(numbers["inside"]) <= 1.0
    assert numbers["n"] > 20


def test_the_worst_of_runs_with_and_without_roll_has_all_answers(
    good: Verdict, rolling: Verdict
) -> None:
    found = worst_of([good, rolling])
    assert [answer.about for answer in found.answers] == [a.about for a in rolling.answers]
    assert f"[of {rolling.log}]" in found.answers[-1].text
    assert "all 2 runs green]" in found.answers[0].text
