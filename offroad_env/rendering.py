"""Pictures of an episode: from above, from the side, and what happened over time.

pygame-ce draws; it is imported with the first picture, not with this module. Pictures are made from
`offroad_env.env.Snapshot` copies, so drawing cannot change an episode.

Colours follow Okabe & Ito (told apart by colour-blind readers too): front axle blue, rear axle
vermilion, estimate green, truth black.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled, Error

from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.path_kernels import PathTable, path_point
from offroad_env.physics.wheel_soil import contact_angle_shares, entry_angle
from offroad_env.terrain import height_map, heights
from offroad_env.vehicles import static_loads

if TYPE_CHECKING:
    from offroad_env.env import OffroadBekkerEnv, Snapshot

__all__ = ["FRAME_SIZE", "RENDER_MODES", "Renderer"]

FRAME_SIZE = (1280, 720)  #: width, height of a frame [pixels]
RENDER_MODES = ("human", "rgb_array")

Colour = tuple[int, int, int]
Box = tuple[int, int, int, int]  # left, top, width, height [pixels]

_PAGE, _PANEL, _GRID = (228, 229, 226), (252, 252, 250), (224, 225, 222)
_INK, _MUTED = (26, 30, 36), (88, 94, 102)
_FRONT, _REAR = (0, 114, 178), (213, 94, 0)
_ESTIMATE, _ESTIMATE_BAND = (0, 128, 94), (186, 226, 212)
_PRIOR_BAND = (222, 222, 228)
_BODY, _CAB, _TYRE = (84, 94, 110), (176, 188, 202), (34, 36, 40)
_SOIL_LIGHT, _SOIL_DARK, _SOIL, _RUT = (232, 218, 190), (176, 154, 118), (205, 184, 146), (150, 122, 84)
_EDGE = (122, 74, 30)
_GOOD, _BAD = (0, 128, 94), (190, 60, 0)

_HEADER: Box = (0, 0, 1280, 44)
_MAP: Box = (12, 52, 780, 556)
_OVERVIEW: Box = (12, 616, 780, 92)
_SIDE: Box = (804, 52, 464, 324)
_EXPONENT: Box = (804, 384, 464, 142)
_STRIPS: Box = (804, 534, 464, 174)

_WHEELBASE = 2.72  # of `mrzr` [m], at which the scale of the map is _MAP_SCALE
_MAP_SCALE = 24.0  # [pixels/m]
_CELL = 10  # pixels of the map for one value of the terrain's shading
_MOST_CELLS = 500_000
_ARROW_TIME = 0.5  # an arrow is where its axle gets to in this time [s]

_ENDINGS = {
    "goal": "GOAL REACHED",
    "left_corridor": "LEFT THE CORRIDOR",
    "rollover": "ROLLED OVER",
    "immobilised": "IMMOBILISED",
    "diverged": "SIMULATION DIVERGED",
}
_TOLD = {"none": "nothing about n", "estimate": "the estimate of n", "truth": "the true n"}


def _import_pygame() -> Any:
    """pygame-ce, without its greeting on standard output."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(
            'rendering needs pygame-ce, which is not installed: pip install "offroad-bekker[view]"'
        ) from error
    return pygame


def _number(value: float, digits: int, unit: str = "", *, sign: bool = False) -> str:
    """``value`` as text with a true minus sign, and never as minus zero."""
    value = round(value, digits) + 0.0
    return f"{value:{'+' if sign else ''}.{digits}f}{unit}".replace("-", "\u2212")


# ---------------------------------------------------------------------- drawing


class _Canvas:
    """A surface with the strokes that a technical drawing needs; all places in pixels."""

    def __init__(self, pygame: Any, size: tuple[int, int]) -> None:
        self.pygame = pygame
        pygame.font.init()
        # Without a display, and always in this layout, whatever the screen has.
        self.surface = pygame.Surface(size, 0, 32)
        self._fonts: dict[int, Any] = {}
        self._texts: dict[tuple[str, int, Colour], Any] = {}

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8, red first; a new array."""
        width, height = self.surface.get_size()
        flat = np.frombuffer(self.pygame.image.tobytes(self.surface, "RGB"), np.uint8)
        return flat.reshape(height, width, 3).copy()

    def box(self, box: Box, fill: Colour, edge: Colour | None = None) -> None:
        """A filled rectangle."""
        self.surface.fill(fill, box)
        if edge is not None:
            self.pygame.draw.rect(self.surface, edge, box, 1)

    @contextmanager
    def clipped(self, box: Box) -> Iterator[None]:
        """Draw nothing outside ``box``."""
        self.surface.set_clip(box)
        try:
            yield
        finally:
            self.surface.set_clip(None)

    def text(
        self,
        place: Sequence[float],
        text: str,
        *,
        size: int = 18,
        colour: Colour = _INK,
        anchor: str = "midleft",
    ) -> float:
        """Write one line; ``anchor`` is the point of its box at ``place``. Returns its right end."""
        key = (text, size, colour)
        image = self._texts.get(key)
        if image is None:
            if len(self._texts) > 600:
                self._texts.clear()
            image = self._texts[key] = self._written(text, size, colour)
        where = image.get_rect(**{anchor: (round(place[0]), round(place[1]))})
        self.surface.blit(image, where)
        return where.right

    def _written(self, text: str, size: int, colour: Colour) -> Any:
        """An image of the text, made twice as large and shrunk: small letters are spaced badly."""
        if size not in self._fonts:
            self._fonts[size] = self.pygame.font.Font(None, 2 * size)
        large = self._fonts[size].render(text, True, colour)
        width, height = large.get_size()
        return self.pygame.transform.smoothscale(large, ((width + 1) // 2, (height + 1) // 2))

    def words(self, place: Sequence[float], words: Sequence[tuple[str, Colour]], *, size: int = 18) -> float:
        """Words of different colours on one line, from ``place`` on; returns the right end."""
        x = place[0]
        for word, colour in words:
            x = self.text((x, place[1]), word, size=size, colour=colour) + 0.35 * size
        return x

    def stroke(self, points: np.ndarray, colour: Colour, width: float = 1.0) -> None:
        """A smooth line through (N, 2) points: thin lines side by side, as pygame's wide ones are rough."""
        if len(points) < 2:
            return
        if width <= 1.0:
            self.pygame.draw.aalines(self.surface, colour, False, points.tolist())
            return
        along = np.empty_like(points)
        along[0], along[-1], along[1:-1] = (
            points[1] - points[0],
            points[-1] - points[-2],
            points[2:] - points[:-2],
        )
        across = along[:, ::-1] * (-1.0, 1.0)
        across *= 0.5 * (width - 1.0) / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
        if len(points) == 2:
            self.shape(np.concatenate((points + across, points[::-1] - across)), colour)
            return
        lines = math.ceil(width)
        for i in range(lines):
            share = 2.0 * i / (lines - 1) - 1.0
            self.pygame.draw.aalines(self.surface, colour, False, (points + share * across).tolist())

    def dashes(self, points: np.ndarray, colour: Colour, width: float = 1.0) -> None:
        """Two of four segments of a line."""
        for i in range(0, len(points) - 1, 4):
            self.stroke(points[i : i + 3], colour, width)

    def shape(self, points: np.ndarray, fill: Colour, edge: Colour | None = None) -> None:
        """A filled polygon with a smooth edge."""
        corners = np.asarray(points).tolist()
        self.pygame.draw.polygon(self.surface, fill, corners)
        self.pygame.draw.aalines(self.surface, edge or fill, True, corners)

    def disc(self, centre: Sequence[float], radius: float, fill: Colour) -> None:
        """A filled circle with a smooth edge."""
        self.pygame.draw.aacircle(self.surface, fill, (float(centre[0]), float(centre[1])), radius)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: Colour, width: float = 3.0) -> None:
        """An arrow; one shorter than its head is left out."""
        along = end - start
        length = float(np.hypot(*along))
        if length < 8.0:
            return
        along = along / length
        across = np.array([-along[1], along[0]])
        self.stroke(np.array([start, end - 7.0 * along]), colour, width)
        back = end - 10.0 * along
        self.shape(np.array([end, back + 5.0 * across, back - 5.0 * across]), colour)


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    """(N, 2) points, turned to the left by ``angle`` [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def _rectangle(x: float, y: float, length: float, width: float) -> np.ndarray:
    """Corners (4, 2) of a rectangle around (x, y)."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.array([x, y]) + 0.5 * corners * [length, width]


