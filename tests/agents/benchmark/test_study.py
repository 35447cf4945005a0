"""The benchmark as a study: units that are kept, agents of one's own, the page, both forms."""

from __future__ import annotations

import json
import os
import textwrap
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import ttest_1samp

from agents.benchmark import study
from agents.benchmark.learned import learned_verdict, seed_interval, summarise_learned
from agents.benchmark.page import benchmark_sections, verdict
from agents.benchmark.runner import ENV_ID, MISMATCH, draw_episodes
from agents.benchmark.statistics import effect_size, recovered_share
from agents.benchmark.study import EPISODES, BenchmarkArgs, run_study
from agents.benchmark.summary import summarise
from agents.controllers.arms import ARMS, make_arm
from agents.controllers.protocol import ArmResult, EpisodeResult
from agents.controllers.tuned import COMMON_PLACES
from agents.driving.episode import find_agent
from agents.reports.page import Picture, render_page
from offroad_env.errors import InvalidParameter

SMALL = BenchmarkArgs(
    tasks=("brake",), agents=("conservative", "oracle"), forms=("matched",), episodes=2, n_jobs=1
)


def test_what_has_been_driven_is_not_driven_again(tmp_path, monkeypatch):
    first = run_study(SMALL, tmp_path)["brake", "matched"]
    monkeypatch.setattr(study, "drive_unit", None)
    again = run_study(SMALL, tmp_path)["brake", "matched"]
    assert again == first
    assert len((tmp_path / EPISODES).read_text(encoding="utf-8").splitlines()) == 4


def test_a_run_that_was_cut_off_goes_on_where_it_stopped(tmp_path):
    whole = run_study(SMALL, tmp_path)["brake", "matched"]
    lines = (tmp_path / EPISODES).read_text(encoding="utf-8").splitlines()
    (tmp_path / EPISODES).write_text("\n".join([*lines[:2], lines[2][:40]]), encoding="utf-8")
    again = run_study(SMALL, tmp_path)["brake", "matched"]
    for arm, arm_again in zip(whole.arms, again.arms, strict=True):
        assert arm.scores.tolist() == arm_again.scores.tolist()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tasks": ("moon",)}, "scenario must be one of"),
        ({"agents": ("nobody",)}, "agent must be one of"),
        ({"forms": ("triplet",)}, "form must be one of matched, mismatch"),
        ({"episodes": 1}, "at least 2"),
    ],
)
def test_what_cannot_be_run_is_refused_by_name(tmp_path, change, words):
    with pytest.raises(InvalidParameter, match=words):
        run_study(BenchmarkArgs(**change), tmp_path)


# ---------------------------------------------------------------------- the two forms


def test_the_forms_differ_in_nothing_but_the_factors_of_the_mismatch():
    matched = draw_episodes("speed", 20, 3)
    other = draw_episodes("speed", 20, 3, form="mismatch")
    assert [draw._replace(mismatch=None) for draw in other] == matched
    factors = np.array([draw.mismatch for draw in other])
    for column, (low, high) in zip(factors.T, MISMATCH.values(), strict=True):
        assert low <= column.min() < column.max() <= high
        assert column.std() > 0.15 * (high - low)


def test_a_mismatch_reaches_the_plant_and_nothing_that_anybody_believes():
    env = gym.make(ENV_ID, scenario="speed", terrain_info="estimate").unwrapped
    env.reset(seed=1, options={"n": 0.7})
    nominal, briefing = env.plant, env.briefing
    env.reset(seed=1, options={"n": 0.7, "mismatch": (1.1, 0.8, 1.4)})
    assert env.plant.vehicle.m == pytest.approx(1.1 * nominal.vehicle.m)
    assert env.plant.vehicle.torque_lag == pytest.approx(1.4 * nominal.vehicle.torque_lag)
    assert env.plant.soil.k_phi == pytest.approx(0.8 * nominal.soil.k_phi)
    assert env.plant.soil.n == 0.7
    assert env.briefing == briefing
    assert env.estimator.plant.vehicle == nominal.vehicle
    with pytest.raises(InvalidParameter, match="mass must be in"):
        env.reset(options={"mismatch": (-1.0, 1.0, 1.0)})


