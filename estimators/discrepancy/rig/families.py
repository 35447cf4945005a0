"""Families of causes on a rig: variants of one thing that the soil, the wheel or a gauge does.

Trials seldom tell the variants of a family from each other, and which of them fits best changes with the
slip angles that are measured. The family is what a verdict can be held to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

__all__ = ["FAMILIES", "families_of"]

#: Family -> its members, effects and structural causes.
FAMILIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "slip sinkage": ("slip_sinkage", "soil_loosening", "slip_exponent"),
        "soil pushed aside": ("bulldozing",),
        "soil pushed ahead": ("front_bulldozing", "rut_drag"),
        "distribution of the pressure": (
            "pressure_distribution",
            "pressure_direction",
            "peak_angle",
            "exit_angle",
        ),
        "strength of the soil": (
            "friction_angle",
            "cohesion",
            "shear_modulus",
            "grouser_thrust",
            "shear_strengths",
            "soil_frame_shear",
        ),
        "stiffness of the soil": ("soil_stiffness", "effective_width"),
        "gauges": ("drawbar_offset", "side_force_offset", "sinkage_offset", "load_scale"),
    }
)


def families_of(members: Iterable[str]) -> tuple[str, ...]:
    """Families that some causes belong to, in the order of `FAMILIES`."""
    names = set(members)
    return tuple(family for family, own in FAMILIES.items() if names.intersection(own))