# ---------------------------------------------------------------------- memory


class _History:
    """What the charts and the tracks show of the past, one row a picture."""

    #: Columns. ``RUT_*``: middle of the rear axle [m].
    (TIME, N, MEAN, SD, SPEED, SLIP_F, SLIP_R, ERROR, RUT_X, RUT_Y, YAW) = range(11)
    _SIZE = 11

    def __init__(self) -> None:
        self._rows = np.empty((512, self._SIZE))
        self._count = 0

    @property
    def rows(self) -> np.ndarray:
        """(T, 11) in order of time."""
        return self._rows[: self._count]

    def add(self, snapshot: Snapshot) -> None:
        """Append this moment, unless it is there already."""
        if self._count and snapshot.time <= self._rows[self._count - 1, self.TIME]:
            return
        if self._count == len(self._rows):
            self._rows = np.concatenate((self._rows, np.empty_like(self._rows)))
        state, readings, estimate = snapshot.state, snapshot.readings, snapshot.estimate
        back = snapshot.plant.vehicle.l_r
        self._rows[self._count] = (
            snapshot.time,
            readings[at.EXPONENT],
            math.nan if estimate is None else estimate.mean,
            math.nan if estimate is None else estimate.sd,
            math.hypot(state[at.V_X], state[at.V_Y]),
            readings[at.SLIP],
            readings[at.AXLE + at.SLIP],
            snapshot.cross_track_error,
            state[at.X] - back * math.cos(state[at.YAW]),
            state[at.Y] - back * math.sin(state[at.YAW]),
            state[at.YAW],
        )
        self._count += 1

    def thinned(self, most: int) -> np.ndarray:
        """At most about ``most`` rows, the last one among them; which ones changes as rarely as possible."""
        rows = self.rows
        stride = 1
        while len(rows) > stride * most:
            stride *= 2
        return rows if stride == 1 else np.concatenate((rows[::stride], rows[-1:]))


# ---------------------------------------------------------------------- from above


class _Course:
    """What stays the same for an episode: terrain image, corridor and the outline of the whole path."""

    def __init__(self, pygame: Any, snapshot: Snapshot) -> None:
        self.path: PathTable = snapshot.course.path
        self.corridor = snapshot.scenario.corridor
        vehicle = snapshot.plant.vehicle
        # A small vehicle is shown larger, a large one on more ground.
        self.scale = _MAP_SCALE * math.sqrt(_WHEELBASE / (vehicle.l_f + vehicle.l_r))
        self.view = np.array(_MAP[2:]) / self.scale
        nodes = self.path.nodes
        self._ahead = 0.55 * float(self.view.min())
        margin = 0.5 * self.view + self._ahead + 1.0
        self._corner = nodes[:, :2].min(axis=0) - margin
        extent = nodes[:, :2].max(axis=0) + margin - self._corner
        self._cell = _CELL
        while extent.prod() * (self.scale / self._cell) ** 2 > _MOST_CELLS:
            self._cell += _CELL
        self._size = self._cell / self.scale  # of a cell [m]
        every = max(round(0.75 / self.path.ds), 1)
        kept = np.unique(np.append(np.arange(0, len(nodes), every), len(nodes) - 1))
        self.s = self.path.ds * kept
        self.line = nodes[kept, :2]
        left = np.column_stack((-np.sin(nodes[kept, 2]), np.cos(nodes[kept, 2])))
        self.edges = (self.line + self.corridor * left, self.line - self.corridor * left)
        self._image = self._shading(pygame, snapshot, np.ceil(extent / self._size).astype(int))

    def _shading(self, pygame: Any, snapshot: Snapshot, cells: np.ndarray) -> Any:
        """The terrain lit from the left and above, higher ground lighter, the corridor lighter still."""
        X, Y = (self._corner[i] + self._size * (0.5 + np.arange(cells[i])) for i in range(2))
        height = height_map(snapshot.course.ground, X, Y)
        dY, dX = np.gradient(height, self._size)
        slope = dX - dY
        light = 0.5 + 0.13 * sum(part / max(float(part.std()), 1e-9) for part in (height, slope))
        light = np.clip(light, 0.0, 1.0)[::-1, :, None]
        shades = np.array(_SOIL_DARK) + light * (np.array(_SOIL_LIGHT) - np.array(_SOIL_DARK))
        image = pygame.image.frombuffer(shades.astype(np.uint8).tobytes(), tuple(cells), "RGB")
        shaded = pygame.Surface(image.get_size(), 0, 32)
        shaded.blit(image, (0, 0))
        shaded.blit(self._veil(pygame, cells), (0, 0))
        return shaded

    def _veil(self, pygame: Any, cells: np.ndarray) -> Any:
        """The corridor in thin white; drawn finer than the cells, or its edges would be stairs."""
        fine = 4
        veil = pygame.Surface(tuple(fine * cells), pygame.SRCALPHA, 32)
        veil.fill((255, 255, 255, 0))
        left, right = (fine * (edge - self._corner) / self._size for edge in self.edges)
        for i in range(len(left) - 1):
            quad = np.array([left[i], left[i + 1], right[i + 1], right[i]])
            quad[:, 1] = fine * cells[1] - quad[:, 1]
            pygame.draw.polygon(veil, (255, 255, 255, 92), quad.tolist())
        return pygame.transform.smoothscale(veil, tuple(cells))

    def camera(self, progress: float) -> np.ndarray:
        """Middle of the view [m]: between vehicle and the path ahead, smooth because the path is."""
        here = path_point(self.path, progress)[:2]
        there = path_point(self.path, min(progress + self._ahead, self.path.length))[:2]
        return 0.5 * (np.array(here) + np.array(there))

    def blit(self, canvas: _Canvas, camera: np.ndarray) -> None:
        """The terrain under the view."""
        low = (camera - 0.5 * self.view - self._corner) / self._size
        width, height = self._image.get_size()
        across, up = (int(n) + 3 for n in self.view / self._size)
        column = min(max(math.floor(low[0]), 0), width - across)
        bottom = min(max(math.floor(low[1]), 0), height - up)
        part = self._image.subsurface((column, height - bottom - up, across, up))
        part = canvas.pygame.transform.smoothscale(part, (across * self._cell, up * self._cell))
        x = _MAP[0] + (column - low[0]) * self._cell
        y = _MAP[1] + _MAP[3] - (bottom + up - low[1]) * self._cell
        canvas.surface.blit(part, (round(x), round(y)))


