"""Navigation: pose and speed from the sensors, by a small compiled extended Kalman filter.

Gyro and accelerometers propagate the state from sample to sample; GNSS position and velocity
correct it, and wheel speed where GNSS is missing. Nothing of the soil enters, so the filter works
on any ground:

- side slip is a state of its own, driven by the lateral accelerometer, since on soil a vehicle does
  not travel where it points;
- the wheels' rim speed is v + creep, and the creep a state of its own that wanders and fades:
  wheels that spin or lock change the creep, not the speed;
- wheels that point straight ahead drive about straight ahead: over minutes this holds the gyro's
  bias where GNSS is missing;
- the accelerometer's bias wanders, which absorbs gravity along a slope; that of the lateral one is constant,
  where the unit has one at all: a side speed that it feigns is a heading that is wrong;
- a fix tells of the time at which it was taken, as far as the receiver's latency is known: at 10 m/s one
  that is 0.1 s old is a metre behind.
"""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass

import numpy as np

from estimators.filters.protocol import Pose
from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.imu import A_X, A_Y, YAW_RATE
from offroad_env.physics.numerics import all_finite
from offroad_env.physics.records import FloatArray, Vehicle
from offroad_env.simulation.sensor_configs import GnssConfig, ImuConfig

__all__ = ["NavigationFilter", "NavigationNoise", "expected_fix", "navigate"]

# State of the filter: [m, m, rad, m/s, m/s, rad/s, m/s^2, m/s, m/s^2].
(X, Y, YAW, V, V_SIDE, GYRO_BIAS, ACCEL_BIAS, CREEP, SIDE_BIAS) = range(9)
SIZE = 9
# A fix of GNSS.
(_FIX_X, _FIX_Y, _SPEED, _COURSE) = range(4)  # [m, m, m/s, rad]
# Its noise as the kernels take it, the fields of `NavigationNoise`.
(_ACCELEROMETER, _GYRO, _GNSS_POSITION, _GNSS_VELOCITY, _WHEEL_SPEED, _CREEP_WALK, _CREEP_TIME) = range(7)
(_ACCEL_BIAS_WALK, _GYRO_BIAS_WALK, _SIDE_WALK, _SIDE_SLIP, _GNSS_LATENCY) = range(7, 12)
#: Scale error of the rim speeds [-]: a tyre's radius.
_RIM_SCALE = 0.01
#: Standard deviations of the start: position [m], heading [rad], speeds [m/s], biases of gyro [rad/s] and
#: accelerometer [m/s^2], creep [m/s]; of the lateral accelerometer's bias it is a setting.
_START = (0.1, 0.1, 0.02, 0.3, 0.2, 0.01, 0.3, 1.0, 0.0)
#: Random walks of speed [m/s/sqrt(s)] and heading [rad/sqrt(s)] where the inertial unit has no sample.
_UNSEEN_SPEED, _UNSEEN_YAW = 1.5, 0.2
_START_COVARIANCE = np.diag(np.square(_START))


@dataclass(frozen=True, kw_only=True)
class NavigationNoise:
    """Standard deviations of the sensors' noise and of what the model leaves out, and the age of a fix."""

    accelerometer: float = 0.2  #: per sample [m/s^2] (the paper's)
    gyro: float = 0.0175  #: per sample [rad/s] (the paper's)
    gnss_position: float = 0.05  #: RTK fix and the time since it was taken [m]
    gnss_velocity: float = 0.05  #: each component [m/s]
    wheel_speed: float = 0.1  #: sensor, scale error at walking pace [m/s]
    creep_walk: float = 1.0  #: random walk of rim speed over ground speed [m/s/sqrt(s)]
    creep_time: float = 2.0  #: in which creep fades [s]; with the walk: 1 m/s where nothing else is known
    accel_bias_walk: float = 0.3  #: random walk of the accelerometer bias [m/s^2/sqrt(s)]: rolling ground
    gyro_bias_walk: float = 1e-4  #: random walk of the gyro bias [rad/s/sqrt(s)]
    side_walk: float = 0.05  #: random walk of side speed [m/s/sqrt(s)]: cross slopes
    side_slip: float = 0.7  #: weight of "the axles slip little", per sample [rad], see `_correct_side`
    gnss_latency: float = 0.0  #: age of a fix when it arrives [s]
    side_bias: float = 0.0  #: bias of the lateral accelerometer, gravity by its mounting included [m/s^2]

    @classmethod
    def of(cls, gnss: GnssConfig | None, imu: ImuConfig | None = None) -> NavigationNoise:
        """Noise and latency of this receiver, and the lateral bias of this unit.

        Correlated errors of a fix count as white ones.
        """
        bias = 0.0 if imu is None else _side_bias(imu)
        if gnss is None:
            return cls(side_bias=bias)
        position, velocity = (
            max(cls.gnss_position, gnss.total_position_sd),
            max(cls.gnss_velocity, gnss.velocity_sd),
        )
        return cls(gnss_position=position, gnss_velocity=velocity, gnss_latency=gnss.latency, side_bias=bias)

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name == "gnss_latency":
                if not 0.0 <= value <= 1.0:
                    raise InvalidParameter(f"gnss_latency must be in [0, 1] s, got {value} - in ms?")
            elif name == "side_bias":
                if not 0.0 <= value < math.inf:
                    raise InvalidParameter(f"side_bias must be 0 or more, got {value}")
            elif not value > 0.0:
                raise InvalidParameter(
                    f"{name} must be > 0, got {value} - a filter needs some noise everywhere"
                )


