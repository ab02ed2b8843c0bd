"""Hydrodynamics of hulls as data: tables over wave frequency and heading, and their motions.

May import usv_gym.physics and usv_kernel; it knows no vessel files. What makes a table from a
vessel's mesh is :mod:`usv_gym.design.panels`.
"""