class _MapView:
    """The vehicle from above: north up, scrolling along the path."""

    def __init__(self, canvas: _Canvas) -> None:
        self.canvas = canvas

    def draw(self, course: _Course, snapshot: Snapshot, history: _History) -> None:
        """The whole panel."""
        self._camera, self._scale = course.camera(snapshot.progress), course.scale
        canvas = self.canvas
        with canvas.clipped(_MAP):
            course.blit(canvas, self._camera)
            self._draw_tracks(snapshot, history)
            self._draw_path(course, snapshot)
            self._draw_vehicle(snapshot)
            self._draw_legend(course)
        canvas.pygame.draw.rect(canvas.surface, _MUTED, _MAP, 1)

    def _pixel(self, places: np.ndarray) -> np.ndarray:
        """Places [m] (..., 2) on the canvas."""
        middle = np.array([_MAP[0] + 0.5 * _MAP[2], _MAP[1] + 0.5 * _MAP[3]])
        return middle + (places - self._camera) * np.array([self._scale, -self._scale])

    def _draw_tracks(self, snapshot: Snapshot, history: _History) -> None:
        vehicle, rows = snapshot.plant.vehicle, history.rows
        middle = rows[:, [history.RUT_X, history.RUT_Y]]
        near = np.abs(middle - self._camera).max(axis=1) < 0.6 * _MAP[2] / self._scale
        first = int(np.argmax(near)) if near.any() else len(rows)
        # About one point per 0.3 m at any frame rate, and always the same ones: no flicker.
        moved = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(middle, axis=0).T))))
        steps = np.floor(moved / 0.3)
        keep = np.concatenate(([True], np.diff(steps) > 0))
        keep[:first], keep[-1] = False, True
        yaw = rows[keep, history.YAW]
        left = 0.5 * vehicle.track * np.column_stack((-np.sin(yaw), np.cos(yaw)))
        sides = (left, -left) if vehicle.wheels_per_axle > 1.0 else (0.0 * left,)
        for side in sides:
            self.canvas.stroke(self._pixel(middle[keep] + side), _RUT, max(vehicle.b * self._scale, 2.0))

    def _draw_path(self, course: _Course, snapshot: Snapshot) -> None:
        reach = float(np.hypot(*course.view))
        near = np.flatnonzero(np.abs(course.s - snapshot.progress) < reach)
        if len(near) < 2:
            near = np.arange(max(len(course.s) - 2, 0), len(course.s))
        part = slice(int(near[0]), int(near[-1]) + 1)
        for edge in course.edges:
            self.canvas.stroke(self._pixel(edge[part]), _EDGE, 3.0)
        # Dashes stay where they are on the ground: start at a node whose number is a multiple of 4.
        start = part.start - part.start % 4
        self.canvas.dashes(self._pixel(course.line[start : part.stop]), _INK, 2.0)
        for index, name in ((0, "start"), (-1, "finish")):
            ends = self._pixel(np.array([edge[index] for edge in course.edges]))
            colour = _GOOD if name == "finish" else _INK
            self.canvas.stroke(ends, colour, 5.0)
            top = ends[np.argmin(ends[:, 1])]
            self.canvas.text((top[0], top[1] - 6), name, size=20, colour=colour, anchor="midbottom")

    def _draw_vehicle(self, snapshot: Snapshot) -> None:
        vehicle, state = snapshot.plant.vehicle, snapshot.state
        place, yaw = state[[at.X, at.Y]], float(state[at.YAW])

        def put(shape: np.ndarray) -> np.ndarray:
            return self._pixel(place + _turned(shape, yaw))

        front, rear = vehicle.l_f + 1.35 * vehicle.r, -vehicle.l_r - 1.35 * vehicle.r
        half = 0.36 * vehicle.track
        nose = front - 0.9 * vehicle.r
        right = [[rear, -half], [nose, -half], [front, -0.55 * half]]
        hull = np.array(right + [[x, -y] for x, y in reversed(right)])
        steer = _road_wheel_angle(snapshot)
        across = 0.5 * vehicle.track if vehicle.wheels_per_axle > 1.0 else 0.0
        sides = (across, -across) if across else (0.0,)
        for arm, angle, colour in ((vehicle.l_f, steer, _FRONT), (-vehicle.l_r, 0.0, _REAR)):
            for side in sides:
                # Half as wide again as the wheel: at this scale a true one could not be seen to steer.
                wheel = _turned(_rectangle(0.0, 0.0, 2.0 * vehicle.r, 1.5 * vehicle.b), angle)
                self.canvas.shape(put(wheel + np.array([arm, side])), _TYRE, colour)
        self.canvas.shape(put(hull), _BODY, _INK)
        cab = _rectangle(0.12 * vehicle.l_f, 0.0, 0.9 * vehicle.l_f, 1.5 * half)
        self.canvas.shape(put(cab), _CAB, _INK)
        for arm, colour in ((vehicle.l_f, _FRONT), (-vehicle.l_r, _REAR)):
            side_speed = state[at.V_Y] + arm * state[at.YAW_RATE]
            ends = np.array([[arm, 0.0], [arm + _ARROW_TIME * state[at.V_X], _ARROW_TIME * side_speed]])
            self.canvas.arrow(*put(ends), colour)

    def _draw_legend(self, course: _Course) -> None:
        canvas = self.canvas
        left, bottom = _MAP[0] + 8, _MAP[1] + _MAP[3] - 30
        canvas.box((left, bottom, 610, 22), _PANEL)
        x = canvas.words((left + 8, bottom + 11), [("\u2013 \u2013 path", _INK), ("corridor", _EDGE)])
        x = canvas.text((x, bottom + 11), f"\u00b1{course.corridor:g} m", colour=_EDGE) + 16
        x = canvas.text((x, bottom + 11), "wheel tracks", colour=(126, 98, 60)) + 16
        x = canvas.text((x, bottom + 11), f"way of the axles in {_ARROW_TIME:g} s:") + 6
        canvas.words((x, bottom + 11), [("front", _FRONT), ("rear", _REAR)])
        length = _round_number(130.0 / course.scale)
        right = _MAP[0] + _MAP[2] - 14
        start = right - length * course.scale
        canvas.box((round(start) - 8, bottom - 14, round(right - start) + 16, 36), _PANEL)
        bar = np.array([[start, bottom + 12], [right, bottom + 12]])
        canvas.stroke(bar, _INK, 3.0)
        for x in (start, right):
            canvas.stroke(np.array([[x, bottom + 6], [x, bottom + 18]]), _INK, 2.0)
        canvas.text((0.5 * (start + right), bottom - 3), f"{length:g} m", anchor="center")