def _side_bias(imu: ImuConfig) -> float:
    """Standard deviation of the lateral accelerometer's error that lasts [m/s^2]."""
    tilt = imu.misalignment_sd[0] * imu.mount().gravity
    return math.hypot(imu.accel_bias_sd, tilt)


@kernel
def _correct(x: FloatArray, P: FloatArray, row: FloatArray, residual: float, variance: float) -> None:
    """Scalar Kalman update with measurement row (9,), in place; P stays symmetric by construction."""
    size = x.shape[0]
    gain = np.zeros(size)
    total = variance
    for i in range(size):
        if row[i] != 0.0:
            for j in range(size):
                gain[j] += P[j, i] * row[i]
    for i in range(size):
        total += row[i] * gain[i]
    for i in range(size):
        x[i] += gain[i] * residual / total
        for j in range(i + 1):
            P[i, j] -= gain[i] * gain[j] / total
            P[j, i] = P[i, j]


@kernel
def _predict(x: FloatArray, P: FloatArray, imu: FloatArray, noise: FloatArray, dt: float) -> None:
    """Carry state and covariance over ``dt`` by gyro and accelerometers, in place."""
    accelerometer, gyro, creep_time = noise[_ACCELEROMETER], noise[_GYRO], noise[_CREEP_TIME]
    cos, sin = math.cos(x[YAW]), math.sin(x[YAW])
    v, side = x[V], x[V_SIDE]
    rate, along = imu[YAW_RATE] - x[GYRO_BIAS], imu[A_X] - x[ACCEL_BIAS]
    F = np.zeros((SIZE, SIZE))
    for i in range(SIZE):
        F[i, i] = 1.0
    F[X, YAW], F[X, V], F[X, V_SIDE] = -dt * (v * sin + side * cos), dt * cos, -dt * sin
    F[Y, YAW], F[Y, V], F[Y, V_SIDE] = dt * (v * cos - side * sin), dt * sin, dt * cos
    F[YAW, GYRO_BIAS] = -dt
    F[V, V_SIDE], F[V, GYRO_BIAS], F[V, ACCEL_BIAS] = dt * rate, -dt * side, -dt
    F[V_SIDE, V], F[V_SIDE, GYRO_BIAS], F[V_SIDE, SIDE_BIAS] = -dt * rate, dt * v, -dt
    F[CREEP, CREEP] = 1.0 - dt / creep_time
    x[X] += dt * (v * cos - side * sin)
    x[Y] += dt * (v * sin + side * cos)
    x[YAW] += dt * rate
    x[V] += dt * (along + side * rate)
    x[V_SIDE] += dt * (imu[A_Y] - x[SIDE_BIAS] - v * rate)
    x[CREEP] *= 1.0 - dt / creep_time
    FP = np.zeros((SIZE, SIZE))
    for i in range(SIZE):
        for k in range(SIZE):
            if F[i, k] != 0.0:
                for j in range(SIZE):
                    FP[i, j] += F[i, k] * P[k, j]
    for i in range(SIZE):
        for j in range(i + 1):
            total = 0.0
            for k in range(SIZE):
                total += FP[i, k] * F[j, k]
            P[i, j] = P[j, i] = total
    P[YAW, YAW] += (gyro * dt) ** 2
    P[V, V] += (accelerometer * dt) ** 2
    P[V_SIDE, V_SIDE] += ((accelerometer * dt) ** 2 + (gyro * dt * v) ** 2) + noise[_SIDE_WALK] ** 2 * dt
    P[GYRO_BIAS, GYRO_BIAS] += noise[_GYRO_BIAS_WALK] ** 2 * dt
    P[ACCEL_BIAS, ACCEL_BIAS] += noise[_ACCEL_BIAS_WALK] ** 2 * dt
    P[CREEP, CREEP] += noise[_CREEP_WALK] ** 2 * dt


@inline_kernel
def _heading(x: FloatArray, axis: int) -> tuple[float, float]:
    """What a vector forward, and one to the left, has towards X (``axis`` 0) or Y (1)."""
    cos, sin = math.cos(x[YAW]), math.sin(x[YAW])
    return (cos, -sin) if axis == 0 else (sin, cos)


