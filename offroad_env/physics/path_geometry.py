"""Reference paths: position along them, distance from them, what lies ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["PathFoot", "PathPoint", "PathTable", "nearest_index", "path_point", "preview", "project"]


class PathTable(NamedTuple):
    """A smooth path by its nodes at uniform distance; made by the factories in ``offroad_env.world.paths``.

    Between nodes position and yaw are cubic Hermite interpolants (their slopes are the unit tangent
    and the curvature), curvature is linear: clothoids and arcs are followed to 1e-6 m. Before the
    first and behind the last node the path goes on straight, so that the distance travelled stays
    defined at start and finish. A closed course is written out lap by lap.
    """

    ds: float  #: arc length from node to node [m]
    nodes: FloatArray  #: (N, 4) float64, C order: X [m], Y [m], yaw [rad, unwrapped], curvature [1/m]

    @property
    def s(self) -> FloatArray:
        """Arc length at the nodes, shape (N,) [m]."""
        return self.ds * np.arange(len(self.nodes), dtype=np.float64)

    @property
    def xy(self) -> FloatArray:
        """Positions of the nodes, shape (N, 2) [m]."""
        return self.nodes[:, :2].copy()

    @property
    def yaw(self) -> FloatArray:
        """Direction of travel at the nodes, unwrapped, shape (N,) [rad]."""
        return self.nodes[:, 2].copy()

    @property
    def curvature(self) -> FloatArray:
        """Curvature at the nodes, positive in a left turn, shape (N,) [1/m]."""
        return self.nodes[:, 3].copy()

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return self.ds * (len(self.nodes) - 1)


class PathPoint(NamedTuple):
    """A point of a path."""

    X: float  #: [m]
    Y: float  #: [m]
    yaw: float  #: direction of travel, unwrapped [rad]
    curvature: float  #: positive in a left turn [1/m]


class PathFoot(NamedTuple):
    """Foot of the perpendicular from a point on a path."""

    s: float  #: arc length [m], negative before the start, beyond the length behind the end
    cross_track: float  #: distance of the point to the left of the path [m]
    yaw: float  #: direction of the path, unwrapped [rad]
    curvature: float  #: of the path [1/m]
    node: int  #: hint for the next call of `project`


@kernel
def _straight_on(path: PathTable, i: int, s: float) -> PathPoint:
    """Point on the straight line through end node ``i``, ``s`` [m] beyond it."""
    yaw = path.nodes[i, 2]
    return PathPoint(path.nodes[i, 0] + s * math.cos(yaw), path.nodes[i, 1] + s * math.sin(yaw), yaw, 0.0)


@kernel
def path_point(path: PathTable, s: float) -> PathPoint:
    """Point of the path at arc length ``s`` [m]."""
    nodes, ds = path.nodes, path.ds
    last = nodes.shape[0] - 1
    if s < 0.0:
        return _straight_on(path, 0, s)
    if s > last * ds:
        return _straight_on(path, last, s - last * ds)
    i = min(int(s / ds), last - 1)
    t = s / ds - i
    # Cubic Hermite basis: values at both ends, then slopes.
    late = t * t * (3.0 - 2.0 * t)
    early = 1.0 - late
    out, back = ds * t * (1.0 - t) * (1.0 - t), ds * t * t * (t - 1.0)
    yaw_0, yaw_1 = nodes[i, 2], nodes[i + 1, 2]
    X = early * nodes[i, 0] + late * nodes[i + 1, 0] + out * math.cos(yaw_0) + back * math.cos(yaw_1)
    Y = early * nodes[i, 1] + late * nodes[i + 1, 1] + out * math.sin(yaw_0) + back * math.sin(yaw_1)
    yaw = early * yaw_0 + late * yaw_1 + out * nodes[i, 3] + back * nodes[i + 1, 3]
    return PathPoint(X, Y, yaw, nodes[i, 3] + t * (nodes[i + 1, 3] - nodes[i, 3]))


@kernel
def _squared_distance(nodes: FloatArray, i: int, X: float, Y: float) -> float:
    """From node ``i`` to (X, Y) [m^2]."""
    x, y = X - nodes[i, 0], Y - nodes[i, 1]
    squared: float = x * x + y * y
    return squared


@kernel
def nearest_index(path: PathTable, X: float, Y: float) -> int:
    """Index of the node nearest to (X, Y) [m] on the whole path: the first hint for ``project``."""
    best, index = math.inf, 0
    for i in range(path.nodes.shape[0]):
        squared = _squared_distance(path.nodes, i, X, Y)
        if squared < best:
            best, index = squared, i
    return index


@kernel
def _walk(nodes: FloatArray, i: int, X: float, Y: float) -> int:
    """From node ``i`` downhill in distance to the next local minimum: another branch is never reached."""
    last = nodes.shape[0] - 1
    i = min(max(i, 0), last)
    here = _squared_distance(nodes, i, X, Y)
    for direction in (1, -1):
        while 0 <= i + direction <= last:
            there = _squared_distance(nodes, i + direction, X, Y)
            if there >= here:
                break
            here = there
            i += direction
    return i


@kernel
def project(path: PathTable, X: float, Y: float, hint_index: int) -> PathFoot:
    """Foot of the perpendicular from a point on the path, searched from a hint.

    Newton's method on (P - C(s)) . tangent(s) = 0, started at the nearest node near the hint. Where the
    point is close to the centre of curvature the foot is not unique and the step is damped.

    Parameters
    ----------
    path : PathTable
    X, Y : the point [m]
    hint_index : index from the last call (or from ``nearest_index``)
    """
    index = _walk(path.nodes, hint_index, X, Y)
    s = index * path.ds
    for _ in range(8):
        x, y, yaw, curvature = path_point(path, s)
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead = (X - x) * cos + (Y - y) * sin
        cross_track = (Y - y) * cos - (X - x) * sin
        if abs(ahead) < 1e-9:
            break
        if 0.0 < s < path.ds * (path.nodes.shape[0] - 1):
            # The foot lies within one node of the start; a longer step would leave the branch.
            step = ahead / max(1.0 - curvature * cross_track, 0.2)
            s += min(max(step, -path.ds), path.ds)
        else:
            s += ahead
    return PathFoot(s, cross_track, yaw, curvature, index)


@kernel
def preview(path: PathTable, s: float, distances: FloatArray, out: FloatArray) -> None:
    """What the path does ahead of ``s``, into ``out``.

    Parameters
    ----------
    path : PathTable
    s : arc length of the observer on the path [m]
    distances : (K,) float64, how far ahead to look [m]
    out : (K, 2) float64; column 0: curvature there [1/m], column 1: yaw there minus yaw at ``s`` [rad]
    """
    _, _, yaw_here, _ = path_point(path, s)
    for i in range(distances.shape[0]):
        _, _, yaw, curvature = path_point(path, s + distances[i])
        out[i, 0] = curvature
        out[i, 1] = yaw - yaw_here
