"""Any filter for n on any log that it can work with.

The online filters (`estimators.filters.online`) need commands and sensors, on the full model or the paper's.
The filters of the paper's half-car on a map (joint UKF, EKF and bank) estimate the whole state and read the
ground under the wheels from the description of the log.

All of them take their model for exact, so what they state holds given that model. Beside it stands the
estimate that is robust to model errors (`estimators.filters.model_evidence`), at the speed of a navigation
filter of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimators.analysis.consistency import innovations_consistent
from estimators.filters.belief_history import BeliefHistory
from estimators.filters.model_evidence import EvidenceSettings, model_evidence
from estimators.filters.navigation import NavigationFilter
from estimators.filters.online import OnBoard
from estimators.filters.protocol import Pose
from estimators.filters.registry import FILTERS, ONLINE_FILTERS, filter_id
from estimators.filters.whole_run import FilterRun, run_filter, with_course
from estimators.logs import Log, commands_at, plant_of
from estimators.logs.config import ImuSpec
from estimators.logs.schema import IMU
from estimators.logs.substitutes import substituted
from estimators.models.half_car_on_map import CHANNELS, JointSettings
from estimators.numerics.bounded import belief_of
from offroad_env.errors import DataError, InvalidParameter, SolverFailure
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import Plant, settled_state
from offroad_env.world.terrain import flat

__all__ = [
    "LOG_FILTERS",
    "LOG_MAP_FILTERS",
    "LogEstimate",
    "LogSamples",
    "RobustEstimate",
    "estimate_log",
    "log_samples",
    "usable_range",
]

#: Ids of the filters with a map that work on logs: smoother and particles are for studies.
LOG_MAP_FILTERS = ("map_joint_ukf", "map_ukf_bank", "map_ekf")
LOG_FILTERS = (*ONLINE_FILTERS, *LOG_MAP_FILTERS)

#: Where n is looked for unless the soil carries the vehicle in a part of it only [-].
_WIDEST = (0.2, 1.4)
_STEP = 0.05
_ROOM = 0.15
#: Priors of n that leave two steps of this search on either side [-].
_PRIORS = (0.3, 1.3)
#: A stamp may be this share of a period away from an even grid.
_JITTER = 0.25
_RATES = (50.0, 1000.0)  # [Hz]
_MENDED = " - imu.rate: 100 Hz in the YAML brings it to one"
#: Standard deviation of a satellite's velocity where the log does not state it [m/s].
_VELOCITY_SD = 0.05
#: Step of the model evidence [s]: its wheels follow the torque by a rule of the first order.
_EVIDENCE_STEP = 0.02
#: Distance of a bank's hypotheses from the bounds of n [-].
_FAN_ROOM = 0.02


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
class RobustEstimate:
    """What a filter's estimate is worth when its model may be wrong, see `model_evidence`."""

    sd: np.ndarray  #: (T,) standard deviation of the filter's estimate [-]
    valid: np.ndarray  #: (T,) bool: the filter's flag is up, and `sd` is below 15 % of n
    posterior_n: np.ndarray  #: (T,) mean of n by the evidence alone [-]
    posterior_sd: np.ndarray  #: (T,) its standard deviation [-]


@dataclass(frozen=True, kw_only=True)
class LogEstimate:
    """Estimate of one filter along a log."""

    log: str  #: name of the log
    filter: str  #: one of `LOG_FILTERS`
    stated: BeliefHistory  #: as stated by the filter, given its model
    robust: RobustEstimate
    n_range: tuple[float, float]  #: where n was looked for [-]
    notes: tuple[str, ...] = ()  #: what stood in for channels that were not measured

    def csv(self) -> str:
        """A line a sample under its heading; an empty nis = no update."""
        lines = ["t,n,sd,low,high,valid,nis,robust_sd,robust_valid,evidence_n,evidence_sd"]
        own, robust = self.stated, self.robust
        stated = (own.t, own.n, own.sd, own.low, own.high, own.nis)
        columns = np.column_stack([*stated, robust.sd, robust.posterior_n, robust.posterior_sd])
        for numbers, valid, trusted in zip(columns.tolist(), own.flag, robust.valid, strict=True):
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
    if log.t is None or config.vehicle is None:
        raise DataError(f"{log.name}: has no times or no vehicle, nothing to filter")
    drive = {"full": "torque", "paper": "force"}[config.model]
    if config.drivetrain != drive:
        raise DataError(
            f"{log.name}: model {config.model} is driven by {drive}, but drivetrain is {config.drivetrain}"
        )
    stamps, row, dt = _even_stamps(log, log.times)
    T = int(row[-1]) + 1
    t = stamps[0] + dt * np.arange(T)
    place = _Placing(log, t[0], dt, T)
    radius = config.vehicle.r
    # A sensor on one axle stands for both: only their mean is used.
    axles = [name for name in ("omega_f", "omega_r") if name in log.channels] or ["omega_f"]
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
        rims=radius * np.column_stack([place(axles[0]), place(axles[-1])]),
        gnss=gnss,
        slide=slide,
        missing=T - len(row),
    )


