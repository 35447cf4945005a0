"""A person at the keyboard: keys become smooth commands, and the drive ends when the driver ends it."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from agents.commands.cli import main
from agents.controllers.keyboard import KeyboardAgent, Keys
from agents.driving.episode import Drive
from offroad_env import ENV_ID


def driven(keys: list[Keys]) -> np.ndarray:
    left = iter(keys)
    agent = KeyboardAgent(lambda: next(left))
    agent.reset(None)
    return np.array([agent.act({}) for _ in keys])


def test_a_key_turns_the_wheel_at_the_pace_of_a_hand_and_it_goes_back_when_released():
    steer = driven([Keys(left=True)] * 60 + [Keys()] * 60)[:, 0]
    assert steer[0] == pytest.approx(0.025)
    assert steer[59] == 1.0
    assert np.abs(np.diff(steer)).max() < 0.026
    assert steer[-1] == 0.0
    assert driven([Keys(right=True)] * 60)[-1, 0] == -1.0
    assert driven([Keys(left=True, right=True)] * 60)[-1, 0] == 0.0


def test_the_brake_goes_before_the_drive():
    assert driven([Keys(drive=True)] * 40)[-1, 1] == 1.0
    assert driven([Keys(drive=True, brake=True)] * 60)[-1, 1] == -1.0


def test_a_drive_ends_when_the_driver_ends_it():
    env = gym.make(ENV_ID, terrain_info="estimate")
    keys = iter([Keys(drive=True)] * 20 + [Keys(stop=True)])
    drive = Drive(env, KeyboardAgent(lambda: next(keys)), seed=1)
    steps = sum(1 for _ in drive)
    env.close()
    assert steps == 22  # the start, 20 steps, and that of the last key
    assert drive.ending == "stopped by the driver"


def test_the_window_of_the_keyboard_shows_the_estimate(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.raises(SystemExit) as ended:
        main(["drive", "--agent", "keyboard", "--duration", "0.2", "--out", str(tmp_path)])
    assert ended.value.code == 0
    assert "estimate of n" in capsys.readouterr().out


def test_the_keyboard_needs_the_window_for_itself(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["drive", "--agent", "keyboard", "--video", str(tmp_path / "a.gif")])
    assert "a window shows itself" in capsys.readouterr().err
