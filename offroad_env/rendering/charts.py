"""n with its estimate, speed, slip and cross-track error over time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from offroad_env.environment.snapshot import Snapshot
from offroad_env.rendering.canvas import Canvas, number, round_number
from offroad_env.rendering.history import History
from offroad_env.rendering.style import (
    EDGE,
    ESTIMATE,
    ESTIMATE_BAND,
    EXPONENT,
    FRONT,
    GRID,
    INK,
    MUTED,
    PANEL,
    PRIOR_BAND,
    REAR,
    STRIPS,
    Box,
    Colour,
)

__all__ = ["Charts"]


class _Axes:
    """A plot over time: where a value sits on the canvas."""

    def __init__(self, canvas: Canvas, box: Box, span: float, limits: tuple[float, float]) -> None:
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
            self.canvas.box((left, round(y), width, 1), GRID)
            self.canvas.text((left - 5, y), number(tick, digits), size=16, colour=MUTED, anchor="midright")
        for i in range(6):
            x = left + width * i // 5
            self.canvas.box((x, top, 1, height), GRID)
            if times:
                unit = " s" if i == 5 else ""
                text = f"{self.span * i / 5:g}{unit}"
                self.canvas.text((x, top + height + 10), text, size=16, colour=MUTED, anchor="center")

    def line(self, time: np.ndarray, values: np.ndarray, colour: Colour, width: float = 2.0) -> None:
        """A curve."""
        self.canvas.stroke(self.points(time, values), colour, width)

    def dashed(self, time: np.ndarray, values: np.ndarray, colour: Colour, width: float = 2.0) -> None:
        """A curve in dashes that stand still while it grows, so that another shows beneath."""
        dash = 7.0 * self.span / self.box.width
        for start in np.arange(0.0, time[-1], 2.0 * dash):
            ends = np.minimum([start, start + dash], time[-1])
            self.line(ends, np.interp(ends, time, values), colour, width)

    def level(self, value: float, colour: Colour) -> None:
        """A dashed horizontal line."""
        y = round(float(self.points(np.zeros(1), np.array([value]))[0, 1]))
        for x in range(self.box.left, self.box.left + self.box.width, 12):
            self.canvas.box((x, y, min(7, self.box.left + self.box.width - x), 1), colour)

    def band(self, time: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour) -> None:
        """The area between two curves."""
        if len(time) > 1:
            self.canvas.shape(np.concatenate((self.points(time, low), self.points(time, high)[::-1])), colour)


def _time_span(time: float) -> float:
    """End of the time axis [s]: a multiple of 10 that rarely changes."""
    ends = (10.0, 20.0, 30.0, 50.0, 75.0, 100.0)
    return next((end for end in ends if time <= end), 50.0 * math.ceil(time / 50.0))


class Charts:
    """n with its estimate, speed, slip and cross-track error over time."""

    _GUTTER = 46  # room for numbers at the left [pixels]

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas

    def draw(self, snapshot: Snapshot, history: History) -> None:
        """Both panels."""
        rows = history.thinned(220)
        span = _time_span(snapshot.time)
        self._draw_exponent(snapshot, rows, span)
        self._draw_strips(snapshot, rows, span)

    def _draw_exponent(self, snapshot: Snapshot, rows: np.ndarray, span: float) -> None:
        left, top, width, height = EXPONENT
        canvas, (low, high) = self.canvas, snapshot.n_range
        canvas.box(EXPONENT, PANEL, MUTED)
        margin = max(0.12 * (high - low), 0.05)
        limits = (low - margin, high + margin)
        box = Box(left + self._GUTTER, top + 28, width - self._GUTTER - 18, height - 48)
        axes = _Axes(canvas, box, span, limits)
        step = round_number(0.4 * (limits[1] - limits[0]))
        ticks = step * np.arange(math.ceil(limits[0] / step), math.floor(limits[1] / step) + 1)
        axes.frame(ticks.tolist(), max(-math.floor(math.log10(step)), 0), times=True)
        time, mean, sd = rows[:, History.TIME], rows[:, History.MEAN], rows[:, History.SD]
        estimate, true = snapshot.estimate, rows[-1, History.N]
        words = [("Sinkage exponent n", INK), (f"true {number(true, 2)}", INK)]
        with canvas.clipped(box):
            if estimate is None:
                whole = np.array([0.0, span])
                axes.band(whole, np.full(2, low), np.full(2, high), PRIOR_BAND)
            else:
                axes.band(time, mean - 2.0 * sd, mean + 2.0 * sd, ESTIMATE_BAND)
                axes.line(time, mean, ESTIMATE)
            axes.dashed(time, rows[:, History.N], INK)
        if estimate is None:
            words.append((f"no estimator: prior {low:g} \u2026 {high:g}", MUTED))
        else:
            words.append((f"estimate {estimate.mean:.2f} \u00b1 {2.0 * estimate.sd:.2f} (2 sd)", ESTIMATE))
        canvas.words((left + 8, top + 14), words, size=19)

    def _draw_strips(self, snapshot: Snapshot, rows: np.ndarray, span: float) -> None:
        left, top, width, height = STRIPS
        self.canvas.box(STRIPS, PANEL, MUTED)
        each = (height - 22) // 3
        for i, draw in enumerate((self._draw_speed, self._draw_slip, self._draw_error)):
            y = top + 2 + i * each
            box = Box(left + self._GUTTER, y + 17, width - self._GUTTER - 18, each - 21)
            draw(snapshot, rows, span, box, last=i == 2)

    def _draw_speed(self, snapshot: Snapshot, rows: np.ndarray, span: float, box: Box, *, last: bool) -> None:
        target, speed = snapshot.scenario.target_speed, rows[:, History.SPEED]
        top = 2.0 * math.ceil(0.55 * max(float(speed.max()), target, 1.0))
        axes = _Axes(self.canvas, box, span, (0.0, top))
        axes.frame((0.0, top), 0, times=last)
        words = [(f"speed {number(speed[-1], 1)} m/s", INK)]
        if target > 0.0:
            axes.level(target, MUTED)
            words.append((f"target {target:g} m/s", MUTED))
        axes.line(rows[:, History.TIME], speed, INK)
        self._title(box, words)

    def _draw_slip(self, snapshot: Snapshot, rows: np.ndarray, span: float, box: Box, *, last: bool) -> None:
        slips = rows[:, [History.SLIP_F, History.SLIP_R]]
        top = next((size for size in (0.1, 0.2, 0.5) if np.abs(slips).max() <= size), 1.0)
        axes = _Axes(self.canvas, box, span, (-top, top))
        axes.frame((-top, 0.0, top), 1, times=last)
        words = [("slip of wheels", INK)]
        for column, name, colour in ((1, "rear", REAR), (0, "front", FRONT)):
            axes.line(rows[:, History.TIME], slips[:, column], colour)
            words.insert(1, (f"{name} {number(slips[-1, column], 2, sign=True)}", colour))
        self._title(box, words)

    def _draw_error(self, snapshot: Snapshot, rows: np.ndarray, span: float, box: Box, *, last: bool) -> None:
        limit, error = snapshot.scenario.corridor, rows[:, History.ERROR]
        axes = _Axes(self.canvas, box, span, (-1.15 * limit, 1.15 * limit))
        axes.frame((-limit, 0.0, limit), 1, times=last)
        for side in (-limit, limit):
            axes.level(side, EDGE)
        axes.line(rows[:, History.TIME], error, INK)
        words = [(f"left of the path {number(error[-1], 2, sign=True)} m", INK)]
        self._title(box, [*words, (f"corridor \u00b1{limit:g} m", EDGE)])

    def _title(self, box: Box, words: Sequence[tuple[str, Colour]]) -> None:
        self.canvas.words((box.left, box.top - 8), words)
