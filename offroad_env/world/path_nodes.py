"""Nodes of reference paths at equal distances along them: roads of clothoids, and sine curves."""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.numerics import lane_rows, sin_cos
from offroad_env.physics.records import FloatArray

__all__ = ["clothoid_nodes", "sine_nodes"]

#: A step leaves about the cube of what is missing of an arc length: from here that is rounding [m].
_CLOSE = 2e-5
_STEPS = 6


@kernel
def clothoid_nodes(
    breaks: FloatArray,
    values: FloatArray,
    gauss: FloatArray,
    weight: FloatArray,
    ds: float,
    nodes: FloatArray,
) -> None:
    """A path whose curvature is linear between breaks, from the origin along X.

    Parameters
    ----------
    breaks, values : (K,) rising arc lengths [m], the first at the start and the last at or beyond the end,
        and the curvature there [1/m]
    gauss, weight : (G,) nodes and weights of a quadrature on 0 ... 1
    ds : distance between the nodes of the path [m]
    nodes : (N + 1, 4) of zeros, becomes X, Y [m], yaw [rad] and curvature [1/m]
    """
    count, points = len(nodes) - 1, len(gauss)
    sines = np.empty(count * points)
    _clothoid_yaws(breaks, values, gauss, ds, nodes, sines)
    cosines = np.empty_like(sines)
    for k in range(len(sines)):  # a loop of its own: it becomes vector instructions
        sines[k], cosines[k] = sin_cos(sines[k])
    X = Y = 0.0
    for i in range(count):
        forward = left = 0.0
        for j in range(points):
            forward += weight[j] * cosines[i * points + j]
            left += weight[j] * sines[i * points + j]
        X += ds * forward
        Y += ds * left
        nodes[i + 1, 0], nodes[i + 1, 1] = X, Y


@inline_kernel
def _clothoid_yaws(
    breaks: FloatArray, values: FloatArray, gauss: FloatArray, ds: float, nodes: FloatArray, yaws: FloatArray
) -> None:
    """Yaw and curvature of the nodes, and the yaw (N G,) at the points of the quadrature between them."""
    piece, reached = 0, 0.0  # yaw at the start of the piece
    slope = (values[1] - values[0]) / (breaks[1] - breaks[0])
    points = len(gauss)
    for i in range(len(nodes) - 1):
        for j in range(points + 1):
            s = (i + gauss[j]) * ds if j < points else (i + 1) * ds
            while s >= breaks[piece + 1] and piece < len(breaks) - 2:
                reached += 0.5 * (breaks[piece + 1] - breaks[piece]) * (values[piece] + values[piece + 1])
                piece += 1
                slope = (values[piece + 1] - values[piece]) / (breaks[piece + 1] - breaks[piece])
            gone = s - breaks[piece]
            yaw = reached + (values[piece] + 0.5 * slope * gone) * gone
            if j < points:
                yaws[i * points + j] = yaw
            else:
                nodes[i + 1, 2], nodes[i + 1, 3] = yaw, values[piece] + slope * gone


@inline_kernel
def _sine_at(steepest: float, k: float, X: float) -> tuple[float, float, float]:
    """(sin k X, dY/dX, dC/dX) of a sine curve, C its arc length; ``steepest`` is dY/dX at the origin."""
    sine, cosine = sin_cos(k * X)
    steepness = steepest * cosine
    return sine, steepness, math.sqrt(1.0 + steepness * steepness)


@kernel
def sine_nodes(
    amplitude: float, k: float, gauss: FloatArray, weight: FloatArray, ds: float, nodes: FloatArray
) -> None:
    """The curve Y = amplitude sin(k X) from the origin; arguments as of `clothoid_nodes`, G <= LANES."""
    speeds = lane_rows()[0]
    steepest, X = amplitude * k, 0.0
    sine, steepness, speed = _sine_at(steepest, k, X)
    for i in range(len(nodes)):
        if i > 0:
            start, missing = X, ds
            for _ in range(_STEPS):
                # Half of the slope of ln(dC/dX): dX to second order in what is missing.
                bend = -0.5 * steepest * k * sine * steepness / (speed * speed)
                step = missing / speed
                X += step * (1.0 - bend * step)
                sine, steepness, speed = _sine_at(steepest, k, X)
                if abs(missing) < _CLOSE:
                    break
                missing = ds
                for j in range(len(gauss)):  # a loop of its own: it becomes vector instructions
                    speeds[j] = _sine_at(steepest, k, start + (X - start) * gauss[j])[2]
                for j in range(len(gauss)):
                    missing -= (X - start) * weight[j] * speeds[j]
        nodes[i, 0], nodes[i, 1] = X, amplitude * sine
        nodes[i, 2] = math.atan(steepness)
        nodes[i, 3] = -steepest * k * sine / (speed * speed * speed)
