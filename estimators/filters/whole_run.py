"""Any filter of the registry over a whole run, from one description of the run to one `BeliefHistory`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.analysis.consistency import innovation_flag
from estimators.filters.augmented_ekf_bank import AugmentedBankSettings, run_augmented_ekf_bank
from estimators.filters.belief_history import NORMAL_99, BeliefHistory, history_of_estimates
from estimators.filters.ekf import run_ekf
from estimators.filters.joint_bank import BankSettings, run_bank
from estimators.filters.joint_ukf import JointHistory, run_joint_filter
from estimators.filters.parameter_ukf import ParameterHistory, ParameterSettings, run_parameter_filter
from estimators.filters.particle import ParticleSettings, run_particles
from estimators.filters.protocol import Estimate, Pose
from estimators.filters.registry import FILTERS, OnlineSetup, filter_id
from estimators.filters.smoother import run_smoother
from estimators.models.half_car_on_map import ETA, IMU_CHANNELS, JointModel, JointSettings, joint_model, prior
from estimators.models.uncertain_half_car import CHANNELS as AUGMENTED_CHANNELS
from estimators.models.uncertain_half_car import uncertain_model
from estimators.numerics.bounded import interval
from offroad_env.errors import InvalidParameter
from offroad_env.physics.axle import Plant
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import settled_state

__all__ = ["FilterRun", "run_filter", "with_course"]

#: Readings of the inertial unit that the online filters compare: a_x, a_y, yaw rate.
_ONLINE_CHANNELS = 3
#: Distance that the smoother's first trajectory keeps from the bounds of n, and the spread of its prior [-].
_ROOM, _SMOOTHER_SD = 0.02, 0.02
#: Samples between two reports of progress.
_REPORT_EVERY = 100


@dataclass(frozen=True, kw_only=True)
class FilterRun:
    """A run as a filter gets it: its own model, what was commanded and measured, and the prior."""

    plant: Plant  #: the filter's own model
    dt: float  #: time between samples [s]
    inputs: np.ndarray  #: (2 T - 1, 3) commands at every half step, as the kernels take them
    z: np.ndarray  #: (T, 11) readings, `estimators.filters.joint_ukf.CHANNELS`; NaN: not measured
    pose: Pose  #: at the start
    n_prior: float = 1.0  #: mean of the prior: the paper's first guess [-]
    sd: float = 0.3  #: its standard deviation [-]
    n_fan: tuple[float, float] = (0.3, 1.3)  #: where the hypotheses of a bank on a map start [-]
    joint: JointSettings = field(default_factory=JointSettings)  #: noise and range of the filters on a map
    #: Of the parameter filter, which has a narrower prior of its own.
    parameter: ParameterSettings = field(default_factory=ParameterSettings)
    known: np.ndarray | None = None  #: (T, 15) true states, for the parameter filter with a known state
    n_range: tuple[float, float] = (0.2, 1.4)  #: bounds of n of the online filters [-]
    imu: ImuConfig = field(default_factory=lambda: ImuConfig(body_axes=False))  #: of the online filters
    gnss: GnssConfig = field(default_factory=GnssConfig)  #: of the online filters
    #: (T,) angle from heading to course, where a log has body speeds in place of a course [rad]
    slide: np.ndarray | None = None
    seed: int = 0  #: of the particles' resampling
    progress: Callable[[float], None] | None = None  #: called with the share done, by online filters

    @property
    def t(self) -> np.ndarray:
        """(T,) [s]"""
        return self.dt * np.arange(len(self.z))

    def place(self) -> tuple[float, float, float]:
        """Position and heading at the start [m, m, rad]."""
        return self.pose.X, self.pose.Y, self.pose.yaw


def run_filter(name: str, run: FilterRun) -> BeliefHistory:
    """Run a filter over a whole run, with its validity flag and the processor time that it took.

    A filter without a flag of its own gets that of `innovation_flag`. The NIS is that of samples with the
    usual number of channels: fixes that come now and then are left out.

    Parameters
    ----------
    name : str
        An id of the registry, or a short name.
    run : FilterRun

    Raises
    ------
    InvalidParameter
        For an unknown filter, or one that keeps no history of n alone.
    SolverFailure
        Where the filter finds no contact solution any more.
    """
    known = filter_id(name, _RUNS)
    begin = time.process_time()
    history = _RUNS[known](run)
    return replace(history, seconds=time.process_time() - begin)


def _usual_channels(history: BeliefHistory, z: np.ndarray) -> BeliefHistory:
    """With the usual number of channels, and the NIS of the samples that measured as many."""
    count = np.isfinite(z).sum(axis=1)
    channels = int(np.median(count[count > 0]))
    return replace(history, nis=np.where(count == channels, history.nis, math.nan), channels=channels)


def _flagged(history: BeliefHistory, width: np.ndarray, dt: float) -> BeliefHistory:
    """With the flag of `innovation_flag`; ``width`` (T,) is that of the 99 % interval."""
    assert history.channels is not None  # set by `_usual_channels` or by the filter
    return replace(history, valid=innovation_flag(history.nis, width, history.channels, dt))


def _widths(eta: np.ndarray, variance: np.ndarray, n_range: tuple[float, float]) -> np.ndarray:
    """Width (T,) of the 99 % interval of n, from mean and variance of eta."""
    ends = np.array([interval(e, v, *n_range, NORMAL_99) for e, v in zip(eta, variance, strict=True)])
    return np.asarray(ends[:, 1] - ends[:, 0])


def _of_joint(history: JointHistory, model: JointModel, run: FilterRun) -> BeliefHistory:
    variance = history.covariances[:, ETA, ETA]
    width = _widths(history.means[:, ETA], variance, (model.low, model.high))
    return _flagged(_usual_channels(history.belief, run.z), width, run.dt)


def _map_model(run: FilterRun) -> JointModel:
    return joint_model(run.plant, run.dt, run.joint)


def _map_joint_ukf(run: FilterRun) -> BeliefHistory:
    model = _map_model(run)
    start = prior(model, run.joint, run.n_prior, run.sd, run.place(), run.pose.v)
    return _of_joint(run_joint_filter(model, start, run.inputs, run.z), model, run)


def _map_ekf(run: FilterRun) -> BeliefHistory:
    model = _map_model(run)
    start = prior(model, run.joint, run.n_prior, run.sd, run.place(), run.pose.v)
    return _of_joint(run_ekf(model, start, run.inputs, run.z), model, run)


def _map_ukf_bank(run: FilterRun) -> BeliefHistory:
    settings = BankSettings(joint=run.joint, n_prior=run.n_prior, n_prior_sd=run.sd, n_fan=run.n_fan)
    bank = run_bank(_map_model(run), settings, run.inputs, run.z, pose=run.place(), v_x=run.pose.v)
    return _usual_channels(bank.belief, run.z)


def _map_particle_filter(run: FilterRun) -> BeliefHistory:
    settings = ParticleSettings(joint=run.joint, n_prior=run.n_prior, n_prior_sd=run.sd, n_fan=run.n_fan)
    place, speed = run.place(), run.pose.v
    particles = run_particles(
        _map_model(run), settings, run.inputs, run.z, pose=place, v_x=speed, seed=run.seed
    )
    return _flagged(_usual_channels(particles.belief, run.z), particles.width, run.dt)


def _map_smoother(run: FilterRun) -> BeliefHistory:
    """Started at the soil where the bank ends: a reference for the width of the peak, not a search.

    The settled start is linearised there, since it bends too much from the prior's mean to the truth.
    """
    model = _map_model(run)
    n = float(np.clip(_map_ukf_bank(run).n[-1], model.low + _ROOM, model.high - _ROOM))
    first, start = (prior(model, run.joint, n, sd, run.place(), run.pose.v) for sd in (_SMOOTHER_SD, run.sd))
    guess = run_joint_filter(model, first, run.inputs, run.z)
    smoothed = run_smoother(model, start, run.inputs, run.z, guess.means)
    return _of_joint(smoothed.joint, model, run)


def _augmented_ekf_bank(run: FilterRun) -> BeliefHistory:
    settings = AugmentedBankSettings(joint=run.joint, n_prior=run.n_prior, n_prior_sd=run.sd, n_fan=run.n_fan)
    model = uncertain_model(run.plant, run.dt, settings.joint, settings.uncertainty)
    history = run_augmented_ekf_bank(model, settings, run.inputs, run.z, pose=run.place(), v_x=run.pose.v)
    return _usual_channels(history.bank.belief, run.z[:, :AUGMENTED_CHANNELS])


def _parameter_ukf(run: FilterRun) -> BeliefHistory:
    """The state is propagated from where the vehicle stands settled on the soil of the prior's mean."""
    return _parameter_filter(run, None)


