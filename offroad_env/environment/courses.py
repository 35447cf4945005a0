"""Courses by description: a path and a ground whose numbers are drawn for each episode."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from offroad_env.environment.scenarios import Course
from offroad_env.errors import InvalidParameter
from offroad_env.physics.path_geometry import PathTable
from offroad_env.world.catalogue import Quantity
from offroad_env.world.paths import circle, from_waypoints, sine_path, straight, winding_corridor
from offroad_env.world.schema import CheckedBy, SectionSchema
from offroad_env.world.terrain import ISO_8608_CLASSES, add, flat, grade, paper_terrain, rough_terrain
from offroad_env.world.yaml_text import shown

__all__ = ["COURSE", "CourseRecipe", "Span", "course_mapping", "read_course"]

#: A number, or (lowest, highest) of one that is drawn uniformly for each episode.
Span = float | tuple[float, float]

PATHS = ("winding", "sine", "straight", "circle", "waypoints")

#: Keys whose number may be drawn.
_SPANS: Mapping[str, Quantity] = MappingProxyType(
    {
        "length": Quantity("in [5, 1e4] m", 5.0, 1e4),
        "amplitude": Quantity("in [0, 100] m", 0.0, 100.0),
        "wavelength": Quantity("in [5, 1e4] m", 5.0, 1e4),
        "wave_height": Quantity("in [0, 2] m", 0.0, 2.0, mistakes=((2.0000001, 2e3, "mm given as m"),)),
        "slope": Quantity("in [-0.8, 0.8] rad", -0.8, 0.8, mistakes=((0.8000001, 46.0, "degrees"),)),
        "cross_slope": Quantity("in [-0.8, 0.8] rad", -0.8, 0.8, mistakes=((0.8000001, 46.0, "degrees"),)),
    }
)
_RADIUS = Quantity("in [2, 1e4] m", 2.0, 1e4)


@dataclass(frozen=True, kw_only=True)
class CourseRecipe:
    """A course whose numbers are drawn for each episode; takes the place of `Scenario.draw`.

    Where a number is a pair, it is drawn uniformly between the two. Always with as many draws.

    Raises
    ------
    InvalidParameter
        For a number out of range.
    """

    path: str = "winding"  #: shape of the path
    length: Span = 200.0  #: of the path [m]; a circle's is driven round and round, waypoints have their own
    radius: tuple[float, float] = (12.0, 40.0)  #: smallest and largest bend [m]; a circle has the smallest
    max_heading: float = 1.3  #: of winding paths: largest angle to the first direction [rad]
    amplitude: Span = 6.0  #: of the sine [m]
    wavelength: Span = 80.0  #: of the sine [m]
    waypoints: tuple[tuple[float, float], ...] = ()  #: points of the path [m], at least three
    roughness: str = "none"  #: class of the ground by ISO 8608, A (very good) to H
    wave_height: Span = 0.0  #: of regular waves of some metres on the ground [m]
    slope: Span = 0.0  #: of the ground towards the first direction of the path, positive uphill [rad]
    cross_slope: Span = 0.0  #: of the ground to the left of it, positive uphill [rad]

    def __post_init__(self) -> None:
        given = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        for name, value in COURSE.check(given, "course").items():
            object.__setattr__(self, name, value)
        if self.path == "waypoints" and len(self.waypoints) < 3:
            raise InvalidParameter(f"course: waypoints must be at least 3 points, got {len(self.waypoints)}")

    def __call__(self, rng: np.random.Generator) -> Course:
        """The course of an episode."""
        drawn = {name: _drawn(getattr(self, name), rng.random()) for name in _SPANS}
        road = rng.spawn(1)[0]
        ground = add(
            paper_terrain(drawn["wave_height"]) if drawn["wave_height"] > 0.0 else flat(),
            grade(drawn["slope"]),
            grade(drawn["cross_slope"], 0.5 * math.pi),
            rough_terrain(self.roughness, rng) if self.roughness != "none" else flat(),
        )
        return Course(path=self._path(drawn, road), ground=ground)

    def _path(self, drawn: Mapping[str, float], rng: np.random.Generator) -> PathTable:
        length = drawn["length"]
        shapes: dict[str, Callable[[], PathTable]] = {
            "winding": lambda: winding_corridor(
                rng, length, radius_range=self.radius, max_heading=self.max_heading
            ),
            "sine": lambda: sine_path(length, drawn["amplitude"], drawn["wavelength"]),
            "straight": lambda: straight(length),
            "circle": lambda: circle(self.radius[0], length / (2.0 * math.pi * self.radius[0])),
            "waypoints": lambda: from_waypoints(self.waypoints),
        }
        return shapes[self.path]()


def _drawn(span: Span, share: float) -> float:
    if isinstance(span, tuple):
        low, high = span
        return low + share * (high - low)
    return span


def _number_or_pair(key: str, quantity: Quantity, value: Any) -> Span:
    if not isinstance(value, list | tuple):
        return quantity.check(key, value)
    if len(value) != 2:
        raise InvalidParameter(f"{key} must be a number or (lowest, highest), got {shown(value)}")
    low, high = (quantity.check(f"{key}[{i}]", number) for i, number in enumerate(value))
    if low > high:
        raise InvalidParameter(f"{key} must be (lowest, highest), got {shown(value)}")
    return low, high


def _span(key: str, quantity: Quantity) -> Any:
    """Type of a key with a number or a pair."""
    return Annotated[Span | None, CheckedBy(partial(_number_or_pair, key, quantity))]


def _radius(value: Any) -> tuple[float, float]:
    found = _number_or_pair("radius", _RADIUS, value)
    return found if isinstance(found, tuple) else (found, found)


def _points(value: Any) -> tuple[tuple[float, float], ...]:
    try:
        return tuple((float(x), float(y)) for x, y in value)
    except (TypeError, ValueError):
        raise InvalidParameter(f"waypoints must be a list of [x, y], got {shown(value)}") from None


_OTHERS: dict[str, tuple[Any, str]] = {
    **{key: (_span(key, quantity), f"{quantity.allowed}, or a pair") for key, quantity in _SPANS.items()},
    "radius": (Annotated[Any, CheckedBy(_radius)], f"{_RADIUS.allowed}, or a pair"),
    "waypoints": (Annotated[Any, CheckedBy(_points)], "list of [x, y]"),
}

COURSE = SectionSchema(
    name="course",
    about="Path and ground of a scenario; where a number is a pair, it is drawn uniformly for each episode.",
    records=(CourseRecipe,),
    choices={"path": PATHS, "roughness": ("none", *ISO_8608_CLASSES)},
    ranges={"max_heading": Quantity("in [0.05, 1.5] rad", 0.05, 1.5, mistakes=((1.5001, 90.0, "degrees"),))},
    others=_OTHERS,
    defaults={entry.name: entry.default for entry in fields(CourseRecipe)},
)


def read_course(given: Mapping[str, Any], where: str = "course") -> CourseRecipe:
    """A course from a mapping."""
    return CourseRecipe(**COURSE.check(given, where))


def course_mapping(recipe: CourseRecipe) -> dict[str, Any]:
    """The mapping from which `read_course` makes it."""
    return asdict(recipe)
