"""Where a road of straights, clothoids and arcs heads, at its nodes and between them."""

from __future__ import annotations

from offroad_env.physics._jit import exact_kernel
from offroad_env.physics.records import FloatArray

__all__ = ["write_directions"]

# Rows of the table of pieces: where each starts [m], half the slope of its curvature [1/m^2], and its first
# curvature [1/m] and yaw [rad].
_START, _HALF_SLOPE, _CURVATURE, _YAW = range(4)


@exact_kernel
def write_directions(
    pieces: FloatArray, s: FloatArray, inner: FloatArray, between: FloatArray, nodes: FloatArray
) -> None:
    """Yaw and curvature at the nodes into ``nodes`` (N + 1, 4), yaw at the places between into ``between``.

    ``pieces`` (4, P), of linear curvature; ``s`` (N + 1,) and ``inner`` (N, M): arc lengths [m].
    """
    piece, last = 0, pieces.shape[1] - 1
    for i in range(s.shape[0]):
        while piece < last and s[i] >= pieces[_START, piece + 1]:
            piece += 1
        travelled = s[i] - pieces[_START, piece]
        half = pieces[_HALF_SLOPE, piece] * travelled
        nodes[i, 2] = (pieces[_CURVATURE, piece] + half) * travelled + pieces[_YAW, piece]
        nodes[i, 3] = pieces[_CURVATURE, piece] + 2.0 * half
        if i == inner.shape[0]:
            break
        there = piece
        for j in range(inner.shape[1]):
            while there < last and inner[i, j] >= pieces[_START, there + 1]:
                there += 1
            travelled = inner[i, j] - pieces[_START, there]
            half = pieces[_HALF_SLOPE, there] * travelled
            between[i, j] = (pieces[_CURVATURE, there] + half) * travelled + pieces[_YAW, there]
