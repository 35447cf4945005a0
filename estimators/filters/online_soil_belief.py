"""Online belief over whole soils: what the soil holds, when more than n is unknown.

A filter for n alone reads a friction angle that is one degree off as another n. Here pressure at 5 cm, n,
cohesion, friction angle, shear modulus and contact angles are unknown together, with the population of
measured soils (`offroad_env.world.soil_prior`) as their prior, and so are the vehicle's mass, the biases of
the inertial unit and the scale of the wheel speeds. Single parameters often stay uncertain; what the soil
holds (`offroad_env.simulation.soil_holds`) is known much better, and is what a driver and a planner need.

*Copies.* As in `estimators.filters.online_parameter_ukf` every sigma point has a vehicle of its own, which
finds its slip, sinkage and side slip on its own soil under the command that was given. 14 copies at 50 Hz
cost about as much as four of that filter.

*A wide belief.* Points lie one standard deviation out, where soils still carry the vehicle; a pair that does
not is drawn nearer. What the sensitivities leave of the copies' differences counts as noise (second-order
filter).

*What lasts.* Errors of model and navigation last tenths of a second and count as white noise of that
duration. What the means of the innovations show beyond it is learnt as a discrepancy and widens the interval.
When the mean over 2 s leaves its band, no soil explains the drive: the flag goes down and part of the prior
comes back.

*Ground.* Gravity along a slope that no map shows adds to the rolling resistance. The slope towards two axes
is unknown, too, within what is stated (`SoilBeliefSettings.grade`): a vehicle that turns tells the two apart,
and where it does not turn the interval of the resistance holds both.

*Wrong laws.* Eight numbers of a soil reproduce much of what other laws do, and the limits are then wrong.
Sideways motion gives it away: its means over 0.5 s err by more than belief and sensors explain, and the flag
goes down. It is up only after 2 s of driving that has passed this test, or earlier where all innovations are
small.

The kernels are in `soil_belief_step`, `soil_belief_points` and `soil_belief_holds`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.filters.believed_limits import BelievedLimits, HeldLimit, RefreshRule
from estimators.filters.navigation import YAW, NavigationFilter, NavigationNoise, V
from estimators.filters.online_base import OnlineFilter, check_positive
from estimators.filters.protocol import Estimate
from estimators.filters.soil_belief_holds import SHIFT, share_of_slope, sharpen
from estimators.filters.soil_belief_points import (
    COPIES,
    GRADE,
    LOG_MASS,
    POINTS,
    SAMPLED,
    SIZE,
    N,
    Sigma,
    plant_of_point,
)
from estimators.filters.soil_belief_prior import POPULATION_RANGE, base_soil, population_n, population_of
from estimators.filters.soil_belief_step import (
    CHANNELS,
    DISCREPANCY,
    FLAGS,
    HELD,
    LEARNED,
    NIS,
    REJECTED,
    REPAIRS,
    RESETS,
    SURPRISE,
    TESTED,
    UNSETTLED,
    BeliefMemory,
    BeliefRules,
    learn_soil,
)
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.axle import contact_shape
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.packing import pack
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import Plant, plant_model
from offroad_env.simulation.soil_holds import SoilHolds

__all__ = [
    "BELIEF_VECTOR",
    "LONGEST",
    "POPULATION_RANGE",
    "HeldLimit",
    "Immobilisation",
    "OnlineSoilBelief",
    "SoilBeliefSettings",
    "population_n",
    "population_of",
]

#: What `OnlineSoilBelief.vector` holds: means and standard deviations in turn, risk of getting stuck, flag.
BELIEF_VECTOR = (
    *(f"{name}{part}" for name in (*SoilHolds._fields, "n") for part in ("", "_sd")),
    *("stuck", "stop_in", "valid"),
)
#: Longest time to a stop that is reported [s].
LONGEST = 100.0
_PULL, _PULL_SLIP = SoilHolds._fields.index("pull"), SoilHolds._fields.index("pull_slip")
#: Certainty [standard deviations] beyond which an immobilisation is not announced sooner.
_SURE = 5.0
#: Times to a stop below this one count as this: a vehicle that is nearly at rest may have stopped [s].
_SOONEST = 0.5
#: Speed of the rims below which no slip is measured [m/s].
_SLOWEST = 0.1

#: Settings that must be positive.
_POSITIVE = (
    *("error_time", "drift", "settle_time", "hold_speed", "mass", "acceleration_bias", "misalignment"),
    *(
        "rate_bias",
        "rim_scale",
        "short_time",
        "memory_time",
        *("misfit_time", "misfit", "test_time", "early_time", "early_surprise", "rejected_time"),
        "surprise",
        "discrepancy",
        *("refresh_time", "refresh_move", "refresh_latest", "refresh_far"),
        "slowing_time",
        "reserve",
        "averaging_time",
    ),
)


class Immobilisation(NamedTuple):
    """Risk of getting stuck."""

    probability: float  #: that the soil gives no pull at any slip, on level ground
    stop_in: float  #: time to a stop as the speed falls now, brakes apart, at most `LONGEST` [s]
    announced: bool  #: whether the vehicle is about to get stuck


@dataclass(frozen=True, kw_only=True)
class SoilBeliefSettings:
    """Noise, gains, priors and tests of the belief; each value has its reason here."""

    #: What the model leaves out: a_x, a_y [m/s^2], yaw rate [rad/s], speed of the navigation filter and rims'
    #: speeds beyond it [m/s]. As in `OnlineParameterSettings`; speed: what the navigation filter has wrong.
    error: tuple[float, float, float, float, float] = (0.15, 0.3, 0.03, 0.07, 0.22)
    error_time: float = 0.3  #: how long such an error lasts [s]
    drift: float = 0.03  #: random walk, in standard deviations of the prior [1/sqrt(s)]
    settle_time: float = 1.0  #: time in which the copies follow their sigma points [s]
    position_gain: float = 5.0  #: pulls as in `OnlineParameterSettings` [1/s]
    speed_gain: float = 4.0
    #: None: tyres damp side slip, and the navigation filter's follows the bias of the accelerometer.
    side_gain: float = 0.0
    yaw_rate_gain: float = 2.0
    pitch_rate_gain: float = 5.0
    hold_speed: float = 1.0  #: below this the copies rest and the belief holds [m/s]
    mass: float = 0.05  #: standard deviation of log mass: load and fuel
    acceleration_bias: float = 0.1  #: of the accelerometers [m/s^2]
    misalignment: float = math.radians(2.0)  #: of the unit; where it measures gravity, it has a share of that
    rate_bias: float = 0.005  #: of the gyro, beyond what the navigation filter has found [rad/s]
    rim_scale: float = 0.01  #: of the rolling radius [-]
    #: Of the slope of the ground beyond that of its map, towards each of two axes [-]: ground that is called
    #: level, a map as good as the mounting of the unit. 0: the ground is known.
    grade: float = 0.03
    short_time: float = 0.5  #: of the mean in which a discrepancy shows [s]
    memory_time: float = 5.0  #: over which its variance is averaged [s]
    misfit_time: float = 2.0  #: over which what neither belief nor sensors explain is averaged [s]
    surprise: float = 15.0  #: largest chi-square (6 channels) of the mean innovation for a valid belief
    #: Largest misfit of lateral acceleration and yaw rate for a valid belief, over `error`; how long the
    #: flag stays down where it is exceeded [s].
    misfit: float = 0.6
    rejected_time: float = 10.0
    #: How long the belief is tested before the flag goes up [s]; from the second time on where the chi-square
    #: of the mean innovation is no larger than the third number. Wrong laws show in it first.
    test_time: float = 2.0
    early_time: float = 0.6
    early_surprise: float = 0.4
    discrepancy: float = 2.5  #: largest discrepancy of a channel for a valid belief, over `error`
    widening: float = 0.2  #: share of the prior's variance that comes back when no soil explains the drive
    unsettled_time: float = 3.0  #: how long the flag then stays down [s]
    #: An immobilisation is announced where the soil gives no pull with probability 0.5, the wheels slip as
    #: for the largest pull, and the speed falls to zero within the first time; each standard deviation of
    #: certainty makes that time e times as long, up to the second [s]. So does slip beyond that of the
    #: largest pull, by one over ``reserve``: who has no pull in reserve cannot push harder.
    stuck: tuple[float, float] = (2.5, 5.0)
    reserve: float = 2.5
    slowing_time: float = 1.0  #: over which the loss of speed is averaged [s]
    #: Information that a drive gives about each limit, over that which the filter counts: its noise has to
    #: cover errors that do not act on all of them alike. Chosen so that 95 % of the intervals hold on tuning
    #: soils. Of n likewise.
    information: tuple[float, ...] = (1.4, 1.2, 1.0, 3.3, 1.0, 1.0)
    information_n: float = 0.6
    #: Errors that last, of lag and drag for one, do not average out: from this time [s] on what is learnt in
    #: the time t counts (averaging_time/t)^fading, for the limits and for n. Chosen on tuning drives of 60 s.
    averaging_time: float = 10.0
    fading: tuple[float, float] = (0.33, 1.0)
    refresh_time: float = 2.0  #: from one reference of the limits to the next, at least [s]
    #: Move of the belief, in its standard deviations, from which the reference is renewed, and the time after
    #: which it is renewed anyway [s]. A reference costs as much as eight updates.
    refresh_move: float = 0.6
    refresh_latest: float = 8.0
    #: Move from which it is renewed at once: beyond two standard deviations parabolas have been wrong by a
    #: factor of ten, where a soil moved along a bent ridge.
    refresh_far: float = 1.8

    def __post_init__(self) -> None:
        check_positive(self, _POSITIVE)
        if not 0.0 <= self.grade <= 0.3:
            raise InvalidParameter(f"grade must be in [0, 0.3], got {self.grade} - in %?")


class OnlineSoilBelief(OnlineFilter):
    """Belief over whole soils from commands and sensors (an `estimators.filters.protocol.Estimator`).

    Parameters
    ----------
    plant : Plant
        The vehicle's model of itself, its wheels (structure, tyre) and the ground: full model, half-car or
        bicycle. Its soil is not used.
    n_range : (float, float)
        Bounds of the reported n [-].
    dt : float
        Time between samples [s].
    imu : ImuConfig, optional
        How the inertial unit is mounted and what it measures, as far as known.
    gnss : GnssConfig, optional
        The receiver, for the noise of the navigation filter.
    settings : SoilBeliefSettings, optional
    navigation : NavigationFilter, optional
        Somebody else's, who keeps it up to date. Default: one of its own.

    Raises
    ------
    InvalidParameter
        For a plant of the paper's model or with four wheels, or a range or step that it cannot work with.
    """

    def __init__(
        self,
        plant: Plant,
        n_range: tuple[float, float],
        *,
        dt: float = 0.02,
        imu: ImuConfig | None = None,
        gnss: GnssConfig | None = None,
        settings: SoilBeliefSettings | None = None,
        navigation: NavigationFilter | None = None,
    ) -> None:
        noise = NavigationNoise.of(gnss, imu)
        super().__init__(
            plant, n_range, dt=dt, navigation=navigation, navigates=navigation is None, noise=noise
        )
        if plant_model(plant) != "full" or plant.four_wheel is not None:
            raise InvalidParameter("the belief over soils needs a half-car or bicycle of the full model")
        self.settings = settings or SoilBeliefSettings()
        self._mount = (imu or ImuConfig()).mount()
        uniform = plant.soil_map._replace(patches=np.empty((0, 4)))
        self._packed = pack(plant._replace(soil=base_soil(), soil_field=None, soil_map=uniform))
        self._rules = self._constants(imu or ImuConfig())
        self._memory = _new_memory(plant)
        s = self.settings
        rule = RefreshRule(s.refresh_time, s.refresh_latest, s.refresh_move, s.refresh_far)
        self._limits = BelievedLimits(self._packed, plant.vehicle.m * GRAVITY, s.information, rule)
        self._speed, self._gain, self._slip = math.nan, 0.0, 0.0
        self._start()

    def _constants(self, imu: ImuConfig) -> BeliefRules:
        s, vehicle = self.settings, self.plant.vehicle
        tilt = self._mount.gravity * s.misalignment
        bias = math.hypot(s.acceleration_bias, tilt)
        own = np.square([s.mass, bias, bias, s.rate_bias, s.rim_scale, s.grade, s.grade])
        sensor = np.array([imu.accel_noise, imu.accel_noise, imu.gyro_noise, 0.0, 0.0, 0.0])
        error = np.array([*s.error, s.error[-1]])
        return BeliefRules(
            prior=np.concatenate([np.diag(population_of()[1]), own]),
            R=sensor**2 + 2.0 * error**2 * s.error_time / self.dt,
            error=error**2,
            sensor=sensor**2,
            drift=float(s.drift),
            lags=(vehicle.steer_lag, vehicle.torque_lag),
            position_gain=float(s.position_gain),
            speed_gain=float(s.speed_gain),
            side_gain=float(s.side_gain),
            yaw_rate_gain=float(s.yaw_rate_gain),
            pitch_rate_gain=float(s.pitch_rate_gain),
            hold_speed=float(s.hold_speed),
            settle_time=float(s.settle_time),
            short_time=float(s.short_time),
            memory_time=float(s.memory_time),
            misfit_time=float(s.misfit_time),
            misfit=float(s.misfit),
            test_time=float(s.early_time),
            rejected_time=float(s.rejected_time),
            surprise=float(s.surprise),
            widening=float(s.widening),
            unsettled_time=float(s.unsettled_time),
            dt=self.dt,
        )

    def _restart(self, n_prior: float, sd: float) -> None:
        for array in self._memory:
            if isinstance(array, np.ndarray):
                array[:] = 0.0
        mean, cov = population_of(n_prior, sd)
        self._memory.mean[:LOG_MASS] = mean
        self._memory.cov[:] = np.diag(self._rules.prior)
        self._memory.cov[:LOG_MASS, :LOG_MASS] = cov
        self._rules.prior[:LOG_MASS] = np.diag(cov)
        self._memory.last[:] = self._memory.flags[NIS] = math.nan
        self._limits.start(self._memory.mean, self._memory.cov)
        self._speed, self._gain, self._slip = math.nan, 0.0, 0.0

    def _update(
        self,
        command: tuple[float, float, float],
        imu: FloatArray,
        rim_speeds: FloatArray,
        gnss: FloatArray,
    ) -> None:
        memory = self._memory
        nav = self.navigation.x
        learn_soil(memory, self._rules, self._packed, self._mount, nav, imu, rim_speeds, command)
        _, _, brake = command
        self._note_loss_of_speed(float(nav[V]), brake)
        self._note_slip(float(nav[V]), 0.5 * (float(rim_speeds[0]) + float(rim_speeds[1])))
        self._limits.follow(memory.mean, memory.cov, self.dt, self._fresh(0))

    def _fresh(self, kind: int) -> float:
        """Share of the information that counts, of the limits (0) or of n (1)."""
        s, learned = self.settings, float(self._memory.flags[LEARNED])
        return math.pow(s.averaging_time / max(learned, s.averaging_time), s.fading[kind])

    def _note_loss_of_speed(self, speed: float, brake: float) -> None:
        """Average the acceleration without what the brakes [N m] take away: who brakes is not stuck."""
        before, self._speed = self._speed, speed
        if math.isfinite(before):
            vehicle = self.plant.vehicle
            unbraked = (speed - before) / self.dt + brake / (vehicle.m * vehicle.r)
            self._gain += self.dt / self.settings.slowing_time * (unbraked - self._gain)

    def _note_slip(self, speed: float, rims: float) -> None:
        """Slip of the wheels, where their speed [m/s] is measured."""
        if math.isfinite(rims):
            self._slip = min(max(1.0 - speed / max(rims, _SLOWEST), -1.0), 1.0)

    @property
    def estimate(self) -> Estimate:
        """The present estimate of n."""
        memory = self._memory
        low, high = self.n_range
        sd = np.array([math.sqrt(float(memory.cov[N, N]))])
        prior = np.array([math.sqrt(float(self._rules.prior[N]))])
        spared = np.array([share_of_slope(memory.cov[N, GRADE:], memory.cov)])
        sharpen(sd, prior, np.array([self.settings.information_n]), spared, self._fresh(1))
        inside, sd_n = min(max(float(memory.mean[N]), low), high), float(sd[0])
        return Estimate(inside, sd_n, float(memory.flags[NIS]), self.is_valid, int(memory.flags[REPAIRS]))

    @property
    def is_valid(self) -> bool:
        """Whether the model has been tested on some driving, and no innovation test rejects it."""
        flags = self._memory.flags
        s = self.settings
        early = flags[TESTED] >= s.early_time and flags[SURPRISE] <= s.early_surprise
        tested = (early or flags[TESTED] >= s.test_time) and flags[REJECTED] <= 0.0
        explained = (
            flags[SURPRISE] < self._rules.surprise and flags[DISCREPANCY] < self.settings.discrepancy**2
        )
        return bool(tested and explained and flags[UNSETTLED] <= 0.0)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Means and standard deviations (6,) of the limits in the order of `SoilHolds`, in copies.

        Those of the logarithm where `LOGARITHMIC` is true.
        """
        return self._limits.centre.copy(), self._limits.sd.copy()

    @property
    def holds(self) -> dict[str, HeldLimit]:
        """Belief about what the soil holds, by the names of `SoilHolds`."""
        return self._limits.by_name()

    @property
    def vector(self) -> FloatArray:
        """(17,) what `BELIEF_VECTOR` names: SI units."""
        numbers = [value for limit in self.holds.values() for value in (limit.mean, limit.sd)]
        estimate, risk = self.estimate, self.immobilisation
        known = (estimate.mean, estimate.sd, risk.probability, risk.stop_in, float(estimate.valid))
        return np.array([*numbers, *known])

    @property
    def immobilisation(self) -> Immobilisation:
        """Risk of getting stuck; the probability is that on level ground, the alarm for the ground here."""
        none = math.log(SHIFT[_PULL] * self.plant.vehicle.m * GRAVITY)
        centre, sd = self._pull()
        probability = 0.5 * math.erfc((centre - none) / sd / math.sqrt(2.0))
        stop_in = LONGEST
        if self._gain < 0.0:
            stop_in = min(max(self._speed, 0.0) / -self._gain, LONGEST)
        soon, latest = self.settings.stuck
        announced = max(stop_in, _SOONEST) < min(soon * math.exp(min(self._certainty(), _SURE)), latest)
        return Immobilisation(probability, stop_in, announced)

    def _pull(self) -> tuple[float, float]:
        """Mean and standard deviation of the logarithm of the shifted pull."""
        return float(self._limits.centre[_PULL]), max(float(self._limits.sd[_PULL]), 1e-9)

    def _certainty(self) -> float:
        """How certain it is that there is no more pull [standard deviations]: by the soil, and by the slip.

        A slope s takes s times the weight: the logarithm of what is needed is log(shift + s) weights, and
        what is not known of s is not known of the pull, with the other sign: their sum is known.
        """
        memory, yaw, (centre, sd) = self._memory, float(self.navigation.x[YAW]), self._pull()
        along = np.array([math.cos(yaw), math.sin(yaw)])
        needed = max(SHIFT[_PULL] + float(along @ memory.mean[GRADE:]), 0.1 * SHIFT[_PULL])
        rate = along / needed
        shared = self._limits.with_slopes[_PULL]
        variance = sd * sd + float(rate @ (memory.cov[GRADE:, GRADE:] @ rate - 2.0 * shared))
        none = math.log(needed * self.plant.vehicle.m * GRAVITY)
        beyond = min(max(self._slip - float(self._limits.centre[_PULL_SLIP]), -0.5), 0.5)
        return (none - centre) / math.sqrt(max(variance, 1e-18)) + self.settings.reserve * beyond

    @property
    def soil(self) -> tuple[FloatArray, FloatArray]:
        """Mean (14,) and covariance (14, 14) of the numbers of `BELIEF_NAMES`, in copies."""
        return self._memory.mean.copy(), self._memory.cov.copy()

    @property
    def believed_plants(self) -> list[Plant]:
        """Models with soil and mass of the belief's mean, and of the other sigma points of the last update.

        The mean of what they predict is the prediction of the belief.
        """
        ground, slope = self.plant.ground, self._memory.mean[GRADE:].tolist()
        tilted = ground._replace(S_x=ground.S_x + slope[0], S_y=ground.S_y + slope[1])
        base = self.plant._replace(soil=base_soil(), ground=tilted)
        points = [self._memory.mean[:SAMPLED], *self._memory.sigma.points[1:]]
        return [plant_of_point(base, point) for point in points]

    @property
    def held(self) -> bool:
        """Whether the last sample left the belief as it was."""
        return bool(self._memory.flags[HELD] > 0.5)

    @property
    def changes(self) -> int:
        """How often no soil has explained the drive since the reset."""
        return int(self._memory.flags[RESETS])


def _new_memory(plant: Plant) -> BeliefMemory:
    sigma = Sigma(np.zeros((SAMPLED, SAMPLED)), np.ones(SAMPLED), np.zeros((POINTS, SAMPLED)))
    return BeliefMemory(
        mean=np.zeros(SIZE),
        cov=np.zeros((SIZE, SIZE)),
        sigma=sigma,
        copies=np.zeros((COPIES, at.STATE_SIZE)),
        warms=np.zeros((COPIES, *contact_shape(plant.structure))),
        last=np.zeros(3),
        mean_innovation=np.zeros(CHANNELS),
        short_innovation=np.zeros(CHANNELS),
        discrepancy=np.zeros(CHANNELS),
        misfit=np.zeros(CHANNELS),
        lean=np.zeros(2),
        flags=np.zeros(FLAGS),
    )
