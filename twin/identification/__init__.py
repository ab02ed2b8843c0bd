"""How model parameters are found: joint UKF, refit, window, waves, identifiability.

May import twin.model and below.
"""
