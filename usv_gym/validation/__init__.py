"""Validation of ship and sea, for ``usv-twin validate``.

May import everything else in usv_gym.
"""
