"""The search without the first name, where its causes leave a rest."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy import diagnosis
from estimators.discrepancy.diagnosis import SCREEN_RATE, split_runs
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.windows import FIT, SELECT
from estimators.discrepancy.search import another_first
from estimators.discrepancy.search.another_first import _better, better_without_first, leaves_a_rest
from estimators.discrepancy.search.stepwise import search


@pytest.mark.parametrize(
    ("causes", "refused", "strongest", "rest"),
    [
        ("a", False, 4.1, True),
        ("a", False, 3.9, False),
        ("a", True, 0.0, True),
        ("", True, 9.0, False),
    ],
)
def test_a_rest_is_a_significant_score_or_a_refusal_beside_causes(
    monkeypatch, causes, refused, strongest, rest
):
    monkeypatch.setattr(another_first, "score_threshold", lambda *_: 4.0)
    last = SimpleNamespace(z=np.array([0.5, -strongest]))
    found = SimpleNamespace(causes=tuple(causes), refused=refused, last=last)
    assert leaves_a_rest(found, 0.05) is rest


def _found(gain: float, sizes: int, scatter: float = 0.0) -> SimpleNamespace:
    """A result that explains so much; with a ``scatter`` null simulations go that far along its residual."""
    null = SimpleNamespace(white=np.array([[scatter, -scatter], [0.0, 0.0]])) if scatter else None
    fit = SimpleNamespace(
        minus_log_likelihood=-gain,
        sizes=np.ones(sizes),
        residual=np.array([gain, 0.0]),
        noise=SimpleNamespace(whiten=lambda table: table),
        without_states=lambda table: table,
        null=null,
    )
    return SimpleNamespace(extended=fit, threshold=4.0, causes=("a",) * sizes)


@pytest.mark.parametrize(
    ("gain", "sizes", "scatter", "better"),
    [
        (8.1, 1, 0.0, True),
        (7.9, 1, 0.0, False),
        # Fewer causes are no gain, and each that is more must gain as much.
        (7.9, 0, 0.0, False),
        (15.9, 2, 0.0, False),
        (16.1, 2, 0.0, True),
        # Road and soil scatter by twice the white noise: a quarter counts.
        (31.0, 1, 2.0, False),
        (33.0, 1, 2.0, True),
    ],
)
def test_the_other_explanation_must_gain_what_an_effect_must_as_often_as_it_has_more(
    gain, sizes, scatter, better
):
    assert _better(_found(gain, sizes, scatter), _found(0.0, 1), ()) is better


@pytest.mark.parametrize("contradicts", [False, True])
def test_windows_apart_may_contradict_the_other_explanation(monkeypatch, contradicts):
    result = SimpleNamespace(result=lambda larger: SimpleNamespace(contradicts=contradicts))
    monkeypatch.setattr(another_first, "HoldOutTest", lambda fit, runs: result)
    assert _better(_found(50.0, 1), _found(0.0, 1), ()) is not contradicts


def test_a_first_name_that_stands_in_for_two_gives_way_to_them():
    """A search that knew of rolling resistance alone, on a log with torques and steering stated too large."""
    log = simulated_log(draw_case(31, road="flat", gnss=True, duration=16.0))
    wrong = {"torque_f": 1.4, "torque_r": 1.4, "steer": 1.2}
    channels = {**log.channels, **{name: scale * log.channels[name] for name, scale in wrong.items()}}
    parts = split_runs([replace(log, channels=channels)])
    nominal = fit_runs(parts[FIT])
    found = search(nominal, ("rolling_resistance",), SCREEN_RATE, parts[SELECT])
    assert [one.effect for one in found.extended.candidates] == ["rolling_resistance"]
    library = ("rolling_resistance", "steer_gain", "torque_scale")
    other = better_without_first(found, library, SCREEN_RATE, parts[SELECT])
    assert {one.effect for one in other.extended.candidates} == {"steer_gain", "torque_scale"}
    # Without these there is nothing better.
    assert better_without_first(found, library[:1], SCREEN_RATE, parts[SELECT]) is None
    assert better_without_first(other, library[:2], SCREEN_RATE, parts[SELECT]) is None


@pytest.mark.parametrize(
    ("rest", "before", "after", "taken"),
    [
        (False, 0.1, 0.1, False),
        (True, 0.1, 0.1, True),
        (True, 0.1, 9.0, False),
        (True, 9.0, 9.0, True),
    ],
)
def test_a_diagnosis_takes_another_explanation_where_a_rest_remains_and_its_solver_is_as_accurate(
    monkeypatch, rest, before, after, taken
):
    def found(error):
        fit, first = SimpleNamespace(converged=True), SimpleNamespace(z=np.array([3.0]))
        return SimpleNamespace(extended=fit, first=first, solver_error=lambda: error)

    def without(result, library, rate, apart):
        assert library == ["a", "c"]
        assert apart == ["windows"]
        return found(after)

    monkeypatch.setattr(diagnosis, "leaves_a_rest", lambda *_: rest)
    monkeypatch.setattr(diagnosis, "better_without_first", without)
    done = diagnosis._Searched({SELECT: ["windows"]}, None, {"b": "no"}, found(before), before)
    stages, failed = [], {}
    again = diagnosis._without_first(done, ("a", "b", "c"), failed, stages.append)
    assert (again is not done) is taken
    assert again.solver_error == (after if taken else before)
    assert bool(stages) is rest
    assert not failed


def test_a_search_that_breaks_down_without_the_first_name_leaves_the_other(monkeypatch):
    def fails(*_):
        raise ArithmeticError("singular")

    monkeypatch.setattr(diagnosis, "leaves_a_rest", lambda *_: True)
    monkeypatch.setattr(diagnosis, "better_without_first", fails)
    done = diagnosis._Searched({SELECT: []}, None, {}, None, 0.0)
    failed = {}
    assert diagnosis._without_first(done, (), failed, lambda stage: None) is done
    assert list(failed) == ["search without the first cause"]
