"""Commands take names and files of one's own, name what exists, and spell an option in one way."""

from __future__ import annotations

import dataclasses
import importlib
import json
from dataclasses import replace
from pathlib import Path

import pytest
from joblib import Parallel, delayed

from agents.benchmark.study import BenchmarkArgs, run_study
from agents.commands.benchmark import BenchmarkRun as Benchmark
from agents.commands.cli import COMMANDS, main
from agents.commands.compare import Compare, paired_lines
from agents.commands.drive import Drive
from agents.commands.options import FORMER, Jobs, Scenarios, option_value, present_spelling
from agents.commands.reproduce import STUDIES
from agents.driving.episode import agents_of, find_agent
from agents.driving.world_options import WorldOptions, known_scenario, known_scenarios
from agents.learning.train import TrainArgs, configuration_hash
from helpers import REPOSITORY
from offroad_env.environment.reference import SECTIONS, reference
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import BUILT_IN, SCENARIOS
from offroad_env.errors import InvalidParameter

LANE = """
scenario:
  base: brake
  name: test_lane
  corridor: 2.5
  course: {path: straight, length: 60, roughness: A}
vehicle: {base: mrzr, m: 1450}
soil: {base: sandy_loam, phi: 0.5}
"""


def offroad(*arguments):
    with pytest.raises(SystemExit) as leaving:
        main([str(argument) for argument in arguments])
    return leaving.value.code


@pytest.fixture
def lane(tmp_path, monkeypatch):
    """A file with a scenario, a vehicle and a soil; what it registers is taken out again."""
    monkeypatch.setenv("OFFROAD_BEKKER_REGISTERED", "{}")
    file = tmp_path / "lane.yaml"
    file.write_text(LANE)
    yield file
    SCENARIOS.pop("test_lane", None)


def test_drive_takes_scenario_soil_vehicle_reward_sensors_and_randomisation(lane, tmp_path, capsys):
    log = tmp_path / "run.csv"
    options = ["--scenario", lane, "--soil", lane, "--vehicle", lane, "--weights", "{goal: 1}"]
    options += ["--sensors", "ideal", "--randomise", "{n: [0.7, 0.7], vehicle.m: {normal: [1450, 20]}}"]
    code = offroad(
        "drive", *options, "--agent", "aware", "--duration", "0.4", "--out", tmp_path, "--log", log
    )
    said = capsys.readouterr().out
    assert code == 0
    assert "test_lane, seed 0" in said
    assert "0.70" in said
    described = log.with_suffix(".yaml").read_text()
    assert "m: 1450" in described, "the log states the nominal vehicle"
    assert (tmp_path / "drive_test_lane_0.png").is_file()


def test_own_scenario_and_world_reach_the_benchmark_and_its_results_are_kept(lane, tmp_path):
    name = known_scenario(str(lane))
    assert name == "test_lane"
    args = BenchmarkArgs(tasks=(name,), agents=("conservative",), forms=("matched",), episodes=2, n_jobs=1)
    plain = run_study(args, tmp_path)[name, "matched"]
    heavy = replace(args, world=WorldOptions(vehicle=str(lane), soil="hard_ground").digest())
    other = run_study(heavy, tmp_path)[name, "matched"]
    assert plain.arms[0].scores.tolist() != other.arms[0].scores.tolist()
    keys = [json.loads(line)["key"] for line in (tmp_path / "episodes.jsonl").read_text().splitlines()]
    assert len(keys) == 4
    assert sum("1450" in str(key) for key in keys) == 2


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("os:system", "part of Python"),
        ("sys:exit", "part of Python"),
        ("no_such:Agent", "no module"),
        ("agents.controllers.arms:believe_fixed", "is a function: give a class"),
        ("agents.controllers.arms:ARMS", "is no class: give a class"),
        ("agents.controllers.population_limits:PopulationDriver", "cannot be made without arguments"),
    ],
)
def test_a_name_that_cannot_be_an_agent_is_refused_in_a_sentence(name, words, tmp_path, capsys):
    assert offroad("compare", name, "--scenario", "brake", "--out", tmp_path) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert words in said
    assert name in said


