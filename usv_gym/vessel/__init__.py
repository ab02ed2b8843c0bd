"""A vessel: its file, its hull shape, and the vessels that ship with the package.

May import usv_gym.physics.
"""
