"""Information on n in one observation: what a policy without the terrain estimate can still see.

On soft soil the wheels slip, the motion is resisted and the tyres drift, each by an amount that depends on
n. A least-squares reading of n from one observation - speeds of rims and vehicle, steering, drive,
accelerations, errors from the path, their squares and products - shows how much of that a policy without
memory can use.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID, Draw, draw_episodes
from agents.controllers.arms import make_arm
from agents.driving.unwrapped import bekker_env
from agents.learning.action_interface import PlanInterface, mirrored

__all__ = ["one_sample_error"]

#: Penalty of the reading's coefficients, for columns of unit size.
_RIDGE = 1e-3
_SCALE_FLOOR = 1e-9


def one_sample_error(task: str, episodes: int) -> tuple[float, float]:
    """R.m.s. errors of n [-]: read from one observation, and of the prior's mean.

    Parameters
    ----------
    task
        Driven by its nominal arm.
    episodes
        For the fit (tuning episodes), and as many test episodes for the error.
    """
    fit = _looks(task, draw_episodes(task, episodes, 0, training=True))
    test = _looks(task, draw_episodes(task, episodes, 0))
    size = np.maximum(fit[0].std(axis=0), _SCALE_FLOOR)
    centre = fit[0].mean(axis=0)
    A, B = (_products((seen - centre) / size) for seen, _ in (fit, test))
    weights = np.linalg.solve(A.T @ A + _RIDGE * len(A) * np.eye(A.shape[1]), A.T @ fit[1])
    read = np.clip(B @ weights, fit[1].min(), fit[1].max())
    error = float(np.sqrt(np.mean((read - test[1]) ** 2)))
    return error, float(np.sqrt(np.mean((fit[1].mean() - test[1]) ** 2)))


def _looks(task: str, draws: list[Draw]) -> tuple[np.ndarray, np.ndarray]:
    """Observations (M, 14) at the policy's pace, and the n (M,) under the front wheels."""
    env = gym.make(ENV_ID, scenario=task)
    agent = make_arm("nominal", scenario=task).agent
    rows, truths = [], []
    for draw in draws:
        observation, info = env.reset(seed=draw.seed, options=draw.options)
        agent.reset(bekker_env(env).briefing)
        done, step = False, 0
        while not done:
            observation, _, terminated, truncated, info = env.step(agent.act(observation))
            done, step = terminated or truncated, step + 1
            if step % PlanInterface.hold == 0:
                seen = mirrored(observation)
                rows.append(np.concatenate([seen["imu"], seen["motion"], seen["path"][:4]]))
                truths.append(info["n_front"])
    env.close()
    return np.array(rows, dtype=np.float64), np.array(truths)


def _products(x: np.ndarray) -> np.ndarray:
    """1, the columns, their squares and products."""
    i, j = np.triu_indices(x.shape[1])
    return np.column_stack([np.ones(len(x)), x, x[:, i] * x[:, j]])
