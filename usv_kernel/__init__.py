"""Compilation of numba kernels, their disk cache, and small functions for kernels.

``usv_gym`` (the simulator) and ``twin`` import this package; it imports neither.
"""

__version__ = "0.2.0"
