"""Delays beyond what a score sees, under a steering that is corrected many times a second."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults import drive
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.search import finite_delays
from estimators.discrepancy.search.finite_delays import delayed
from estimators.discrepancy.search.score_test import score_test

_STEERING = [Candidate(effect="steer_delay")]


class _Nervous(drive._Driver):
    """Steers at random, another angle with each command."""

    def __init__(self, rng, case):
        super().__init__(rng, case)
        self._rng = np.random.default_rng(5)

    def __call__(self, t, v):
        _, *pedals = super().__call__(t, v)
        return 0.2 * self._rng.standard_normal(), *pedals


def _late(log, rows):
    steer = log.channels["steer"].copy()
    steer[rows:], steer[:rows] = steer[:-rows], steer[0]
    return fit_runs([RunModel(replace(log, channels={**log.channels, "steer": steer}))])


@pytest.fixture(scope="module")
def nervous():
    """The nominal fit to such a drive, its steering stamped 0.2 s late."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "_Driver", _Nervous)
        log = simulated_log(draw_case(31, road="flat", gnss=True, duration=19.0))
    return _late(log, 20)


def test_a_delay_is_found_that_no_score_points_to(nervous):
    score = score_test(nervous, _STEERING)
    assert abs(score.size[0]) < 0.05
    (found,) = delayed(nervous, _STEERING, 3.4)
    assert found.sizes[0] == pytest.approx(-0.2, abs=0.02)
    assert delayed(nervous, [Candidate(effect="payload")], 3.4) == []


def test_what_explains_less_than_an_effect_must_is_no_model(nervous, monkeypatch):
    assert delayed(nervous, _STEERING, 1e3) == []
    monkeypatch.setattr(finite_delays, "_gain", lambda *_: 1e9)
    assert delayed(nervous, _STEERING, 1e3) == []


def test_where_a_score_sees_delays_none_is_tried(monkeypatch):
    log = simulated_log(draw_case(31, road="flat", gnss=True, duration=12.0))
    monkeypatch.setattr(finite_delays, "_gain", lambda *_: pytest.fail("tried"))
    assert delayed(_late(log, 20), _STEERING, 3.4) == []
