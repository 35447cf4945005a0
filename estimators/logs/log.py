"""The record of one measured or simulated run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.logs.config import ImuSpec, LogConfig
from offroad_env.errors import DataError
from offroad_env.physics.records import Vehicle, Wheel

__all__ = ["IMU_FIRST", "Log"]

#: Channels of which the first one there is gives the rate of the IMU.
IMU_FIRST = ("a_x", "a_y", "yaw_rate", "a_z", "pitch_rate")


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """One run, in SI units. Arrays are read-only and have one entry a row of the file, NaN = no sample.

    Sensors of different rates share the rows: each has its own samples, none is resampled
    (`samples`). A wheel-rig log has no time and one row a steady trial.
    """

    name: str  #: file name without ending
    t: np.ndarray | None  #: (T,) time, strictly increasing [s]; None in a wheel-rig log
    channels: dict[str, np.ndarray]  #: (T,) each, by column name
    references: dict[str, np.ndarray]  #: ``ref_*`` columns as they are: for people; no estimate uses them
    config: LogConfig  #: content of the YAML
    hash: str  #: SHA-256 of both files

    @property
    def rig(self) -> bool:
        """Whether this is a wheel-rig log."""
        return self.t is None

    @property
    def times(self) -> np.ndarray:
        """Time of every row, (T,) [s]; `DataError` for a wheel-rig log."""
        if self.t is None:
            raise DataError(f"{self.name}: a wheel-rig log has no time")
        return self.t

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle of the run; `DataError` for a wheel-rig log."""
        if self.config.vehicle is None:
            raise DataError(f"{self.name}: is a wheel-rig log: it has no vehicle")
        return self.config.vehicle

    @property
    def imu(self) -> ImuSpec:
        """Noise and place of the IMU; `DataError` for a wheel-rig log."""
        if self.config.imu is None:
            raise DataError(f"{self.name}: is a wheel-rig log: it has no IMU")
        return self.config.imu

    @property
    def wheel(self) -> Wheel:
        """The wheel of a rig; `DataError` for a vehicle log."""
        if self.config.wheel is None:
            raise DataError(f"{self.name}: is a vehicle log: it has no single wheel")
        return self.config.wheel

    @property
    def imu_times(self) -> np.ndarray:
        """Times of the samples of the IMU [s]: of that of its channels which comes first in `IMU_FIRST`.

        Raises
        ------
        DataError
            If the log has none of them.
        """
        name = next((name for name in IMU_FIRST if name in self.channels), None)
        if name is None:
            raise DataError(f"{self.name}: has no channel of an IMU")
        return self.samples(name)[0]

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
        t = self.times
        if name not in self.channels:
            raise DataError(f"{self.name}: no column {name!r}; there are {', '.join(self.channels)}")
        values = self.channels[name]
        present = ~np.isnan(values)
        return t[present], values[present]
