"""Which sensors can be trusted: each is held against the others, row by row.

On board: imports nothing of the simulator. ``state`` has the memory and the settings, ``checks`` the
kernels, ``monitor`` what users see.
"""
