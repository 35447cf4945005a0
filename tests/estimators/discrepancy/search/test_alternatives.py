"""Which effects may take the place of a cause: those that the data leave undecided, and no others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.studies.fault_detection.one_log import natural_case
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.faults.other_forms import OTHER_FORMS
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search import alternatives, stepwise
from estimators.discrepancy.search.acceptance import Accepted
from estimators.discrepancy.search.alternatives import cause_of
from estimators.discrepancy.search.holdout import HoldOutResult
from estimators.discrepancy.search.result import EQUIVALENT


class _Fit(SimpleNamespace):
    """As much of a fitted model with one effect as the comparison looks at."""

    def size_deviations(self) -> np.ndarray:
        return np.full(len(self.sizes), 0.1)

    def deviations(self) -> np.ndarray:
        return np.array([0.01])


def _fit(effect: str, cost: float, size: float = 1.0, **others: Any) -> _Fit:
    return _Fit(
        candidates=(Candidate(effect=effect),),
        sizes=np.array([size]),
        cost=cost,
        size_inflation=np.ones(1),
        nuisances=np.array([0.8]),
        runs=(SimpleNamespace(size_limits=lambda name: (-9.0, 9.0)),),
        null=None,
        **others,
    )


def _scores(**strengths: float) -> SimpleNamespace:
    return SimpleNamespace(
        candidates=[Candidate(effect=name) for name in strengths],
        z=np.array(list(strengths.values())),
        size=np.full(len(strengths), 0.5),
        fit=SimpleNamespace(tail=lambda strength: 1e-9),
    )


@pytest.fixture
def fitted(monkeypatch):
    """Costs of models of one effect -> what is found in the place of ``inertia``, of cost 0."""

    def found(
        costs: dict[str, float],
        confirmed: bool = True,
        stronger: tuple[_Fit, ...] = (),
        rejected: tuple[str, ...] = (),
        **strengths: float,
    ) -> list[str]:
        first = _scores(inertia=8.0, **strengths)
        last = _scores(**{name: 1.0 for name in strengths if name not in rejected})
        ratio = np.full(len(last.candidates), 1e3)  # a linear look finds nothing
        look = SimpleNamespace(likelihood_ratio=ratio, size=0.0 * ratio)
        monkeypatch.setattr(alternatives, "_first_look", lambda *_: look)
        monkeypatch.setattr(alternatives, "separation", lambda best, other: 2.0 * (other.cost - best.cost))
        monkeypatch.setattr(
            alternatives, "refit", lambda fit, names, *_: _fit(names[0].effect, costs[names[0].effect])
        )
        _, cause = cause_of(_fit("inertia", 0.0), last, 0, first, lambda larger: confirmed, stronger)
        return [one.candidate.effect for one in cause.alternatives]

    return found


def test_what_scored_nearly_as_high_before_is_refitted_whatever_a_linear_look_says(fitted) -> None:
    assert fitted({"steer_lag": 1.0}, steer_lag=6.0) == ["inertia", "steer_lag"]
    assert fitted({"steer_lag": 1.0}, steer_lag=4.0) == ["inertia"]


def test_the_best_of_them_takes_its_place(fitted) -> None:
    assert fitted({"steer_lag": -1.0}, steer_lag=6.0) == ["steer_lag", "inertia"]


def test_it_must_explain_as_much_and_be_confirmed_and_not_have_been_rejected(fitted) -> None:
    assert fitted({"steer_lag": 0.6 * EQUIVALENT}, steer_lag=6.0) == ["inertia"]
    assert fitted({"steer_lag": 1.0}, confirmed=False, steer_lag=6.0) == ["inertia"]
    assert fitted({"steer_lag": 1.0}, rejected=("steer_lag",), steer_lag=6.0) == ["inertia"]


def test_a_refused_model_that_explains_more_in_all_makes_the_cause_uncertain(fitted) -> None:
    refused = (_fit("rolling_resistance", -20.0), _fit("inertia", -1.0))
    assert fitted({}, stronger=refused, payload=1.0) == ["inertia", "rolling_resistance"]


def test_only_models_of_one_effect_with_more_evidence_count() -> None:
    pair = SimpleNamespace(candidates=(Candidate(effect="grade"), Candidate(effect="bank")))
    weak, strong = _fit("grade", 0.0), _fit("payload", 0.0)
    others = ((weak, 9.0), (strong, 11.0), (pair, 30.0))
    taken = Accepted(_fit("bank", 0.0), [1.0], refused=False, evidence=10.0, others=others)
    assert taken.stronger == (strong,)
    assert taken._replace(fit=None).stronger == ()


def _sets(seed: int, fault: Any) -> list[set[str]]:
    found = diagnose([simulated_log(natural_case(seed), fault)]).causes
    return [{one.candidate.effect for one in cause.alternatives} for cause in found]


@pytest.mark.check
def test_a_lag_is_not_taken_for_an_inertia_for_certain() -> None:
    """A score of 4.8 for an inertia, of 3.6 for the lag, whose model gains more."""
    assert any("steer_lag" in found for found in _sets(20002, FAULTS["steer_lag"](0.0459)))


@pytest.mark.check
def test_a_cause_that_windows_apart_reject_stays_possible_where_it_explains_most() -> None:
    """Rolling resistance that grows with the speed: it gains 31 in the log-likelihood, a grade 12."""
    assert any(
        "rolling_resistance" in found for found in _sets(13001, OTHER_FORMS["rolling_resistance"](0.0812))
    )


@pytest.mark.parametrize(
    ("gain", "support", "taken"),
    [(None, 0.0, True), (1.0, 9.0, True), (1.0, 3.0, False), (-30.0, 99.0, False)],
)
def test_an_alternative_needs_what_a_first_effect_needs(
    monkeypatch, gain: float | None, support: float, taken: bool
) -> None:
    """Evidence of 8 in all, and no contradiction by windows apart, where there are any."""
    result = None if gain is None else HoldOutResult(gain=gain, expected=5.0, deviation=3.0)
    monkeypatch.setattr(stepwise, "support_of", lambda fit, beside, larger: support)
    monkeypatch.setattr(stepwise, "replace", lambda fit, **fields: fit)
    nominal = SimpleNamespace(noise=None, null=None)
    test = SimpleNamespace(result=lambda larger: result)
    assert stepwise._Confirmed(nominal, test, 8.0)(_fit("steer_lag", 0.0)) is taken
