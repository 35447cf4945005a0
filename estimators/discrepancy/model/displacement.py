"""Windows that begin elsewhere on ground that is the same everywhere: no simulation is needed."""

from __future__ import annotations

import numpy as np

from estimators.discrepancy.model.protocol import Records
from estimators.discrepancy.model.windows import Windows
from offroad_env.effects import Setup
from offroad_env.physics import state as at

__all__ = ["displaced", "same_everywhere"]


def same_everywhere(setup: Setup) -> bool:
    """Whether a vehicle moves alike wherever it begins and whatever its heading.

    Laws of effects may know place and heading, and ruts stay where they are.
    """
    plant = setup.plant
    ground = plant.ground
    level = ground.S_x == 0.0 and ground.S_y == 0.0 and not np.any(ground.waves[:, 0])
    even = len(plant.soil_map.patches) == 0 and plant.soil_field is None
    return level and even and plant.effects is None and plant.structure is None


def displaced(setup: Setup, records: Records, windows: Windows, state: int, by: float) -> Records | None:
    """The records of windows that begin elsewhere; None where that changes the motion.

    Parameters
    ----------
    state
        Index of what differs at the start of every window: X, Y or heading.
    by
        By how much [m or rad].
    """
    if state not in (at.X, at.Y, at.YAW) or not same_everywhere(setup):
        return None
    states = records.states.copy()
    states[:, state] += by
    if state == at.YAW:
        first = np.repeat(records.states[windows.begin[:-1]], windows.count + 1, axis=0)
        x, y = (records.states[:, i] - first[:, i] for i in (at.X, at.Y))
        states[:, at.X] = first[:, at.X] + np.cos(by) * x - np.sin(by) * y
        states[:, at.Y] = first[:, at.Y] + np.sin(by) * x + np.cos(by) * y
    return Records(states=states, readings=records.readings)
