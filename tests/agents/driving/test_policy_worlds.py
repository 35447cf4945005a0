"""``offroad drive --policy``: a policy drives in the world of its training, and its folder runs no code."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

import agents
from agents.commands.cli import main
from agents.commands.drive import Drive
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.errors import DataError, InvalidParameter, OffroadError

WEIGHTS = Path(agents.__file__).parent / "weights" / "speed"


@pytest.fixture
def policy(tmp_path, monkeypatch):
    """Changes of a shipped policy's settings -> its folder."""
    monkeypatch.setenv("OFFROAD_BEKKER_REGISTERED", "{}")
    monkeypatch.chdir(tmp_path)

    def changed(name: str = "ppo_aware", **settings: Any) -> Path:
        folder = tmp_path / "policy"
        shutil.copytree(WEIGHTS / name / "0", folder)
        file = folder / "policy.json"
        file.write_text(json.dumps({**json.loads(file.read_text()), **settings}))
        return folder

    yield changed
    for name in ("mine", "own"):
        SCENARIOS.pop(name, None)


def _driven(folder: Path, **options: Any) -> Drive:
    command = Drive(policy=folder, duration=0.1, out=folder.parent, **options)
    command.run()
    return command


def test_a_policy_from_somebody_else_names_no_function(policy, tmp_path):
    (tmp_path / "evil.py").write_text("open('ran', 'w').close()\ndef f(*given): ...\n")
    folder = policy(scenario="{course: 'evil:f'}")
    with pytest.raises(InvalidParameter, match="not built in, nor described in the folder - give --scenario"):
        _driven(folder)
    (folder / "policy.json").write_text(
        json.dumps({**json.loads((folder / "policy.json").read_text()), "course": {"course": "evil:f"}})
    )
    with pytest.raises(InvalidParameter, match="not built in"):
        _driven(folder)
    assert not (tmp_path / "ran").exists()


def test_the_course_of_its_training_is_the_one_in_its_folder(policy):
    course = {"base": "speed", "name": "mine", "corridor": 2.5}
    assert _driven(policy(scenario="gone.yaml", course=course)).scenario == "mine"
    assert SCENARIOS["mine"].corridor == 2.5


def test_a_policy_drives_in_the_form_of_its_training(policy, capsys):
    _driven(policy("direct_oracle_refined"))
    printed = capsys.readouterr().out
    assert "form natural" in printed
    assert "drawn: vehicle.m" in printed


def test_an_unknown_form_is_refused(policy):
    with pytest.raises(DataError, match="form must be one of matched"):
        _driven(policy(form="lunar"))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"form": "natural", "world": {"randomise": "x"}}, "randomise must be a mapping"),
        ({"form": "natural", "scenario": "patches"}, "natural forms have track, .* got patches"),
        ({"form": "natural", "world": {"vehicle": 3}}, "vehicle"),
        ({"world": {"randomise": "x"}}, "randomise"),
        ({"world": {"tyre": 3}}, "tyre"),
    ],
)
def test_a_world_of_a_policy_that_cannot_be_is_refused_in_a_sentence(policy, settings, words):
    with pytest.raises(OffroadError, match=words):
        _driven(policy(**settings))


@pytest.mark.parametrize(
    ("name", "given", "allowed"),
    [("ppo_aware", "belief", "estimate or truth"), ("direct_oracle_refined", "estimate", "belief or limits")],
)
def test_other_terrain_information_is_refused_in_a_sentence(policy, name, given, allowed):
    with pytest.raises(InvalidParameter, match=f"terrain_info must be {allowed}, got {given}"):
        _driven(policy(name), terrain_info=given)


def test_the_truth_stands_for_its_estimate(policy):
    _driven(policy(), terrain_info="truth")


def test_an_agent_beside_a_policy_and_a_picture_of_another_kind_are_refused(policy, tmp_path):
    with pytest.raises(InvalidParameter, match="--policy or --agent, not both"):
        _driven(policy(), agent="stanley")
    with pytest.raises(InvalidParameter, match=r"picture must end in \.png"):
        Drive(picture=tmp_path / "p.jpg").run()


def test_a_function_that_draws_courses_may_lie_in_the_working_directory(
    policy, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    (tmp_path / "my_lane.py").write_text(
        "from offroad_env.environment.scenarios import SCENARIOS\n"
        "def draw(*given):\n    return SCENARIOS['brake'].draw(*given)\n"
    )
    with pytest.raises(SystemExit) as leaving:
        main(["drive", "--scenario", "{course: 'my_lane:draw'}", "--duration", "0.1", "--out", str(tmp_path)])
    assert leaving.value.code in (0, None)
