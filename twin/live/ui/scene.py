"""The three-dimensional scene of a view: sea, boat, its virtual copy, and what is forecast.

Everything hangs on one node, ``/sea``, whose axes are north, east and down as everywhere else. It
is moved so that the boat stays in the middle of the world, where every camera looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.live.sessions.session import Snapshot
from twin.motion import MotionForecast
from usv_gym.envs.scene import SDS, TwinOverlay, ellipses
from usv_gym.physics import frames as fr
from usv_gym.vessel.geometry import Boat

if TYPE_CHECKING:
    import viser

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "PALE",
    "PURPLE",
    "RED",
    "SceneView",
]

Array = NDArray[np.float64]

Colour = tuple[int, int, int]

# colours that people with any colour vision can tell apart
# Source: Okabe and Ito (2008), Color Universal Design.
BLUE, GREEN, RED = (0, 114, 178), (0, 158, 115), (213, 94, 0)

PURPLE, GREY, PALE = (150, 52, 116), (90, 96, 100), (255, 206, 120)

WATER, SKY = (70, 130, 168), ((160, 196, 222), (244, 248, 251))

TURN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""North, east, down to what viser has: east, north, up."""

CELLS, FAR, NEAR = 56, 16.0, 0.35
"""Cells a side of the surface, its extent in lengths, and the size of its middle cells over that of
equal cells."""

TRACK, FIXES, PATH = 500, 400, 120
"""Most segments of the track, fixes and legs that are drawn."""

STEPS, ACROSS = 40, 7
"""Pieces of the ribbon along and across: it lies on the waves."""

RING = 72


