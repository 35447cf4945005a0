"""What windows that no fit has seen say of a larger model, and how they are fitted."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.discrepancy.fit import Candidate, fit_runs
from estimators.discrepancy.gain import Held, held_beside, held_out
from estimators.discrepancy.gate import Gate, Word
from estimators.discrepancy.hide import HIDERS, draw_case, hidden_log
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.search import refit
from estimators.discrepancy.windows import FIT, SELECT
from offroad_env.physics import state as at

#: Of a healthy accelerometer's constant error, five standard deviations [m/s^2].
BIAS = 0.1


def _fitted(log):
    return fit_runs([RunModel(log, use=FIT)]), [RunModel(log, use=SELECT)]


@pytest.fixture(scope="module")
def biased():
    return _fitted(hidden_log(draw_case(6, road="flat", duration=30.0), HIDERS["accel_bias_y"](BIAS)))


@pytest.fixture(scope="module")
def bumpy():
    return _fitted(hidden_log(draw_case(6, road="known", gnss=True, duration=30.0)))


def test_a_coins_toss_is_no_word_against_an_effect_and_a_clear_loss_is():
    assert not Word(gain=-0.9, expected=0.8, scatter=1.6).contradicts
    assert Word(gain=-54.0, expected=89.0, scatter=15.0).contradicts
    # What gains is nearer to the larger model than to the smaller one.
    assert not Word(gain=4.0, expected=89.0, scatter=15.0).contradicts


def test_what_is_believed_of_a_sensor_counts_where_it_was_fitted_and_not_again(biased):
    fit, apart = biased
    larger, cost = refit(fit, [Candidate(effect="accel_bias_y")], [BIAS])
    assert fit.cost_of(fit.residual()) - cost > 5.0
    # Both models explain a constant error: the windows apart cannot tell them apart.
    word = Gate(fit, apart).word(larger)
    assert abs(word.gain) < 1.0
    assert word.expected < 1.0


def test_a_true_effect_gains_what_is_expected(biased):
    case = draw_case(6, road="flat", duration=30.0)
    fit, apart = _fitted(hidden_log(case, HIDERS["rolling_resistance"](0.02)))
    larger, _ = refit(fit, [Candidate(effect="rolling_resistance")], [0.02])
    word = Gate(fit, apart).word(larger)
    assert word.gain > 10.0
    assert abs(word.gain - word.expected) < 3.0 * word.scatter
    wrong = fit.with_effects([Candidate(effect="rolling_resistance")], [-0.02])
    wrong.shares = larger.shares
    assert Gate(fit, apart).word(wrong).contradicts


def test_a_window_that_began_in_another_valley_begins_again(bumpy):
    fit, apart = bumpy
    held = held_out(fit, apart)
    astray = held.fit.branch()
    for start in astray.starts:
        start[:, at.X] += 0.7
    lost = Held(fit=astray, residual=astray.residual(), cost=astray.cost_of(astray.residual()))
    assert lost.cost > 0.75 * len(lost.residual)
    again = held_beside(lost, held)
    assert again.cost == pytest.approx(held.cost, abs=1.0)
    assert held_beside(held, lost) is held


def test_a_point_is_simulated_once(bumpy, monkeypatch):
    fit, calls = bumpy[0].branch(), []
    simulate = RunModel.simulate
    monkeypatch.setattr(RunModel, "simulate", lambda *args: calls.append(args) or simulate(*args))
    first = fit.residual()
    before = len(calls)
    assert np.array_equal(fit.residual(), first)
    assert len(calls) == before
    for change in (
        lambda: fit.nuisances.__setitem__(0, 0.01),
        lambda: fit.starts[0].__setitem__((0, at.X), 1.0),
    ):
        change()
        assert not np.array_equal(fit.residual(), first)
