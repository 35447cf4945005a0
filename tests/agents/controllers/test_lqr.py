"""LQR steering: the gains are the optimal ones, the soil schedules them, and it holds the path."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.controllers.lqr import LqrWeights, path_gains
from agents.driving.episode import find_agent
from offroad_env.errors import InvalidParameter


@pytest.mark.parametrize("b", [0.1, 0.37, 1.0])
def test_the_gains_solve_the_riccati_equation(b):
    weights = LqrWeights(cross_track=0.3, course=0.15, steer=0.08)
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [b]])
    Q = np.diag([weights.cross_track**-2, weights.course**-2])
    R = np.array([[weights.steer**-2]])
    P = solve_continuous_are(A, B, Q, R)
    expected = np.linalg.solve(R, B.T @ P)[0]
    assert path_gains(b, weights) == pytest.approx(tuple(expected), rel=1e-8)


@pytest.mark.check
def test_with_the_same_belief_and_speed_plan_it_stays_nearer_to_the_path_than_pure_pursuit():
    errors = {}
    for name in ("lqr_oracle", "oracle"):
        agent, told = find_agent(name, "speed", None)
        env = gym.make(ENV_ID, scenario="speed", terrain_info=told)
        draws = draw_episodes("speed", 4, 0)
        errors[name] = np.mean([run_episode(env, agent, d.seed, n=d.n).cross_track_rms for d in draws])
    assert errors["lqr_oracle"] < 0.9 * errors["oracle"]


def test_it_steers_only():
    with pytest.raises(InvalidParameter, match="lqr_aware steers only"):
        find_agent("lqr_aware", "brake", None)
