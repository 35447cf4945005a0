"""Several drives of one vehicle: causes and numbers in common, and every drive's own clocks and biases."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.diagnosis import diagnose, split_runs
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.nuisances import NUISANCES, acts, nuisances_of
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT
from estimators.discrepancy.other_runs import gains_on
from estimators.discrepancy.summarise import summarise


def _drive(seed: int, duration: float, name: str):
    """A drive of the same late vehicle on the same soil."""
    case = draw_case(seed, soil="lete_sand", n=0.8, road="flat", gnss=True, duration=duration)
    return simulated_log(case, FAULTS["steer_delay"](0.06), name)


@pytest.fixture(scope="module")
def drives():
    """Two drives of one late vehicle, the second with an accelerometer that reads too much on that day."""
    first, second = _drive(31, 24.0, "first"), _drive(32, 24.0, "second")
    return first, replace(second, channels=second.channels | {"a_x": second.channels["a_x"] + 0.04})


def test_one_drive_has_the_usual_nuisances_and_each_further_one_its_own_clocks_and_biases(drives):
    assert nuisances_of(drives[:1]) is NUISANCES
    several = nuisances_of(drives)
    own = [one for one in NUISANCES if one.own]
    assert {one.name for one in own} == {"shift", "wheel_age", "pose_age", *(f"bias_{i}" for i in range(5))}
    assert len(several) == len(NUISANCES) + len(own)
    assert [one.name for one in several[: len(NUISANCES)]] == [one.name for one in NUISANCES]
    runs = split_runs(drives)[FIT]
    for one in several:
        assert sum(acts(one, run) for run in runs) <= (1 if one.own else 2)


def test_drives_that_state_other_soils_have_an_n_each(drives):
    first, second = drives
    soil = second.config.soil._replace(n=second.config.soil.n + 0.1)
    other = replace(second, config=replace(second.config, soil=soil))
    names = [one.name for one in nuisances_of([first, other])]
    assert "ground of second" in names
    assert "ground of second" not in [one.name for one in nuisances_of(drives)]


def test_long_drives_are_divided_by_time_each_and_short_ones_one_by_one(drives):
    long = split_runs([*drives, replace(drives[0], name="third")])
    assert [len(long[use]) for use in (FIT, SELECT, REPORT)] == [3, 3, 3]
    short = [_drive(seed, 8.0, f"short {seed}") for seed in range(31, 35)]
    parts = split_runs(short)
    assert sum(len(parts[use]) for use in (FIT, SELECT, REPORT)) == 4
    assert all(run.nuisances is NUISANCES for run in parts[FIT])


@pytest.mark.check
def test_drives_together_name_one_cause_with_one_value_and_each_keeps_its_bias(drives):
    found = diagnose(drives, library=("steer_delay", "payload", "accel_bias_x"))
    assert found.verdict == "NAMED"
    (cause,) = found.causes
    assert cause.best.candidate.effect == "steer_delay"
    assert cause.best.size == pytest.approx(0.06, abs=0.01)
    values = found.checks.nuisances
    names = {log.name: "bias_0" if log is found.logs[0] else f"bias_0 of {log.name}" for log in found.logs}
    assert values[names["second"]] - values[names["first"]] == pytest.approx(0.04, abs=0.015)
    assert summarise(found).to_dict()["families"] == [["late steering"]]
    third = _drive(33, 12.0, "third")
    gains = {gain.channel: gain for gain in gains_on(found, [third])["third"]}
    assert gains["yaw_rate"].low > 0.0
    assert np.isfinite(gains["a_x"].extended)


def test_a_problem_of_the_data_says_whose_it_is(drives):
    first, second = drives
    wrong = replace(second, channels=second.channels | {"yaw_rate": np.degrees(second.channels["yaw_rate"])})
    found = diagnose([first, wrong])
    assert found.verdict == "DATA PROBLEM"
    assert all(finding.sentence.startswith("second: ") for finding in found.findings)
