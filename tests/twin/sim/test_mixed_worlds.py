"""Twins of boats that differ: they know the class, never the boat."""

import dataclasses

import numpy as np
import pytest

from twin import Twin
from twin.agents.agent import ControllerError
from twin.agents.controllers import make_controller
from twin.predictors.own_prior import prior_of_runs
from twin.predictors.registry import PredictorError
from twin.sim.bridge import particulars_of, simulate
from twin.sim.wrapper import make_env, make_vector_env
from usv_gym import SeaState, Vessel
from usv_kernel.errors import UsvTwinError


def test_twins_know_the_nominal_vessel_only() -> None:
    env = make_env(vessel="usv75|otter", vessel_spread=0.3, load=1.3, twin="ukf")
    for seed in range(6):
        drawn = env.reset(seed=seed)[1]["drawn"]
        nominal = Vessel.load(drawn["vessel"])
        assert env.twin.particulars == particulars_of(nominal)
        assert env.simulation.vessel_of(0).values["mass"] != nominal.values["mass"]
    envs = make_vector_env(4, vessel="usv75|otter", twin="ukf")
    for i, name in enumerate(envs.reset(seed=0)[1]["drawn"]["vessel"]):
        assert envs.twin(i).particulars == particulars_of(Vessel.load(name))


def test_how_much_of_its_boat_a_twin_knows() -> None:
    nominal = particulars_of(Vessel.load("usv75"))
    start = make_env(twin="dsw-ukf-plus").twin.estimate()
    calm = SeaState.named("0")
    log = simulate("zigzag", vessel=Vessel.load("usv75"), sea=calm, duration=40.0, seed=0)
    taught = Twin(nominal, "dsw-ukf-plus")
    taught.run(log.without_truth())
    own = dataclasses.replace(nominal, prior=prior_of_runs([taught.predictor]))
    sds = []
    for prior in ("boat", "class", "fleet"):
        options = {"twin": "dsw-ukf-plus", "particulars": own, "twin_prior": prior}
        twin = make_env(**options).twin
        sds.append(twin.estimate().params_sd)
        assert make_vector_env(2, **options).twin(1).particulars == twin.particulars
    np.testing.assert_array_equal(sds[1], start.params_sd)  # the default without an own prior
    thrust = list(twin.predictor.parameter_names).index("X_nn")
    assert sds[0][thrust] < sds[1][thrust] < sds[2][thrust]
    with pytest.raises(UsvTwinError, match="known: boat, class, fleet"):
        make_env(twin_prior="own")


def test_what_needs_one_boat_refuses_several() -> None:
    with pytest.raises(PredictorError, match="oracle is given the sea and the boat"):
        make_env(twin="oracle", vessel_spread=0.1)
    with pytest.raises(PredictorError, match="leave out the particulars"):
        make_env(vessel="usv75|otter", particulars=particulars_of(Vessel.load("otter")))
    with pytest.raises(PredictorError, match="identify different parameters"):
        make_env(vessel="usv75|otter", twin="ukf", observation="twin_params")
    envs = make_vector_env(2, vessel="usv75|otter")
    for name in ("los-twin", "mpc-twin"):
        with pytest.raises(ControllerError, match=r"one vessel|compiled twins"):
            make_controller(name).begin(envs)
