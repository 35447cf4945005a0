"""Episodes as policies learn from them: what an action means, and what is learnt. Needs the extra ``rl``."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces

from agents.learning.action_interface import ActionInterface, make_interface
from agents.learning.emulated_belief import EmulatedBelief
from offroad_env.environment.env import CONTROL_PERIOD
from offroad_env.environment.sb3_vec import Sb3VecEnv
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv
from offroad_env.errors import InvalidParameter

__all__ = ["OBJECTIVES", "LearningVecEnv"]

#: What is learnt: the environment's reward, or minus the benchmark's score (`_objective`).
OBJECTIVES = ("reward", "score")
#: Last episodes by which it is judged how many arrive; before the fewest none is thought to.
_LAST, _FEWEST = 100, 20
#: Speed below which a vehicle counts as standing in training [m/s].
SLOW = 1.0


class LearningVecEnv(Sb3VecEnv):
    """`Sb3VecEnv` with actions of a policy, each held for a while, and the benchmark's score to learn.

    Parameters
    ----------
    envs
        With ``autoreset_mode="SameStep"``.
    action_interface
        Name in `agents.learning.action_interface.ACTION_INTERFACES`: what the actions mean, each of which is
        held for a while. None: actions and observations are the environment's own.
    objective : {"reward", "score"}
        What is learnt.
    charge
        Cost of a failure there, as a share of the task's time limit. With the whole of it, as in the
        benchmark, failures by exploration noise dominate the learning of speed.
    pace
        Time that a metre of progress counts for where time is measured [s/m]: 0.15 is 7 m/s.
    edge
        The reward's weight of the distance from the path while none of the last episodes arrives, and when
        all do; in between it grows with their share. The price of a failure is proportional to it, so
        that it grows as the policy gets better. None: the weight is that of the environment.
    idle
        Time of standing, or of less than `SLOW`, that costs as much as a failure [s]; None: standing costs
        what it costs in the environment. For tasks that do not end with a stop.
    centre
        Further weight of the distance from the path: per second at the edge of the corridor, quadratic.
        Unlike ``edge`` it holds from the start, and no price of a failure depends on it.
    belief_seed
        Show an emulated belief about the soil instead of its true limits, which the environments observe
        (``terrain_info="limits"``); this is the seed of its errors. None: what they observe is shown.

    Notes
    -----
    An episode that begins while an action is held is driven by it for the rest, at most 0.18 s, without
    reward.
    """

    def __init__(  # noqa: PLR0913 - an argument for each price
        self,
        envs: OffroadBekkerVectorEnv,
        *,
        action_interface: str | None = None,
        objective: str = "reward",
        charge: float = 1.0,
        pace: float = 0.15,
        edge: tuple[float, float] | None = None,
        idle: float | None = None,
        centre: float = 0.0,
        belief_seed: int | None = None,
    ) -> None:
        super().__init__(envs)
        if objective not in OBJECTIVES:
            raise InvalidParameter(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
        self.objective = objective
        self.charge = charge  #: may be changed between two steps
        self._pace, self._edge, self._idle, self._centre = pace, edge, idle, centre
        self._ends: deque[bool] = deque(maxlen=_LAST)
        first = envs.envs[0]
        self._scenario: Scenario = first.scenario
        if objective == "score" and self._scenario.measure == "cross_track":
            raise InvalidParameter('objective must be "reward" where a distance from the path is measured')
        self._interface = (
            None if action_interface is None else make_interface(action_interface, first.briefing)
        )
        if self._interface is not None:
            self.observation_space = _space_of(self._interface, self.observation_space)
        hold = 1 if self._interface is None else self._interface.hold
        self._belief: EmulatedBelief | None = None
        if belief_seed is not None:
            if first.terrain_info != "limits":
                raise InvalidParameter(
                    f'an emulated belief needs terrain_info="limits", got {first.terrain_info!r}'
                )
            self._belief = EmulatedBelief(envs.num_envs, hold * CONTROL_PERIOD, belief_seed)
        self._set_price()

    def reset(self) -> dict[str, np.ndarray]:
        """Start all episodes."""
        self._start()
        return self._believed(np.ones(self.num_envs, np.bool_))

    def _believed(self, fresh: np.ndarray) -> dict[str, np.ndarray]:
        """What the learner sees, ``fresh`` (N,) episodes having just begun."""
        if self._belief is not None:
            if fresh.any():
                self._belief.restart(fresh)
            self._last_belief = self._belief.shown(self._seen)
            self._seen = {**self._seen, "terrain": self._last_belief}
        return self._shown(self._seen)

    def _shown_last(self, observation: dict[str, np.ndarray], row: int) -> dict[str, np.ndarray]:
        """With the last belief of the episode, where it is emulated."""
        known = {} if self._belief is None else {"terrain": self._last_belief[row]}
        return self._shown({**observation, **known})

    def _set_price(self) -> None:
        """Weigh the edge of the corridor by how many of the last episodes arrived; from the next reset on.

        A failure that costs much from the start teaches to stand, since those who learn leave the corridor
        whenever they drive; one that costs little is never unlearnt.
        """
        if self._edge is None:
            return
        (low, high), count = self._edge, len(self._ends)
        arrived = sum(self._ends) / count if count >= _FEWEST else 0.0
        weights = replace(self.envs.envs[0].weights, cross_track=low + (high - low) * arrived)
        self.set_attr("weights", weights)

    def _start(self) -> dict[str, Any]:
        infos = super()._start()
        self._progress = infos["progress"].copy()
        return infos

    def _shown(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the learner sees of them."""
        return observations if self._interface is None else self._interface.seen(observations)

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One step of all episodes: a control period, or the time for which an action is held."""
        if self._interface is None:
            gained, done, ends = self._gained(self._actions)
            return self._believed(done), gained, done, ends
        rewards = np.zeros(self.num_envs, np.float32)
        over = np.zeros(self.num_envs, np.bool_)
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(self._interface.hold):
            gained, done, ends = self._gained(self._interface.actions(self._seen, self._actions))
            rewards += np.where(over, np.float32(0.0), gained)
            for i in np.flatnonzero(done & ~over):
                listed[i] = ends[i]
            over |= done
        return self._believed(over), rewards, over, listed

    def _gained(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """What a period brings, ends, and infos."""
        rewards, done, listed, infos = self._one_period(actions)
        if done.any():
            self._ends.extend(bool(listed[i]["is_success"]) for i in np.flatnonzero(done))
            self._set_price()
        if self._idle is not None:
            price = self.envs.envs[0].weights.failure(self._scenario.time_limit)
            rewards = rewards - (infos["speed"] < SLOW) * (price * CONTROL_PERIOD / self._idle)
        if self._centre:
            off = np.minimum(np.abs(infos["cross_track_error"]) / self._scenario.corridor, 1.0)
            rewards = rewards - self._centre * CONTROL_PERIOD * off * off
        if self.objective == "score":
            rewards = self._objective(infos["progress"], done, listed)
        return rewards.astype(np.float32), done, listed

    def _objective(self, progress: np.ndarray, done: np.ndarray, ends: list[dict[str, Any]]) -> np.ndarray:
        """Minus the score that a period adds, shaped by progress.

        In tasks that measure time, a period costs its time, and a failure a share of the time limit; a metre
        of progress counts for ``pace`` seconds, a potential (A. Y. Ng, D. Harada, S. Russell, ICML 1999):
        without a discount the sum of an episode that arrives is minus its score but for a constant of the
        course. Where the way is measured, it is the way.
        """
        last = np.array([end["progress"] if done[i] else progress[i] for i, end in enumerate(ends)])
        advance = last - self._progress
        self._progress = progress.copy()
        timed = self._scenario.measure == "time"
        gained = self._pace * advance - CONTROL_PERIOD if timed else advance
        for i in np.flatnonzero(done):
            end = ends[i]
            regular = end["success"] or (self._scenario.stalling and end["failure"] in ("", "immobilised"))
            if regular:
                continue
            gained[i] -= self.charge * self._scenario.time_limit if timed else end["progress"]
        return np.asarray(gained)


def _space_of(interface: ActionInterface, given: Any) -> spaces.Dict:
    """Space of what a policy sees of observations in the space ``given``."""
    shown = interface.seen({key: np.zeros(box.shape, np.float32) for key, box in given.items()})
    added = {key: spaces.Box(-np.inf, np.inf, shown[key].shape, np.float32) for key in {*shown} - {*given}}
    return spaces.Dict({**given, **added})
