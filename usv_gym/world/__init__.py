"""What a vessel sails in: sea, sensors, and the simulation of both with the ship.

May import usv_gym.physics and usv_gym.vessel.
"""
