"""Results of the study of PPO's learning curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["ARMS", "Curve"]

#: Trained arms -> action interface. Their terrain information is in `agents.learning.policies.LEARNED`.
ARMS = {"ppo_tracker_aware": "tracker", "ppo_tracker_oblivious": "tracker", "ppo_direct_aware": "direct"}


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Learning curve of one policy on the tuning episodes, and when it outdid pure pursuit there."""

    arm: str
    seed: int
    steps: tuple[int, ...]  #: of the policy, at each drive of the tuning episodes
    wall_times: tuple[float, ...]  #: at the same [s]
    scores: tuple[float, ...]  #: mean of the tuning episodes [s]
    passed: int | None  #: index of the first drive below pure pursuit
    ahead: int | None  #: index of the drive from which on all are below it

    @property
    def action_interface(self) -> str:
        """Meaning of the policy's actions."""
        return ARMS[self.arm]

    @classmethod
    def of(cls, arm: str, seed: int, points: Sequence[Sequence[float]], reference: float) -> Curve:
        """From (steps, wall time [s], score [s]) and pure pursuit's score on the same episodes."""
        steps, times, scores = zip(*points, strict=True)
        below = np.array(scores) < reference
        behind = np.flatnonzero(~below)
        ahead = int(behind[-1]) + 1 if behind.size else 0
        return cls(
            arm=arm,
            seed=seed,
            steps=tuple(int(count) for count in steps),
            wall_times=times,
            scores=scores,
            passed=int(np.argmax(below)) if below.any() else None,
            ahead=ahead if ahead < len(scores) else None,
        )
