"""Traction limits over what a soil holds, for controllers that do not know its five numbers.

Measured soils differ in pressure, n, cohesion, friction angle and shear modulus, and no single one of them
decides what a tyre holds (`offroad_env.world.soil_prior`). What a driver can know is the limit itself: so
here soils of the population are ordered by one of their limits, and the table of
`agents.controllers.traction_limits` runs over that limit where it otherwise runs over n.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from agents.controllers.protocol import Agent, Observation
from agents.controllers.speed_planner import Belief, BeliefSource
from agents.controllers.traction_limits import Capability, SoilRow, WheelLaws, soil_row, table_of
from estimators.filters.online_soil_belief import BELIEF_VECTOR
from offroad_env.environment.soil_draws import MeasuredSoils
from offroad_env.errors import SolverFailure
from offroad_env.physics.records import Vehicle
from offroad_env.simulation.soil_holds import REFERENCE_SPEED

__all__ = [
    "COORDINATES",
    "Coordinate",
    "PopulationDriver",
    "believe_limit",
    "population_limits",
    "population_range",
]

#: Soils of which the table is made, and the seed they are drawn with; not those of any benchmark.
_SOILS, _SEED = 60, 90210
#: Places of the table, by quantile: the ends hold what 2 % of the soils exceed.
_NODES, _ENDS = 13, (0.02, 0.98)
#: Weaker soils, as shares of the lower end: who knows that a soil holds less drives by what it holds.
_WEAKER = (0.25, 0.5, 0.75)
#: Width of the average over neighbouring soils, as a share of the table [-].
_WIDTH = 0.08
_LATERAL_ANGLE = np.radians(15.0)
#: Factor on the standard deviation of a belief whose flag is down [-].
_UNSURE = 2.0


class Coordinate(NamedTuple):
    """A limit that decides a task, and how a belief about soils gives it."""

    entry: str  #: of `BELIEF_VECTOR`
    of_table: str  #: the same in a row of the table: "lateral" or "braking"


#: Task -> the limit by which its controller knows the soil. Not so in `climb`: tyres pull most at the highest
#: slip on nearly all soils, so no two of them differ in it.
COORDINATES: dict[str, Coordinate] = {"brake": Coordinate("stopping", "braking")}
_LATERAL = Coordinate("lateral", "lateral")


def coordinate_of(task: str) -> Coordinate:
    """The limit that counts in a task: where nothing else is said, the lateral one."""
    return COORDINATES.get(task, _LATERAL)


def as_coordinate(coordinate: Coordinate, mean: float, sd: float) -> tuple[float, float]:
    """(value, standard deviation) of the coordinate from an entry of the belief and its deviation.

    A stopping distance d from v is a deceleration of v^2 / (2 d), with the same relative deviation.
    """
    if coordinate.entry != "stopping":
        return mean, sd
    value = REFERENCE_SPEED**2 / (2.0 * max(mean, 0.1))
    return value, value * sd / max(mean, 0.1)


@lru_cache(maxsize=8)
def _rows(vehicle: Vehicle, laws: WheelLaws) -> tuple[SoilRow, ...]:
    """What soils of the population hold, one row each."""
    soils, rng = MeasuredSoils(), np.random.default_rng(_SEED)
    found: list[SoilRow] = []
    while len(found) < _SOILS:
        try:
            found.append(soil_row(vehicle, soils.draw(rng), laws))
        except SolverFailure:
            continue  # a soil that carries a standing vehicle, but no rolling one
    return tuple(found)


def _value(coordinate: Coordinate, row: SoilRow) -> float:
    """The coordinate of a soil."""
    if coordinate.of_table == "braking":
        return float(row.scalars[0])
    sides = [np.interp(_LATERAL_ANGLE, row.angles, np.maximum.accumulate(side)) for side in row.bends[0]]
    return float(min(sides))


@lru_cache(maxsize=16)
def population_limits(vehicle: Vehicle, laws: WheelLaws, coordinate: Coordinate) -> Capability:
    """The limits of soils that have a coordinate in common, over that coordinate; cached.

    A row is the mean of the soils nearby, weighted by a normal kernel; its side forces, or its braking, are
    then scaled to the coordinate itself. Below `population_range` all that the weakest row holds is scaled.
    """
    rows = _rows(vehicle, laws)
    values = np.array([_value(coordinate, row) for row in rows])
    low, high = population_range(vehicle, laws, coordinate)
    nodes = np.linspace(low, high, _NODES)
    width = _WIDTH * (high - low)
    merged = []
    for node in nodes:
        apart = (values - node) / width
        weights = np.exp(-0.5 * (apart**2 - (apart**2).min()))
        weights /= weights.sum()
        merged.append(_scaled(_mean(rows, weights), coordinate, float(node)))
    weaker = [_weakened(merged[0], share) for share in _WEAKER]
    return table_of(np.append(low * np.array(_WEAKER), nodes), [*weaker, *merged])


@lru_cache(maxsize=16)
def population_range(vehicle: Vehicle, laws: WheelLaws, coordinate: Coordinate) -> tuple[float, float]:
    """(low, high) of a coordinate over the soils of the population but for the extreme ones; cached."""
    low, high = np.quantile([_value(coordinate, row) for row in _rows(vehicle, laws)], _ENDS)
    return float(low), max(float(high), float(low) + 0.05)


def _weakened(row: SoilRow, share: float) -> SoilRow:
    """The row of a soil that holds a share of it in every direction and resists as much."""
    return row._replace(
        scalars=row.scalars * np.array([share, share, 1.0, 1.0]),
        bends=row.bends * np.array([share, 1.0])[:, None, None],
        pull=row.pull * share,
    )


def _mean(rows: Sequence[SoilRow], weights: np.ndarray) -> SoilRow:
    return rows[0]._replace(
        scalars=np.tensordot(weights, [row.scalars for row in rows], axes=1),
        bends=np.tensordot(weights, [row.bends for row in rows], axes=1),
        pull=np.tensordot(weights, [row.pull for row in rows], axes=1),
    )


def _scaled(row: SoilRow, coordinate: Coordinate, value: float) -> SoilRow:
    """The row with its own coordinate at the wanted value."""
    factor = value / max(_value(coordinate, row), 1e-3)
    if coordinate.of_table == "braking":
        return row._replace(scalars=row.scalars * np.array([factor, 1.0, 1.0, 1.0]))
    return row._replace(bends=row.bends * np.array([factor, 1.0])[:, None, None])


def believe_limit(coordinate: Coordinate, z: float) -> BeliefSource:
    """The limit of ``terrain_info="belief"`` or "limits", insured over ``z`` standard deviations.

    While the flag is down the standard deviation counts `_UNSURE` times: the mean is still the best guess.
    """
    place = BELIEF_VECTOR.index(coordinate.entry)

    def believe(briefing: Any, table: Capability, observation: Observation) -> Belief:
        low, high = float(table.grid[0]), float(table.grid[-1])
        terrain = observation["terrain"]
        mean, sd = as_coordinate(coordinate, float(terrain[place]), float(terrain[place + 1]))
        if not (np.isfinite(mean) and np.isfinite(sd)):
            mean, sd = 0.5 * (low + high), (high - low) / np.sqrt(12.0)
        elif terrain[-1] < 0.5:
            sd *= _UNSURE
        mean = min(max(mean, low), high)
        return Belief(max(mean - z * sd, low), mean, min(mean + z * sd, high))

    return believe


class Tabulating(Agent, Protocol):
    """A controller that lets others make its table."""

    tabulate: Callable[[Any], Capability]  #: ``tabulate(briefing)`` -> traction limits


class PopulationDriver:
    """A controller of one task whose table runs over a limit of the population.

    Parameters
    ----------
    agent
        Controller made for a table over n.
    laws
        Structure and tyre of the wheels that it assumes.
    coordinate
        Over what its table runs.
    """

    def __init__(self, agent: Tabulating, laws: WheelLaws, coordinate: Coordinate) -> None:
        self.agent: Agent = agent
        self._laws, self._coordinate = laws, coordinate
        agent.tabulate = self._table

    def _table(self, briefing: Any) -> Capability:
        return population_limits(briefing.vehicle, self._laws, self._coordinate)

    def reset(self, briefing: Any) -> None:
        """As `Agent`; the range of the coordinate takes the place of that of n."""
        ends = population_range(briefing.vehicle, self._laws, self._coordinate)
        self.agent.reset(dataclasses.replace(briefing, n_range=ends))

    def act(self, observation: Observation) -> np.ndarray:
        """As `Agent`."""
        return self.agent.act(observation)
