"""The tasks: which course, which soil, when it is over. Each has its reason in physics.

A scenario only draws a course; it never looks at an agent, and its numbers are not tuned to one:
docs/benchmark.md derives them from what the soil holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from offroad_env.environment.rewards import RewardWeights, Rules
from offroad_env.errors import InvalidParameter
from offroad_env.physics.path_geometry import PathTable
from offroad_env.physics.records import Ground, Soil, SoilMap, Vehicle
from offroad_env.world.paths import sine_path, winding_corridor
from offroad_env.world.terrain import add, flat, paper_terrain, rough_terrain, soil_map, soil_patches_along
from offroad_env.world.yaml_text import shown

__all__ = ["BUILT_IN", "MEASURES", "SCENARIOS", "Course", "Scenario", "draw_steep_climb"]

#: What a benchmark measures in a task, always so that less is better: name -> (words, unit).
MEASURES = {
    "time": ("time to the goal, a failure costs the time limit", "s"),
    "cross_track": ("r.m.s. distance from the path, a failure costs the corridor", "m"),
    "shortfall": ("way to the top that is left when the vehicle gets no further", "m"),
}


@dataclass(frozen=True, kw_only=True)
class Course:
    """What one episode is driven on."""

    path: PathTable  #: way that the vehicle has to follow
    ground: Ground  #: its true height
    known_ground: Ground = field(default_factory=flat)  #: what a map of heights shows of it
    sections: tuple[tuple[float, float, float], ...] = ()  #: (start, end [m], place of n in the range [-])

    def soil_map(self, n_range: tuple[float, float]) -> SoilMap:
        """Stretches of the course with another n, by their places in ``n_range``."""
        low, high = n_range
        sections = [(start, end, low + place * (high - low)) for start, end, place in self.sections]
        return soil_patches_along(self.path, sections) if sections else soil_map()


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A task. ``draw`` makes the course of an episode from a Generator, always with as many draws.

    Parameters are the fields. ``draw`` is a function, or an `environment.courses.CourseRecipe`.
    """

    name: str  #: in figures and tables
    draw: Callable[[np.random.Generator], Course]  #: makes the course of an episode
    corridor: float = 2.0  #: half width of the corridor [m]; leaving it ends the episode
    target_speed: float = 0.0  #: speed to hold [m/s]; 0 = as fast as possible
    start_speed: float = 3.0  #: speed at the start [m/s]
    reason: str = ""  #: why the soil decides this task, from physics
    soil: str | Soil = "dry_sand"  #: soil or its name; n is drawn from `n_range`
    vehicle: str | Vehicle = "mrzr"  #: vehicle or its name
    n_range: tuple[float, float] = (0.3, 1.1)  #: sinkage exponent, drawn uniformly [-]
    time_limit: float = 120.0  #: after which an episode is truncated [s]
    stop_zone: float = 0.0  #: > 0: the task is to stand within this distance before the end [m]
    shake_limit: float = math.inf  #: largest running r.m.s. of the vertical acceleration [m/s^2]
    changing: bool = False  #: whether n changes on the way; the online filter is set for it
    stalling: bool = False  #: whether getting stuck is how the task ends for everybody, not a failure
    weights: RewardWeights = field(default_factory=RewardWeights)  #: of the reward's terms
    measure: str = "time"  #: what a benchmark measures, a name in `MEASURES`
    like: str = ""  #: built-in task whose controllers and tuned settings the arms take; "": by the rules

    @property
    def task(self) -> str:
        """The built-in task that it is, or is most like: its arms drive with that one's settings."""
        if self.name in BUILT_IN or self.like:
            return self.like or self.name
        for name in BUILT_IN:
            if SCENARIOS[name].draw is self.draw:
                return name
        if self.stop_zone > 0.0:
            return "brake"
        if math.isfinite(self.shake_limit):
            return "ride"
        if self.changing:
            return "patches"
        return "track" if self.target_speed > 0.0 else "speed"

    def draw_course(self, rng: np.random.Generator) -> Course:
        """The course of an episode.

        Raises
        ------
        InvalidParameter
            Where ``draw`` makes something else.
        """
        course = self.draw(rng)
        if not isinstance(course, Course):
            raise InvalidParameter(f"scenario {self.name}: draw must return a Course, got {shown(course)}")
        return course

    @property
    def rules(self) -> Rules:
        """The numbers by which an episode ends."""
        return Rules(self.corridor, self.time_limit, self.stop_zone, self.shake_limit, float(self.stalling))


def _draw_track(rng: np.random.Generator) -> Course:
    amplitude, wavelength = rng.uniform(4.0, 8.0), rng.uniform(60.0, 100.0)
    roughness = rough_terrain("B", rng)
    path = sine_path(amplitude=amplitude, wavelength=wavelength, length=250.0)
    return Course(path=path, ground=add(paper_terrain(0.03), roughness))


def _draw_speed(rng: np.random.Generator) -> Course:
    path = winding_corridor(rng, length=300.0)
    return Course(path=path, ground=rough_terrain("B", rng))


#: Stretches of another soil in `patches`.
_PATCHES = 3

#: The hill of `climb`: steepest slope [-], reached at this distance from its foot [m]. Flexible tyres pull
#: more than rigid rims on sandy loam: 0.80 of the weight on the best twentieth of the population's soils.
_STEEPEST, _HILL, _STEEPEST_ON_TYRES = 0.45, 120.0, 0.85


