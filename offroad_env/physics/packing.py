"""A plant that crosses from Python in microseconds less.

A nested record of seventy floats is unpacked field by field at every call from Python; the same
numbers in one array cross in one piece and are taken apart by compiled code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.records import Ground, Soil, SoilMap, Vehicle
from offroad_env.physics.vehicle_model import Plant

__all__ = ["PackedPlant", "pack", "unpack"]

_VEHICLE, _SOIL = len(Vehicle._fields), len(Soil._fields)
_REST = _VEHICLE + _SOIL


class PackedPlant(NamedTuple):
    """A `Plant` as arrays."""

    numbers: np.ndarray  #: (70 or so,) every float of the plant, in the order of its records
    waves: np.ndarray
    patches: np.ndarray
    effects: np.ndarray | None


def pack(plant: Plant) -> PackedPlant:
    """The plant as arrays; `unpack` gives back the same plant."""
    ground, soil_map = plant.ground, plant.soil_map
    rest = (ground.H_0, ground.S_x, ground.S_y, soil_map.edge)
    rest += (plant.slip, plant.resultant, plant.half_car, plant.v_eps, float(plant.fine))
    numbers = np.array([*plant.vehicle, *plant.soil, *rest])
    return PackedPlant(numbers, ground.waves, soil_map.patches, plant.effects)


@inline_kernel
def unpack(packed):
    """The `Plant` that was packed."""
    p = packed.numbers
    s, g = p[_VEHICLE:_REST], p[_REST:]
    vehicle = Vehicle(
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13],
        p[14], p[15], p[16], p[17], p[18], p[19], p[20], p[21], p[22], p[23], p[24], p[25], p[26],
    )  # fmt: skip
    soil = Soil(
        s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10], s[11], s[12], s[13],
        s[14],
    )  # fmt: skip
    return Plant(
        vehicle,
        soil,
        Ground(g[0], g[1], g[2], packed.waves),
        SoilMap(g[3], packed.patches),
        g[4],
        g[5],
        g[6],
        g[7],
        g[8] > 0.5,
        packed.effects,
    )
