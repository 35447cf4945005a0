"""The arms of the benchmark's natural form: one controller, four sources of what the soil holds.

The controllers are those of `agents.controllers.arms`; their tables run over one limit of the soil
(`agents.controllers.population_limits`) instead of over n:

oracle        the true limit (``terrain_info="limits"``)
aware         mean and standard deviation of the online belief (``terrain_info="belief"``)
nominal       one fixed limit, at a place in the population
conservative  the lowest limit of the population

*Common knobs* are searched once, for the oracle, and all arms drive with them: a difference is then one of
knowledge. *Own knobs* are searched for each arm with the same budget.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from agents.controllers.arms import ARMS, CONTROLLERS, Arm, ArmSettings, believe_fixed
from agents.controllers.natural_tuned import SETTINGS
from agents.controllers.population_limits import PopulationDriver, believe_limit, coordinate_of
from agents.controllers.speed_control import SpeedGains
from agents.controllers.speed_planner import BeliefSource, PlannerGains, SoilTracker
from agents.controllers.traction_limits import WheelLaws
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.errors import InvalidParameter

__all__ = ["KNOBS", "NATURAL_FORMS", "NATURAL_LAWS", "SOURCES", "TYRE_GAINS", "make_natural_arm"]

#: Forms with whole soils: name -> name in text.
NATURAL_FORMS = {
    "natural": "natural soils",
    "natural_unusual": "natural soils outside of the training range",
    "natural_gnss": "natural soils, GNSS of 1.5 m",
}
#: Wheels that the controllers assume, and the benchmark drives.
NATURAL_LAWS = WheelLaws(structure="field", tyre="mrzr")
#: Which knobs an arm drives with.
KNOBS = ("common", "own")

#: A tyre that spins or is locked hardly steers. Both are cut off in the way that every car does.
TYRE_GAINS = SpeedGains(slip_limit=0.2, slip_band=0.15, brake_slip=0.12)

#: Arm -> (terrain_info, how task and settings become a belief).
SOURCES: dict[str, tuple[str, Callable[[str, ArmSettings], BeliefSource]]] = {
    "nominal": ("none", lambda task, settings: believe_fixed(settings.n)),
    "conservative": ("none", lambda task, settings: believe_fixed(0.0)),
    "aware": ("belief", lambda task, settings: believe_limit(coordinate_of(task), settings.z)),
    "oracle": ("limits", lambda task, settings: believe_limit(coordinate_of(task), 0.0)),
}


def make_natural_arm(
    name: str, *, scenario: str = "speed", knobs: str = "common", settings: ArmSettings | None = None
) -> Arm:
    """An arm of the natural form.

    Parameters
    ----------
    name : {"nominal", "conservative", "aware", "oracle"}
    scenario
    knobs : {"common", "own"}
        Which settings of `agents.controllers.natural_tuned` it takes.
    settings
        Instead of these.

    Raises
    ------
    InvalidParameter
        For an unknown arm or kind of knobs, or a task that has no settings.
    """
    task = find_scenario(scenario).task
    if name not in SOURCES or knobs not in KNOBS:
        raise InvalidParameter(
            f"arm must be one of {', '.join(SOURCES)} with knobs {KNOBS}, got {name!r}, {knobs!r}"
        )
    if settings is None:
        if (task, name, knobs) not in SETTINGS:
            raise InvalidParameter(f"{name!r} has no {knobs} knobs for {task!r} in the natural form")
        settings = ArmSettings(**SETTINGS[task, name, knobs])
    terrain_info, source = SOURCES[name]
    gains = PlannerGains(
        margin=settings.margin,
        slip_angle=settings.slip_angle,
        feed_forward=settings.feed_forward,
        brake_share=settings.brake_share,
        speed_max=settings.speed_max,
        speed=replace(TYRE_GAINS, k_i=settings.integral),
    )
    believe = source(task, settings)
    agent = (
        CONTROLLERS[task](believe, gains, settings) if task in CONTROLLERS else SoilTracker(believe, gains)
    )
    assert isinstance(agent, SoilTracker)
    driver = PopulationDriver(agent, NATURAL_LAWS, coordinate_of(task))
    return Arm(name=name, terrain_info=terrain_info, informed=ARMS[name][1], agent=driver)
