"""Options of every command that drives: one's own soil, vehicle, reward and sensors, by name or file."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from agents.driving.own_agents import search_here
from offroad_env.environment.choices import plain_arguments
from offroad_env.environment.scenario_descriptions import (
    find_scenario,
    register_scenario,
    scenario_mapping,
)
from offroad_env.environment.scenarios import SCENARIOS, Scenario
from offroad_env.errors import InvalidParameter
from offroad_env.world.documents import is_name, open_document

__all__ = ["WorldOptions", "known_scenario", "known_scenarios"]


@dataclass(frozen=True, kw_only=True)
class WorldOptions:
    """What is driven on and with: a name of the catalogue, a file *.yaml, or inline YAML "{base: ...}"."""

    soil: str | None = None  #: in place of the scenario's; of a catalogue name n is drawn
    vehicle: str | None = None  #: in place of the scenario's
    weights: str | None = None  #: of the reward, in place of the scenario's
    sensors: str | None = None  #: paper, ideal, automotive, consumer; default: paper
    structure: str | None = None  #: laws of the wheels: full, grid, field, or departures "grid,ruts=none"
    tyre: str | None = None  #: flexible tyres; need structure grid or field
    randomise: str | None = None  #: what is drawn for each episode: "{vehicle.m: [1200, 1500]}", or a file

    def env_options(self) -> dict[str, Any]:
        """For ``gym.make``: what is given, in plain values that any process understands."""
        given = {name: value for name, value in asdict(self).items() if value is not None}
        if "randomise" in given:
            given["randomise"] = dict(open_document(given["randomise"], "randomise").content)
        return plain_arguments(given)

    def digest(self) -> str:
        """The same as text; empty where nothing is given."""
        options = self.env_options()
        return json.dumps(options, sort_keys=True) if options else ""

    def words(self) -> str:
        """As they are written on the command line."""
        given = {name: value for name, value in asdict(self).items() if value is not None}
        return "".join(f" --{name} '{value}'" for name, value in given.items())


def known_scenario(given: str) -> str:
    """The name of a scenario that is given by name, file or inline YAML; one's own is registered by it.

    What a file holds by now takes the place of what was registered by that name before.
    """
    if is_name(given) and given in SCENARIOS:
        return given
    search_here()  # a course may be drawn by a function of one's own
    scenario = find_scenario(given)
    name = re.sub(r"\W", "_", scenario.name)
    former = SCENARIOS.get(name)
    if former == scenario:
        return name
    made = register_scenario(scenario)
    if former is None or not _is_same(former, made):
        _end_waiting_processes()
    return made.name


def known_scenarios(given: Sequence[str]) -> tuple[str, ...]:
    """`known_scenario` of all that one command is to drive.

    Raises
    ------
    InvalidParameter
        If two different ones have the same name.
    """
    found: dict[str, Scenario] = {}
    names = []
    for one in given:
        name = known_scenario(one)
        if not _is_same(found.setdefault(name, SCENARIOS[name]), SCENARIOS[name]):
            raise InvalidParameter(
                f"scenario: two different ones are called {name!r} - give each a name of its own (name: ...)"
            )
        names.append(name)
    return tuple(names)


def _is_same(one: Scenario, other: Scenario) -> bool:
    """Whether two registered scenarios are the same; functions that draw courses are known by their names."""
    content = scenario_mapping(one)
    return one == other or (content is not None and content == scenario_mapping(other))


def _end_waiting_processes() -> None:
    """End the local processes that wait for further work: they know what was registered when they began."""
    if "joblib" in sys.modules:
        from joblib.externals.loky import get_reusable_executor

        get_reusable_executor(reuse=True).shutdown(wait=True)
