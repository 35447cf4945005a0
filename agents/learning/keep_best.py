"""Callbacks of a training run: noise that is drawn anew, and the best policy by episodes apart.

The best policy is that of episodes that are in neither training nor test. A policy gets better and worse
again while it learns: between two checks a hundred updates apart the share of failures changes by a factor
of five. Needs the extra ``rl``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from agents.benchmark.runner import draw_episodes
from agents.learning.checks import merit, scores_together
from agents.learning.policies import scaled, scaling_of
from offroad_env.errors import InvalidParameter

__all__ = ["FEWEST_FAILURES", "FreshNoise", "KeepBest"]

#: Share of failures below which the faster policy is the better one [-].
FEWEST_FAILURES = 0.02


class FreshNoise(BaseCallback):
    """Draw the noise of a state-dependent exploration anew at every decision, from a share of them on.

    Noise that is held finds bends and stops, but under it few episodes arrive. Drawn anew it averages out.

    Parameters
    ----------
    after
        Share of the decisions in which it is held as the model's ``sde_sample_freq`` has it.

    Raises
    ------
    InvalidParameter
        If ``after`` is no share.
    """

    def __init__(self, after: float) -> None:
        super().__init__()
        if not 0.0 <= after <= 1.0:
            raise InvalidParameter(f"after must be in [0, 1], got {after:g}")
        self._after, self._begin = after, 0.0

    def _on_training_start(self) -> None:
        self._begin = self._after * self.locals["total_timesteps"]

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._begin:
            self.model.sde_sample_freq = 1


class KeepBest(BaseCallback):
    """Drive validation episodes without noise every so often, and save the policy that does best in them.

    Parameters
    ----------
    scaler
        Around the environments of the training: its scaling is saved with the policy.
    task
        Name of the task.
    out
        Files: ``out.zip`` is the policy, ``out.pkl`` the scaling.
    every
        Decisions between two checks.
    episodes
        Of a check, matched form.
    env
        Further arguments of the environment.
    """

    def __init__(
        self, scaler: VecNormalize, task: str, out: str, *, every: int, episodes: int, env: dict[str, Any]
    ) -> None:
        super().__init__()
        self._scaler, self._task, self._out, self._every, self._env = scaler, task, Path(out), every, env
        self._draws = draw_episodes(task, episodes, 0, split="validation")
        self._last = 0
        self.best: tuple[float, float] | None = None  #: `merit` of what is saved

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self._last >= self._every:
            self._check()

    def _on_training_end(self) -> None:
        self._check()

    def _check(self) -> None:
        self._last = self.num_timesteps
        scaling = scaling_of(self._scaler)

        def predict(seen: dict[str, np.ndarray], _: np.ndarray) -> np.ndarray:
            return self.model.predict(scaled(seen, scaling), deterministic=True)[0]

        scores, success = scores_together(
            predict, self._task, self._draws, form="matched", interface="direct", **self._env
        )
        found = merit(scores, success, FEWEST_FAILURES)
        self.logger.record("validation/failures", 1.0 - np.mean(success))
        self.logger.record("validation/score", found[1])
        if self.best is None or found < self.best:
            self.best = found
            self.model.save(self._out)
            self._scaler.save(f"{self._out}.pkl")
