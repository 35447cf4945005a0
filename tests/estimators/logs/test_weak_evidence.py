"""Units and axes by how the vehicle moves, where no number of a column is impossible by itself."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.logs.checking import conventions
from estimators.logs.checking.weak_evidence import weak_unit_remarks
from estimators.logs.log import Log
from estimators.logs.quality import quality


@pytest.fixture(scope="module")
def drive() -> Log:
    return simulated_log(draw_case(3))


@pytest.mark.parametrize(
    ("factor", "unit", "words"),
    [(np.degrees(1.0), "deg", "in degrees"), (16.0, "rad", "of a steering wheel"), (1.0, None, None)],
)
def test_an_angle_that_hardly_turns_is_in_degrees_or_that_of_a_steering_wheel(drive, factor, unit, words):
    channels = {**drive.channels, "steer": factor * drive.channels["steer"]}
    log = replace(drive, channels=channels)
    remarks = weak_unit_remarks(log, quality(log), lambda name: (name,))
    if unit is None:
        assert not remarks
        return
    (remark,) = remarks
    assert words in remark.sentence
    (line,) = remark.lines
    assert line.key == "units.steer"
    assert line.value.endswith(unit)
    if unit == "rad":  # no wheel turns more than it steers: what the soil gives away makes the ratio larger
        assert 1.0 / 30.0 < float(line.value.split()[0]) < 1.0 / 12.0


@pytest.mark.parametrize(
    ("mean", "kinematic", "seen"),
    [
        (3.0, True, False),  # a vehicle that brakes, or a bias
        (6.5, True, True),  # gravity is there after all
        (3.0, False, True),  # in another unit, perhaps
    ],
)
def test_a_small_mean_is_no_gravity_where_that_is_taken_out(mean, kinematic, seen):
    """A stuck vehicle had its IMU turned upright by half a metre per second squared of braking."""
    log = SimpleNamespace(imu=SimpleNamespace(kinematic=kinematic), duration=10.0)
    noise = 0.01 * np.random.default_rng(1).standard_normal((3, 20))
    direction = conventions._gravity(log, [*(np.array([[mean], [0.0], [0.0]]) + noise)])
    assert np.isfinite(direction).all() == seen
