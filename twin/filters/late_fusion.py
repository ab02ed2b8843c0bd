"""The paper's late fusion: a GPS filter and an IMU filter, joined by inverse covariance.

Two plain Kalman filters of filterpy run side by side. The GPS filter moves each axis with constant
acceleration, and measures position and Doppler velocity. The matrix printed as Eq 49, an
observation matrix, is its transition matrix; that of Eq 48 fits no filter here. The IMU filter
takes the accelerometer, turned to the earth frame, as a known input and measures compass and gyro.
Position and velocity of both are joined by Eq 41 and 42; heading and yaw rate come from the IMU
filter alone. Equations carry the numbers that the paper prints.

Decisions that the paper leaves open, all of them ours:

- Feedback. The IMU filter measures neither position nor velocity, so that its covariance grows
  without end and its weight in Eq 42 goes to zero. The fused value and its covariance are therefore
  written back into it, but only in rows that bring a GPS sample. A prediction of the GPS filter is
  no new information. ``feedback=False`` shows the scheme as printed.
- GPS latency is not compensated, as in the paper: a fix counts as being of its row's time.
- The two estimates share their past once there is feedback, so that the fused covariance is
  too small. The formula is kept as printed.
- Noise that no data sheet states scales by Froude's law with the length of the boat.
- A fix that is farther off than :data:`DIVERGED_SD` restarts both filters. False numbers may have
  driven one away, and its covariance does not know.
- Losses. Variances are capped (position 1000 lengths, velocity ten times ``sqrt(g * length)``,
  acceleration g, heading pi). What is capped loses its correlations, which keeps the covariances
  positive definite. After ``hold`` seconds without a sample, the acceleration of the GPS filter and
  the yaw rate of the IMU filter fade to zero. Without accelerometer, or without any idea of the
  heading, the IMU filter holds its velocity, with a process noise of ``jerk * g`` over
  ``sqrt(length / g)``.
"""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import ArrayLike, NDArray

from twin.channels import MEASUREMENTS, PSI, V
from twin.checkpoint import State, check_fields
from twin.particulars import GRAVITY, Instruments
from usv_kernel.channels import ACCEL_X, ACCEL_Y, COMPASS, GPS_VX, GYRO
from usv_kernel.errors import UsvTwinError
from usv_kernel.scalar import wrap

__all__ = [
    "DIVERGED_SD",
    "LateFusion",
    "fuse",
]

Array = NDArray[np.float64]

SAME_DT = 1e-9
"""Steps that differ by less, in s, share their matrices (times read from a file round)."""

HEADING_VAR_MAX = 0.5**2
"""Heading variance, rad2, above which the accelerometer, whose direction is then unknown,
counts as missing."""

DIVERGED_SD = 20.0
"""Innovation of a fix, in standard deviations, above which a filter has diverged."""

NORTH, EAST, NORTH_SPEED, EAST_SPEED, HEADING, TURN = range(6)
"""State of the IMU filter: place (m), velocity (m/s), heading (rad), yaw rate (rad/s)."""

_GPS_TO_FUSED = np.array([0, 3, 1, 4])
"""Where north, east and their velocities stand in the state of the GPS filter."""

_GPS_SELECT = np.ix_(_GPS_TO_FUSED, _GPS_TO_FUSED)


def fuse(phi_gps: Array, K_gps: Array, phi_imu: Array, K_imu: Array) -> tuple[Array, Array, Array]:
    """Join two estimates (n,) of one vector by their inverse covariances (n, n).

    Returned are the fused estimate, its covariance if the errors of the two are independent, and
    the weight of the first estimate. That of the second is ``I - W_gps``.

    Source: Qu et al. 2025, Eq 41 and 42.
    """
    # solve on the transpose: the sum and both covariances are symmetric
    W_gps = np.asarray(np.linalg.solve(K_gps + K_imu, K_imu).T, dtype=np.float64)  # Eq 42
    phi = phi_imu + W_gps @ (phi_gps - phi_imu)  # Eq 41
    K = W_gps @ K_gps
    return phi, 0.5 * (K + K.T), W_gps


