"""The command line ``usv-twin``, one file a command.

May import everything else in twin.
"""
