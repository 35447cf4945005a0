"""The vehicle from above, the whole course, and what the driver does."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from offroad_env.environment.snapshot import Snapshot
from offroad_env.physics import state as at
from offroad_env.physics.path_geometry import PathTable, path_point
from offroad_env.rendering.canvas import Canvas, number, rectangle, round_number, turned
from offroad_env.rendering.history import History
from offroad_env.rendering.soil import firmness, varies
from offroad_env.rendering.style import (
    BODY,
    CAB,
    EDGE,
    FIRM,
    FRONT,
    GOOD,
    GRID,
    INK,
    MAP,
    MUTED,
    OVERVIEW,
    PANEL,
    REAR,
    RUT,
    SOFT,
    SOIL_DARK,
    SOIL_LIGHT,
    TYRE,
    Box,
)
from offroad_env.world.terrain import height_map

__all__ = ["CourseDrawing", "MapView", "Overview"]

_WHEELBASE = 2.72  # of `mrzr` [m], at which the scale of the map is _MAP_SCALE
_MAP_SCALE = 24.0  # [pixels/m]
_CELL = 10  # pixels of the map for one value of the terrain's shading
_MOST_CELLS = 500_000
_TINT, _FULL_TINT = 0.75, 0.4  # share of the tint where the logarithm of the pressure at 5 cm is off by that
_ARROW_TIME = 0.5  # an arrow is where its axle gets to in this time [s]


class CourseDrawing:
    """What stays the same for an episode: terrain image, corridor and the outline of the whole path."""

    def __init__(self, pygame: Any, snapshot: Snapshot) -> None:
        self.path: PathTable = snapshot.course.path
        self.corridor = snapshot.scenario.corridor
        vehicle = snapshot.plant.vehicle
        # A small vehicle is shown larger, a large one on more ground.
        self.scale = _MAP_SCALE * math.sqrt(_WHEELBASE / (vehicle.l_f + vehicle.l_r))
        self.view = np.array(MAP[2:]) / self.scale
        self.soil_varies = varies(snapshot.plant)
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
        shades = np.array(SOIL_DARK) + light * (np.array(SOIL_LIGHT) - np.array(SOIL_DARK))
        if self.soil_varies:
            firm = np.clip(firmness(snapshot.plant, X, Y) / _FULL_TINT, -1.0, 1.0)[::-1, :, None]
            tint = np.where(firm > 0.0, np.array(FIRM), np.array(SOFT))
            shades = shades + _TINT * np.abs(firm) * (tint - shades)
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
        return np.array([0.5 * (here[0] + there[0]), 0.5 * (here[1] + there[1])])

    def blit(self, canvas: Canvas, camera: np.ndarray) -> None:
        """The terrain under the view."""
        low = (camera - 0.5 * self.view - self._corner) / self._size
        width, height = self._image.get_size()
        across, up = (int(n) + 3 for n in self.view / self._size)
        column = min(max(math.floor(low[0]), 0), width - across)
        bottom = min(max(math.floor(low[1]), 0), height - up)
        part = self._image.subsurface((column, height - bottom - up, across, up))
        part = canvas.pygame.transform.smoothscale(part, (across * self._cell, up * self._cell))
        x = MAP[0] + (column - low[0]) * self._cell
        y = MAP[1] + MAP[3] - (bottom + up - low[1]) * self._cell
        canvas.surface.blit(part, (round(x), round(y)))


class MapView:
    """The vehicle from above: north up, scrolling along the path."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas

    def draw(self, course: CourseDrawing, snapshot: Snapshot, history: History) -> None:
        """The whole panel."""
        self._camera, self._scale = course.camera(snapshot.progress), course.scale
        canvas = self.canvas
        with canvas.clipped(MAP):
            course.blit(canvas, self._camera)
            self._draw_tracks(snapshot, history)
            self._draw_path(course, snapshot)
            self._draw_vehicle(snapshot)
            self._draw_legend(course)
        canvas.pygame.draw.rect(canvas.surface, MUTED, MAP, 1)

    def _pixel(self, places: np.ndarray) -> np.ndarray:
        """Places [m] (..., 2) on the canvas."""
        middle = np.array([MAP[0] + 0.5 * MAP[2], MAP[1] + 0.5 * MAP[3]])
        return np.asarray(middle + (places - self._camera) * np.array([self._scale, -self._scale]))

    def _draw_tracks(self, snapshot: Snapshot, history: History) -> None:
        vehicle, rows = snapshot.plant.vehicle, history.rows
        middle = rows[:, [history.RUT_X, history.RUT_Y]]
        near = np.abs(middle - self._camera).max(axis=1) < 0.6 * MAP[2] / self._scale
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
            self.canvas.stroke(self._pixel(middle[keep] + side), RUT, max(vehicle.b * self._scale, 2.0))

    def _draw_path(self, course: CourseDrawing, snapshot: Snapshot) -> None:
        reach = float(np.hypot(*course.view))
        near = np.flatnonzero(np.abs(course.s - snapshot.progress) < reach)
        if len(near) < 2:
            near = np.arange(max(len(course.s) - 2, 0), len(course.s))
        part = slice(int(near[0]), int(near[-1]) + 1)
        for edge in course.edges:
            self.canvas.stroke(self._pixel(edge[part]), EDGE, 3.0)
        # Dashes stay where they are on the ground: start at a node whose number is a multiple of 4.
        start = part.start - part.start % 4
        self.canvas.dashes(self._pixel(course.line[start : part.stop]), INK, 2.0)
        for index, name in ((0, "start"), (-1, "finish")):
            ends = self._pixel(np.array([edge[index] for edge in course.edges]))
            colour = GOOD if name == "finish" else INK
            self.canvas.stroke(ends, colour, 5.0)
            top = ends[np.argmin(ends[:, 1])]
            self.canvas.text((top[0], top[1] - 6), name, size=20, colour=colour, anchor="midbottom")

    def _draw_vehicle(self, snapshot: Snapshot) -> None:
        vehicle, state = snapshot.plant.vehicle, snapshot.state
        place, yaw = state[[at.X, at.Y]], float(state[at.YAW])

        def put(shape: np.ndarray) -> np.ndarray:
            return self._pixel(place + turned(shape, yaw))

        front, rear = vehicle.l_f + 1.35 * vehicle.r, -vehicle.l_r - 1.35 * vehicle.r
        half = 0.36 * vehicle.track
        nose = front - 0.9 * vehicle.r
        right = [[rear, -half], [nose, -half], [front, -0.55 * half]]
        hull = np.array(right + [[x, -y] for x, y in reversed(right)])
        steer = road_wheel_angle(snapshot)
        across = 0.5 * vehicle.track if vehicle.wheels_per_axle > 1.0 else 0.0
        sides = (across, -across) if across else (0.0,)
        for arm, angle, colour in ((vehicle.l_f, steer, FRONT), (-vehicle.l_r, 0.0, REAR)):
            for side in sides:
                # Half as wide again as the wheel: at this scale a true one could not be seen to steer.
                wheel = turned(rectangle(0.0, 0.0, 2.0 * vehicle.r, 1.5 * vehicle.b), angle)
                self.canvas.shape(put(wheel + np.array([arm, side])), TYRE, colour)
        self.canvas.shape(put(hull), BODY, INK)
        cab = rectangle(0.12 * vehicle.l_f, 0.0, 0.9 * vehicle.l_f, 1.5 * half)
        self.canvas.shape(put(cab), CAB, INK)
        for arm, colour in ((vehicle.l_f, FRONT), (-vehicle.l_r, REAR)):
            side_speed = state[at.V_Y] + arm * state[at.YAW_RATE]
            ends = np.array([[arm, 0.0], [arm + _ARROW_TIME * state[at.V_X], _ARROW_TIME * side_speed]])
            start, end = put(ends)
            self.canvas.arrow(start, end, colour)

    def _draw_legend(self, course: CourseDrawing) -> None:
        canvas = self.canvas
        left, bottom = MAP[0] + 8, MAP[1] + MAP[3] - 30
        canvas.box((left, bottom, 610, 22), PANEL)
        x = canvas.words((left + 8, bottom + 11), [("\u2013 \u2013 path", INK), ("corridor", EDGE)])
        x = canvas.text((x, bottom + 11), f"\u00b1{course.corridor:g} m", colour=EDGE) + 16
        x = canvas.text((x, bottom + 11), "wheel tracks", colour=(126, 98, 60)) + 16
        x = canvas.text((x, bottom + 11), f"way of the axles in {_ARROW_TIME:g} s:") + 6
        x = canvas.words((x, bottom + 11), [("front", FRONT), ("rear", REAR)])
        if course.soil_varies:
            canvas.box((left, bottom - 26, 300, 22), PANEL)
            for place, colour, word in ((left + 8, SOFT, "softer soil"), (left + 122, FIRM, "firmer soil")):
                canvas.box((place, bottom - 22, 18, 14), colour, MUTED)
                canvas.text((place + 25, bottom - 15), word)
        length = round_number(130.0 / course.scale)
        right = MAP[0] + MAP[2] - 14
        start = right - length * course.scale
        canvas.box((round(start) - 8, bottom - 14, round(right - start) + 16, 36), PANEL)
        bar = np.array([[start, bottom + 12], [right, bottom + 12]])
        canvas.stroke(bar, INK, 3.0)
        for x in (start, right):
            canvas.stroke(np.array([[x, bottom + 6], [x, bottom + 18]]), INK, 2.0)
        canvas.text((0.5 * (start + right), bottom - 3), f"{length:g} m", anchor="center")


