"""Scenarios and reward weights by name, as objects, as mappings and as YAML: all the same thing."""

from __future__ import annotations

import importlib
import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from typing import Annotated, Any

import numpy as np

from offroad_env.environment.courses import CourseRecipe, course_mapping, read_course
from offroad_env.environment.rewards import RewardWeights
from offroad_env.environment.scenarios import BUILT_IN, MEASURES, SCENARIOS, Course, Scenario
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Soil, Vehicle
from offroad_env.world.argument_checks import numbers
from offroad_env.world.catalogue import Quantity
from offroad_env.world.descriptions import (
    Description,
    is_registered,
    read_soil,
    read_vehicle,
    soil_mapping,
    vehicle_mapping,
)
from offroad_env.world.documents import Document, is_name, open_document, recalled, remember
from offroad_env.world.schema import CheckedBy, SectionSchema
from offroad_env.world.yaml_text import shown

__all__ = [
    "SCENARIO",
    "WEIGHTS",
    "find_scenario",
    "read_weights",
    "register_scenario",
    "scenario_mapping",
    "weights_mapping",
]

Draw = Callable[[np.random.Generator], Course]

_WEIGHT = Quantity("in [0, 1000]", 0.0, 1000.0)
WEIGHTS = SectionSchema(
    name="weights",
    about="Weights of the reward's terms; what is not given is the scenario's, or that of the base.",
    records=(RewardWeights,),
    ranges={entry.name: _WEIGHT for entry in fields(RewardWeights)},
    defaults={entry.name: entry.default for entry in fields(RewardWeights)},
    bases=lambda: SCENARIOS,
)


def _pair(value: Any) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InvalidParameter(f"n_range must be (low, high), got {shown(value)}")
    low, high = numbers("n_range", value).tolist()
    return low, high


_SCENARIO_RANGES = {
    "corridor": Quantity("in [0.2, 100] m", 0.2, 100.0),
    "target_speed": Quantity("in [0, 60] m/s", 0.0, 60.0),
    "start_speed": Quantity("in [0, 60] m/s", 0.0, 60.0),
    "time_limit": Quantity("in [0.1, 3600] s", 0.1, 3600.0),
    "stop_zone": Quantity("in [0, 100] m", 0.0, 100.0),
    "shake_limit": Quantity("in [0.1, 1e9] m/s^2", 0.1, 1e9),
}
_TEXT = Annotated[str | None, CheckedBy(lambda value: str(value))]
SCENARIO = SectionSchema(
    name="scenario",
    about="A task: what is driven, on what, and when it is over.",
    records=(Scenario,),
    choices={"measure": tuple(MEASURES), "like": BUILT_IN},
    ranges=_SCENARIO_RANGES,
    flags=("changing", "stalling"),
    others={
        "name": (_TEXT, "text"),
        "reason": (_TEXT, "text"),
        "n_range": (Annotated[Any, CheckedBy(_pair)], "pair, each in (0.05, 2.5]"),
        "soil": (Any, "name, file, description"),
        "vehicle": (Any, "name, file, description"),
        "weights": (Any, "description"),
        "course": (Any, "description, module:function"),
    },
    defaults={
        **{entry.name: entry.default for entry in fields(Scenario)},
        "shake_limit": "none",
        "weights": "of `weights`",
        "course": "of the base, else of `course`",
        "name": "own",
        "like": "of the base, else by the rules",
    },
    meanings={
        "course": "keys of `course`, or a function from a numpy Generator to a `Course`",
        "weights": "keys of `weights`",
        "name": "of the scenario, in figures and tables",
        "like": "built-in task whose controllers and tuned settings the arms take",
        "shake_limit": "largest running r.m.s. of the vertical acceleration [m/s^2]",
    },
    bases=lambda: SCENARIOS,
)


def read_weights(given: RewardWeights | Description, start: RewardWeights) -> RewardWeights:
    """Weights from an object, a scenario's name, a mapping or YAML; ``start`` has what is not given."""
    if isinstance(given, RewardWeights):
        return given
    if isinstance(given, str) and is_name(given):
        return find_scenario(given).weights
    document = open_document(given, "weights")
    stated = document.check(WEIGHTS)
    base = document.beside(stated.pop("base", None))
    return replace(start if base is None else read_weights(base, start), **stated)


def weights_mapping(weights: RewardWeights) -> dict[str, Any]:
    """The mapping from which `read_weights` makes them."""
    return asdict(weights)


def _checked(scenario: Scenario) -> Scenario:
    """A scenario that was made as an object, its numbers within the ranges of a description."""
    if not isinstance(scenario.weights, RewardWeights):
        scenario = replace(scenario, weights=read_weights(scenario.weights, RewardWeights()))
    for name, allowed in _SCENARIO_RANGES.items():
        value = getattr(scenario, name)
        if not (name == "shake_limit" and value == math.inf):
            allowed.check(f"scenario {scenario.name}: {name}", value)
    for name, one in asdict(scenario.weights).items():
        _WEIGHT.check(f"scenario {scenario.name}: weights.{name}", one)
    for name, known in (("measure", tuple(MEASURES)), ("like", ("", *BUILT_IN))):
        value = getattr(scenario, name)
        if value not in known:
            listed = ", ".join(filter(None, known))
            raise InvalidParameter(
                f"scenario {scenario.name}: {name} must be one of {listed}, got {shown(value)}"
            )
    return scenario


