"""A search leaves a poor minimum, whether an effect leads out of it or the stated numbers do."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.fit import begun_afresh, fit_runs, with_null_simulations
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.linearisation import Jacobian
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.search import lower_minimum as lower_minimum_module
from estimators.discrepancy.search import stepwise
from estimators.discrepancy.search.lower_minimum import begun_again, lower_minimum
from estimators.discrepancy.search.refitting import refit
from offroad_env.errors import SolverFailure

_PAYLOAD = [Candidate(effect="payload")]


def _fitted(fault=None):
    case = draw_case(31, road="flat", natural=True, duration=12.0)
    return fit_runs([RunModel(simulated_log(case, fault))])


def _away(fit, name, deviations):
    """The fit with one number moved, and nothing fitted."""
    moved = fit.nuisances.copy()
    place = [nuisance.name for nuisance in fit.problem.nuisances].index(name)
    moved[place] += deviations * fit.problem.nuisance_spread[place]
    return fit.moved(replace(fit.point, nuisances=moved))


@pytest.fixture(scope="module")
def sound():
    """A fit to a drive without a fault, and the model with a load that comes to nothing."""
    fit = _fitted()
    return fit, refit(fit, _PAYLOAD, [0.0])


def test_a_gain_without_a_size_is_the_smaller_model_s_own(sound):
    fit, larger = sound
    poor = _away(fit, "mass", 3.0)
    assert poor.cost > fit.cost + 10.0
    lower = lower_minimum(poor, larger, 3.4)
    assert lower.candidates == ()
    assert lower.minus_log_likelihood == pytest.approx(fit.minus_log_likelihood, abs=1.0)


def test_a_minimum_that_is_none_the_lower_is_left_alone(sound):
    assert lower_minimum(*sound, 3.4) is None


@pytest.mark.check
def test_a_significant_size_is_evidence():
    fit = _fitted(FAULTS["payload"](0.5))
    larger = refit(fit, _PAYLOAD, [0.5])
    assert larger.sizes[0] / larger.size_deviations()[0] > 3.4
    assert lower_minimum(_away(fit, "mass", 3.0), larger, 3.4) is None


def test_a_model_that_has_left_the_stated_numbers_is_begun_again(sound):
    fit, _ = sound
    assert begun_again(fit) is fit
    assert begun_again(_away(fit, "mass", 2.0)).nuisances == pytest.approx(_away(fit, "mass", 2.0).nuisances)
    again = begun_again(_away(fit, "mass", 6.0))
    assert np.all(np.abs(again.nuisances) < 5.0 * fit.problem.nuisance_spread)
    assert again.minus_log_likelihood == pytest.approx(fit.minus_log_likelihood, abs=2.0)


def test_it_begins_from_several_exponents_and_the_best_is_fitted(sound, monkeypatch):
    away, asked, real = _away(sound[0], "mass", 6.0), {}, begun_afresh

    def begun(fit, candidates, sizes, *, n=None):
        if n == 0.3:
            raise SolverFailure("sinks")
        asked[n] = real(fit, candidates, sizes, n=n)
        return asked[n]

    ended = []
    monkeypatch.setattr(lower_minimum_module, "begun_afresh", begun)
    monkeypatch.setattr(lower_minimum_module, "settled", lambda fit, fresh: ended.append(fit) or fit)
    begun_again(away)
    assert list(asked) == [None, 0.5, 0.9, 1.1]
    assert ended[0].first_cost == pytest.approx(min(one.cost for one in asked.values()))


def test_a_rough_fit_begins_with_its_exponent_and_the_numbers_stay_if_they_shall(sound):
    fit, _ = sound
    problem = fit.problem
    numbers = [i for i, nuisance in enumerate(problem.nuisances) if nuisance.tolerated]
    assert problem.exponent(problem.with_exponent(problem.stated(), 0.31)) == pytest.approx(0.31)
    kept = begun_afresh(fit, _PAYLOAD, [0.3], n=0.5, numbers=False)
    assert not kept.nuisances[numbers].any() or np.flatnonzero(kept.nuisances[numbers]).tolist() == [0]
    assert begun_afresh(fit, _PAYLOAD, [0.3]).nuisances[numbers].all()
    # Beside another's derivatives they stay, too, and move again with derivatives of their own.
    beside = begun_afresh(fit, _PAYLOAD, [0.2], kept, numbers=False)
    assert np.count_nonzero(beside.nuisances[numbers]) <= 1
    free = GaussNewton(rounds=1).descend(replace(beside, jacobian=Jacobian()))
    assert np.count_nonzero(free.nuisances[numbers]) > 5


def test_no_model_is_begun_again_that_does_not_drive_as_logged_from_there(sound, monkeypatch):
    away = _away(sound[0], "mass", 6.0)
    monkeypatch.setattr(lower_minimum_module, "HOPELESS", 1e-3)
    assert begun_again(away) is away


def test_a_rough_fit_beside_another_takes_its_derivatives(sound):
    fit, _ = sound
    first = begun_afresh(fit, _PAYLOAD, [0.1])
    second = begun_afresh(fit, _PAYLOAD, [0.4], first)
    assert second.jacobian.states is first.jacobian.states
    assert second.jacobian.nuisances is first.jacobian.nuisances
    # The size may move, so that both come down; far from where the other began.
    assert second.cost < 1.5 * first.cost


def test_null_simulations_are_made_once_and_not_where_all_noise_is_white(sound):
    fit, _ = sound
    assert fit.null is not None
    assert with_null_simulations(fit) is fit
    without = replace(fit, null=None)
    assert with_null_simulations(without).null is not None
    white = replace(without, white=True)
    assert with_null_simulations(white) is white


def test_a_search_begins_again_from_the_better_minimum(sound, monkeypatch):
    """An effect leads out of a poor minimum, and is then no cause."""
    fit, larger = sound
    begun, onward = [], stepwise._onward

    def first_accepted(test, last, bar, rate):
        begun.append(last.fit)
        if len(begun) == 1:
            return stepwise._Accepted(larger, [1.0], refused=False)
        return onward(test, last, bar, rate)

    monkeypatch.setattr(stepwise, "_onward", first_accepted)
    found = stepwise.search(_away(fit, "mass", 3.0), ("payload", "torque_scale"), 0.06)
    assert len(begun) == 2
    assert found.causes == ()
    assert found.nominal.minus_log_likelihood == pytest.approx(fit.minus_log_likelihood, abs=1.0)
