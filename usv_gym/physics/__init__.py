"""The physics of ship and sea: plain compiled functions of arrays.

May import usv_kernel and nothing else of the project.

Notation, signs and units of every file in this folder
=======================================================

Frames
    Earth: north-east-down (NED), x north, y east, z down. Body: x forward, y starboard, z down,
    origin in the still water line. It is at midship or at the length of the centre of gravity
    (``x_G`` of the vessel file says which). psi is clockwise from north; r > 0 turns to starboard,
    phi > 0 is starboard down, theta > 0 is bow up.
State (16 numbers, indices in :mod:`~usv_gym.physics.frames`)
    ``eta = (x, y, z, phi, theta, psi)`` in m and rad,
    ``nu = (u, v, w, p, q, r)`` over the ground in m/s and rad/s,
    actuators ``(n_left, n_right, delta_left, delta_right)`` in rev/s and rad.
Command ``cmd`` (4 numbers)
    ``(n_left, n_right, delta_left, delta_right)``: commanded shaft speeds and angles.
    delta > 0 turns to starboard (the paper's Eq 10 has it the other way round).
Forces
    Suffix names the part: ``X_H Y_H N_H`` hull, ``_P`` propulsion, ``_wind``, ``_wave``.
    Coefficients as printed in the literature (``Y_v``, ``N_r``); primed values of the MMG
    standard method are made dimensionless with ``1/2 rho L d U^2`` (and ``L`` for moments).
Directions
    ``wind_from`` (where it comes from), ``wave_to`` and ``current_to`` (where it goes),
    clockwise from north.
Units
    SI and radians; shaft speed in rev/s.
Equation numbers
    Those of Qu et al. 2025, J. Mar. Sci. Eng. 13(5) 932, with its misprints mended.

Order of reading: frames, parameters, hull, propulsion, spectra, wind, waves, weather,
rigid_body, ship.
What happens in a step is behind :mod:`~usv_gym.physics.ship`; :mod:`~usv_gym.world.sea` draws what
it sails in.
"""

GRAVITY = 9.80665
"""Standard gravity, m/s2."""
KNOT = 1852.0 / 3600.0
"""One knot in m/s."""
AIR_DENSITY = 1.224
"""kg/m3, at 15 degrees and sea level."""
