"""A wider search where the first one leaves something, and which explanation counts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy import diagnosis
from estimators.discrepancy.diagnosis import SCREEN_RATE, split_runs
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.windows import FIT, SELECT
from estimators.discrepancy.search import second_look
from estimators.discrepancy.search.lower_minimum import LEFT
from estimators.discrepancy.search.second_look import _better, incomplete, looked_again
from estimators.discrepancy.search.stepwise import search


@pytest.mark.parametrize(
    ("causes", "refused", "strongest", "off", "more"),
    [
        ("a", False, 4.1, 4.4, True),
        ("a", False, 3.9, 4.4, False),
        ("a", False, 0.0, 4.6, True),
        ("a", True, 0.0, 0.0, True),
        ("", True, 9.0, 0.0, False),
        ("", False, 0.0, 4.6, True),
    ],
)
def test_a_search_is_incomplete_if_it_leaves_numbers_far_off_or_a_rest_beside_causes(
    monkeypatch, causes, refused, strongest, off, more
):
    assert LEFT == 4.5
    monkeypatch.setattr(second_look, "astray", lambda fit: fit.astray)
    monkeypatch.setattr(second_look, "score_threshold", lambda last, rate: 4.0 if rate == 0.005 else 0.0)
    monkeypatch.setattr(second_look, "strayed", lambda fit, deviations: ["mass"] * (fit.off > deviations))
    found = SimpleNamespace(
        causes=tuple(causes),
        refused=refused,
        last=SimpleNamespace(z=np.array([0.5, -strongest])),
        nominal=SimpleNamespace(astray=True),
        extended=SimpleNamespace(off=off),
    )
    assert incomplete(found) is more
    # Where the nominal model has its numbers about as stated a wider search is the same.
    found.nominal.astray = False
    assert not incomplete(found)


def _found(gain: float, sizes: int, scatter: float = 1.0) -> SimpleNamespace:
    """A result that explains so much; of the difference to another road and soil explain a part."""
    fit = SimpleNamespace(minus_log_likelihood=-gain, sizes=np.ones(sizes), scatter=scatter)
    return SimpleNamespace(extended=fit, threshold=4.0, causes=("a",) * sizes)


@pytest.mark.parametrize(
    ("gain", "sizes", "scatter", "better"),
    [
        (8.1, 2, 1.0, True),
        (7.9, 2, 1.0, False),
        # Each cause that is more must gain as much, and may that is fewer.
        (0.1, 1, 1.0, True),
        (-0.1, 1, 1.0, False),
        (15.9, 3, 1.0, False),
        (16.1, 3, 1.0, True),
        (31.0, 2, 4.0, False),
        (33.0, 2, 4.0, True),
        (99.0, 0, 1.0, False),
    ],
)
def test_another_explanation_must_gain_what_an_effect_must_as_often_as_it_has_more(
    monkeypatch, gain, sizes, scatter, better
):
    monkeypatch.setattr(second_look, "scatter_between", lambda fit, other: fit.scatter)
    assert _better(_found(gain, sizes, scatter), _found(0.0, 2), ()) is better


def test_any_explanation_is_better_than_none():
    assert _better(_found(0.0, 1), _found(0.0, 0), ())
    assert not _better(_found(0.0, 0), _found(0.0, 0), ())


@pytest.mark.parametrize("contradicts", [False, True])
def test_windows_apart_may_contradict_the_other_explanation(monkeypatch, contradicts):
    monkeypatch.setattr(second_look, "scatter_between", lambda *_: 1.0)
    result = SimpleNamespace(result=lambda larger: SimpleNamespace(contradicts=contradicts))
    monkeypatch.setattr(second_look, "HoldOutTest", lambda fit, runs: result)
    assert _better(_found(50.0, 1), _found(0.0, 1), ()) is not contradicts


def test_the_wider_search_finds_what_another_could_not_and_else_leaves_it():
    """A search that knew of rolling resistance alone, on a log with torques and steering stated too large."""
    log = simulated_log(draw_case(31, road="flat", gnss=True, duration=16.0))
    wrong = {"torque_f": 1.4, "torque_r": 1.4, "steer": 1.2}
    channels = {**log.channels, **{name: scale * log.channels[name] for name, scale in wrong.items()}}
    parts = split_runs([replace(log, channels=channels)])
    nominal = fit_runs(parts[FIT])
    found = search(nominal, ("rolling_resistance",), SCREEN_RATE, parts[SELECT])
    assert [one.effect for one in found.extended.candidates] == ["rolling_resistance"]
    library = ("rolling_resistance", "steer_gain", "torque_scale")
    other = looked_again(found, library, SCREEN_RATE, parts[SELECT])
    assert {one.effect for one in other.extended.candidates} == {"steer_gain", "torque_scale"}
    assert looked_again(other, library[:1], SCREEN_RATE, parts[SELECT]) is other


@pytest.mark.parametrize(
    ("rest", "before", "after", "taken"),
    [
        (False, 0.1, 0.1, False),
        (True, 0.1, 0.1, True),
        (True, 0.1, 9.0, False),
        (True, 9.0, 9.0, True),
    ],
)
def test_a_diagnosis_takes_another_explanation_where_one_is_incomplete_and_its_solver_is_as_accurate(
    monkeypatch, rest, before, after, taken
):
    def found(error):
        fit, first = SimpleNamespace(converged=True), SimpleNamespace(z=np.array([3.0]))
        return SimpleNamespace(extended=fit, first=first, solver_error=lambda: error)

    def wider(result, library, rate, apart):
        assert library == ["a", "c"]
        assert apart == ["windows"]
        return found(after)

    monkeypatch.setattr(diagnosis, "incomplete", lambda _: rest)
    monkeypatch.setattr(diagnosis, "looked_again", wider)
    done = diagnosis._Searched({SELECT: ["windows"]}, None, {"b": "no"}, found(before), before)
    stages, failed = [], {}
    again = diagnosis._looked_again(done, ("a", "b", "c"), failed, stages.append)
    assert (again is not done) is taken
    assert again.solver_error == (after if taken else before)
    assert again.wide is taken
    assert bool(stages) is rest
    assert not failed


def test_a_wider_search_that_breaks_down_leaves_the_other(monkeypatch):
    def fails(*_):
        raise ArithmeticError("singular")

    monkeypatch.setattr(diagnosis, "incomplete", lambda _: True)
    monkeypatch.setattr(diagnosis, "looked_again", fails)
    done = diagnosis._Searched({SELECT: []}, None, {}, None, 0.0)
    failed = {}
    assert diagnosis._looked_again(done, (), failed, lambda stage: None) is done
    assert list(failed) == ["wider search"]


@pytest.mark.parametrize(
    ("accurate", "restructured", "replaced", "order"),
    [
        (True, False, False, "completed looked"),
        (True, False, True, "completed looked completed"),
        (True, True, True, "completed"),
        # A wrong effect may be what needs a finer solver.
        (False, False, True, "looked refined completed"),
        (False, True, False, "looked refined completed"),
    ],
)
def test_a_wider_search_comes_before_a_finer_solver_and_not_where_another_structure_is_named(
    monkeypatch, accurate, restructured, replaced, order
):
    happened = []
    done, other = (SimpleNamespace(accurate=one, name=one) for one in (accurate, True))

    def looked(there, allowed, failed, progress):
        happened.append("looked")
        return other if replaced else there

    def refined(there, allowed, failed, *, white, progress):
        if not accurate:
            happened.append("refined")
        return there

    def completed(begun, there, allowed, failed, progress):
        happened.append("completed")
        return SimpleNamespace(restructured="grid" if restructured else None, done=there)

    stubs = {
        "quality_of": lambda logs, failed: [SimpleNamespace(problems=[])],
        "unusable": lambda logs, reports: (),
        "used_findings": lambda logs, reports: (),
        "split_runs": lambda logs: {},
        "_searched": lambda *_, **__: done,
        "_clearly_restructured": lambda *_: None,
        "_looked_again": looked,
        "_refined": refined,
        "_completed": completed,
        "_with_stops": lambda result, *_: result,
        "_with_fewer_causes": lambda result, begun, there, allowed, progress: (result, there),
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(diagnosis, name, stub)
    result, last = diagnosis.diagnose([SimpleNamespace(hash="a")])
    assert " ".join(happened) == order
    # What is judged is what is refined and completed last.
    expected = other if "looked" in order and replaced else done
    assert result.done is expected
    assert last is expected
