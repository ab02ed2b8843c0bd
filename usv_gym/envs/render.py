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
from usv_gym.envs.scene import SDS, Scene, Trail, TwinOverlay, drives, ellipses, outline, rotated
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

SMALLEST = (400, 360)
"""Below this the words do not fit."""

LARGEST = 4096


LOOK = 10.0
"""Time that the picture reaches ahead of a boat at its nominal speed, s."""

# colours that people with any colour vision can tell apart, with paler ones for areas
# Source: Okabe and Ito (2008), Color Universal Design.
_INK, _GREY = (0, 0, 0), (120, 128, 134)

_BLUE, _SKY, _GREEN = (0, 114, 178), (86, 180, 233), (0, 158, 115)

_RED, _PURPLE = (213, 94, 0), (170, 68, 130)

_WATER, _GRID, _PANEL = (236, 244, 249), (219, 230, 237), (255, 255, 255)

_PALE, _HULL = (248, 216, 178), (92, 99, 105)

_FINE = 2  # the map is drawn this many times larger, and smoothed


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
        terms = record["terms"].tolist()
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
            rewards=dict(zip(task.terms, terms, strict=False)) if goal else {},
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
    return max(1.5 * LOOK * speed, 6.0 * vessel.values["length_overall"])


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
    """Paints scenes: a map with the north up, a rose, what the instruments say, and a key.

    ``placed`` are the rectangles of the words and the rose of the last picture, pixels.
    """

    def __init__(self, size: tuple[int, int] = RENDER_SIZE) -> None:
        self.size = w, h = checked_size(size)
        self.pg = _pygame()
        self.pg.font.init()
        em = max(9, round(min(self.size) / 50))
        self._em, self._line = em, round(1.27 * em)
        # the font that comes with a library which is there anyway
        import matplotlib

        font = f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf"
        self._font = self.pg.font.Font(font, em)
        self._words: dict[tuple[str, Any], Any] = {}
        pad, line = em // 2, self._line
        rose = min(10 * line, w - 35 * em)
        panel = 12 * line + 3 * pad
        self._map = self.pg.Rect(0, 0, w, h - panel)
        top = h - panel + pad
        self._rose = self.pg.Rect(pad, top + (10 * line - rose) // 2, rose, rose)
        spare = max(w - rose - 35 * em, 0) // 4
        left = pad + rose + em + spare
        self._said, self._key = (left, top), (left + round(15.5 * em) + spare, top)
        self._terms = pad, top + 10 * line + pad
        fine = _FINE * self._map.width, _FINE * self._map.height
        self._canvas = self.pg.Surface(fine, 0, 32)
        self._frame = self.pg.Surface(self.size, 0, 32)
        self._small = self.pg.Surface((_FINE * rose, _FINE * rose), 0, 32)
        self.placed: list[Any] = []

    def paint(self, scene: Scene) -> Frame:
        """Return the picture of a scene, shape (height, width, 3)."""
        self.draw(scene)
        pixels = np.frombuffer(self.pg.image.tobytes(self._frame, "RGB"), np.uint8)
        return pixels.reshape(self.size[1], self.size[0], 3).copy()

    def draw(self, scene: Scene) -> Any:
        """Return the picture of a scene as a surface of pygame, which the next one overwrites."""
        self.placed = []
        self._frame.fill(_PANEL)
        self._draw_map(scene)
        self._draw_rose(scene)
        terms = [f"{name.replace('_', ' ')} {value:+.2f}" for name, value in scene.rewards.items()]
        if terms:
            terms.insert(0, f"reward {sum(scene.rewards.values()):+.2f}")
        self._write(self._said, _said(scene))
        self._write(self._terms, [(text, _INK) for text in (*terms[:1], "   ".join(terms[1:]))])
        self._draw_key(scene, self._key)
        return self._frame

    def _draw_map(self, scene: Scene) -> None:
        draw, canvas = self.pg.draw, self._canvas
        canvas.fill(_WATER)
        rect = canvas.get_rect()
        scale = min(rect.size) / _span(scene.vessel, scene.speed)
        thin, place = max(_FINE, round(0.14 * _FINE * self._em)), scene.state[:2]

        def at(points: Array, far: float = 1e6) -> Any:
            """Return places (..., 2) in pixels; far ones are brought near for pygame."""
            away = (points - scene.view) * scale
            pixels = np.stack([rect.centerx + away[..., 1], rect.centery - away[..., 0]], axis=-1)
            return np.clip(pixels, -far, far).tolist()

        # a grid fixed to the earth, so that one sees the boat move
        mesh = _nice(0.3 * min(rect.size) / scale)
        corner = np.array([rect.h, rect.w]) / (2.0 * scale)
        low, high = (np.floor((scene.view + k * corner) / mesh).astype(int) for k in (-1, 1))
        for north in range(low[0], high[0] + 1):
            y = at(np.array([north * mesh, 0.0]))[1]
            draw.line(canvas, _GRID, (0, y), (rect.w, y), _FINE)
        for east in range(low[1], high[1] + 1):
            x = at(np.array([0.0, east * mesh]))[0]
            draw.line(canvas, _GRID, (x, 0), (x, rect.h), _FINE)

        overlay = scene.overlay
        if overlay:
            near = 3.0 * max(rect.size)
            places, covs = overlay.interpolate()[1:]
            for shape in at(ellipses(places, covs), near):
                draw.polygon(canvas, _PALE, shape)
            for shape in at(ellipses(overlay.ahead[:, :2], overlay.covs, 64), near):
                draw.polygon(canvas, _RED, shape, thin // 2)
        if len(scene.path):
            points = at(scene.path)
            draw.lines(canvas, _GREY, False, points, thin)
            draw.line(canvas, _GREEN, *points[scene.leg : scene.leg + 2], 2 * thin)
            lengths = np.hypot(*np.diff(scene.path, axis=0).T)
            # the many points of a curve are not marked
            marked = lengths.max() > 2.0 * scene.vessel.values["length_overall"]
            for k, point in enumerate(points if marked else []):
                target = k == scene.leg + 1
                draw.circle(canvas, _GREEN if target else _GREY, point, 3 * thin)
                draw.circle(canvas, _WATER, point, (1 if target else 2) * thin)
        if len(scene.track) > 1:
            draw.lines(canvas, _BLUE, False, at(scene.track), thin)
        for point in at(scene.fixes):
            if rect.collidepoint(point):
                draw.circle(canvas, _PURPLE, point, round(1.3 * thin))
        hull, psi = outline(scene.vessel), float(scene.state[fr.PSI])
        for line in drives(scene.vessel, scene.state):
            draw.line(canvas, _INK, *at(rotated(line, psi, place)), 2 * thin)
        shape = at(rotated(hull, psi, place))
        draw.polygon(canvas, _HULL, shape)
        draw.polygon(canvas, _INK, shape, thin)
        if overlay:
            draw.lines(canvas, _RED, False, at(places), thin)
            ghost = at(rotated(hull, float(overlay.state[2]), overlay.state[:2]), near)
            draw.polygon(canvas, _RED, ghost, round(1.5 * thin))
        self.pg.transform.smoothscale(canvas, self._map.size, self._frame.subsurface(self._map))
        self._draw_scale(mesh, scale / _FINE)
        if scene.gps_lost:
            text = f"GPS LOST {scene.gps_age:.1f} s"
            self._boxed(text, (self._map.centerx, self._map.top + self._em), _RED)

    def _draw_scale(self, mesh: float, scale: float) -> None:
        """Draw the scale, which is as long as a mesh of the net."""
        em, length = self._em, round(mesh * scale)
        words = self._word(f"{mesh:g} m", _INK)
        box = self.pg.Rect(0, 0, max(length, words.get_width()) + em, self._line + em)
        box.bottomleft = self._map.left + em // 2, self._map.bottom - em // 2
        self._frame.fill(_PANEL, box)
        left, y = box.left + em // 2, box.bottom - em // 2
        bar = [(left, y - em // 3), (left, y), (left + length, y), (left + length, y - em // 3)]
        self.pg.draw.lines(self._frame, _INK, False, bar, max(1, em // 8))
        self._frame.blit(words, (left, box.top + 1))
        self.placed.append(box)

    def _draw_rose(self, scene: Scene) -> None:
        """Draw the rose: wind from the rim, waves to the rim, the boat in the middle."""
        draw, canvas, em = self.pg.draw, self._small, _FINE * self._em
        canvas.fill(_PANEL)
        middle = canvas.get_width() / 2.0
        rim = middle - 1.4 * em

        def at(radius: float, angle: float, aside: float = 0.0) -> tuple[float, float]:
            c, s = math.cos(angle), math.sin(angle)
            return middle + radius * s + aside * c, middle - radius * c + aside * s

        def arrow(colour: Any, begin: float, end: float, angle: float, double: bool) -> None:
            head = end - math.copysign(0.9 * em, end - begin)
            for aside in (-0.22 * em, 0.22 * em) if double else (0.0,):
                draw.line(canvas, colour, at(begin, angle, aside), at(head, angle, aside), em // 5)
            wings = at(head, angle, -0.5 * em), at(head, angle, 0.5 * em)
            draw.polygon(canvas, colour, [at(end, angle), *wings])

        draw.circle(canvas, _GREY, (middle, middle), rim, _FINE)
        for k in range(12):
            angle = k * math.pi / 6.0
            inner = rim - (0.5 if k % 3 else 0.8) * em
            draw.line(canvas, _GREY, at(inner, angle), at(rim, angle), _FINE)
        if scene.wind > 0.05:
            arrow(_SKY, rim, 0.4 * rim, scene.wind_from, False)
        if scene.hs > 0.005:
            arrow(_BLUE, 0.4 * rim, rim, scene.wave_to, True)
        hull = outline(scene.vessel)
        shape = rotated(hull * (0.6 * rim / np.ptp(hull[:, 0])), scene.state[fr.PSI], np.zeros(2))
        draw.polygon(canvas, _HULL, [(middle + e, middle - n) for n, e in shape])
        self.pg.transform.smoothscale(canvas, self._rose.size, self._frame.subsurface(self._rose))
        for k, letter in enumerate("NESW"):
            words = self._word(letter, _INK)
            x, y = at(rim + 0.75 * em, k * math.pi / 2.0)
            box = words.get_rect(center=(x / _FINE, y / _FINE)).move(self._rose.topleft)
            self._frame.blit(words, box)
        self.placed.append(self._rose)

    def _draw_key(self, scene: Scene, place: tuple[int, int]) -> None:
        """Draw what each colour stands for."""
        rows = [(_HULL, "boat (truth)"), (_BLUE, "its track"), (_PURPLE, "GPS fix")]
        if scene.overlay:
            horizons = scene.overlay.horizons
            listed = ", ".join(f"{number:g}" for number in horizons)
            rows += [
                (_RED, f"twin: now and next {horizons[-1]:g} s"),
                (_PALE, f"twin: {SDS:g} sd; at {listed} s"),
            ]
        if len(scene.path):
            rows += [(_GREEN, "present leg"), (_GREY, "path, way points")]
        rows += [(_SKY, "wind")] * (scene.wind > 0.05)
        rows += [(_BLUE, "waves (double arrow)")] * (scene.hs > 0.005)
        em, (left, top) = self._em, place
        for k, (colour, _) in enumerate(rows):
            y = top + k * self._line + self._line // 2
            self._frame.fill(colour, (left, y - em // 4, 2 * em, max(em // 2, 1)))
        self._write((left + round(2.6 * em), top), [(text, _INK) for _, text in rows])

    def _word(self, text: str, colour: Any) -> Any:
        key = text, colour
        if key not in self._words:
            if len(self._words) > 1000:
                self._words.clear()
            self._words[key] = self._font.render(text, True, colour)
        return self._words[key]

    def _write(self, place: tuple[int, int], lines: list[tuple[str, Any]]) -> None:
        """Write lines of a text and its colour from a place on."""
        left, top = place
        for text, colour in lines:
            self.placed.append(self._frame.blit(self._word(text, colour), (left, top)))
            top += self._line

    def _boxed(self, text: str, top: tuple[int, int], colour: Any) -> None:
        """Write white on a colour, from a place at the middle of its top."""
        words = self._word(text, _PANEL)
        box = words.get_rect(midtop=top).inflate(self._em, self._em // 2)
        self._frame.fill(colour, box)
        self._frame.blit(words, words.get_rect(center=box.center))
        self.placed.append(box)


def _said(scene: Scene) -> list[tuple[str, Any]]:
    """Return the lines of what instruments would say, each with its colour."""
    state = scene.state
    along = math.hypot(state[fr.U], state[fr.V])
    lines: list[tuple[str, Any]] = [
        (f"time {scene.t:.2f} s", _INK),
        (f"speed {along:.2f} m/s", _INK),
        (f"heading {_angle(state[fr.PSI])}", _INK),
    ]
    if scene.heeling:
        roll, pitch = np.degrees(state[[fr.PHI, fr.THETA]])
        lines.append((f"roll {roll:+.1f}, pitch {pitch:+.1f} deg", _INK))
    if len(scene.path):
        side = "starboard" if scene.off_path > 0.0 else "port"
        lines.append((f"{abs(scene.off_path):.1f} m {side} of leg", _INK))
        to_go = math.dist(scene.path[scene.leg + 1], state[:2])
        lines.append((f"leg {scene.leg + 1} of {len(scene.path) - 1}: {to_go:.1f} m to go", _INK))
    if scene.overlay:
        off = math.dist(scene.overlay.state[:2], state[:2])
        lines.append((f"twin off by {off:.2f} m", _INK))
    lines.append((f"GPS fix {scene.gps_age:.1f} s old", _RED if scene.gps_lost else _INK))
    wind = f"{scene.wind:.1f} m/s from {_angle(scene.wind_from)}"
    lines.append(("no wind" if scene.wind <= 0.05 else f"wind {wind}", _INK))
    waves = f"{scene.hs:.2f} m to {_angle(scene.wave_to)}"
    lines.append(("no waves" if scene.hs <= 0.005 else f"waves Hs {waves}", _INK))
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
