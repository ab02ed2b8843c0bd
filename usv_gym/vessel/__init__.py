"""Vessels: parameters, files, geometric models, and the vessels that ship with the package.

May import usv_gym.physics.
"""
