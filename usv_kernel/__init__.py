"""What simulator and twin compile with: kernels, their cache, and functions that both need.

``usv_gym`` (the simulator) and ``twin`` both import this package; it imports neither.
"""

__version__ = "0.1.0"
