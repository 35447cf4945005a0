"""The environment ``OffroadBekker-v1``, and its vector environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Structure, Tyre, Vehicle, Wheel
from offroad_env.simulation.sensor_descriptions import SensorsLike
from offroad_env.world.descriptions import Description, read_vehicle
from offroad_env.world.four_wheel_vehicles import FourWheelVehicle
from offroad_env.world.natural_soil import SoilSpread
from offroad_env.world.tyres import TYRES, make_tyre, require_fitting_tyre

__all__ = ["OffroadBekkerEnvV1", "OffroadBekkerVectorEnvV1"]

#: Inflation pressure where the catalogue has no tyre for a vehicle [Pa].
_INFLATION = 150e3


def own_tyre(vehicle: Vehicle | FourWheelVehicle | Description) -> Tyre:
    """The tyre of a vehicle: of its name in the catalogue where that fits, else of its size at 150 kPa."""
    name, driven, _ = read_vehicle(vehicle)
    if name in TYRES:
        try:
            require_fitting_tyre(TYRES[name], Wheel(driven.r, driven.b))
        except InvalidParameter:  # the wheel of the HMMWV is that of a narrower tyre
            pass
        else:
            return TYRES[name]
    return make_tyre(r=driven.r, b=driven.b, inflation=_INFLATION)


class OffroadBekkerEnvV1(OffroadBekkerEnv):
    """`OffroadBekkerEnv` with the vehicle, ground and sensors that people have.

    ## Description
    Action, rewards, tasks, arguments and info are those of v0 (`OffroadBekkerEnv`). Only defaults differ, and
    each can be set back:

    - ``structure="field"`` (v0: None, Wong-Reece contact angles on a rigid rim, no ruts): pressure along the
      ground's normal from each point's own sinkage, shear along the path in the soil, ruts that the rear
      wheels follow, Lyasko's slip sinkage
    - ``tyre="own"`` (v0: None, rigid rims): the vehicle's tyre in `world.tyres.TYRES` if it fits the wheel,
      else one of the wheel's size at 150 kPa
    - ``natural_soil=True`` (v0: False, the same soil everywhere but for the stretches of "patches"): a random
      field of pressure, n, cohesion and friction angle around the drawn soil
    - ``sensors="automotive"`` (v0: "paper", white noise, gravity taken out): bias and drift, scale errors,
      misalignment, gravity in the accelerations, latency, losses, counted wheel speeds, GNSS errors of 0.2 m

    ``randomise={"soil": MeasuredSoils()}`` drives on another whole soil of the measured population in every
    episode.

    Structure, tyre and natural soil need ``model="full"`` and deformable soil.

    ## Observation Space
    That of v0. ``imu`` holds gravity: a_z is about 9.8 m/s^2 at rest, and a_x leans with the pitch. The pose
    behind ``path`` lags by the latency of the receiver and wanders with its error.

    ## Estimators
    They assume the half-car on rigid rims with Wong-Reece angles on uniform soil, and sensors
    with white noise: with these defaults the model is not matched.

    ## Version History
    v1: other defaults than v0, as above.
    """

    def __init__(
        self,
        *,
        scenario: Scenario | Description = "track",
        vehicle: Vehicle | FourWheelVehicle | Description | None = None,
        structure: Structure | Description | None = "field",
        tyre: Tyre | Description | None = "own",
        natural_soil: bool | SoilSpread | Mapping[str, float] = True,
        sensors: SensorsLike = "automotive",
        **options: Any,
    ) -> None:
        driven = find_scenario(scenario).vehicle if vehicle is None else vehicle
        super().__init__(
            scenario=scenario,
            vehicle=vehicle,
            structure=structure,
            tyre=own_tyre(driven) if isinstance(tyre, str) and tyre == "own" else tyre,
            natural_soil=natural_soil,
            sensors=sensors,
            **options,
        )


class OffroadBekkerVectorEnvV1(OffroadBekkerVectorEnv):
    """N episodes of `OffroadBekkerEnvV1`: the same numbers as N single environments, to the last bit."""

    single = OffroadBekkerEnvV1
