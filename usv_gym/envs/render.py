"""Pictures of the boats from above: numbers gathered in a :class:`Scene`, painted by pygame.

A picture shows the truth; the estimate of a twin comes in as a
:class:`TwinOverlay`. Painting never writes what it reads: an episode is the same without it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from usv_gym.envs.episodes import Episodes, Observer
from usv_gym.envs.scene import SDS, Scene, Trail, TwinOverlay, drives, ellipses, outlines, rotated
from usv_gym.envs.scoring import NOTHING
from usv_gym.physics import frames as fr
from usv_gym.physics import waves as wv
from usv_gym.physics import weather as wx
from usv_gym.vessel.vessel import Vessel
from usv_kernel.errors import UsvTwinError

__all__ = [
    "RENDER_MODES",
    "RENDER_SIZE",
    "Painter",
    "Renderer",
]

Array = NDArray[np.float64]

Frame = NDArray[np.uint8]

RENDER_MODES = ["human", "rgb_array"]

RENDER_SIZE = (720, 720)
"""Width and height of a frame, pixels."""

SMALLEST, LARGEST = (400, 360), 4096
"""Least width and height, below which the words do not fit, and the most of either, pixels."""

LOOK_AHEAD_S = 10.0
"""Time that the picture reaches ahead of a boat at its nominal speed, s."""

# colours that people with any colour vision can tell apart, with paler ones for areas
# Source: Okabe and Ito (2008), Color Universal Design.
INK, GREY, WHITE = (0, 0, 0), (120, 128, 134), (255, 255, 255)
BLUE, GREEN, RED, PURPLE = (0, 114, 178), (0, 158, 115), (213, 94, 0), (170, 68, 130)
WATER, GRID, PALE, HULL = (236, 244, 249), (219, 230, 237), (248, 216, 178), (92, 99, 105)

FINE = 2
"""The map is drawn this many times larger, and smoothed."""


class Renderer:
    """Pictures of the boats of an environment, ``size`` pixels wide and high.

    ``observer.overlay``, if there is one, returns the estimate of the twin of boat i. ``mode`` is
    ``"rgb_array"`` or ``"human"``. ``waits``: :meth:`look` is left to one who brings a twin from
    outside.
    """

    def __init__(
        self,
        episodes: Episodes,
        observer: Observer | None,
        mode: str,
        size: tuple[int, int] = RENDER_SIZE,
    ) -> None:
        if not isinstance(mode, str) or mode not in RENDER_MODES:
            raise UsvTwinError(
                f"render_mode = {mode!r}: unknown; use {' or '.join(map(repr, RENDER_MODES))}, or "
                "leave it out"
            )
        self.episodes, self.mode = episodes, mode
        self.painter = Painter(size)
        self.overlay: Callable[[int], TwinOverlay | None] | None = getattr(
            observer, "overlay", None
        )
        self.waits = False
        self._window = Window(self.painter.size, fps_of(episodes)) if mode == "human" else None
        length = episodes.vessel.values["length_overall"]
        self.trails = [
            Trail(0.05 * length, 0.2 * _span(episodes.vessel, episodes.speed))
            for _ in range(episodes.n)
        ]

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies are made of."""
        if self._window:
            raise UsvTwinError("an environment with a window cannot be copied; use 'rgb_array'")
        return {**vars(self), "painter": self.painter.size}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become a copy."""
        vars(self).update(state)
        self.painter = Painter(state["painter"])

    @classmethod
    def of(
        cls,
        episodes: Episodes,
        observer: Observer | None,
        mode: str | None,
        size: tuple[int, int],
    ) -> Renderer | None:
        """Return what makes an environment's pictures; None without a mode."""
        checked_size(size)
        return None if mode is None else cls(episodes, observer, mode, size)

    def observe(self, obs: NDArray[np.float32], look: bool = True) -> None:
        """Add a step of every boat to its trail."""
        sim, records = self.episodes.simulation, self.episodes.records
        for i, trail in enumerate(self.trails):
            trail.add(
                sim.t.item(i), sim.state[i], records["held"][i, :2], records["age"].item(i, 0)
            )

    def look(self) -> None:
        """Remember also what a reset made new; show the first boat where there is a window."""
        self.observe(np.empty(0, np.float32))
        if self._window:
            self._window.show(self.painter, self.scene(0))

    def scene(self, i: int) -> Scene:
        """Return what a picture of boat i shows now."""
        episodes, sim, task, trail = (
            *(self.episodes, self.episodes.simulation, self.episodes.task),
            self.trails[i],
        )
        t, age = sim.t.item(i), self.episodes.records["age"].item(i, 0)
        record, goal = task.records[i], task.kind != NOTHING or task.is_own
        kind = episodes.kinds[int(episodes.records["kind"][i])]
        north, east = wx.air_velocity(t, sim.gusts[i], sim.weather[i])
        waves = sim.waves[i]
        # the components' mean direction, weighted with their energy
        energy = waves[wv.AMPLITUDE] ** 2
        number = np.maximum(np.hypot(waves[wv.K_NORTH], waves[wv.K_EAST]), 1e-12)
        to_north, to_east = (energy @ (waves[k] / number) for k in (wv.K_NORTH, wv.K_EAST))
        gain = wx.wave_gain(t, sim.weather[i])
        return Scene(
            vessel=kind.vessel,
            speed=kind.speed,
            t=t,
            state=sim.state[i].copy(),
            view=trail.view,
            track=np.array([*trail.track, sim.state[i, :2]]),
            path=task.points[i].copy() if goal else np.empty((0, 2)),
            leg=int(record["leg"]),
            off_path=float(record["errors"][0]),
            fixes=np.array(trail.fixes).reshape(-1, 2),
            gps_age=age,
            gps_lost=age > max(3.0 / sim.suite.gps_rate, 0.5),
            wind=math.hypot(north, east),
            wind_from=math.atan2(-east, -north),
            hs=4.0 * gain * math.sqrt(0.5 * energy.sum()),
            wave_to=math.atan2(to_east, to_north),
            reward=sum(record["terms"][: len(task.terms)].tolist()) if goal else None,
            heeling=sim.dof == 6,
            overlay=self.overlay(i) if self.overlay else None,
        )

    def frames(self) -> tuple[Frame, ...]:
        """Return a picture of each boat, shape (height, width, 3)."""
        return tuple(self.painter.paint(self.scene(i)) for i in range(self.episodes.n))

    def close(self) -> None:
        """Close the window."""
        if self._window:
            self._window.close()


