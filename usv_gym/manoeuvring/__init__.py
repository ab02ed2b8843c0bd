"""Timed manoeuvres, and a survey by an autopilot.

May import usv_gym.physics, vessel and world.
"""
