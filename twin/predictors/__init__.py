"""Predictors by name, from persistence to DSW-UKF+.

May import twin.identification and below.
"""
