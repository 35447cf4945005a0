"""The natural form of the benchmark: whole soils, flexible tyres, vehicles and sensors as they are.

In the matched form nothing but n is unknown. Here soils are drawn whole from the population of measured ones
(`offroad_env.world.soil_prior`) and vary over metres, tyres are flexible, every vehicle departs from its data
sheet, and sensors have bias, scale errors, misalignment and latency, and feel gravity. Of
the soil an agent is given what it holds (``terrain_info``): "none", "belief" or "limits".

====================  ======================================================================
``natural``           soils of the usual 80 % of the population, fixes with 0.03 m of noise
``natural_unusual``   soils outside of these, on which nothing was tuned or trained
``natural_gnss``      as ``natural``, 1.5 m of noise; corridors are as much wider (`CORRIDORS`)
====================  ======================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from agents.controllers.natural_arms import NATURAL_FORMS, NATURAL_LAWS
from offroad_env.environment.randomisation import LogUniform, Normal
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import SCENARIOS, Scenario, draw_steep_climb
from offroad_env.environment.soil_draws import MeasuredSoils
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Vehicle, Wheel
from offroad_env.world.descriptions import choose_tyre, read_vehicle
from offroad_env.world.tyres import require_fitting_tyre
from offroad_env.world.yaml_text import shown

__all__ = [
    "CORRIDORS",
    "NATURAL_FORMS",
    "NATURAL_TASKS",
    "is_natural",
    "natural_options",
    "natural_scenario",
    "natural_vehicle",
    "options_of",
]

#: Tasks that there are in these forms. `patches` changes n alone, which no soils side by side do.
NATURAL_TASKS = ("track", "speed", "climb", "brake", "ride")

#: White noise of a fix [m]; the drift of the car receiver, 0.17 m over 100 s, stays.
_FIX, _COARSE_FIX = 0.03, 1.5
#: Half widths of the corridors with coarse fixes [m]: the given ones and one standard deviation of a fix.
CORRIDORS = {task: SCENARIOS[task].corridor + _COARSE_FIX for task in NATURAL_TASKS}

#: Tolerances of a vehicle: relative standard deviations of numbers that load, wear and assembly change.
#: Mass: a passenger or fuel; height of the centre of gravity with it; inertia and springs: parts of a kind;
#: brakes: friction of linings; power: engines of a kind and altitude.
_TOLERANCES = {
    "m": 0.05,
    "h_cg": 0.03,
    "I_z": 0.05,
    "k_f": 0.05,
    "k_r": 0.05,
    "c_f": 0.1,
    "c_r": 0.1,
    "brake_torque_max": 0.05,
    "drive_torque_max": 0.03,
    "power_max": 0.05,
}
#: Numbers that are known to a factor only.
_FACTORS = {"torque_lag": 1.4, "steer_lag": 1.4, "drag_area": 1.4}


def is_natural(form: str) -> bool:
    """Whether a form of the benchmark has whole soils."""
    return form in NATURAL_FORMS


def natural_vehicle(vehicle: Any = "mrzr") -> dict[str, Any]:
    """What differs from vehicle to vehicle about a chosen one, as ``randomise`` takes it.

    Raises
    ------
    InvalidParameter
        For one of which something is stated for its four wheels.
    """
    nominal = _nominal(vehicle)._asdict()
    found: dict[str, Any] = {
        f"vehicle.{key}": Normal(nominal[key], sd * nominal[key], *_ends(nominal[key], sd))
        for key, sd in _TOLERANCES.items()
    }
    for key, factor in _FACTORS.items():
        found[f"vehicle.{key}"] = LogUniform(nominal[key] / factor, nominal[key] * factor)
    return found


def _ends(value: float, sd: float) -> tuple[float, float]:
    """Two standard deviations to both sides: what assembly would refuse is cut off."""
    return (1.0 - 2.0 * sd) * value, (1.0 + 2.0 * sd) * value


def _nominal(vehicle: Any) -> Vehicle:
    """Numbers of the chosen vehicle, if these forms can draw others about them."""
    _, nominal, four_wheel = read_vehicle(vehicle)
    if four_wheel is not None:
        raise InvalidParameter(
            "vehicle: natural forms draw the numbers of a vehicle anew for every episode, to which what is "
            "stated of four single wheels would no longer belong - leave that out, or drive another form"
        )
    return nominal


def natural_options(form: str = "natural", vehicle: Any = "mrzr") -> dict[str, Any]:
    """Arguments of ``gym.make`` beside task and ``terrain_info``.

    Parameters
    ----------
    form
        In `NATURAL_FORMS`.
    vehicle
        About which the vehicles of episodes are drawn: name, record, mapping or YAML.
    """
    fix = _COARSE_FIX if form == "natural_gnss" else _FIX
    region = "unusual" if form == "natural_unusual" else "usual"
    return {
        "structure": NATURAL_LAWS.structure,
        "tyre": NATURAL_LAWS.tyre,
        "natural_soil": True,
        "sensors": {"base": "automotive", "gnss": {"position_sd": fix, "velocity_sd": 0.05}},
        "randomise": {"soil": MeasuredSoils(region=region), **natural_vehicle(vehicle)},
    }


def natural_scenario(task: str, form: str = "natural") -> Scenario:
    """The task as it is in this form; what differs follows from what tyres hold (docs/benchmark.md).

    A scenario of one's own keeps its own course and the width of its corridor, to which a coarse fix adds:
    only a hill that it has from `climb` becomes the steep one.
    """
    scenario = find_scenario(task)
    like = scenario.task  # of its course, which is replaced below, the rules could no longer tell
    if scenario.draw is SCENARIOS["climb"].draw:
        scenario = replace(scenario, draw=draw_steep_climb, like=like)
    if form == "natural_gnss":
        scenario = replace(scenario, corridor=scenario.corridor + _COARSE_FIX, like=like)
    return scenario


def options_of(task: str, form: str, world: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
    """Arguments of ``gym.make`` for a task in any form; ``world`` holds further ones of a user's own.

    What a natural form draws for each episode it still draws beside what ``world["randomise"]`` adds.
    Vehicles are drawn about the one in ``world``, or else the scenario's.

    Raises
    ------
    InvalidParameter
        For what a natural form cannot have: a task or soil of another kind, a vehicle that its tyre does not
        fit, values that are drawn and no mapping.
    """
    own = dict(world or {})
    if not is_natural(form):
        return {"scenario": task, **own}
    _check_natural(task, form, own)
    scenario = natural_scenario(task, form)
    vehicle = scenario.vehicle if own.get("vehicle") is None else own["vehicle"]
    found = natural_options(form, vehicle)
    _check_tyre(own.get("tyre", found["tyre"]), vehicle)
    if "randomise" in own:
        own["randomise"] = {**found["randomise"], **own["randomise"]}
    return {"scenario": scenario, **found, **own}


def _check_natural(task: str, form: str, own: Mapping[str, Any]) -> None:
    """Refuse tasks and worlds that a natural form cannot have."""
    kind = find_scenario(task).task
    if kind not in NATURAL_TASKS:
        raise InvalidParameter(
            f"natural forms have {', '.join(NATURAL_TASKS)}, got {kind} - there n alone changes, which no "
            "soils side by side do"
        )
    if "soil" in own:
        raise InvalidParameter(
            f"soil: the form {form!r} draws a whole soil for every episode - leave soil out, or drive "
            'the form "matched"'
        )
    drawn = own.get("randomise", {})
    if not isinstance(drawn, Mapping):
        raise InvalidParameter(
            f"randomise must be a mapping of what is drawn for each episode, got {shown(drawn)}"
        )
    if "vehicle" in drawn:
        raise InvalidParameter(
            f"randomise: the form {form!r} draws the numbers of one vehicle for every episode, which would "
            "replace those of a whole one that is drawn - leave 'vehicle' out, or give one as vehicle"
        )


def _check_tyre(tyre: Any, vehicle: Any) -> None:
    """Refuse a vehicle with wheels of another size than the tyre's, by its name."""
    chosen, (name, nominal, _) = choose_tyre(tyre), read_vehicle(vehicle)
    if chosen is None:
        return
    try:
        require_fitting_tyre(chosen, Wheel(nominal.r, nominal.b))
    except InvalidParameter as error:
        raise InvalidParameter(
            f"vehicle: {name} has wheels on which the tyre does not fit: {error}"
        ) from None
