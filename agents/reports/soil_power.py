"""Scan of the power that soil takes from a wheel, over motions, slip angles, sinkages and soils."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from offroad_env.physics.records import Soil, Structure, Wheel
from offroad_env.simulation.soil_power import PowerStates, random_rolling_states, soil_power
from offroad_env.world.soils import SOILS

__all__ = ["PowerScan", "deformable_soils", "least_rolling_power", "scan_power"]

#: Speed of rim and travel together [m/s].
_SPEED = 3.0
_DIRECTIONS, _DEPTHS, _ANGLES = 121, 40, 18


class PowerScan(NamedTuple):
    """Least power of all slip angles and soils, over the load times |r omega| + |v|."""

    direction: np.ndarray  #: (A,) atan(r omega / v): -pi/2 spins backwards, 0 locked, pi/4 rolls [rad]
    depth: np.ndarray  #: (D,) sinkage over the radius [-]
    least: np.ndarray  #: (A, D) [-]
    soils: tuple[str, ...]  #: that give power somewhere
    slip_angles: tuple[float, float]  #: least and largest slip angle at which they do [rad]; NaN: none does


def deformable_soils() -> dict[str, Soil]:
    """The soils of the catalogue but hard ground."""
    return {name: SOILS[name] for name in SOILS if SOILS[name].rigid < 0.5}


def scan_power(structure: Structure, wheel: Wheel, soils: Mapping[str, Soil]) -> PowerScan:
    """Over all directions of rim and travel, to 0.9 of the radius, slip angles to 85 degrees."""
    direction = np.radians(np.linspace(-89.0, 89.0, _DIRECTIONS))
    depth = np.linspace(0.005, 0.9, _DEPTHS)
    angles = np.radians(np.linspace(0.0, 85.0, _ANGLES))
    a, d, beta = np.meshgrid(direction, depth, angles, indexing="ij")
    v = _SPEED * np.cos(a)
    states = PowerStates(_SPEED * np.sin(a), v, v * np.tan(beta), d * wheel.r)
    least, giving = np.full(a.shape, np.inf), []
    for name, soil in soils.items():
        power = soil_power(structure, soil, wheel, states)
        if power.min() < 0.0:
            giving.append(name)
        least = np.minimum(least, power)
    where = angles[(least < 0.0).any(axis=(0, 1))]
    ends = (float(where.min()), float(where.max())) if len(where) else (np.nan, np.nan)
    return PowerScan(direction, depth, least.min(axis=2), tuple(giving), ends)


def least_rolling_power(
    structure: Structure, wheel: Wheel, soils: Mapping[str, Soil], count: int, seed: int
) -> float:
    """Least power of ``count`` random states of steady rolling, shared among the soils [-]."""
    rng = np.random.default_rng(seed)
    each = -(-count // len(soils))
    return min(
        float(soil_power(structure, soil, wheel, random_rolling_states(rng, each)).min())
        for soil in soils.values()
    )
