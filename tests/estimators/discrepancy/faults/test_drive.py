"""Data as loggers leave them: gaps, lost samples, uneven stamps, a clock that jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from offroad_env.effects import EFFECTS

_CASE = draw_case(34, road="flat", duration=30.0, gnss=True)
_INPUTS = ("steer", "torque_f", "torque_r")


def _worn(log):
    """A tenth of the sensors' samples lost, a second of silence, stamps uneven by a millisecond."""
    rng = np.random.default_rng(5)
    t = log.t + np.concatenate([[0.0], rng.uniform(-1e-3, 1e-3, len(log.t) - 1)])
    kept = (log.t < 12.0) | (log.t > 13.0)
    channels = {
        name: (values if name in _INPUTS else np.where(rng.random(len(t)) < 0.1, np.nan, values))[kept]
        for name, values in log.channels.items()
    }
    return replace(log, t=t[kept], channels=channels, references={})


def _late_from(log, start: float, delay: float):
    """The sensors' clock jumps: from ``start`` [s] on their samples come ``delay`` [s] late."""
    rows, first = round(delay / 0.01), int(np.searchsorted(log.t, start))
    channels = dict(log.channels)
    for name in channels.keys() - set(_INPUTS):
        values = channels[name].copy()
        values[first + rows :] = channels[name][first:-rows]
        values[first : first + rows] = np.nan
        channels[name] = values
    return replace(log, channels=channels, references={})


@pytest.mark.study
def test_worn_data_with_nothing_wrong_raise_no_alarm():
    assert diagnose([_worn(simulated_log(_CASE))]).verdict == "NO EFFECT"


@pytest.mark.check
def test_an_effect_is_found_in_worn_data_with_its_size():
    diagnosis = diagnose([_worn(simulated_log(_CASE, FAULTS["torque_scale"](0.1)))])
    sizes = {rival.candidate.effect: rival.size for cause in diagnosis.causes for rival in cause.alternatives}
    assert sizes["torque_scale"] == pytest.approx(0.1, rel=0.2)


@pytest.mark.study
def test_a_clock_that_jumps_is_no_cause_in_the_soil_or_the_vehicle():
    diagnosis = diagnose([_late_from(simulated_log(_CASE), 8.0, 0.2)])
    assert diagnosis.verdict != "NO EFFECT"
    if diagnosis.verdict in ("NAMED", "ONE OF"):
        first = diagnosis.causes[0].best.candidate.effect
        assert EFFECTS[first].family == "timing"
