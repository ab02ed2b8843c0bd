"""The twin as the external navigation of an autopilot, which sails on when the GPS is lost.

What the autopilot says, when its EKF is to change its source, and what it is sent. ``link`` is for
a real boat, ``simulated`` for one of ``usv_gym.sitl``; the others run on board without either.
"""
