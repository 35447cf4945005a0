"""Positions against a heading that is the integral of a turn, which is not known everywhere."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.logs import plausibility
from estimators.logs.log import Log
from estimators.logs.plausibility import violations_of


def driven(log: Log, *, course: bool) -> Log:
    """A path with bends that slows down to a crawl and turns, where steering tells no rate of turn."""
    t = log.times
    crawls = (t > 8.0) & (t < 17.0)
    speed = np.where(crawls, 0.8, 3.0)
    turn = np.where(crawls, 0.35, 0.25 * np.sin(0.8 * t))
    step = np.diff(t, prepend=t[0])
    heading = np.cumsum(turn * step)
    v = log.vehicle
    channels = {
        "speed": speed,
        "x": np.cumsum(speed * np.cos(heading) * step),
        "y": np.cumsum(speed * np.sin(heading) * step),
        "steer": np.arctan(turn * (v.l_f + v.l_r) / speed),
        "a_y": turn * speed,
    }
    if course:
        channels["course"] = np.arctan2(np.sin(heading), np.cos(heading))
    return replace(log, channels=channels)


@pytest.fixture(scope="module")
def drive() -> Log:
    return simulated_log(draw_case(43, duration=30.0))


def of_positions(log: Log) -> set[str]:
    return {name for one in violations_of(log)[0] for name in one.channels if name in ("x", "y")}


@pytest.mark.parametrize("course", [False, True])
def test_a_crawl_whose_turn_nothing_tells_is_no_contradiction_of_the_path(drive, course):
    assert not of_positions(driven(drive, course=course))


@pytest.mark.parametrize("course", [False, True])
def test_a_path_that_is_wrong_is_found_beside_a_crawl(drive, course):
    log = driven(drive, course=course)
    wrong = {**log.channels, "y": 3.0 * log.channels["y"]}
    assert "y" in of_positions(replace(log, channels=wrong))


@pytest.mark.parametrize("course", [False, True])
def test_where_no_turn_is_known_at_all_positions_are_not_judged(drive, course, monkeypatch):
    def witnessed(windows, what, *others):
        found = original(windows, what, *others)
        return found * np.nan if what == "turn" else found

    original = plausibility._witnessed
    monkeypatch.setattr(plausibility, "_witnessed", witnessed)
    assert not of_positions(driven(drive, course=course))
