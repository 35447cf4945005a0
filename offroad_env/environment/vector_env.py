"""Many episodes at once: the native vector environment behind ``gymnasium.make_vec``."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from offroad_env.environment.arguments import (
    checked_actions,
    require_choice,
    require_count,
    require_mapping,
    require_seed,
)
from offroad_env.environment.choices import PlainSpec
from offroad_env.environment.control_period import BELIEVE, DRIVE, REPORT, period_full, period_paper
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.episode_records import (
    CONTROL_PERIOD,
    LAST_ROW,
    REPORTED,
    REPORTED_TERMS,
    Memory,
)
from offroad_env.environment.observation import WHOLE_SOIL, Layout
from offroad_env.environment.rewards import ENDINGS, TERMS
from offroad_env.errors import InvalidParameter
from offroad_env.world.yaml_text import shown

__all__ = ["OffroadBekkerVectorEnv", "make_vec"]

_EVERYTHING = DRIVE | BELIEVE | REPORT
_GOAL = ENDINGS.index("goal")
_FAILURES = np.array(["" if ending == "goal" else ending for ending in ENDINGS], dtype=object)
_TERM_COLUMNS = range(REPORTED_TERMS.start, REPORTED_TERMS.stop)
#: Fewest episodes that are worth a thread: handing over costs as much as one period or two.
_FEWEST = 4
#: More environments than fit into any memory: an environment takes some 10 kB.
_MOST_ENVS = 1_000_000


def make_vec(num_envs: int, **options: Any) -> VectorEnv:
    """``num_envs`` episodes of ``OffroadBekker-v0`` that run in one compiled call.

    Parameters
    ----------
    num_envs
        Episodes at a time.
    options
        Arguments of `OffroadBekkerVectorEnv` and of `OffroadBekkerEnv`; ``version="v1"`` makes episodes of
        ``OffroadBekker-v1``.

    Examples
    --------
    >>> envs = make_vec(8, scenario="speed", terrain_info="estimate")
    >>> observations, infos = envs.reset(seed=0)
    >>> observations["path"].shape
    (8, 12)
    """
    if require_count("num_envs", num_envs) > _MOST_ENVS:
        raise InvalidParameter(f"num_envs must be at most {_MOST_ENVS}, got {num_envs}")
    version = options.pop("version", "v0")
    require_choice("version", version, ("v0", "v1"))
    name = f"offroad_env:OffroadBekker-{version}"
    return gym.make_vec(name, num_envs, vectorization_mode="vector_entry_point", **options)


def _threads(wanted: int | None, num_envs: int) -> int:
    if wanted is None:
        usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return max(min(usable, num_envs // _FEWEST), 1)
    return min(require_count("threads", wanted), num_envs)


def _copied(infos: dict[str, Any]) -> dict[str, Any]:
    """Infos that share no memory with these."""
    return {key: _copied(value) if isinstance(value, dict) else value.copy() for key, value in infos.items()}


def _period_of(env: OffroadBekkerEnv) -> Any:
    """The compiled period of its model."""
    return period_full if env.model == "full" else period_paper


def _autoreset(given: str | AutoresetMode) -> AutoresetMode:
    try:
        return AutoresetMode(given)
    except ValueError:
        names = ", ".join(mode.value for mode in AutoresetMode)
        raise InvalidParameter(f"autoreset_mode must be one of {names}, got {shown(given)}") from None


class OffroadBekkerVectorEnv(PlainSpec, VectorEnv):
    """N episodes of `OffroadBekkerEnv`: the same numbers as N single environments, to the last bit.

    Episodes share nothing but the arguments; seeds, time limit, truncation and ``infos`` are those of
    Gymnasium's `SyncVectorEnv`. A step is one compiled call for all episodes, on all processors; what
    begins anew is drawn by the single environment's own `reset`. Truths of an extended model move one by one.

    Parameters
    ----------
    num_envs
        Episodes.
    max_episode_steps
        Steps after which an episode is truncated, if the task's time limit has not done so; None: that limit
        alone.
    autoreset_mode
        When an episode that has ended begins anew: "NextStep" (that step's action is not used), "SameStep"
        (what ended is in ``infos["final_obs"]`` and ``infos["final_info"]``) or "Disabled" (call
        ``reset(options={"reset_mask": ended})``).
    threads
        Threads of a step, default one per usable processor; the results do not depend on it.
    options
        Arguments of `OffroadBekkerEnv`, the same for all episodes.

    Notes
    -----
    ``reset(options={"n": [...]})`` takes one sinkage exponent per episode, or one for all; "context" likewise
    one mapping or a list of them.
    """

    #: What runs N times.
    single: type[OffroadBekkerEnv] = OffroadBekkerEnv

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        #: Episodes.
        self.num_envs = require_count("num_envs", num_envs)
        if self.num_envs > 1 and options.get("render_mode") == "human":
            raise InvalidParameter(
                f'render_mode="human" shows one environment, got num_envs={num_envs} - "rgb_array" gives a '
                "picture of each"
            )
        self.autoreset_mode = _autoreset(autoreset_mode)
        self.envs = [self.single(**options) for _ in range(self.num_envs)]
        first = self.envs[0]
        if max_episode_steps is not None:
            max_episode_steps = require_count("max_episode_steps", max_episode_steps)
        self.max_episode_steps = max_episode_steps
        self._most_steps = math.inf if max_episode_steps is None else max_episode_steps
        self._time_limit = first.scenario.time_limit
        self.metadata = {**first.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = first.render_mode
        #: Of one episode.
        self.single_action_space, self.single_observation_space = first.action_space, first.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)  #: of all episodes
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)  #: of all episodes
        self._layout = Layout(first.vehicle.steer_max, terrain_info=first.terrain_info)
        self._period: Any = _period_of(first)
        self._memory = Memory(self.num_envs, first.sizes)
        for row, env in enumerate(self.envs):
            env.join(self._memory, row)
        count = _threads(threads, self.num_envs)
        edges = [round(i * self.num_envs / count) for i in range(count + 1)]
        self._shares = [slice(low, high) for low, high in pairwise(edges)]
        self._pool, self._process = self._make_pool(), os.getpid()
        self._elapsed = np.zeros(self.num_envs, np.int64)
        self._over = np.zeros(self.num_envs, np.bool_)
        self._begun = np.zeros(self.num_envs, np.bool_)
        self._has_context = np.zeros(self.num_envs, np.bool_)
        self._context_infos: dict[str, Any] | None = None

    def _make_pool(self) -> ThreadPoolExecutor | None:
        """Threads for all shares but the first, which the caller's own thread takes."""
        return ThreadPoolExecutor(len(self._shares) - 1) if len(self._shares) > 1 else None

    def __getstate__(self) -> dict[str, Any]:
        """Without threads and compiled code, which no file can hold."""
        left_out = ("_pool", "_period", "_context_infos")
        return {key: value for key, value in self.__dict__.items() if key not in left_out}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """With threads of its own."""
        self.__dict__.update(state)
        self._context_infos = None
        self._period = _period_of(self.envs[0])
        self._pool, self._process = self._make_pool(), os.getpid()

    # ------------------------------------------------------------------ Gymnasium

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | np.ndarray | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any]] | None = None,
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start all episodes, or those of ``options["reset_mask"]``; seeds as in Gymnasium's vector API.

        ``options`` may also be a list with the options of each single episode.
        """
        seeds = self._row_seeds(seed)
        if isinstance(options, list | tuple):
            rows, chosen = self._masked(None), self._options_of_each(options)
        else:
            shared = require_mapping("options", options)
            rows = self._masked(shared.pop("reset_mask", None))
            chosen = self._row_options(shared, rows)
        for i, row_options in zip(rows, chosen, strict=True):
            self._restart(i, seeds[i], row_options)
        present = np.zeros(self.num_envs, np.bool_)
        present[rows] = True
        return self._observations(), self._infos(present)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control period of every episode."""
        values = checked_actions("actions", actions, (self.num_envs, 2))
        if not self._begun.all():
            raise ResetNeeded("step needs reset before it: no episode has begun")
        if self.autoreset_mode is AutoresetMode.DISABLED and self._over.any():
            raise InvalidParameter(f"episodes {np.flatnonzero(self._over)} are over: reset them first")
        again = self._over.copy()
        self._memory.actions[:] = values
        self._advance(~again)
        for i in np.flatnonzero(again).tolist():
            self._restart(i, None, {})
        self._elapsed[~again] += 1
        episodes = self._memory.episodes
        terms = episodes["report"][:, REPORTED_TERMS]
        rewards = np.zeros(self.num_envs)
        for j in range(len(TERMS)):  # one after the other, as a single environment adds them
            rewards += terms[:, j]
        rewards[again] = 0.0
        terminated = (episodes["ending"] > 0) & ~again
        late = episodes["time"] > self._time_limit - 0.5 * CONTROL_PERIOD
        truncated = ((self._elapsed >= self._most_steps) | (late & ~terminated)) & ~again
        ended = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            for i in np.flatnonzero(ended).tolist():
                final = {"final_obs": self.envs[i].observation}
                infos = self._add_info(infos, {**final, "final_info": self.envs[i].result()[0]}, i)
                self._restart(i, None, {})
        else:
            self._over = ended
        infos |= self._infos(np.ones(self.num_envs, np.bool_))
        return self._observations(), rewards, terminated, truncated, infos

    def render(self) -> tuple[Any, ...]:
        """What every single environment draws."""
        return tuple(env.render() for env in self.envs)

    def close_extras(self, **_: Any) -> None:
        """Close the windows and end the threads."""
        for env in self.envs:
            env.close()
        if self._pool is not None:
            self._pool.shutdown()

    @property  # type: ignore[misc]  # Gymnasium assigns it
    def np_random(  # type: ignore[override]  # one for each episode, as in Gymnasium's own vector environments
        self,
    ) -> tuple[np.random.Generator, ...]:
        """The generators of the episodes."""
        return self.get_attr("np_random")

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]  # as `np_random`
        """Their seeds."""
        return self.get_attr("np_random_seed")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """What the method, or the attribute, of every single environment gives."""
        found = [getattr(env, name) for env in self.envs]
        return tuple(value(*args, **kwargs) if callable(value) else value for value in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of every single environment."""
        return tuple(getattr(env, name) for env in self.envs)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every single environment: a list or tuple of values, or one for all."""
        if not isinstance(values, list | tuple):
            values = [values] * self.num_envs
        for env, value in zip(self.envs, values, strict=True):
            setattr(env, name, value)

    # ------------------------------------------------------------------ one step

    def _masked(self, mask: np.ndarray | None) -> np.ndarray:
        """Rows to be reset."""
        if mask is None:
            return np.arange(self.num_envs)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise InvalidParameter(
                f"reset_mask must be a boolean array ({self.num_envs},), got {shown(mask)}"
            )
        if not mask.any():
            raise InvalidParameter("reset_mask must hold at least one True")
        return np.flatnonzero(mask)

    def _row_seeds(self, seed: Any) -> list[int | None]:
        """A seed for each row: given one by one, or counted up from one number."""
        if isinstance(seed, Sequence) or (isinstance(seed, np.ndarray) and seed.ndim == 1):
            if len(seed) == self.num_envs:
                return [require_seed(one) for one in seed]
        elif seed is None or isinstance(seed, int | np.integer):
            first = require_seed(seed)
            return [None if first is None else first + i for i in range(self.num_envs)]
        raise InvalidParameter(f"seed must be one number or {self.num_envs}, got {shown(seed)}")

    def _options_of_each(self, given: Sequence[Any]) -> list[dict[str, Any]]:
        """Options of each episode, as stable-baselines3 hands them over: one dictionary for each."""
        if len(given) != self.num_envs:
            raise InvalidParameter(f"options must be one for all or {self.num_envs}, got {len(given)}")
        options = [require_mapping("options", one) for one in given]
        return [self._row_options(one, np.array([i]))[0] for i, one in enumerate(options)]

    def _row_options(self, options: dict[str, Any], rows: np.ndarray) -> list[dict[str, Any]]:
        """Options of the reset of each row: "n" and "context" may be one for all, or one per episode."""
        lists = {
            key: value
            for key, value in options.items()
            if (key == "n" and np.ndim(value) == 1) or (key == "context" and isinstance(value, list | tuple))
        }
        for key, values in lists.items():
            if len(values) != self.num_envs:
                raise InvalidParameter(f"{key} must be one for all or {self.num_envs}, got {len(values)}")
        return [{**options, **{key: values[i] for key, values in lists.items()}} for i in rows]

    def _observations(self) -> dict[str, np.ndarray]:
        """What all agents see now."""
        if self.envs[0].terrain_info not in WHOLE_SOIL:
            return self._layout.split(self._memory.shown)
        return self._layout.split(self._memory.shown, [row for env in self.envs for row in env.soil_belief])

    def _restart(self, row: int, seed: int | None, options: dict[str, Any]) -> None:
        self.envs[row].reset(seed=seed, options=options)
        self._elapsed[row], self._over[row], self._begun[row] = 0, False, True
        self._has_context[row] = self.envs[row].context is not None
        self._context_infos = None

    def _advance(self, moving: np.ndarray) -> None:
        """One period of the episodes in the mask ``moving``."""
        for i in np.flatnonzero((self._memory.episodes["noise_row"] > LAST_ROW) & moving):
            self.envs[i].draw_noise()
        phases = _EVERYTHING
        if self.envs[0].extension is not None:
            phases = BELIEVE | REPORT
            for i in np.flatnonzero(moving):
                self.envs[i].drive_extended()
        asking = [i for i in np.flatnonzero(moving) if not self.envs[i].is_compiled]
        if not asking:
            self._run(np.where(moving, phases, 0))
            return
        self._memory.assumptions = None
        self._run(np.where(moving, phases & ~REPORT, 0))
        for i in asking:
            self.envs[i].ask_estimator()
        self._run(np.where(moving, REPORT, 0))

    def _run(self, phases: np.ndarray) -> None:
        """The compiled period, every thread its share."""
        if self._process != os.getpid():  # after a fork: threads do not come along
            self._pool, self._process = self._make_pool(), os.getpid()
        self._memory.episodes["phases"] = phases
        parts = [self._memory.part(share) for share in self._shares]
        jobs: list[Any] = [partial(self._period, *part) for part in parts[1:]]
        waiting = [] if self._pool is None else [self._pool.submit(job) for job in jobs]
        self._period(*parts[0])
        for future in waiting:
            future.result()

    def _infos(self, present: np.ndarray) -> dict[str, Any]:
        """Gymnasium's form: one array per key, and a mask of the episodes that have it."""
        episodes = self._memory.episodes
        report = np.where(present[:, None], episodes["report"], 0.0)
        columns: dict[str, Any] = {name: report[:, at].copy() for name, at in REPORTED.items()}
        ending = np.where(present, episodes["ending"], 0)
        failure = np.full(self.num_envs, None, dtype=object)
        failure[present] = _FAILURES[ending[present]]
        columns |= {
            "n": np.where(present, episodes["n"], 0.0),
            "path_length": np.where(present, episodes["ds"] * (episodes["path_end"] - 1), 0.0),
            "filter_repairs": columns["filter_repairs"].astype(np.int64),
            "success": ending == _GOAL,
            "failure": failure,
            "reward_terms": self._with_masks(
                {name: report[:, at].copy() for name, at in zip(TERMS, _TERM_COLUMNS, strict=True)}, present
            ),
        }
        found = self._with_masks(columns, present)
        return found | self._contexts(present)

    def _contexts(self, present: np.ndarray) -> dict[str, Any]:
        """What `_infos` holds of the contexts, in Gymnasium's form: made anew where an episode has begun."""
        if present.all() and self._context_infos is not None:
            return _copied(self._context_infos)
        found: dict[str, Any] = {}
        for i in np.flatnonzero(present & self._has_context).tolist():
            found = self._add_info(found, {"context": self.envs[i].context}, i)
        if present.all():
            self._context_infos = _copied(found)
        return found

    @staticmethod
    def _with_masks(columns: dict[str, Any], present: np.ndarray) -> dict[str, Any]:
        for name in list(columns):
            columns[f"_{name}"] = present.copy()
        return columns
