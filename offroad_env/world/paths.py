"""Reference paths: straight, circle, sine, figure of eight, winding corridor, through waypoints."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from offroad_env.errors import InvalidParameter
from offroad_env.physics.path_geometry import PathTable
from offroad_env.world.catalogue import Quantity
from offroad_env.world.clothoids import RoadLimits, draw_bends
from offroad_env.world.path_nodes import clothoid_nodes, sine_nodes
from offroad_env.world.yaml_text import shown

__all__ = [
    "PathTable",
    "circle",
    "figure_eight",
    "from_waypoints",
    "sine_path",
    "straight",
    "winding_corridor",
]

#: Distance between nodes [m]; the length of a path is met exactly, so it is adapted a little.
NODE_DISTANCE = 0.25

_LENGTH = Quantity("in [1, 1e5] m", 1.0, 1e5)
_RADIUS = Quantity("in [2, 1e4] m", 2.0, 1e4)
_AMPLITUDE = Quantity("in [0, 1000] m", 0.0, 1e3)
_LAPS = Quantity("in (0, 1000]", 0.0, 1e3, low_open=True)
_PLACE = Quantity("in [-1e5, 1e5] m", -1e5, 1e5)
_STRAIGHT = Quantity("in [0, 1000] m", 0.0, 1e3)
_TURN = Quantity("in [0.1, 1.5] rad", 0.1, 1.5, mistakes=((1.5000001, 90.0, "degrees"),))

# Nodes and weights on 0 ... 1. Eleventh order: over 0.25 m of a curve of 2 m radius exact to rounding.
_GAUSS, _WEIGHT = np.polynomial.legendre.leggauss(6)
_GAUSS, _WEIGHT = 0.5 * (1.0 + _GAUSS), 0.5 * _WEIGHT

#: A plane curve: ``curve(t, k)`` is its k-th derivative by t, as (x, y), k = 0, 1, 2.
Curve = Callable[[np.ndarray, int], tuple[np.ndarray, np.ndarray]]


def _table(length: float, X: ArrayLike, Y: ArrayLike, yaw: ArrayLike, curvature: ArrayLike) -> PathTable:
    nodes = np.column_stack(np.broadcast_arrays(X, Y, yaw, curvature)).astype(np.float64)
    return PathTable(length / (len(nodes) - 1), np.ascontiguousarray(nodes))


def _distances(length: float) -> int:
    """How many distances between nodes a path has, each about ``NODE_DISTANCE``."""
    return max(math.ceil(length / NODE_DISTANCE - 1e-9), 1)


def _stations(length: float) -> np.ndarray:
    """Arc length at the nodes [m], ending exactly at ``length``."""
    return np.linspace(0.0, length, _distances(length) + 1)


def _empty(length: float) -> PathTable:
    """A path whose nodes are still to be written."""
    count = _distances(length)
    return PathTable(length / count, np.zeros((count + 1, 4)))


def _arc_length(curve: Curve, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Length of the curve from parameter ``start`` to ``end``, by Gauss quadrature."""
    t = start[:, None] + (end - start)[:, None] * _GAUSS
    speed: np.ndarray = np.hypot(*curve(t, 1))
    length: np.ndarray = (end - start) * (speed @ _WEIGHT)
    return length


def _sample(curve: Curve, marks: np.ndarray) -> PathTable:
    """Nodes at uniform arc length along a curve given by any parameter.

    ``marks`` divides the parameter's range so finely that the speed |dC/dt| is smooth in between; the
    path ends with them.
    """
    travelled = np.concatenate([[0.0], np.cumsum(_arc_length(curve, marks[:-1], marks[1:]))])
    length = float(travelled[-1])
    s = _stations(length)
    piece = np.clip(np.searchsorted(travelled, s, side="right") - 1, 0, len(marks) - 2)
    t = np.interp(s, travelled, marks)
    for _ in range(6):  # Newton: the slope of arc length over t is the speed
        missing = s - travelled[piece] - _arc_length(curve, marks[piece], t)
        t = t + missing / np.hypot(*curve(t, 1))
    x_1, y_1 = curve(t, 1)
    x_2, y_2 = curve(t, 2)
    curvature = (x_1 * y_2 - y_1 * x_2) / np.hypot(x_1, y_1) ** 3
    return _table(length, *curve(t, 0), np.unwrap(np.arctan2(y_1, x_1)), curvature)


def straight(length: float) -> PathTable:
    """A straight path along X.

    Raises
    ------
    InvalidParameter
        If ``length`` lies outside 1 ... 1e5 m.
    """
    length = _LENGTH.check("length", length)
    return _table(length, _stations(length), 0.0, 0.0, 0.0)


def circle(radius: float, laps: float = 1.0, *, left: bool = True) -> PathTable:
    """A circle through the origin, entered along X and written out for ``laps`` rounds.

    Parameters
    ----------
    radius
        Radius [m].
    laps
        Number of rounds, any positive number.
    left
        Turn left (centre on the positive Y axis) or right.

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """
    radius = _RADIUS.check("radius", radius)
    length = _LENGTH.check("2 pi radius laps", 2.0 * math.pi * radius * _LAPS.check("laps", laps))
    curvature = 1.0 / radius if left else -1.0 / radius
    yaw = curvature * _stations(length)
    return _table(length, np.sin(yaw) / curvature, (1.0 - np.cos(yaw)) / curvature, yaw, curvature)


