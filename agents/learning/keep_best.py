"""The best policy of a training run, by episodes that are in neither training nor test.

A policy gets better and worse again while it learns: between two checks a hundred updates apart the share of
failures changes by a factor of five. The mean of its weights over the last updates changes less (B. T. Polyak
and A. B. Juditsky, SIAM J. Control Optim. 30 (1992) 838). Needs the extra ``rl``.
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

__all__ = ["FEWEST_FAILURES", "KeepBest"]

#: Share of failures below which the faster policy is the better one [-].
FEWEST_FAILURES = 0.02


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
    average
        Share of the mean weights that stays at every update; 0: the last ones are driven and kept.
    """

    def __init__(
        self,
        scaler: VecNormalize,
        task: str,
        out: str,
        *,
        every: int,
        episodes: int,
        env: dict[str, Any],
        average: float = 0.0,
    ) -> None:
        super().__init__()
        if not 0.0 <= average < 1.0:
            raise InvalidParameter(f"average must be in [0, 1), got {average:g}")
        self._average, self._mean = average, dict[str, Any]()
        self._scaler, self._task, self._out, self._every, self._env = scaler, task, Path(out), every, env
        self._draws = draw_episodes(task, episodes, 0, split="validation")
        self._last = 0
        self.best: tuple[float, float] | None = None  #: `merit` of what is saved

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self._learn()
        if self.num_timesteps - self._last >= self._every:
            self._check()

    def _on_training_end(self) -> None:
        self._learn()
        self._check()

    def _learn(self) -> None:
        """Take the weights of the last update into their mean."""
        weights = self.model.policy.state_dict()
        for name, last in weights.items():
            before = self._mean.get(name, last)
            self._mean[name] = (self._average * before + (1.0 - self._average) * last).clone()

    def _check(self) -> None:
        """Drive by the mean weights, and keep them if nothing was better; the training goes on as it was."""
        self._last = self.num_timesteps
        own = {name: value.clone() for name, value in self.model.policy.state_dict().items()}
        self.model.policy.load_state_dict(self._mean)
        try:
            self._drive()
        finally:
            self.model.policy.load_state_dict(own)

    def _drive(self) -> None:
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
