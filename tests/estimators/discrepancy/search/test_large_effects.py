"""Effects so large that the numbers of a model without them end far from any truth."""

import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.tolerances import TOLERATED
from estimators.discrepancy.search.from_stated import fits_from_stated
from estimators.discrepancy.search.holdout import HoldOutTest
from estimators.discrepancy.search.score_test import candidates_for, score_test
from estimators.discrepancy.search.stepwise import _larger
from offroad_env.effects import EFFECTS

#: Load of the simulated vehicle [share of its mass].
_LOAD = 0.63


@pytest.fixture(scope="module")
def scores():
    """Scores of a log of a vehicle with a load of six tenths of its mass."""
    case = draw_case(9700, road="unknown", natural=True, duration=19.0)
    fit = fit_runs([RunModel(simulated_log(case, FAULTS["payload"](_LOAD)))])
    return score_test(fit, candidates_for(fit, ("payload", "steer_gain", "cg_shift")))


@pytest.mark.check
def test_a_number_that_has_hidden_a_large_effect_leads_to_it(scores):
    assert scores.fit.nuisance_values()["mass"] > 5.0
    first = _larger(
        scores, 3.4, HoldOutTest(scores.fit, []), fits_from_stated(scores, 3.4, wide=True), False
    )[0]
    assert [candidate.effect for candidate in first.candidates] == ["payload"]
    assert first.sizes[0] == pytest.approx(_LOAD, rel=0.15)


def test_the_effect_beyond_a_tolerance_is_one_of_the_library():
    named = {nuisance.effect for nuisance in TOLERATED} - {""}
    assert named <= set(EFFECTS)
    assert "payload" in named
