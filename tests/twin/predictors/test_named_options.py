"""Options in the names of predictors: read, checked, and kept wherever a name goes."""

import json

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from twin import Twin
from twin.benchmark.protocol import Settings, Unit
from twin.benchmark.runner import result_file, run_unit
from twin.cli.common import OptionError, parse_predictors
from twin.predictors.named_options import OptionTextError, split_name, split_names
from twin.predictors.registry import (
    PREDICTORS,
    PredictorError,
    base_name,
    options_of,
    predictor_class,
)
from usv_kernel.errors import ArgumentError, UsvTwinError

PRINTED = {"adapt": "literal", "adapts": "QR", "feedback": False, "window": "dynamic"}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("dsw-ukf", {}),
        ("dsw-ukf:window=off,adapt=literal", {"window": "off", "adapt": "literal"}),
        ("dsw-ukf: window = off , stride = 3", {"window": "off", "stride": 3}),
        ("dsw-ukf:feedback=no,x0=0.2,n_unit=none", {"feedback": False, "x0": 0.2, "n_unit": None}),
        ("dsw-ukf:n_unit=1", {"n_unit": 1.0}),
        ("dsw-ukf:printed", PRINTED),
        ("dsw-ukf:printed,window=off", {**PRINTED, "window": "off"}),
        ("ukf:model=mmg", {"model": "mmg"}),
        ("dsw-ukf-plus:draws=20,period=2", {"draws": 20, "period": 2.0}),
    ],
)
def test_options_in_a_name_have_the_types_of_the_class(name, options):
    found = options_of(name)
    assert found == options
    assert {key: type(value) for key, value in found.items()} == {
        key: type(value) for key, value in options.items()
    }
    assert predictor_class(name) is predictor_class(base_name(name))


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("dsw-ukf:windw=off", ArgumentError, r"no option 'windw' \(did you mean 'window'\?\); its"),
        (
            "dsw-ukf:printd",
            OptionTextError,
            r"'printd' .*did you mean 'printed'.*options: model, f",
        ),
        ("ukf:printed", OptionTextError, "its options: model, settings; it has no preset"),
        ("dsw-ukf:", OptionTextError, "'' is no option as key=value"),
        ("dsw-ukf:window=off,printed", OptionTextError, "presets, which stand first: printed"),
        ("dsw-ukf:window=off,window=fixed", OptionTextError, "window is given twice"),
        ("dsw-ukf:feedback=maybe", OptionTextError, "'maybe' must be one of true, on, yes, false"),
        ("dsw-ukf:stride=2.5", OptionTextError, r"stride = '2.5' must be a whole number"),
        ("dsw-ukf:adapt_gain=much", OptionTextError, "adapt_gain = 'much' must be a number"),
        ("ukf:settings=3", OptionTextError, "FilterSettings.* has no text; hand it to"),
        ("ukf:seed=3", ArgumentError, "no option 'seed'"),
        ("dsw:window=off", PredictorError, r"no predictor is called 'dsw' \(did you mean"),
        ("persistence:model=mmg", ArgumentError, "no option 'model'"),
    ],
)
def test_wrong_options_in_a_name_say_what_is_legal(name, error, words):
    with pytest.raises(error, match=words):
        predictor_class(name)


def test_names_of_modules_take_options_after_the_class():
    assert split_name("a.b:Mine", PREDICTORS) == ("a.b:Mine", None)
    assert split_name("a.b:Mine:gain=2", PREDICTORS) == ("a.b:Mine", "gain=2")
    name = "twin.predictors.dsw_ukf:DSWPredictor:printed,window=off"
    assert options_of(name) == {**PRINTED, "window": "off"}


def test_lists_keep_options_with_the_predictor_before_them():
    text = "ukf, dsw-ukf:window=off,adapt=literal,lstm,mod:Mine:a=1,b=2,ukf,dsw-ukf:printed"
    assert parse_predictors(text) == (
        "ukf",
        "dsw-ukf:window=off,adapt=literal",
        "lstm",
        "mod:Mine:a=1,b=2",
        "dsw-ukf:printed",
    )
    with pytest.raises(OptionTextError, match=r"model=mmg: .* write ukf:model=mmg"):
        split_names("ukf,model=mmg")
    with pytest.raises(OptionError, match="--predictors: name at least one"):
        parse_predictors(" , ")


def test_saved_twins_keep_the_options_of_their_name(boat, zigzag, tmp_path):
    name = "dsw-ukf:printed,window=off"
    twin = Twin(boat, name)
    twin.run(zigzag.slice(0.0, 3.0))
    twin.save(tmp_path / "boat.twin")
    again = Twin.load(tmp_path / "boat.twin")
    assert again.name == name and again.predictor.use == "off" and again.predictor.adapt != "off"
    rest = zigzag.slice(3.0, 5.0)
    twin.run(rest), again.run(rest)
    np.testing.assert_array_equal(twin.predict("hold").mean, again.predict("hold").mean)
    given = Twin(boat, "dsw-ukf", **options_of(name))
    given.run(zigzag.slice(0.0, 5.0))
    np.testing.assert_array_equal(twin.predict("hold").mean, given.predict("hold").mean)


def test_benchmark_scores_and_keeps_variants_apart(tmp_path):
    names = ("persistence", "dsw-ukf:window=off", "dsw-ukf")
    settings = Settings(
        scenarios=("turn",), faults=("none",), seeds=(0,), predictors=names, plans=("known",),
        identify_s=6.0, duration_s=18.0,
    )  # fmt: skip
    files, errors = set(), []
    for name in names[1:]:
        unit = Unit("turn", "none", 0, name)
        result = run_unit(settings, unit, tmp_path, pictures=False)
        file = result_file(settings, unit, tmp_path)
        assert json.loads(file.read_text())["content"]["unit"]["predictor"] == name
        files.add(file)
        errors.append(json.dumps(result["plans"]["known"]))
    assert len(files) == 2 and errors[0] != errors[1]
    long = "dsw-ukf:" + ",".join(f"x0=0.{k}" for k in range(100))
    other = result_file(settings, Unit("turn", "none", 0, long + "1"), tmp_path)
    assert len(other.name) < 255
    assert other != result_file(settings, Unit("turn", "none", 0, long), tmp_path)


def test_environments_take_options_in_the_name():
    many = gym.make_vec("USVTwin-v0", num_envs=2, twin="ukf:model=paper")
    many.reset(seed=[3, 4])
    assert many.twin(1).name == "ukf:model=paper"
    many.close()
    with pytest.raises(UsvTwinError, match="no option"):
        gym.make("USVTwin-v0", twin="ukf:nope=1")
