"""Ruts: the track that a leading wheel leaves, and what of it a following wheel meets.

A leader notes where it went, how deep the unloaded rut is and how far its soil is sheared, every few
centimetres, in a ring that is part of the contact state (`state`). A follower takes the nearest place of
that track. A vehicle that crosses its own older ruts, or backs up into them, meets virgin soil there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.pressure_sinkage import rebound_modulus
from offroad_env.physics.records import FloatArray, RutSection, Structure

__all__ = ["Place", "find_rut", "follow_rut", "lay_track", "prefill_track", "track_spacing"]


class Place(NamedTuple):
    """Where a wheel is and which way its track goes."""

    x: float  #: [m]
    y: float  #: [m]
    heading: tuple[float, float]  #: (sin, cos)


# Columns of a cell.
_X, _Y, _DEPTH, _SHEAR = range(4)
#: Length of a track over the wheelbase.
_LENGTH = 1.5


@inline_kernel
def track_spacing(wheelbase: float) -> float:
    """Distance between two cells of a track [m]."""
    return _LENGTH * wheelbase / at.CELLS


@inline_kernel
def _cell(number: float) -> int:
    """Where a cell of this number begins in a wheel's row."""
    return at.TRACK + at.CELL_SIZE * (int(number) % at.CELLS)


@inline_kernel
def _rut_depth(structure: Structure, sinkage: float, peak: float) -> float:
    """Depth [m] that a rut keeps when the wheel of ``sinkage`` [m] and ``peak`` pressure [Pa] has left it."""
    return max(sinkage - peak / rebound_modulus(structure.elastic_modulus, peak, sinkage), 0.0)


@inline_kernel
def _note(row: FloatArray, number: float, x: float, y: float, left: tuple[float, float]) -> None:
    """Cell ``number``; ``left`` = (depth [m], shear displacement)."""
    place = _cell(number)
    row[place + _X], row[place + _Y] = x, y
    row[place + _DEPTH], row[place + _SHEAR] = left


@kernel
def lay_track(structure: Structure, row: FloatArray, place: Place, sinkage: float, spacing: float) -> None:
    """Note what a leading wheel leaves at a place where it has gone on by ``spacing`` [m].

    ``row``: the wheel's row of the contact state, which holds its last contact.
    """
    x, y = place.x, place.y
    sin, cos = place.heading
    newest = _cell(row[at.LAID] - 1.0)
    if (x - row[newest + _X]) * cos + (y - row[newest + _Y]) * sin < spacing:
        return
    _note(row, row[at.LAID], x, y, (_rut_depth(structure, sinkage, row[at.PEAK]), row[at.SHEAR]))
    row[at.LAID] += 1.0


@kernel
def prefill_track(
    structure: Structure, row: FloatArray, place: Place, sinkage: float, spacing: float
) -> None:
    """A track as if the wheel had come straight to a place, sinking as it does there."""
    x, y = place.x, place.y
    sin, cos = place.heading
    left = _rut_depth(structure, sinkage, row[at.PEAK]), row[at.SHEAR]
    for i in range(at.CELLS):
        back = (at.CELLS - 1 - i) * spacing
        _note(row, float(i), x - back * cos, y - back * sin, left)
    row[at.LAID], row[at.NEAREST] = float(at.CELLS), 0.0


@inline_kernel
def _distance(row: FloatArray, number: float, x: float, y: float) -> float:
    """Square of the distance to a cell [m^2]."""
    place = _cell(number)
    d_x: float = x - row[place + _X]
    d_y: float = y - row[place + _Y]
    return d_x * d_x + d_y * d_y


@inline_kernel
def _nearest(row: FloatArray, begin: float, x: float, y: float) -> float:
    """Number of the cell nearest to a place, from cell ``begin`` on, either way."""
    last: float = row[at.LAID] - 1.0
    first = max(last - (at.CELLS - 1.0), 0.0)
    number: float = min(max(begin, first), last)
    near = _distance(row, number, x, y)
    while number < last and _distance(row, number + 1.0, x, y) < near:
        number += 1.0
        near = _distance(row, number, x, y)
    while number > first and _distance(row, number - 1.0, x, y) < near:
        number -= 1.0
        near = _distance(row, number, x, y)
    return number


@inline_kernel
def _along(row: FloatArray, number: float, x: float, y: float) -> tuple[float, float]:
    """(share of the way from cell ``number`` to the next, distance across [m]) of a place."""
    here, there = _cell(number), _cell(number + 1.0)
    d_x, d_y = row[there + _X] - row[here + _X], row[there + _Y] - row[here + _Y]
    r_x, r_y = x - row[here + _X], y - row[here + _Y]
    square = max(d_x * d_x + d_y * d_y, 1e-12)
    return (r_x * d_x + r_y * d_y) / square, abs(r_x * d_y - r_y * d_x) / math.sqrt(square)


@kernel
def find_rut(leader: FloatArray, begin: float, x: float, y: float, b: float) -> tuple[float, RutSection]:
    """(number of the nearest cell, the rut) under a wheel of width ``b`` [m] at a place.

    ``leader``: row of the leading wheel; ``begin``: where to search from. The share falls with the
    distance across and, behind the oldest place that is known, with the distance along.
    """
    number = _nearest(leader, begin, x, y)
    last = leader[at.LAID] - 1.0
    base = min(number, last - 1.0)
    share, across = _along(leader, base, x, y)
    if share < 0.0 and base > max(last - (at.CELLS - 1.0), 0.0):
        base -= 1.0
        share, across = _along(leader, base, x, y)
    here, there = _cell(base), _cell(base + 1.0)
    behind = max(-share, 0.0)
    share = min(max(share, 0.0), 1.0)
    overlap = max(1.0 - across / b, 0.0) * max(1.0 - behind, 0.0)
    depth = leader[here + _DEPTH] + share * (leader[there + _DEPTH] - leader[here + _DEPTH])
    shear = leader[here + _SHEAR] + share * (leader[there + _SHEAR] - leader[here + _SHEAR])
    return number, RutSection(overlap, depth, shear)


@inline_kernel
def follow_rut(
    structure: Structure | None, leader: FloatArray, row: FloatArray, b: float, x: float, y: float
) -> None:
    """The rut under a wheel of width ``b`` [m] at a place, into its ``row`` of the contact state."""
    if structure is None:
        return
    if structure.ruts > 0.5:
        row[at.NEAREST], rut = find_rut(leader, row[at.NEAREST], x, y, b)
        row[at.RUT_SHARE], row[at.RUT_DEPTH], row[at.RUT_SHEAR] = rut.share, rut.depth, rut.shear
