"""A first mapping file for a log of unknown columns, from their names and values.

May be imported by ``twin.cli``; imports readers, dates and ``twin.logs.checks``.
"""
