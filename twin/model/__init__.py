"""The twin's model: structure, dynamics, actuators, rollout, priors of its parameters.

May import twin.filters and below.
"""
