"""Hydrodynamics of hulls as data: tables over wave frequency and heading, and their motions.

May import usv_gym.physics and usv_kernel; it knows no vessel files. A script in
examples/hydrodynamics makes the tables.
"""
