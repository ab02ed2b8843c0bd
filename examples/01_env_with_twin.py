"""Run USVTwin-v0 with its twin, lose the GPS for 10 s, and grade the twin against the truth."""

import gymnasium as gym
import numpy as np

import usv_gym

faults = [usv_gym.Fault("gps", start=20.0, duration=10.0)]
env = gym.make("USVTwin-v0", sea="2", faults=faults)
obs, info = env.reset(seed=1)
names = env.unwrapped.observation_names
for step in range(800):
    # steer back to the leg, by the twin's estimate alone
    seen = dict(zip(names, obs.tolist(), strict=True))
    course = np.arctan2(seen["twin_sin_course_error"], seen["twin_cos_course_error"])
    drive = 1.5 * course - 0.6 * seen["twin_cross_track"] - 0.5 * seen["twin_yaw_rate"]
    action = np.array([0.8, np.clip(drive, -1.0, 1.0)], dtype=np.float32)
    obs, reward, terminated, truncated, info = env.step(action)
    if step % 100 == 99:
        print(
            f"t = {info['t_s']:5.1f} s  GPS age {10 * seen['gps_age']:4.1f} s  "
            f"cross-track error {info['cross_track_m']:5.1f} m  "
            f"position error of the twin {info['twin_position_error_m']:.1f} m"
        )
    if terminated or truncated:
        break
env.close()