def fps_of(episodes: Episodes) -> float:
    """Return decisions per second, as a whole number where it is one."""
    fps = 1.0 / (episodes.simulation.dt * episodes.frame_skip)
    return round(fps) if math.isclose(fps, round(fps)) else fps


def pictures(renderer: Renderer | None, started: bool) -> tuple[Frame, ...] | None:
    """Return what ``render()`` of an environment does: pictures only in the mode ``rgb_array``.

    As in Gymnasium: before the first reset it is an error, and without a mode it warns.
    """
    if renderer is None:
        gym.logger.warn(
            "render() does nothing without a render_mode: make the environment with "
            "render_mode='rgb_array' or 'human'"
        )
        return None
    if not started:
        raise gym.error.ResetNeeded("call reset() before render()")
    return renderer.frames() if renderer.mode == "rgb_array" else None


def _span(vessel: Vessel, speed: float) -> float:
    """Return how many metres the shorter side of a picture shows."""
    return max(1.5 * LOOK_AHEAD_S * speed, 6.0 * vessel.values["length_overall"])


def _angle(rad: float) -> str:
    """Return a direction as people write it: 007 deg."""
    return f"{round(math.degrees(rad)) % 360:03d} deg"


def _nice(length: float) -> float:
    """Return the greatest of 1, 2 and 5 times a power of ten that is no longer than a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return power * max(k for k in (1.0, 2.0, 5.0) if k * power <= length * (1.0 + 1e-9))


def checked_size(size: Any) -> tuple[int, int]:
    """Return width and height of a picture, pixels; UsvTwinError says which there may be."""
    try:
        w, h = size
        whole = bool(w == int(w) and h == int(h))
    except (OverflowError, TypeError, ValueError):
        whole = False
    if not (whole and SMALLEST[0] <= w <= LARGEST and SMALLEST[1] <= h <= LARGEST):
        raise UsvTwinError(
            f"render_size = {size!r}: must be width and height in whole pixels, at least "
            f"{SMALLEST[0]} x {SMALLEST[1]} and at most {LARGEST} x {LARGEST}"
        )
    return int(w), int(h)


class Painter:
    """Paints scenes: a map with the north up, and words in the colours of what they speak of."""

    def __init__(self, size: tuple[int, int] = RENDER_SIZE) -> None:
        self.size = checked_size(size)
        self.pg = _pygame()
        self.pg.font.init()
        # the font that comes with a library which is there anyway
        import matplotlib

        self._em = max(9, round(min(self.size) / 50))
        font = f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf"
        self._font = self.pg.font.Font(font, self._em)
        self._frame = self.pg.Surface(self.size, 0, 32)
        self._canvas = self.pg.Surface((FINE * self.size[0], FINE * self.size[1]), 0, 32)

    def paint(self, scene: Scene) -> Frame:
        """Return the picture of a scene, shape (height, width, 3)."""
        self.draw(scene)
        pixels = np.frombuffer(self.pg.image.tobytes(self._frame, "RGB"), np.uint8)
        return pixels.reshape(self.size[1], self.size[0], 3).copy()

    def draw(self, scene: Scene) -> Any:
        """Return the picture of a scene as a surface of pygame, which the next one overwrites."""
        canvas = self._canvas
        middle = np.array(canvas.get_rect().center)
        scale = min(canvas.get_size()) / _span(scene.vessel, scene.speed)

        def at(points: Array) -> Any:
            """Return places (..., 2) in pixels; far ones are brought near for pygame."""
            away = (points - scene.view)[..., ::-1] * (scale, -scale)
            return np.clip(middle + away, -1e6, 1e6).tolist()

        canvas.fill(WATER)
        mesh = _nice(0.3 * min(canvas.get_size()) / scale)
        self._draw_grid(scene, at, mesh)
        self._draw_map(scene, at)
        self.pg.transform.smoothscale(canvas, self.size, self._frame)
        self._write(_said(scene), topleft=(self._em, self._em))
        bar = self._write([(f"{mesh:g} m", INK)], bottomleft=(self._em, self.size[1] - self._em))
        ends = bar.bottomleft, (bar.left + round(mesh * scale / FINE), bar.bottom)
        self.pg.draw.line(self._frame, INK, *ends, 2)
        if scene.gps_lost:
            lost = [(f"GPS LOST {scene.gps_age:.1f} s", WHITE)]
            self._write(lost, RED, topright=(self.size[0] - self._em, self._em))
        return self._frame

    def _draw_grid(self, scene: Scene, at: Callable[[Array], Any], mesh: float) -> None:
        """Draw a grid fixed to the earth, so that one sees the boat move."""
        w, h = self._canvas.get_size()
        reach = math.ceil(0.5 * max(w, h) / min(w, h) * _span(scene.vessel, scene.speed) / mesh) + 1
        for k in range(-reach, reach + 1):
            x, y = at((np.floor(scene.view / mesh) + k) * mesh)
            self.pg.draw.line(self._canvas, GRID, (0, y), (w, y), FINE)
            self.pg.draw.line(self._canvas, GRID, (x, 0), (x, h), FINE)

    def _draw_map(self, scene: Scene, at: Callable[[Array], Any]) -> None:
        """Draw the twin's uncertainty, path, track, fixes, boat, and the twin over it."""
        draw, canvas, overlay = self.pg.draw, self._canvas, scene.overlay
        thin = max(FINE, round(0.14 * FINE * self._em))
        if overlay:
            places, covs = overlay.interpolate()[1:]
            for shape in at(ellipses(places, covs)):
                draw.polygon(canvas, PALE, shape)
        if len(scene.path):
            points = at(scene.path)
            draw.lines(canvas, GREY, False, points, thin)
            draw.line(canvas, GREEN, *points[scene.leg : scene.leg + 2], 2 * thin)
            draw.circle(canvas, GREEN, points[scene.leg + 1], 3 * thin)
        if len(scene.track) > 1:
            draw.lines(canvas, BLUE, False, at(scene.track), thin)
        for point in at(scene.fixes):
            draw.circle(canvas, PURPLE, point, round(1.3 * thin))
        shapes, psi, place = outlines(scene.vessel), float(scene.state[fr.PSI]), scene.state[:2]
        for line in drives(scene.vessel, scene.state):
            draw.line(canvas, INK, *at(rotated(line, psi, place)), 2 * thin)
        for shape in shapes:
            draw.polygon(canvas, HULL, at(rotated(shape, psi, place)))
        if overlay:
            draw.lines(canvas, RED, False, at(places), thin)
            for shape in shapes:
                ghost = rotated(shape, float(overlay.state[2]), overlay.state[:2])
                draw.polygon(canvas, RED, at(ghost), round(1.5 * thin))

    def _write(self, lines: list[tuple[str, Any]], ground: Any = WHITE, **corner: Any) -> Any:
        """Write lines, a text and its colour each, on a ground with this corner; return its box."""
        words = [self._font.render(text, True, colour) for text, colour in lines]
        wide, tall = max(word.get_width() for word in words), words[0].get_height()
        box = self.pg.Rect(0, 0, wide + self._em, tall * len(words))
        for name, point in corner.items():
            setattr(box, name, point)
        self._frame.fill(ground, box)
        for k, word in enumerate(words):
            self._frame.blit(word, (box.left + self._em // 2, box.top + k * tall))
        return box


def _said(scene: Scene) -> list[tuple[str, Any]]:
    """Return what instruments would say, each line with the colour of its subject on the map."""
    state = scene.state
    lines: list[tuple[str, Any]] = [
        (f"time {scene.t:.2f} s", INK),
        (f"speed {math.hypot(state[fr.U], state[fr.V]):.2f} m/s", BLUE),
        (f"heading {_angle(state[fr.PSI])}", INK),
    ]
    if scene.heeling:
        roll, pitch = np.degrees(state[[fr.PHI, fr.THETA]])
        lines.append((f"roll {roll:+.1f}, pitch {pitch:+.1f} deg", INK))
    if len(scene.path):
        side = "starboard" if scene.off_path > 0.0 else "port"
        to_go = math.dist(scene.path[scene.leg + 1], state[:2])
        lines += [
            (f"{abs(scene.off_path):.1f} m {side} of leg", GREEN),
            (f"leg {scene.leg + 1} of {len(scene.path) - 1}: {to_go:.1f} m to go", GREEN),
        ]
    if scene.overlay:
        off = math.dist(scene.overlay.state[:2], state[:2])
        lines.append((f"twin off by {off:.2f} m", RED))
        lines.append((f"twin: next {scene.overlay.horizons[-1]:g} s, {SDS:g} sd", RED))
    lines.append((f"GPS fix {scene.gps_age:.1f} s old", PURPLE))
    wind = f"{scene.wind:.1f} m/s from {_angle(scene.wind_from)}"
    lines.append(("no wind" if scene.wind <= 0.05 else f"wind {wind}", INK))
    waves = f"{scene.hs:.2f} m to {_angle(scene.wave_to)}"
    lines.append(("no waves" if scene.hs <= 0.005 else f"waves Hs {waves}", INK))
    if scene.reward is not None:
        lines.append((f"reward {scene.reward:+.2f}", INK))
    return lines


class Window:
    """A window on the screen, size in pixels; its user may close it, and nothing else ends by that.

    Showing waits for ``fps`` frames per second.
    """

    def __init__(self, size: tuple[int, int], fps: float) -> None:
        self.size, self.fps, self.pg = size, fps, _pygame()
        self.clock = self.pg.time.Clock()
        self.screen: Any = None
        self.closed = False

    def show(self, painter: Painter, scene: Scene) -> None:
        """Show a scene, unless the window was closed."""
        if self.closed:
            return
        if self.screen is None:
            try:
                self.pg.display.init()
                self.screen = self.pg.display.set_mode(self.size)
            except self.pg.error as error:
                raise gym.error.Error(
                    f"render_mode='human' finds no screen to open a window on ({error}); use "
                    "render_mode='rgb_array'"
                ) from None
            self.pg.display.set_caption(scene.vessel.title)
        if self.pg.event.get(self.pg.QUIT):
            self.close()
            return
        self.pg.event.pump()
        self.screen.blit(painter.draw(scene), (0, 0))
        self.pg.display.flip()
        self.clock.tick(self.fps)

    def close(self) -> None:
        """Close it for good."""
        if self.screen is not None:
            self.pg.display.quit()
        self.screen, self.closed = None, True


def _pygame() -> Any:
    """Return pygame, which is an extra."""
    try:
        import pygame
    except ImportError:
        raise gym.error.DependencyNotInstalled(
            "pictures are painted by pygame, which is not installed: pip install 'usv-twin[render]'"
        ) from None
    return pygame
