"""The simulator: ship, sea, sensors, and the Gymnasium environment ``USVTwin-v0`` over them.

May import usv_kernel; never twin.
"""

from gymnasium.envs.registration import register, registry

from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.faults import Bursts, Fault, RandomFaults
from usv_gym.world.sea import SEA_STATES, SeaKeyframe, SeaState
from usv_gym.world.sensors import SensorSuite

__all__ = [
    "SEA_STATES",
    "Bursts",
    "Fault",
    "RandomFaults",
    "SeaKeyframe",
    "SeaState",
    "SensorSuite",
    "Vessel",
    "vessel_names",
]

MAX_EPISODE_STEPS = 2400

if "USVTwin-v0" not in registry:
    # The twin is named by a string: nothing of it is imported before gym.make.
    register(
        id="USVTwin-v0",
        entry_point="twin.sim.wrapper:make_env",
        vector_entry_point="twin.sim.wrapper:make_vector_env",
        max_episode_steps=MAX_EPISODE_STEPS,
        # the environment itself refuses a step before the reset
        order_enforce=False,
        disable_env_checker=True,
    )
