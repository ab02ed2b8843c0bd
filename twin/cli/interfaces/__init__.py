"""The commands that join ship and twin to other programs: ``sitl``, ``link`` and ``fmu``.

What they do is in ``usv_gym.sitl``, ``twin.live.external`` and ``usv_gym.cosimulation``; here are
options and print.
"""