class SceneView:
    """A scene of a server that is kept like the latest snapshot of a boat."""

    def __init__(self, server: viser.ViserServer, boat: Boat) -> None:
        self.scene, self.boat = server.scene, boat
        self.scene.set_up_direction("+z")
        self._light()
        self.length = float(np.ptp(boat.whole().vertices[:, 0]))
        self.place = np.zeros(2)
        thick, L = 0.03 * self.length, self.length
        add = self.scene
        self.root = add.add_frame(
            "/sea", show_axes=False, wxyz=quaternion(Rotation.from_matrix(TURN))
        )
        edge = stretched(CELLS) * FAR * L
        self._grid = np.stack(np.meshgrid(edge, edge, indexing="ij"), axis=-1).reshape(-1, 2)
        self.surface = add.add_mesh_simple(
            "/sea/surface",
            self._lifted(self._grid, lambda places: np.zeros(len(places))),
            strip(CELLS + 1, CELLS + 1),
            color=WATER,
            opacity=0.9,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        self.hull = self._add_boat()
        whole = boat.whole()
        self.ghost = add.add_mesh_simple(
            "/sea/ghost",
            whole.vertices.astype(np.float32),
            whole.faces,
            color=RED,
            opacity=0.45,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self.ribbon = add.add_mesh_simple(
            "/sea/ribbon",
            np.zeros(((STEPS + 1) * (ACROSS + 1), 3), np.float32),
            strip(STEPS + 1, ACROSS + 1),
            # not transparent: on transparent water, objects would be drawn in any order
            color=PALE,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self.forecast = self._lines("forecast", STEPS, RED, thick)
        self.end = self._lines("end", RING, RED, 0.6 * thick)
        self.track = self._lines("track", TRACK, BLUE, thick)
        self.ahead = self._lines("ahead", TRACK, BLUE, 0.5 * thick)
        self.path = self._lines("path", PATH, GREEN, 0.8 * thick)
        self.ring = self._lines("ring", RING, GREY, 0.2 * thick)
        self.north = add.add_label("/sea/north", "N", anchor="center-center")
        self.scale = add.add_label("/sea/scale", "", anchor="center-center")
        self.fixes = add.add_point_cloud(
            "/sea/fixes",
            np.zeros((FIXES, 3), np.float32),
            PURPLE,
            point_size=0.035 * L,
            point_shape="circle",
            precision="float32",
            point_shading="flat",
            visible=False,
        )
        self.lost = add.add_label(
            "/sea/lost", "", anchor="bottom-center", font_screen_scale=1.3, visible=False
        )
        self.radius = nice(2.2 * L)
        server.initial_camera.position = (-1.2 * L, -3.2 * L, 1.9 * L)
        server.initial_camera.look_at = (0.0, 0.6 * L, 0.0)
        server.initial_camera.far = 60.0 * L
        server.initial_camera.near = min(0.02 * L, 0.2)

    def _light(self) -> None:
        """Let a low sun shine, so that waves are seen by their slopes."""
        add = self.scene
        add.configure_default_lights(enabled=False)
        add.configure_environment_map(None)
        add.add_light_hemisphere(
            "/sky", sky_color=(255, 255, 255), ground_color=(60, 80, 100), intensity=1.4
        )
        add.add_light_directional("/sun", position=(-3.0, 2.0, 1.6), intensity=2.2)
        share = np.linspace(0.0, 1.0, 64)[:, None, None]
        top, horizon = (np.array(colour)[None, None] for colour in SKY)
        add.set_background_image(
            np.broadcast_to(top + share * (horizon - top), (64, 4, 3)).astype(np.uint8)
        )

    def show(self, now: Snapshot) -> None:
        """Make the scene like a snapshot."""
        if np.isfinite(now.boat[[fr.X, fr.Y]]).all():
            self.place = now.boat[[fr.X, fr.Y]]
        elif now.overlay is not None:
            self.place = now.overlay.state[:2]
        place = self.place

        def height(places: Array) -> Array:
            """Return the height of the surface in m at places (n, 2)."""
            if now.sea is None:
                return np.zeros(len(places))
            return now.sea.elevation(places[:, 0], places[:, 1], now.t)

        self.root.position = tuple(-TURN @ [*place, 0.0])
        self.surface.vertices = self._lifted(self._grid + place, height, 0.0)
        self._show_boat(now)
        # whole seconds: a browser takes a moment for every new text
        losses = [f"GPS LOST {now.gps_age:.0f} s"] * now.gps_lost + ["IMU LOST"] * now.imu_lost
        if now.silence > 0.0:
            losses = [f"NOTHING HEARD FOR {now.silence:.0f} s"]
        self.lost.visible = bool(losses) and math.isfinite(now.gps_age)
        self.lost.text = ", ".join(losses)
        self.lost.position = (*place.tolist(), -1.0 * self.length)
        self._show_overlay(now.overlay, now.motion, height)
        self._draw(self.track, now.track, height)
        self._draw(self.ahead, now.ahead, height, 0.075)
        self._draw(self.path, nearest(now.path, place), height)
        angle = np.linspace(0.0, 2.0 * math.pi, RING + 1)
        circle = place + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self._draw(self.ring, circle, height)
        self.north.position = tuple(self._lifted(circle[:1], height, 0.1)[0])
        self.scale.position = tuple(self._lifted(circle[RING // 4 :][:1], height, 0.1)[0])
        self.scale.text = f"{self.radius:g} m"
        self.fixes.visible = bool(len(now.fixes))
        if len(now.fixes):
            # the unused places repeat the last fix
            fixes = padded(now.fixes[-FIXES:], FIXES)
            self.fixes.points = self._lifted(fixes, height, 0.05)

    def _add_boat(self) -> Any:
        """Add the boat's parts; return the frame that they hang on."""
        frame = self.scene.add_frame("/sea/boat", show_axes=False)
        paths = {"": "/sea/boat"}
        self._steered: list[tuple[int, Any]] = []
        for part in self.boat.parts:
            paths[part.name] = f"{paths[part.parent]}/{part.name}"
            handle = self.scene.add_mesh_simple(
                paths[part.name],
                part.mesh.vertices.astype(np.float32),
                part.mesh.faces,
                color=part.colour,
                flat_shading=True,
                position=part.position,
                receive_shadow=False,
            )
            if part.moves == "steer":
                self._steered.append((part.unit, handle))
        return frame

    def _show_boat(self, now: Snapshot) -> None:
        state = now.boat
        self.hull.visible = bool(np.isfinite(state[[fr.X, fr.Y, fr.PSI]]).all())
        if not self.hull.visible:
            return
        self.hull.position = tuple(state[[fr.X, fr.Y, fr.Z]])
        self.hull.wxyz = attitude(*state[[fr.PHI, fr.THETA, fr.PSI]])
        for unit, handle in self._steered:
            handle.wxyz = attitude(0.0, 0.0, -float(state[fr.DELTA_LEFT + unit]))

    def _show_overlay(
        self,
        overlay: TwinOverlay | None,
        motion: MotionForecast | None,
        height: Callable[[Array], Array],
    ) -> None:
        for handle in (self.ghost, self.ribbon, self.forecast, self.end):
            handle.visible = overlay is not None
        if overlay is None:
            return
        x, y, psi = overlay.state[:3]
        if motion is None:
            # a twin without heave is drawn at the local water level
            lift = float(height(np.array([[x, y]]))[0]) if self.hull.visible else 0.0
            roll, pitch, heave = 0.0, 0.0, -lift
        else:
            roll, pitch, heave = motion.mean[0, :3].tolist()
        self.ghost.position = (float(x), float(y), heave)
        self.ghost.wxyz = attitude(roll, pitch, float(psi))
        places, covs = overlay.interpolate(STEPS)[1:]
        left, right = borders(places, covs).transpose(1, 0, 2)[:, :, None]
        net = left + np.linspace(0.0, 1.0, ACROSS + 1)[:, None] * (right - left)
        self.ribbon.vertices = self._lifted(net.reshape(-1, 2), height, 0.04)
        self._draw(self.forecast, places, height, 0.06)
        outline = ellipses(places[-1:], covs[-1:], RING)[0]
        self._draw(self.end, np.concatenate([outline, outline[:1]]), height, 0.06)

    def _lines(self, name: str, most: int, colour: Colour, thickness: float) -> Any:
        return self.scene.add_line_segments(
            f"/sea/{name}",
            np.zeros((most, 2, 3), np.float32),
            colour,
            thickness=thickness,
            visible=False,
        )

    def _draw(
        self, handle: Any, places: Array, height: Callable[[Array], Array], above: float = 0.05
    ) -> None:
        """Lay a line along places (n, 2) on the water."""
        handle.visible = len(places) > 1
        if len(places) > 1:
            most = len(handle.points)
            places = padded(places[-(most + 1) :], most + 1)
            points = self._lifted(places, height, above)
            handle.points = np.stack([points[:-1], points[1:]], axis=1)

    def _lifted(
        self, places: Array, height: Callable[[Array], Array], above: float = 0.0
    ) -> NDArray[np.float32]:
        """Return places (n, 2) on the water, or so many lengths above it, as points (n, 3)."""
        down = -height(places) - above * self.length
        return np.column_stack([places, down]).astype(np.float32)


def quaternion(turn: Rotation) -> tuple[float, float, float, float]:
    """Return a rotation as a quaternion w, x, y, z."""
    x, y, z, w = turn.as_quat().tolist()
    return w, x, y, z


def attitude(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Return roll, pitch and heading as a quaternion w, x, y, z."""
    return quaternion(Rotation.from_euler("ZYX", [psi, theta, phi]))


def stretched(cells: int) -> Array:
    """Return the edges of cells between -1 and 1 that are smallest in the middle."""
    s = np.linspace(-1.0, 1.0, cells + 1)
    return NEAR * s + (1.0 - NEAR) * s**3


def strip(rows: int, columns: int) -> NDArray[np.int32]:
    """Return the triangles of a net of points, row by row."""
    k = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def padded(places: Array, size: int) -> Array:
    """Return places (n, 2), the last again and again up to a size."""
    return np.concatenate([places, np.repeat(places[-1:], size - len(places), axis=0)])


def nearest(path: Array, place: Array) -> Array:
    """Return the part of a path that is nearest to a place and fits its capacity."""
    if len(path) <= PATH + 1:
        return path
    at = int(np.argmin(np.hypot(*(path - place).T)))
    first = min(max(at - PATH // 2, 0), len(path) - PATH - 1)
    return path[first : first + PATH + 1]


def borders(places: Array, covs: Array) -> Array:
    """Return points (T, 2, 2) :data:`~usv_gym.envs.scene.SDS` sd left and right of a track (m)."""
    along = np.gradient(places, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    sd = np.sqrt(np.maximum(np.einsum("ti,tij,tj->t", across, covs, across), 0.0))
    off = SDS * sd[:, None] * across
    return np.stack([places - off, places + off], axis=1)


def nice(length: float) -> float:
    """Return a round number near a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return min((k * power for k in (1.0, 2.0, 5.0, 10.0)), key=lambda k: abs(k - length))
