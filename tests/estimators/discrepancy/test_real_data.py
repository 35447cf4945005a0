"""Measured data of other people: what the commands and a diagnosis make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agents.commands.data import LogOf as DataLog
from agents.commands.diagnose import Diagnose
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.gauss_newton import bounded_step, moved
from estimators.discrepancy.model.normal_equations import NormalEquations, WindowSolution
from estimators.discrepancy.model.nuisances import NUISANCES
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.structure_comparison import compare_structures
from estimators.discrepancy.summarise import summarise
from estimators.logs import f1tenth_log, read_log, write_log
from estimators.rig.cmu_soil_bin import cmu_rig_log
from helpers import measured_data
from offroad_env.effects import EFFECTS, apply
from offroad_env.errors import DataError


@pytest.mark.parametrize("drive", ["DS1", "DS2", "DS3"])
def test_a_published_drive_in_the_wrong_units_ends_in_a_data_problem_that_names_them(drive, tmp_path):
    path = measured_data("f1tenth_indoor") / f"{drive}.csv"
    DataLog(name="f1tenth_indoor", path=path, out=tmp_path).run()
    diagnosis = diagnose([read_log(tmp_path / f"{drive}.csv")])
    assert diagnosis.verdict == "DATA PROBLEM"
    said = " ".join(finding.sentence for finding in diagnosis.findings)
    assert "yaw_rate is in deg/s" in said
    assert "a_z is in g" in said
    assert "turned by 90 degrees" in said
    assert "deg/s" in summarise(diagnosis).sentence


def test_the_soil_bin_becomes_a_log_that_reads_back_as_it_was(tmp_path):
    path = measured_data("cmu_single_wheel") / "original" / "all_grouser_data.mat"
    DataLog(name="cmu_single_wheel", path=path, out=tmp_path).run()
    back, log = read_log(tmp_path / "cmu_single_wheel.csv"), cmu_rig_log(path)
    assert back.rig
    assert back.hash == log.hash
    for name, values in log.channels.items():
        assert np.array_equal(back.channels[name], values, equal_nan=True)


def test_without_a_file_all_published_drives_become_logs(tmp_path):
    measured_data("f1tenth_indoor")
    DataLog(name="f1tenth_indoor", out=tmp_path).run()
    assert {path.name for path in tmp_path.glob("*.csv")} == {"DS1.csv", "DS2.csv", "DS3.csv"}


def test_trials_and_drives_are_not_mistaken_for_each_other(tmp_path):
    drive = write_log(tmp_path / "run.csv", simulated_log(draw_case(9, duration=5.0)))
    with pytest.raises(DataError, match="a drive, not trials"):
        Diagnose(logs=(drive,), rig=True, out=tmp_path).run()


def test_inputs_are_nobodys_fault_by_half_a_sample_at_most():
    """Else the healthy timing of the inputs would swallow any delay of the steering."""
    problem = LeastSquaresProblem([RunModel(simulated_log(draw_case(9, duration=8.0, road="flat")), use=FIT)])
    point, run = problem.begun(problem.stated()), problem.runs[0]
    change = np.zeros(len(NUISANCES))
    shift = [nuisance.name for nuisance in NUISANCES].index("shift")
    change[shift] = 10.0
    states = len(run.free)
    still = WindowSolution(offset=np.zeros(states), slope=np.zeros((states, len(change))))
    point = moved(problem, point, change, [still] * len(run.windows), 1.0)
    assert point.nuisances[shift] == pytest.approx(np.sqrt(3.0))
    # sqrt(3) standard deviations of a uniform law over a sample are half of it.
    assert problem.setup(run, point).inputs.delay == pytest.approx(0.5 * run.step)


def hard_drive(**columns):
    """A drive of the 1:10 car on a hard floor whose wheels turn as measured."""
    drive = f1tenth_log(measured_data("f1tenth_indoor") / "DS1.csv", corrected=True)
    return replace(drive, channels=drive.channels | columns)


def test_no_window_holds_a_jump_of_the_position_or_a_car_that_stands():
    drive = hard_drive()
    run = RunModel(drive, whole=FIT)
    begin = run.t_0 + run.step * run.windows.first
    end = begin + run.step * run.windows.count
    # The particle filter of this drive loses the car three times, the last at 40.1 s.
    for jump in (25.4, 27.3, 40.1):
        assert not ((begin < jump) & (jump < end)).any()
    speed = np.abs(drive.channels["omega_f"]) * drive.config.vehicle.r
    for a, b in zip(begin, end, strict=True):
        assert speed[(drive.t > a) & (drive.t < b)].min() > 0.2
    assert run.step * run.windows.count.min() >= 1.0
    assert run.step * run.windows.count.max() < 2.5, "a small car lives faster"


def test_sensors_of_wheels_that_turn_as_measured_move_the_car():
    run = RunModel(hard_drive(), whole=FIT)
    late = replace(run.setup, inputs=replace(run.setup.inputs, delay=0.02))
    assert np.allclose(run._rim_speeds(late)[1:], run._rim_speeds(run.setup)[:-1])
    wrong = apply(run.setup, [("wheel_radius_scale", {"share": 0.1})])
    assert np.allclose(1.1 * run._rim_speeds(wrong), run._rim_speeds(run.setup))
    assert run.moved_by(wrong, run.setup)
    assert not run.moved_by(late, run.setup)
    old = replace(run.setup, errors=replace(run.setup.errors, wheel_delay=0.02))
    assert np.allclose(run._rim_speeds(old)[:-1], run._rim_speeds(run.setup)[1:])
    assert run.moved_by(old, run.setup)


def test_a_late_pose_that_sensors_alone_tell_is_known_before_any_fit():
    run = RunModel(hard_drive(), whole=FIT)
    assert run.setup.errors.pose_delay == pytest.approx(0.033, abs=0.003)
    drive = hard_drive()
    t, yaw = drive.t, np.unwrap(drive.channels["yaw"])
    in_time = RunModel(hard_drive(yaw=np.interp(t + 0.033, t, yaw)), whole=FIT)
    assert in_time.setup.errors.pose_delay == 0.0


def test_a_step_leaves_what_is_at_its_limit_and_goes_on_with_the_rest():
    """Else a fit at a limit promises for ever what it cannot keep, and counts as no minimum."""
    problem = LeastSquaresProblem([RunModel(hard_drive(), use=FIT)])
    point = problem.stated()
    names = [nuisance.name for nuisance in NUISANCES]
    balance, ground = names.index("balance"), names.index("ground")
    point.nuisances[balance] = 0.1
    score = np.zeros(len(NUISANCES))
    score[[balance, ground]] = 1.0
    equations = NormalEquations(normal=np.eye(len(NUISANCES)), score=score, cost=0.0, windows=())
    change = bounded_step(problem, point, equations)
    assert change[balance] == 0.0
    assert change[ground] == pytest.approx(1.0)
    equations.score[balance] = -1.0
    assert bounded_step(problem, point, equations)[balance] == pytest.approx(-1.0)


@pytest.mark.parametrize(
    "drive",
    [
        *(pytest.param(name, marks=pytest.mark.check) for name in ("DS1", "DS2")),
        pytest.param("DS3", marks=pytest.mark.study),
    ],
)
def test_the_slow_steering_of_the_measured_car_is_named_with_one_size_for_every_drive(drive):
    log = f1tenth_log(measured_data("f1tenth_indoor") / f"{drive}.csv", corrected=True)
    found = diagnose([log])
    named = {cause.best.candidate.effect: cause.best for cause in found.named}
    assert named["steer_lag"].size == pytest.approx(0.05, abs=2.0 * named["steer_lag"].deviation)


@pytest.mark.check
def test_effects_that_make_up_for_a_wrong_law_of_the_wheels_leave_a_rest_and_give_way_to_a_structure(
    monkeypatch,
):
    """Wheels on a grid of soil follow no effect of the library: what mends them is another structure."""
    log = read_log(measured_data("chrono_scm") / "clay_0.05_sin02_R0.csv")
    with monkeypatch.context() as alone:
        alone.setattr("estimators.discrepancy.diagnosis.compare_structures", lambda *_: None)
        # The drive is a simulated one: its numbers are exact. Without what comes closest to the law of the
        # wheels, other effects make up for it, but never as the whole explanation.
        exact = replace(log, config=replace(log.config, exact=True))
        gone = ("cg_height", "inertia", "spring_rate", "cohesion", "shear_modulus", "friction_angle")
        library = [name for name in EFFECTS if name not in gone]
        diagnosis = diagnose([exact], library=library)
    assert diagnosis.causes
    assert diagnosis.verdict in ("ONE OF", "NAMED + UNEXPLAINED REST", "UNEXPLAINED")
    restructured = replace(diagnosis, structure=compare_structures([log]), causes=(), joint=None)
    assert restructured.verdict == "NAMED"
    summary = summarise(restructured)
    assert summary.sentence.startswith("The structure of the model is wrong: ")
    assert summary.extended_model.structure.startswith(("grid", "field"))
    assert not summary.extended_model.effects
