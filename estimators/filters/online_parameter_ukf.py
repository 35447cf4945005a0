"""Online parameter unscented filter: the sinkage exponent alone, from commands and sensors.

Three copies of the vehicle's model are propagated, one for each sigma point of the belief about n, all under
the command that was given. Their predictions for the inertial unit are compared with its readings.

*What n is inferred from.* The drive torque is known, the acceleration is measured, and in between stands the
resistance of the ground that is pressed down: T/r - F_x, some 0.1 to 0.3 of the weight, grows with
n. Cornering adds the dependence of the side forces. Each copy finds the slip that its own soil
needs for the torque, as the vehicle does; nothing may move its wheels to a measured speed, since a
slip that is wrong by 0.01 is a force that is wrong by 0.13 m/s^2.

*Why each sigma point has its own state.* Heave, slip and side slip follow n within tenths of a
second. In copies that start every step from one common state n acts only through the forces of that
instant, at a sinkage which belongs to another n: the sensitivity has the wrong size and at times
the wrong sign, and the filter confirms itself.

*Why the noise is larger than the sensors'.* Roughness that the model lacks, the pull of
the navigation filter and the model's lag give errors that last tenths of a second. An error of
standard deviation s that lasts tau counts, for a filter for white noise, as a
variance 2 s^2 tau/dt per sample. `OnlineParameterSettings.error` holds s per channel.

*Why the rate of learning is bounded.* A first second of hard braking would narrow the belief
tenfold while the copies still settle, at readings that no soil gives. The share of the variance
that an update may remove is therefore bounded (`settle_time`), and below a smallest share nothing is
learnt at all (`least_information`): the estimate holds and its standard deviation grows.

*Change of soil.* A belief of a minute would follow a step of n in ten seconds and stay
narrow meanwhile. But a step shows in all innovations of half a second at once, along their
sensitivity to n; noise does not. When that score leaves its band, the belief is widened by the
change that explains it and the flag is down until the copies have followed.

*Where the soil is known to change.* Then all this is too slow, and a belief that drifts faster learns no
sooner from the inertial unit alone: when only the front wheels stand on softer soil, the vehicle hardly
decelerates. But they slip, at once and by far more than a rim's speed may be wrong. `CHANGING_SOIL` lets
the belief drift with the soil and compares the rims' speeds too; on soil that rests its band is four times
as wide, so it is not the default.

The kernels of a sample are in `estimators.filters.online_parameter_step`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.filters.navigation import NavigationFilter, NavigationNoise
from estimators.filters.online_base import (
    CHANGE_FIELDS,
    OnlineFilter,
    check_positive,
    filter_range,
    require_plain_plant,
)
from estimators.filters.online_parameter_step import (
    ASSUMPTIONS,
    MEMORY,
    learn_full,
    learn_paper,
    summary,
)
from estimators.filters.protocol import Estimate
from estimators.numerics.bounded import belief_of
from estimators.numerics.unscented import check_alpha
from offroad_env.physics._jit import kernel
from offroad_env.physics.packing import pack
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, plant_model

__all__ = ["CHANGING_SOIL", "OnlineParameterSettings", "OnlineParameterUKF"]

#: Samples of the rim speeds a second [Hz].
_RIM_RATE = WheelSpeedConfig().rate


@dataclass(frozen=True, kw_only=True)
class OnlineParameterSettings:
    """Noise, gains and tests of the filter; each value has its reason here."""

    alpha: float = 1.0  #: sigma points one standard deviation out: they must span the belief
    drift: float = 0.03  #: random walk of eta [1/sqrt(s)]: about 0.007 of n per sqrt(s)
    #: What the model leaves out, per channel (a_x, a_y, yaw_rate) [m/s^2, m/s^2, rad/s].
    error: tuple[float, float, float] = (0.15, 0.3, 0.03)
    error_time: float = 0.3  #: how long such an error lasts [s]
    settle_time: float = 0.5  #: time in which the copies follow their sigma points [s]
    position_gain: float = 5.0  #: pull of position and heading [1/s]: the ground is read in the right place
    speed_gain: float = 4.0  #: pull of forward speed [1/s]: follows in 0.25 s, smooths the fixes
    side_gain: float = 1.0  #: pull of side speed [1/s]: weak, since side slip depends on the soil
    yaw_rate_gain: float = 2.0  #: pull of yaw rate by the gyro [1/s]: weak, as above; stops a copy that spins
    pitch_rate_gain: float = 5.0  #: pull of pitch rate by the gyro [1/s]: roughness that the belief lacks
    hold_speed: float = 1.0  #: below this the copies rest and the estimate holds [m/s]
    least_information: float = 0.02  #: smallest share of the variance that a second must remove [1/s]
    surprise: float = 25.0  #: largest chi-square (3 channels) of the mean innovation for a valid estimate
    #: The same of a rim's speed beyond the vehicle's own [m/s]; infinite: rims are not compared. The paper's
    #: wheels do not spin, so with its model they never are.
    rim_error: float = math.inf

    change_time: float = 0.5  #: fading window of the test for a change of n [s]
    #: Deviation at which n has changed [standard deviations]. They are those of errors that last, far
    #: wider than what a window shows on a constant soil: of 0.7 to 2 the least with no alarm there.
    change_level: float = 1.25
    change_settle: float = 1.0  #: how long the flag stays down after a change: two `settle_time` [s]

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        names = ("drift", "error_time", "settle_time", "hold_speed", "surprise", "rim_error")
        check_positive(self, (*names, *CHANGE_FIELDS))


#: Where the soil is known to change every few tens of metres: eta may move by a standard deviation of the
#: prior in a second, and slip follows n within 0.1 s. A radius known to 1 % and the speed of the navigation
#: filter leave some 0.1 m/s of a rim's speed unknown; twice that, and the level of the test, were chosen on
#: recorded drives over patches: for delay, and for few alarms on soil that rests below another mass.
CHANGING_SOIL = OnlineParameterSettings(
    drift=1.0, settle_time=0.1, rim_error=0.25, change_level=2.5, change_settle=0.2
)


@kernel
def _summary(memories: np.ndarray, assumptions: np.ndarray) -> Estimate:
    return summary(memories[0], assumptions[0])


@kernel
def _learn_full(
    memories: np.ndarray,
    assumptions: np.ndarray,
    waves: FloatArray,
    patches: FloatArray,
    nav: FloatArray,
    imu: FloatArray,
    rims: FloatArray,
    command: tuple[float, float, float],
) -> None:
    learn_full(memories[0], assumptions[0], (waves, patches), nav, (imu, rims), command)


@kernel
def _learn_paper(
    memories: np.ndarray,
    assumptions: np.ndarray,
    waves: FloatArray,
    patches: FloatArray,
    nav: FloatArray,
    imu: FloatArray,
    rims: FloatArray,
    command: tuple[float, float, float],
) -> None:
    learn_paper(memories[0], assumptions[0], (waves, patches), nav, (imu, rims), command)


class OnlineParameterUKF(OnlineFilter):
    """Estimate of the sinkage exponent from commands and sensors (an
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
    imu : ImuConfig, optional
        How the inertial unit is mounted, what it measures and how noisy it is, as far as known.
    gnss : GnssConfig, optional
        The receiver, for the navigation filter.
    settings : OnlineParameterSettings, optional
    navigation : NavigationFilter, optional
        Somebody else's, who keeps it up to date: then it is only read here. Default: one of its own.

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
        settings: OnlineParameterSettings | None = None,
        navigation: NavigationFilter | None = None,
    ) -> None:
        require_plain_plant(plant)
        noise = NavigationNoise.of(gnss, imu)
        super().__init__(
            plant, n_range, dt=dt, navigation=navigation, navigates=navigation is None, noise=noise
        )
        self.settings = settings or OnlineParameterSettings()
        packed = pack(plant)
        self._map = (packed.waves, packed.patches)
        self._kernel = _learn_full if plant_model(plant) == "full" else _learn_paper
        self.assumptions = np.zeros(1, ASSUMPTIONS)
        self._assume(packed.numbers, imu or ImuConfig())
        self.memory = np.zeros(1, MEMORY)
        self._start()

    def __getstate__(self) -> dict[str, Any]:
        """Without the compiled function, which a checkpoint of training cannot hold."""
        return {name: value for name, value in vars(self).items() if name != "_kernel"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._kernel = _learn_full if plant_model(self.plant) == "full" else _learn_paper

    def _assume(self, numbers: FloatArray, imu: ImuConfig) -> None:
        s, assumed = self.settings, self.assumptions[0]
        sensor = np.array([imu.accel_noise, imu.accel_noise, imu.gyro_noise])
        mount, vehicle = imu.mount(), self.plant.vehicle
        assumed["plant"], assumed["lags"] = numbers, (vehicle.steer_lag, vehicle.torque_lag)
        assumed["lever"], assumed["rotation"] = mount.lever, mount.rotation
        assumed["mount"] = mount.body_axes, mount.gravity
        assumed["low"], assumed["high"] = self.n_range
        assumed["bounds"] = filter_range(self.n_range)
        assumed["R"] = sensor**2 + np.square(s.error) * 2.0 * s.error_time / self.dt
        for name in (
            *("alpha", "position_gain", "speed_gain", "side_gain", "yaw_rate_gain", "pitch_rate_gain"),
            *("hold_speed", "least_information", "settle_time", "drift", "surprise", *CHANGE_FIELDS),
        ):
            assumed[name] = getattr(s, name)
        assumed["radius"] = vehicle.r
        rim_error = s.rim_error if plant_model(self.plant) == "full" else math.inf
        assumed["rim_variance"] = rim_error**2 * 2.0 * s.error_time * _RIM_RATE
        assumed["dt"] = self.dt

    def lodge(self, memory: np.ndarray) -> None:
        """From now on keep the memory in the first record of ``memory`` (1,), of the type `MEMORY`."""
        memory[0] = self.memory[0]
        self.memory = memory

    def _restart(self, n_prior: float, sd: float) -> None:
        self.memory[0] = np.zeros((), MEMORY)
        self.memory["belief"][0] = belief_of(n_prior, sd, *self.assumptions["bounds"][0].tolist())
        self.memory["last"][0] = self.memory["nis"][0] = math.nan

    def _update(
        self,
        command: tuple[float, float, float],
        imu: FloatArray,
        rim_speeds: FloatArray,
        gnss: FloatArray,
    ) -> None:
        nav = self.navigation.x
        self._kernel(self.memory, self.assumptions, *self._map, nav, imu, rim_speeds, command)

    @property
    def estimate(self) -> Estimate:
        """The present estimate."""
        return _summary(self.memory, self.assumptions)

    @property
    def held(self) -> bool:
        """Whether the last sample left n as it was."""
        return bool(self.memory["held"][0] > 0.5)

    @property
    def changes(self) -> int:
        """How many changes of n it has detected since the reset."""
        return int(self.memory["changes"][0])
