"""Model-predictive control with the arms' sources of belief: the truth, the belief, one fixed soil.

All three drive with the same settings of `agents.controllers.nmpc.NmpcSettings`. In the matched form the
fixed soil is that of the arm `nominal` and the belief is insured over one standard deviation; on natural
soils all of it comes from one search (`agents.controllers.natural_tuned`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from agents.controllers import natural_tuned
from agents.controllers.arms import ARMS, Arm, ArmSettings
from agents.controllers.natural_arms import NATURAL_LAWS, SOURCES, TYRE_GAINS
from agents.controllers.nmpc import NmpcAgent, NmpcSettings
from agents.controllers.population_limits import PopulationDriver, coordinate_of
from agents.controllers.protocol import Agent
from agents.controllers.tuned import SETTINGS
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.errors import InvalidParameter

__all__ = ["PREDICTIVE", "make_nmpc", "natural_knobs"]

#: Agent -> the arm whose belief it has.
PREDICTIVE = {"nmpc_nominal": "nominal", "nmpc_belief": "aware", "nmpc_truth": "oracle"}
#: Standard deviations over which the belief is insured in the matched form.
_Z = 1.0
#: Of car sensors: what heading and side acceleration are off.
_BIASES = NmpcSettings(heading_bias=0.02, side_bias=0.15)
#: Knobs that are the belief's, not the controller's.
_OF_BELIEF = ("n", "z")
#: Task whose knobs other tasks on natural soils take.
_SEARCHED = "speed"
#: Soft soil locks a braked front wheel within a tenth of a second: brakes go as soon as it lags behind.
_SLIPS = replace(TYRE_GAINS, brake_slip=0.0, slip_band=0.08)


def make_nmpc(
    name: str,
    *,
    scenario: str = "speed",
    natural: bool = False,
    knobs: Mapping[str, float] | None = None,
) -> Arm:
    """Model-predictive control with one source of belief.

    Parameters
    ----------
    name
        In `PREDICTIVE`.
    scenario
    natural
        Whether beliefs are about what the soil holds instead of n.
    knobs
        Fields of `NmpcSettings`, ``n`` (place of the fixed soil) and ``z`` (insurance of the belief); those
        left out have their defaults. None for those that were chosen on training episodes.

    Raises
    ------
    InvalidParameter
        For another name.
    """
    if name not in PREDICTIVE:
        raise InvalidParameter(f"agent must be one of {', '.join(PREDICTIVE)}, got {name!r}")
    task, arm = find_scenario(scenario).task, PREDICTIVE[name]
    if natural:
        terrain_info, source = SOURCES[arm]
    else:
        terrain_info, _, source = ARMS[arm]
    if knobs is None:
        knobs = natural_knobs(task, name) if natural else _matched_knobs(task)
    belief = source(task, ArmSettings(**{knob: knobs[knob] for knob in _OF_BELIEF if knob in knobs}))
    changed = {knob: value for knob, value in knobs.items() if knob not in _OF_BELIEF}
    settings = replace(_BIASES if natural else NmpcSettings(), **changed)  # type: ignore[arg-type]
    controller = NmpcAgent(belief, settings, slips=_SLIPS if natural else None)
    agent: Agent = controller
    if natural:
        agent = PopulationDriver(controller, NATURAL_LAWS, coordinate_of(task))
    return Arm(name=name, terrain_info=terrain_info, informed=ARMS[arm][1], agent=agent)


def _matched_knobs(task: str) -> dict[str, float]:
    return {"n": SETTINGS.get((task, "nominal"), {}).get("n", 0.3), "z": _Z}


def natural_knobs(task: str, name: str) -> dict[str, float]:
    """What it drives a task with on natural soils: its own knobs, or those of `speed`."""
    found = natural_tuned.SETTINGS
    return found.get((task, name, "common"), found[_SEARCHED, name, "common"])
