"""Commands that take a log: check it, map it, identify and predict from it, send it.

May import all of twin but the other commands.
"""
