"""What online filters share: ranges, actuators at rest, and the validity of a report."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.filters.online_base import checked_range, filter_range, follow_command, report_estimate
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES


def test_a_range_that_is_no_soil_is_refused():
    plant = make_plant(VEHICLES["mrzr"], make_soil("dry_sand"), flat())
    with pytest.raises(InvalidParameter, match="n_range"):
        checked_range(plant, (1.1, 0.3), 0.01)
    with pytest.raises(InvalidParameter, match="in ms"):
        checked_range(plant, (0.3, 1.1), 10.0)


@pytest.mark.parametrize("n_range", [(0.3, 1.1), (0.06, 2.5)])
def test_a_filter_has_room_beyond_the_bounds_that_it_reports(n_range):
    low, high = filter_range(n_range)
    assert 0.0 < low < n_range[0]
    assert high > n_range[1]
    wide = report_estimate((high, 0.1), n_range, 1.0, 0, True)
    assert wide.mean == n_range[1]


def test_actuators_follow_with_their_lags():
    x = np.zeros(at.STATE_SIZE)
    for _ in range(20):
        follow_command(x, (0.1, 500.0, 200.0), (0.1, 0.2), 0.01)
    # Euler's steps of 0.01 s: within 1 % of the exponential.
    assert x[at.STEER] == pytest.approx(0.1 * (1.0 - math.exp(-2.0)), rel=0.02)
    assert x[at.DRIVE] == pytest.approx(500.0 * (1.0 - math.exp(-1.0)), rel=0.02)
    assert x[at.BRAKE] / 200.0 == pytest.approx(x[at.DRIVE] / 500.0)


def test_a_command_without_a_brake_leaves_no_nan_in_the_state():
    x = np.zeros(at.STATE_SIZE)
    follow_command(x, (0.1, 500.0, math.nan), (0.1, 0.2), 0.01)
    assert np.isfinite(x).all()


def test_an_estimate_without_a_finite_width_is_never_valid():
    assert report_estimate((0.7, 0.1), (0.3, 1.1), 1.0, 0, True).valid
    assert not report_estimate((0.7, math.nan), (0.3, 1.1), 1.0, 0, True).valid
    assert not report_estimate((0.7, 0.1), (0.3, 1.1), 1.0, 0, False).valid
