"""The tasks: which course, which soil, when it is over. Each has its reason in physics.

A scenario only draws a course; it never looks at an agent, and its numbers are not tuned to one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.paths import sine_path, winding_corridor
from offroad_env.physics.path_kernels import PathTable
from offroad_env.physics.records import Ground
from offroad_env.terrain import add, paper_terrain, rough_terrain

__all__ = ["SCENARIOS", "Course", "Scenario", "find_scenario"]


@dataclass(frozen=True, kw_only=True)
class Course:
    """What one episode is driven on."""

    path: PathTable
    ground: Ground


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A task. ``draw`` makes the course of an episode from a Generator, always with as many draws."""

    name: str
    reason: str  #: why the soil decides this task, from physics
    draw: Callable[[np.random.Generator], Course]
    corridor: float  #: half width of the corridor [m]; leaving it ends the episode
    target_speed: float  #: speed to hold [m/s]; 0 = as fast as possible
    start_speed: float  #: speed at the start [m/s]
    soil: str = "dry_sand"  #: name in SOILS; its n is replaced by the drawn one
    vehicle: str = "mrzr"  #: name in VEHICLES
    n_range: tuple[float, float] = (0.3, 1.1)  #: sinkage exponent, drawn uniformly [-]
    steer_scale: float = 1.0  #: share of the vehicle's steering range that action 1 commands


def _draw_track(rng: np.random.Generator) -> Course:
    amplitude, wavelength = rng.uniform(4.0, 8.0), rng.uniform(60.0, 100.0)
    roughness = rough_terrain("B", rng)
    path = sine_path(amplitude=amplitude, wavelength=wavelength, length=250.0)
    return Course(path=path, ground=add(paper_terrain(0.03), roughness))


def _draw_speed(rng: np.random.Generator) -> Course:
    path = winding_corridor(rng, length=300.0)
    return Course(path=path, ground=rough_terrain("B", rng))


SCENARIOS: dict[str, Scenario] = {
    "track": Scenario(
        name="track",
        reason=(
            "The path is to be followed at a given speed on wavy ground. The soil sets the slip angle "
            "that a curve needs (at 10 degrees the side force on sand is 0.10 of the load for n = 0.3 "
            "and 0.24 for n = 1.1), so a steering law tuned on one soil cuts or runs wide on another."
        ),
        draw=_draw_track,
        corridor=4.0,
        target_speed=4.0,
        start_speed=3.0,
    ),
    "speed": Scenario(
        name="speed",
        reason=(
            "A winding corridor is to be crossed as fast as possible. The corner speed is the square "
            "root of radius times the lateral acceleration that the soil holds, which grows by more "
            "than two from n = 0.3 to n = 1.1: who believes the wrong n leaves the corridor or loses time."
        ),
        draw=_draw_speed,
        corridor=1.5,
        target_speed=0.0,
        start_speed=3.0,
    ),
}


def find_scenario(name: str) -> Scenario:
    """The scenario of that name, or an `InvalidParameter` that lists the names."""
    if name not in SCENARIOS:
        raise InvalidParameter(f"scenario must be one of {', '.join(SCENARIOS)}, got {name!r}")
    return SCENARIOS[name]
