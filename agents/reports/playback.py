"""A drive that a page plays back: from above, wheels from the side, and its time series with one scrubber.

The drawing is done by ``agents/templates/playback.js``, some hundred lines that are embedded in the page.
Plotting libraries that do the same take a megabyte (bokeh) to five (plotly) of a page that may have five,
and neither draws a vehicle.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

__all__ = ["HOW_TO", "Above", "Chart", "Line", "Playback", "WheelSide"]

#: What can be done with a playback.
HOW_TO = (
    "Move the slider or press the button. Drag across a chart to zoom all of them, double-click to see the "
    "whole again."
)
#: Most samples of a series that a page gets: more than a screen has columns of pixels.
_MOST = 1200
#: Most points of a path that is drawn once.
_MOST_POINTS = 800
#: Digits of a number: no eye sees more.
_DIGITS = 5


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of a chart, with a band where ``low`` and ``high`` are given; NaN is a gap."""

    label: str
    values: np.ndarray  #: (T,)
    low: np.ndarray | None = None  #: (T,)
    high: np.ndarray | None = None  #: (T,)
    dashed: bool = False


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Lines over time with one unit."""

    title: str
    unit: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, kw_only=True)
class Above:
    """Where the vehicle was."""

    x: np.ndarray  #: (T,) [m]
    y: np.ndarray  #: (T,) [m]
    yaw: np.ndarray  #: (T,) [rad]
    path: np.ndarray | None = None  #: (P, 2) reference path [m]
    corridor: float = 0.0  #: half its width [m]; 0 for none
    stretches: tuple[tuple[float, float, str], ...] = ()  #: of other soil: from, to along the path [m], name


@dataclass(frozen=True, kw_only=True)
class WheelSide:
    """A wheel seen from the left; what is unknown is None and not drawn."""

    name: str
    radius: float  #: [m]
    turned: np.ndarray  #: (T,) angle since the start [rad]
    sinkage: np.ndarray | None = None  #: (T,) below the undisturbed surface [m]
    slip: np.ndarray | None = None  #: (T,) [-]


@dataclass(frozen=True, kw_only=True)
class Playback:
    """What a page plays back."""

    t: np.ndarray  #: (T,) [s]
    charts: tuple[Chart, ...]
    above: Above | None = None
    wheels: tuple[WheelSide, ...] = ()
    caption: str = ""

    def embedded(self) -> Markup:
        """The data as JSON that may stand in a page's script element."""
        text = json.dumps(self._content(), separators=(",", ":"), allow_nan=False)
        return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))

    def _content(self) -> dict[str, Any]:
        rows = np.unique(np.linspace(0, len(self.t) - 1, min(_MOST, len(self.t))).round().astype(int))
        content: dict[str, Any] = {
            "t": _plain(self.t[rows] - self.t[0]),
            "charts": [_chart(chart, rows) for chart in self.charts],
            "wheels": [
                {
                    "name": wheel.name,
                    "radius": wheel.radius,
                    "turned": _plain(np.mod(wheel.turned[rows], 2.0 * math.pi)),
                    "sinkage": _optional(wheel.sinkage, rows),
                    "slip": _optional(wheel.slip, rows),
                }
                for wheel in self.wheels
            ],
        }
        if self.above is not None:
            content["above"] = _above(self.above, rows)
        return content


def _chart(chart: Chart, rows: np.ndarray) -> dict[str, Any]:
    lines = [
        {
            "label": line.label,
            "dashed": line.dashed,
            "values": _plain(line.values[rows]),
            "low": _optional(line.low, rows),
            "high": _optional(line.high, rows),
        }
        for line in chart.lines
    ]
    return {"title": chart.title, "unit": chart.unit, "lines": lines}


def _above(above: Above, rows: np.ndarray) -> dict[str, Any]:
    path, stretches = above.path, []
    if path is not None:
        way = np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))
        for start, end, name in above.stretches:
            inside = path[(way >= start) & (way <= end)]
            if len(inside) > 1:
                stretches.append({"name": name, "points": _points(inside)})
    return {
        "x": _plain(above.x[rows]),
        "y": _plain(above.y[rows]),
        "yaw": _plain(above.yaw[rows]),
        "path": None if path is None else _points(path),
        "corridor": above.corridor,
        "stretches": stretches,
    }


def _points(path: np.ndarray) -> list[list[float | None]]:
    every = max(len(path) // _MOST_POINTS, 1)
    return [_plain(point) for point in path[::every]]


def _optional(values: np.ndarray | None, rows: np.ndarray) -> list[float | None] | None:
    return None if values is None else _plain(values[rows])


def _plain(values: Sequence[float] | np.ndarray) -> list[float | None]:
    """Numbers with some digits; what is not finite is None."""
    return [
        float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]
