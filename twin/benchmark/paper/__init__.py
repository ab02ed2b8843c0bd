"""The paper redone: its tables and figures beside those of this package.

``usv-twin paper`` runs it. May import the benchmark and what that may.
"""
