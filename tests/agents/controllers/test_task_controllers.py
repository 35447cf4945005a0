"""The controllers of the tasks do what the soil allows, and what the belief says changes what they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agents.benchmark.runner import Draw, draw_episodes, run_jobs
from agents.controllers.arms import ArmSettings, make_arm
from agents.controllers.speed_control import SpeedGains, gentle_target
from agents.controllers.speed_planner import SoilTracker
from agents.controllers.traction_limits import soil_capability
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.world.soils import SOILS
from offroad_env.world.vehicles import VEHICLES


@pytest.fixture(scope="module")
def loam():
    return soil_capability(VEHICLES["mrzr"], SOILS["sandy_loam"], (0.3, 1.1))


def drive(scenario, name, n, settings=None, seed=5):
    arm = make_arm(name, scenario=scenario, settings=settings or ArmSettings())
    return run_jobs(scenario, {"arm": arm}, [Draw(seed, n)], n_jobs=1)["arm"].episodes[0]


def test_the_best_slip_falls_with_n_and_is_the_slip_of_the_largest_pull(loam):
    slips = [loam.best_slip(n, n) for n in (0.3, 0.5, 0.8, 1.1)]
    assert slips == sorted(slips, reverse=True)
    for n, slip in zip((0.3, 0.5, 0.8, 1.1), slips, strict=True):
        row = loam.pull[int(np.argmin(np.abs(loam.grid - n)))]
        assert loam.slips[int(np.argmax(row))] == pytest.approx(slip, abs=0.021)


def test_who_does_not_know_n_takes_the_slip_with_the_least_regret(loam):
    slip = loam.best_slip(0.3, 1.1)
    assert loam.best_slip(1.1, 1.1) < slip < loam.best_slip(0.3, 0.3)
    regret = (loam.pull.max(axis=1, keepdims=True) - loam.pull).max(axis=0)
    assert regret[int(np.argmin(np.abs(loam.slips - slip)))] == regret.min()


@pytest.mark.check
def test_on_the_hill_who_knows_the_firm_soil_gets_further_than_who_fears_the_soft_one():
    knowing, fearing = (drive("climb", name, 0.35).progress for name in ("oracle", "conservative"))
    assert knowing > fearing + 3.0


@pytest.mark.parametrize("n", [0.4, 1.0])
def test_the_line_is_reached_and_not_crossed(n):
    episode = drive("brake", "oracle", n, ArmSettings(brake_share=0.9))
    assert episode.success
    assert episode.time < drive("brake", "oracle", n, ArmSettings(brake_share=0.3)).time


def test_who_believes_in_twice_the_brakes_crosses_the_line():
    assert drive("brake", "nominal", 0.3, ArmSettings(brake_share=2.0, n=1.0)).failure == "overran"


def test_a_driver_who_knows_nothing_slows_down_before_a_line_only():
    assert gentle_target(8.0, 3.0, 0.0) == 8.0
    speeds = [gentle_target(8.0, distance, 3.0) for distance in (1.0, 5.0, 20.0, 80.0)]
    assert speeds[0] == 0.0
    assert speeds == sorted(speeds)
    assert speeds[-1] == 8.0


def test_on_rough_ground_feeling_alone_keeps_the_limit():
    settings = ArmSettings(ride_speed=8.0, ride_feel=1.0, ride_share=0.6)
    assert drive("ride", "nominal", 0.4, settings).success
    assert drive("ride", "nominal", 0.4, replace(settings, ride_feel=0.0)).failure == "too_rough"


@pytest.mark.parametrize("scenario", ["climb", "brake", "ride"])
def test_the_briefing_says_what_the_task_demands(scenario):
    briefing = OffroadBekkerEnv(scenario=scenario).briefing
    assert (briefing.stop_zone > 0.0) == (scenario == "brake")
    assert np.isfinite(briefing.shake_limit) == (scenario == "ride")
    assert briefing.time_limit == (40.0 if scenario == "brake" else 120.0)


def observed(speed, curvature, n=0.9):
    """On the path, at that speed, in a bend of that curvature that does not end."""
    path = [0.0, 0.0, 0.0] + [curvature] * 8 + [100.0]
    return {
        "path": np.array(path),
        "motion": np.array([speed, speed, speed, 0.0, 0.0]),
        "terrain": np.array([n, 0.0, 1.0]),
    }


@pytest.mark.parametrize("integral", [0.0, 1.0])
def test_what_could_not_be_reached_is_made_up_for_in_the_next_bend_by_an_integral_only(integral):
    env = OffroadBekkerEnv(scenario="speed")
    agent = make_arm("oracle", scenario="speed", settings=ArmSettings(integral=integral)).agent
    agent.reset(env.briefing)
    for _ in range(200):  # four seconds in a wide bend, at less than its speed: the vehicle cannot do better
        assert agent.act(observed(6.0, 0.04))[1] > 0.0
    bend = observed(6.0, 0.1)
    assert (agent.act(bend)[1] < 0.0) == (integral == 0.0)


@pytest.mark.check
def test_where_soil_changes_who_knows_what_drive_a_bend_takes_needs_no_integral():
    def plain(believe, gains):
        return SoilTracker(believe, replace(gains, turning=False, speed=SpeedGains(k_i=0.0)))

    settings = ArmSettings(margin=0.9, slip_angle=0.32, feed_forward=0.9, integral=0.0)
    arms = {
        name: make_arm("oracle", scenario="patches", settings=settings, tracker=tracker)
        for name, tracker in {"knows": None, "plain": plain}.items()
    }
    results = run_jobs("patches", arms, draw_episodes("patches", 5, 7, training=True), n_jobs=1)
    assert results["knows"].success.all()
    assert results["knows"].scores.mean() < 0.985 * results["plain"].scores.mean()


@pytest.mark.check
def test_on_soil_that_changes_the_estimate_is_worth_time():
    draws = draw_episodes("patches", 5, 7, training=True)
    arms = {name: make_arm(name, scenario="patches") for name in ("aware", "conservative")}
    results = run_jobs("patches", arms, draws, n_jobs=1)
    assert results["aware"].success.all()
    assert results["aware"].scores.mean() < 0.95 * results["conservative"].scores.mean()