class Overview:
    """The whole course with the vehicle on it, and what the driver does."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas

    def draw(self, course: CourseDrawing, snapshot: Snapshot) -> None:
        """The whole panel."""
        left, top, width, height = OVERVIEW
        canvas = self.canvas
        canvas.box(OVERVIEW, PANEL, MUTED)
        done = min(max(snapshot.progress, 0.0), course.path.length)
        text = f"whole course: {done:.0f} of {course.path.length:.0f} m"
        canvas.text((left + 8, top + 12), text)
        self._draw_course(course, snapshot, Box(left + 10, top + 22, 440, height - 30))
        vehicle, (_, drive) = snapshot.plant.vehicle, snapshot.command
        steer = road_wheel_angle(snapshot)
        place = (left + width - 190, top + 30)
        share = -steer / vehicle.steer_max
        self._draw_gauge(place, "steering", share, number(math.degrees(steer), 0, "\u00b0", sign=True))
        name = "drive" if drive >= 0.0 else "brake"
        self._draw_gauge((place[0], place[1] + 34), name, drive, number(100.0 * abs(drive), 0, " %"))

    def _draw_course(self, course: CourseDrawing, snapshot: Snapshot, box: Box) -> None:
        low, high = course.line.min(axis=0), course.line.max(axis=0)
        extent = np.maximum(high - low, 1.0)
        scale = float((np.array([box.width, box.height]) / extent).min())
        flip = np.array([scale, -scale])
        middle = 0.5 * (low[1] + high[1])
        origin = np.array([box.left, box.top + 0.5 * box.height]) - flip * np.array([low[0], middle])
        line = origin + flip * course.line
        self.canvas.stroke(line, (188, 176, 154), 4.0)
        self.canvas.stroke(line[course.s <= snapshot.progress], INK, 2.0)
        self.canvas.disc(line[-1], 5.0, GOOD)
        here = origin + flip * snapshot.state[[at.X, at.Y]]
        self.canvas.disc(here, 8.0, PANEL)
        self.canvas.disc(here, 6.0, INK)

    def _draw_gauge(self, place: tuple[int, int], name: str, share: float, value: str) -> None:
        """A bar to the left or right of its middle for ``share`` in -1 ... 1."""
        canvas, (x, y) = self.canvas, place
        canvas.text((x - 10, y), name, anchor="midright")
        canvas.box((x, y - 8, 120, 16), GRID, MUTED)
        length = round(58.0 * min(max(share, -1.0), 1.0))
        canvas.box((x + 60 + min(length, 0), y - 7, abs(length), 14), MUTED)
        canvas.box((x + 59, y - 11, 2, 22), INK)
        canvas.text((x + 178, y), value, anchor="midright")


def road_wheel_angle(snapshot: Snapshot) -> float:
    """Angle of the front wheels [rad]: the paper's model has no actuator, its wheels follow at once."""
    if snapshot.model == "paper":
        return snapshot.command[0] * snapshot.plant.vehicle.steer_max
    return float(snapshot.state[at.STEER])
