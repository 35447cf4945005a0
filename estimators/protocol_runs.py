"""The eight rows of the paper's table as one protocol for every filter that estimates the state too.

The truth is a draw from what the filter believes about everything but n: its start is settled on
the true soil and displaced by the stated spread, its motion carries the stated process noise and
its sensors the stated noise. Seeds for tuning and for reporting do not meet.

`run_bank_row` runs one seed of one row beside its bound, `summarise` turns the seeds of a row into
a line of the table.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.bank import BankRun, BankSettings, run_bank
from estimators.bounds import mean_bound, posterior_bound
from estimators.consistency import coverage
from estimators.joint import (
    CHANNELS,
    ETA,
    SIZE,
    JointModel,
    JointSettings,
    advance_point,
    joint_model,
    prior,
    read_point,
)
from estimators.paper import CHOICES, Row, row_plant, row_truth
from estimators.scores import SETTLED, late_rmse, mean_square_error, time_to_5pct
from estimators.transforms import from_range, to_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.simulator import settled_state
from offroad_env.soils import SOILS

__all__ = [
    "REPORT_SEEDS",
    "SENSORS",
    "TUNING_SEEDS",
    "BankScore",
    "RowSummary",
    "RowTwin",
    "row_model",
    "row_twin",
    "run_bank_row",
    "summarise",
]

#: Channels of `joint.CHANNELS` that a set of sensors measures.
SENSORS: dict[str, tuple[int, ...]] = {
    "imu": (0, 1, 2, 3, 4),
    "imu+wheels": (0, 1, 2, 3, 4, 5, 6),
    "imu+wheels+gnss": tuple(range(11)),
}
#: Error of n beyond which an estimate belongs to another soil [-]: the roots of F_x(n) on clay are
#: 0.08 apart.
_WRONG = 0.05
_FIRST_GNSS = CHANNELS.index("X")
#: GNSS gives a fix every so many samples (10 Hz).
_FIX_EVERY = 10

#: Noise seeds on which anything was chosen, and those on which results are reported.
TUNING_SEEDS = tuple(range(101, 109))
REPORT_SEEDS = tuple(range(20))


@dataclass(frozen=True, kw_only=True)
class RowTwin:
    """A row of the table with noise in start, motion and sensors."""

    row: Row
    seed: int
    inputs: np.ndarray  #: (2 T - 1, 3) steer [rad], F_u [N], NaN at every half step
    truth: np.ndarray  #: (T, 11) true states and eta
    z: np.ndarray  #: (T, 11) readings of all sensors, `joint.CHANNELS`, at every sample
    n: np.ndarray  #: (T,) true sinkage exponent [-]
    dt: float  #: [s]

    @property
    def t(self) -> np.ndarray:
        """(T,) [s]"""
        return self.dt * np.arange(len(self.z))

    def readings(self, sensors: str = "imu") -> np.ndarray:
        """(T, 11) readings of a set of `SENSORS`, NaN where nothing is measured; GNSS at 10 Hz."""
        if sensors not in SENSORS:
            raise InvalidParameter(f"sensors must be one of {', '.join(SENSORS)}, got {sensors!r}")
        z = np.full_like(self.z, math.nan)
        index = list(SENSORS[sensors])
        z[:, index] = self.z[:, index]
        z[np.arange(len(z)) % _FIX_EVERY != 0, _FIRST_GNSS:] = math.nan
        return z


def row_model(row: Row, settings: JointSettings) -> JointModel:
    """The filter's model of a row."""
    return joint_model(row_plant(row), CHOICES["dt"].value, settings)


@kernel
def _draw(x, warm, inputs, model, noise, states, readings):
    """Carry the true point (11,) through the run; returns the step that failed, or the number of rows."""
    work, scratch = np.empty((3, x.shape[0] - 1)), np.empty(at.READINGS_SIZE)
    for k in range(states.shape[0]):
        if k > 0:
            step = inputs[2 * k - 2 : 2 * k + 1]
            if advance_point(x, warm, step, model, work, scratch) >= SUNK:
                return k
            x[:] += noise[k]
        states[k] = x
        if read_point(x, warm, inputs[2 * k], model, work, scratch, readings[k]) >= SUNK:
            return k
    return states.shape[0]


def row_twin(
    row: Row,
    seed: int,
    settings: JointSettings,
    *,
    duration: float = 100.0,
    change: tuple[float, float] | None = None,
    inputs: np.ndarray | None = None,
    exponents: np.ndarray | None = None,
) -> RowTwin:
    """Simulate a row with the noise that ``settings`` state.

    Parameters
    ----------
    row : Row
        One of `estimators.paper.ROWS`.
    seed : int
        Of start, process and sensor noise.
    settings : JointSettings
    duration : float
        [s]
    change : (time, n), optional
        From this time [s] on the true soil has this exponent [-].
    inputs : array (2 T - 1, 3), optional
        Other inputs than the row's, at every half step; they set the duration.
    exponents : array (T,), optional
        True exponent at every sample instead of ``change`` [-]; starts with the soil's.

    Raises
    ------
    SolverFailure
        When the drawn vehicle leaves the range of the model.
    """
    model = row_model(row, settings)
    if inputs is None:
        inputs = row_truth(row, duration=duration).inputs
    state, warm = settled_state(model.plant, v_x=CHOICES["start_speed"].value)
    rng = np.random.default_rng([seed, row.number])
    x = np.empty(SIZE)
    x[:ETA] = state[:ETA] + rng.normal(size=ETA) * settings.start
    x[ETA] = from_range(SOILS[row.soil].n, model.low, model.high)
    T = len(inputs) // 2 + 1
    noise = rng.normal(size=(T, SIZE)) * np.sqrt(model.Q)
    if change is not None:
        noise[round(change[0] / model.dt), ETA] += from_range(change[1], model.low, model.high) - x[ETA]
    if exponents is not None:
        noise[1:, ETA] += np.diff([from_range(float(n), model.low, model.high) for n in exponents])
    truth, z = np.empty((T, SIZE)), np.empty((T, len(CHANNELS)))
    done = _draw(x, warm, inputs, model, noise, truth, z)
    if done < T or not np.isfinite(z).all():
        raise SolverFailure(f"row {row.number}, seed {seed}: no contact at t = {done * model.dt:.2f} s")
    z += rng.normal(size=z.shape) * np.sqrt(model.R)
    n = np.array([to_range(eta, model.low, model.high) for eta in truth[:, ETA]])
    return RowTwin(row=row, seed=seed, inputs=inputs, truth=truth, z=z, n=n, dt=model.dt)


