"""Agents of the user's own: what they are made from, and that older episodes do not count after a change."""

from __future__ import annotations

import os
import zlib

import numpy as np
import pytest

from agents.benchmark.study import EPISODES, BenchmarkArgs, run_study
from agents.driving.own_agents import made_from, own_content

MODULE = """
import numpy as np
from {name}_gains import GAIN

class Pusher:
    def __init__(self):
        self.drive = GAIN * float(np.load("weights.npy")[0])
        with open("notes.txt", "w") as file:
            file.write("made")

    def reset(self, briefing): ...

    def act(self, observation):
        return np.array([0.0, self.drive])
"""


@pytest.fixture
def pusher(request, tmp_path, monkeypatch):
    """Name of an agent that reads weights and imports a module from its folder."""
    name = f"pusher_{zlib.crc32(request.node.name.encode()):08x}"  # modules of one name would be one module
    (tmp_path / f"{name}.py").write_text(MODULE.format(name=name), encoding="utf-8")
    (tmp_path / f"{name}_gains.py").write_text("GAIN = 1.0\n", encoding="utf-8")
    np.save(tmp_path / "weights.npy", np.array([0.3]))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(os.fspath(tmp_path))
    return f"{name}:Pusher"


def test_an_agent_is_made_from_its_modules_and_from_what_it_reads(pusher):
    module = pusher.partition(":")[0]
    assert [path.name for path in made_from(pusher)] == [f"{module}.py", f"{module}_gains.py", "weights.npy"]


@pytest.mark.parametrize("changed", ["weights", "gains"])
def test_a_change_of_any_of_it_makes_another_agent(pusher, changed, tmp_path):
    before = own_content(pusher)
    assert own_content(pusher) == before
    if changed == "weights":
        np.save("weights.npy", np.array([0.31]))
    else:
        (tmp_path / f"{pusher.partition(':')[0]}_gains.py").write_text("GAIN = 1.01\n", encoding="utf-8")
    assert own_content(pusher) != before


def test_an_agent_with_new_weights_is_driven_again(pusher, tmp_path):
    args = BenchmarkArgs(
        tasks=("brake",), agents=(pusher, "oracle"), forms=("matched",), episodes=2, n_jobs=1
    )

    def lines():
        return len((tmp_path / EPISODES).read_text(encoding="utf-8").splitlines())

    first = run_study(args, tmp_path)["brake", "matched"]
    assert lines() == 4
    assert run_study(args, tmp_path)["brake", "matched"] == first
    assert lines() == 4
    np.save("weights.npy", np.array([-1.0]))
    again = run_study(args, tmp_path)["brake", "matched"]
    assert lines() == 6
    assert again.arm("oracle") == first.arm("oracle")
    assert again.arm(pusher).episodes != first.arm(pusher).episodes
