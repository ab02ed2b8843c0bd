"""Controllers and trained agents, and the study that compares them.

May import twin.sim and below.
"""
