"""What an environment is made of: its arguments by name, object, mapping or YAML, resolved and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from estimators.filters.online import OnBoard
from offroad_env.environment.arguments import checked_range, require_bearing, require_rate
from offroad_env.environment.plants import FOUR_WHEEL, PlantChoice
from offroad_env.environment.randomisation import Randomisation, Truth, apply_context, read_randomisation
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
from offroad_env.simulation.simulator import settled_state
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
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat

__all__ = ["Choices", "PlainSpec", "plain_arguments"]

#: Contexts that are drawn when an environment is made, to see whether its episodes can begin.
_DRAWS = 4


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
        randomise: Randomisation | Description | None,
    ) -> Choices:
        """The arguments of an environment, resolved.

        Raises
        ------
        InvalidParameter, DataError
            With what is wrong, and where.
        """
        task = find_scenario(scenario)
        if randomise is not None:
            randomise = read_randomisation(randomise)
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

    @property
    def _exponents(self) -> tuple[float, float]:
        """Least and largest n that episodes drive on [-]: a soil of one's own has one, but for patches."""
        return self.n_range if self.own_n is None or self.scenario.changing else (self.own_n, self.own_n)

    def require_bearing(self, sensors: SensorSuite, plants: PlantChoice) -> None:
        """Refuse choices and ranges with which a reset would fail later.

        Raises
        ------
        InvalidParameter
            For soils in which the standing vehicle drowns, tyres that do not fit a wheel, natural soil on
            hard ground, values that do not belong together; of what is randomised, with the key.
        """
        soil, exponents = self.soil.record, self._exponents
        require_bearing(self.vehicle.record, self.soil.name, soil, exponents, plants.model)
        if self.randomisation is None or not {"soil", "n", "soil.n"} & self.randomisation.table.keys():
            plants.require_natural(soil, exponents)
        if self.randomisation is None:
            return
        for key in ("vehicle", "vehicle.track"):
            if plants.vehicle_model == FOUR_WHEEL and key in self.randomisation.table:
                raise InvalidParameter(
                    f"randomise: {key!r} cannot be drawn with vehicle_model='four_wheel', whose roll "
                    "stiffness and inertia are those of the nominal vehicle"
                )
        nominal = Truth(self.vehicle.record, soil, flat(), sensors)
        for key in self.randomisation.table:
            for end in self.randomisation.ends(key):
                try:
                    self._require_possible({key: end}, nominal, plants)
                except (InvalidParameter, SolverFailure) as error:
                    raise InvalidParameter(f"randomise: {key} = {end!r}: {error}") from error
        for seed in range(_DRAWS):
            drawn = self.randomisation.draw(np.random.default_rng(seed))
            try:
                self._require_possible(drawn, nominal, plants)
            except (InvalidParameter, SolverFailure) as error:
                if "soil" in drawn and isinstance(error, SolverFailure):
                    continue  # of soils that are drawn whole some drown the vehicle: a reset draws again
                raise InvalidParameter(f"randomise: with {drawn} drawn: {error}") from error

    def _require_possible(self, context: Mapping[str, Any], nominal: Truth, plants: PlantChoice) -> None:
        """Refuse a context with which no episode can begin."""
        truth = apply_context(context, nominal)
        require_rate(truth.sensors.imu.rate)
        truth.sensors.anew().reset(np.random.default_rng(0), radius=truth.vehicle.r)
        if all(key.partition(".")[0] not in ("n", "soil", "vehicle") for key in context):
            return
        chosen = not {"n", "soil.n", "soil"}.isdisjoint(context)
        exponents = (truth.soil.n,) * 2 if chosen else self._exponents
        plants.require_natural(truth.soil, exponents)
        for n in dict.fromkeys(exponents):
            settled_state(plants.truth(truth.vehicle, make_soil(truth.soil, n=n), flat()))


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
    return read_randomisation(value).plain


def _plain_spread(value: Any) -> Any:
    return asdict(value) if isinstance(value, SoilSpread) else value


def _plain_range(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(float(one) for one in value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _plain_estimator(value: Any) -> Any:
    """The keys of an `OnBoard` that are not nominal, as `read_on_board` takes them."""
    if not isinstance(value, OnBoard):
        return value
    found = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    found = {name: part for name, part in found.items() if part is not None}
    for name, plain in (("vehicle", vehicle_mapping), ("soil", soil_mapping)):
        if name in found:
            found[name] = plain(found[name])
    if "ground" in found:
        found["ground"] = {name: _plain_range(part) for name, part in found["ground"]._asdict().items()}
    return found


_PLAIN: Mapping[str, Callable[[Any], Any]] = {
    "scenario": _plain_scenario,
    "soil": lambda value: soil_mapping(read_soil(value).record),
    "vehicle": _plain_vehicle,
    "weights": _plain_weights,
    "sensors": lambda value: sensors_mapping(read_sensors(value)),
    "structure": _plain_structure,
    "tyre": _plain_tyre,
    "natural_soil": _plain_spread,
    "estimator": _plain_estimator,
    "n_range": _plain_range,
    "randomise": _plain_randomisation,
}
