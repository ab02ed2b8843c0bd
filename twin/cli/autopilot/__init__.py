"""The commands with an autopilot at the other end: ``sitl`` and ``link``.

What they do is in ``usv_gym.sitl`` and ``twin.live.external``; here are options and print.
"""
