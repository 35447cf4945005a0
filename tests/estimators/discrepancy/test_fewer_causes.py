"""Causes that forecasts refute together: those remain that they do not refute alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy import diagnosis
from estimators.discrepancy.diagnosis import SCREEN_RATE, split_runs
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.windows import FIT, SELECT
from estimators.discrepancy.search.stepwise import search, without_cause
from estimators.discrepancy.verdict import VehicleDiagnosis


@pytest.mark.parametrize("left_out", [0, 1])
def test_without_a_cause_the_other_is_fitted_and_something_remains(left_out):
    """Of a log whose steering angles and torques are stated too large."""
    log = simulated_log(draw_case(31, road="flat", gnss=True, duration=16.0))
    wrong = {"torque_f": 1.4, "torque_r": 1.4, "steer": 1.2}
    channels = {**log.channels, **{name: scale * log.channels[name] for name, scale in wrong.items()}}
    parts = split_runs([replace(log, channels=channels)])
    found = search(fit_runs(parts[FIT]), ("steer_gain", "torque_scale"), SCREEN_RATE, parts[SELECT])
    assert {cause.best.candidate.effect for cause in found.causes} == {"steer_gain", "torque_scale"}
    gone, kept = (found.extended.candidates[k].effect for k in (left_out, 1 - left_out))
    found = replace(found, uncertain=(1,))
    fewer = without_cause(found, left_out, parts[SELECT], SCREEN_RATE)
    assert fewer.uncertain == ((0,) if left_out == 0 else ())
    assert [cause.best.candidate.effect for cause in fewer.causes] == [kept]
    assert [candidate.effect for candidate in fewer.extended.candidates] == [kept]
    assert fewer.extended.minus_log_likelihood > found.extended.minus_log_likelihood
    assert fewer.refused
    assert not fewer.capped
    # The scores are those beside the smaller model: what was left out has one again.
    assert {c.effect for c in fewer.last.candidates} == {gone}
    assert np.abs(fewer.last.z).max() > fewer.threshold


@pytest.mark.parametrize(
    ("right", "causes", "tried"),
    [
        ({"abc"}, "abc", []),
        ({"bc", "b", "c"}, "bc", ["bc"]),
        ({"c"}, "c", ["bc", "c"]),
        ({"b"}, "b", ["bc", "c", "b"]),
        ({"a"}, "abc", ["bc", "c", "b"]),
    ],
)
def test_causes_are_left_out_until_forecasts_do_not_refute_the_others(monkeypatch, right, causes, tried):
    """Of sizes 1, 2 and 3 deviations; where forecasts refute what remains the first result stays."""
    seen = []

    class Result(VehicleDiagnosis):
        misled = property(lambda self: "".join(self.causes) not in right)
        stated = property(lambda self: () if self.misled else self.causes)

    def completed(begun, done, allowed, failed, progress):
        seen.append("".join(done.found.causes))
        return Result(causes=done.found.causes)

    def found(names):
        sizes = np.array([1.0 + "abc".index(name) for name in names])
        fit = SimpleNamespace(sizes=sizes, size_deviations=lambda: np.ones(len(sizes)))
        return SimpleNamespace(causes=tuple(names), extended=fit, solver_error=lambda: 0.0)

    def without(result, left_out, apart, rate):
        return found([name for k, name in enumerate(result.causes) if k != left_out])

    monkeypatch.setattr(diagnosis, "_completed", completed)
    monkeypatch.setattr(diagnosis, "without_cause", without)
    done = diagnosis._Searched({SELECT: []}, None, {}, found("abc"), 0.0)
    stages = []
    result = diagnosis._with_fewer_causes(Result(causes=("a", "b", "c")), Result(), done, (), stages.append)
    assert "".join(result.causes) == causes
    assert seen == tried
    assert stages == ["fewer causes"] * len(tried)


def test_a_failure_on_the_way_leaves_the_first_result(monkeypatch):
    def fails(found, left_out, apart, rate):
        raise ArithmeticError("singular")

    class Result(VehicleDiagnosis):
        misled = True

    monkeypatch.setattr(diagnosis, "without_cause", fails)
    fit = SimpleNamespace(sizes=np.ones(2), size_deviations=lambda: np.ones(2))
    found = SimpleNamespace(causes=("a", "b"), extended=fit)
    done = diagnosis._Searched({SELECT: []}, None, {}, found, 0.0)
    first = Result(causes=("a", "b"))
    assert diagnosis._with_fewer_causes(first, Result(), done, (), lambda stage: None) is first
    assert not first.failed
