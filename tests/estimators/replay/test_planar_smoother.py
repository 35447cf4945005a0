"""The motion that all channels of a log tell of together."""

from dataclasses import replace

import numpy as np
import pytest

from agents.reports.log_playback import log_playback
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.replay.planar_smoother import _drive_of, _smooth, smooth_motion
from estimators.replay.replay import grid_of
from offroad_env.errors import DataError


def test_channels_that_contradict_each_other_have_no_motion_and_no_playback():
    log = simulated_log(draw_case(102, duration=6.0))
    wrong = replace(log, channels={**log.channels, "yaw_rate": 1000.0 * log.channels["yaw_rate"]})
    assert log_playback(log) is not None
    with pytest.raises(DataError, match="another unit"):
        smooth_motion(wrong, grid_of(wrong))
    assert log_playback(wrong) is None


@pytest.mark.parametrize("rolls", [True, False])
def test_the_lever_arm_of_the_imu_is_taken_off_a_body_that_turns_about_all_axes(rolls):
    """The centre of gravity is at rest: what is left of the readings is noise of the derivatives."""
    log = simulated_log(draw_case(102, duration=6.0))
    t = log.times
    lever, omega = np.array([0.2, 0.1, 0.5]), np.zeros((3, len(t)))
    omega[1], omega[2] = -0.4 * np.cos(3.0 * t), 0.5 * np.sin(2.0 * t)
    change = np.stack([np.zeros(len(t)), 1.2 * np.sin(3.0 * t), np.cos(2.0 * t)])
    if rolls:
        omega[0], change[0] = 0.3 * np.sin(2.5 * t), 0.75 * np.cos(2.5 * t)
    else:  # in level axes, which turn with the heading, the pitch axis turns
        change[0] = -omega[1] * omega[2]
    felt = np.cross(change.T, lever) + np.cross(omega.T, np.cross(omega.T, lever))
    channels = {name: value for name, value in log.channels.items() if not name.startswith("a_")}
    channels |= dict(zip(("a_x", "a_y", "a_z"), felt.T, strict=True))
    channels |= {"pitch_rate": -omega[1], "yaw_rate": omega[2]}
    channels |= {"roll_rate": omega[0]} if rolls else {}
    imu = replace(log.config.imu, position=tuple(lever.tolist()), sd_rate=1e-3)
    turning = replace(log, channels=channels, config=replace(log.config, imu=imu))
    grid = grid_of(turning)
    left = _drive_of(turning, grid, _smooth(turning, "yaw_rate", grid, 1e-3)).a[20:-20]
    assert np.abs(felt).max() > 0.3
    assert np.abs(left).max() < 0.03