def _round_number(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= value * 1.000001)


def _road_wheel_angle(snapshot: Snapshot) -> float:
    """Angle of the front wheels [rad]: the paper's model has no actuator, its wheels follow at once."""
    if snapshot.model == "paper":
        return snapshot.command[0] * snapshot.plant.vehicle.steer_max
    return float(snapshot.state[at.STEER])


class _Overview:
    """The whole course with the vehicle on it, and what the driver does."""

    def __init__(self, canvas: _Canvas) -> None:
        self.canvas = canvas

    def draw(self, course: _Course, snapshot: Snapshot) -> None:
        """The whole panel."""
        left, top, width, height = _OVERVIEW
        canvas = self.canvas
        canvas.box(_OVERVIEW, _PANEL, _MUTED)
        done = min(max(snapshot.progress, 0.0), course.path.length)
        text = f"whole course: {done:.0f} of {course.path.length:.0f} m"
        canvas.text((left + 8, top + 12), text)
        self._draw_course(course, snapshot, (left + 10, top + 22, 440, height - 30))
        vehicle, (_, drive) = snapshot.plant.vehicle, snapshot.command
        steer = _road_wheel_angle(snapshot)
        place = (left + width - 190, top + 30)
        share = -steer / vehicle.steer_max
        self._draw_gauge(place, "steering", share, _number(math.degrees(steer), 0, "\u00b0", sign=True))
        name = "drive" if drive >= 0.0 else "brake"
        self._draw_gauge((place[0], place[1] + 34), name, drive, _number(100.0 * abs(drive), 0, " %"))

    def _draw_course(self, course: _Course, snapshot: Snapshot, box: Box) -> None:
        low, high = course.line.min(axis=0), course.line.max(axis=0)
        extent = np.maximum(high - low, 1.0)
        scale = float((np.array(box[2:]) / extent).min())
        flip = np.array([scale, -scale])
        middle = 0.5 * (low[1] + high[1])
        origin = np.array([box[0], box[1] + 0.5 * box[3]]) - flip * np.array([low[0], middle])
        line = origin + flip * course.line
        self.canvas.stroke(line, (188, 176, 154), 4.0)
        self.canvas.stroke(line[course.s <= snapshot.progress], _INK, 2.0)
        self.canvas.disc(line[-1], 5.0, _GOOD)
        here = origin + flip * snapshot.state[[at.X, at.Y]]
        self.canvas.disc(here, 8.0, _PANEL)
        self.canvas.disc(here, 6.0, _INK)

    def _draw_gauge(self, place: tuple[int, int], name: str, share: float, value: str) -> None:
        """A bar to the left or right of its middle for ``share`` in -1 ... 1."""
        canvas, (x, y) = self.canvas, place
        canvas.text((x - 10, y), name, anchor="midright")
        canvas.box((x, y - 8, 120, 16), _GRID, _MUTED)
        length = round(58.0 * min(max(share, -1.0), 1.0))
        canvas.box((x + 60 + min(length, 0), y - 7, abs(length), 14), _MUTED)
        canvas.box((x + 59, y - 11, 2, 22), _INK)
        canvas.text((x + 178, y), value, anchor="midright")


# ---------------------------------------------------------------------- from the side


class _Axle(NamedTuple):
    """One axle in the side view. Heights are above the undeformed ground's zero."""

    name: str
    colour: Colour
    arm: float  #: distance ahead of the CG [m]
    ground: float  #: undeformed ground under the wheel [m]
    bottom: float  #: lowest point of the wheel [m]
    mount: float  #: where ``bottom`` would be at static suspension travel [m]
    sinkage: float  #: [m]
    airborne: bool
    readings: np.ndarray  #: (13,) of this axle


