"""Detectors: what is wrong with a log, by family, with numbers and a remedy.

Pure numpy on arrays of times and samples. May import twin.channels, twin.particulars and
twin.logs.columns.
"""
