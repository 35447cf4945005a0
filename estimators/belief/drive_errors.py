"""What sensors and model leave of a drive when every number is right: its covariance.

Sensors have noise and constant errors. The model knows neither the road nor how the soil scatters: what they
do is a discrepancy (M. Kennedy & A. O'Hagan, J. R. Stat. Soc. B 63(3), 2001), here processes of Ornstein and
Uhlenbeck. Standard deviations and times are what the true vehicle on its true soil, on a level road without
scatter, leaves on 40 tuning drives. They differ from drive to drive by a factor of five, so each drive tells
a factor on each of three groups.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from estimators.belief.drive_samples import BLOCK, COMPARED, DriveSamples
from estimators.filters.online_soil_belief import SoilBeliefSettings
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.sensors import GnssConfig, WheelSpeedConfig

__all__ = ["DISCREPANCY", "GROUPS", "HEADING", "ROAD_ERRORS", "DriveErrors", "Process", "errors_of"]


class Process(NamedTuple):
    """A discrepancy of the model."""

    group: str
    sd: float  #: of the process
    time: float  #: of its correlation [s]


GROUPS = ("along", "rims", "sideways")
#: Speed [m/s], which is right at the start; acceleration beyond it [m/s^2]; speeds of the rims beyond it
#: [m/s]; yaw rate [rad/s], side slip [m/s] and lateral acceleration [m/s^2].
DISCREPANCY = {
    "speed": Process("along", 0.09, 4.0),
    "a_x": Process("along", 0.03, 0.4),
    "wheel_f": Process("rims", 0.12, 0.8),
    "wheel_r": Process("rims", 0.04, 0.7),
    "yaw_rate": Process("sideways", 0.01, 0.45),
    "side": Process("sideways", 0.014, 0.7),
    "a_y": Process("sideways", 0.055, 0.45),
}
#: The same without the scatter of the soil: what a rough road leaves, on 30 tuning drives, with half of it
#: again for what covariances of the scatter leave out.
ROAD_ERRORS = {
    "speed": Process("along", 0.006, 1.0),
    "a_x": Process("along", 0.021, 0.05),
    "wheel_f": Process("rims", 0.017, 0.05),
    "wheel_r": Process("rims", 0.01, 0.05),
    "yaw_rate": Process("sideways", 0.0023, 0.3),
    "side": Process("sideways", 0.01, 0.5),
    "a_y": Process("sideways", 0.014, 0.1),
}
#: Standard deviations of the heading at the start [rad], and of the logarithms of the factors.
HEADING, _FACTOR_SD = math.radians(1.0), 0.7
#: Least speed with which an error of the velocity is one of the course [m/s].
_LEAST_SPEED = 1.0
#: First steps of the factors' logarithms, and when their search ends: after so many steps a group at most.
_FIRST, _MOST, _SEARCH = 0.7, 20, {"xatol": 0.05, "fatol": 0.05}


@dataclass(frozen=True, kw_only=True)
class DriveErrors:
    """Covariances of residuals (7 B,), channel by channel as `COMPARED`."""

    sensors: FloatArray  #: (7 B, 7 B) noise and constant errors
    groups: FloatArray  #: (G, 7 B, 7 B) of the model, with the factor one: as `GROUPS`, then what is added

    def factor(self, scales: FloatArray) -> FloatArray:
        """(7 B, 7 B) lower Cholesky factor of the whole with ``scales`` (G,) on the groups."""
        found: FloatArray = cholesky(self.sensors + np.tensordot(scales**2, self.groups, 1), lower=True)
        return found

    def scales(self, residuals: FloatArray, slopes: FloatArray, information: FloatArray) -> FloatArray:
        """(G,) most probable factors, what is fitted integrated out.

        Parameters
        ----------
        residuals
            (7 B,) at the fit.
        slopes
            (7 B, P) of the residuals by what is fitted, which takes up part of the errors.
        information
            (P, P) about that from elsewhere.
        """

        def loss(logs: FloatArray) -> float:
            L = self.factor(np.exp(logs))
            white = solve_triangular(L, np.column_stack([residuals, slopes]), lower=True)
            r, J = white[:, 0], white[:, 1:]
            # The optimum moves with the factors: to first order the residuals are those projected on.
            H = J.T @ J + information
            square = r @ r - (J.T @ r) @ np.linalg.solve(H, J.T @ r)
            volume = np.log(np.diag(L)).sum() + 0.5 * np.linalg.slogdet(H)[1]
            return float(0.5 * square + volume + 0.5 * (logs @ logs) / _FACTOR_SD**2)

        groups = len(self.groups)
        corners = np.vstack([np.zeros(groups), _FIRST * np.eye(groups)])
        options = {**_SEARCH, "maxiter": _MOST * groups, "initial_simplex": corners}
        found = minimize(loss, corners[0], method="Nelder-Mead", options=options)
        scales: FloatArray = np.exp(found.x)
        return scales


class _Channels:
    """Where the means of each channel lie in the residuals."""

    def __init__(self, blocks: int) -> None:
        self.blocks, self.size = blocks, blocks * len(COMPARED)

    def rows(self, **parts: FloatArray) -> FloatArray:
        """(7 B, S) effect on all channels of something of S numbers, from that (B, S) on some of them."""
        width = next(iter(parts.values())).shape[1]
        found = np.zeros((self.size, width))
        for name, part in parts.items():
            first = COMPARED.index(name) * self.blocks
            found[first : first + self.blocks] = part
        return found


def _correlation(t: np.ndarray, time: float, *, from_nothing: bool = False) -> np.ndarray:
    """(S, S) correlation of a process at instants (S,) [s]; ``from_nothing``: it is zero at t = 0."""
    apart: np.ndarray = np.exp(-np.abs(t[:, None] - t) / time)
    return apart - np.exp(-(t[:, None] + t) / time) if from_nothing else apart


def _discrepancies(channels: _Channels, speed: FloatArray, processes: Mapping[str, Process]) -> FloatArray:
    """(3, 7 B, 7 B) covariances by group."""
    B = channels.blocks
    every, edges = np.eye(B), np.eye(B + 1)
    middle = BLOCK * (np.arange(B) + 0.5)
    mean, change = 0.5 * (edges[1:] + edges[:-1]), (edges[1:] - edges[:-1]) / BLOCK
    turned = BLOCK * (np.tril(np.ones((B, B))) - 0.5 * every)
    effects = {
        "speed": channels.rows(a_x=change, wheel_f=mean, wheel_r=mean, speed=mean),
        "a_x": channels.rows(a_x=every),
        "wheel_f": channels.rows(wheel_f=every),
        "wheel_r": channels.rows(wheel_r=every),
        "yaw_rate": channels.rows(yaw_rate=every, course=turned),
        "side": channels.rows(course=np.diag(1.0 / speed)),
        "a_y": channels.rows(a_y=every),
    }
    found = np.zeros((len(GROUPS), channels.size, channels.size))
    for name, effect in effects.items():
        group, sd, time = processes[name]
        whole = name == "speed"
        t = BLOCK * np.arange(B + 1) if whole else middle
        found[GROUPS.index(group)] += sd**2 * (effect @ _correlation(t, time, from_nothing=whole) @ effect.T)
    return found


def errors_of(
    samples: DriveSamples,
    counts: FloatArray,
    speed: FloatArray,
    processes: Mapping[str, Process] = DISCREPANCY,
    wheel: WheelSpeedConfig | None = None,
    gnss: GnssConfig | None = None,
) -> DriveErrors:
    """Covariances for a drive.

    Parameters
    ----------
    counts
        (B, 7) samples in each mean.
    speed
        (B,) about that of the vehicle [m/s].
    processes
        Discrepancies of the model, as `DISCREPANCY`.
    wheel, gnss
        Sensors as described; constant errors are those of `SoilBeliefSettings`.
    """
    wheel, gnss = wheel or WheelSpeedConfig(), gnss or GnssConfig()
    unit, s, channels = samples.unit, SoilBeliefSettings(), _Channels(samples.blocks)
    fast = np.maximum(speed, _LEAST_SPEED)
    noise = [unit.accel_noise, unit.accel_noise, unit.gyro_noise, wheel.noise, wheel.noise]
    sds = np.column_stack([np.tile(noise, (len(fast), 1)), np.full(len(fast), gnss.velocity_sd)])
    sds = np.column_stack([sds, gnss.velocity_sd / fast]) / np.sqrt(counts)
    sensors = np.diag(sds.T.reshape(-1) ** 2)
    tilt = unit.mount().gravity * s.misalignment
    one, along = np.ones((len(fast), 1)), speed[:, None]
    for effect, sd in (
        (channels.rows(a_x=one), math.hypot(s.acceleration_bias, tilt)),
        (channels.rows(a_y=one), math.hypot(s.acceleration_bias, tilt)),
        (channels.rows(yaw_rate=one), s.rate_bias),
        (channels.rows(wheel_f=along), s.rim_scale),
        (channels.rows(wheel_r=along), s.rim_scale),
        (channels.rows(course=one), HEADING),
    ):
        sensors += sd**2 * (effect @ effect.T)
    return DriveErrors(sensors=sensors, groups=_discrepancies(channels, fast, processes))
