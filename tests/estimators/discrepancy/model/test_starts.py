"""What sensors tell of the state in which a window begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import fit_runs, settled
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.starts import FREE, StartSensors
from estimators.discrepancy.search.refitting import refit
from estimators.logs import Log
from offroad_env.physics import state as at

_WIDE = FREE[at.YAW]


def _log(*, gnss: bool, seed: int = 3, duration: float = 30.0) -> Log:
    return simulated_log(draw_case(seed, road="unknown", gnss=gnss, natural=True, duration=duration))


def _without(log: Log, *names: str) -> Log:
    return replace(log, channels={name: v for name, v in log.channels.items() if name not in names})


def _headings(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """(headings at the starts of the windows, standard deviations of their priors)."""
    run = RunModel(log)
    return run.first_starts(run.setup)[0][:, at.YAW], run.spread[:, run.free.index(at.YAW)]


def test_without_another_sensor_the_gyro_tells_the_heading():
    known, blind = _log(gnss=True), _log(gnss=False)
    truth, wide = _headings(known)
    heading, narrow = _headings(blind)
    assert np.ptp(truth) > 0.3
    # The course of a satellite receiver is as noisy as its speed, 0.05 m/s.
    assert heading == pytest.approx(truth, abs=0.08)
    assert wide == pytest.approx(np.full(len(truth), _WIDE))
    t = RunModel(blind).step * RunModel(blind).windows.first
    assert narrow == pytest.approx(np.hypot(0.005, 5e-4 * t))


@pytest.mark.parametrize("other", ["yaw", "course", "x"])
def test_any_other_sensor_of_heading_or_place_leaves_it_open(other):
    blind = _log(gnss=False)
    seen = replace(blind, channels={**blind.channels, other: np.zeros(len(blind.t))})
    spread = StartSensors(seen, radius=0.3, driven=True).spread([at.YAW], np.array([0.0, 20.0]))
    assert spread == pytest.approx(np.full((2, 1), _WIDE))


def test_without_a_gyro_or_after_a_pause_the_heading_is_unknown():
    blind = _log(gnss=False)
    t = np.array([1.0, 9.0, 21.0])
    nothing = StartSensors(_without(blind, "yaw_rate"), radius=0.3, driven=True)
    assert nothing.spread([at.YAW, at.X], t)[:, 0] == pytest.approx(np.full(3, _WIDE))
    for pause, lost in ((0.45, False), (0.55, True)):
        rate = blind.channels["yaw_rate"].copy()
        rate[(blind.t > 10.0) & (blind.t < 10.0 + pause)] = np.nan
        silent = replace(blind, channels={**blind.channels, "yaw_rate": rate})
        spread = StartSensors(silent, radius=0.3, driven=True).spread([at.YAW], t)[:, 0]
        assert spread[:2] == pytest.approx(np.hypot(0.005, 5e-4 * t[:2]), rel=1e-3)
        assert spread[2] == pytest.approx(_WIDE if lost else np.hypot(0.005, 5e-4 * t[2]), rel=1e-3)


def test_a_gyro_that_has_drifted_far_is_no_worse_than_none():
    late = np.array([0.0, 600.0, 5000.0])
    sensors = StartSensors(_log(gnss=False), radius=0.3, driven=True)
    assert sensors.spread([at.YAW], late)[:, 0] == pytest.approx([0.005, 0.30004, _WIDE], rel=1e-3)


def test_every_drive_of_several_has_priors_of_its_own():
    runs = [RunModel(_log(gnss=gnss, duration=12.0)) for gnss in (True, False)]
    problem = LeastSquaresProblem(runs)
    heading, windows = runs[0].free.index(at.YAW), len(runs[0].windows)
    information = problem.state_information[:, heading]
    assert problem.state_information.shape == (windows + len(runs[1].windows), len(runs[0].free))
    assert information[:windows] == pytest.approx(np.full(windows, _WIDE**-2))
    assert np.all(information[windows:] > 1e3)


def test_a_slope_of_the_ground_is_not_turned_in_every_window():
    """Its push would otherwise point sideways as far as soil that scatters asks for, in each window anew."""
    fit = fit_runs([RunModel(_log(gnss=False, seed=28012, duration=20.0))], white=True)
    fit = refit(fit, [Candidate(effect="grade")], [-0.06])
    assert fit is not None
    fit = settled(fit, fresh=False)
    turned = (fit.point.starts[0] - fit.point.centre[0])[:, at.YAW]
    assert np.abs(turned).max() < 0.05
