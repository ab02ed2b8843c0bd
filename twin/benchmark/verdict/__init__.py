"""What a benchmark says first: one line for each predictor, recorded runs, and ends of losses.

May import what ``twin.benchmark`` may; the runner, the report and the command import from here.
"""
