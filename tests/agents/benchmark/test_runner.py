"""Whole episodes: arms on paired episodes, and policies that must not score."""

from __future__ import annotations

import dataclasses
import json
import math

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.figure import arms_figure
from agents.benchmark.runner import ENV_ID, Draw, draw_episodes, run_arms, run_episode, run_jobs
from agents.benchmark.summary import summarise
from agents.controllers.arms import ArmSettings, make_arm
from agents.controllers.protocol import ArmResult, EpisodeResult
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.controllers.stanley import StanleyAgent
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.errors import InvalidParameter


@pytest.fixture(scope="module", params=sorted(SCENARIOS))
def env(request):
    made = gym.make(ENV_ID, scenario=request.param)
    yield made
    made.close()


@pytest.mark.parametrize("agent", [PurePursuitAgent, StanleyAgent])
def test_the_simple_trackers_arrive_on_every_soil(env, agent):
    for n in (0.4, 1.0):
        episode = run_episode(env, agent(), 3, n=n)
        assert episode.success, episode.failure
        assert episode.progress > 30.0  # on the hill nobody arrives
        assert episode.cross_track_rms < 0.7


def without_clock(arm):
    return [dataclasses.replace(episode, step_time=0.0, env_time=0.0) for episode in arm.episodes]


def test_the_same_seed_gives_the_same_result_to_the_last_digit():
    draws = draw_episodes("speed", 1, 5)
    first, second = (run_jobs("speed", {"a": make_arm("aware")}, draws, n_jobs=1)["a"] for _ in range(2))
    assert without_clock(first) == without_clock(second)


def test_who_knows_the_soil_arrives_earlier_on_soil_that_holds():
    draws = [Draw(7, 0.7)]
    jobs = {name: make_arm(name) for name in ("conservative", "oracle")}
    arms = run_jobs("speed", jobs, draws, n_jobs=1)
    assert arms["oracle"].success.all()
    assert arms["oracle"].time[0] < arms["conservative"].time[0] - 0.5


def test_who_believes_the_firmest_soil_leaves_the_corridor_on_the_softest():
    bold = ArmSettings(margin=1.0, slip_angle=0.3, feed_forward=1.0, n=1.0)
    arms = run_jobs("speed", {"bold": make_arm("nominal", settings=bold)}, [Draw(7, 0.35)], n_jobs=1)
    assert arms["bold"].failures == {"left_corridor": 1}


def test_a_run_reports_its_progress_and_ends_in_json(tmp_path):
    seen = []
    result = run_arms(
        "speed", 2, seed=1, n_jobs=1, arms=("conservative",), progress=lambda *at: seen.append(at)
    )
    assert seen[-1] == (2, 2)
    table = json.loads(result.save(tmp_path / "arms.json").read_text(encoding="utf-8"))
    assert table["summaries"][0]["name"] == "conservative"
    assert len(table["arms"][0]["episodes"]) == 2


def test_a_soil_of_ones_own_is_driven_with_its_own_n():
    world = {"soil": "{base: clay, n: 0.9}"}
    result = run_arms("speed", 2, n_jobs=1, arms=("conservative",), env_options=world)
    assert [episode.n for episode in result.arm("conservative").episodes] == [0.9, 0.9]


def test_draws_cover_the_prior_and_training_never_sees_a_test_episode():
    test, training = draw_episodes("speed", 30, 0), draw_episodes("speed", 30, 0, training=True)
    low, high = SCENARIOS["speed"].n_range
    strata = sorted(math.floor(30 * (draw.n - low) / (high - low)) for draw in test)
    assert strata == list(range(30))
    assert not {draw.seed for draw in test} & {draw.seed for draw in training}


def made_up(name, times, failures=()):
    """An arm whose episode i took ``times[i]``, and failed where i is in ``failures``."""
    return ArmResult(
        name=name,
        time_limit=120.0,
        episodes=tuple(
            EpisodeResult(
                seed=i,
                n=0.5,
                success=i not in failures,
                failure="left_corridor" if i in failures else "",
                time=t,
                progress=300.0,
                reward=0.0,
                score=120.0 if i in failures else t,
                cross_track_rms=0.1,
                step_time=1e-4,
                env_time=2e-4,
            )
            for i, t in enumerate(times)
        ),
    )


@pytest.fixture
def comparison():
    base = np.linspace(40.0, 50.0, 12)
    return summarise(
        "speed",
        0,
        (
            made_up("nominal", base - 2.0, failures=range(6)),
            made_up("conservative", base + 4.0),
            made_up("aware", base + 1.0),
            made_up("oracle", base),
        ),
    )


def test_a_failed_episode_costs_the_time_limit(comparison):
    nominal = comparison.arm("nominal")
    assert nominal.scores[:6].tolist() == [120.0] * 6
    assert nominal.failures == {"left_corridor": 6}
    assert comparison.finished_by_all == 6


def test_headroom_and_recovered_share_are_counted_from_the_better_uninformed_arm(comparison):
    assert comparison.better_uninformed == "conservative"
    assert comparison.headroom.value == pytest.approx(4.0)
    assert comparison.oracle_minus_uninformed.value == pytest.approx(-4.0)
    assert comparison.recovered.value == pytest.approx(0.75)
    assert next(d for d in comparison.against if d.name == "oracle").wins.value == 1.0


def test_the_figure_shows_every_arm_and_every_episode(comparison):
    figure = arms_figure(comparison)
    episodes, score, *_ = figure.axes
    assert [label.get_text() for label in score.get_yticklabels()] == [arm.name for arm in comparison.arms]
    assert sum(len(line.get_xdata()) for line in episodes.lines[:8]) == 4 * 12
    figure.canvas.draw()


def test_one_episode_has_no_interval():
    with pytest.raises(InvalidParameter, match="at least 2"):
        run_arms("speed", 1)


@pytest.mark.parametrize(
    "world",
    [
        {"soil": {"base": "clay", "n": 0.9}},
        {"randomise": {"n": [0.5, 0.55]}},
        {"randomise": {"soil": ["clay"]}},
    ],
    ids=["own soil", "own n", "own soils"],
)
@pytest.mark.parametrize("form", ["matched", "mismatch"])
def test_an_n_that_the_world_decides_is_left_to_it(world, form):
    draws = draw_episodes("speed", 4, 0, form=form, world=world)
    plain = draw_episodes("speed", 4, 0, form=form)
    assert all(draw.n is None for draw in draws)
    assert [draw.seed for draw in draws] == [draw.seed for draw in plain]
    assert [draw.mismatch for draw in draws] == [draw.mismatch for draw in plain]
    assert draw_episodes("speed", 4, 0, form=form, world={"soil": "clay", "tyre": None}) == plain
    with gym.make(ENV_ID, scenario="speed", **world) as env:
        for draw in draws:
            n = env.reset(seed=draw.seed, options=draw.options)[1]["n"]
            if "soil" in world:
                assert n == pytest.approx(0.9)
            elif "n" in world["randomise"]:
                assert 0.5 <= n <= 0.55
