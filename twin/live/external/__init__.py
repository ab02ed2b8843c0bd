"""The twin as the external navigation of an autopilot, which sails on when the GPS is lost.

What the autopilot says, when its EKF is to change its source, and what it is sent. Runs with a
real boat, and beside ``usv_gym.sitl``; all but ``simulated`` imports no simulator.
"""
