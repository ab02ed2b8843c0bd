"""A vessel in its sea as a co-simulation unit (FMI 2.0).

    pythonfmu build -f ship_and_sea.py

Source: Modelica Association 2022, Functional Mock-up Interface 2.0.4.
"""

import math

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real

from usv_gym import SeaState
from usv_gym.world.simulation import Simulation

# what the unit simulates
VESSEL = "usv75"
SEA = SeaState.named("2")
DEGREES_OF_FREEDOM = 3
STEP_S = 0.05

INPUTS = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
OUTPUTS = (
    *("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "psi_rad"),
    *("u_mps", "v_mps", "w_mps", "p_radps", "q_radps", "r_radps"),
    *("shaft_left_rps", "shaft_right_rps", "drive_left_rad", "drive_right_rad"),
)
PARAMETERS = {
    "hs_m": SEA.hs,
    "wind_mps": SEA.wind,
    "wind_from_rad": SEA.wind_from,
    "current_mps": SEA.current,
    "current_to_rad": SEA.current_to,
}


class ShipAndSea(Fmi2Slave):
    """The unit: shaft speeds and drive angles in, the state of the ship out."""

    author = "usv-twin"
    description = "A vessel in its sea"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name in (*INPUTS, *OUTPUTS):
            setattr(self, name, 0.0)
        for name, value in PARAMETERS.items():
            setattr(self, name, float(value))
        self.seed = 0
        for name in INPUTS:
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in OUTPUTS:
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        for name in PARAMETERS:
            self.register_variable(Real(name, **fixed))
        self.register_variable(Integer("seed", **fixed))

    def exit_initialization_mode(self):
        sea = SEA.replace(
            hs=self.hs_m,
            wind=self.wind_mps,
            wind_from=self.wind_from_rad,
            current=self.current_mps,
            current_to=self.current_to_rad,
        )
        self.simulation = Simulation(1, VESSEL, sea, dof=DEGREES_OF_FREEDOM, dt=STEP_S)
        # the sea of `usv-twin simulate` with the same seed
        self.simulation.reset([0], [np.random.default_rng(self.seed).spawn(2)[0]])
        self.show()

    def do_step(self, current_time, step_size):
        steps = round(step_size / STEP_S)
        if not (steps and math.isclose(steps * STEP_S, step_size, rel_tol=1e-6)):
            raise ValueError(f"step {step_size} s: must be a whole multiple of {STEP_S} s")
        command = np.array([[getattr(self, name) for name in INPUTS]])
        for _ in range(steps):
            self.simulation.step(command)
        self.show()
        return True

    def show(self):
        for name, value in zip(OUTPUTS, self.simulation.state[0].tolist(), strict=True):
            setattr(self, name, value)