class LateFusion:
    """State of the boat from GPS and IMU as the paper fuses them.

    Parameters
    ----------
    instruments : Instruments
        Standard deviations of the sensors.
    length : float
        Waterline length, m; sets the scale of the unstated noises.
    feedback : bool
        Write the fused value back into the IMU filter. Without it the IMU weight in
        Eq 42 goes to zero and the GPS filter alone is left.
    jerk : float
        Process noise of the GPS filter: the acceleration wanders by about ``jerk * g``
        within ``sqrt(length / g)`` seconds.
    yaw : float
        Process noise of the yaw rate: it wanders by about ``yaw * sqrt(g / length)``
        within ``sqrt(length / g)`` seconds.
    hold : float, optional
        Time without a sample after which accelerations and yaw rate begin to fade, and the time
        constant with which they do, s. By default the larger of 2 s and ``2.5 * sqrt(length / g)``.

    Attributes
    ----------
    state : ndarray, shape (6,)
        Latest result (x, y, psi, u, v, r): m, m, rad, m/s, m/s, rad/s.
    fused : ndarray, shape (4,)
        Fused (x, y, vx, vy) in the earth frame, m and m/s ...
    fused_covariance : ndarray, shape (4, 4)
        ... and its covariance.
    weight_gps : ndarray, shape (4, 4)
        Weight of the GPS filter by Eq 42 in the latest update; the rest is that of the IMU.
    ready : bool
        True once a fix and a compass sample have come.

    Notes
    -----
    Before the first fix the result is zero but for psi and r, which follow compass and gyro as soon
    as these come. Before the first compass sample psi counts from zero.

    Source: Qu et al. 2025, Eq 41, 42 and 49 and the text around them.
    """

    def __init__(
        self,
        instruments: Instruments,
        length: float,
        *,
        feedback: bool = True,
        jerk: float = 0.1,
        yaw: float = 0.1,
        hold: float | None = None,
    ) -> None:
        settings = {"length": length, "jerk": jerk, "yaw": yaw}
        if hold is not None:
            settings["hold"] = hold
        for name, value in settings.items():
            if not (math.isfinite(value) and value > 0.0):
                raise UsvTwinError(f"{name} = {value} must be a finite number above 0")
        self.instruments = instruments
        self.length = float(length)
        self.feedback = bool(feedback)
        self._time_scale = math.sqrt(length / GRAVITY)
        self.hold = max(2.0, 2.5 * self._time_scale) if hold is None else float(hold)
        self._jerk_density = (jerk * GRAVITY) ** 2 / self._time_scale
        self._accel_density = (jerk * GRAVITY) ** 2 * self._time_scale
        self._yaw_density = yaw**2 / self._time_scale**3

        speed = math.sqrt(GRAVITY * length)
        self._start_velocity_var = speed**2
        self._start_accel_var = (jerk * GRAVITY) ** 2
        self._start_yaw_rate_var = (0.3 / self._time_scale) ** 2
        position_cap = (1000.0 * length) ** 2
        velocity_cap = (10.0 * speed) ** 2
        self._gps_cap = np.array([position_cap, velocity_cap, GRAVITY**2] * 2)
        self._imu_cap = np.array(
            [position_cap] * 2 + [velocity_cap] * 2 + [math.pi**2, 1.0 / self._time_scale**2]
        )

        sensors = instruments
        fix_sd = math.hypot(sensors.gps_sd, sensors.gps_bias_sd)
        gps_R = np.array([fix_sd, fix_sd, sensors.doppler_sd, sensors.doppler_sd])
        gyro_var = sensors.gyro_sd**2 + sensors.gyro_bias_sd**2
        self._gps_R = gps_R**2
        self._gps_H = np.eye(6)[_GPS_TO_FUSED]
        self._imu_R = np.array([sensors.compass_sd**2, gyro_var])
        self._imu_H = np.eye(6)[HEADING:]
        self._selections: dict[tuple[str, bytes], tuple[Array, Array]] = {}
        self.reset()

    def reset(self) -> None:
        """Forget everything: wait for the first fix and the first compass sample."""
        self.gps = KalmanFilter(dim_x=6, dim_z=4)
        self.imu = KalmanFilter(dim_x=6, dim_z=2)
        self.imu.inv = _inverse_small
        self.gps.x = np.zeros(6)
        self.imu.x = np.zeros(6)
        self.gps.P = np.diag(0.25 * self._gps_cap)
        self.imu.P = np.diag(0.25 * self._imu_cap)
        self.state = np.zeros(6)
        self.fused = np.zeros(4)
        self.fused_covariance = self.imu.P[:4, :4].copy()
        self.weight_gps = np.zeros((4, 4))
        self._have_fix = False
        self._have_heading = False
        self._gps_age = 0.0
        self._yaw_age = 0.0
        self._free_time = 0.0
        self._dt = math.nan

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name."""
        return {
            **{"gps.mean": self.gps.x.copy(), "gps.covariance": self.gps.P.copy()},
            **{"imu.mean": self.imu.x.copy(), "imu.covariance": self.imu.P.copy()},
            **{"mean": self.state.copy(), "fused": self.fused.copy()},
            "fused_covariance": self.fused_covariance.copy(),
            "weight_gps": self.weight_gps.copy(),
            **{"have_fix": self._have_fix, "have_heading": self._have_heading},
            **{"gps_age": self._gps_age, "yaw_age": self._yaw_age},
            **{"free_time": self._free_time, "step": self._dt},
        }

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned."""
        check_fields(state, self.state_dict())
        self.gps.x, self.gps.P = state["gps.mean"].copy(), state["gps.covariance"].copy()
        self.imu.x, self.imu.P = state["imu.mean"].copy(), state["imu.covariance"].copy()
        self.state, self.fused = state["mean"].copy(), state["fused"].copy()
        self.fused_covariance = state["fused_covariance"].copy()
        self.weight_gps = state["weight_gps"].copy()
        self._have_fix, self._have_heading = state["have_fix"], state["have_heading"]
        self._gps_age, self._yaw_age = state["gps_age"], state["yaw_age"]
        self._free_time = state["free_time"]
        self._dt = math.nan
        if math.isfinite(state["step"]):
            self._prepare(state["step"])

    @property
    def ready(self) -> bool:
        """True once a fix and a compass sample have come."""
        return self._have_fix and self._have_heading

    @property
    def covariance(self) -> Array:
        """Covariance of the result, shape (6, 6), in the order (x, y, psi, u, v, r)."""
        psi, u, v = self.state[PSI : V + 1]
        c, s = math.cos(psi), math.sin(psi)
        joint = self.imu.P.copy()
        joint[:4, :4] = self.fused_covariance
        J = np.zeros((6, 6))
        J[0, 0] = J[1, 1] = J[2, 4] = J[5, 5] = 1.0
        J[3, 2], J[3, 3], J[3, 4] = c, s, v
        J[4, 2], J[4, 3], J[4, 4] = -s, c, -u
        P: Array = J @ joint @ J.T
        return 0.5 * (P + P.T)

    def update(self, dt: float, z: ArrayLike) -> Array:
        """Take one row of measurements; return the state (6,), heading unwrapped, always finite.

        ``dt`` is the time since the row before, s; 0 or more, unused in the first row. ``z`` (19,)
        are GPS x, y (m), GPS velocity north and east (m/s), compass (rad), gyro (rad/s),
        accelerometer x and y (m/s2). The wind speed (m/s) is unused. What is not finite counts as
        missing. UsvTwinError: dt is negative or not finite, or z has another shape.
        """
        z = np.asarray(z, dtype=np.float64)
        if z.shape != (len(MEASUREMENTS),):
            raise UsvTwinError(f"z has shape {z.shape}; expected ({len(MEASUREMENTS)},)")
        if not (math.isfinite(dt) and dt >= 0.0):
            raise UsvTwinError(f"dt = {dt} must be a finite number, 0 or more")
        given = np.isfinite(z)
        if self._have_fix or self._have_heading:
            self._prepare(dt)
            self._predict_imu(dt, z, given)
        self._update_yaw(dt, z, given)
        self._update_gps(dt, z, given)
        psi, r = float(self.imu.x[HEADING]), float(self.imu.x[TURN])
        c, s = math.cos(psi), math.sin(psi)
        x, y, vx, vy = self.fused.tolist()
        self.state = np.array([x, y, psi, c * vx + s * vy, c * vy - s * vx, r])
        return self.state.copy()

    def _prepare(self, dt: float) -> None:
        """Build the matrices that depend on dt only; most rows come at the same dt."""
        if abs(dt - self._dt) < SAME_DT:
            return
        self._dt = dt
        dt2, dt3 = dt * dt, dt * dt * dt
        jerk = self._jerk_density * np.array(
            [
                [dt2 * dt3 / 20.0, dt2 * dt2 / 8.0, dt3 / 6.0],
                [dt2 * dt2 / 8.0, dt3 / 3.0, dt2 / 2.0],
                [dt3 / 6.0, dt2 / 2.0, dt],
            ]
        )
        block = np.array([[1.0, dt, 0.5 * dt2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])  # Eq 49
        decay = math.exp(-dt / self.hold)
        reach = self.hold * (1.0 - decay)
        fading = block.copy()
        fading[:, 2] = self.hold * (dt - reach), reach, decay
        pair = np.eye(2)
        self._gps_F = np.kron(pair, block)
        self._gps_F_fading = np.kron(pair, fading)
        self._gps_Q = np.kron(pair, jerk)

        self._imu_F = np.eye(6)
        for to, rate in ((NORTH, NORTH_SPEED), (EAST, EAST_SPEED), (HEADING, TURN)):
            self._imu_F[to, rate] = dt
        self._imu_F_fading = self._imu_F.copy()
        self._imu_F_fading[HEADING, TURN], self._imu_F_fading[TURN, TURN] = reach, decay
        self._imu_B = np.zeros((6, 2))
        self._imu_B[0, 0] = self._imu_B[1, 1] = 0.5 * dt2
        self._imu_B[2, 0] = self._imu_B[3, 1] = dt

        # white noise of one sample, held over the step ...
        held = np.array([[0.25 * dt2 * dt2, 0.5 * dt3], [0.5 * dt3, dt2]])
        # ... and one that is white in continuous time
        white = np.array([[dt3 / 3.0, dt2 / 2.0], [dt2 / 2.0, dt]])
        # the true acceleration moves on while a sample is held
        with_sample = self.instruments.accel_sd**2 * held + jerk[:2, :2]
        yaw = np.zeros((6, 6))
        yaw[HEADING:, HEADING:] = self._yaw_density * white
        self._imu_Q = np.kron(with_sample, pair)
        self._imu_Q = _embedded(self._imu_Q) + yaw
        self._imu_Q_bias = _embedded(self.instruments.accel_bias_sd**2 * np.kron(white, pair))
        self._imu_Q_blind = _embedded(self._accel_density * np.kron(white, pair)) + yaw

    def _predict_imu(self, dt: float, z: Array, given: NDArray[np.bool_]) -> None:
        """Move the IMU filter on, with the acceleration in the earth frame as known input."""
        self._free_time += dt
        imu = self.imu
        psi = float(imu.x[HEADING])
        F = self._imu_F if self._yaw_age + dt <= self.hold else self._imu_F_fading
        known = self._have_heading and imu.P[HEADING, HEADING] < HEADING_VAR_MAX
        if given[ACCEL_X] and given[ACCEL_Y] and known:
            c, s = math.cos(psi), math.sin(psi)
            ax, ay = float(z[ACCEL_X]), float(z[ACCEL_Y])
            # The error of a constant bias grows with the time since the filter was set:
            # d(bias^2 t^2)/dt = 2 bias^2 t.
            lever = 2.0 * self._free_time + self._time_scale
            imu.predict(
                u=np.array([c * ax - s * ay, s * ax + c * ay]),
                B=self._imu_B,
                F=F,
                Q=self._imu_Q + lever * self._imu_Q_bias,
            )
        else:
            imu.predict(F=F, Q=self._imu_Q_blind)
        imu.P = _capped(imu.P, self._imu_cap)

    def _update_yaw(self, dt: float, z: Array, given: NDArray[np.bool_]) -> None:
        """Measure compass and gyro; the first compass sample sets the heading."""
        imu = self.imu
        seen = given[COMPASS : GYRO + 1]
        if not self._have_heading:
            if seen[0]:
                self._have_heading = True
                imu.x[HEADING] = z[COMPASS]
                imu.x[TURN] = z[GYRO] if seen[1] else 0.0
                imu.P[HEADING:, :] = imu.P[:, HEADING:] = 0.0
                imu.P[HEADING, HEADING] = self._imu_R[0]
                imu.P[TURN, TURN] = self._imu_R[1] if seen[1] else self._start_yaw_rate_var
            elif seen[1]:
                imu.x[TURN] = z[GYRO]
            return
        if not seen.any():
            self._yaw_age += dt
            return
        self._yaw_age = 0.0
        psi = float(imu.x[HEADING])
        z_yaw = np.array([psi + wrap(z[COMPASS] - psi) if seen[0] else 0.0, z[GYRO]])
        H, R = self._select("imu", seen)
        imu.update(z_yaw[seen], R=R, H=H)

    def _update_gps(self, dt: float, z: Array, given: NDArray[np.bool_]) -> None:
        """Run the GPS filter, fuse, and feed back."""
        gps, imu = self.gps, self.imu
        seen = given[:COMPASS]
        if not self._have_fix:
            if seen[0] and seen[1]:
                self._start(z, seen)
            return
        stale = self._gps_age + dt > self.hold
        gps.predict(F=self._gps_F_fading if stale else self._gps_F, Q=self._gps_Q)
        gps.P = _capped(gps.P, self._gps_cap)
        fresh = bool(seen.any())
        if seen[0] and seen[1] and self._is_lost(z):
            self._gps_age = 0.0
            self._start(z, seen)
            return
        if fresh:
            self._gps_age = 0.0
            H, R = self._select("gps", seen)
            gps.update(z[:COMPASS][seen], R=R, H=H)
        else:
            self._gps_age += dt
        self.fused, self.fused_covariance, self.weight_gps = fuse(
            gps.x[_GPS_TO_FUSED], gps.P[_GPS_SELECT], imu.x[:4], imu.P[:4, :4]
        )
        if self.feedback and fresh:
            self._feed_back()

    def _is_lost(self, z: Array) -> bool:
        """Return whether a fix is so far off that both filters must start again."""
        for kalman, at in ((self.gps, _GPS_TO_FUSED[:2]), (self.imu, slice(NORTH, EAST + 1))):
            variance = kalman.P.diagonal()[at] + self._gps_R[:2]
            if ((z[:2] - kalman.x[at]) ** 2 > DIVERGED_SD**2 * variance).any():
                return True
        return False

    def _start(self, z: Array, seen: NDArray[np.bool_]) -> None:
        """Set both filters to the first fix."""
        velocity = np.where(seen[GPS_VX:], z[GPS_VX:COMPASS], 0.0)
        velocity_var = np.where(seen[GPS_VX:], self._gps_R[GPS_VX], self._start_velocity_var)
        self.gps.x = np.array([z[0], velocity[0], 0.0, z[1], velocity[1], 0.0])
        variances = [
            (self._gps_R[0], float(velocity_var[axis]), self._start_accel_var) for axis in (0, 1)
        ]
        self.gps.P = np.diag([value for axis in variances for value in axis])
        self.fused = self.gps.x[_GPS_TO_FUSED]
        self.fused_covariance = self.gps.P[_GPS_SELECT]
        self.weight_gps = np.eye(4)
        self._have_fix = True
        self._feed_back()

    def _feed_back(self) -> None:
        """Set position and velocity of the IMU filter to the fused ones."""
        self.imu.x[:4] = self.fused
        self.imu.P[:4, :4] = self.fused_covariance
        self._free_time = 0.0

    def _select(self, name: str, seen: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return H and R for the samples that are there."""
        key = (name, seen.tobytes())
        if key not in self._selections:
            H, R = (self._gps_H, self._gps_R) if name == "gps" else (self._imu_H, self._imu_R)
            self._selections[key] = H[seen], np.diag(R[seen])
        return self._selections[key]


def _embedded(block: ArrayLike) -> Array:
    """Return a (6, 6) matrix with the (4, 4) block in its upper left corner."""
    full = np.zeros((6, 6))
    full[:4, :4] = block
    return full


def _inverse_small(S: Array) -> Array:
    """Return the inverse of a (1, 1) or (2, 2) matrix, faster than through LAPACK."""
    if S.shape == (1, 1):
        return 1.0 / S
    (a, b), (c, d) = S.tolist()
    scale = 1.0 / (a * d - b * c)
    return np.array([[d * scale, -b * scale], [-c * scale, a * scale]])


def _capped(P: Array, cap: Array) -> Array:
    """Return P with no variance above its cap; a capped one also loses its correlations."""
    P = 0.5 * (P + P.T)
    over = P.diagonal() > cap
    if over.any():
        P[over] = 0.0
        P[:, over] = 0.0
        P[over, over] = cap[over]
    return P
