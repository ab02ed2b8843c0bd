"""Logs of boats: reading, checking, mapping, known data sets.

May import twin.channels, twin.particulars and twin.files.
"""
