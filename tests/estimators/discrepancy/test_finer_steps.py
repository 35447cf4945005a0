"""A search that its solver spoils is repeated by half the step, then by a quarter."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy import diagnosis
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.verdict import SEARCH
from offroad_env.errors import InvalidParameter, OffroadError, SolverFailure


def searched(error, *, converged=True):
    """What a search leaves behind, by the error of its solver."""
    first = SimpleNamespace(z=np.array([2.0, 5.0]))  # a tenth of the largest is below the absolute limit of 1
    nominal = f"fit with an error of {error}"
    found = SimpleNamespace(extended=SimpleNamespace(converged=converged), first=first, nominal=nominal)
    return diagnosis._Searched({}, None, {}, found, error, wide=True)


ACCURATE, ROUGH, ROUGHER = searched(0.9), searched(1.1), searched(2.0)
LOST = searched(0.1, converged=False)
FAILS = SolverFailure("the simulation fails")
BEYOND = InvalidParameter("a fit has left the range of a number")


@pytest.mark.parametrize(
    ("first", "then", "expected"),
    [
        (ACCURATE, [], ACCURATE),
        (ROUGH, [ACCURATE], ACCURATE),
        (LOST, [ACCURATE], ACCURATE),
        (ROUGH, [FAILS, ACCURATE], ACCURATE),
        (ROUGH, [BEYOND, ACCURATE], ACCURATE),
        (ROUGH, [ROUGHER, ACCURATE], ACCURATE),
        (ROUGH, ["search fails", ACCURATE], ACCURATE),
        (ROUGHER, [ROUGH, FAILS], ROUGH),
        (ROUGH, [ROUGHER, FAILS], ROUGH),
        (ROUGH, [FAILS, FAILS], ROUGH),
    ],
)
def test_the_first_accurate_search_counts_else_the_least_wrong(monkeypatch, first, then, expected):
    failed, left, steps, begins = {}, list(then), [], []
    run = SimpleNamespace(step=1.0)
    run.refined = lambda: SimpleNamespace(step=0.5, refined=lambda: SimpleNamespace(step=0.25))

    def again(splits, allowed, failed, *, white, progress, near, wide):
        # A finer search is as wide as the first: else it could end where that one began.
        assert wide
        steps.append(splits["fit"][0].step)
        begins.append(near)
        outcome = left.pop(0)
        if isinstance(outcome, OffroadError):
            raise outcome
        if outcome == "search fails":
            failed[SEARCH] = "a crash"
            return ROUGHER
        return outcome

    monkeypatch.setattr(diagnosis, "_searched", again)
    done = first._replace(splits={"fit": [run]})
    found = diagnosis._refined(done, [], failed, white=False, progress=lambda _: None)
    assert found.found is expected.found
    assert steps == [0.5, 0.25][: len(then)]
    assert begins[:1] == [first.found.nominal][: len(then)]
    assert not failed


def test_a_fit_by_half_the_step_begins_where_the_first_one_ended():
    run = RunModel(simulated_log(draw_case(31, road="flat", natural=True, duration=8.0)))
    first = fit_runs([run])
    finer = fit_runs([run.refined()], near=first)
    assert finer.runs[0].dt == 0.5 * first.runs[0].dt
    assert finer.minus_log_likelihood == pytest.approx(first.minus_log_likelihood, abs=2.0)
    assert finer.null is not None
    assert finer.converged
