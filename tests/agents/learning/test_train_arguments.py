"""What cannot be trained with is refused before training: by name, with what is allowed."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

import agents
from agents.commands import train as command
from agents.commands.cli import main
from agents.learning import policies
from agents.learning.arguments import TrainArgs, check_arguments
from agents.studies.direct_policies import study as direct
from offroad_env.errors import InvalidParameter

MANY = tuple([8] * 17)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"batch_size": 1}, "batch_size must be >= 2 with ppo, got 1"),
        ({"algorithm": "recurrent_ppo", "batch_size": 1}, "batch_size must be >= 2 with recurrent_ppo"),
        ({"n_envs": 1, "n_steps": 1}, r"n_envs x n_steps must be >= 2 with ppo, got 1 x 1"),
        (
            {"algorithm": "recurrent_ppo", "n_envs": 3, "n_steps": 3, "batch_size": 4},
            "batch_size must not leave one of the n_envs x n_steps = 9 samples alone, got 4",
        ),
        ({"idle": 0.0}, "idle must be finite and > 0, got 0 - without it"),
        ({"time_budget": 0.0}, "time_budget must be finite and > 0, got 0"),
        ({"clip_reward": 0.0}, "clip_reward must be finite and > 0, got 0"),
        ({"learning_rate": float("inf")}, "learning_rate must be finite and > 0, got inf"),
        ({"log_std": float("nan")}, r"log_std must be in \[-20, 2\], got nan - a natural logarithm"),
        ({"log_std": 30.0}, r"log_std must be in \[-20, 2\], got 30"),
        ({"seed": 5_000_000_000}, r"seed must be in \[0, 4294967295\], got 5000000000"),
        ({"seed": -1}, "seed must be in"),
        ({"algorithm": "sac", "first_drive": 0.3}, "first_drive needs algorithm=.* got .sac."),
        (
            {"algorithm": "sac", "held_noise": 0.5, "last_log_std": -5.0},
            "last_log_std needs algorithm=.* got .sac.",
        ),
        ({"algorithm": "sac", "frames": 3}, "frames must be 1 with sac, got 3"),
        ({"algorithm": "sac", "buffer_size": 16}, "buffer_size must be >= n_envs = 32, got 16"),
        ({"buffer_size": 0}, "buffer_size must be >= 1, got 0"),
        ({"critic_steps": -5}, "critic_steps must be >= 0, got -5"),
        ({"gradient_steps": 0}, "gradient_steps must be >= 1, got 0"),
        ({"noise_steps": 0}, "noise_steps must be >= 1, got 0"),
        ({"first_drive": 2.0}, r"first_drive must be in \[-1, 1\], got 2"),
        ({"centre": float("nan")}, "centre must be finite and >= 0, got nan"),
        ({"pace": -0.1}, "pace must be finite and >= 0, got -0.1"),
        ({"edge": (0.1, float("nan"))}, "edge must be finite and >= 0, got nan"),
        ({"gamma": 96.0}, r"gamma must be in \(0, 1\], got 96 - in percent"),
        ({"held_noise": 1.5}, r"held_noise must be in \[0, 1\], got 1.5"),
        ({"last_log_std": -5.0}, "last_log_std needs held_noise < 1"),
        ({"last_log_std": -1.0, "held_noise": 0.5}, "last_log_std must be in .* got -1"),
        ({"most_failures": 5.0}, r"most_failures must be in \[0, 1\], got 5"),
        ({"hidden": ()}, "hidden must hold 1 to 16 sizes"),
        ({"hidden": (5000,)}, "hidden must hold 1 to 16 sizes .* got '5000'"),
        ({"hidden": MANY}, "hidden must hold 1 to 16 sizes"),
        ({"frames": 1001}, r"frames must be in \[1, 1000\], got 1001"),
        (
            {"algorithm": "dqn", "batch_size": 1},
            "algorithm must be one of ppo, recurrent_ppo, sac, got 'dqn'",
        ),
        ({"objective": "points", "frames": 0}, "objective must be one of reward, score, got 'points'"),
        ({"objective": ""}, "objective must be one of reward, score, got ''"),
        ({"action_interface": "wheel", "frames": 0}, "action_interface must be one of plan, .* got 'wheel'"),
        ({"form": "foo", "frames": 0}, "form must be one of matched, .* got 'foo'"),
        ({"threads": 0}, "threads must be >= 1, got 0 - without it there is one"),
        ({"first_charge": 0.5}, "first_charge must be at most charge = 0.333333, got 0.5"),
        ({"form": "foo", "check_episodes": 0}, "form must be one of matched, .* got 'foo'"),
        ({"scenario": "patches", "form": "natural"}, "natural forms have track, .* got patches"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, dict) else "",
)
def test_what_cannot_be_trained_with_is_refused_before_training(options, sentence, monkeypatch, tmp_path):
    monkeypatch.setattr(command, "train", lambda *_, **__: pytest.fail("it was trained with"))
    with pytest.raises(InvalidParameter, match=sentence):
        command.Train(**options, out=tmp_path).run()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"gamma": 0.0}, "gamma must be in (0, 1], got 0"),
        ({"gae_lambda": float("nan")}, "gae_lambda must be in (0, 1], got nan"),
        ({"held_noise": -0.1}, "held_noise must be in [0, 1], got -0.1"),
        ({"centre": float("inf")}, "centre must be finite and >= 0, got inf"),
        ({"seed": -1}, "seed must be in [0, 4294967295], got -1"),
        (
            {"last_log_std": float("nan"), "held_noise": 0.5},
            "last_log_std must be in [-20, log_std = -3.2], got nan",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, dict) else "",
)
def test_what_may_be_meant_is_asked_only_where_it_fits(options, sentence):
    with pytest.raises(InvalidParameter) as refused:
        check_arguments(TrainArgs(**options))
    assert str(refused.value) == sentence


def test_the_command_says_so_in_one_sentence(capsys, tmp_path):
    with pytest.raises(SystemExit) as leaving:
        main(["train", "--batch-size", "1", "--out", str(tmp_path)])
    assert leaving.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("offroad: batch_size must be >= 2")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"algorithm": "sac", "batch_size": 1, "n_envs": 1, "n_steps": 1},
        {"algorithm": "recurrent_ppo", "held_noise": 0.5, "last_log_std": -5.0, "first_drive": 0.3},
        {"check_episodes": 0, "eval_episodes": 0, "seed": 2**32 - 1, "idle": 2.0, "form": "natural_gnss"},
        {"n_envs": 3, "n_steps": 3, "batch_size": 4},
        {"first_charge": 1.0 / 3.0, "threads": 1, "objective": "score", "action_interface": "pedals"},
    ],
    ids=lambda options: " ".join(options),
)
def test_what_can_be_trained_with_passes(options):
    check_arguments(TrainArgs(**options))


def test_what_policies_were_trained_with_passes(tmp_path):
    for file in sorted((Path(agents.__file__).parent / "weights").rglob(policies.KIND)):
        given = json.loads(file.read_text(encoding="utf-8"))
        names = {entry.name for entry in fields(TrainArgs)} - {"start", "world"}
        known = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items() if key in names}
        check_arguments(TrainArgs(**known))
    for task in direct.recipes():
        for arm in (*direct._ARMS, direct._SAC):
            check_arguments(direct.arguments(task, arm, 0, tmp_path))


def test_the_largest_policy_that_passes_is_one_that_is_read():
    largest = TrainArgs(
        frames=policies.MOST_FRAMES, hidden=(policies.WIDEST,) * policies.DEEPEST, n_envs=2, n_steps=2
    )
    check_arguments(largest)
    for options in (
        {"frames": policies.MOST_FRAMES + 1},
        {"hidden": (policies.WIDEST + 1,)},
        {"hidden": (1,) * (policies.DEEPEST + 1)},
    ):
        with pytest.raises(InvalidParameter):
            check_arguments(replace(largest, **options))


def test_the_objectives_are_those_that_environments_take():
    environments = pytest.importorskip("agents.learning.sb3_vec_env", exc_type=ImportError)
    for objective in environments.OBJECTIVES:
        check_arguments(TrainArgs(objective=objective))
