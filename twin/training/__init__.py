"""Offline fitting: priors from a population of boats, networks for many boats.

May import twin.sim and below.
"""
