"""The demo: every part runs, the page stands alone, and its sentences say what came out."""

from __future__ import annotations

import itertools
import json
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest

import agents.demo.control as control
import agents.demo.driving as driving
import agents.demo.measured as measured
import agents.demo.parts as parts
import agents.demo.physics as physics
from agents.benchmark.summary import summarise
from agents.commands.cli import COMMANDS, _parse
from agents.commands.demo import Demo
from agents.controllers.protocol import ArmResult, EpisodeResult
from agents.demo.context import Driven, Run
from agents.demo.diagnosis import DELAY
from agents.demo.parts import SECTIONS, DemoSettings, run_demo
from agents.driving.recording import EpisodeLog
from agents.learning.policies import MissingExtraError
from agents.reports.page import Section, frame_png, render_page
from estimators.experiments.buzhardt_tallapragada import forward_comparison
from offroad_env.errors import DataError, InvalidParameter

pytestmark = pytest.mark.check


def no_download(name):
    raise DataError(f"{name} could not be downloaded: no connection to example.org")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Little of everything."""
    return DemoSettings(
        out=tmp_path_factory.mktemp("demo"),
        duration=2.0,
        row_duration=2.0,
        episodes=2,
        n_jobs=1,
        learning_time=0.1,
        test_episodes=0,
        log_duration=30.0,
    )


@pytest.fixture(scope="module")
def heard():
    """What the progress bar was told."""
    return []


@pytest.fixture(scope="module")
def sections(small, heard):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured, "fetch", no_download)
        return list(run_demo(small, progress=lambda label, share: heard.append((label, share))))


@pytest.fixture(scope="module")
def by_name(sections):
    return {section.name: section for section in sections}


# ---------------------------------------------------------------------- the whole


def test_every_part_runs_in_order_and_says_one_sentence(sections):
    assert [section.name for section in sections] == list(SECTIONS)
    for section in sections:
        assert re.fullmatch(r"[A-Z].*\.", section.sees, flags=re.DOTALL), section.sees
        assert section.seconds > 0.0


def test_progress_never_goes_back_and_ends_inside_the_last_part(sections, heard):
    shares = [share for _, share in heard]
    assert shares[0] == 0.0
    assert all(a <= b + 1e-12 for a, b in itertools.pairwise(shares))
    assert 0.9 < shares[-1] <= 1.0


def test_every_command_on_the_page_is_one_that_exists(sections):
    for section in sections:
        program, command, *arguments = section.command.split()
        assert program == "offroad"
        assert command in COMMANDS
        _parse(command, arguments)  # leaves by SystemExit where it is wrong


def test_the_page_stands_alone(sections):
    page = render_page(sections, title="T", intro="I", footer="F")
    addresses = re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?([^\"')>\s]+)", page)
    assert addresses
    assert all(address.startswith(("data:image/png;base64,", "#")) for address in addresses)
    assert not re.search(r"<script[^>]*\bsrc\b", page)
    assert len(page.encode()) < 6e6
    assert len(re.findall(r"<img ", page)) == sum(len(section.pictures) for section in sections)
    assert not re.search(r'alt=""', page)


def test_the_page_shows_text_as_text():
    section = Section(name="a", title="a < b", sees="<b>5 m", command="offroad demo")
    page = render_page([section], title="T & U", intro="I", footer="F")
    assert "&lt;b&gt;5\N{NO-BREAK SPACE}m" in page
    assert "a &lt; b" in page
    assert "T &amp; U" in page


def test_the_command_writes_page_and_numbers(small, sections, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("agents.demo.parts.run_demo", lambda settings, only, progress: iter(sections))
    Demo(out=tmp_path / "new" / "folder").run()
    page = (tmp_path / "new" / "folder" / "demo.html").read_text(encoding="utf-8")

    def refuse(constant):
        raise AssertionError(constant)

    text = (tmp_path / "new" / "folder" / "demo.json").read_text(encoding="utf-8")
    numbers = json.loads(text, parse_constant=refuse)["sections"]
    assert list(numbers) == list(SECTIONS)
    printed = capsys.readouterr().out
    for section in sections:
        for what, value in section.key:
            assert what in page
            assert value in page
            assert value in printed
            assert numbers[section.name]["key"][what] == value


def test_a_part_can_be_run_alone(small):
    assert [section.name for section in run_demo(small, only=("exponent",))] == ["exponent"]
    with pytest.raises(InvalidParameter, match="only must name sections among soil"):
        next(run_demo(small, only=("exponents",)))


def test_the_longest_part_runs_beside_the_others_and_comes_in_its_place(small, monkeypatch):
    heard = []

    def maker(name):
        def make(run):
            heard.append(name)
            return Section(name=name, title=name, sees="S.", command="offroad demo")

        return make

    class Beside:
        """Stands for joblib: says when something is begun in another process, and when it is ended."""

        def __init__(self, n_jobs, return_as):
            assert (n_jobs, return_as) == (2, "generator")

        def __call__(self, tasks):
            heard.append("begun")
            return self._results(tasks)

        @staticmethod
        def _results(tasks):
            try:
                yield from (function(*arguments) for function, arguments, _ in tasks)
            finally:
                heard.append("ended")

    several = {name: (label, weight, maker(name)) for name, (label, weight, _) in SECTIONS.items()}
    monkeypatch.setattr(parts, "SECTIONS", several)
    monkeypatch.setattr(parts, "Parallel", Beside)
    two = replace(small, n_jobs=2)
    assert [section.name for section in run_demo(two)] == list(SECTIONS)
    assert heard == [
        "soil", "forward", "exponent", "drive", "begun", "estimate", "arms", "learning", "diagnose", "ended",
        "wheel-data",
    ]  # fmt: skip
    heard.clear()
    assert [section.name for section in run_demo(two, only=("drive", "diagnose"))] == ["drive", "diagnose"]
    assert heard == ["drive", "diagnose"]
    heard.clear()
    left = run_demo(two)
    assert next(section for section in left if section.name == "estimate")
    left.close()
    assert heard == ["soil", "forward", "exponent", "drive", "begun", "estimate"]


def test_the_result_of_the_longest_part_can_come_from_another_process(by_name):
    section = by_name["diagnose"]
    there = pickle.loads(pickle.dumps(section))
    assert there.sees == section.sees
    assert len(there.pictures) == len(section.pictures) > 0


# ---------------------------------------------------------------------- the parts


def test_the_comparison_states_what_the_models_say_beside_the_paper(small, monkeypatch):
    comparison = forward_comparison(duration=small.duration)
    distance = np.linspace(0.0, 1.0, len(comparison.t))
    distance[50] = 7.125  # largest in the middle, not at the end
    told = replace(comparison, distance=distance)
    monkeypatch.setattr(physics, "forward_comparison", lambda duration: told)
    section = physics.forward_section(Run(small))
    assert section.data["largest_distance"] == 7.125
    assert "up to 7.12 m apart; the paper reports up to 15 m." in section.sees
    assert section.key[0][1] == "7.12 m (paper: up to 15 m)"


def test_paths_are_compared_at_the_same_speed_and_under_the_same_force(by_name):
    data = by_name["exponent"].data
    assert (data["n"][0], data["n"][-1]) == (0.4, 0.6)
    for mode, ends in data["ends"].items():
        apart = max(np.hypot(*(a - b)) for a in ends for b in ends)
        assert data["spread"][mode] == pytest.approx(apart)
        assert f"{apart:.1f} m" in by_name["exponent"].sees


def test_the_paper_s_error_stands_beside_the_one_here(by_name):
    data = by_name["estimate"].data
    assert data["paper_mse"] == {"half_car": 4.26e-3, "bicycle": 5.78e-2}  # row 4 of the paper's table
    rows = by_name["estimate"].tables[0].rows
    assert [row[2] for row in rows] == [f"{value:.2e}" for value in data["mse"].values()]


def test_the_episode_is_driven_once_for_both_parts_that_show_it(by_name):
    assert by_name["drive"].data["n"] == by_name["estimate"].data["on_board"]["true_n"]
    assert len(by_name["drive"].pictures) == 2


def test_the_injected_steering_delay_is_found_and_the_page_says_so(by_name):
    section = by_name["diagnose"]
    found = section.data["diagnosis"]["causes"][0]
    assert "steer_delay" in found["set"]
    assert section.data["diagnosis"]["sentence"] in section.sees
    assert found["parameters"]["delay"]["low"] < DELAY < found["parameters"]["delay"]["high"]
    less = {row[0]: (float(row[3]) / float(row[2])) for row in section.tables[0].rows}
    assert less["yaw_rate"] < 0.8


def test_without_drawing_the_episode_is_still_told(small, by_name, monkeypatch):
    run = Run(small)
    driven = Driven(drive=_Stub(), frame=None)
    object.__setattr__(driven, "briefing", None)
    object.__setattr__(driven, "plant", None)
    run.__dict__["driven"] = driven
    monkeypatch.setattr(driving, "drive_figure", lambda log: None)
    monkeypatch.setattr(driving, "figure_picture", lambda figure, caption: None)
    monkeypatch.setattr(driving, "bekker_env", lambda env: driven)
    monkeypatch.setattr(driving, "episode_playback", lambda log, briefing, plant: None)
    section = driving.drive_section(run)
    assert "ends (left corridor) 12 m into the 300 m course" in section.sees
    assert "pygame-ce" in section.notes[0]


class _Stub:
    """An episode that left the corridor."""

    env = None

    info = {  # noqa: RUF012 - a constant
        "success": False,
        "failure": "left_corridor",
        "progress": 12.0,
        "path_length": 300.0,
        "time": 3.0,
        "n": 0.5,
    }

    class log(EpisodeLog):  # noqa: N801 - stands for the attribute of that name
        @staticmethod
        def columns():
            return {"speed": np.array([3.0, 5.0])}


def arm(name, times, failed=()):
    episodes = tuple(
        EpisodeResult(
            seed=i,
            n=0.5,
            success=i not in failed,
            failure="rollover" if i in failed else "",
            time=time,
            progress=300.0,
            score=120.0 if i in failed else time,
            reward=0.0,
            cross_track_rms=0.1,
            step_time=1e-4,
            env_time=2e-4,
        )
        for i, time in enumerate(times)
    )
    return ArmResult(name=name, time_limit=120.0, episodes=episodes)


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (
            8.0,
            r"^Knowing the soil saves 8 s of \d+ s \[7\.\d+, 8\.?\d*\] "
            r"\(all but n known; 40 paired episodes; .* against nominal",
        ),
        (-8.0, r"^Knowing the soil adds 8 s to 50 s \[7\.\d+, 8\.?\d*\]"),
        (0.05, r"^No difference shows between knowing the soil and not: [+-]0\.05 \[-0\.\d+, \+0\.\d+\] s"),
        (-0.05, r"^No difference shows between knowing the soil and not: [+-]0\.05 \[-0\.\d+, \+0\.\d+\] s"),
    ],
)
def test_the_arms_are_judged_by_the_interval(gain, words):
    times = 50.0 + 5.0 * np.random.default_rng(0).standard_normal(40)
    noise = np.random.default_rng(1).standard_normal(40)
    noise -= noise.mean()
    arms = (
        arm("nominal", times),
        arm("conservative", times + 20.0),
        arm("aware", times),
        arm("oracle", times - gain + noise),
    )
    assert re.search(words, control.arms_sentence(summarise("speed", 0, arms)))


def test_what_learning_drives_is_compiled_before_its_time_begins(small, monkeypatch):
    heard = []

    def fail(*_, **__):
        heard.append("learning")
        raise MissingExtraError("enough")

    class Vector(control.make_vec(1, scenario="speed", terrain_info="none").__class__):
        def step(self, actions):
            heard.append("step")
            return super().step(actions)

    monkeypatch.setattr(control, "make_vec", lambda n, **options: Vector(n, **options))
    monkeypatch.setattr(control, "train", fail)
    control.learning_section(Run(small))
    assert heard == ["step", "learning"]


def test_learning_is_left_out_with_a_sentence_where_its_packages_are_missing(small, monkeypatch):
    def fail(*_, **__):
        raise MissingExtraError("learning needs stable-baselines3")

    monkeypatch.setattr(control, "train", fail)
    section = control.learning_section(Run(small))
    assert section.sees == "Left out: learning needs stable-baselines3."


def test_measured_data_that_cannot_be_had_are_left_out_with_a_sentence(small, monkeypatch):
    monkeypatch.setattr(measured, "locate", no_download)
    monkeypatch.setattr(measured, "fetch", no_download)
    section = measured.wheel_section(Run(small))
    assert section.sees.startswith("The measured data can be had neither on this machine nor by download")
    assert section.sees.endswith("no connection to example.org.")


def test_measured_data_on_this_machine_are_not_downloaded(offroad_data, small, monkeypatch):
    offroad_data("cmu_single_wheel")
    monkeypatch.setattr(measured, "fetch", lambda name: pytest.fail("asked for a download"))
    section = measured.wheel_section(Run(small))
    assert len(section.pictures) == 1
    assert [row[0] for row in section.tables[0].rows] == ["sinkage", "drawbar pull", "side force"]


def test_a_quick_run_is_shorter_in_every_respect(small):
    full = DemoSettings(out=small.out)
    quick = full.quick()
    for name in ("duration", "row_duration", "episodes", "learning_time", "test_episodes"):
        assert getattr(quick, name) < getattr(full, name)
    assert replace(quick, out=small.out) == quick
    assert full.episodes >= 20  # fewer tell nothing of a difference


def test_a_thin_line_keeps_its_colour_in_a_small_picture():
    import io

    from PIL import Image

    rng = np.random.default_rng(0)
    frame = rng.integers(150, 220, size=(360, 640, 3)).astype(np.uint8)
    frame[100:102, 50:200] = (0, 128, 94)
    with Image.open(io.BytesIO(frame_png(frame))) as image:
        assert image.mode == "P"
        assert tuple(np.asarray(image.convert("RGB"))[100, 60]) == (0, 128, 94)