def _axle(snapshot: Snapshot, *, front: bool) -> _Axle:
    vehicle, state = snapshot.plant.vehicle, snapshot.state
    readings = snapshot.readings[: at.AXLE] if front else snapshot.readings[at.AXLE : at.MOTION]
    arm = vehicle.l_f if front else -vehicle.l_r
    stiffness = vehicle.k_f if front else vehicle.k_r
    airborne = readings[at.N] <= 0.0
    ground, sinkage = float(readings[at.HEIGHT]), float(readings[at.SINKAGE])
    bottom = mount = ground - sinkage
    if snapshot.plant.half_car > 0.5:
        mount = float(state[at.Z] + arm * math.sin(state[at.PITCH]))
    if airborne:
        # The spring has given all its static load: the wheel hangs that far below its static place.
        bottom = max(bottom, mount - static_loads(vehicle)[0 if front else 1] / stiffness)
    name, colour = ("front", _FRONT) if front else ("rear", _REAR)
    return _Axle(name, colour, arm, ground, bottom, mount, sinkage, bool(airborne), readings)


class _SideView:
    """The vehicle from its right side, at true scale, and both wheels in the soil enlarged."""

    _ENLARGED = 146  # height of the pictures of the wheels
    _CAPTION = 40  # of it for words

    def __init__(self, canvas: _Canvas) -> None:
        self.canvas = canvas
        self._turned = np.zeros(2)  # how far the front and rear wheels have turned [rad]
        self._time = 0.0

    def restart(self) -> None:
        """A new episode."""
        self._turned[:] = self._time = 0.0

    def draw(self, snapshot: Snapshot) -> None:
        """The whole panel."""
        canvas, (left, top, width, height) = self.canvas, _SIDE
        self._roll(snapshot)
        axles = _axle(snapshot, front=True), _axle(snapshot, front=False)
        canvas.box(_SIDE, _PANEL, _MUTED)
        canvas.text((left + 8, top + 13), "Side view", size=20)
        self._write_posture(snapshot, axles)
        self._draw_whole(snapshot, axles, (left + 1, top + 24, width - 2, height - self._ENLARGED - 34))
        half = (width - 24) // 2
        for i, axle in enumerate(axles):
            box = (left + 8 + (1 - i) * (half + 8), top + height - self._ENLARGED - 8, half, self._ENLARGED)
            self._draw_wheel(snapshot, axle, float(self._turned[i]), box)

    def _roll(self, snapshot: Snapshot) -> None:
        """Turn the wheels by the rim speed since the last picture."""
        rims = snapshot.readings[[at.R_OMEGA, at.AXLE + at.R_OMEGA]]
        self._turned += max(snapshot.time - self._time, 0.0) * rims / snapshot.plant.vehicle.r
        self._turned %= 2.0 * math.pi
        self._time = snapshot.time

    def _write_posture(self, snapshot: Snapshot, axles: tuple[_Axle, _Axle]) -> None:
        left, top, width, _ = _SIDE
        place = (left + width - 8, top + 13)
        if snapshot.plant.half_car < 0.5:
            text = "bicycle model: the body does not move"
            self.canvas.text(place, text, colour=_MUTED, anchor="midright")
            return
        pitch = _number(math.degrees(snapshot.state[at.PITCH]), 1, "\u00b0", sign=True)
        front, rear = (_number(1e3 * (axle.bottom - axle.mount), 0, " mm", sign=True) for axle in axles)
        x = self.canvas.text((left + 92, top + 13), f"pitch {pitch}") + 14
        x = self.canvas.text((x, top + 13), "compression") + 6
        self.canvas.words((x, top + 13), [(f"front {front}", _FRONT), (f"rear {rear}", _REAR)])

    def _draw_whole(self, snapshot: Snapshot, axles: tuple[_Axle, _Axle], box: Box) -> None:
        vehicle = snapshot.plant.vehicle
        wheelbase = vehicle.l_f + vehicle.l_r
        scale = min(box[2] / (1.9 * wheelbase), box[3] / (5.6 * vehicle.r))
        middle = 0.5 * (vehicle.l_f - vehicle.l_r)
        datum = min(axle.bottom for axle in axles)
        origin = np.array([box[0] + 0.5 * box[2], box[1] + box[3] - 0.6 * vehicle.r * scale])

        def put(places: np.ndarray) -> np.ndarray:
            return origin + scale * (np.asarray(places) - [middle, datum]) * [1.0, -1.0]

        reach = np.linspace(-0.5, 0.5, 121) * box[2] / scale + middle
        yaw = float(snapshot.state[at.YAW])
        X, Y = (snapshot.state[i] + reach * f(yaw) for i, f in ((at.X, math.cos), (at.Y, math.sin)))
        profile = put(np.column_stack((reach, heights(snapshot.course.ground, X, Y))))
        base = box[1] + box[3]
        with self.canvas.clipped(box):
            soil = np.concatenate((profile, [[profile[-1, 0], base], [profile[0, 0], base]]))
            self.canvas.shape(soil, _SOIL)
            self._draw_body(snapshot, axles, put, scale)
            self.canvas.stroke(profile, _EDGE, 1.0)
            self._draw_scale(box, scale)

    def _draw_body(self, snapshot: Snapshot, axles: tuple[_Axle, _Axle], put: Any, scale: float) -> None:
        vehicle = snapshot.plant.vehicle
        r = vehicle.r
        # The line through both mounts is the body's: it carries pitch, slope and heave at once.
        (front, rear), wheelbase = axles, vehicle.l_f + vehicle.l_r
        tilt = math.atan2(front.mount - rear.mount, wheelbase)
        start = np.array([-vehicle.l_r, rear.mount + r])

        def body(shape: list[list[float]]) -> np.ndarray:
            return put(start + _turned(np.array(shape), tilt))

        L, over = wheelbase, 1.35 * r
        hull = [
            [-over, 1.25 * r], [-0.95 * r, 1.25 * r], [0.95 * r, 0.25 * r], [L - 0.95 * r, 0.25 * r],
            [L + 0.8 * r, 1.25 * r], [L + over, 1.25 * r], [L + over, 1.55 * r], [L - 0.9 * r, 2.15 * r],
            [-over, 2.15 * r],
        ]  # fmt: skip
        for cage in (
            [[-0.6 * r, 2.1 * r], [-0.2 * r, 3.1 * r], [0.62 * L, 3.1 * r], [L - 0.9 * r, 2.1 * r]],
            [[0.35 * L, 2.1 * r], [0.35 * L, 3.1 * r]],
        ):
            self.canvas.stroke(body(cage), _BODY, 3.0)
        self.canvas.shape(body(hull), _BODY, _INK)
        for i, axle in enumerate(axles):
            hub = put(np.array([axle.arm, axle.bottom + r]))
            self._draw_disc(hub, r * scale, float(self._turned[i]), axle.colour)
            self._draw_spring(hub, body([[L if i == 0 else 0.0, 1.75 * r]])[0])

    def _draw_spring(self, hub: np.ndarray, mount: np.ndarray) -> None:
        """A zigzag whose length is the true distance of wheel and body."""
        along = mount - hub
        across = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
        share = np.linspace(0.0, 1.0, 10)
        swing = np.array([0.0, 0.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0])
        self.canvas.stroke(hub + share[:, None] * along + 5.0 * swing[:, None] * across, _PANEL, 2.0)
        for end in (hub, mount):
            self.canvas.disc(end, 3.0, _PANEL)

    def _draw_disc(self, hub: np.ndarray, radius: float, turned: float, colour: Colour) -> None:
        """A wheel with spokes that turn to the right as it rolls forward."""
        self.canvas.disc(hub, radius, _TYRE)
        self.canvas.disc(hub, 0.62 * radius, colour)
        for spoke in range(5):
            angle = turned + 0.4 * math.pi * spoke
            end = hub + 0.62 * radius * np.array([math.cos(angle), math.sin(angle)])
            self.canvas.stroke(np.array([hub, end]), _TYRE, max(0.05 * radius, 2.0))

    def _draw_scale(self, box: Box, scale: float) -> None:
        length = _round_number(60.0 / scale)
        x, y = box[0] + 10, box[1] + 14
        self.canvas.stroke(np.array([[x, y], [x + length * scale, y]]), _INK, 3.0)
        self.canvas.text((x + length * scale + 7, y - 1), f"{length:g} m")

    def _draw_wheel(self, snapshot: Snapshot, axle: _Axle, turned: float, box: Box) -> None:
        """The lower part of a wheel, the soil ahead of it and the rut behind it, at one scale."""
        canvas, r = self.canvas, snapshot.plant.vehicle.r
        self._write_wheel(axle, box)
        left, top, width, height = box[0], box[1] + self._CAPTION, box[2], box[3] - self._CAPTION
        scale = width / (2.3 * r)
        # The surface stays where it is unless the wheel would leave the picture below.
        surface = min(top + 0.58 * height, top + height - 12.0 - axle.sinkage * scale)
        origin = np.array([left + 0.42 * width, surface])

        def put(places: np.ndarray) -> np.ndarray:
            return origin + scale * places * [1.0, -1.0]

        with canvas.clipped((left, top, width, height)):
            canvas.box((left, top, width, height), (240, 243, 246))
            line = self._surface(snapshot, axle)
            base = (top + height + 4 - surface) / -scale
            canvas.shape(put(np.concatenate((line, [[line[-1, 0], base], [line[0, 0], base]]))), _SOIL)
            canvas.stroke(put(line), _EDGE, 2.0)
            hub = put(np.array([0.0, axle.bottom - axle.ground + r]))
            self._draw_disc(hub, r * scale, turned, axle.colour)
            self._draw_depth(axle, origin, scale, left + width - 40.0)
        canvas.pygame.draw.rect(canvas.surface, axle.colour, box, 2)

    def _surface(self, snapshot: Snapshot, axle: _Axle) -> np.ndarray:
        """(N, 2) line of the soil around a wheel [m], from its lowest undeformed point: rut, arc, ahead.

        The rut is as deep as the wheel where it leaves the soil, at the model's exit angle.
        """
        plant, yaw = snapshot.plant, float(snapshot.state[at.YAW])
        reach = 1.5 * plant.vehicle.r
        x = np.linspace(-reach, reach, 61)
        way = 1.0 if axle.readings[at.R_OMEGA] >= 0.0 else -1.0
        place = axle.readings[[at.WHEEL_X, at.WHEEL_Y]]
        X, Y = place[0] + x * math.cos(yaw), place[1] + x * math.sin(yaw)
        line = heights(snapshot.course.ground, X, Y) - axle.ground
        if axle.sinkage > 0.0:
            r = plant.vehicle.r
            theta_f = entry_angle(axle.sinkage, r)
            theta_r = contact_angle_shares(plant.soil, float(axle.readings[at.SLIP]))[1] * theta_f
            rut = axle.sinkage - r * (1.0 - math.cos(theta_r))
            ahead = way * x
            inside = np.clip(ahead, r * math.sin(theta_r), r * math.sin(theta_f))
            arc = r - np.sqrt(r * r - inside * inside) - axle.sinkage
            behind = ahead < r * math.sin(theta_r)
            line = np.where(behind, line - rut, np.where(ahead <= r * math.sin(theta_f), arc, line))
        return np.column_stack((x, line))

    def _draw_depth(self, axle: _Axle, origin: np.ndarray, scale: float, x: float) -> None:
        """The sinkage as a dimension beside the wheel, from its lowest point to the level of the ground."""
        if axle.sinkage <= 0.0:
            return
        top, bottom = float(origin[1]), float(origin[1] + axle.sinkage * scale)
        self.canvas.stroke(np.array([[x - 8.0, top], [x + 8.0, top]]), _INK, 2.0)
        self.canvas.stroke(np.array([[origin[0], bottom], [x + 8.0, bottom]]), _INK, 1.0)
        self.canvas.stroke(np.array([[x, top], [x, bottom]]), _INK, 2.0)

    def _write_wheel(self, axle: _Axle, box: Box) -> None:
        readings, canvas = axle.readings, self.canvas
        right, y = box[0] + box[2] - 8, box[1] + 12
        sinkage = "no contact" if axle.airborne else f"sinkage {_number(1e3 * axle.sinkage, 0)} mm"
        canvas.text((box[0] + 8, y), axle.name, size=20, colour=axle.colour)
        canvas.text((right, y), sinkage, size=20, anchor="midright")
        load = float(readings[at.N])
        text = _number(1e-3 * load, 1, " kN") if load >= 1e3 else _number(load, 0, " N")
        canvas.text((box[0] + 52, y), text, colour=_MUTED)
        canvas.text((box[0] + 8, y + 17), f"slip {_number(readings[at.SLIP], 2, sign=True)}")
        angle = math.degrees(math.atan2(readings[at.V_C], max(abs(readings[at.V_L]), 1e-3)))
        text = f"slip angle {_number(angle, 1, sign=True)}\u00b0"
        canvas.text((right, y + 17), text, anchor="midright")


