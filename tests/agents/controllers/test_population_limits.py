"""How the belief about what the soil holds becomes the limits that a controller drives with."""

from types import SimpleNamespace

import numpy as np
import pytest

from agents.controllers.natural_tuned import SETTINGS
from agents.controllers.nmpc_arms import make_nmpc
from agents.controllers.population_limits import believe_limit, coordinate_of
from estimators.filters.online_soil_belief import BELIEF_VECTOR

_TABLE = SimpleNamespace(grid=np.linspace(1.0, 9.0, 5))


def _seen(mean: float, sd: float, *, valid: bool) -> dict[str, np.ndarray]:
    """An observation whose belief about the lateral limit is this."""
    place, terrain = BELIEF_VECTOR.index("lateral"), np.zeros(len(BELIEF_VECTOR))
    terrain[[place, place + 1, -1]] = mean, sd, valid
    return {"terrain": terrain}


def _believed(mean: float, sd: float, *, valid: bool, z: float = 1.0):
    return believe_limit(coordinate_of("speed"), z)(None, _TABLE, _seen(mean, sd, valid=valid))


def test_a_valid_belief_is_insured_over_its_standard_deviations():
    assert _believed(5.0, 0.5, valid=True) == pytest.approx((4.5, 5.0, 5.5))
    assert _believed(5.0, 0.5, valid=True, z=2.0) == pytest.approx((4.0, 5.0, 6.0))


def test_with_the_flag_down_the_mean_stays_and_the_deviation_counts_twice():
    """On soft soil the middle of the population is a worse guess than a belief of doubtful width."""
    assert _believed(2.5, 0.5, valid=False) == pytest.approx((1.5, 2.5, 3.5))


def test_what_the_population_does_not_hold_is_not_believed():
    assert _believed(1.2, 0.5, valid=True).low == 1.0
    assert _believed(20.0, 0.5, valid=True).mean == 9.0


def test_without_a_number_the_middle_of_the_population_stands_in():
    found = _believed(np.nan, 0.5, valid=False)
    assert found.mean == 5.0
    assert found.high - found.low == pytest.approx(2.0 * 8.0 / np.sqrt(12.0))


def test_model_predictive_control_is_insured_over_what_its_knobs_say(monkeypatch):
    pytest.importorskip("casadi")
    knobs = {**SETTINGS["speed", "nmpc_belief", "common"], "z": 0.7}
    monkeypatch.setitem(SETTINGS, ("speed", "nmpc_belief", "common"), knobs)
    controller = make_nmpc("nmpc_belief", natural=True).agent.agent
    assert controller.believe(None, _TABLE, _seen(5.0, 1.0, valid=True)).low == pytest.approx(4.3)
    assert controller.settings.margin == knobs["margin"]