# ---------------------------------------------------------------------- knobs


@pytest.mark.parametrize(
    ("knobs", "form", "driver"),
    [
        (None, "matched", "aware"),
        ("own", "mismatch", "aware"),
        ("common", "matched", "aware_common"),
        (None, "natural", "aware"),
        ("common", "natural", "aware"),
        ("own", "natural", "aware_own"),
    ],
)
def test_arms_drive_with_the_usual_knobs_of_the_form_unless_others_are_asked_for(knobs, form, driver):
    args = replace(SMALL, knobs=knobs)
    assert args.driver("aware", form) == driver
    assert args.driver("pure_pursuit", form) == "pure_pursuit"


@pytest.mark.parametrize("task", sorted(COMMON_PLACES))
def test_with_common_knobs_arms_differ_by_nothing_but_what_they_believe(task):
    gains = {name: make_arm(name, scenario=task, knobs="common").agent.gains for name in ARMS}
    assert all(gain == gains["oracle"] for gain in gains.values())
    assert gains["oracle"] == make_arm("oracle", scenario=task).agent.gains
    with pytest.raises(InvalidParameter, match="knobs must be own or common"):
        make_arm("oracle", scenario=task, knobs="others")


def test_episodes_with_common_knobs_are_kept_apart(tmp_path):
    own = run_study(SMALL, tmp_path)["brake", "matched"]
    common = run_study(replace(SMALL, knobs="common"), tmp_path)["brake", "matched"]
    assert (common.arm("oracle").scores == own.arm("oracle").scores).all()
    assert (common.arm("conservative").scores != own.arm("conservative").scores).all()
    assert len((tmp_path / EPISODES).read_text(encoding="utf-8").splitlines()) == 8


# ---------------------------------------------------------------------- an agent of one's own