@inline_kernel
def _turned(vector: tuple[float, float], axis: int) -> float:
    """Derivative of a component of a vector that turns with the vehicle, by the heading."""
    return -vector[1] if axis == 0 else vector[0]


@inline_kernel
def _velocity(x: FloatArray) -> tuple[float, float]:
    """Towards X and Y [m/s]."""
    cos, sin = math.cos(x[YAW]), math.sin(x[YAW])
    return x[V] * cos - x[V_SIDE] * sin, x[V] * sin + x[V_SIDE] * cos


@inline_kernel
def _acceleration(x: FloatArray, imu: FloatArray) -> tuple[float, float]:
    """Towards X and Y [m/s^2]; zero where it was not measured."""
    if not (math.isfinite(imu[A_X]) and math.isfinite(imu[A_Y])):
        return 0.0, 0.0
    cos, sin = math.cos(x[YAW]), math.sin(x[YAW])
    along, side = imu[A_X] - x[ACCEL_BIAS], imu[A_Y] - x[SIDE_BIAS]
    return along * cos - side * sin, along * sin + side * cos


@kernel
def expected_fix(x: FloatArray, imu: FloatArray, age: float, k: int, row: FloatArray) -> float:
    """Number ``k`` of a fix (X, Y, velocity towards X, Y) of ``age`` [s], and its derivatives ``row`` (9,).

    Since the fix was taken velocity and acceleration are what they are now.
    """
    axis = k % 2
    v, a, (forward, aside) = _velocity(x), _acceleration(x, imu), _heading(x, axis)
    row[:] = 0.0
    if k < 2:
        row[X + axis] = 1.0
        row[YAW], row[V], row[V_SIDE] = -age * _turned(v, axis), -age * forward, -age * aside
        then: float = x[X + axis] - age * v[axis] + 0.5 * age * age * a[axis]
        return then
    row[YAW], row[V], row[V_SIDE] = _turned(v, axis) - age * _turned(a, axis), forward, aside
    row[ACCEL_BIAS], row[SIDE_BIAS] = age * forward, age * aside
    return v[axis] - age * a[axis]


@kernel
def _correct_gnss(x: FloatArray, P: FloatArray, gnss: FloatArray, imu: FloatArray, noise: FloatArray) -> None:
    """Position, and the velocity vector that speed and course stand for, when the fix was taken."""
    place, velocity = noise[_GNSS_POSITION] ** 2, noise[_GNSS_VELOCITY] ** 2
    speed, course = gnss[_SPEED], gnss[_COURSE]
    measured = gnss[_FIX_X], gnss[_FIX_Y], speed * math.cos(course), speed * math.sin(course)
    row = np.zeros(SIZE)
    for k in range(4):
        expected = expected_fix(x, imu, noise[_GNSS_LATENCY], k, row)
        _correct(x, P, row, measured[k] - expected, place if k < 2 else velocity)


@kernel
def _correct_wheels(x: FloatArray, P: FloatArray, rim_speeds: FloatArray, noise: FloatArray) -> None:
    """Mean rim speed = v + creep."""
    row = np.zeros(SIZE)
    row[V] = row[CREEP] = 1.0
    rim = 0.5 * (rim_speeds[0] + rim_speeds[1])
    _correct(x, P, row, rim - x[V] - x[CREEP], noise[_WHEEL_SPEED] ** 2 + (_RIM_SCALE * rim) ** 2)


@kernel
def _correct_side(
    x: FloatArray, P: FloatArray, gyro: float, steer: float, axles: FloatArray, noise: FloatArray
) -> None:
    """The axles slip little: side speed near l_r yaw_rate, yaw rate near v tan(steer)/L.

    A slip angle of 0.05 rad that lasts a second is a hundred samples with one error, so each of
    them counts with 0.05 sqrt(2 100) = 0.7 rad.
    """
    l_f, l_r = axles[0], axles[1]
    speed, slip = abs(x[V]) + 1.0, noise[_SIDE_SLIP]
    row = np.zeros(SIZE)
    row[V_SIDE] = 1.0
    _correct(x, P, row, l_r * (gyro - x[GYRO_BIAS]) - x[V_SIDE], (slip * speed) ** 2)
    row[V_SIDE], row[GYRO_BIAS] = 0.0, 1.0
    turn = x[V] * math.tan(steer) / (l_f + l_r)
    sd = 2.0 * slip * speed * (0.1 + abs(math.tan(steer))) / (l_f + l_r)
    _correct(x, P, row, gyro - turn - x[GYRO_BIAS], sd**2)


