"""The common protocol: what is measured, how runs are scored and summed up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.scores import score
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.filter_comparison import row_bound, run_filter
from estimators.experiments.simulated_rows import REPORT_SEEDS, TUNING_SEEDS, simulate_row
from estimators.filters.joint_bank import BankSettings
from offroad_env.errors import InvalidParameter

pytestmark = pytest.mark.check

SETTINGS = BankSettings()


@pytest.fixture(scope="module")
def bank():
    """(simulated row, history of the bank on it)."""
    drive = simulate_row(ROWS[2], 101, SETTINGS.joint, duration=4.0)
    return drive, run_filter("map_ukf_bank", drive)


def test_seeds_of_tuning_and_report_do_not_meet():
    assert not set(TUNING_SEEDS) & set(REPORT_SEEDS)
    assert len(REPORT_SEEDS) >= 20


def test_sensor_sets_measure_what_they_say():
    twin = simulate_row(ROWS[2], 1, SETTINGS.joint, duration=1.0)
    measured = {name: np.isfinite(twin.readings(name)).sum(axis=0) for name in ("imu", "imu+wheels+gnss")}
    assert list(measured["imu"]) == [101] * 5 + [0] * 6
    assert list(measured["imu+wheels+gnss"]) == [101] * 7 + [11] * 4
    with pytest.raises(InvalidParameter, match="lidar"):
        twin.readings("lidar")


def test_score_follows_from_the_run(bank):
    drive, history = bank
    found = score(history, drive.n)
    error = history.n - drive.n
    assert found.mse == pytest.approx(np.mean(error**2))
    assert math.isnan(found.late_mse)
    after = drive.t >= found.time_to_5pct
    assert (np.abs(error[after]) <= 0.05 * 0.5).all()
    assert 0.0 < found.time_to_5pct < 3.0
    assert not found.wrong
    assert row_bound(drive)[-1] < 0.01
    assert found.coverage == pytest.approx(np.mean((history.low <= drive.n) & (drive.n <= history.high)))
    assert found.valid == pytest.approx(history.flag.mean())
