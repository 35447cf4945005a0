"""The record of one measured or simulated run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.logs.config import LogConfig
from offroad_env.errors import DataError

__all__ = ["Log"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """One run, in SI units. Arrays are read-only and have one entry a row of the file, NaN = no sample.

    Sensors of different rates share the rows: each has its own samples, none is resampled
    (`samples`). A wheel-rig log has no time and one row a steady trial.
    """

    name: str  #: file name without ending
    t: np.ndarray | None  #: (T,) time, strictly increasing [s]; None in a wheel-rig log
    channels: dict[str, np.ndarray]  #: (T,) each, by column name
    references: dict[str, np.ndarray]  #: ``ref_*`` columns, as they stand: for people, not for a finder
    config: LogConfig  #: what the YAML says
    hash: str  #: SHA-256 of both files

    @property
    def rig(self) -> bool:
        """Whether this is a wheel-rig log."""
        return self.t is None

    @property
    def duration(self) -> float:
        """From first to last row [s]; 0 for a wheel-rig log."""
        return 0.0 if self.t is None else float(self.t[-1] - self.t[0])

    def __len__(self) -> int:
        return len(next(iter(self.channels.values())))

    def samples(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and values of the rows in which channel ``name`` has a sample.

        Raises
        ------
        DataError
            If the log has no such channel, or no time.
        """
        if self.t is None:
            raise DataError(f"{self.name}: a wheel-rig log has no time")
        if name not in self.channels:
            raise DataError(f"{self.name}: no column {name!r}; there are {', '.join(self.channels)}")
        values = self.channels[name]
        present = ~np.isnan(values)
        return self.t[present], values[present]