# ---------------------------------------------------------------------- over time


class _Axes:
    """A plot over time: where a value sits on the canvas."""

    def __init__(self, canvas: _Canvas, box: Box, span: float, limits: tuple[float, float]) -> None:
        self.canvas, self.box, self.span, self.limits = canvas, box, span, limits

    def points(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(N, 2) pixels, values held inside the plot."""
        left, top, width, height = self.box
        low, high = self.limits
        share = np.clip((np.asarray(values) - low) / (high - low), 0.0, 1.0)
        x, y = np.broadcast_arrays(left + np.asarray(time) / self.span * width, top + (1.0 - share) * height)
        return np.column_stack((x, y))

    def frame(self, ticks: Sequence[float], digits: int, *, times: bool) -> None:
        """Background, grid, and numbers of the vertical axis (and of time below)."""
        left, top, width, height = self.box
        self.canvas.box(self.box, (255, 255, 255))
        for tick in ticks:
            y = float(self.points(np.zeros(1), np.array([tick]))[0, 1])
            self.canvas.box((left, round(y), width, 1), _GRID)
            self.canvas.text((left - 5, y), _number(tick, digits), size=16, colour=_MUTED, anchor="midright")
        for i in range(6):
            x = left + width * i // 5
            self.canvas.box((x, top, 1, height), _GRID)
            if times:
                unit = " s" if i == 5 else ""
                text = f"{self.span * i / 5:g}{unit}"
                self.canvas.text((x, top + height + 10), text, size=16, colour=_MUTED, anchor="center")

    def line(self, time: np.ndarray, values: np.ndarray, colour: Colour, width: float = 2.0) -> None:
        """A curve."""
        self.canvas.stroke(self.points(time, values), colour, width)

    def dashed(self, time: np.ndarray, values: np.ndarray, colour: Colour, width: float = 2.0) -> None:
        """A curve in dashes that stand still while it grows, so that another shows beneath."""
        dash = 7.0 * self.span / self.box[2]
        for start in np.arange(0.0, time[-1], 2.0 * dash):
            ends = np.minimum([start, start + dash], time[-1])
            self.line(ends, np.interp(ends, time, values), colour, width)

    def level(self, value: float, colour: Colour) -> None:
        """A dashed horizontal line."""
        y = round(float(self.points(np.zeros(1), np.array([value]))[0, 1]))
        for x in range(self.box[0], self.box[0] + self.box[2], 12):
            self.canvas.box((x, y, min(7, self.box[0] + self.box[2] - x), 1), colour)

    def band(self, time: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour) -> None:
        """The area between two curves."""
        if len(time) > 1:
            self.canvas.shape(np.concatenate((self.points(time, low), self.points(time, high)[::-1])), colour)


def _time_span(time: float) -> float:
    """End of the time axis [s]: a multiple of 10 that rarely changes."""
    ends = (10.0, 20.0, 30.0, 50.0, 75.0, 100.0)
    return next((end for end in ends if time <= end), 50.0 * math.ceil(time / 50.0))


class _Charts:
    """n with its estimate, speed, slip and cross-track error over time."""

    _GUTTER = 46  # room for numbers at the left [pixels]

    def __init__(self, canvas: _Canvas) -> None:
        self.canvas = canvas

    def draw(self, snapshot: Snapshot, history: _History) -> None:
        """Both panels."""
        rows = history.thinned(220)
        span = _time_span(snapshot.time)
        self._draw_exponent(snapshot, rows, span)
        self._draw_strips(snapshot, rows, span)

    def _draw_exponent(self, snapshot: Snapshot, rows: np.ndarray, span: float) -> None:
        left, top, width, height = _EXPONENT
        canvas, (low, high) = self.canvas, snapshot.n_range
        canvas.box(_EXPONENT, _PANEL, _MUTED)
        margin = max(0.12 * (high - low), 0.05)
        limits = (low - margin, high + margin)
        box = (left + self._GUTTER, top + 28, width - self._GUTTER - 18, height - 48)
        axes = _Axes(canvas, box, span, limits)
        step = _round_number(0.4 * (limits[1] - limits[0]))
        ticks = step * np.arange(math.ceil(limits[0] / step), math.floor(limits[1] / step) + 1)
        axes.frame(ticks, max(-math.floor(math.log10(step)), 0), times=True)
        time, mean, sd = rows[:, _History.TIME], rows[:, _History.MEAN], rows[:, _History.SD]
        estimate, true = snapshot.estimate, rows[-1, _History.N]
        words = [("Sinkage exponent n", _INK), (f"true {_number(true, 2)}", _INK)]
        with canvas.clipped(box):
            if estimate is None:
                whole = np.array([0.0, span])
                axes.band(whole, np.full(2, low), np.full(2, high), _PRIOR_BAND)
            else:
                axes.band(time, mean - 2.0 * sd, mean + 2.0 * sd, _ESTIMATE_BAND)
                axes.line(time, mean, _ESTIMATE)
            axes.dashed(time, rows[:, _History.N], _INK)
        if estimate is None:
            words.append((f"no estimator: prior {low:g} \u2026 {high:g}", _MUTED))
        else:
            words.append((f"estimate {estimate.mean:.2f} \u00b1 {2.0 * estimate.sd:.2f} (2 sd)", _ESTIMATE))
        canvas.words((left + 8, top + 14), words, size=19)

    def _draw_strips(self, snapshot: Snapshot, rows: np.ndarray, span: float) -> None:
        left, top, width, height = _STRIPS
        self.canvas.box(_STRIPS, _PANEL, _MUTED)
        each = (height - 22) // 3
        for i, draw in enumerate((self._draw_speed, self._draw_slip, self._draw_error)):
            y = top + 2 + i * each
            box = (left + self._GUTTER, y + 17, width - self._GUTTER - 18, each - 21)
            draw(snapshot, rows, span, box, last=i == 2)

    def _draw_speed(self, snapshot: Snapshot, rows: np.ndarray, span: float, box: Box, *, last: bool) -> None:
        target, speed = snapshot.scenario.target_speed, rows[:, _History.SPEED]
        top = 2.0 * math.ceil(0.55 * max(float(speed.max()), target, 1.0))
        axes = _Axes(self.canvas, box, span, (0.0, top))
        axes.frame((0.0, top), 0, times=last)
        words = [(f"speed {_number(speed[-1], 1)} m/s", _INK)]
        if target > 0.0:
            axes.level(target, _MUTED)
            words.append((f"target {target:g} m/s", _MUTED))
        axes.line(rows[:, _History.TIME], speed, _INK)
        self._title(box, words)

    def _draw_slip(self, snapshot: Snapshot, rows: np.ndarray, span: float, box: Box, *, last: bool) -> None:
        slips = rows[:, [_History.SLIP_F, _History.SLIP_R]]
        top = next((size for size in (0.1, 0.2, 0.5) if np.abs(slips).max() <= size), 1.0)
        axes = _Axes(self.canvas, box, span, (-top, top))
        axes.frame((-top, 0.0, top), 1, times=last)
        words = [("slip of wheels", _INK)]
        for column, name, colour in ((1, "rear", _REAR), (0, "front", _FRONT)):
            axes.line(rows[:, _History.TIME], slips[:, column], colour)
            words.insert(1, (f"{name} {_number(slips[-1, column], 2, sign=True)}", colour))
        self._title(box, words)

    def _draw_error(self, snapshot: Snapshot, rows: np.ndarray, span: float, box: Box, *, last: bool) -> None:
        limit, error = snapshot.scenario.corridor, rows[:, _History.ERROR]
        axes = _Axes(self.canvas, box, span, (-1.15 * limit, 1.15 * limit))
        axes.frame((-limit, 0.0, limit), 1, times=last)
        for side in (-limit, limit):
            axes.level(side, _EDGE)
        axes.line(rows[:, _History.TIME], error, _INK)
        words = [(f"left of the path {_number(error[-1], 2, sign=True)} m", _INK)]
        self._title(box, [*words, (f"corridor \u00b1{limit:g} m", _EDGE)])

    def _title(self, box: Box, words: Sequence[tuple[str, Colour]]) -> None:
        self.canvas.words((box[0], box[1] - 8), words)


# ---------------------------------------------------------------------- the whole picture


class Renderer:
    """Draws an environment; made by ``OffroadBekkerEnv.render``.

    Parameters
    ----------
    mode : {"human", "rgb_array"}
        A window on the screen, or an array; an array needs no screen.
    fps
        Pictures a second that a window waits for [1/s].

    Raises
    ------
    InvalidParameter
        For another mode, or an ``fps`` that is not positive.
    """

    def __init__(self, mode: str, fps: float = 50.0) -> None:
        if mode not in RENDER_MODES:
            raise InvalidParameter(f"mode must be one of {', '.join(RENDER_MODES)}, got {mode!r}")
        if not 0.0 < fps < math.inf:
            raise InvalidParameter(f"fps must be a positive number of pictures a second, got {fps!r}")
        self.mode, self.fps = mode, fps
        self.closed_by_user = False  #: the window was closed: nothing is drawn any more
        self._canvas: _Canvas | None = None
        self._window: Any = None
        self._last: Snapshot | None = None

    def __reduce__(self) -> tuple[type[Renderer], tuple[str, float]]:
        # Surfaces and windows cannot be copied: a copied or pickled environment starts with blank ones.
        return Renderer, (self.mode, self.fps)

    def draw(self, env: OffroadBekkerEnv) -> np.ndarray | None:
        """One picture of the environment as it is now.

        Returns
        -------
        (720, 1280, 3) uint8 array, new with every call; None with mode "human".

        Raises
        ------
        gymnasium.error.DependencyNotInstalled
            Without pygame-ce.
        gymnasium.error.Error
            With mode "human" where no window can be opened.
        """
        if self.closed_by_user:
            return None
        if self._canvas is None:
            self._open()
        self._compose(self._remember(env.snapshot()))
        if self.mode == "rgb_array":
            return self._canvas.pixels()
        self._show()
        return None

    def close(self) -> None:
        """Close the window, if there is one, and forget everything drawn."""
        if self._window is not None:
            self._canvas.pygame.display.quit()
        self._window = self._canvas = self._last = None

    def _open(self) -> None:
        pygame = _import_pygame()
        canvas = _Canvas(pygame, FRAME_SIZE)
        if self.mode == "human":
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(FRAME_SIZE)
            except pygame.error as error:
                raise Error(
                    f'no window can be opened ({error}): render_mode="rgb_array" needs no screen'
                ) from error
            pygame.display.set_caption("OffroadBekker")
            self._clock = pygame.time.Clock()
        self._canvas = canvas
        self._map, self._overview = _MapView(canvas), _Overview(canvas)
        self._side, self._charts = _SideView(canvas), _Charts(canvas)

    def _remember(self, snapshot: Snapshot) -> Snapshot:
        """Add to the history, or start a new one; a diverged state shows the last sound one instead."""
        last = self._last
        if last is None or snapshot.course is not last.course or snapshot.time < last.time:
            self._history = _History()
            self._side.restart()
            self._course = _Course(self._canvas.pygame, snapshot)
        elif not (np.isfinite(snapshot.state).all() and np.isfinite(snapshot.readings).all()):
            return replace(last, ending=snapshot.ending)
        self._history.add(snapshot)
        self._last = snapshot
        return snapshot

    def _compose(self, snapshot: Snapshot) -> None:
        self._canvas.box((0, 0, *FRAME_SIZE), _PAGE)
        self._map.draw(self._course, snapshot, self._history)
        self._overview.draw(self._course, snapshot)
        self._side.draw(snapshot)
        self._charts.draw(snapshot, self._history)
        self._write_header(snapshot)

    def _write_header(self, snapshot: Snapshot) -> None:
        canvas, middle = self._canvas, _HEADER[1] + _HEADER[3] // 2
        x = canvas.text((14, middle), f"OffroadBekker \u00b7 {snapshot.scenario.name}", size=30) + 22
        kind = "half-car" if snapshot.plant.half_car > 0.5 else "bicycle"
        facts = f"{snapshot.model} model, {kind}   |   the agent is told {_TOLD[snapshot.terrain_info]}"
        canvas.text((x, middle + 2), facts, size=22, colour=_MUTED)
        canvas.text((1266, middle), f"t = {snapshot.time:.2f} s", size=28, anchor="midright")
        if snapshot.ending:
            badge = (822, 8, 290, 28)
            canvas.box(badge, _GOOD if snapshot.ending == "goal" else _BAD)
            place = (badge[0] + badge[2] / 2, middle)
            canvas.text(place, _ENDINGS[snapshot.ending], size=26, colour=_PANEL, anchor="center")

    def _show(self) -> None:
        pygame = self._canvas.pygame
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            self.closed_by_user = True
            return
        self._window.blit(self._canvas.surface, (0, 0))
        pygame.display.flip()
        self._clock.tick(self.fps)
