"""The command line: what it writes, what it says when something is wrong, and how fast it starts."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import math
import os
import re
import shutil
import stat
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from agents.commands.cli import COMMANDS, main
from agents.commands.reproduce import STUDIES, STUDY_ALIASES
from agents.learning.policies import learned_folder
from agents.reports import output
from agents.reports.output import OutputError, plain, write_bytes, write_json
from helpers import run_fresh
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.vehicles import make_wheel

PNG = b"\x89PNG\r\n"


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")


@pytest.fixture
def no_network(monkeypatch, tmp_path):
    """No measured data on this machine, and nobody to get them from."""
    monkeypatch.delenv("OFFROAD_DATA", raising=False)
    monkeypatch.setattr("offroad_env.world.datasets.cache_folder", lambda: tmp_path / "no-cache")
    for name in ("HTTPS_PROXY", "https_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")  # the discard port: nobody listens
    for name in ("NO_PROXY", "no_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)


def offroad(*arguments):
    """Exit status of ``offroad`` with these arguments."""
    with pytest.raises(SystemExit) as leaving:
        main([str(argument) for argument in arguments])
    return leaving.value.code


def read_strictly(path):
    """JSON as the standard has it: no NaN, no Infinity."""

    def refuse(constant):
        raise AssertionError(f"{constant} in {path}")

    return json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=refuse)


# ---------------------------------------------------------------------- finding a command


def test_help_lists_every_command(capsys):
    assert offroad("--help") == 0
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in COMMANDS)


def test_without_a_command_the_help_is_shown_as_wrong_usage(capsys):
    assert offroad() == 2
    assert "usage: offroad COMMAND" in capsys.readouterr().out


def test_help_loads_nothing_that_makes_it_slow():
    code = (
        "import sys\nfrom agents.commands.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: print('loaded', *sys.modules)"
    )
    loaded = run_fresh(code).split("loaded")[1].split()
    assert {"numba", "scipy", "matplotlib", "torch", "pygame", "pandas"}.isdisjoint(loaded)


def test_version_is_that_of_the_package(capsys):
    assert offroad("--version") == 0
    assert capsys.readouterr().out == f"offroad {version('offroad-bekker')}\n"


#: Commands of several subcommands.
_SEVERAL = ("data", "log", "reproduce")
ARGUMENT_CLASSES = [
    *(("commands", *entry[:2]) for name, entry in COMMANDS.items() if name not in _SEVERAL),
    *(("commands", "log", kind) for kind in ("Template", "Check", "Draw")),
    *(("studies", f"{module}.study", kind) for module, kind, _ in STUDIES.values()),
]


def test_every_other_name_of_a_study_leads_to_one():
    assert set(STUDY_ALIASES.values()) <= set(STUDIES)
    assert not set(STUDY_ALIASES) & set(STUDIES)


@pytest.mark.parametrize(("package", "module", "kind"), ARGUMENT_CLASSES)
def test_every_argument_has_a_line_of_explanation(package, module, kind):
    arguments = getattr(importlib.import_module(f"agents.{package}.{module}"), kind)
    source = "".join(inspect.getsource(part) for part in arguments.__mro__ if dataclasses.is_dataclass(part))
    for field in dataclasses.fields(arguments):
        assert re.search(rf"^    {field.name}: .*  #: \w", source, flags=re.MULTILINE), field.name


@pytest.mark.parametrize("command", ["demo", "drive", "soil", "wheel-data"])
def test_help_explains_the_command_and_where_results_go(command, capsys):
    assert offroad(command, "--help") == 0
    text = capsys.readouterr().out
    assert f"usage: offroad {command} " in text
    assert all(argument in text for argument in ("--out PATH", "--json {None}|PATH", "Write"))


@pytest.mark.parametrize("arguments", [("data", "get"), ("data", "list"), ("train",)])
def test_the_other_commands_explain_themselves_too(arguments, capsys):
    assert offroad(*arguments, "--help") == 0
    assert "usage: offroad " + " ".join(arguments) in capsys.readouterr().out


def test_studies_are_listed_explained_and_guessed(capsys):
    assert offroad("reproduce", "--help") == 0
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in STUDIES)
    assert offroad("study", "--help") == 0
    assert capsys.readouterr().out == text
    assert offroad("reproduce") == 2
    assert offroad("reproduce", "table1", "--help") == 0
    assert "usage: offroad reproduce table1 " in capsys.readouterr().out
    assert offroad("reproduce", "paper_table", "--help") == 0  # another name of the same
    assert "usage: offroad reproduce table1 " in capsys.readouterr().out
    assert offroad("reproduce", "tabel1") == 2
    assert capsys.readouterr().err == "offroad: no study 'tabel1' - did you mean 'table1'?\n"


def test_a_misspelt_command_is_wrong_usage_with_the_nearest_name(capsys):
    assert offroad("drvie") == 2
    assert capsys.readouterr().err == "offroad: no command 'drvie' - did you mean 'drive'?\n"


@pytest.mark.parametrize("arguments", [("soil", "--lods", "1"), ("data",), ("drive", "--seed", "one")])
def test_wrong_arguments_are_wrong_usage_and_no_traceback(arguments, capsys):
    assert offroad(*arguments) == 2
    captured = capsys.readouterr()
    assert "Traceback" not in captured.out + captured.err


# ---------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("soil", "claay"), "no soil named 'claay' - did you mean"),
        (("soil", "clay", "--n", "30"), "n must be in"),
        (("soil", "clay", "--loads", "-5"), "loads must be positive"),
        (("soil", "clay", "--slips", "30"), "slip must be in [-1, 1]"),
        (("drive", "--scenario", "moon"), "ride, patches, got 'moon'"),
        (("drive", "--agent", "nobody"), "agent must be one of pure_pursuit"),
        (("drive", "--agent", "nowhere.at_all:Driver"), "no module 'nowhere.at_all' in "),
        (("compare", "nowhere:Driver"), "no module 'nowhere' in "),
        (("drive", "--scenario", "speed", "--agent", "oracle", "--terrain-info", "none"), '"truth"'),
        (("drive", "--duration", "-1"), "duration must be in (0, 3600] s, got -1"),
        (("drive", "--window", "--video", "a.gif"), "give --window (or the keyboard), or --video"),
        (("drive", "--video", "a.avi", "--duration", "1"), "video must end in .gif or .mp4"),
        (("drive", "--policy", "no-such-folder"), "no policy in no-such-folder - train one with"),
        (("drive", "--duration", "inf"), "duration must be in"),
        (("drive", "--seed", "-1"), "seed must be >= 0, got -1"),
        (("wheel-data", "no-such-file.mat"), "no-such-file.mat: no such file"),
        (("data", "get", "cmu"), "name must be one of cmu_single_wheel"),
        (("train", "--n-envs", "0"), "n_envs must be >= 1, got 0"),
        (("train", "--gamma", "99"), "gamma must be in (0, 1], got 99"),
        (("train", "--held-noise", "40"), "held_noise must be in [0, 1], got 40"),
        (("train", "--centre", "-0.3"), "centre must be finite and >= 0, got -0.3"),
        (
            ("train", "--last-log-std", "-3", "--log-std", "-3.2"),
            "last_log_std must be in [-20, log_std = -3.2], got -3",
        ),
        (("train", "--last-log-std", "-4"), "last_log_std needs held_noise < 1, got 1"),
        (("demo", "--only", "tea"), "only must name sections among soil, forward"),
    ],
)
def test_an_error_ends_in_one_sentence_and_status_one(arguments, words, capsys, tmp_path):
    out = () if arguments[0] == "data" else ("--out", tmp_path)
    assert offroad(*arguments, *out) == 1
    sentence = capsys.readouterr().err
    assert sentence.startswith("offroad: ")
    assert words in sentence
    assert sentence.count("\n") == 1


def test_data_without_a_network_say_so_in_one_sentence(no_network, capsys):
    assert offroad("data", "get", "cmu_single_wheel") == 1
    sentence = capsys.readouterr().err
    assert sentence.startswith("offroad: cmu_single_wheel could not be downloaded: no connection to")
    assert sentence.count("\n") == 1


def test_data_that_are_not_here_come_with_the_command_that_gets_them(no_network, capsys, tmp_path):
    assert offroad("wheel-data", "--out", tmp_path) == 1
    assert "run: offroad data get cmu_single_wheel" in capsys.readouterr().err


def test_results_that_cannot_be_written_are_an_error_with_the_path(capsys, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    assert offroad("soil", "clay", "--out", tmp_path / "file") == 1
    assert f"offroad: cannot write {tmp_path / 'file' / 'soil_clay.png'}" in capsys.readouterr().err


# ---------------------------------------------------------------------- files


def test_json_holds_no_number_that_json_does_not_know():
    @dataclasses.dataclass
    class Record:
        value: float
        where: Path

    soil = SOILS["clay"]
    content = {1: Record(math.nan, Path("a")), "array": np.array([1.0, np.inf]), "soil": soil, "none": None}
    assert plain(content) == {
        "1": {"value": None, "where": "a"},
        "array": [1.0, None],
        "soil": soil._asdict(),
        "none": None,
    }


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = write_json(tmp_path / "deep" / "numbers.json", {"a": 1})
    before = path.read_text()
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(output.os, "replace", fail)
    with pytest.raises(OutputError, match=r"cannot write .*numbers\.json: No space left on device"):
        write_bytes(path, b"other")
    assert path.read_text() == before
    assert [p.name for p in path.parent.iterdir()] == ["numbers.json"]


@pytest.mark.skipif(os.name != "posix", reason="file modes as POSIX has them")
def test_a_result_can_be_read_by_whom_the_user_lets_read_files(tmp_path):
    mask = os.umask(0o027)
    try:
        path = write_bytes(tmp_path / "a", b"")
    finally:
        os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


# ---------------------------------------------------------------------- the commands


def test_soil_draws_what_the_wheel_function_says(tmp_path):
    arguments = ("--n", "0.6", "--slip-angle", "12", "--radius", "0.3", "--width", "0.2")
    assert offroad("soil", "clay", *arguments, "--out", tmp_path, "--json", tmp_path / "s.json") == 0
    assert (tmp_path / "soil_clay.png").read_bytes().startswith(PNG)
    curves = read_strictly(tmp_path / "s.json")["curves"]
    soil, wheel = make_soil("clay", n=0.6), make_wheel(r=0.3, b=0.2)
    load, slip = curves["loads"][1], curves["slip_axis"][70]
    straight = wheel_forces(soil, wheel, load=load, slip=slip)
    turned = wheel_forces(soil, wheel, load=load, slip=slip, slip_angle=math.radians(12.0))
    drawn = [curves["over_slip"][name][1][70] for name in ("sinkage", "drawbar", "side_force")]
    assert drawn == [straight.sinkage, straight.F_x, -turned.F_y]


def test_soil_shows_the_prior_and_natural_soil(tmp_path, capsys):
    assert offroad("soil", "--prior", "--out", tmp_path, "--json", tmp_path / "p.json") == 0
    assert "all four" in capsys.readouterr().out
    numbers = read_strictly(tmp_path / "p.json")
    assert numbers["coverage"]["one soil left out"]["0.8"][-1] == pytest.approx(0.75, abs=0.1)
    assert offroad("soil", "clay", "--field", "--seed", 3, "--out", tmp_path) == 0
    for name in ("soil_prior", "soil_field_clay"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(PNG)


def test_a_curve_ends_where_the_soil_no_longer_carries_the_wheel(tmp_path):
    json_file = tmp_path / "s.json"
    assert offroad("soil", "snow", "--loads", "20000", "--out", tmp_path, "--json", json_file) == 0
    sinkage = read_strictly(json_file)["curves"]["over_load"]["sinkage"][0]
    assert sinkage[0] is not None
    assert sinkage[-1] is None


def test_the_catalogue_is_listed_with_its_sources(capsys, tmp_path):
    assert offroad("soil", "--list", "--json", tmp_path / "l.json") == 0
    text = capsys.readouterr().out
    listed = read_strictly(tmp_path / "l.json")
    assert set(listed) == set(SOILS)
    for name, entry in listed.items():
        assert name in text
        assert entry["source"] in text


def test_wheel_data_prints_and_writes_the_errors_by_channel(offroad_data, capsys, tmp_path):
    path = offroad_data("cmu_single_wheel") / "original" / "all_grouser_data.mat"
    assert offroad("wheel-data", path, "--out", tmp_path, "--json", tmp_path / "w.json") == 0
    scores = read_strictly(tmp_path / "w.json")["scores"]
    text = capsys.readouterr().out
    assert f"{1e3 * scores['sinkage']['rmse']:.1f} [" in text
    assert "residuals" not in text
    assert "Carnegie Mellon University" in text
    assert (tmp_path / "wheel_data.png").read_bytes().startswith(PNG)


def test_data_sets_are_listed_even_where_they_are_not(no_network, capsys, tmp_path):
    assert offroad("data", "list", "--json", tmp_path / "d.json") == 0
    assert "not on this machine - get it with: offroad data get cmu_single_wheel" in capsys.readouterr().out
    assert read_strictly(tmp_path / "d.json")["cmu_single_wheel"]["file"] is None


def test_the_same_seed_drives_the_same_episode(tmp_path):
    common = ("drive", "--duration", "2", "--out", tmp_path)
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        assert offroad(*common, "--seed", seed, "--json", tmp_path / f"{name}.json") == 0
    a, b, c = (read_strictly(tmp_path / f"{name}.json") for name in "abc")
    assert a == b
    assert a["summary"]["true n [-]"] != c["summary"]["true n [-]"]
    assert a["series"]["time"][-1] == pytest.approx(2.0)
    assert (tmp_path / "drive_track_3.png").read_bytes().startswith(PNG)


def test_a_policy_drives_the_task_that_it_was_trained_for(tmp_path):
    folder = learned_folder("brake", "ppo_aware", 0)
    arguments = ("drive", "--policy", folder, "--duration", "0.2", "--out", tmp_path)
    assert offroad(*arguments) == 0
    assert (tmp_path / "drive_brake_0.png").exists()
    assert offroad(*arguments, "--scenario", "speed") == 0
    assert (tmp_path / "drive_speed_0.png").exists()


def test_a_policy_drives_in_the_world_that_it_has_learnt_in(tmp_path, capsys):
    folder = tmp_path / "policy"
    shutil.copytree(learned_folder("brake", "ppo_aware", 0), folder)
    kind = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(
        json.dumps(kind | {"world": {"structure": "field", "vehicle": "hmmwv"}})
    )
    arguments = (
        "drive",
        "--policy",
        folder,
        "--duration",
        "0.2",
        "--out",
        tmp_path,
        "--json",
        tmp_path / "d.json",
    )
    deepest = "deepest sinkage [mm]"
    found = {}
    for name, options in (("its own", ()), ("asked for", ("--structure", "full", "--vehicle", "mrzr"))):
        assert offroad(*arguments, *options) == 0
        found[name] = read_strictly(tmp_path / "d.json")["summary"][deepest]
    assert "world of the policy: structure 'field', vehicle 'hmmwv'" in capsys.readouterr().out
    assert found["its own"] != found["asked for"]
    (folder / "policy.json").write_text(json.dumps(kind | {"world": {"agent": "mine.py"}}))
    assert offroad(*arguments) == 1


def test_the_soil_of_an_episode_can_be_chosen(tmp_path):
    arguments = ("drive", "--n", "0.5", "--duration", "0.5", "--out", tmp_path)
    assert offroad(*arguments, "--json", tmp_path / "d.json") == 0
    assert read_strictly(tmp_path / "d.json")["summary"]["true n [-]"] == 0.5


def test_an_episode_can_be_pictured_and_filmed(tmp_path):
    from PIL import Image

    files = ("--picture", tmp_path / "p" / "a.png", "--video", tmp_path / "v" / "a.gif")
    assert offroad("drive", "--duration", "1", *files, "--out", tmp_path) == 0
    with Image.open(tmp_path / "p" / "a.png") as picture, Image.open(tmp_path / "v" / "a.gif") as video:
        assert picture.size == (1280, 720)
        assert video.n_frames == 6  # at 0, 0.2, ..., 1 s


def test_an_episode_can_be_watched(tmp_path):
    assert offroad("drive", "--duration", "0.1", "--window", "--out", tmp_path) == 0


@pytest.mark.parametrize(("asked", "threads"), [({}, [1]), ({"OPENBLAS_NUM_THREADS": "2"}, [2])])
def test_the_command_uses_one_thread_of_blas_unless_others_are_asked_for(asked, threads):
    """numpy is loaded before the command can set the environment that it reads."""
    code = f"""
import os
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.pop(name, None)
os.environ.update({asked})
from threadpoolctl import threadpool_info, threadpool_limits
from agents.commands import cli
threadpool_limits(limits=2, user_api="blas")
cli._use_one_thread()
print(sorted({{one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}}))
"""
    assert json.loads(run_fresh(code)) == threads
