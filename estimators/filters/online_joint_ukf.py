"""Online joint unscented filter: the vehicle's motion and n in one belief, or a bank of such beliefs.

The filter of `estimators.filters.joint_ukf` has a map and the paper's dynamics. In a moving vehicle neither
is given: the ground is unknown, and the drive is torque at wheels that slip. The belief here holds the states
that the soil acts on - speeds, heave and pitch, wheel spin - and eta, the sinkage exponent on an unbounded
scale. Place and heading come from the navigation filter, the actuators follow the known command.

*Roughness is a state.* On ground that is taken to be level, the real slopes push the vehicle for tenths of a
second, forward and to the side. That is no white noise: a filter for such would be too sure of n after a
second. The two pushes are states of their own, which wander and fade. They act on speeds and accelerometers
alike, which distinguishes them from sensor noise, and average out over time, which distinguishes them from n.

*The pushes cost no force evaluation.* In the order [eta, motion, pushes] the last columns of the Cholesky
factor change pushes only: their sigma points share the step of the centre.

*One step a sample.* A sigma point is read where it stands and then propagated, so the covariance of that
reading with the state one period later is at hand: every sample of the inertial unit is used one period
late, without a second evaluation of the wheels. The velocity of a satellite fix is linear in the state and is
used at once. Rim speeds serve navigation only: a radius known to 1 % leaves the slip uncertain by 0.01, and
the force by 0.13 m/s^2.

With more than one component the belief is a Gaussian sum over n (`estimators.filters.gaussian_sum`): each
component is narrow, and the weights follow from how well each predicted.

*Change of soil.* The updates of eta are tested for whiteness (`estimators.filters.change_test`). Where a
second of them is three standard deviations away from zero, the soil has changed. The belief is then widened
by the change that explains the window, together with all that was inferred from the old n, and the validity
flag is down until the filter has followed.

The kernels of a sample are in `estimators.filters.online_joint_step`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.filters.change_test import WINDOW
from estimators.filters.navigation import V_SIDE, YAW, NavigationFilter, NavigationNoise, V, X, Y
from estimators.filters.online_base import (
    CHANGE_FIELDS,
    OnlineFilter,
    check_positive,
    filter_range,
    require_plain_plant,
)
from estimators.filters.online_joint_step import (
    ALIVE,
    AWAKE,
    CHANGES,
    CHANNELS,
    HELD,
    MEMORY,
    NIS,
    SURPRISE,
    USED,
    ChangeTest,
    JointRules,
    JointState,
    copies_of,
    note_estimate,
    place_all_points,
    update_all,
)
from estimators.filters.protocol import Estimate
from estimators.models.imu_prediction import plant_with_exponent, step_full_copies, step_paper_copies
from estimators.numerics.bounded import belief_of, to_range
from estimators.numerics.unscented import centred_weights
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.packing import pack
from offroad_env.physics.records import FloatArray
from offroad_env.physics.settle import settle
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import Plant, plant_model

__all__ = ["OnlineJointSettings", "OnlineJointUKF"]

#: States of the vehicle in the belief, after eta and before the pushes. The bicycle does not heave, the
#: paper's wheels do not spin.
_MOTION = (at.V_X, at.V_Y, at.YAW_RATE)
_HEAVE = (at.Z, at.PITCH, at.V_Z, at.PITCH_RATE)
_SPIN = (at.OMEGA_F, at.OMEGA_R)


@dataclass(frozen=True, kw_only=True)
class OnlineJointSettings:
    """Noise, start and tests of the filter; each value has its reason here."""

    components: int = 1  #: 1 = a joint filter; more = a bank of them over n
    spread: float = 1.7  #: sigma points in standard deviations: sqrt(3) has the fourth moment right
    drift: float = 0.02  #: random walk of eta [1/sqrt(s)]: about 0.005 of n per sqrt(s)
    push: tuple[float, float] = (0.15, 0.3)  #: standard deviation of the pushes along, across [m/s^2]
    push_time: float = 0.3  #: how long a push lasts: a metre or two of ground [s]
    #: Random walks of v_x, v_y, yaw rate; z, pitch, v_z, pitch rate; wheel spin [the unit per sqrt(s)].
    walk: tuple[float, ...] = (0.02, 0.03, 0.12, 6e-4, 4e-4, 0.008, 0.012, 0.3)
    #: Start: standard deviation of the same [m/s, rad/s; m, rad, m/s, rad/s; rad/s].
    start: tuple[float, ...] = (0.2, 0.1, 0.03, 0.005, 0.005, 0.03, 0.03, 1.0)
    hold_speed: float = 1.0  #: below this the filter rests and the estimate holds [m/s]
    surprise: float = 25.0  #: largest chi-square (3 channels) of the mean innovation for a valid estimate
    drop: float = 1e-4  #: weight below which a component is dropped

    change_time: float = 1.0  #: fading window of the test for a change of n [s]
    #: Deviation at which n has changed [standard deviations]; constant soils reach 2.7 in half a minute
    #: on roads of class B, a step of a quarter reaches 4.
    change_level: float = 3.0
    change_settle: float = 1.0  #: how long the flag stays down after a change [s]

    def __post_init__(self) -> None:
        if not 1 <= self.components <= 20:
            raise InvalidParameter(f"components must be in [1, 20], got {self.components}")
        names = ("spread", "drift", "push_time", "hold_speed", "surprise", "drop")
        check_positive(self, (*names, *CHANGE_FIELDS))
        for name, count in (("push", 2), ("walk", 8), ("start", 8)):
            values = getattr(self, name)
            if len(values) != count or not all(value > 0.0 for value in values):
                raise InvalidParameter(f"{name} must be {count} numbers > 0, got {values}")


class OnlineJointUKF(OnlineFilter):
    """Estimate of the sinkage exponent with the vehicle's motion (an
    `estimators.filters.protocol.Estimator`).

    Parameters
    ----------
    plant : Plant
        The vehicle's model of itself and the ground: full or paper model, half-car or bicycle, with rigid
        rims on uniform soil, whose n is not used. A ground that is not known is `flat()`.
    n_range : (float, float)
        Bounds of n [-]; the reported mean stays inside.
    dt : float
        Time between samples [s].
    imu, gnss : ImuConfig, GnssConfig, optional
        Mounting and noise, as far as known.
    settings : OnlineJointSettings, optional
    navigation : NavigationFilter, optional
        To be used and updated here, and by nobody else; default: one of its own.

    Raises
    ------
    InvalidParameter
        For a range, step or plant that the filter cannot work with.
    """

    def __init__(
        self,
        plant: Plant,
        n_range: tuple[float, float],
        *,
        dt: float = 0.01,
        imu: ImuConfig | None = None,
        gnss: GnssConfig | None = None,
        settings: OnlineJointSettings | None = None,
        navigation: NavigationFilter | None = None,
    ) -> None:
        require_plain_plant(plant)
        noise = NavigationNoise.of(gnss, imu)
        super().__init__(plant, n_range, dt=dt, navigation=navigation, navigates=True, noise=noise)
        self.settings = settings or OnlineJointSettings()
        self._full = plant_model(plant) == "full"
        self._packed = pack(plant)
        imu = imu or ImuConfig()
        self._mount = imu.mount()
        self._rules, self._prior = self._constants(imu, gnss or GnssConfig())
        self._state = self._memory()
        self._start()

    def _constants(self, imu: ImuConfig, gnss: GnssConfig) -> tuple[JointRules, FloatArray]:
        """The kernels' view of the settings, and the variances (L - 1,) of the start."""
        s, vehicle, (low, high) = self.settings, self.plant.vehicle, filter_range(self.n_range)
        heave, spin = self.plant.half_car > 0.5, self._full
        states = _MOTION + (_HEAVE if heave else ()) + (_SPIN if spin else ())
        noise_of = [0, 1, 2] + [3, 4, 5, 6] * heave + [7, 7] * spin
        fade = math.exp(-self.dt / s.push_time)
        walk, push = np.square(np.array(s.walk)[noise_of]) * self.dt, np.square(s.push)
        Q = np.concatenate([[s.drift**2 * self.dt], walk, push * (1.0 - fade * fade)])
        rules = JointRules(
            n_range=self.n_range,
            low=low,
            high=high,
            states=np.array(states),
            Q=Q,
            R=np.square([imu.accel_noise, imu.accel_noise, imu.gyro_noise]),
            fix=gnss.velocity_sd**2,
            fade=fade,
            weights=centred_weights(float(len(Q)), float(s.spread)),
            lags=(vehicle.steer_lag, vehicle.torque_lag),
            hold_speed=float(s.hold_speed),
            log_drop=math.log(s.drop),
            surprise=float(s.surprise),
            change=ChangeTest(float(s.change_time), float(s.change_level), float(s.change_settle)),
            dt=self.dt,
        )
        return rules, np.concatenate([np.square(np.array(s.start)[noise_of]), push])

    def _memory(self) -> JointState:
        K, L, C = self.settings.components, len(self._rules.Q), copies_of(self._rules)
        return JointState(
            means=np.zeros((K, L)),
            covs=np.zeros((K, L, L)),
            log_weights=np.zeros(K),
            points=np.zeros((K, 2 * L + 1, L)),
            copies=np.zeros((K * C, at.STATE_SIZE)),
            warms=np.zeros((K * C, 2, at.CONTACT_SIZE)),
            exponents=np.zeros(K * C),
            predicted=np.zeros((K * C, 5)),
            shared=np.zeros(at.STATE_SIZE),
            last=np.zeros(CHANNELS),
            mean_innovation=np.zeros(CHANNELS),
            windows=np.zeros((K, WINDOW)),
            memory=np.zeros(MEMORY),
            report=np.zeros(len(Estimate._fields)),
        )

    def _restart(self, n_prior: float, sd: float) -> None:
        state, K = self._state, self.settings.components
        for array in state:
            array[:] = 0.0
        eta, variance = belief_of(n_prior, sd, self._rules.low, self._rules.high)
        # Side by side, each as wide as its share of the way: the sum has the prior's mean and variance.
        places, width = (2.0 * np.arange(K) + 1.0 - K) / K, 1.0 / K
        scale = math.sqrt(variance / (np.mean(np.square(places)) + width * width))
        state.means[:, 0], state.covs[:, 0, 0] = eta + scale * places, (scale * width) ** 2
        state.log_weights[:] = -math.log(K)
        state.memory[ALIVE], state.memory[NIS], state.memory[HELD] = K, math.nan, 1.0
        note_estimate(state, self._rules)

    def _update(
        self,
        command: tuple[float, float, float],
        imu: FloatArray,
        rim_speeds: FloatArray,
        gnss: FloatArray,
    ) -> None:
        nav, state, rules = self.navigation.x, self._state, self._rules
        if place_all_points(state, nav, imu, command, rules):
            stepped = int(state.memory[ALIVE]) * copies_of(rules)
            copies, warms, predicted = (
                array[:stepped] for array in (state.copies, state.warms, state.predicted)
            )
            step = step_full_copies if self._full else step_paper_copies
            n = state.exponents[:stepped]
            status = step(copies, warms, self._packed, n, command, self.dt, self._mount, predicted)
            if status < SUNK and np.isfinite(predicted).all() and np.isfinite(copies).all():
                update_all(state, nav, gnss, rules)
            else:
                self._sleep()
                note_estimate(state, rules)
        elif nav[V] > rules.hold_speed and np.isfinite(imu).all():
            self._wake()
            note_estimate(state, rules)
        state.last[:] = imu[USED]

    def _wake(self) -> None:
        """Settle every component on its own soil, rolling at the navigation filter's speed."""
        state, rules, nav = self._state, self._rules, self.navigation.x
        states, C, spread = rules.states, copies_of(rules), math.sqrt(rules.weights.scale)
        motion = slice(1, 1 + len(states))
        for k in range(int(state.memory[ALIVE])):
            variance = float(state.covs[k, 0, 0])
            beside, sides = spread * math.sqrt(variance), np.empty((3, at.STATE_SIZE))
            own = (0, 1, 2 + len(states))  # copies of the centre and of the points along eta
            for i, step in enumerate((0.0, beside, -beside)):
                n = to_range(float(state.means[k, 0]) + step, rules.low, rules.high)
                plant = plant_with_exponent(self.plant, n)
                status, sides[i], warm = settle(plant, (nav[X], nav[Y], nav[YAW]), nav[V])
                if status >= SUNK or not np.isfinite(sides[i]).all():
                    state.memory[SURPRISE] = math.inf
                    return
                if i == 0:
                    state.warms[k * C : (k + 1) * C] = warm
                state.warms[k * C + own[i]] = warm
            # The settled start is linearised in eta: a vehicle on softer soil stands deeper.
            slope = np.zeros(len(state.means[k]))
            slope[0], slope[motion] = 1.0, (sides[1] - sides[2])[states] / (2.0 * beside)
            state.means[k, 1:], state.means[k, motion] = 0.0, sides[0, states]
            state.means[k, 2] = nav[V_SIDE]
            state.covs[k] = variance * np.outer(slope, slope)
            state.covs[k][np.arange(1, len(slope)), np.arange(1, len(slope))] += self._prior
        state.memory[AWAKE], state.memory[SURPRISE] = 1.0, 0.0
        state.mean_innovation[:] = 0.0
        state.windows[:] = 0.0

    def _sleep(self) -> None:
        """A copy has no contact: hold, not valid, and start all of them again at the next sample."""
        memory = self._state.memory
        memory[AWAKE], memory[HELD], memory[SURPRISE] = 0.0, 1.0, math.inf

    @property
    def estimate(self) -> Estimate:
        """The present estimate."""
        mean, sd, nis, valid, repairs = self._state.report.tolist()
        return Estimate(mean, sd, nis, valid > 0.5, int(repairs))

    @property
    def held(self) -> bool:
        """Whether the last sample left n as it was."""
        return bool(self._state.memory[HELD] > 0.5)

    @property
    def changes(self) -> int:
        """How many changes of n it has detected since the reset."""
        return int(self._state.memory[CHANGES])
