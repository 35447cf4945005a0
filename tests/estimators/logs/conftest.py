"""The drive that the tests of logs share."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.logs import (
    Log,
    log_from_run,
)
from offroad_env.world.terrain import paper_terrain
from simulated_logs import BELIEVED_N, plant_with, sensors_for, slalom


@pytest.fixture(scope="module")
def run():
    return slalom()


@pytest.fixture(scope="module")
def log(run) -> Log:
    trajectory, plant, commands = run
    return log_from_run(
        trajectory,
        plant,
        commands,
        sensors_for(),
        np.random.default_rng(7),
        belief=plant_with(BELIEVED_N, paper_terrain(0.02)),
        name="slalom",
    )
