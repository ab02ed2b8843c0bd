"""The parameters of a vessel as kernels read them: one record with a named field for each.

They are the numbers of the vessel file in SI units. Nothing derived is stored.
:attr:`usv_gym.Vessel.packed` writes the record.
"""

from __future__ import annotations

import numpy as np

RESISTANCE_POINTS = 16
"""Capacity for the points of a resistance curve; unused ones repeat the last."""

KINDS = ("steerable_drive", "propeller_rudder", "thruster_pair")
"""Kinds of propulsion; the record holds the index in this list."""

STEERABLE_DRIVE, PROPELLER_RUDDER, THRUSTER_PAIR = 0, 1, 2

SCALARS = (
    # hull and mass
    "length_overall",  # m
    "length_waterline",  # m, the L of every primed coefficient
    "beam",  # m
    "draft",  # m, the d of every primed coefficient
    "block_coefficient",
    "water_density",  # kg/m3
    "mass",  # kg
    "x_G",  # m, centre of gravity forward of the origin
    "KG",  # m, centre of gravity above the keel
    "I_xx",  # kg m2, about the centre of gravity
    "I_yy",
    "I_zz",
    "m_x",  # kg, added mass in surge
    "m_y",  # kg, added mass in sway
    "J_zz",  # kg m2, added moment of inertia in yaw
    # heave, roll, pitch
    "A_wp",  # m2, water plane
    "x_F",  # m, its centre forward of the origin
    "GM_T",  # m
    "GM_L",  # m
    "m_z",  # kg, added mass in heave
    "J_xx",  # kg m2, added moments of inertia in roll and pitch
    "J_yy",
    "zeta_heave",  # shares of the critical damping
    "zeta_roll",
    "zeta_pitch",
    "z_H",  # m, where hull forces act below the water line
    # hull forces (primed)
    "R_0",
    "X_vv",
    "X_vr",
    "X_rr",
    "X_vvvv",
    "Y_v",
    "Y_r",
    "Y_vvv",
    "Y_vvr",
    "Y_vrr",
    "Y_rrr",
    "N_v",
    "N_r",
    "N_vvv",
    "N_vvr",
    "N_vrr",
    "N_rrr",
    "C_d_crossflow",
    # linear and square damping in SI units, above 0 where it brakes
    "D_u",  # kg/s
    "D_uu",  # kg/m
    "D_v",  # kg/s
    "D_vv",  # kg/m
    "D_r",  # kg m2/s
    "D_rr",  # kg m2
    "D_rrr",  # kg m2 s
    # propulsion of every kind
    "kind",  # place in KINDS
    "units",  # 1 or 2
    "propeller_diameter",  # m
    "k_0",  # K_T = k_0 + k_1 J + k_2 J^2
    "k_1",
    "k_2",
    "astern",  # thrust at rest astern over that ahead
    "wake_fraction",
    "thrust_deduction",
    "y_P",  # m, each of two units off the centre line
    "z_P",  # m, shafts below the water line
    "shaft_lag",  # s
    "shaft_rate",  # rev/s2
    "shaft_speed_max",  # rev/s
    "steer_lag",  # s
    "steer_rate",  # rad/s
    "steer_max",  # rad
    "A_R",  # m2, rudder, or leg of a drive as a foil; each
    "f_alpha",  # its lift gradient, 1/rad
    # steerable drive
    "x_P",  # m, drives forward of the origin (negative: aft)
    "slipstream",  # share of the ideal slipstream speed that the leg meets
    # propeller and MMG rudder; lengths over the ship's length
    "rudder_height",  # m
    "C_1",  # wake in drift
    "C_2_plus",  # for beta_P > 0
    "C_2_minus",
    "x_P_prime",
    "epsilon",
    "kappa",
    "l_R_prime",
    "gamma_R_plus",  # for beta_R > 0
    "gamma_R_minus",
    "t_R",
    "a_H",
    "x_H_prime",
    "x_R_prime",
    # wind (Blendermann)
    "A_F",  # m2, frontal
    "A_L",  # m2, lateral
    "s_L",  # m, lateral centre forward of midship
    "s_H",  # m, lateral centre above the water line
    "kappa_wind",  # of the heeling moment
    "CD_t",
    "CD_l_bow",
    "CD_l_stern",
    "delta_wind",
)

PARAMETERS = np.dtype(
    [(name, float) for name in SCALARS]
    + [
        ("resistance_speed", float, RESISTANCE_POINTS),  # m/s, increasing
        ("resistance_force", float, RESISTANCE_POINTS),  # N
        ("side_thrust", float, 2),  # thrust of the left and right unit over nominal, less 1
    ]
)
"""A vessel, as every kernel of the physics takes it."""
