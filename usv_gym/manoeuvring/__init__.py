"""Standard manoeuvres and trials, their indices, and responses to waves.

May import usv_gym.physics, vessel and world.
"""
