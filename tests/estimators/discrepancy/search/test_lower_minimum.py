"""A search leaves a poor minimum, whether an effect leads out of it or the stated numbers do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.fit import begun_afresh, fit_runs, unfitted_cost, with_null_simulations
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.linearisation import Jacobian
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.search import lower_minimum as lower_minimum_module
from estimators.discrepancy.search import stepwise
from estimators.discrepancy.search.acceptance import Accepted
from estimators.discrepancy.search.lower_minimum import begun_again, beside_rejected, exponents, lower_minimum
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


def test_a_rejected_effect_leads_to_a_better_minimum_whatever_its_size(sound):
    fit, larger = sound
    strong = larger.with_effects(_PAYLOAD, [0.02])
    assert np.abs(strong.sizes) / strong.size_deviations() > 0.01
    poor = _away(fit, "mass", 6.0)
    assert lower_minimum(poor, strong, 0.01) is None
    lower = beside_rejected(poor, [larger, strong], 0.01)
    assert lower.candidates == ()
    assert lower.minus_log_likelihood == pytest.approx(fit.minus_log_likelihood, abs=1.0)
    assert beside_rejected(poor, [], 0.01) is None


def test_beside_a_rejected_effect_nothing_is_sought_for_a_model_that_is_about_as_stated(sound):
    fit, larger = sound
    poor = _away(fit, "mass", 2.5)
    assert lower_minimum(poor, larger, 3.4) is not None
    assert beside_rejected(poor, [larger], 3.4) is None


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


@pytest.mark.parametrize("n", [0.3, 1.1])
def test_it_begins_from_the_exponent_that_costs_least_unfitted(sound, monkeypatch, n):
    away, asked = _away(sound[0], "mass", 6.0), []

    def begun(fit, candidates, sizes, *, n):
        asked.append(n)
        raise SolverFailure("sinks")

    monkeypatch.setattr(lower_minimum_module, "begun_afresh", begun)
    monkeypatch.setattr(lower_minimum_module, "unfitted_cost", lambda fit, names, sizes, at: abs(at - n))
    assert begun_again(away) is away
    assert asked == [n]


def test_before_anything_is_fitted_a_model_costs_least_about_the_true_size_and_exponent():
    true = _fitted(FAULTS["payload"](0.5))
    stated = true.problem.exponent(true.problem.stated())
    about = true.problem.exponent(refit(true, _PAYLOAD, [0.5]).point)
    cost = unfitted_cost(true, _PAYLOAD, [0.5], about)
    assert cost < unfitted_cost(true, _PAYLOAD, [0.1], about)
    assert cost < unfitted_cost(true, _PAYLOAD, [0.5], about + 0.4)
    assert unfitted_cost(true, _PAYLOAD, [0.5], None) == unfitted_cost(true, _PAYLOAD, [0.5], stated)


def test_a_model_without_a_solution_costs_more_than_any(sound, monkeypatch):
    def sinks(self, point):
        raise SolverFailure("sinks")

    monkeypatch.setattr(LeastSquaresProblem, "begun", sinks)
    assert unfitted_cost(sound[0], (), [], None) == np.inf


def test_exponents_to_begin_from_are_those_of_soils_and_none_on_hard_ground(sound):
    fit, _ = sound
    stated = fit.problem.exponent(fit.problem.stated())
    assert exponents(fit) == [stated, 0.3, 0.5, 0.7, 0.9, 1.1]
    hard = SimpleNamespace(problem=SimpleNamespace(hard=True, exponent=lambda n: n, stated=lambda: 0.7))
    assert exponents(hard) == [0.7]


def test_a_rough_fit_begins_with_its_exponent_and_the_numbers_stay_if_they_shall(sound):
    fit, _ = sound
    problem = fit.problem
    numbers = [i for i, nuisance in enumerate(problem.nuisances) if nuisance.tolerated]
    assert problem.exponent(problem.stated(n=0.31)) == pytest.approx(0.31)
    kept = begun_afresh(fit, _PAYLOAD, [0.3], n=0.5, numbers=False)
    # The mass, whose effect moves, has its derivative from there.
    assert np.count_nonzero(kept.nuisances[numbers]) <= 1
    assert begun_afresh(fit, _PAYLOAD, [0.3]).nuisances[numbers].all()
    free = GaussNewton(rounds=1).descend(replace(kept, jacobian=Jacobian()))
    assert np.count_nonzero(free.nuisances[numbers]) > 5


def test_no_model_is_begun_again_that_does_not_drive_as_logged_from_there(sound, monkeypatch):
    away = _away(sound[0], "mass", 6.0)
    monkeypatch.setattr(lower_minimum_module, "HOPELESS", 1e-3)
    assert begun_again(away) is away


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

    def first_accepted(test, last, bar, rate, wide):
        begun.append(last.fit)
        if len(begun) == 1:
            return Accepted(larger, [1.0], refused=False)
        assert wide
        return onward(test, last, bar, rate, wide)

    monkeypatch.setattr(stepwise, "_onward", first_accepted)
    found = stepwise.search(_away(fit, "mass", 2.5), ("payload", "torque_scale"), 0.06, wide=True)
    assert len(begun) == 2
    assert found.causes == ()
    assert found.nominal.minus_log_likelihood == pytest.approx(fit.minus_log_likelihood, abs=1.0)


@pytest.mark.parametrize(("restarts", "searches"), [(2, 2), (0, 1)])
def test_a_search_begins_again_beside_an_effect_that_is_rejected(sound, monkeypatch, restarts, searches):
    fit, larger = sound
    begun, poor = [], _away(fit, "mass", 6.0)

    def rejected(test, last, bar, rate, wide):
        begun.append(last.fit)
        return Accepted(None, [-1.0], refused=True, settled=(larger,))

    monkeypatch.setattr(stepwise, "_onward", rejected)
    monkeypatch.setattr(stepwise, "begun_again", lambda one: one)
    found = stepwise.search(poor, ("payload", "torque_scale"), 0.06, restarts=restarts)
    assert len(begun) == searches
    assert found.refused
    better = fit.minus_log_likelihood + 1.0
    assert (found.nominal.minus_log_likelihood < better) == (searches == 2)
