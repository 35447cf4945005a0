"""The common protocol: what is measured, how runs are scored and summed up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.bank import BankSettings
from estimators.paper import ROWS
from estimators.protocol_runs import REPORT_SEEDS, TUNING_SEEDS, row_twin, run_bank_row, summarise
from offroad_env.errors import InvalidParameter

SETTINGS = BankSettings()


@pytest.fixture(scope="module")
def score():
    return run_bank_row(ROWS[2], 101, duration=4.0)


def test_seeds_of_tuning_and_report_do_not_meet():
    assert not set(TUNING_SEEDS) & set(REPORT_SEEDS)
    assert len(REPORT_SEEDS) >= 20


def test_sensor_sets_measure_what_they_say():
    twin = row_twin(ROWS[2], 1, SETTINGS.joint, duration=1.0)
    measured = {name: np.isfinite(twin.readings(name)).sum(axis=0) for name in ("imu", "imu+wheels+gnss")}
    assert list(measured["imu"]) == [101] * 5 + [0] * 6
    assert list(measured["imu+wheels+gnss"]) == [101] * 7 + [11] * 4
    with pytest.raises(InvalidParameter, match="lidar"):
        twin.readings("lidar")


def test_score_follows_from_the_run(score):
    error = score.run.n - score.twin.n
    assert score.mse == pytest.approx(np.mean(error**2))
    assert math.isnan(score.late_rmse)
    after = score.twin.t >= score.time_to_5pct
    assert (np.abs(error[after]) <= 0.05 * 0.5).all()
    assert 0.0 < score.time_to_5pct < 3.0
    assert not score.ends_wrong
    assert score.bound[-1] < 0.01


def test_summary_of_one_run_is_the_run(score):
    line = summarise([score])
    assert (line.row, line.ends_wrong, line.repairs) == (3, 0, 0)
    assert line.mse == line.mse_low == line.mse_high == score.mse
    assert line.coverage == pytest.approx(
        np.mean((score.run.low <= score.twin.n) & (score.twin.n <= score.run.high))
    )
    assert line.valid == pytest.approx(score.run.valid.mean())


def test_rows_are_not_mixed(score):
    other = run_bank_row(ROWS[3], 101, duration=0.5)
    with pytest.raises(InvalidParameter, match="one row"):
        summarise([score, other])
    with pytest.raises(InvalidParameter, match="one row"):
        summarise([])
