"""Numbers that Qu et al. 2025 print: Tables 2, 3 and 4, and what the text says of the figures."""

import numpy as np

# fmt: off
PAPER_TABLE_2 = np.array([
    -0.01933487, -0.13319095, 0.47497131, 0.02046881, 0.00750947, 0.00750947, 0.14275839,
    -0.13801318, -0.10806983, -0.34930751, 0.17874066, 0.05575388, 0.58329755, 0.13710593,
    -0.07592142, -0.01698518, 0.03176391, -0.17702271, -0.04692461, 0.17730327, 0.07858179,
    0.11225423, 0.08986971, 0.00568659, 0.00568859,
])
"""Table 2, from a 20 degree turn, in the order of the structure ``paper``; it is unstable."""

PAPER_TABLE_3 = np.array([
    -0.01520207, 0.87067625, 0.85951994, -0.09341181, 0.01141719, 0.01141719, -0.01204963,
    -0.07585661, -0.53618141, -0.32916798, 0.30233231, 0.13383581, 0.32354393, 0.01002316,
    0.00686091, -0.00045943, 0.04981479, -0.29850031, -0.06855151, -0.06284036, -0.09460934,
    0.14198421, 0.10663989, 0.00136872, 0.00107281,
])
"""Table 3, from a 20/-20 degree zigzag; it speeds up in turns."""
# fmt: on

TABLES = {"turn": ("Table 2", PAPER_TABLE_2), "zigzag": ("Table 3", PAPER_TABLE_3)}
"""Identified parameters by scenario."""

TABLE_4 = {
    "turn": {
        "DSW-UKF": (0.1592, 0.2292),
        "UKF": (0.1721, 0.2331),
        "LSTM": (0.1944, 0.2542),
    },
    "zigzag": {
        "DSW-UKF": (0.1733, 0.1837),
        "UKF": (0.1855, 0.1894),
        "LSTM": (0.2792, 0.2952),
    },
}
"""Table 4: MAE and MSE of each method by scenario."""

FIGURES = {
    "turn": {"surge": "Figure 9", "sway": "Figure 10", "yaw": "Figure 11"},
    "zigzag": {"surge": "Figure 13", "sway": "Figure 14", "yaw": "Figure 15"},
}
"""Figures of the parameters, by scenario and equation."""

PREDICTION_FIGURES = {"turn": "Figure 12", "zigzag": "Figure 16"}
"""Figures of the 10 s prediction."""

ITERATIONS = 210
"""Iterations in which the parameters of Tables 2 and 3 were found, from 80 s of data."""

SETTLED_ITERATIONS = {"Figure 9": 90}
"""Iterations after which the text says that a figure's parameters had settled."""
