"""Learning curves of policies that start behind pure pursuit."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.learning.action_interface import ZeroAction
from agents.learning.policies import load_policy
from agents.learning.train import TrainArgs, configuration_hash, failure_charge, train
from agents.studies.ppo_learning_curve.figure import learning_curve_figure
from agents.studies.ppo_learning_curve.study import ARMS, Curve, PPOLearningCurve, arguments
from offroad_env.errors import InvalidParameter


def curve(*scores):
    return Curve.of("ppo_tracker_aware", 0, [(1000 * i, 10.0 * i, s) for i, s in enumerate(scores)], 75.0)


def test_a_policy_has_passed_for_good_where_it_never_falls_back():
    one = curve(85.0, 70.0, 80.0, 60.0, 50.0)
    assert (one.passed, one.ahead) == (1, 3)
    assert (curve(85.0, 70.0, 80.0).passed, curve(85.0, 70.0, 80.0).ahead) == (1, None)
    assert (curve(85.0, 80.0).passed, curve(85.0, 80.0).ahead) == (None, None)


def test_the_figure_has_a_line_for_each_training_and_a_ring_where_it_passes():
    figure = learning_curve_figure([curve(85.0, 70.0), curve(90.0, 80.0)], 75.0)
    lines = figure.axes[0].get_lines()
    assert [len(line.get_xdata()) for line in lines] == [2, 1, 2, 2]  # curve, ring, curve, pure pursuit


def test_arms_of_an_interface_differ_in_their_terrain_information_and_in_nothing_else(tmp_path):
    aware, oblivious = (arguments(arm, 3, tmp_path) for arm in ("ppo_tracker_aware", "ppo_tracker_oblivious"))
    differing = {name for name in vars(aware) if getattr(aware, name) != getattr(oblivious, name)}
    assert differing == {"terrain_info", "out"}
    assert len({configuration_hash(arguments(arm, 0, tmp_path)) for arm in ARMS}) == len(ARMS)


def test_an_unknown_arm_is_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="arms must be of ppo_tracker_aware"):
        PPOLearningCurve(arms=("autopilot",), out=tmp_path).run()


def test_the_charge_grows_by_equal_factors_from_the_first_to_the_last():
    args = TrainArgs(charge=0.8, first_charge=0.05, total_steps=100)
    assert [failure_charge(args, steps) for steps in (0, 50, 100, 120)] == pytest.approx(
        [0.05, 0.2, 0.8, 0.8]
    )
    assert failure_charge(TrainArgs(charge=0.3), 7) == 0.3


@pytest.mark.check
def test_five_thousand_words_to_a_tracker_keep_more_of_the_episodes_in_the_corridor(tmp_path):
    pytest.importorskip("stable_baselines3")
    args = TrainArgs(
        action_interface="tracker",
        terrain_info="none",
        seed=1,
        total_steps=5_120,
        threads=1,
        n_steps=16,
        charge=0.8,
        pace=0.4,
        learning_rate=5e-4,
        gamma=0.98,
        check_episodes=0,
        checkpoint_steps=0,
        eval_episodes=0,
        out=tmp_path,
    )
    train(args)
    env = gym.make(ENV_ID, scenario="speed")
    draws = draw_episodes("speed", 8, 7)
    untrained, trained = (
        np.mean([run_episode(env, agent, draw.seed, n=draw.n).score for draw in draws])
        for agent in (ZeroAction("tracker"), load_policy(tmp_path))
    )
    assert trained < untrained - 10.0  # 94 s, and 67 to 69 s with the training seeds 1 to 3
