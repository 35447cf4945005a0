"""Comparison on windows apart in one noise, and what is tested after a refusal."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search import acceptance, stepwise
from estimators.discrepancy.search.acceptance import Accepted, Bars, Refuted, accepted_of
from estimators.discrepancy.search.holdout import HoldOutResult, HoldOutTest
from estimators.discrepancy.search.stepwise import _onward, _uncertain


@dataclass(frozen=True)
class Fit:
    """What the hold-out test takes from a fit before any window is simulated."""

    null: object
    noise: str
    candidates: tuple[Candidate, ...] = ()


@pytest.mark.parametrize(
    ("null", "noise", "held"), [(None, "its own", "tested"), ("a sample", "nominal", None)]
)
def test_on_natural_ground_both_models_have_the_noise_of_the_smaller(null, noise, held):
    test = HoldOutTest(Fit(null, "nominal"), [])
    larger = Fit(null, "its own")
    assert test._beside(larger).noise == noise
    test._tested = "tested"
    assert test.onward(larger)._held == held


def _search(
    monkeypatch, strongest: float, refused: set[str], *, supported: bool = True
) -> tuple[Accepted, list[str]]:
    """The next model where effects fall from ``strongest``, null logs stay below 4 and some are refused.

    Parameters
    ----------
    supported
        Whether the fitted windows support those that are refused.
    """
    tried: list[str] = []

    def scores(fit: Fit, candidates: list[Candidate]) -> SimpleNamespace:
        order = {name: strongest - i for i, name in enumerate("abcde")}
        strength = np.array([order[candidate.effect] for candidate in candidates])
        return SimpleNamespace(fit=fit, candidates=tuple(candidates), z=strength)

    def accepted(test: HoldOutTest, trials: list[Fit], bars: object) -> Accepted:
        (name,) = [candidate.effect for candidate in trials[0].candidates]
        tried.append(name)
        wrong = name in refused
        against = (Refuted(trials[0], 40.0),) if wrong else ()
        gain = -5.0 if wrong else 5.0
        fit = None if wrong else trials[0]
        left = (trials[0],) if wrong else ()
        return Accepted(fit, [gain], refused=wrong and supported, refuted=against, settled=left)

    monkeypatch.setattr(stepwise, "refined_places", lambda last, *_: last)
    monkeypatch.setattr(stepwise, "fits_from_stated", lambda *_, **__: [])
    monkeypatch.setattr(stepwise, "score_threshold", lambda *_: 4.0)
    monkeypatch.setattr(stepwise, "score_test", scores)
    monkeypatch.setattr(stepwise, "accepted_of", accepted)
    monkeypatch.setattr(
        stepwise, "_larger", lambda last, *_: [Fit(None, "", (one,)) for one in last.candidates]
    )
    nominal = Fit(None, "")
    start = scores(nominal, [Candidate(effect=name) for name in "abcde"])
    return _onward(HoldOutTest(nominal, []), start, 3.4, 0.06, False), tried


def test_after_a_refusal_that_no_null_log_has_the_next_best_explanation_is_tested(monkeypatch):
    found, tried = _search(monkeypatch, 9.0, {"a"})
    assert tried == ["a", "b"]
    assert found.fit.candidates[0].effect == "b"
    assert found.rejected == {"a"}
    assert not found.refused
    assert found.refuted == ()


@pytest.mark.parametrize(("wrong", "found", "tried"), [("a", "b", "ab"), ("abcde", None, "abc")])
def test_a_first_name_without_support_is_refused_like_any_other(monkeypatch, wrong, found, tried):
    """Its score was large, and the refit gains little: the score was that of another effect."""
    result, names = _search(monkeypatch, 9.0, set(wrong), supported=False)
    assert names == list(tried)
    assert (result.fit.candidates[0].effect if result.fit else None) == found
    assert result.refused == (found is None)


def test_a_score_of_noise_without_support_is_no_discrepancy(monkeypatch):
    found, tried = _search(monkeypatch, 3.9, {"a"}, supported=False)
    assert (found.fit, found.refused, tried) == (None, False, ["a"])


def test_where_null_logs_have_such_a_score_only_the_best_is_tested(monkeypatch):
    found, tried = _search(monkeypatch, 3.9, {"a"})
    assert tried == ["a"]
    assert (found.fit, found.refused, found.rejected) == (None, True, frozenset())


def test_no_more_than_three_explanations_are_tested(monkeypatch):
    found, tried = _search(monkeypatch, 9.0, set("abcde"))
    assert tried == ["a", "b", "c"]
    assert (found.fit, found.refused) == (None, True)
    assert ["".join(c.effect for c in one.fit.candidates) for one in found.refuted] == ["a", "b", "c"]
    assert found.settled == tuple(one.fit for one in found.refuted)


@pytest.mark.parametrize(
    ("refused", "found", "tried"),
    [({"ab"}, "b", ["ab", "b"]), ({"ab", "b"}, None, ["ab", "b"]), (set(), "ab", ["ab"])],
)
def test_of_two_effects_that_are_refused_together_the_stronger_is_tested_alone(
    monkeypatch, refused: set[str], found: str | None, tried: list[str]
) -> None:
    """One may be certain, and the other too small. Null logs have such a score: it is no discrepancy."""
    names: list[str] = []

    def accepted(test: HoldOutTest, trials: list[Fit], bars: object) -> Accepted:
        name = "".join(candidate.effect for candidate in trials[0].candidates)
        names.append(name)
        return Accepted(None if name in refused else trials[0], [5.0], refused=name == "ab")

    def larger(
        last: SimpleNamespace, bar: float, test: HoldOutTest, begun: list[Fit], singly: bool
    ) -> list[Fit]:
        return [Fit(None, "", (Candidate(effect="b"),))] if singly else [Fit(None, "", last.candidates)]

    monkeypatch.setattr(stepwise, "refined_places", lambda last, *_: last)
    monkeypatch.setattr(stepwise, "fits_from_stated", lambda *_, **__: [])
    monkeypatch.setattr(stepwise, "score_threshold", lambda *_: 4.0)
    monkeypatch.setattr(stepwise, "accepted_of", accepted)
    monkeypatch.setattr(stepwise, "_larger", larger)
    nominal = Fit(None, "")
    both = tuple(Candidate(effect=name) for name in "ab")
    start = SimpleNamespace(fit=nominal, candidates=both, z=np.array([3.8, 3.9]))
    result = _onward(HoldOutTest(nominal, []), start, 3.4, 0.06, False)
    assert names == tried
    assert ("".join(one.effect for one in result.fit.candidates) if result.fit else None) == found
    # What the fitted windows supported remains, where nothing else is found.
    assert result.refused == (found is None)


@pytest.mark.parametrize(
    ("gain", "support", "refuted", "refused"),
    [
        (-30.0, 60.0, True, True),  # 41 in all, where 8 make an effect and 32 are left for it
        (-30.0, 50.0, False, True),  # 31
        (-30.0, 7.0, False, False),
        (0.5, 60.0, False, False),  # confirmed
    ],
)
def test_a_model_is_kept_for_which_far_more_speaks_than_an_effect_needs(
    monkeypatch, gain: float, support: float, refuted: bool, refused: bool
) -> None:
    result = HoldOutResult(gain=gain, expected=20.0, deviation=8.0)
    larger, settled = (Fit(None, name, (Candidate(effect="payload"),)) for name in ("larger", "settled"))
    monkeypatch.setattr(acceptance, "settled", lambda fit, fresh: settled)
    monkeypatch.setattr(acceptance, "support_of", lambda *_: support)
    test = SimpleNamespace(fit=Fit(None, ""), result=lambda model: result)
    found = accepted_of(test, [larger], Bars(4.0, 4.0))
    assert [one.fit for one in found.refuted] == ([settled] if refuted else [])
    assert found.refused is refused
    assert (found.fit is settled) is (gain > 0.0)
    assert found.settled == (() if gain > 0.0 else (settled,))


@pytest.mark.parametrize(
    ("names", "together", "places"),
    [("ab", False, (1,)), ("bca", False, (0, 1)), ("ab", True, ()), ("a", False, ())],
)
def test_uncertain_are_effects_that_came_after_what_is_certain(
    names: str, together: bool, places: tuple[int, ...]
) -> None:
    def fit(effects: str) -> Fit:
        return Fit(None, "", tuple(Candidate(effect=name) for name in effects))

    class Certain:
        fit: Fit

        def __call__(self, larger: Fit) -> bool:
            return together

    certain = Certain()
    certain.fit = fit("a")
    assert _uncertain(fit(names), certain) == places


def test_a_search_goes_on_from_what_is_confirmed_or_else_from_the_refuted_model_with_most_evidence() -> None:
    weak, strong, right = (Fit(None, name) for name in ("weak", "strong", "right"))
    refuted = (Refuted(weak, 40.0), Refuted(strong, 50.0), Refuted(weak, 45.0))
    assert Accepted(None, [], refused=True, refuted=refuted).step is strong
    assert Accepted(right, [], refused=False, refuted=refuted).step is right
    assert Accepted(None, [], refused=True).step is None
