"""The packed vessel: which number stands where in the flat vector that kernels read.

It holds the vessel file's numbers in SI units and nothing computed from them, so that there
is one truth for each. :meth:`usv_gym.Vessel.pack` writes it.
"""

from __future__ import annotations

RESISTANCE_POINTS = 16
"""Room for the points of a resistance curve; unused ones repeat the last."""

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
    "I_zz",  # kg m2, about the centre of gravity
    "m_x",  # kg, added mass in surge
    "m_y",  # kg, added mass in sway
    "J_zz",  # kg m2, added moment of inertia in yaw
    # hull forces (primed)
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
    # two propellers on steerable drives
    "propeller_diameter",  # m
    "k_0",  # K_T = k_0 + k_1 J + k_2 J^2
    "k_1",
    "k_2",
    "wake_fraction",
    "thrust_deduction",
    "x_P",  # m, drives forward of the origin (negative: aft)
    "y_P",  # m, each drive off the centre line
    "A_R",  # m2, leg of one drive as a foil
    "f_alpha",  # lift gradient of the leg, 1/rad
    "slipstream",  # share of the ideal slipstream speed that the leg meets
    "shaft_lag",  # s
    "shaft_speed_max",  # rev/s
    "steer_lag",  # s
    "steer_rate",  # rad/s
    "steer_max",  # rad
    # wind (Blendermann)
    "A_F",  # m2, frontal
    "A_L",  # m2, lateral
    "s_L",  # m, lateral centre forward of midship
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
I_ZZ = INDEX["I_zz"]
M_X = INDEX["m_x"]
M_Y = INDEX["m_y"]
J_ZZ = INDEX["J_zz"]
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
DIAMETER = INDEX["propeller_diameter"]
K_0 = INDEX["k_0"]
K_1 = INDEX["k_1"]
K_2 = INDEX["k_2"]
WAKE = INDEX["wake_fraction"]
DEDUCTION = INDEX["thrust_deduction"]
X_P = INDEX["x_P"]
Y_P = INDEX["y_P"]
A_R = INDEX["A_R"]
F_ALPHA = INDEX["f_alpha"]
SLIPSTREAM = INDEX["slipstream"]
SHAFT_LAG = INDEX["shaft_lag"]
SHAFT_MAX = INDEX["shaft_speed_max"]
STEER_LAG = INDEX["steer_lag"]
STEER_RATE = INDEX["steer_rate"]
STEER_MAX = INDEX["steer_max"]
A_F = INDEX["A_F"]
A_L = INDEX["A_L"]
S_L = INDEX["s_L"]
CD_T = INDEX["CD_t"]
CD_L_BOW = INDEX["CD_l_bow"]
CD_L_STERN = INDEX["CD_l_stern"]
DELTA_WIND = INDEX["delta_wind"]