def _parameter_filter(run: FilterRun, known: np.ndarray | None) -> BeliefHistory:
    """The paper's filter, on ``known`` states (T, 15) where there are any."""
    plant = run.plant._replace(soil=run.plant.soil._replace(n=run.parameter.n_prior))
    x, y, yaw, v = run.pose
    start = settled_state(plant, x=x, y=y, yaw=yaw, v_x=v)
    imu = run.z[:, :IMU_CHANNELS]
    return _of_parameter(
        run_parameter_filter(plant, start, run.inputs, imu, run.dt, run.parameter, known=known), run
    )


def _of_parameter(history: ParameterHistory, run: FilterRun) -> BeliefHistory:
    width = _widths(history.eta, history.variance, run.parameter.n_range)
    return _flagged(history.belief, width, run.dt)


def _parameter_ukf_known_state(run: FilterRun) -> BeliefHistory:
    if run.known is None:
        raise InvalidParameter("parameter_ukf_known_state needs the true states of the run")
    return _parameter_filter(run, run.known)


def with_course(fix: np.ndarray, slide: float, yaw: float) -> np.ndarray:
    """Satellite fix (4,) whose course, where it is missing, follows from heading and ``slide``.

    Parameters
    ----------
    fix : array (4,)
        X, Y [m], speed [m/s], course [rad].
    slide : float
        Angle from heading to course [rad]; NaN where it was not measured.
    yaw : float
        Heading [rad].
    """
    if math.isnan(fix[3]) and not math.isnan(slide):
        return np.array([*fix[:3], yaw + slide])
    return fix


