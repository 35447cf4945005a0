"""A plant that crosses from Python in microseconds less.

A nested record of seventy floats is unpacked field by field at every call from Python; the same
numbers in one array cross in one piece and are taken apart by compiled code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.record_operations import numbers_of, record_from
from offroad_env.physics.records import FloatArray, FourWheel, SoilField, Structure

__all__ = ["PackedPlant", "pack", "unpack"]


class PackedPlant(NamedTuple):
    """A `Plant` as arrays."""

    #: (N,) every float of the plant but those of its optional records, in the order of its records
    numbers: FloatArray
    waves: FloatArray
    patches: FloatArray
    effects: FloatArray | None
    four_wheel: FourWheel | None
    structure: Structure | None
    soil_field: SoilField | None


def pack(plant: Plant) -> PackedPlant:
    """The plant as arrays; `unpack` gives back the same plant."""
    numbers = np.array(numbers_of(plant))
    options = plant.effects, plant.four_wheel, plant.structure, plant.soil_field
    return PackedPlant(numbers, plant.ground.waves, plant.soil_map.patches, *options)


@inline_kernel
def unpack(packed: PackedPlant) -> Plant:
    """The `Plant` that was packed."""
    parts = (
        packed.waves,
        packed.patches,
        packed.effects,
        packed.four_wheel,
        packed.structure,
        packed.soil_field,
    )
    return record_from(Plant, packed.numbers, parts)
