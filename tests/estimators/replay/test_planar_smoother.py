"""The motion that all channels of a log tell of together."""

from dataclasses import replace

import pytest

from agents.reports.log_playback import log_playback
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.replay.planar_smoother import smooth_motion
from estimators.replay.replay import grid_of
from offroad_env.errors import DataError


def test_channels_that_contradict_each_other_have_no_motion_and_no_playback():
    log = simulated_log(draw_case(102, duration=6.0))
    wrong = replace(log, channels={**log.channels, "yaw_rate": 1000.0 * log.channels["yaw_rate"]})
    assert log_playback(log) is not None
    with pytest.raises(DataError, match="another unit"):
        smooth_motion(wrong, grid_of(wrong))
    assert log_playback(wrong) is None
