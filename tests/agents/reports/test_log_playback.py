"""What the playback of a log takes from its reference columns."""

from __future__ import annotations

import numpy as np

from agents.reports.log_playback import log_playback
from estimators.logs import log_from_run
from simulated_logs import sensors_for, slalom


def test_the_wheels_of_a_log_stand_as_deep_as_its_references_say():
    trajectory, plant, commands = slalom(2.0)
    log = log_from_run(trajectory, plant, commands, sensors_for(), np.random.default_rng(7))
    front, rear = log_playback(log).wheels
    for wheel, column in ((front, "ref_sinkage_f"), (rear, "ref_sinkage_r")):
        assert np.allclose(wheel.sinkage, log.references[column], atol=1e-4)
        assert wheel.sinkage.max() > 1e-3
    assert not np.allclose(front.sinkage, rear.sinkage, atol=1e-4)
