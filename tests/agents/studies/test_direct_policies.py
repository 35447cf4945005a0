"""Policies that steer and drive themselves: arms of one recipe."""

from __future__ import annotations

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
