"""The benchmark: protocol, runner, metrics, report and figures.

May import twin.sim and below.
"""
