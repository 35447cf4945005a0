"""The study of the delay with which a change of the soil is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.benchmark.statistics import Interval
from agents.studies.detection_delay.figure import delay_figure
from agents.studies.detection_delay.results import DrivenLine, FilterLine
from agents.studies.detection_delay.study import Late, delays_of, driven_lines, filter_lines, run_unit
from offroad_env.environment.env import OffroadBekkerEnv


class Listener:
    """Remembers the n that it gets."""

    def reset(self, briefing):
        self.heard = []

    def act(self, observation):
        self.heard.append(float(observation["terrain"][0]))
        return np.zeros(2)


def test_a_delayed_agent_gets_the_prior_first_and_then_the_truth_of_a_while_ago():
    listener = Listener()
    agent = Late(listener, 0.06)
    for _ in range(2):  # a reset forgets what is under way
        agent.reset(OffroadBekkerEnv(scenario="patches").briefing)
        for n in (0.4, 0.5, 0.6, 0.7, 0.8):
            agent.act({"terrain": np.array([n, 0.0, 1.0])})
        assert listener.heard == pytest.approx([0.7, 0.7, 0.7, 0.4, 0.5])


def test_a_delay_counts_from_the_edge_to_an_estimate_near_the_new_soil():
    n = np.repeat([0.4, 0.6, 0.9, 0.95, 0.5], [50, 1, 100, 100, 50])
    mean = np.concatenate([np.full(60, 0.4), np.full(240, 0.88), np.full(1, 0.7)])
    # Up in two steps that are one change, answered at 60; 0.05 are no change; never down again.
    assert delays_of(n, mean) == [pytest.approx(10 * 0.02), math.inf]
    assert delays_of(n[:-30], mean[:-30]) == [pytest.approx(10 * 0.02)]  # no time is left for an answer
    assert delays_of(np.full(10, 0.5), np.full(10, 0.5)) == []


@pytest.mark.check
def test_a_delay_costs_time_and_a_filter_that_expects_changes_answers_sooner():
    keys = [("late", 0.0), ("late", 2.0), ("filter", "constant n"), ("filter", "changing n")]
    results = {(*key, i, 4, 0): run_unit(*key, i, 4, 0) for key in keys for i in range(2)}
    prompt, late = driven_lines(results)
    assert (prompt.failures, prompt.episodes) == (0, 2)
    assert late.score.value > prompt.score.value
    constant, changing = filter_lines(results)
    assert changing.delay < 0.5 * constant.delay
    assert changing.rmse < constant.rmse


def test_failures_stand_in_a_panel_of_their_own_and_no_number_on_a_marker():
    def line(name: str, delay: float, failures: int) -> DrivenLine:
        return DrivenLine(name, delay, Interval(42.0, 41.0, 43.0, 0.95), failures, 30)

    driven = [line("late", 0.0, 0), line("late", 0.5, 3), line("aware", float("nan"), 0)]
    found = FilterLine("changing n", 0.36, 1.0, 99, 0.06, 0.98, 1.0)
    times, failures = delay_figure(driven, [found]).axes
    assert [bar.get_height() for bar in failures.patches] == [0.0, 3.0]
    assert "of 30" in failures.get_ylabel()
    assert [text.get_text() for text in times.texts] == ["filter of a changing n"]