@kernel
def _coast(
    x: FloatArray, P: FloatArray, steer: float, axles: FloatArray, noise: FloatArray, dt: float
) -> None:
    """Carry state and covariance over ``dt`` without the inertial unit: the speeds stay, the wheels steer."""
    rate = x[V] * math.tan(steer) / (axles[0] + axles[1])
    imu, wide = np.zeros(5), noise.copy()
    imu[YAW_RATE] = x[GYRO_BIAS] + rate
    imu[A_X], imu[A_Y] = x[ACCEL_BIAS] - x[V_SIDE] * rate, x[SIDE_BIAS] + x[V] * rate
    wide[_ACCELEROMETER], wide[_GYRO] = _UNSEEN_SPEED / math.sqrt(dt), _UNSEEN_YAW / math.sqrt(dt)
    _predict(x, P, imu, wide, dt)


@kernel
def navigate(
    belief: tuple[FloatArray, FloatArray],
    sensors: tuple[FloatArray, FloatArray, FloatArray],
    steer: float,
    axles: FloatArray,
    noise: FloatArray,
    dt: float,
) -> None:
    """One sample of all sensors; ``belief`` = (x (9,), P (9, 9)), in place.

    ``sensors`` = (imu, rim_speeds, gnss), where NaN marks what was not measured; ``axles`` = (l_f, l_r);
    ``noise`` (13,) are the fields of `NavigationNoise`.
    """
    x, P = belief
    imu, rim_speeds, gnss = sensors
    if all_finite(imu):
        _predict(x, P, imu, noise, dt)
        _correct_side(x, P, imu[YAW_RATE], steer, axles, noise)
    else:
        _coast(x, P, steer, axles, noise, dt)
    if all_finite(rim_speeds):
        _correct_wheels(x, P, rim_speeds, noise)
    if all_finite(gnss):
        _correct_gnss(x, P, gnss, imu, noise)


class NavigationFilter:
    """Pose and speed from IMU, wheel speed and GNSS.

    Parameters
    ----------
    vehicle : Vehicle
        Only its geometry is used.
    noise : NavigationNoise, optional

    Examples
    --------
    >>> filter = NavigationFilter(VEHICLES["mrzr"])
    >>> filter.reset(0.0, 0.0, 0.0, 3.0)
    >>> pose = filter.update(imu, rim_speeds, steer, gnss, 0.01)
    """

    def __init__(self, vehicle: Vehicle, noise: NavigationNoise | None = None) -> None:
        self.noise = noise or NavigationNoise()
        #: Noise and axle distances as the kernels take them.
        self.constants = np.array(astuple(self.noise))
        self.axles = np.array([vehicle.l_f, vehicle.l_r])
        self.x, self.P = np.zeros(SIZE), np.eye(SIZE)

    def reset(self, x: float, y: float, yaw: float, v: float) -> Pose:
        """Start at a pose that is known to 0.1 m, 0.02 rad and 0.3 m/s.

        Raises
        ------
        InvalidParameter
            For a pose that is not finite.
        """
        if not all(map(math.isfinite, (x, y, yaw, v))):
            raise InvalidParameter(f"the start must be finite, got {(x, y, yaw, v)}")
        self.x[:] = 0.0
        self.x[:4] = x, y, yaw, v
        self.P[:] = _START_COVARIANCE
        self.P[SIDE_BIAS, SIDE_BIAS] = self.noise.side_bias**2
        return self.pose

    def update(
        self, imu: FloatArray, rim_speeds: FloatArray, steer: float, gnss: FloatArray, dt: float
    ) -> Pose:
        """Take in one sample.

        Parameters
        ----------
        imu : array (5,)
            a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s].
        rim_speeds : array (2,)
            r omega front, rear [m/s]; NaN when not measured.
        steer : float
            Road-wheel angle that was commanded [rad].
        gnss : array (4,)
            X, Y [m], speed [m/s], course [rad]; NaN when not measured.
        dt : float
            Time since the last sample [s].

        Returns
        -------
        Pose
            Heading unwrapped: it counts turns.
        """
        navigate((self.x, self.P), (imu, rim_speeds, gnss), steer, self.axles, self.constants, dt)
        return self.pose

    def lodge(self, x: FloatArray, P: FloatArray) -> None:
        """From now on keep the belief in these arrays (9,), (9, 9)."""
        x[:], P[:] = self.x, self.P
        self.x, self.P = x, P

    @property
    def pose(self) -> Pose:
        """Position, heading and forward speed."""
        return Pose(float(self.x[X]), float(self.x[Y]), float(self.x[YAW]), float(self.x[V]))

    @property
    def side_speed(self) -> float:
        """Speed to the left [m/s]."""
        return float(self.x[V_SIDE])

    @property
    def gyro_bias(self) -> float:
        """Of the yaw gyro [rad/s]."""
        return float(self.x[GYRO_BIAS])