def find_scenario(given: Scenario | Description) -> Scenario:
    """A scenario from its name in `SCENARIOS`, an object, a mapping or YAML.

    Raises
    ------
    InvalidParameter, DataError
        With what is wrong, and where.
    """
    if isinstance(given, Scenario):
        return _checked(given)
    if isinstance(given, str) and is_name(given):
        if given in SCENARIOS:
            return SCENARIOS[given]
        content = recalled("scenario", given)
        if content is None:
            known = ", ".join(SCENARIOS)
            raise InvalidParameter(f"scenario must be one of {known}, got {shown(given)}")
        return find_scenario(content)
    document = open_document(given, "scenario")
    stated = document.check(SCENARIO)
    base = document.beside(stated.pop("base", None))
    start = None if base is None else find_scenario(base)
    with document.refusing():
        return _made(start, stated, document)


def _made(start: Scenario | None, stated: dict[str, Any], document: Document) -> Scenario:
    if "course" in stated:
        stated["draw"] = _course(stated.pop("course"), document)
    for name, read in (("soil", read_soil), ("vehicle", read_vehicle)):
        if name in stated and not is_name(stated[name]):
            stated[name] = read(document.beside(stated[name])).record
    if "weights" in stated:
        weights = document.beside(stated["weights"])
        stated["weights"] = read_weights(weights, RewardWeights() if start is None else start.weights)
    if start is not None:
        return replace(start, **{"name": document.name, "like": start.task, **stated})
    return Scenario(**{"name": document.name, "draw": CourseRecipe(), **stated})


def _course(given: Any, document: Document) -> Draw:
    if isinstance(given, Mapping):
        return read_course(given, f"{document.where}: course")
    if callable(given):
        draw: Draw = given
        return draw
    if not isinstance(given, str) or ":" not in given:
        raise InvalidParameter(f"course must hold keys, or be module:function, got {shown(given)}")
    module, _, name = given.partition(":")
    try:
        if module.partition(".")[0] in sys.stdlib_module_names:
            raise InvalidParameter(f"course must be a function that draws courses, not {shown(given)}")
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as error:
        raise InvalidParameter(f"course: there is no {given!r} ({error})") from error
    draw = found
    return draw


def scenario_mapping(scenario: Scenario) -> dict[str, Any] | None:
    """The mapping from which `find_scenario` makes it; None where its course is no function of a module."""
    base = SCENARIOS[scenario.task] if scenario.draw is SCENARIOS[scenario.task].draw else None
    found: dict[str, Any] = {} if base is None else {"base": base.name}
    if base is None:
        course = _course_text(scenario.draw)
        if course is None:
            return None
        found["course"] = course
    plain = _plain_fields(scenario)
    defaults = {"shake_limit": math.inf} if base is None else _plain_fields(base)
    found |= {key: value for key, value in plain.items() if key not in defaults or value != defaults[key]}
    if found.get("shake_limit") == math.inf:
        found["shake_limit"] = _SCENARIO_RANGES["shake_limit"].high
    return found


def _plain_fields(scenario: Scenario) -> dict[str, Any]:
    found: dict[str, Any] = {
        entry.name: getattr(scenario, entry.name) for entry in fields(Scenario) if entry.name != "draw"
    }
    found["like"] = scenario.task
    found["weights"] = weights_mapping(scenario.weights)
    found["n_range"] = list(scenario.n_range)
    if isinstance(scenario.soil, Soil) or is_registered("soil", scenario.soil):
        found["soil"] = soil_mapping(read_soil(scenario.soil).record)
    if isinstance(scenario.vehicle, Vehicle) or is_registered("vehicle", scenario.vehicle):
        found["vehicle"] = vehicle_mapping(read_vehicle(scenario.vehicle).record)
    return found


def _course_text(draw: Draw) -> dict[str, Any] | str | None:
    if isinstance(draw, CourseRecipe):
        return course_mapping(draw)
    module, name = getattr(draw, "__module__", None), getattr(draw, "__qualname__", "<")
    return None if module is None or "<" in name else f"{module}:{name}"


def register_scenario(scenario: Scenario | Description, *, name: str | None = None) -> Scenario:
    """Put a scenario of one's own into `SCENARIOS`, for this process and those that it starts.

    Parameters
    ----------
    scenario
        An object, a mapping or YAML.
    name
        Default: its own.

    Raises
    ------
    InvalidParameter
        For a name that a built-in scenario has.
    """
    made = find_scenario(scenario)
    name = re.sub(r"\W", "_", made.name) if name is None else name
    if not isinstance(name, str) or name in BUILT_IN or not name.isidentifier():
        raise InvalidParameter(
            f"name must be a new one of letters, digits and underscores, got {shown(name)}"
        )
    made = replace(made, name=name, like=made.task)
    SCENARIOS[name] = made
    content = scenario_mapping(made)
    if content is not None:
        remember("scenario", name, content)
    return made