def test_an_agent_of_ones_own_drives_the_same_episodes(tmp_path, monkeypatch):
    source = """
        import numpy as np

        class Braker:
            def reset(self, briefing): ...
            def act(self, observation): return np.array([0.0, -1.0])

        class Mute:
            def reset(self, briefing): ...
        """
    (tmp_path / "own_agents.py").write_text(textwrap.dedent(source), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(os.fspath(tmp_path))
    args = BenchmarkArgs(
        tasks=("brake",), agents=("own_agents:Braker", "oracle"), forms=("matched",), episodes=2, n_jobs=1
    )
    result = run_study(args, tmp_path)["brake", "matched"]
    assert result.arm("own_agents:Braker").failures == {"time_limit": 2}
    assert result.arm("oracle").success.all()
    for name, words in (("own_agents:Mute", "no method act"), ("own_agents:Nobody", "no 'Nobody'")):
        with pytest.raises(InvalidParameter, match=words):
            find_agent(name, "brake", None)
    with pytest.raises(InvalidParameter, match=r"no module .no_such_module."):
        find_agent("no_such_module:Agent", "brake", None)


# ---------------------------------------------------------------------- the page


def made_up(name, scores):
    return ArmResult(
        name=name,
        time_limit=120.0,
        episodes=tuple(
            EpisodeResult(
                seed=i,
                n=0.3 + 0.02 * i,
                success=True,
                failure="",
                time=score,
                progress=300.0,
                score=score,
                reward=0.0,
                cross_track_rms=0.1,
                step_time=1e-4,
                env_time=2e-4,
            )
            for i, score in enumerate(scores)
        ),
    )


@pytest.fixture
def comparison():
    rng = np.random.default_rng(0)
    base = np.linspace(40.0, 50.0, 20)
    worse = {"nominal": 5.0, "conservative": 4.0, "aware": 1.0, "oracle": 0.0}
    return summarise(
        "speed", 0, tuple(made_up(name, base + more + rng.normal(0, 0.1, 20)) for name, more in worse.items())
    )


def test_the_verdict_says_what_knowing_is_worth_and_how_much_is_recovered(comparison):
    words = verdict(comparison)
    assert words.startswith("On speed, knowing n is worth 3.98 s (8 %)")
    assert "conservative" in words
    assert "recovers 7" in words


def test_where_nothing_shows_the_verdict_says_so():
    rng = np.random.default_rng(1)
    arms = tuple(made_up(name, 45.0 + rng.normal(0, 1.0, 20)) for name in ("nominal", "aware", "oracle"))
    result = summarise("speed", 0, arms)
    assert "do not show that knowing n pays" in verdict(result)
    assert result.recovered is None


def test_the_page_holds_every_comparison_with_its_numbers(comparison):
    picture = Picture(png=b"png", caption="physics")
    place = ("speed", "matched")
    trained = {place: [trained_arm("ppo_aware", 46.0), trained_arm("ppo_oblivious", 52.0)]}
    sections = benchmark_sections({place: comparison}, picture, trained, command="offroad", seconds=1.0)
    page = render_page(sections, title="t", intro="i", footer="f")
    words = ("What knowing the soil is worth", "speed, matched model", "Headroom:", "interquartile mean")
    for word in (*words, "ppo_oblivious", "trained policies do better with the estimate"):
        assert word in page
    assert json.loads(json.dumps(sections[-2].data))["better_uninformed"] == "conservative"


def trained_arm(name, score):
    episodes = {seed: ([score + 0.1 * seed, score], [True, True]) for seed in range(5)}
    return summarise_learned("speed", name, episodes)


def test_the_interval_of_a_trained_arm_is_students_over_its_seeds():
    values = [1.0, 2.0, 3.0, 4.0]
    expected = ttest_1samp(values, 0.0).confidence_interval()
    found = seed_interval(values)
    assert (found.value, found.low, found.high) == pytest.approx((2.5, expected.low, expected.high))
    assert seed_interval([1.0]).high == np.inf


@pytest.mark.parametrize(("aware", "says"), [(46.0, "do better"), (58.0, "do worse"), (52.05, "do not show")])
def test_trained_arms_differ_where_their_intervals_do_not_overlap(aware, says):
    arms = [trained_arm("ppo_aware", aware), trained_arm("ppo_oblivious", 52.0)]
    assert says in learned_verdict(arms, "s")


def test_policies_of_two_kinds_are_compared_with_their_own_kind():
    pairs = {
        "ppo_aware": 45.0,
        "ppo_oblivious": 52.0,
        "ppo_tracker_aware": 60.0,
        "ppo_tracker_oblivious": 55.0,
    }
    verdict = learned_verdict([trained_arm(name, score) for name, score in pairs.items()], "s")
    assert "trained policies do better" in verdict
    assert "policies that say the speed themselves do worse" in verdict


def test_the_recovered_share_is_one_for_the_oracle_and_none_for_the_uninformed():
    oracle, blind = np.linspace(1.0, 2.0, 30), np.linspace(2.0, 3.0, 30)
    assert recovered_share(oracle, oracle, (blind,)).value == pytest.approx(1.0)
    assert recovered_share(blind, oracle, (blind, blind + 1.0)).value == pytest.approx(0.0)
    half = recovered_share(0.5 * (oracle + blind), oracle, (blind,))
    assert half.low <= half.value == pytest.approx(0.5)


def test_the_effect_size_is_the_difference_in_units_of_its_spread():
    a = np.array([1.0, 2.0, 3.0, 4.0])
    assert effect_size(a, a) == 0.0
    assert effect_size(a + np.array([1.0, 2.0, 1.0, 2.0]), a) == pytest.approx(1.5 / 0.57735, rel=1e-4)