def _hill(steepest: float) -> Ground:
    """H = A (1 - cos(p X)): level at the foot, the steeper the further up, A p the steepest slope."""
    p = 0.5 * math.pi / _HILL
    A = steepest / p
    return Ground(A, 0.0, 0.0, np.array([[-A, p, 0.0, 0.5 * math.pi]]))


def _draw_climb(rng: np.random.Generator) -> Course:
    return _climb(rng, _hill(_STEEPEST))


def draw_steep_climb(rng: np.random.Generator) -> Course:
    """The course of `climb` on a hill that stops flexible tyres too."""
    return _climb(rng, _hill(_STEEPEST_ON_TYRES))


def _climb(rng: np.random.Generator, hill: Ground) -> Course:
    path = winding_corridor(
        rng, length=_HILL, radius_range=(25.0, 60.0), straight_range=(0.0, 10.0), lead_in=3.0, max_heading=0.3
    )
    roughness = rough_terrain("B", rng)
    return Course(path=path, ground=add(hill, roughness), known_ground=hill)


def _draw_brake(rng: np.random.Generator) -> Course:
    length = rng.uniform(60.0, 90.0)
    road = winding_corridor(rng, length=90.0, radius_range=(60.0, 120.0), max_heading=0.3)
    path = PathTable(road.ds, road.nodes[: round(length / road.ds) + 1].copy())
    return Course(path=path, ground=rough_terrain("B", rng))


def _draw_ride(rng: np.random.Generator) -> Course:
    path = winding_corridor(rng, length=250.0, radius_range=(60.0, 120.0), max_heading=0.4)
    return Course(path=path, ground=rough_terrain("D", rng))


def _draw_patches(rng: np.random.Generator) -> Course:
    path = winding_corridor(rng, length=300.0)
    roughness = rough_terrain("B", rng)
    starts = 50.0 + 100.0 * np.arange(_PATCHES) + rng.uniform(-15.0, 15.0, _PATCHES)
    ends = np.minimum(starts + rng.uniform(35.0, 65.0, _PATCHES), path.length)
    sections = tuple(
        (float(a), float(b), float(place))
        for a, b, place in zip(starts, ends, rng.random(_PATCHES), strict=True)
    )
    return Course(path=path, ground=roughness, sections=sections)


SCENARIOS: dict[str, Scenario] = {
    "track": Scenario(
        name="track",
        reason=(
            "The path is to be followed at a given speed on wavy ground. The soil sets the slip angle "
            "that a curve needs (at 10 degrees the side force on sand is 0.10 of the load for n = 0.3 "
            "and 0.28 for n = 1.1), so a steering law tuned on one soil cuts or runs wide on another."
        ),
        draw=_draw_track,
        corridor=4.0,
        target_speed=4.0,
        start_speed=3.0,
        measure="cross_track",
    ),
    "speed": Scenario(
        name="speed",
        reason=(
            "A winding corridor is to be crossed as fast as possible. The corner speed is the square "
            "root of radius times the lateral acceleration that the soil holds, which grows by more "
            "than two from n = 0.3 to n = 1.1: a wrong n leads out of the corridor or costs time."
        ),
        draw=_draw_speed,
        corridor=1.5,
        target_speed=0.0,
        start_speed=3.0,
    ),
    "climb": Scenario(
        name="climb",
        reason=(
            "A hill gets steeper until the vehicle gets no further. The drawbar pull decides how far, and "
            "the slip that gives most of it falls from 0.9 for n = 0.3 (0.37 of the weight) to 0.12 for "
            "n = 1.1 (0.15): on soil of high n more slip digs in, on soil of low n less slip leaves half "
            "of the pull unused."
        ),
        draw=_draw_climb,
        corridor=2.5,
        target_speed=2.0,
        start_speed=2.0,
        soil="sandy_loam",
        stalling=True,
        weights=RewardWeights(progress=1.0, time=0.05, cross_track=0.1, speed_error=0.0),
        measure="shortfall",
    ),
    "brake": Scenario(
        name="brake",
        reason=(
            "The vehicle comes at up to 10 m/s and must stand before a line, soon. What the soil gives a "
            "braked wheel grows from 0.66 to 1.04 of the load from n = 0.3 to n = 1.1, so the stopping "
            "distance shrinks by a third: an n that is too large leads across the line, one that is too "
            "small costs time."
        ),
        draw=_draw_brake,
        corridor=2.0,
        target_speed=10.0,
        start_speed=8.0,
        soil="sandy_loam",
        time_limit=40.0,
        stop_zone=3.0,
        weights=RewardWeights(speed_error=0.0),
    ),
    "ride": Scenario(
        name="ride",
        reason=(
            "Rough ground is to be crossed as fast as the load can bear: the r.m.s. of the vertical "
            "acceleration is limited. Soil is a spring below the suspension, n times the load over the "
            "sinkage: stiff as hard ground for n = 0.3, half as stiff as the suspension for n = 1.1. But "
            "the limit can be measured without n, so knowing n may be worth nothing here."
        ),
        draw=_draw_ride,
        corridor=2.0,
        target_speed=0.0,
        start_speed=3.0,
        shake_limit=1.6,
    ),
    "patches": Scenario(
        name="patches",
        reason=(
            "The corridor of `speed` with stretches of another soil: what a corner holds changes within a "
            "metre. An estimate follows some seconds late; the truth is observed when the front wheels "
            "are there."
        ),
        draw=_draw_patches,
        corridor=1.5,
        target_speed=0.0,
        start_speed=3.0,
        changing=True,
    ),
}


#: The tasks of the project; `offroad_env.register_scenario` adds others to `SCENARIOS`.
BUILT_IN = tuple(SCENARIOS)
