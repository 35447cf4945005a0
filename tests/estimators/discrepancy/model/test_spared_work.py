"""Work that a fit to a drive does not repeat."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model import run_model
from estimators.discrepancy.model.fit import fit_runs, settled
from estimators.discrepancy.model.linearisation import Linearisation
from estimators.discrepancy.model.run_model import RunModel


@pytest.fixture(scope="module")
def fit():
    log = simulated_log(draw_case(100, road="unknown", natural=True, duration=12.0))
    return fit_runs([RunModel(log)], white=True)


def test_inputs_are_prepared_once_for_all_starts_and_again_for_other_inputs(fit, monkeypatch):
    run, (setup,), count = fit.runs[0].refined(), fit.linearisation.setups, []
    real = run_model.actuator_states
    monkeypatch.setattr(run_model, "actuator_states", lambda *args: count.append(0) or real(*args))
    starts, warm = fit.point.starts[0], fit.point.warm[0]
    first = run.simulate(setup, starts, warm, run.windows)
    again = run.simulate(setup, starts, warm, run.windows)
    assert len(count) == 1
    assert np.array_equal(first.states, again.states)
    late = replace(setup, inputs=replace(setup.inputs, delay=0.05))
    other = run.simulate(late, starts, warm, run.windows)
    assert len(count) == 2
    assert not np.array_equal(first.states, other.states)


def test_on_the_way_to_a_minimum_derivatives_by_tolerated_numbers_serve_again(fit, monkeypatch):
    """And where a fit ends, all are new."""
    asked = []
    real = Linearisation.nuisance_columns

    def columns(self, known=None):
        asked.append(known is None)
        return real(self, known)

    monkeypatch.setattr(Linearisation, "nuisance_columns", columns)
    settled(fit)
    assert asked[0] is False
    assert asked[-1] is True
    known = np.full_like(fit.jacobian.nuisances, 7.0)
    mixed = real(fit.linearisation, known)
    tolerated = fit.problem.nuisances.index(next(n for n in fit.problem.nuisances if n.tolerated))
    assert (mixed[:, tolerated] == 7.0).all()
    assert not (mixed[:, 0] == 7.0).any()