@pytest.mark.parametrize(("action", "noted"), [((30.0, 500.0), True), ((1.2, -1.5), False)])
def test_actions_in_degrees_or_newton_metres_are_noted(action, noted, tmp_path, monkeypatch, capsys):
    name = f"far_{int(action[0])}"
    lines = f"class Far:\n    def reset(self, b): ...\n    def act(self, o): return np.array({action})\n"
    (tmp_path / f"{name}.py").write_text(f"import numpy as np\n{lines}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert offroad("drive", "--agent", f"{name}:Far", "--duration", "0.2", "--out", tmp_path) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert ("acts by up to 500: steering and drive are shares" in said) is noted


def test_compare_shows_the_own_agent_against_every_other_one(tmp_path):
    agents = ("pure_pursuit", "conservative")
    args = BenchmarkArgs(tasks=("brake",), agents=agents, forms=("matched",), episodes=2, n_jobs=1)
    result = run_study(args, tmp_path)["brake", "matched"]
    first, second = paired_lines(result, "pure_pursuit")
    assert "pure_pursuit against the others, brake (matched)" in first
    assert "conservative: +" in second
    assert second.endswith(("worse", "no difference shown"))


def test_training_on_another_world_is_another_configuration():
    plain, other = TrainArgs(), TrainArgs(world=WorldOptions(vehicle="{base: mrzr, m: 1450}"))
    assert configuration_hash(plain) != configuration_hash(other)
    assert other.world.env_options()["vehicle"]["m"] == 1450.0


@pytest.mark.parametrize(("scenario", "steered"), [("speed", True), ("climb", False)])
def test_help_and_errors_name_the_agents_of_that_scenario(scenario, steered):
    text = Drive.description(["--scenario", scenario])
    assert ("lqr_aware" in text) == steered
    with pytest.raises(
        InvalidParameter, match=r"agent must be one of .*module:Class, got 'nobody'"
    ) as caught:
        find_agent("nobody", scenario, None)
    assert ("lqr_aware" in str(caught.value)) == steered
    assert ("ppo_aware_0 ... ppo_aware_4" in str(caught.value)) == (scenario == "speed")


@pytest.mark.parametrize("scenario", BUILT_IN)
def test_every_agent_that_is_named_can_be_had(scenario):
    for name in agents_of(scenario):
        agent, _ = find_agent(name, scenario, None)
        assert callable(agent.act)


def commands():
    """(command, its class of arguments)."""
    for name, (module, kind, _) in COMMANDS.items():
        if kind != "STUDIES":
            yield name, getattr(importlib.import_module(f"agents.commands.{module}"), kind)
    for name, (module, kind, _) in STUDIES.items():
        yield name, getattr(importlib.import_module(f"agents.studies.{module}.study"), kind)


#: Spelling of a thing -> words that would be a second one.
SPELLINGS = {
    "jobs": {"n_jobs", "processes", "workers", "cores", "parallel"},
    "scenario": {"tasks", "task", "scenarios", "courses"},
    "out": {"output", "folder", "directory", "out_dir"},
    "json": {"numbers", "json_file"},
    "seed": {"random_seed", "rng"},
    "soil": {"ground", "soil_name"},
    "vehicle": {"car", "vehicle_name"},
    "terrain_info": {"terrain", "info"},
}
#: Field -> the option it is given by.
OPTIONS = {"Jobs": "jobs", "Scenarios": "scenario"}


def test_an_option_has_one_spelling_in_all_commands():
    second = {word: first for first, words in SPELLINGS.items() for word in words}
    found = []
    for command, kind in commands():
        if not dataclasses.is_dataclass(kind):
            continue
        for entry in dataclasses.fields(kind):
            option = OPTIONS.get(str(entry.type), entry.name)
            if option in second:
                found.append(f"{command}: --{option}, elsewhere --{second[option]}")
    assert not found
    assert {f.name for f in dataclasses.fields(Compare) if str(f.type) in OPTIONS} == {"n_jobs", "tasks"}
    assert all("name=" in str(kind) for kind in (Jobs, Scenarios))


def test_former_spellings_are_still_read():
    words = ["--n-jobs", "1", "--tasks=brake"]
    assert present_spelling(words) == ["--jobs", "1", "--scenario=brake"]
    assert set(FORMER.values()) <= {"--jobs", "--scenario"}


def test_a_command_without_any_argument_takes_the_usual_value():
    assert option_value([], "--scenario", "track") == "track"
    assert option_value(["--scenario"], "--scenario", "track") == "track"
    assert option_value(["--seed", "1", "--scenario", "brake"], "--scenario", "track") == "brake"


def test_soil_draws_a_soil_of_ones_own_and_says_all_that_is_wrong_with_one(lane, tmp_path, capsys):
    assert offroad("soil", lane, "--loads", "1000", "--slips", "0.1", "--out", tmp_path) == 0
    assert (tmp_path / "soil_lane.png").is_file()
    lane.write_text("soil: {base: clay, phi: 30, kphi: 2}\n")
    assert offroad("soil", lane) == 1
    said = capsys.readouterr().err
    assert "degrees?" in said
    assert "did you mean 'k_phi'?" in said


def test_the_page_of_keys_is_that_of_the_code(capsys):
    page = REPOSITORY / "docs" / "keys.md"
    assert page.read_text(encoding="utf-8") == reference(), "offroad keys --markdown > docs/keys.md"
    assert offroad("keys", "weights") == 0
    assert "per metre along the path" in capsys.readouterr().out


@pytest.mark.parametrize("section", SECTIONS)
def test_every_key_has_a_meaning_a_range_and_a_default(section):
    for row in SECTIONS[section].table():
        assert len(row.meaning) > 5, row
        assert row.allowed, row
        assert row.default or row.key == "reason", row


def test_the_example_is_short_and_stands_on_the_page():
    example = REPOSITORY / "examples" / "own_laboratory.py"
    source = example.read_text(encoding="utf-8")
    assert len(source.splitlines()) <= 60
    compile(source, str(example), "exec")
    page = (REPOSITORY / "docs" / "own.md").read_text(encoding="utf-8")
    assert "examples/own_laboratory.py" in page
    assert Path(example).is_file()


@pytest.mark.parametrize(
    "command",
    [lambda tasks: Compare(agent="aware", tasks=tasks).run(), lambda tasks: Benchmark(tasks=tasks).run()],
)
def test_two_scenarios_of_one_name_are_refused_in_one_command(lane, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidParameter, match="two different ones are called 'test_lane'"):
        command((str(lane), "{base: brake, name: test_lane, corridor: 3.0}"))


def test_one_scenario_may_be_given_twice_in_one_command(lane):
    assert known_scenarios(("speed", str(lane), str(lane), "test_lane")) == ("speed", *["test_lane"] * 3)


def corridor(name):
    return find_scenario(name).corridor


def test_an_edited_file_takes_the_place_of_the_former_one_in_other_processes_too(lane):
    for width in (2.5, 3.5):
        lane.write_text(LANE.replace("corridor: 2.5", f"corridor: {width}"))
        (name,) = known_scenarios((str(lane),))
        assert SCENARIOS[name].corridor == width
        assert set(Parallel(n_jobs=2)(delayed(corridor)(name) for _ in range(4))) == {width}
