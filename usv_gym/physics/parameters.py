"""The packed vessel: which number stands where in the flat vector that kernels read.

It holds the vessel file's numbers in SI units and nothing computed from them, so that there
is one truth for each. :attr:`usv_gym.Vessel.packed` writes it.
"""

from __future__ import annotations

RESISTANCE_POINTS = 16
"""Room for the points of a resistance curve; unused ones repeat the last."""

KINDS = ("steerable_drive", "propeller_rudder", "thruster_pair")
"""Kinds of propulsion; the packed vector holds the place in this list."""

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

INDEX = {name: i for i, name in enumerate(SCALARS)}

RESISTANCE_SPEEDS = len(SCALARS)

RESISTANCE_FORCES = RESISTANCE_SPEEDS + RESISTANCE_POINTS

PACKED_SIZE = RESISTANCE_FORCES + RESISTANCE_POINTS

LENGTH_OVERALL = INDEX["length_overall"]

LENGTH = INDEX["length_waterline"]

BEAM = INDEX["beam"]

DRAFT = INDEX["draft"]

BLOCK = INDEX["block_coefficient"]

DENSITY = INDEX["water_density"]

MASS = INDEX["mass"]

X_G = INDEX["x_G"]

KG = INDEX["KG"]

I_XX = INDEX["I_xx"]

I_YY = INDEX["I_yy"]

I_ZZ = INDEX["I_zz"]

M_X = INDEX["m_x"]

M_Y = INDEX["m_y"]

J_ZZ = INDEX["J_zz"]

A_WP = INDEX["A_wp"]

X_F = INDEX["x_F"]

GM_T = INDEX["GM_T"]

GM_L = INDEX["GM_L"]

M_Z = INDEX["m_z"]

J_XX = INDEX["J_xx"]

J_YY = INDEX["J_yy"]

ZETA_HEAVE = INDEX["zeta_heave"]

ZETA_ROLL = INDEX["zeta_roll"]

ZETA_PITCH = INDEX["zeta_pitch"]

Z_H = INDEX["z_H"]

R_0 = INDEX["R_0"]

X_VV = INDEX["X_vv"]

X_VR = INDEX["X_vr"]

X_RR = INDEX["X_rr"]

X_VVVV = INDEX["X_vvvv"]

Y_V = INDEX["Y_v"]

Y_R = INDEX["Y_r"]

Y_VVV = INDEX["Y_vvv"]

Y_VVR = INDEX["Y_vvr"]

Y_VRR = INDEX["Y_vrr"]

Y_RRR = INDEX["Y_rrr"]

N_V = INDEX["N_v"]

N_R = INDEX["N_r"]

N_VVV = INDEX["N_vvv"]

N_VVR = INDEX["N_vvr"]

N_VRR = INDEX["N_vrr"]

N_RRR = INDEX["N_rrr"]

CROSSFLOW = INDEX["C_d_crossflow"]

D_U = INDEX["D_u"]

D_UU = INDEX["D_uu"]

D_V = INDEX["D_v"]

D_VV = INDEX["D_vv"]

D_R = INDEX["D_r"]

D_RR = INDEX["D_rr"]

D_RRR = INDEX["D_rrr"]

KIND = INDEX["kind"]

UNITS = INDEX["units"]

DIAMETER = INDEX["propeller_diameter"]

K_0 = INDEX["k_0"]

K_1 = INDEX["k_1"]

K_2 = INDEX["k_2"]

ASTERN = INDEX["astern"]

WAKE = INDEX["wake_fraction"]

DEDUCTION = INDEX["thrust_deduction"]

Y_P = INDEX["y_P"]

Z_P = INDEX["z_P"]

SHAFT_LAG = INDEX["shaft_lag"]

SHAFT_RATE = INDEX["shaft_rate"]

SHAFT_MAX = INDEX["shaft_speed_max"]

STEER_LAG = INDEX["steer_lag"]

STEER_RATE = INDEX["steer_rate"]

STEER_MAX = INDEX["steer_max"]

A_R = INDEX["A_R"]

F_ALPHA = INDEX["f_alpha"]

X_P = INDEX["x_P"]

SLIPSTREAM = INDEX["slipstream"]

RUDDER_HEIGHT = INDEX["rudder_height"]

C_1 = INDEX["C_1"]

C_2_PLUS = INDEX["C_2_plus"]

C_2_MINUS = INDEX["C_2_minus"]

X_P_PRIME = INDEX["x_P_prime"]

EPSILON = INDEX["epsilon"]

KAPPA = INDEX["kappa"]

L_R_PRIME = INDEX["l_R_prime"]

GAMMA_R_PLUS = INDEX["gamma_R_plus"]

GAMMA_R_MINUS = INDEX["gamma_R_minus"]

T_R = INDEX["t_R"]

A_H = INDEX["a_H"]

X_H_PRIME = INDEX["x_H_prime"]

X_R_PRIME = INDEX["x_R_prime"]

A_F = INDEX["A_F"]

A_L = INDEX["A_L"]

S_L = INDEX["s_L"]

S_H = INDEX["s_H"]

KAPPA_WIND = INDEX["kappa_wind"]

CD_T = INDEX["CD_t"]

CD_L_BOW = INDEX["CD_l_bow"]

CD_L_STERN = INDEX["CD_l_stern"]

DELTA_WIND = INDEX["delta_wind"]