def _online(name: str) -> Callable[[FilterRun], BeliefHistory]:
    """The run of an online filter, sample by sample."""

    def whole(run: FilterRun) -> BeliefHistory:
        make = FILTERS[name].make
        assert make is not None  # `_RUNS` asks for online filters only
        estimator = make(OnlineSetup(run.plant, run.n_range, run.dt, run.imu, run.gnss))
        estimates: list[Estimate] = [estimator.reset(run.n_prior, run.sd, run.pose)]
        speed = np.full(len(run.z), run.pose.v)
        for k in range(1, len(run.z)):
            steer, drive, brake = run.inputs[2 * k - 1].tolist()
            brake = 0.0 if math.isnan(brake) else brake  # the paper's model has none
            z, slide = run.z[k], math.nan if run.slide is None else float(run.slide[k])
            fix = with_course(z[7:], slide, estimator.pose.yaw)
            estimates.append(estimator.update((steer, drive, brake), z[:5], z[5:7], fix))
            speed[k] = estimator.pose.v
            if run.progress is not None and k % _REPORT_EVERY == 0:
                run.progress(k / len(run.z))
        return history_of_estimates(run.t, estimates, run.n_range, channels=_ONLINE_CHANNELS, speed=speed)

    return whole


_RUNS: dict[str, Callable[[FilterRun], BeliefHistory]] = {
    "parameter_ukf": _parameter_ukf,
    "parameter_ukf_known_state": _parameter_ukf_known_state,
    "map_joint_ukf": _map_joint_ukf,
    "map_ekf": _map_ekf,
    "map_particle_filter": _map_particle_filter,
    "map_ukf_bank": _map_ukf_bank,
    "map_smoother": _map_smoother,
    "augmented_ekf_bank": _augmented_ekf_bank,
    "online_parameter_ukf": _online("online_parameter_ukf"),
    "online_joint_ukf": _online("online_joint_ukf"),
    "online_ukf_bank": _online("online_ukf_bank"),
}
