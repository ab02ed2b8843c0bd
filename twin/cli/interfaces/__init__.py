"""The commands that join ship and twin to other programs: ``sitl`` and ``link``.

What they do is in ``usv_gym.sitl`` and ``twin.live.external``; here are options and print.
"""