def _even_stamps(log: Log, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(stamps of the IMU [s], their rows on its even grid, step of the grid [s])."""
    measured = [name for name in IMU if name in log.channels]
    present = np.all([~np.isnan(log.channels[name]) for name in measured], axis=0)
    stamps = t[present]
    if len(stamps) < 3:
        raise DataError(
            f"{log.name}: has {len(stamps)} rows with all of {', '.join(measured)} - imu.rate: 100 Hz "
            "in the YAML brings them to common rows"
        )
    dt = float(np.median(np.diff(stamps)))
    if not _RATES[0] - 1e-6 <= 1.0 / dt <= _RATES[1]:
        raise DataError(f"{log.name}: the IMU has {1.0 / dt:.3g} Hz, a filter needs 50 to 1000 Hz{_MENDED}")
    # The steps' mean, not their median, so that stamps rounded to milliseconds do not drift off.
    steps = np.round(np.diff(stamps) / dt)
    dt = float((stamps[-1] - stamps[0]) / steps.sum())
    dt = min(dt, 1.0 / _RATES[0]) if dt < 1.0 / _RATES[0] + 1e-9 else dt  # rounded stamps
    row = np.round((stamps - stamps[0]) / dt).astype(int)
    off = np.abs(stamps - stamps[0] - row * dt)
    if off.max() > _JITTER * dt or len(np.unique(row)) < len(row):
        worst = int(np.argmax(off))
        raise DataError(
            f"{log.name}: the inertial unit samples unevenly (at t = {stamps[worst]:.3f} s by "
            f"{1e3 * off[worst]:.2g} ms of {1e3 * dt:.3g} ms): a filter steps at one rate{_MENDED}"
        )
    return stamps, row, dt


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
    """Fixes (T, 4) and the slide (T,); the course is NaN where it depends on the heading."""
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
        own = plant.soil.n
        soil = "the soil of the description"
        if around == own:
            raise DataError(f"{soil} (n = {own:g}) does not carry the vehicle")
        raise DataError(f"{soil} does not carry the vehicle with n_prior = {around:g} (its own n is {own:g})")
    low = high = around
    while low - _STEP >= _WIDEST[0] - 1e-9 and bears(low - _STEP):
        low -= _STEP
    while high + _STEP <= _WIDEST[1] + 1e-9 and bears(high + _STEP):
        high += _STEP
    if high < _WIDEST[1] - _STEP:  # online filters look a little beyond their range
        high -= _ROOM * (high - low)
    if not low + _STEP < around < high - _STEP:
        raise DataError(
            f"the soil carries the vehicle for n = {low:.2f} ... {high:.2f} only, the prior is {around:g}: "
            "too little to look in"
        )
    return low, high


def _imu(log: Log) -> ImuSpec:
    if log.config.imu is None:
        raise DataError(f"{log.name}: its description has no inertial unit")
    return log.config.imu


def _sensors(log: Log, rate: float) -> tuple[ImuConfig, GnssConfig]:
    imu, gnss = _imu(log), log.config.gnss
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
        One of `LOG_FILTERS`, or a short name.
    n_prior, sd : float
        Prior of n [-]; its mean is by default the description's.
    progress : callable, optional
        Called with the share that is done, now and then.

    Raises
    ------
    DataError
        For a log that the filter cannot work with, in one sentence.
    InvalidParameter
        For an unknown filter or a prior that does not fit.
    """
    known = filter_id(name, LOG_FILTERS)
    if log.config.soil.rigid > 0.5:
        raise DataError(f"{log.name}: stands on hard ground, which has no sinkage exponent to estimate")
    around = _prior_mean(log, n_prior)
    complete, notes = substituted(log)
    samples, plant = log_samples(complete), plant_of(log)
    n_range = usable_range(plant, around)
    belief_of(around, sd, n_range[0] - _STEP, n_range[1] + _STEP)  # refuses a prior that is too wide
    prepare = _online_run if FILTERS[known].make is not None else _map_run
    run = replace(prepare(log, known, samples, plant, n_range), n_prior=around, sd=sd, progress=progress)
    if progress is not None:
        progress(0.0)
    history = run_filter(known, run)
    if not FILTERS[known].make and known != "map_ukf_bank":
        # The flag of a comparison asks for a narrow interval too; here the robust estimate judges that.
        assert history.channels is not None  # `run_filter` counts them
        history = replace(history, valid=innovations_consistent(history.nis, history.channels, run.dt))
    stated = replace(history, t=samples.t)
    robust = _robust(log, samples, plant, n_range, stated)
    return LogEstimate(log=log.name, filter=known, stated=stated, robust=robust, n_range=n_range, notes=notes)


def _prior_mean(log: Log, n_prior: float | None) -> float:
    """The option, else n of the description; where no range of n can be laid around it, it is refused."""
    n: float = log.config.soil.n if n_prior is None else n_prior
    low, high = _PRIORS
    if low <= n <= high:
        return n
    if n_prior is None:
        raise DataError(
            f"{log.name}: a filter needs a prior of n in [{low:g}, {high:g}], soil.n of the description is "
            f"{n:g}: give n_prior"
        )
    raise InvalidParameter(f"n_prior must be in [{low:g}, {high:g}], got {n_prior}")


def _pose(log: Log) -> Pose:
    start = log.config.start
    return Pose(start.x, start.y, start.yaw, start.v_x)


def _navigated_speed(log: Log, samples: LogSamples, plant: Plant) -> np.ndarray:
    """Forward speed (T,) of a navigation filter of its own [m/s]."""
    navigation, pose = NavigationFilter(plant.vehicle), _pose(log)
    navigation.reset(*pose)
    speed = np.full(len(samples.t), pose.v)
    for k in range(1, len(speed)):
        fix = with_course(samples.gnss[k], samples.slide[k], navigation.pose.yaw)
        steer = float(samples.commands[k, 0])
        speed[k] = navigation.update(samples.imu[k], samples.rims[k], steer, fix, samples.dt).v
    return speed


def _robust(
    log: Log, samples: LogSamples, plant: Plant, n_range: tuple[float, float], stated: BeliefHistory
) -> RobustEstimate:
    """The estimate with the model uncertain."""
    imu, _ = _sensors(log, 1.0 / samples.dt)
    measured = samples.imu.copy()  # at the centre of gravity: a lever arm adds centripetal acceleration
    measured[:, :2] += np.square(measured[:, 4:]) * imu.lever_arm[:2]
    measured[:, 2] -= GRAVITY if imu.kind == "specific_force" else 0.0
    settings = EvidenceSettings(
        soils=n_range,
        samples=max(round(_EVIDENCE_STEP / samples.dt), 1),
        noise=(imu.accel_noise, imu.accel_noise, imu.gyro_noise),
    )
    speed = _navigated_speed(log, samples, plant)
    posterior = model_evidence(plant, settings, samples.inputs, measured, speed, samples.dt)
    sd, valid = posterior.robust(stated.n, stated.sd, stated.flag)
    return RobustEstimate(sd=sd, valid=valid, posterior_n=posterior.mean, posterior_sd=posterior.sd)


def _online_run(
    log: Log, name: str, samples: LogSamples, plant: Plant, n_range: tuple[float, float]
) -> FilterRun:
    imu, gnss = _sensors(log, 1.0 / samples.dt)
    # Without fixes the place is soon lost, and a map that is read elsewhere is worse than none.
    ground = flat() if np.isnan(samples.gnss[:, 0]).all() else plant.ground
    return FilterRun(
        plant=OnBoard(kind=name, ground=ground).belief(plant),
        dt=samples.dt,
        inputs=samples.inputs,
        z=np.column_stack([samples.imu, samples.rims, samples.gnss]),
        pose=_pose(log),
        n_range=n_range,
        imu=imu,
        gnss=gnss,
        slide=samples.slide,
    )


def _map_run(
    log: Log, name: str, samples: LogSamples, plant: Plant, n_range: tuple[float, float]
) -> FilterRun:
    if log.config.model != "paper":
        raise DataError(
            f"{log.name}: {name} runs the paper's half-car, the log is of model full - "
            f"use {', '.join(ONLINE_FILTERS)}"
        )
    if log.config.terrain.kind == "unknown":
        raise DataError(f"{log.name}: {name} needs a map, the ground is unknown - use one of the others")
    z = np.full((len(samples.t), len(CHANNELS)), math.nan)
    z[:, :5] = samples.imu
    for i, name in enumerate(IMU):
        if name not in log.channels:  # these filters need no substitute
            z[:, i] = math.nan
    return FilterRun(
        plant=plant,
        dt=samples.dt,
        inputs=samples.inputs,
        z=z,
        pose=_pose(log),
        n_fan=(n_range[0] + _FAN_ROOM, n_range[1] - _FAN_ROOM),
        joint=_joint_settings(log, n_range),
    )


def _joint_settings(log: Log, n_range: tuple[float, float]) -> JointSettings:
    """The filter's settings with the sensors of the log, a little wider than the range to be searched."""
    imu, settings = _imu(log), JointSettings()
    noise = (imu.sd_a,) * 3 + (imu.sd_rate,) * 2 + settings.noise[5:]
    return replace(settings, n_range=(n_range[0] - _STEP, n_range[1] + _STEP), noise=noise)
