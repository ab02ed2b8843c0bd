"""Co-simulation: a vessel in its sea as a unit that other simulators run (FMI 2.0).

May import usv_gym.world and what lies below it.
"""
