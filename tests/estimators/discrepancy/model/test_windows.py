"""Hold-out tests on windows that no fit has seen, and how these windows are fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from estimators.discrepancy.checks.holdout_gain import Held, held_beside, held_out
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT, SELECT
from estimators.discrepancy.search import stepwise
from estimators.discrepancy.search.acceptance import Accepted, Refuted
from estimators.discrepancy.search.holdout import HoldOutResult, HoldOutTest
from estimators.discrepancy.search.refitting import refit
from offroad_env.physics import state as at

#: Of an unmodified accelerometer's constant error, five standard deviations [m/s^2].
BIAS = 0.1


def _fitted(log):
    return fit_runs([RunModel(log, use=FIT)]), [RunModel(log, use=SELECT)]


@pytest.fixture(scope="module")
def biased():
    return _fitted(simulated_log(draw_case(6, road="flat", duration=30.0), FAULTS["accel_bias_y"](BIAS)))


@pytest.fixture(scope="module")
def bumpy():
    return _fitted(simulated_log(draw_case(6, road="known", gnss=True, duration=30.0)))


def test_a_gain_of_random_sign_does_not_contradict_an_effect_and_a_clear_loss_does():
    assert not HoldOutResult(gain=-0.9, expected=0.8, deviation=1.6).contradicts
    assert HoldOutResult(gain=-54.0, expected=89.0, deviation=15.0).contradicts
    # What gains is nearer to the larger model than to the smaller one.
    assert not HoldOutResult(gain=4.0, expected=89.0, deviation=15.0).contradicts


def test_what_is_believed_of_a_sensor_counts_where_it_was_fitted_and_not_again(biased):
    fit, apart = biased
    larger = refit(fit, [Candidate(effect="accel_bias_y")], [BIAS])
    assert fit.cost - larger.cost > 5.0
    # Both models explain a constant error: the windows apart cannot tell them apart.
    result = HoldOutTest(fit, apart).result(larger)
    assert abs(result.gain) < 1.0
    assert result.expected < 1.0


@pytest.mark.parametrize(("most", "capped"), [(0, True), (1, False)])
def test_a_search_says_that_it_stopped_at_the_most_effects_of_a_model(biased, monkeypatch, most, capped):
    fit, apart = biased
    monkeypatch.setattr(stepwise, "MOST", most)
    found = stepwise.search(fit, ("accel_bias_x", "accel_bias_y"), 0.06, apart)
    assert len(found.causes) == most
    assert found.capped is capped


@pytest.mark.parametrize("together", [True, False])
def test_an_effect_that_windows_apart_contradict_is_a_step_and_no_end(biased, monkeypatch, together):
    """Of two effects that they confirm one alone may be contradicted; else it is an uncertain cause."""
    fit, apart = biased
    larger, other = (refit(fit, [Candidate(effect=f"accel_bias_{one}")], [BIAS]) for one in "yx")
    refuted = (Refuted(other, 40.0), Refuted(larger, 50.0))
    steps = iter([Accepted(None, [-5.0], refused=True, refuted=refuted), Accepted(None, [], refused=False)])
    begun: list[int] = []

    def onward(test, last, *_):
        begun.append(len(test.fit.candidates))
        return next(steps)

    monkeypatch.setattr(stepwise, "_onward", onward)
    monkeypatch.setattr(stepwise._Confirmed, "__call__", lambda self, model: together)
    found = stepwise.search(fit, ("accel_bias_y",), 0.06, apart)
    assert begun == [0, 1]
    assert [cause.best.candidate.effect for cause in found.causes] == ["accel_bias_y"]
    assert found.holdout_gains == (-5.0,)
    assert found.refused is not together
    assert found.uncertain == (() if together else (0,))


def test_a_true_effect_gains_what_is_expected(biased):
    case = draw_case(6, road="flat", duration=30.0)
    fit, apart = _fitted(simulated_log(case, FAULTS["rolling_resistance"](0.02)))
    larger = refit(fit, [Candidate(effect="rolling_resistance")], [0.02])
    result = HoldOutTest(fit, apart).result(larger)
    assert result.gain > 10.0
    assert abs(result.gain - result.expected) < 3.0 * result.deviation
    wrong = fit.with_effects([Candidate(effect="rolling_resistance")], [-0.02])
    wrong = replace(wrong, equations=larger.equations)
    assert HoldOutTest(fit, apart).result(wrong).contradicts


def test_what_null_residuals_scatter_along_the_difference_of_two_models_takes_weight_from_a_gain(biased):
    fit, apart = biased
    larger = fit.with_effects([Candidate(effect="rolling_resistance")], [0.01])
    larger = replace(larger, equations=refit(fit, larger.candidates, [0.01]).equations)
    plain = HoldOutTest(fit, apart).result(larger)
    assert plain.inflation == 1.0
    assert 0.0 < abs(plain.evidence) < abs(plain.gain)
    held = held_out(fit, apart)
    difference = held.residual - held_out(larger, apart, held).residual
    # A null residual like the difference itself has its length along it: twice the expected gain.
    scattered = HoldOutTest(fit, apart, null=difference[:, None]).result(larger)
    information = 2.0 * plain.expected
    assert scattered.gain == pytest.approx(plain.gain)
    assert scattered.inflation == pytest.approx(information, rel=1e-6)
    assert scattered.inflation > 2.0
    assert abs(scattered.evidence) < abs(plain.evidence)
    added = scattered.deviation**2 - plain.deviation**2
    assert added == pytest.approx((information - 1.0) * information, rel=1e-6)
    # What scatters less than white noise is no reason to trust a gain more.
    calm = HoldOutTest(fit, apart, null=1e-3 * difference[:, None]).result(larger)
    assert calm.inflation == 1.0


@pytest.mark.parametrize(
    ("gain", "expected", "deviation"), [(20.0, 30.0, 9.0), (-20.0, 30.0, 9.0), (-2534.4, 538.2, 277565.5)]
)
def test_evidence_is_the_likelihood_ratio_of_a_gain(gain, expected, deviation):
    """Of a window that magnifies what parameters are off, about to get stuck, it says next to nothing."""
    result = HoldOutResult(gain=gain, expected=expected, deviation=deviation)
    ratio = norm.logpdf(gain, expected, deviation) - norm.logpdf(gain, -expected, deviation)
    assert result.evidence == pytest.approx(ratio, rel=1e-4)
    assert replace(result, deviation=0.0, expected=0.0).evidence == 0.0


def test_a_window_that_began_in_another_valley_begins_again(bumpy):
    fit, apart = bumpy
    held = held_out(fit, apart)
    point = held.fit.point
    starts = tuple(start.copy() for start in point.starts)
    for start in starts:
        start[:, at.X] += 0.7
    astray = held.fit.moved(replace(point, starts=starts))
    lost = Held(fit=astray, residual=astray.residual, cost=astray.cost)
    assert lost.cost > 0.75 * len(lost.residual)
    again = held_beside(lost, held)
    assert again.cost == pytest.approx(held.cost, abs=1.0)
    assert held_beside(held, lost) is held


def test_a_fit_is_simulated_where_it_is_moved_and_not_again(bumpy, monkeypatch):
    fit, calls = bumpy[0], []
    simulate = RunModel.simulate
    monkeypatch.setattr(RunModel, "simulate", lambda *args: calls.append(args) or simulate(*args))
    first, cost = fit.residual, fit.cost
    assert np.array_equal(fit.residual, first)
    assert not calls
    nuisances, starts = fit.nuisances.copy(), tuple(start.copy() for start in fit.point.starts)
    nuisances[0] += 0.01
    starts[0][0, at.X] += 1.0
    for change in ({"nuisances": nuisances}, {"starts": starts}):
        moved = fit.moved(replace(fit.point, **change))
        assert len(calls) == len(fit.runs)
        assert not np.array_equal(moved.residual, first)
        assert (fit.residual is first, fit.cost) == (True, cost), "a fit is immutable"
        calls.clear()
