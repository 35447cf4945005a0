"""Causes that make forecasts worse, or with which a model predicts nothing, are not named."""

import math
from dataclasses import replace

import pytest

from estimators.discrepancy.checks.forecast import Prediction, predictions
from estimators.discrepancy.diagnosis import diagnose, split_runs
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import Verdict


def forecast(quantity="position", *, extended, high=-0.1, horizon=3.0, kept=math.nan, kept_high=math.nan):
    """A forecast with an error of 1 by the nominal model."""
    return Prediction(
        quantity=quantity,
        unit="m",
        horizon=horizon,
        count=20,
        nominal=1.0,
        extended=extended,
        low=high - 0.2,
        high=high,
        kept=kept,
        kept_high=kept_high,
    )


@pytest.fixture(scope="module")
def late():
    """A diagnosis of a run whose steering is stamped 0.1 s late."""
    log = simulated_log(draw_case(31, road="flat", gnss=True, duration=20.0))
    steer = log.channels["steer"].copy()
    steer[10:], steer[:10] = steer[:-10], steer[0]
    return diagnose(
        [replace(log, channels={**log.channels, "steer": steer})], library=("steer_delay", "payload")
    )


def test_a_steering_that_is_stamped_late_is_named_as_one_that_acts_early(late):
    assert late.verdict is Verdict.NAMED
    summary = summarise(late)
    assert [cause.best.effect for cause in summary.causes] == ["steer_delay"]
    assert summary.causes[0].best.size == pytest.approx(-0.1, abs=0.02)
    assert "earlier than logged" in summary.sentence
    assert any(one.quantity == "heading" for one in late.forecasts)


def test_a_speed_forecast_is_compared_with_a_speed_that_stays_by_an_interval(late):
    # The part of the fit is long enough for an interval of short forecasts; it counts alone that it is one.
    runs = split_runs(late.logs)[FIT]
    found = predictions(late.search.nominal, late.model, runs)
    (speed,) = (one for one in found if one.quantity == "speed" and one.horizon == 1.0)
    assert 1.0 - speed.extended / speed.kept < speed.kept_high < 1.0
    others = [one for one in found if one.quantity != "speed"]
    assert others
    assert all(math.isnan(one.kept_high) for one in others)


@pytest.mark.parametrize(
    ("one", "refuted"),
    [
        (forecast(extended=2.1), True),
        (forecast(extended=1.9), False),
        (forecast(extended=2.1, high=0.01), False),
        (forecast("speed", extended=0.55, kept=0.54, high=0.5), True),
        (forecast("speed", extended=0.55, kept=0.54, kept_high=-0.01, high=0.5), True),
        (forecast("speed", extended=0.55, kept=0.54, kept_high=0.01, high=0.5), False),
        (forecast("speed", extended=1.05, kept=0.54, high=-0.01), True),
        (forecast("speed", extended=0.55, kept=0.56, high=0.5), False),
        (forecast("speed", extended=0.45, kept=0.1, high=0.5), False),
        (forecast("speed", extended=0.55, kept=0.54, high=0.5, horizon=10.0), False),
    ],
)
def test_a_forecast_that_gets_worse_takes_the_names_away(late, one, refuted):
    found = replace(late, forecasts=(one,))
    assert found.verdict is (Verdict.UNEXPLAINED if refuted else Verdict.NAMED)
    assert bool(found.named) is not refuted
    summary = summarise(found)
    assert (summary.extended_model is None) is refuted
    if refuted:
        asked = "torques those of the wheels" in summary.sentence
        assert asked is (one.quantity == "speed")
        assert asked is not ("forecasts worse" in summary.sentence)
