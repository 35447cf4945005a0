"""The speed command: ratios are what they say, and what is promised of a fresh interpreter holds."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

import agents.studies.speed.fresh as fresh
import agents.studies.speed.study as study
from agents.commands.cli import main
from agents.studies.speed.drives import DRIVES
from agents.studies.speed.figure import speed_figure
from agents.studies.speed.fresh import Fresh
from agents.studies.speed.predictive import SolveTime, measure_solves
from agents.studies.speed.study import BARS, SIZES, Bar, Speed, compare
from agents.studies.speed.verdicts import VERDICT_BARS, VerdictTime
from helpers import run_fresh

TIMES = {
    # rounds x (CPU, clock) [s]
    "ours": np.array([[2e-5, 4e-5], [4e-5, 4e-5], [3e-5, 4e-5]]),
    "peer": np.array([[1e-5, 4e-5], [1e-5, 8e-5], [3e-5, 6e-5]]),
}


@pytest.mark.parametrize(
    ("bar", "expected"),
    [
        (Bar("ours", "peer"), (0.5, 0.25, 1.0)),
        (Bar("ours", "peer", rate=False), (2.0, 1.0, 4.0)),
        (Bar("ours", "peer", clock=True), (1.5, 1.0, 2.0)),
    ],
)
def test_a_ratio_is_taken_round_by_round(bar, expected):
    (ratio,) = compare(TIMES, [bar])
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx(expected)
    assert ratio.met is None


def test_a_rate_must_be_large_enough_and_a_time_small_enough():
    def met(**kinds):
        return compare(TIMES, [Bar("ours", "peer", **kinds)])[0].met

    assert met(bar=0.5)
    assert not met(bar=0.51)
    assert met(rate=False, bar=2.0)
    assert not met(rate=False, bar=1.99)


def test_a_peer_that_is_not_installed_is_left_out():
    assert compare(TIMES, [Bar("ours", "nobody"), Bar("nobody", "peer")]) == ()


def test_every_promise_is_about_sides_that_exist():
    ours = {"RK4 step on clay", "RK4 step on dry sand", "env.step", "env.step, parameter UKF"}
    ours |= {"env.step, joint filter", "update of the parameter UKF", "update of the joint UKF"}
    ours |= {f"vector of {count}{kind}" for count in SIZES for kind in ("", ", parameter UKF")}
    ours |= {"env.reset", "env.step, soil belief", "sample for the soil belief", *DRIVES}
    peers = {"Pendulum-v1", "HalfCheetah-v5", "mj_step of HalfCheetah", "racetrack-v0"}
    assert {bar.ours for bar in BARS} <= ours
    assert {bar.peer for bar in BARS} <= peers | ours


def test_a_quick_turn_does_not_shorten_what_settles_first(monkeypatch):
    """The first second of the belief holds its first reference: it alone would say 4.7 instead of 3.8."""
    taken = {}

    def side(name):
        return lambda steps: taken.setdefault(name, []).append(steps) or (steps * 1e-6, steps * 1e-6)

    names = ("env.step", "sample for the soil belief", "update of the parameter UKF", "env.step, soil belief")
    study._take_turns({name: (side(name), 1000) for name in names}, 1, 0.1, None)
    assert [taken[name][-1] for name in names] == [100, 1000, 1000, 1000]


def test_a_side_measures_the_steps_and_not_the_resets():
    """Episodes of one step, each with a reset a hundred times as long."""

    class Slow(gym.Env):
        action_space = observation_space = gym.spaces.Box(-1.0, 1.0, (1,))

        def reset(self, *, seed=None, options=None):
            sum(range(200_000))
            return np.zeros(1, np.float32), {}

        def step(self, action):
            return np.zeros(1, np.float32), 0.0, True, False, {}

    gym.register("Slow-v0", entry_point=lambda: Slow())
    try:
        cpu, clock = study._environment("Slow-v0", np.zeros((1, 1), np.float32))(50)
        assert cpu < 1e-3 / 2.0
        assert clock > 0.0
    finally:
        del gym.registry["Slow-v0"]


def some_speed(median_ms=11.0):
    times = {side: (1.0 + i) * TIMES["ours"] for i, bar in enumerate(BARS) for side in (bar.ours, bar.peer)}
    return Speed(
        ratios=compare(times),
        sides_us=dict.fromkeys(times, 1.0),
        vector_us={"env.step": {1: (50.0, 60.0), 64: (2500.0, 1300.0)}},
        missing=("racetrack-v0",),
        processors=2,
        rounds=3,
        diagnosis_s=3.0,
        verdicts=(
            VerdictTime(what="no fault", seconds=14.0, most=40.0, bar=15.0),
            VerdictTime(what="one effect", seconds=16.0, most=20.0, bar=15.0),
        ),
        solves=SolveTime(median_ms=median_ms, high_ms=2.0 * median_ms, decisions=300),
        fresh=Fresh(
            import_s=0.1,
            import_others_s=0.3,
            first_step_s=0.8,
            compile_s=(15.0, 16.0),
            compile_filter_s=None,
            peak_mb=190.0,
            per_environment_kb=100.0,
            state_kb=3.3,
        ),
    )


def test_the_command_prints_promises_and_writes_numbers_and_figure(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(study, "measure_speed", lambda **_: some_speed())
    with pytest.raises(SystemExit) as left:
        main(["speed", "--out", str(tmp_path), "--json", str(tmp_path / "speed.json")])
    assert left.value.code == 0
    printed = capsys.readouterr().out
    assert "MISSED" in printed
    assert "racetrack-v0 is not installed" in printed
    assert "diagnosis of a log of 60 s: 3.0 s" in printed
    rows = {line.split("  ")[0].strip(" │"): line for line in printed.splitlines()}
    assert "MISSED" in rows["one effect"]
    assert "MISSED" not in rows["no fault"]
    assert "15.0 s of CPU time, 16.0 s by the clock" in printed
    assert (tmp_path / "speed.png").stat().st_size > 10_000
    numbers = json.loads((tmp_path / "speed.json").read_text(encoding="utf-8"))
    assert len(numbers["ratios"]) == len(BARS)
    assert numbers["fresh"]["peak_mb"] == 190.0
    assert numbers["solves"]["median_ms"] == 11.0


@pytest.mark.parametrize("median_ms", [40.0, 40.1])
def test_a_decision_of_predictive_control_takes_forty_milliseconds_at_most(
    monkeypatch, tmp_path, capsys, median_ms
):
    monkeypatch.setattr(study, "measure_speed", lambda **_: some_speed(median_ms))
    with pytest.raises(SystemExit):
        main(["speed", "--out", str(tmp_path)])
    (line,) = (row for row in capsys.readouterr().out.splitlines() if "a decision of nmpc_truth" in row)
    assert f"{median_ms:.1f} ms" in line
    assert ("MISSED" in line) == (median_ms > 40.0)


def test_decisions_are_measured_one_by_one():
    pytest.importorskip("casadi", reason="needs the extra mpc")
    solves = measure_solves(5)
    assert solves.decisions == 5
    assert 0.1 < solves.median_ms <= solves.high_ms


def test_the_figure_shows_every_ratio_of_rates():
    speed = some_speed()
    labels = [label.get_text() for label in speed_figure(speed).axes[0].get_yticklabels()]
    assert len(labels) == sum(bar.rate for bar in BARS)


def test_the_package_itself_loads_no_compiler_and_no_solver():
    loaded = run_fresh("import offroad_env, sys; print(*sys.modules)").split()
    assert not {"numba", "scipy", "matplotlib"} & set(loaded)


def test_an_environment_without_a_filter_loads_no_solvers():
    code = (
        "import gymnasium as gym, numpy as np, sys\n"
        "env = gym.make('offroad_env:OffroadBekker-v0', scenario='speed')\n"
        "env.reset(seed=0); env.step(np.zeros(2)); print(*sys.modules)"
    )
    assert not {
        "scipy.optimize",
        "scipy.interpolate",
        "scipy.special",
        "filterpy",
        "matplotlib",
        "pydantic",
    } & set(run_fresh(code).split())


def test_one_environment_needs_less_than_250_megabytes():
    run_fresh(fresh._ONE.replace("print(peak())", ""))  # what is not compiled yet would count as well
    assert fresh._fresh(fresh._PEAK + fresh._ONE)[0] < 250.0


def test_the_record_of_an_episode_is_smaller_than_four_kilobytes():
    assert gym.make("offroad_env:OffroadBekker-v0").unwrapped.memory_size < 4096


@pytest.mark.parametrize("compiled", [True, False])
def test_a_first_compilation_is_announced_once(monkeypatch, tmp_path, caplog, compiled):
    import offroad_env.environment.control_period as period

    if compiled:
        (tmp_path / "module").mkdir()
        (tmp_path / "module/period_full-1.py311.nbi").touch()
    monkeypatch.setattr(period, "cache_folder", lambda _: tmp_path)
    period.announce_compilation.cache_clear()
    period.say_once.cache_clear()
    for _ in range(2):
        period.announce_compilation()
    assert len(caplog.records) == (0 if compiled else 1)


def test_a_verdict_has_the_time_that_its_bar_allows():
    assert dict(VERDICT_BARS) == {"no fault": 15.0, "one effect": 15.0, "another structure": 90.0}
    for seconds, met in ((15.0, True), (15.1, False)):
        assert VerdictTime(what="no fault", seconds=seconds, most=60.0, bar=15.0).met is met
