"""Which sensors can be trusted: each is held against the others, row by row.

``monitor`` has what users see, ``checks`` the order of the checks, ``state`` memory and settings;
each other module holds one pair of sensors against each other.
On board: imports nothing of the simulator.
"""
