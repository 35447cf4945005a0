"""The memory of any number of episodes: what the compiled period works on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from offroad_env.observation import SHOWN
from offroad_env.period import EPISODE, NOISE_PERIODS, RULES, SAMPLES
from offroad_env.physics.sensor_kernels import CHANNELS

if TYPE_CHECKING:
    from offroad_env.physics.path_kernels import PathTable
    from offroad_env.physics.records import Ground
    from offroad_env.physics.vehicle_model import Plant

__all__ = ["LAST_ROW", "NOISE_ROWS", "Memory"]

#: Samples for which sensor noise is drawn at a time.
NOISE_ROWS = NOISE_PERIODS * SAMPLES
#: Last row from which there is enough for a period.
LAST_ROW = NOISE_ROWS - SAMPLES


class Memory:
    """Arrays with one row per episode; `period_full` says what they hold.

    Parameters
    ----------
    count : episodes
    """

    def __init__(self, count: int) -> None:
        self.episodes = np.zeros(count, EPISODE)
        self.rules = np.zeros(1, RULES)
        self.tables = np.zeros((count, 1, 4))
        self.noise = np.zeros((count, NOISE_ROWS, CHANNELS))
        self.actions = np.zeros((count, 2))
        self.shown = np.zeros((count, SHOWN), np.float32)
        #: What the filter in the compiled period assumes (1,); None where none runs there.
        self.assumptions: np.ndarray | None = None

    def lay_out(self, row: int, path: PathTable, plant: Plant, known: Ground) -> None:
        """Write the course of an episode into its table; all tables grow where it is longer.

        ``known`` is what a map shows of the ground.
        """
        parts = (path.nodes, plant.ground.waves, plant.soil_map.patches, known.waves)
        ends = np.cumsum([len(part) for part in parts])
        if ends[-1] > self.tables.shape[1]:
            grown = np.zeros((len(self.tables), int(ends[-1]), 4))
            grown[:, : self.tables.shape[1]] = self.tables
            self.tables = grown
        self.tables[row, : ends[-1]] = np.concatenate(parts)
        episode = self.episodes[row]
        episode["ds"] = path.ds
        for name, end in zip(("path_end", "waves_end", "patches_end", "known_end"), ends, strict=True):
            episode[name] = end

    def part(self, rows: slice) -> tuple[Any, ...]:
        """Arguments of `period_full` for some of the episodes."""
        return (
            self.episodes[rows],
            self.rules,
            self.tables[rows],
            self.noise[rows],
            self.actions[rows],
            self.shown[rows],
            self.assumptions,
        )
