"""Measurements of speed, for ``usv-twin bench``.

May import twin.sim and below.
"""
