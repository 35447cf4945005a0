"""Any filter for n on any log that it can work with.

Two families. Those that a vehicle carries (`estimators.carried`) need commands and sensors, on the
full model or the paper's. Those of the paper's half-car with a map (`estimators.joint`, `bank`,
`ekf`) hold the whole state and read the ground under the wheels from the description of the log.

All of them believe their model. Beside what each says stands what that is worth to somebody who
does not (`estimators.second_opinion`), at the speed of a navigation filter of its own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimators.bank import BankSettings, run_bank
from estimators.carried import OnBoard, make_estimator
from estimators.consistency import surprise
from estimators.ekf import run_ekf
from estimators.joint import (
    CHANNELS,
    JointModel,
    JointRun,
    JointSettings,
    joint_model,
    prior,
    run_joint_filter,
)
from estimators.logs import Log, commands_at, plant_of
from estimators.logs.schema import IMU
from estimators.navigation import NavigationFilter
from estimators.protocol import Pose
from estimators.second_opinion import OpinionSettings, form_opinion
from estimators.transforms import belief_of
from offroad_env.errors import DataError, InvalidParameter, SolverFailure
from offroad_env.physics.numerics import GRAVITY
from offroad_env.sensors import GnssConfig, ImuConfig
from offroad_env.simulator import Plant, settled_state
from offroad_env.terrain import flat

__all__ = [
    "CARRIED_FILTERS",
    "LOG_FILTERS",
    "MAP_FILTERS",
    "LogEstimate",
    "LogSamples",
    "estimate_log",
    "log_samples",
    "usable_range",
]

CARRIED_FILTERS = ("parameter", "joint", "bank")
MAP_FILTERS = ("map_joint", "map_bank", "map_ekf")
LOG_FILTERS = CARRIED_FILTERS + MAP_FILTERS

#: Where n is looked for unless the soil carries the vehicle in a part of it only [-].
_WIDEST = (0.2, 1.4)
_STEP = 0.05
_ROOM = 0.15
#: A stamp may be this share of a period away from an even grid.
_JITTER = 0.25
_RATES = (50.0, 1000.0)  # [Hz]
#: 97.5 % quantile of the normal distribution.
_Z_95 = 1.959964
#: A filter without a flag of its own is believed while its mean innovation is within so many
#: standard deviations, over this time [s].
_SURPRISE, _WATCH_TIME = 5.0, 2.0
#: Standard deviation of a satellite's velocity where the log does not say [m/s].
_VELOCITY_SD = 0.05
#: Step of the second opinion [s]: its wheels follow the torque by a rule of the first order.
_OPINION_STEP = 0.02


@dataclass(frozen=True, kw_only=True)
class LogSamples:
    """A vehicle log as filters take it: one row a sample of the inertial unit, NaN = not measured."""

    t: np.ndarray  #: (T,) [s]
    dt: float  #: [s]
    commands: np.ndarray  #: (T, 3) held before the row, as the kernels take them
    inputs: np.ndarray  #: (2 T - 1, 3) the same at every half step
    imu: np.ndarray  #: (T, 5) a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s]
    rims: np.ndarray  #: (T, 2) r omega front, rear [m/s]
    gnss: np.ndarray  #: (T, 4) X, Y [m], speed [m/s], course [rad]
    slide: np.ndarray  #: (T,) angle from heading to course where only the body's speeds were measured [rad]
    missing: int  #: rows of the grid without a sample of the inertial unit


@dataclass(frozen=True, kw_only=True)
class LogEstimate:
    """What one filter believed along a log."""

    log: str  #: name of the log
    filter: str  #: one of `LOG_FILTERS`
    t: np.ndarray  #: (T,) [s]
    n: np.ndarray  #: (T,) mean [-]
    sd: np.ndarray  #: (T,) standard deviation [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval [-]
    high: np.ndarray  #: (T,) its upper end [-]
    valid: np.ndarray  #: (T,) bool: the filter vouches for it, given its model
    nis: np.ndarray  #: (T,) normalised innovation squared; NaN without an update
    channels: int  #: measured at an update: what `nis` should be on average
    repairs: int  #: repaired factorisations
    seconds: float  #: processor time [s]
    n_range: tuple[float, float]  #: where n was looked for [-]
    #: (T,) standard deviation of the estimate once its model is doubted, see `Opinion.doubted` [-]
    sd_in_doubt: np.ndarray
    trusted: np.ndarray  #: (T,) bool: the filter vouches for it, and it is narrow in doubt too
    second: np.ndarray  #: (T, 2) mean and standard deviation of n by the second opinion alone [-]

    @property
    def real_time_factor(self) -> float:
        """Seconds of the log per processor second."""
        return float(self.t[-1] - self.t[0]) / max(self.seconds, 1e-9)

    def csv(self) -> str:
        """A line a sample under its heading; an empty nis = no update."""
        lines = ["t,n,sd,low,high,valid,nis,sd_in_doubt,trusted,second_n,second_sd"]
        columns = np.column_stack(
            [self.t, self.n, self.sd, self.low, self.high, self.nis, self.sd_in_doubt, self.second]
        )
        for numbers, valid, trusted in zip(columns.tolist(), self.valid, self.trusted, strict=True):
            shown = ["" if math.isnan(value) else repr(value) for value in numbers]
            lines.append(",".join([*shown[:5], str(int(valid)), *shown[5:7], str(int(trusted)), *shown[7:]]))
        return "\n".join(lines) + "\n"


# ------------------------------------------------------------------ from the log


def log_samples(log: Log) -> LogSamples:
    """The samples of a log on the even grid of its inertial unit; nothing is interpolated.

    A sample of a slower sensor stands in the row next to its stamp.

    Raises
    ------
    DataError
        For a wheel-rig log, an inertial unit that is too slow or samples unevenly, or a drive that the
        model does not take.
    """
    if log.rig:
        raise DataError(f"{log.name}: is a wheel-rig log: trials without time, nothing to filter")
    config = log.config
    drive = {"full": "torque", "paper": "force"}[config.model]
    if config.drivetrain != drive:
        raise DataError(
            f"{log.name}: model {config.model} is driven by {drive}, but drivetrain is {config.drivetrain}"
        )
    present = np.all([~np.isnan(log.channels[name]) for name in IMU], axis=0)
    stamps = log.t[present]
    if len(stamps) < 3:
        raise DataError(f"{log.name}: has {len(stamps)} rows with all of {', '.join(IMU)}")
    dt = float(np.median(np.diff(stamps)))
    if not _RATES[0] - 1e-6 <= 1.0 / dt <= _RATES[1]:
        raise DataError(f"{log.name}: the inertial unit has {1.0 / dt:.3g} Hz, a filter needs 50 to 1000 Hz")
    # The steps' mean, not their median, so that stamps rounded to milliseconds do not drift off.
    steps = np.round(np.diff(stamps) / dt)
    dt = float((stamps[-1] - stamps[0]) / steps.sum())
    row = np.round((stamps - stamps[0]) / dt).astype(int)
    off = np.abs(stamps - stamps[0] - row * dt)
    if off.max() > _JITTER * dt or len(np.unique(row)) < len(row):
        worst = int(np.argmax(off))
        raise DataError(
            f"{log.name}: the inertial unit samples unevenly (at t = {stamps[worst]:.3f} s by "
            f"{1e3 * off[worst]:.2g} ms of {1e3 * dt:.3g} ms): a filter steps at one rate"
        )
    T = int(row[-1]) + 1
    t = stamps[0] + dt * np.arange(T)
    place = _Placing(log, t[0], dt, T)
    radius = config.vehicle.r
    imu = np.column_stack([place(name) for name in IMU])
    gnss, slide = _satellite(place)
    # A little late, so that rounding does not give a row the command that ends there.
    inputs = commands_at(log, t[0] + dt * (0.5 * np.arange(2 * T - 1) + 1e-6))
    return LogSamples(
        t=t,
        dt=dt,
        commands=np.vstack([inputs[:1], inputs[1::2]]),
        inputs=inputs,
        imu=imu,
        rims=radius * np.column_stack([place("omega_f"), place("omega_r")]),
        gnss=gnss,
        slide=slide,
        missing=T - len(row),
    )


class _Placing:
    """Puts the samples of a channel into the rows next to their stamps."""

    def __init__(self, log: Log, start: float, dt: float, rows: int) -> None:
        self._log, self._start, self._dt, self._rows = log, start, dt, rows

    def __call__(self, name: str) -> np.ndarray:
        values = np.full(self._rows, math.nan)
        if name in self._log.channels:
            t, samples = self._log.samples(name)
            row = np.round((t - self._start) / self._dt).astype(int)
            inside = (row >= 0) & (row < self._rows)
            values[row[inside]] = samples[inside]
        return values


def _satellite(place: _Placing) -> tuple[np.ndarray, np.ndarray]:
    """Fixes (T, 4) and the slide (T,); the course is NaN where it hangs on the heading."""
    x, y, speed, course = (place(name) for name in ("x", "y", "speed", "course"))
    v_x, v_y, yaw = place("v_x"), place("v_y"), place("yaw")
    slide = np.where(np.isnan(course), np.arctan2(v_y, v_x), math.nan)
    speed = np.where(np.isnan(speed), np.hypot(v_x, v_y), speed)
    course = np.where(np.isnan(course), yaw + slide, course)
    return np.column_stack([x, y, speed, course]), np.where(np.isnan(yaw), slide, math.nan)


def usable_range(plant: Plant, around: float) -> tuple[float, float]:
    """The part of 0.2 ... 1.4 about ``around`` in which the soil carries the standing vehicle.

    Raises
    ------
    DataError
        When not even that soil does.
    """

    def bears(n: float) -> bool:
        try:
            settled_state(plant._replace(soil=plant.soil._replace(n=n)))
        except SolverFailure:
            return False
        return True

    if not bears(around):
        raise DataError(f"the soil of the description (n = {around:g}) does not carry the vehicle")
    low = high = around
    while low - _STEP >= _WIDEST[0] - 1e-9 and bears(low - _STEP):
        low -= _STEP
    while high + _STEP <= _WIDEST[1] + 1e-9 and bears(high + _STEP):
        high += _STEP
    if high < _WIDEST[1] - _STEP:  # filters on board look a little further than they are told
        high -= _ROOM * (high - low)
    if not low + _STEP < around < high - _STEP:
        raise DataError(
            f"the soil carries the vehicle for n = {low:.2f} ... {high:.2f} only, the prior is {around:g}: "
            "too little to look in"
        )
    return low, high


def _sensors(log: Log, rate: float) -> tuple[ImuConfig, GnssConfig]:
    imu, gnss = log.config.imu, log.config.gnss
    speed = None if gnss is None else gnss.sd_speed
    return (
        ImuConfig(
            rate=rate,
            accel_noise=imu.sd_a,
            gyro_noise=imu.sd_rate,
            lever_arm=imu.position,
            kind="kinematic" if imu.kinematic else "specific_force",
            body_axes=log.config.model == "full",
        ),
        GnssConfig(
            velocity_sd=_VELOCITY_SD if speed is None else speed,
            position_sd=0.05 if gnss is None else gnss.sd_position,
        ),
    )


# ------------------------------------------------------------------ filters


def estimate_log(
    log: Log,
    name: str,
    *,
    n_prior: float | None = None,
    sd: float = 0.2,
    progress: Callable[[float], None] | None = None,
) -> LogEstimate:
    """Run one filter over a log.

    Parameters
    ----------
    log : Log
        Of a vehicle on deformable soil.
    name : str
        One of `LOG_FILTERS`.
    n_prior, sd : float
        Prior of n [-]; its mean is by default the description's.
    progress : callable, optional
        Told the share that is done, now and then.

    Raises
    ------
    DataError
        For a log that the filter cannot work with, in one sentence.
    InvalidParameter
        For an unknown filter or a prior that does not fit.
    """
    if name not in LOG_FILTERS:
        raise InvalidParameter(f"filter must be one of {', '.join(LOG_FILTERS)}, got {name!r}")
    if log.config.soil.rigid > 0.5:
        raise DataError(f"{log.name}: stands on hard ground, which has no sinkage exponent to estimate")
    samples, plant = log_samples(log), plant_of(log)
    around = plant.soil.n if n_prior is None else n_prior
    n_range = usable_range(plant, around)
    belief_of(around, sd, n_range[0] - _STEP, n_range[1] + _STEP)  # refuses a prior that is too wide
    tell = progress or (lambda share: None)
    run = _run_carried if name in CARRIED_FILTERS else _run_mapped
    return run(log, name, samples, (plant, n_range, around, sd), tell)


def _pose(log: Log) -> Pose:
    start = log.config.start
    return Pose(start.x, start.y, start.yaw, start.v_x)


def _fix(samples: LogSamples, k: int, yaw: float) -> np.ndarray:
    """Fix (4,) of row ``k``: body speeds without a heading get the course that agrees with ``yaw``."""
    fix = samples.gnss[k]
    if math.isnan(fix[3]) and not math.isnan(samples.slide[k]):
        return np.array([*fix[:3], yaw + samples.slide[k]])
    return fix


def _doubted(
    log: Log, samples: LogSamples, belief: tuple, n: np.ndarray, sd: np.ndarray, valid: np.ndarray
) -> dict[str, np.ndarray]:
    """What an estimate is worth in doubt of its model: the last three fields of `LogEstimate`."""
    plant, n_range, _, _ = belief
    imu, _ = _sensors(log, 1.0 / samples.dt)
    navigation, pose = NavigationFilter(plant.vehicle), _pose(log)
    navigation.reset(*pose)
    speed = np.full(len(samples.t), pose.v)
    for k in range(1, len(speed)):
        fix, steer = _fix(samples, k, navigation.pose.yaw), float(samples.commands[k, 0])
        speed[k] = navigation.update(samples.imu[k], samples.rims[k], steer, fix, samples.dt).v
    felt = samples.imu.copy()  # at the centre of gravity: a lever arm feels the turning
    felt[:, :2] += np.square(felt[:, 4:]) * imu.lever_arm[:2]
    felt[:, 2] -= GRAVITY if imu.kind == "specific_force" else 0.0
    settings = OpinionSettings(
        soils=n_range,
        samples=max(round(_OPINION_STEP / samples.dt), 1),
        noise=(imu.accel_noise, imu.accel_noise, imu.gyro_noise),
    )
    opinion = form_opinion(plant, settings, samples.inputs, felt, speed, samples.dt)
    wide, trusted = opinion.doubted(n, sd, valid)
    second = np.column_stack([opinion.mean, opinion.sd])
    return {"sd_in_doubt": wide, "trusted": trusted, "second": second}


def _run_carried(
    log: Log, name: str, samples: LogSamples, belief: tuple, tell: Callable[[float], None]
) -> LogEstimate:
    plant, n_range, n_prior, sd = belief
    rate = 1.0 / samples.dt
    imu, gnss = _sensors(log, rate)
    # Without fixes the place is soon lost, and a map that is read elsewhere is worse than none.
    ground = flat() if np.isnan(samples.gnss[:, 0]).all() else plant.ground
    choice = OnBoard(kind=name, rate=rate, ground=ground)
    estimator = make_estimator(choice, plant, n_range, imu, gnss)
    T = len(samples.t)
    rows = np.empty((T, 4))
    first = estimator.reset(n_prior, sd, _pose(log))
    rows[0] = first.mean, first.sd, math.nan, first.valid
    begin = time.process_time()
    for k in range(1, T):
        fix = _fix(samples, k, estimator.pose.yaw)
        command = tuple(samples.commands[k].tolist())
        estimate = estimator.update(command, samples.imu[k], samples.rims[k], fix)
        rows[k] = estimate.mean, estimate.sd, estimate.nis, estimate.valid
        if k % 100 == 0:
            tell(k / T)
    seconds = time.process_time() - begin
    n, spread, valid = rows[:, 0], rows[:, 1], rows[:, 3] > 0.5
    return LogEstimate(
        log=log.name,
        filter=name,
        t=samples.t,
        n=n,
        sd=spread,
        low=np.maximum(n - _Z_95 * spread, n_range[0]),
        high=np.minimum(n + _Z_95 * spread, n_range[1]),
        valid=valid,
        nis=rows[:, 2],
        channels=3,
        repairs=estimate.repairs,
        seconds=seconds,
        n_range=n_range,
        **_doubted(log, samples, belief, n, spread, valid),
    )


def _run_mapped(
    log: Log, name: str, samples: LogSamples, belief: tuple, tell: Callable[[float], None]
) -> LogEstimate:
    plant, n_range, n_prior, sd = belief
    if log.config.model != "paper":
        raise DataError(
            f"{log.name}: {name} runs the paper's half-car, the log is of model full - "
            f"use {', '.join(CARRIED_FILTERS)}"
        )
    if log.config.terrain.kind == "unknown":
        raise DataError(f"{log.name}: {name} needs a map, the ground is unknown - use one of the others")
    settings = _joint_settings(log, n_range)
    model = joint_model(plant, samples.dt, settings)
    z = np.full((len(samples.t), len(CHANNELS)), math.nan)
    z[:, :5] = samples.imu
    pose = _pose(log)
    tell(0.0)
    begin = time.process_time()
    if name == "map_bank":
        fan = (n_range[0] + 0.02, n_range[1] - 0.02)
        bank = BankSettings(joint=settings, n_prior=n_prior, n_prior_sd=sd, n_fan=fan)
        run = run_bank(model, bank, samples.inputs, z, pose=pose[:3], v_x=pose.v)
        valid = run.valid
    else:
        start = prior(model, settings, n_prior, sd, pose[:3], pose.v)
        run = (run_ekf if name == "map_ekf" else run_joint_filter)(model, start, samples.inputs, z)
        valid = _calm(run, model)
    seconds = time.process_time() - begin
    return LogEstimate(
        log=log.name,
        filter=name,
        t=samples.t,
        n=run.n,
        sd=run.sd,
        low=run.low,
        high=run.high,
        valid=valid,
        nis=run.nis,
        channels=5,
        repairs=run.repairs,
        seconds=seconds,
        n_range=n_range,
        **_doubted(log, samples, belief, run.n, run.sd, valid),
    )


def _joint_settings(log: Log, n_range: tuple[float, float]) -> JointSettings:
    """The filter's settings with the sensors of the log, a little wider than the range to be searched."""
    imu, settings = log.config.imu, JointSettings()
    noise = (imu.sd_a,) * 3 + (imu.sd_rate,) * 2 + settings.noise[5:]
    return replace(settings, n_range=(n_range[0] - _STEP, n_range[1] + _STEP), noise=noise)


def _calm(run: JointRun, model: JointModel) -> np.ndarray:
    """Validity (T,): the innovations are as large as they should be."""
    level = surprise(run.nis, 5, model.dt, _WATCH_TIME)
    return (level <= _SURPRISE) & (model.dt * np.arange(len(level)) > _WATCH_TIME)
