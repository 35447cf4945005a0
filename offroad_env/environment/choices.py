"""What an environment is made of: its arguments by name, object, mapping or YAML, resolved and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from offroad_env.environment.arguments import checked_range, require_bearing
from offroad_env.environment.plants import FOUR_WHEEL
from offroad_env.environment.randomisation import Randomisation, Truth, apply_context
from offroad_env.environment.rewards import RewardWeights
from offroad_env.environment.scenario_descriptions import (
    find_scenario,
    read_weights,
    scenario_mapping,
    weights_mapping,
)
from offroad_env.environment.scenarios import BUILT_IN, Scenario
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil, Structure, Tyre, Vehicle
from offroad_env.simulation.sensor_descriptions import read_sensors, sensors_mapping
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.world.descriptions import (
    Description,
    NamedSoil,
    NamedVehicle,
    choose_structure,
    choose_tyre,
    is_registered,
    read_soil,
    read_vehicle,
    soil_mapping,
    structure_mapping,
    tyre_mapping,
    vehicle_mapping,
)
from offroad_env.world.documents import is_name, open_document
from offroad_env.world.four_wheel_vehicles import FourWheelVehicle
from offroad_env.world.natural_soil import SoilSpread
from offroad_env.world.terrain import flat

__all__ = ["Choices", "PlainSpec", "plain_arguments"]


class PlainSpec:
    """An environment whose ``spec`` holds plain values: no objects, files or names that others do not have.

    So ``spec.to_json()`` works with one's own soil or vehicle, and what is made from it is the same.
    """

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> Any:
        """How it was made, by ``gym.make``; None without it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None if spec is None else replace(spec, kwargs=plain_arguments(spec.kwargs))


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Scenario, soil, vehicle, reward and what differs from episode to episode."""

    scenario: Scenario
    soil: NamedSoil  #: nominal
    own_n: float | None  #: true n of a soil of one's own [-]; None where n is drawn
    vehicle: NamedVehicle  #: nominal
    weights: RewardWeights
    n_range: tuple[float, float]  #: prior of the sinkage exponent [-]
    randomisation: Randomisation | None

    @classmethod
    def read(
        cls,
        scenario: Scenario | Description,
        *,
        soil: Soil | Description | None,
        vehicle: Vehicle | FourWheelVehicle | Description | None,
        weights: RewardWeights | Description | None,
        n_range: Any,
        randomise: Randomisation | Mapping[str, Any] | None,
    ) -> Choices:
        """The arguments of an environment, resolved.

        Raises
        ------
        InvalidParameter, DataError
            With what is wrong, and where.
        """
        task = find_scenario(scenario)
        if randomise is not None and not isinstance(randomise, Randomisation):
            randomise = Randomisation(randomise)
        chosen = read_soil(task.soil if soil is None else soil)
        if n_range is None and randomise is not None:
            n_range = randomise.n_range
        own_n = chosen.record.n if n_range is None and _is_own("soil", soil) else None
        if own_n is not None:
            n_range = (min(task.n_range[0], own_n), max(task.n_range[1], own_n))
        return cls(
            scenario=task,
            soil=chosen,
            own_n=own_n,
            vehicle=read_vehicle(task.vehicle if vehicle is None else vehicle),
            weights=task.weights if weights is None else read_weights(weights, task.weights),
            n_range=checked_range(task.n_range if n_range is None else n_range, chosen.record),
            randomisation=randomise,
        )

    @property
    def draws_soils(self) -> bool:
        """Whether episodes differ in more of their soil than n."""
        keys = () if self.randomisation is None else self.randomisation.table
        return any(key == "soil" or (key.startswith("soil.") and key != "soil.n") for key in keys)

    def require_bearing(self, sensors: SensorSuite, model: str, vehicle_model: str) -> None:
        """Refuse ranges that reach soils in which the standing vehicle drowns: a reset would fail later."""
        soil = self.soil.record
        require_bearing(self.vehicle.record, self.soil.name, soil, self.n_range, model)
        if self.randomisation is None:
            return
        for key in ("vehicle", "vehicle.track"):
            if vehicle_model == FOUR_WHEEL and key in self.randomisation.table:
                raise InvalidParameter(
                    f"randomise: {key!r} cannot be drawn with vehicle_model='four_wheel', whose roll "
                    "stiffness and inertia are those of the nominal vehicle"
                )
        nominal = Truth(self.vehicle.record, soil, flat(), sensors)
        for key, distribution in self.randomisation.table.items():
            for end in distribution.ends:
                self._require_end(key, end, nominal, model)

    def _require_end(self, key: str, end: Any, nominal: Truth, model: str) -> None:
        try:
            truth = apply_context({key: end}, nominal)
            truth.sensors.anew().reset(np.random.default_rng(0), radius=truth.vehicle.r)
            ns = (truth.soil.n,) * 2 if key in ("n", "soil.n", "soil") else self.n_range
            if key.partition(".")[0] in ("n", "soil", "vehicle"):
                require_bearing(truth.vehicle, "the soil", truth.soil, ns, model)
        except (InvalidParameter, SolverFailure) as error:
            raise InvalidParameter(f"randomise: {key} = {end!r}: {error}") from error


def plain_arguments(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments without objects, files and names of one's own: for JSON and for other processes."""
    return {name: _plain(name, value) for name, value in arguments.items()}


def _is_own(name: str, value: Any) -> bool:
    """Whether an argument is something of one's own, not a name that every process knows."""
    if value is None:
        return False
    return not is_name(value) or is_registered(name, value) or (name == "scenario" and value not in BUILT_IN)


def _plain(name: str, value: Any) -> Any:
    known = name not in _PLAIN or isinstance(value, bool) or not _is_own(name, value)
    return value if known else _PLAIN[name](value)


def _plain_scenario(value: Any) -> Any:
    scenario = find_scenario(value)
    if scenario.name in BUILT_IN and scenario == find_scenario(scenario.name):
        return scenario.name
    found = scenario_mapping(scenario)
    return value if found is None else found


def _plain_vehicle(value: Any) -> Any:
    _, vehicle, four_wheel = read_vehicle(value)
    return vehicle_mapping(vehicle, four_wheel)


def _plain_structure(value: Any) -> Any:
    found = choose_structure(value)
    return structure_mapping(found) if isinstance(found, Structure) and found.tyre is None else found


def _plain_tyre(value: Any) -> Any:
    found = choose_tyre(value)
    return tyre_mapping(found) if isinstance(found, Tyre) else found


def _plain_weights(value: Any) -> Any:
    if isinstance(value, RewardWeights):
        return weights_mapping(value)
    return dict(open_document(value, "weights").content)


def _plain_randomisation(value: Any) -> Any:
    return (value if isinstance(value, Randomisation) else Randomisation(value)).plain


def _plain_spread(value: Any) -> Any:
    return asdict(value) if isinstance(value, SoilSpread) else value


_PLAIN: Mapping[str, Callable[[Any], Any]] = {
    "scenario": _plain_scenario,
    "soil": lambda value: soil_mapping(read_soil(value).record),
    "vehicle": _plain_vehicle,
    "weights": _plain_weights,
    "sensors": lambda value: sensors_mapping(read_sensors(value)),
    "structure": _plain_structure,
    "tyre": _plain_tyre,
    "natural_soil": _plain_spread,
    "randomise": _plain_randomisation,
}
