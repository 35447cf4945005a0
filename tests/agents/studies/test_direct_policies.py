"""Policies that steer and drive themselves: arms of one recipe."""

from __future__ import annotations

import numpy as np
import pytest

from agents.benchmark.runner import draw_episodes
from agents.learning.action_interface import Direct, find_interface
from agents.learning.arguments import configuration_hash
from agents.learning.policies import DIRECT, learned_folder, load_policy, shipped_seeds
from agents.studies.direct_policies.study import (
    _ARMS,
    _VALIDATION_SEED,
    FORM,
    DirectPolicies,
    arguments,
    recipes,
    shipped_seed,
)
from offroad_env.errors import InvalidParameter


@pytest.mark.parametrize("task", sorted(recipes()))
def test_arms_differ_in_what_they_see_of_the_soil_and_in_nothing_else(task, tmp_path):
    each = {arm: arguments(task, arm, 3, tmp_path) for arm in _ARMS}
    blind = each["direct_oblivious"]
    for arm, args in each.items():
        differing = {name for name in vars(args) if getattr(args, name) != getattr(blind, name)}
        assert differing <= {"terrain_info", "emulated", "frames", "out"}, arm
        assert args.form == "natural"
        # Neither a planner nor a tracker inside.
        assert issubclass(find_interface(args.action_interface), Direct)
    assert len({configuration_hash(args) for args in each.values()}) == len(_ARMS)


def test_the_arm_off_policy_learns_the_same_from_the_same_rewards(tmp_path):
    sac, ppo = (arguments("speed", arm, 3, tmp_path) for arm in ("direct_sac", "direct_oracle"))
    differing = {name for name in vars(sac) if getattr(sac, name) != getattr(ppo, name)}
    assert differing == {"algorithm", "batch_size", "gradient_steps", "first_drive", "out"}
    assert sac.algorithm == "sac"


def test_the_refined_arm_goes_on_from_the_shipped_policy_that_observes_the_same(tmp_path):
    first, refined = (
        arguments("speed", arm, 3, tmp_path) for arm in ("direct_oracle", "direct_oracle_refined")
    )
    assert refined.start == learned_folder(
        "speed", "direct_oracle", shipped_seeds("speed", "direct_oracle")[0]
    )
    same = ("terrain_info", "action_interface", "hidden", "frames", "world", "gamma", "idle", "centre")
    assert [getattr(first, name) for name in same] == [getattr(refined, name) for name in same]
    assert refined.edge[0] > first.edge[1]  # failures are dearer from the start
    load_policy(refined.start)
    assert DIRECT["direct_oracle_refined"] == DIRECT["direct_oracle"]
    with pytest.raises(InvalidParameter, match="has a recipe for speed, not for brake"):
        arguments("brake", "direct_oracle_refined", 0, tmp_path)


def test_the_weights_of_the_recipe_reach_the_environment(tmp_path):
    weights = arguments("speed", "direct_belief", 0, tmp_path).world.env_options()["weights"]
    assert weights["time"] == recipes()["speed"]["weights"]["time"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tasks": ("ride",)}, "tasks must be of"),
        ({"arms": ("autopilot",)}, "arms must be of direct_oblivious"),
        ({"episodes": 1}, "episodes must be >= 2"),
    ],
)
def test_what_cannot_be_run_is_refused(change, words, tmp_path):
    with pytest.raises(InvalidParameter, match=words):
        DirectPolicies(out=tmp_path, **change).run()


def test_the_sentences_compare_policies_with_the_arms_on_the_same_episodes(tmp_path):
    rng = np.random.default_rng(0)
    course = rng.normal(50.0, 10.0, 60)
    arms = ("direct_oracle", "direct_memory", "direct_oblivious")
    study = DirectPolicies(out=tmp_path, arms=arms, seeds=2, episodes=60)
    lead = {
        "direct_oracle": -5.0,
        "direct_memory": -2.0,
        "direct_oblivious": 5.0,
        "nominal": 0.0,
        "oracle": -8.0,
    }
    done = {
        key: {
            "scores": (course + lead[key[1]] + rng.normal(0.0, 1.0, 60)).tolist(),
            "success": [True] * 60,
            "validation": {"scores": [40.0, 41.0], "success": [True, True]},
        }
        for key in study._stamps()
    }
    said = "\n".join(study._sentences(done))
    assert "direct_oracle beats nominal" in said
    assert "direct_oracle is beaten by oracle" in said
    assert "direct_oracle beats direct_oblivious" in said
    assert "direct_oracle beats direct_memory" in said
    assert "direct_memory beats direct_oblivious" in said
    assert "direct_oblivious is beaten by nominal" in said
    assert "direct_memory is beaten by direct_oracle" not in said  # each pair once
    assert "Time: 0.90 [" in said


def test_the_training_that_is_shipped_is_the_best_on_validation_soils_whatever_the_test_says(tmp_path):
    study = DirectPolicies(out=tmp_path, arms=("direct_oracle",), seeds=3, episodes=4)
    validation = {0: ([40.0] * 100, 4), 1: ([50.0] * 100, 1), 2: ([45.0] * 100, 2)}
    done = {}
    for key in study._stamps():
        _, arm, seed, *_ = key
        best_in_test = arm == "direct_oracle" and seed == 0
        done[key] = {
            "scores": [30.0 if best_in_test else 60.0] * 4,
            "success": [best_in_test, True, True, True],
        }
        if arm == "direct_oracle":
            scores, failures = validation[seed]
            done[key]["validation"] = {
                "scores": [*scores[failures:], *[120.0] * failures],
                "success": [i < 100 - failures for i in range(100)],
            }
    assert shipped_seed(done, "speed", "direct_oracle") == 2  # 1 and 2 fail little enough, 2 is faster
    assert "training 2 is shipped" in (said := study._shipped(done, "speed", "direct_oracle"))
    assert "1 of 4 test episodes fail (4.6 to 69.9 %), time: 1.00 [1.00, 1.00] x that of nominal" in said


def test_no_validation_episode_is_a_test_episode_or_one_of_the_checks():
    validation = draw_episodes("speed", 100, _VALIDATION_SEED, form=FORM, split="validation")
    checks = draw_episodes("speed", 60, 0, form=FORM, split="validation")
    test = draw_episodes("speed", 200, DirectPolicies.test_seed, form=FORM)
    assert not {draw.seed for draw in validation} & {draw.seed for draw in [*checks, *test]}
