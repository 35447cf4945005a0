"""Where the descent to a model with other effects begins."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search import refitting
from estimators.discrepancy.search.refitting import refit

_DRAG, _PAYLOAD = Candidate(effect="rut_drag"), Candidate(effect="payload")


class Fit:
    """A fitted model; ``cost`` of a start with other effects by their sizes."""

    def __init__(self, cost, candidates=(), sizes=()):
        self._cost, self.candidates, self.sizes = cost, tuple(candidates), np.array(sizes)
        vehicle = SimpleNamespace(m=750.0, r=0.3)
        self.runs = [SimpleNamespace(setup=SimpleNamespace(plant=SimpleNamespace(vehicle=vehicle)))]

    def with_effects(self, candidates, sizes):
        return SimpleNamespace(candidates=candidates, sizes=sizes, cost=self._cost(*sizes))


@pytest.fixture(autouse=True)
def no_descent(monkeypatch):
    """Every descent ends where it begins."""

    class Still:
        def __init__(self, enough):
            pass

        def descend(self, fit, *, fresh):
            return fit

    monkeypatch.setattr(refitting, "GaussNewton", Still)


def _too_far(drag: float) -> float:
    """Numbers that have taken the place of a drag stop the vehicle beside the whole of it."""
    return 9000.0 + (1e5 if drag > 2000.0 else -0.01 * drag)


def test_a_step_that_stops_the_vehicle_is_no_start():
    begun = refit(Fit(_too_far), [_DRAG], [5500.0])
    assert list(begun.sizes) == [0.0]


def test_a_step_that_is_better_than_the_model_without_the_effect_is_taken():
    begun = refit(Fit(_too_far), [_DRAG], [1500.0])
    assert list(begun.sizes) == [1500.0]


def test_effects_that_are_in_the_model_keep_their_sizes_where_the_new_one_is_off():
    fit = Fit(lambda payload, drag: _too_far(drag), [_PAYLOAD], [0.2])
    begun = refit(fit, [_PAYLOAD, _DRAG], [0.5, 5500.0])
    assert list(begun.sizes) == [0.2, 0.0]
