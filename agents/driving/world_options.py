"""Options of every command that drives: one's own soil, vehicle, reward and sensors, by name or file."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, replace
from typing import Any

from agents.driving.own_agents import search_here
from offroad_env.environment.choices import plain_arguments
from offroad_env.environment.scenario_descriptions import (
    find_scenario,
    register_scenario,
    scenario_mapping,
)
from offroad_env.environment.scenarios import BUILT_IN, SCENARIOS
from offroad_env.errors import InvalidParameter
from offroad_env.world.documents import is_name, open_document

__all__ = ["WorldOptions", "known_scenario"]


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
    """The name of a scenario that is given by name, file or inline YAML; one's own is registered by it."""
    if is_name(given) and given in SCENARIOS:
        return given
    search_here()  # a course may be drawn by a function of one's own
    scenario = find_scenario(given)
    name = re.sub(r"\W", "_", scenario.name)
    former = SCENARIOS.get(name)
    if former == scenario:
        return name
    if former is not None and name not in BUILT_IN:
        content = scenario_mapping(replace(scenario, name=name, like=scenario.task))
        if content is None or content != scenario_mapping(former):
            raise InvalidParameter(
                f"scenario: two different ones are called {name!r} - give each a name of its own (name: ...)"
            )
    return register_scenario(scenario).name
