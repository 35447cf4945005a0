"""What causes leave by channel and regime: noise where the model is right, else no name is certain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.checks.regime_rest import RegimeRest, regime_rests
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.search.refitting import refit
from estimators.discrepancy.verdict import OVERLAP, REST_RATE, VehicleDiagnosis, Verdict
from estimators.discrepancy.wording import verdict_sentence


@pytest.fixture(scope="module")
def delayed():
    """A run whose steering acts 0.1 s late, and the fit with that delay."""
    log = simulated_log(draw_case(31, road="flat", duration=19.0), FAULTS["steer_delay"](0.1))
    nominal = fit_runs([RunModel(log, use=FIT)])
    return nominal, refit(nominal, [Candidate(effect="steer_delay")], [0.1])


def test_the_right_model_leaves_noise(delayed):
    nominal, right = delayed
    assert regime_rests(right)[0].p_value > 0.05
    # The learned noise takes most of what is late: the mean of a regime is a weak test of that.
    first = regime_rests(nominal)[0]
    assert abs(first.z) > abs(regime_rests(right)[0].z)
    assert first.alike == ()


def test_a_sensor_that_errs_in_left_turns_alone_is_seen_there_and_resembles_late_steering_little(delayed):
    nominal, right = delayed
    log = nominal.runs[0].log
    turning = log.channels["a_y"] > 0.5
    channels = log.channels | {"a_y": log.channels["a_y"] + 0.3 * turning}
    fit = fit_runs([RunModel(replace(log, channels=channels), use=FIT)])
    fit = refit(fit, right.candidates, right.sizes)
    first = regime_rests(fit)[0]
    assert (first.channel, first.regime) == ("a_y", "turning left")
    assert first.p_value < REST_RATE
    assert len(first.alike) == 1
    assert 0.0 <= first.alike[0] <= 1.0


def _rest(p_value: float, alike: float) -> RegimeRest:
    return RegimeRest(channel="a_y", regime="turning left", z=6.0, p_value=p_value, alike=(alike,))


def test_a_significant_rest_takes_the_certainty_from_a_name_that_it_resembles():
    cause = SimpleNamespace(alternatives=(None,))
    first = SimpleNamespace(z=np.array([9.0]))
    search = SimpleNamespace(
        refused=False, capped=False, strayed=(), uncertain=(), beyond_null_logs=False, first=first
    )
    checks = SimpleNamespace(overlap=0.0, solver=0.0, converged=True)
    plain = VehicleDiagnosis(search=search, checks=checks, causes=(cause,))
    assert plain.verdict is Verdict.NAMED
    uncertain = replace(plain, rests=(_rest(0.6 * REST_RATE, 1.1 * OVERLAP),))
    assert uncertain.inadequate == (True,)
    assert uncertain.verdict is Verdict.ONE_OF
    for rest in (_rest(1.1 * REST_RATE, 1.0), _rest(0.0, 0.9 * OVERLAP)):
        assert replace(plain, rests=(rest,)).verdict is Verdict.NAMED
    # A model that is full, and beside which effects are significant, may stand for one cause that is missing.
    full = replace(plain, search=SimpleNamespace(**vars(search) | {"capped": True}))
    assert full.verdict is Verdict.NAMED_WITH_REST
    assert replace(full, rests=uncertain.rests).verdict is Verdict.ONE_OF
    correlated = SimpleNamespace(**vars(checks) | {"overlap": 1.1 * OVERLAP})
    assert replace(full, checks=correlated).verdict is Verdict.ONE_OF
    assert replace(plain, checks=correlated).verdict is Verdict.ONE_OF
    correlated.overlap = 0.9 * OVERLAP
    assert replace(plain, checks=correlated).verdict is Verdict.NAMED
    # Beside other discrepancies unknown inputs, fitted jointly, decide.
    assert replace(uncertain, search=SimpleNamespace(**vars(search) | {"refused": True})).inadequate == (
        False,
    )


def test_the_sentence_says_what_is_not_noise():
    cause = SimpleNamespace(
        named=True, joint=None, families=(), members=(SimpleNamespace(phrase="the steering acts late"),)
    )
    diagnosis = VehicleDiagnosis(
        search=SimpleNamespace(refused=False, capped=False, strayed=(), uncertain=()),
        checks=SimpleNamespace(overlap=0.0),
        causes=(SimpleNamespace(alternatives=(None,)),),
        rests=(_rest(0.0, 0.9),),
    )
    assert verdict_sentence(Verdict.ONE_OF, diagnosis, [cause]) == (
        "The steering acts late; or another law of the same cause: what remains of a_y (turning left) "
        "resembles it and is not noise."
    )
    correlated = replace(diagnosis, checks=SimpleNamespace(overlap=1.1 * OVERLAP), rests=())
    assert verdict_sentence(Verdict.ONE_OF, correlated, [cause]) == (
        "The steering acts late; or a single cause that the library lacks: their sizes are correlated."
    )


@pytest.mark.parametrize(("null", "expected"), [(None, 1.97e-9), (48, 2.5e-7), (10, 1.3e-4)])
def test_few_null_simulations_make_large_scores_less_rare(null, expected):
    """The variance of a score from K simulations errs itself: its law has the tails of Student's t."""
    sample = None if null is None else SimpleNamespace(white=np.zeros((5, null)))
    assert FitResult.tail(SimpleNamespace(null=sample), -6.0) == pytest.approx(expected, rel=0.05)