class BankScore(NamedTuple):
    """One seed of one row."""

    twin: RowTwin
    run: BankRun
    bound: np.ndarray  #: (T,) bound on sd(n) along this truth [-]
    seconds: float  #: processor time of the filter [s]

    @property
    def mse(self) -> float:
        """Mean square error of n over the run [-]: the number in the paper's table."""
        return mean_square_error(self.run.n, self.twin.n)

    @property
    def late_rmse(self) -> float:
        """Root mean square error after 20 s [-]; NaN for shorter runs."""
        return late_rmse(self.twin.t, self.run.n, self.twin.n)

    @property
    def time_to_5pct(self) -> float:
        """From here on the error stays below 5 % [s]; inf when it does not."""
        return time_to_5pct(self.twin.t, self.run.n, self.twin.n)

    @property
    def ends_wrong(self) -> bool:
        """The bank vouches at the end for an estimate that belongs to another soil."""
        return bool(self.run.valid[-1] and abs(self.run.n[-1] - self.twin.n[-1]) > _WRONG)


class RowSummary(NamedTuple):
    """The seeds of one row: a line of the table."""

    row: int
    mse: float  #: median mean square error of n [-]
    mse_low: float  #: 2.5 % quantile over the seeds
    mse_high: float  #: 97.5 % quantile
    paper_ratio: float  #: the paper's half-car value over the median [-]
    rmse_after_20s: float  #: over all seeds [-]
    bound_rmse_after_20s: float  #: the least possible [-]
    coverage: float  #: of the 95 % interval, over time and seeds
    coverage_valid: float  #: where the flag is up
    valid: float  #: share of the time that the flag is up
    time_to_5pct: float  #: median [s]
    ends_wrong: int  #: seeds that vouch for another soil at the end
    repairs: int  #: repaired factorisations
    real_time_factor: float  #: simulated seconds per processor second


def run_bank_row(
    row: Row,
    seed: int,
    settings: BankSettings | None = None,
    *,
    sensors: str = "imu",
    duration: float = 100.0,
    change: tuple[float, float] | None = None,
) -> BankScore:
    """Run the bank on one seed of one row, with the bound along the same truth.

    Parameters
    ----------
    row, seed, duration, change
        As in `row_twin`.
    settings : BankSettings, optional
        Default: the one setting for all rows.
    sensors : str
        One of `SENSORS`.
    """
    settings = settings or BankSettings()
    twin = row_twin(row, seed, settings.joint, duration=duration, change=change)
    model, speed = row_model(row, settings.joint), CHOICES["start_speed"].value
    z, pose = twin.readings(sensors), (0.0, 0.0, 0.0)
    begin = time.process_time()
    run = run_bank(model, settings, twin.inputs, z, pose=pose, v_x=speed)
    seconds = time.process_time() - begin
    start = prior(model, settings.joint, float(twin.n[0]), settings.n_prior_sd, pose, speed)
    bound = posterior_bound(model, start, twin.truth, twin.inputs, z)
    return BankScore(twin=twin, run=run, bound=bound, seconds=seconds)


def summarise(scores: Sequence[BankScore]) -> RowSummary:
    """A line of the table from the seeds of one row.

    Raises
    ------
    InvalidParameter
        For no scores, or scores of several rows.
    """
    if len({score.twin.row for score in scores}) != 1:
        raise InvalidParameter("scores must be one or more seeds of one row")
    row = scores[0].twin.row
    mse = np.array([score.mse for score in scores])
    bound = mean_bound([score.bound for score in scores])
    late = scores[0].twin.t >= SETTLED
    low, high, truth, valid = (
        np.array(values)
        for values in zip(*((s.run.low, s.run.high, s.twin.n, s.run.valid) for s in scores), strict=True)
    )
    simulated, spent = sum(float(s.twin.t[-1]) for s in scores), sum(s.seconds for s in scores)
    return RowSummary(
        row=row.number,
        mse=float(np.median(mse)),
        mse_low=float(np.quantile(mse, 0.025)),
        mse_high=float(np.quantile(mse, 0.975)),
        paper_ratio=row.paper_half_car / float(np.median(mse)),
        rmse_after_20s=float(np.sqrt(np.mean([score.late_rmse**2 for score in scores]))),
        bound_rmse_after_20s=float(np.sqrt(np.mean(bound[late] ** 2))) if late.any() else math.nan,
        coverage=coverage(low, high, truth),
        coverage_valid=coverage(low, high, truth, valid),
        valid=float(valid.mean()),
        time_to_5pct=float(np.median([score.time_to_5pct for score in scores])),
        ends_wrong=sum(score.ends_wrong for score in scores),
        repairs=sum(score.run.repairs for score in scores),
        real_time_factor=simulated / spent,
    )
