"""Policies that steer and drive themselves: arms of one recipe."""

from __future__ import annotations

import numpy as np
import pytest

from agents.learning.arguments import configuration_hash
from agents.learning.policies import DIRECT
from agents.studies.direct_policies.study import DirectPolicies, arguments, recipes
from offroad_env.errors import InvalidParameter


@pytest.mark.parametrize("task", sorted(recipes()))
def test_arms_differ_in_what_they_see_of_the_soil_and_in_nothing_else(task, tmp_path):
    each = {arm: arguments(task, arm, 3, tmp_path) for arm in DIRECT}
    blind = each["direct_oblivious"]
    for arm, args in each.items():
        differing = {name for name in vars(args) if getattr(args, name) != getattr(blind, name)}
        assert differing <= {"terrain_info", "emulated", "frames", "out"}, arm
        assert args.form == "natural"
    assert len({configuration_hash(args) for args in each.values()}) == len(DIRECT)


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
    study = DirectPolicies(out=tmp_path, arms=("direct_oblivious", "direct_oracle"), seeds=2, episodes=60)
    lead = {"direct_oracle": -5.0, "direct_oblivious": 5.0, "nominal": 0.0, "oracle": -8.0}
    done = {
        key: {"scores": (course + lead[key[1]] + rng.normal(0.0, 1.0, 60)).tolist(), "success": [True] * 60}
        for key in study._stamps()
    }
    said = "\n".join(study._sentences(done))
    assert "direct_oracle beats nominal" in said
    assert "direct_oracle is beaten by oracle" in said
    assert "direct_oracle beats direct_oblivious" in said
    assert "direct_oblivious is beaten by nominal" in said
    assert "Time: 0.90 [" in said
