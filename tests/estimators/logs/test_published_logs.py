"""Logs of wheel rigs, measured drives and drives of another simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from estimators.logs import (
    Log,
    LogConfig,
    commands_at,
    f1tenth_log,
    plant_of,
    quality,
    read_log,
    read_logs,
    start_of,
    write_log,
)
from estimators.logs.clocks import pose_age
from estimators.rig.cmu_soil_bin import load_cmu_single_wheel
from helpers import measured_data
from offroad_env.errors import DataError
from offroad_env.physics import state as at
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.vehicles import make_wheel
from simulated_logs import changed, same_columns

# ------------------------------------------------------------------ wheel rigs

DEGREES = 180.0 / np.pi


def cmu_rig_log() -> Log:
    """The measured trials as a log; the carriage at 90 degrees has no longitudinal slip."""
    trials = load_cmu_single_wheel(measured_data("cmu_single_wheel") / "original" / "all_grouser_data.mat")
    names = ("slip", "slip_angle", "load", "drawbar", "side_force", "sinkage")
    channels = {name: getattr(trials, name).copy() for name in names}
    channels["condition"] = trials.condition.astype(float)
    config = LogConfig(soil=make_soil(SOILS["dry_sand"]), wheel=make_wheel(r=0.058, b=0.05))
    return Log(name="cmu", t=None, channels=channels, references={}, config=config, hash="")


def test_measured_rig_trials_pass_through_the_format_unchanged(tmp_path):
    rig = cmu_rig_log()
    back = read_log(write_log(tmp_path / "cmu.csv", rig))
    assert back.rig
    assert same_columns(back.channels, rig.channels)
    assert back.config == rig.config
    report = quality(back)
    assert len(back) == 189
    assert report.problems == ()


def test_rig_sinkage_in_millimetres_is_suspected(tmp_path):
    rig = cmu_rig_log()
    wrong = quality(changed(rig, sinkage=1e3 * rig.channels["sinkage"]))
    assert wrong.suspected_units == {"sinkage": "mm"}


def test_a_vehicles_yaml_serves_the_rig_that_carries_its_wheel(tmp_path):
    (tmp_path / "rig.csv").write_text("slip,load,drawbar\n0.1,1500,200\n0.3,1500,400\n")
    data = yaml.safe_load(
        "vehicle: {r: 0.33, b: 0.212, m: 1378}\nsoil: {k_phi: 1.5e+6, n: 1.1, c: 1040, phi: 0.48}\n"
    )
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    rig = read_log(tmp_path / "rig.csv")
    assert rig.config.wheel == make_wheel(r=0.33, b=0.212)
    for needs_vehicle in (plant_of, start_of):
        with pytest.raises(DataError, match="wheel-rig"):
            needs_vehicle(rig)


# ------------------------------------------------------------------ measured and foreign logs


def scm_logs() -> list[Path]:
    return sorted(measured_data("chrono_scm").glob("*_*.csv"))


def test_logs_of_an_independent_simulator_are_read_and_found_sound():
    logs = read_logs(scm_logs())
    assert len(logs) == 5
    for log in logs:
        assert len(log) == (2001 if "straight" in log.name else 2501)
        assert set(log.references) >= {"ref_yaw", "ref_sinkage_f"}
        report = quality(log)
        assert [f.sentence for f in report.findings if f.severity != "note"] == []
        # The published noise comes out of the data: 0.05 m/s^2 and 0.003 rad/s.
        noise = {channel.name: channel.noise for channel in report.channels}
        assert noise["a_y"] == pytest.approx(0.05, rel=0.25)
        assert noise["yaw_rate"] == pytest.approx(0.003, rel=0.1)


def test_gnss_at_5_hz_beside_an_imu_at_100_hz_is_not_resampled():
    log = read_log(scm_logs()[0])
    t, x = log.samples("x")
    assert (len(t), len(x)) == (126, 126)
    assert np.array_equal(t, log.t[::20])
    assert len(log.samples("a_x")[0]) == 2501


def test_the_vehicle_of_a_foreign_log_settles_on_its_soil_and_rolls():
    for path in scm_logs():
        log = read_log(path)
        plant = plant_of(log)
        state, _ = start_of(log)
        assert state[at.V_X] == log.config.start.v_x
        assert state[at.Z] < 0.03
        assert plant.vehicle.drive_front == 0.5  # equal torque on four shafts
        sunk = -float(np.mean(log.references["ref_sinkage_f"]))
        assert -0.1 < sunk < 0.0


def test_a_straight_foreign_run_says_that_it_tells_nothing_lateral():
    straight = next(path for path in scm_logs() if "straight" in path.name)
    assert any("steer never moves" in f.sentence for f in quality(read_log(straight)).findings)


DRIVES = ("DS1", "DS2", "DS3")


@pytest.mark.parametrize("drive", DRIVES)
def test_the_published_1_to_10_drives_have_a_gyro_in_degrees_and_accelerations_in_g(drive):
    report = quality(f1tenth_log(measured_data("f1tenth_indoor") / f"{drive}.csv"))
    assert report.suspected_units == {
        "yaw_rate": "deg/s",
        "roll_rate": "deg/s",
        "pitch_rate": "deg/s",
        "a_x": "g",
        "a_y": "g",
        "a_z": "g",
    }
    law = next(check for check in report.checks if check.name == "yaw_rate against the change of yaw")
    assert law.factor == pytest.approx(DEGREES, rel=0.03)  # an independent camera-free pose says so
    assert law.correlation > 0.98


@pytest.mark.parametrize("drive", DRIVES)
def test_the_published_1_to_10_drives_have_their_imu_turned_to_the_left(drive):
    report = quality(f1tenth_log(measured_data("f1tenth_indoor") / f"{drive}.csv"))
    axes = [finding for finding in report.problems if finding.kind == "axes"]
    assert len(axes) == 1
    assert "x axis points left" in axes[0].sentence


@pytest.mark.parametrize("drive", DRIVES)
def test_the_corrected_1_to_10_drives_obey_physics(drive):
    report = quality(f1tenth_log(measured_data("f1tenth_indoor") / f"{drive}.csv", corrected=True))
    assert report.problems == ()
    law = next(check for check in report.checks if check.name == "a_y against speed x yaw_rate")
    assert law.verdict == "agrees"
    assert law.correlation > 0.95
    # The same dead time and lag of the steering on all three drives, seen before any model is fitted.
    answer = next(f for f in report.findings if (f.kind, f.channel) == ("clock", "yaw_rate"))
    assert answer.numbers["delay"] == pytest.approx(0.127, abs=0.015)
    # So does the age of the particle filter's pose.
    assert pose_age(f1tenth_log(measured_data("f1tenth_indoor") / f"{drive}.csv", corrected=True)) == (
        pytest.approx(0.033, abs=0.003)
    )


def test_a_silence_of_26_seconds_in_a_published_drive_is_reported():
    report = quality(f1tenth_log(measured_data("f1tenth_indoor") / "DS2.csv", corrected=True))
    gap = next(f for f in report.findings if f.kind == "gap")
    assert gap.numbers["longest"] == pytest.approx(26.441, abs=1e-3)


def test_a_converted_drive_is_a_log_on_hard_ground(tmp_path):
    drive = f1tenth_log(measured_data("f1tenth_indoor") / "DS3.csv", corrected=True)
    back = read_log(write_log(tmp_path / "DS3.csv", drive))
    assert back.hash == drive.hash
    assert same_columns(back.channels, drive.channels)
    soil = plant_of(back).soil
    assert (soil.rigid, soil.C_kappa) == (1.0, soil.C_alpha)
    state, _ = start_of(back)
    assert state[at.X] == drive.channels["x"][0]
    with pytest.raises(DataError, match="torque_f"):
        commands_at(back, back.t)


def test_a_file_that_is_no_such_drive_is_refused(tmp_path):
    (tmp_path / "DS9.csv").write_text("t_s,speed\n0,1\n")
    with pytest.raises(DataError, match=r"DS9\.csv, column 'cmd_steer_rad'"):
        f1tenth_log(tmp_path / "DS9.csv")
