"""Model-predictive control with the arms' sources of belief: the truth, the belief, one fixed soil.

All three drive with the same settings of `agents.controllers.nmpc.NmpcSettings`. The fixed soil is that of
the arm `nominal`, and the belief is insured over one standard deviation, on natural soils over 0.7.
"""

from __future__ import annotations

from dataclasses import replace

from agents.controllers.arms import ARMS, Arm, ArmSettings
from agents.controllers.natural_arms import NATURAL_LAWS, SOURCES, TYRE_GAINS
from agents.controllers.nmpc import NmpcAgent, NmpcSettings
from agents.controllers.population_limits import PopulationDriver, coordinate_of
from agents.controllers.protocol import Agent
from agents.controllers.tuned import SETTINGS
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.errors import InvalidParameter

__all__ = ["PREDICTIVE", "make_nmpc"]

#: Agent -> the arm whose belief it has.
PREDICTIVE = {"nmpc_nominal": "nominal", "nmpc_belief": "aware", "nmpc_truth": "oracle"}
#: Standard deviations over which the belief is insured; on natural soils chosen on training episodes, where
#: more costs time and `NmpcSettings.margin` covers the rest.
_Z, _NATURAL_Z = 1.0, 0.7
#: Place of nominal in the population: it was best for the trackers with their first common knobs, and is not
#: searched for this controller.
_NATURAL_PLACE = 0.483
#: Settings on natural soils, chosen on training episodes: car sensors have biases, and on soft soil most of
#: what brakes in a bend is the soil, so that bends are prepared early.
_NATURAL = NmpcSettings(
    margin=0.7,
    inside=0.6,
    beyond=0.5,
    brake_share=0.35,
    speed_max=11.0,
    heading_bias=0.02,
    side_bias=0.15,
)
#: Soft soil locks a braked front wheel within a tenth of a second: brakes go as soon as it lags behind.
_SLIPS = replace(TYRE_GAINS, brake_slip=0.0, slip_band=0.08)


def make_nmpc(
    name: str, *, scenario: str = "speed", natural: bool = False, settings: NmpcSettings | None = None
) -> Arm:
    """Model-predictive control with one source of belief.

    Parameters
    ----------
    name
        In `PREDICTIVE`.
    scenario
    natural
        Whether beliefs are about what the soil holds instead of n.
    settings
        Default: those that were chosen on training episodes.

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
        tuned = {"n": _NATURAL_PLACE}
    else:
        terrain_info, _, source = ARMS[arm]
        tuned = SETTINGS.get((task, "nominal"), {})
    belief = source(task, ArmSettings(n=tuned.get("n", 0.3), z=_NATURAL_Z if natural else _Z))
    if settings is None and natural:
        settings = _NATURAL
    controller = NmpcAgent(belief, settings, slips=_SLIPS if natural else None)
    agent: Agent = controller
    if natural:
        agent = PopulationDriver(controller, NATURAL_LAWS, coordinate_of(task))
    return Arm(name=name, terrain_info=terrain_info, informed=ARMS[arm][1], agent=agent)
