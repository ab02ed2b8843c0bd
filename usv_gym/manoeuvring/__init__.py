"""Manoeuvres, standard trials and their indices, and responses to waves.

May import usv_gym.physics, vessel and world.
"""
