"""The example of a laboratory of one's own runs to its end: it learns, films, compares, logs, diagnoses."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from helpers import REPOSITORY

EXAMPLE = REPOSITORY / "examples" / "own_laboratory.py"


@pytest.mark.check
def test_the_example_runs_from_an_empty_folder(tmp_path):
    pytest.importorskip("moviepy")
    command = [sys.executable, str(EXAMPLE), "512", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "drawn: {'soil.phi': 0.4" in done.stdout or "drawn: {'soil.phi': 0.5" in done.stdout
    for place in ("video", "compared/benchmark.html", "run.csv", "out/diagnosis.html"):
        assert (tmp_path / place).exists(), place
    assert "cruise:Cruise" in done.stdout


@pytest.mark.check
def test_the_example_of_learning_runs_and_leaves_a_policy(tmp_path):
    pytest.importorskip("stable_baselines3")
    command = [sys.executable, str(EXAMPLE.with_name("train_ppo.py")), "0", "4096"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(EXAMPLE.with_name("train_ppo.py").read_text(encoding="utf-8").splitlines()) < 30
    for name in ("ppo_speed_0.zip", "ppo_speed_0.pkl"):
        assert (tmp_path / name).exists(), name
    # What was saved drives as an agent.
    command = [sys.executable, "-m", "agents.commands.cli", "compare", "ppo_agent:Trained"]
    command += ["--terrain-info", "truth", "--against", "pure_pursuit", "--episodes", "2", "--jobs", "1"]
    paths = os.pathsep.join([str(EXAMPLE.parent), str(REPOSITORY)])
    env = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 0, done.stderr
    assert "ppo_agent:Trained" in done.stdout
