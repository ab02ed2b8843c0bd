"""Filters as such: UKF, navigation filter, late measurements, small linear algebra.

May import twin.logs, twin.channels and twin.particulars.
"""
