"""Agents of the user's own: what they are made from, and that older episodes do not count after a change."""

from __future__ import annotations

import importlib
import os
import zlib

import numpy as np
import pytest

from agents.benchmark.study import EPISODES, BenchmarkArgs, run_study
from agents.driving.own_agents import course_content, made_from, own_content
from offroad_env.errors import InvalidParameter

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


READER = """
from pathlib import Path
import numpy as np

GAIN = float(Path("gain.txt").read_text())

class Pusher:
    def reset(self, briefing): ...

    def act(self, observation):
        return np.array([0.0, GAIN])
"""


def test_what_a_module_reads_at_its_first_import_counts_the_second_time_too(tmp_path, monkeypatch):
    (tmp_path / "reader_of_gains.py").write_text(READER, encoding="utf-8")
    (tmp_path / "gain.txt").write_text("0.3")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(os.fspath(tmp_path))
    first, again = (own_content("reader_of_gains:Pusher") for _ in range(2))
    assert again == first
    (tmp_path / "gain.txt").write_text("0.4")
    assert own_content("reader_of_gains:Pusher") != first


TWO = """
from pathlib import Path
from two_agents_shared import SIZE

GAIN = float(Path("gain.txt").read_text())

class A:
    def __init__(self):
        Path("of_a.txt").read_text()

    def reset(self, briefing): ...

    def act(self, observation): ...

class B(A):
    def __init__(self): ...
"""


def user_modules(folder, monkeypatch, sources):
    """Write modules, file -> source, into the working directory."""
    for name, source in sources.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(source, encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(os.fspath(folder))


def test_two_classes_of_a_module_are_both_made_from_what_it_reads(tmp_path, monkeypatch):
    user_modules(tmp_path, monkeypatch, {"two_agents.py": TWO, "two_agents_shared.py": "SIZE = 1\n"})
    for name in ("gain.txt", "of_a.txt"):
        (tmp_path / name).write_text("0.3")
    shared = ["two_agents.py", "two_agents_shared.py"]
    assert [path.name for path in made_from("two_agents:A")] == ["gain.txt", "of_a.txt", *shared]
    assert [path.name for path in made_from("two_agents:B")] == ["gain.txt", *shared]


def test_what_else_is_loaded_makes_no_other_agent(tmp_path, monkeypatch):
    plain = "class A:\n    def reset(self, b): ...\n    def act(self, o): ...\n"
    user_modules(tmp_path, monkeypatch, {"lonely_agent.py": plain, "lonely_neighbour.py": plain})
    importlib.import_module("lonely_neighbour")
    assert [path.name for path in made_from("lonely_agent:A")] == ["lonely_agent.py"]


def test_a_module_that_is_imported_by_a_computed_name_counts(tmp_path, monkeypatch):
    source = "import importlib\nimportlib.import_module('computed_' + 'gains')\n"
    plain = "class A:\n    def reset(self, b): ...\n    def act(self, o): ...\n"
    user_modules(
        tmp_path, monkeypatch, {"computed_agent.py": source + plain, "computed_gains.py": "GAIN = 1\n"}
    )
    for _ in range(2):
        assert [p.name for p in made_from("computed_agent:A")] == ["computed_agent.py", "computed_gains.py"]


COURSE = """
from offroad_env.environment.scenarios import SCENARIOS

def draw(*given):
    import shapes_of_lanes
    return SCENARIOS['brake'].draw(*given)
"""


def assert_each_counts(folder, course, files):
    """A course is another one after an edit of any of these files, and the same once it is undone."""
    before = course_content(course)
    for file in files:
        former = (folder / file).read_text()
        (folder / file).write_text(f"{former}# edited\n")
        assert course_content(course) != before, file
        (folder / file).write_text(former)
    assert course_content(course) == before


def test_a_course_is_known_by_what_it_imports_not_by_what_is_loaded(tmp_path, monkeypatch):
    user_modules(
        tmp_path,
        monkeypatch,
        {
            "drawer_of_courses.py": COURSE,
            "shapes_of_lanes.py": "from lanes_kit import bends\n",
            "lanes_kit/__init__.py": "",
            "lanes_kit/bends.py": "from . import radii\nfrom .radii import RADIUS\nimport lanes_kit.bends\n",
            "lanes_kit/radii.py": "RADIUS = 5.0\n",
            "lanes_kit/unused.py": "",
            "agent_beside_courses.py": "GAIN = 1.0\n",
        },
    )
    importlib.import_module("drawer_of_courses")
    before = course_content("drawer_of_courses:draw")
    for module in ("agent_beside_courses", "shapes_of_lanes", "lanes_kit.unused"):
        importlib.import_module(module)
        assert course_content("drawer_of_courses:draw") == before
    for file in ("agent_beside_courses.py", "lanes_kit/unused.py"):
        (tmp_path / file).write_text("# edited\n")
        assert course_content("drawer_of_courses:draw") == before
    kit = ("__init__.py", "bends.py", "radii.py")
    files = ("shapes_of_lanes.py", *(f"lanes_kit/{file}" for file in kit))
    assert_each_counts(tmp_path, "drawer_of_courses:draw", files)


def test_a_course_in_a_package_is_known_by_the_package_and_its_neighbours(tmp_path, monkeypatch):
    user_modules(
        tmp_path,
        monkeypatch,
        {
            "field_kit/__init__.py": "",
            "field_kit/courses.py": "from .widths import WIDTH\nimport beside_field_kit\n",
            "field_kit/widths.py": "WIDTH = 2.0\n",
            "beside_field_kit.py": "",
        },
    )
    importlib.import_module("field_kit.courses")
    files = ("field_kit/__init__.py", "field_kit/widths.py", "beside_field_kit.py")
    assert_each_counts(tmp_path, "field_kit.courses:draw", files)


def test_a_course_with_other_code_is_driven_again(tmp_path, monkeypatch):
    module = tmp_path / "drawer_of_lanes.py"
    text = (
        "from offroad_env.environment.scenarios import SCENARIOS\n"
        "def draw(*given):\n    return SCENARIOS['brake'].draw(*given)\n"
    )
    module.write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(os.fspath(tmp_path))
    importlib.import_module("drawer_of_lanes")
    before = course_content("drawer_of_lanes:draw")
    module.write_text(f"{text}# another one\n")
    assert course_content("drawer_of_lanes:draw") != before
    assert course_content("offroad_env.environment.scenarios:draw_steep_climb") == b""


def test_a_part_of_python_is_no_agent():
    with pytest.raises(InvalidParameter, match="is a part of Python"):
        own_content("json:JSONDecoder")