def sine_path(length: float, amplitude: float = 5.0, wavelength: float = 60.0) -> PathTable:
    """The sine curve Y = amplitude sin(2 pi X / wavelength) from the origin, ``length`` along the curve.

    Raises
    ------
    InvalidParameter
        If a value is out of range, or the tightest bend (wavelength^2 / (4 pi^2 amplitude)) is below 2 m.
    """
    length = _LENGTH.check("length", length)
    amplitude = _AMPLITUDE.check("amplitude", amplitude)
    k = 2.0 * math.pi / _LENGTH.check("wavelength", wavelength)
    if amplitude > 0.0:
        _RADIUS.check(
            "smallest radius wavelength^2 / (4 pi^2 amplitude)", min(1.0 / (amplitude * k * k), 1e4)
        )

    path = _empty(length)
    sine_nodes(amplitude, k, _GAUSS, _WEIGHT, path.ds, path.nodes)
    return path


def figure_eight(size: float, laps: float = 1.0) -> PathTable:
    """Gerono's lemniscate X = size sin t, Y = size sin t cos t: a path that crosses itself at the origin.

    Parameters
    ----------
    size
        Half the extent in X [m]; the tightest bend has a radius of about 0.35 sizes.
    laps
        Number of rounds, any positive number.

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """
    size = _RADIUS.check("size", size)
    laps = _LAPS.check("laps", laps)

    def curve(t: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        quarter = 0.5 * math.pi * order  # each derivative shifts a sine by a quarter of a turn
        return size * np.sin(t + quarter), 0.5 * size * 2.0**order * np.sin(2.0 * t + quarter)

    return _sample(curve, np.linspace(0.0, 2.0 * math.pi * laps, math.ceil(200 * laps) + 1))


def from_waypoints(points: ArrayLike) -> PathTable:
    """A path with continuous curvature through given points (cubic spline over the chord length).

    Parameters
    ----------
    points
        (N, 2) positions [m], N >= 3, in order of travel.

    Raises
    ------
    InvalidParameter
        If the shape is wrong, a number is not finite, two neighbours coincide, or the spline bends
        tighter than 2 m.
    """
    from scipy.interpolate import CubicSpline  # here: it takes longer to load than the whole environment

    points = np.array(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise InvalidParameter(f"points must have shape (N, 2) with N >= 3, got {points.shape}")
    for i, (x, y) in enumerate(points):
        _PLACE.check(f"points[{i}] x", x)
        _PLACE.check(f"points[{i}] y", y)
    chords = np.hypot(*np.diff(points, axis=0).T)
    if chords.min() < 1e-3:
        i = int(chords.argmin())
        raise InvalidParameter(f"points[{i}] and points[{i + 1}] coincide: a path needs a direction")
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    spline = CubicSpline(knots, points)

    def curve(t: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        value = spline(t, order)
        return value[..., 0], value[..., 1]

    pieces = [np.linspace(a, b, 9)[:-1] for a, b in pairwise(knots)]
    path = _sample(curve, np.append(np.concatenate(pieces), knots[-1]))
    _LENGTH.check("length of the path through points", path.length)
    tightest = 1.0 / max(float(np.abs(path.nodes[:, 3]).max()), 1e-4)
    _RADIUS.check("smallest radius of the path through points", tightest)
    return path


def winding_corridor(
    rng: np.random.Generator,
    length: float = 300.0,
    *,
    radius_range: tuple[float, float] = (12.0, 40.0),
    straight_range: tuple[float, float] = (5.0, 25.0),
    transition: float = 6.0,
    lead_in: float = 15.0,
    max_heading: float = 1.3,
) -> PathTable:
    """A random winding road: straights and arcs joined by clothoids, from the origin along X.

    Every bend turns to a new heading within +-``max_heading`` of the X axis, at least half of
    ``max_heading`` away from the last one. X therefore grows all along: the road cannot cross itself, and
    its branches stay at least twice the smallest radius apart at a hairpin.

    Parameters
    ----------
    rng
        Source of the road; how much is drawn depends on the other arguments only.
    length
        Length of the road [m].
    radius_range, straight_range
        Smallest and largest radius of arcs and length of straights [m], drawn uniformly.
    transition
        Length of the clothoid between straight and arc [m]; shorter where it would take up more than half
        of a bend.
    lead_in
        Straight at the beginning [m].
    max_heading
        Largest angle to the X axis [rad], at most 1.5.

    Raises
    ------
    InvalidParameter
        If a value is out of range or a range is the wrong way round.
    """
    if not isinstance(rng, np.random.Generator):
        raise InvalidParameter(
            f"rng must be a numpy Generator, got {shown(rng)} - numpy.random.default_rng(seed)?"
        )
    length = _LENGTH.check("length", length)
    radii = _ordered("radius_range", radius_range, _RADIUS)
    straights = _ordered("straight_range", straight_range, _STRAIGHT)
    transition = _LENGTH.check("transition", transition)
    max_heading = _TURN.check("max_heading", max_heading)

    limits = RoadLimits(length, *radii, *straights, transition, max_heading)
    # As many draws as the shortest possible bends need: the state of rng afterwards does not depend on luck.
    bends = math.ceil(length / (0.5 * max_heading * radii[0] + straights[0]))
    lead_in = max(_STRAIGHT.check("lead_in", lead_in), 1e-3)
    breaks, values = draw_bends(rng.random((bends, 3)), limits, lead_in)
    path = _empty(length)
    clothoid_nodes(breaks, values, _GAUSS, _WEIGHT, path.ds, path.nodes)
    return path


def _ordered(name: str, limits: tuple[float, float], quantity: Quantity) -> tuple[float, float]:
    low, high = (quantity.check(f"{name}[{i}]", value) for i, value in enumerate(limits))
    if low > high:
        raise InvalidParameter(f"{name} must be (smallest, largest), got {limits}")
    return low, high
