"""The record of one episode in a memory: views, which copies and pickles take anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from estimators.filters.navigation import NavigationFilter
from estimators.filters.online import Thinned
from estimators.filters.online_parameter_ukf import OnlineParameterUKF
from estimators.filters.online_soil_belief import BELIEF_VECTOR, LONGEST, OnlineSoilBelief
from estimators.filters.protocol import Estimator
from offroad_env.environment.control_period import period_of
from offroad_env.environment.episode_records import Memory, PeriodArguments
from offroad_env.environment.observation import WHOLE_SOIL, Layout
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.simulation.simulator import Plant
from offroad_env.simulation.soil_holds import SoilHolds, soils_hold

__all__ = ["EpisodeRow", "true_limits"]


def true_limits(plant: Plant) -> np.ndarray:
    """(17,) `BELIEF_VECTOR` of somebody who knows the base soil of a plant: all standard deviations are 0."""
    (held,) = soils_hold(plant, [plant.soil])
    if not np.isfinite(held).all():  # not even a rolling vehicle is carried
        held = np.array([0.0, 0.0, 0.5, plant.vehicle.m * GRAVITY, plant.vehicle.r, LONGEST])
    values = dict.fromkeys(BELIEF_VECTOR, 0.0)
    values |= dict(zip(SoilHolds._fields, held.tolist(), strict=True))
    values |= {"n": plant.soil.n, "stuck": float(held[1] <= 0.0), "stop_in": LONGEST, "valid": 1.0}
    return np.array([values[name] for name in BELIEF_VECTOR])


class EpisodeRow:
    """An environment's part of a `Memory`, of one episode or of many."""

    _sensing: SensorSuite  # of this episode
    _navigation: NavigationFilter
    _learner: OnlineParameterUKF | None
    _layout: Layout
    estimator: Estimator | None
    _memory: Memory
    _row: int
    _begun: bool  # an episode
    _warned: bool  # of steps after its end
    _arguments: PeriodArguments
    _period: Callable[[], None] | None  # for these arguments; None until it is called
    model: str
    terrain_info: str
    plant: Plant  # the truth
    _limits_of: Plant | None = None  # whose limits are known
    _limits: np.ndarray

    def _require_begun(self, call: str) -> None:
        if not self._begun:
            raise gym.error.ResetNeeded(f"{call} needs reset before it: no episode has begun")

    def _beyond_the_end(self, info: dict[str, Any]) -> float:
        """The reward of a step after the end, without terms: what the end costs or gives is paid once."""
        if not self._warned:
            gym.logger.warn("step after the end of an episode, which gives no reward: call reset before it")
        self._warned = True
        info["reward_terms"] = dict.fromkeys(info["reward_terms"], 0.0)
        return 0.0

    def join(self, memory: Memory, row: int) -> None:
        """Keep the episodes in that row of a memory, from the next reset on."""
        self._memory, self._row = memory, row
        self._bind()

    def _bind(self) -> None:
        """Take views of the own row: a copied or pickled view is an array of its own."""
        rows = slice(self._row, self._row + 1)
        self._arguments, self._period = self._memory.part(rows), None
        self._episode = self._memory.episodes[self._row]
        self.state, self.warm = self._episode["state"], self._episode["warm"]
        self.readings, self._rims = self._episode["readings"], self._episode["rims"]
        self._samples, self._report = self._episode["samples"], self._episode["report"]
        self._actions, self._shown = self._memory.actions[self._row], self._memory.shown[self._row]
        self._navigation.lodge(self._episode["navigation"], self._episode["covariance"])
        if self._learner is not None:
            self._learner.lodge(self._memory.episodes["filter"][rows])

    @property
    def memory_size(self) -> int:
        """Bytes of the record of an episode; its course and the noise lie beside it."""
        return self._memory.episodes.itemsize

    def __getstate__(self) -> dict[str, Any]:
        """Without the tuple of views, which would be stored once more, and the call that holds them."""
        return {key: value for key, value in self.__dict__.items() if key not in ("_arguments", "_period")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Views were copied as arrays of their own: look at the memory again."""
        self.__dict__.update(state)
        self._bind()

    def _run(self, phases: int) -> None:
        """Move the episode on by what ``phases`` ask for."""
        self._episode["phases"] = phases
        if self._period is None:
            self._period = period_of(self.model, self._arguments)
        self._period()

    @property
    def observation(self) -> dict[str, np.ndarray]:
        """What the agent sees now."""
        if self.terrain_info not in WHOLE_SOIL:
            return self._layout.split(self._shown)
        return self._layout.split(self._shown, self.soil_belief)

    @property
    def soil_belief(self) -> tuple[np.ndarray, ...]:
        """What ``terrain`` shows of whole soils (17,), believed or true; nothing where it shows n."""
        if self.terrain_info == "limits":
            return (self._true_limits(),)
        inner = self.estimator.inner if isinstance(self.estimator, Thinned) else self.estimator
        return (inner.vector,) if isinstance(inner, OnlineSoilBelief) else ()

    def _true_limits(self) -> np.ndarray:
        """What the episode's base soil holds, without its variation over metres."""
        if self._limits_of is not self.plant:
            self._limits_of, self._limits = self.plant, true_limits(self.plant)
        return self._limits

    def draw_noise(self) -> None:
        """Sensor noise of the next periods, for a caller of the compiled period."""
        self._sensing.draw_noise(self._memory.noise[self._row])
        self._episode["noise_row"] = 0
