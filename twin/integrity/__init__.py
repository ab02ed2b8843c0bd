"""Integrity: sensors and commands held against each other by one statistical engine.

May import filters, channels and particulars; no predictor.
"""
