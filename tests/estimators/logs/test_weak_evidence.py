"""Units by how the vehicle moves, where no number of a column is impossible by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
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
