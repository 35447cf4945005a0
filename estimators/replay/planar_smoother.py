"""Fixed-interval smoother of a vehicle's horizontal motion from the logged sensors, without any model of it.

The accelerometers and the gyros drive the kinematics, position and speed of the satellite receiver correct
them, and the pass of Rauch, Tung & Striebel (AIAA J. 3 (1965), 1445-1450) takes the later samples into
account. No law of wheels or soil enters, so it favours none of the structures that start from it, and no
reference column is read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.logs.clocks import pose_age
from estimators.logs.log import Log
from estimators.logs.signals import noise_sd, unwrapped
from estimators.numerics.small_matrices import multiply, multiply_transposed, solve_in_place
from estimators.replay.channel_smoother import SmoothChannel, smooth_channel
from offroad_env.errors import DataError
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["PlanarMotion", "smooth_motion"]

#: States: position [m], heading [rad], velocity in heading axes [m/s], pitch and roll [rad], offsets of the
#: accelerometers [m/s^2] and of the yaw gyro [rad/s].
(X, Y, YAW, V_X, V_Y, PITCH, ROLL, B_X, B_Y, B_YAW) = range(10)
_SIZE = 10
#: Standard deviations at the start, the heading known from the way travelled.
_START = np.array([3.0, 3.0, 0.3, 2.0, 0.5, 0.05, 0.05, 0.05, 0.05, 0.003])
#: Random walk of the offsets [m/s^2, rad/s per root second]: that of automotive sensors.
_DRIFT_A, _DRIFT_YAW = 2e-3, 5e-5
#: Pitch and roll stay about the level; this is all that is known of them where the IMU does not feel gravity,
#: and all that the roll is known by without its gyro [rad, per root second].
_LEVEL, _ROLL_WALK = 0.1, 0.05
#: Noise where a log states none: speed [m/s], heading [rad].
_SPEED_SD, _YAW_SD = 0.1, 0.02
#: Slip that a wheel speed may have where no other sensor measures the speed [-].
_SLIP_SD = 0.05
#: Least speed at which a course means something, and way by which a heading is first known [m/s, m].
_COURSE_SPEED, _WAY = 1.0, 1.0
#: Passes: the second is linearised along the first.
_PASSES = 2

#: Kinds of measurement; the first five are states.
(AT_X, AT_Y, AT_YAW, AT_V_X, AT_V_Y, AT_SPEED, AT_COURSE) = range(7)
_KINDS = {
    "x": AT_X,
    "y": AT_Y,
    "yaw": AT_YAW,
    "v_x": AT_V_X,
    "v_y": AT_V_Y,
    "speed": AT_SPEED,
    "course": AT_COURSE,
}


@dataclass(frozen=True, kw_only=True)
class PlanarMotion:
    """Smoothed motion on a grid of instants."""

    t: np.ndarray  #: (K,) [s]
    states: np.ndarray  #: (K, 10) x, y, yaw, v_x, v_y, pitch, roll, offsets of a_x, a_y and the yaw gyro
    sd: np.ndarray  #: (K, 10) standard deviations
    yaw_rate: np.ndarray  #: (K,) [rad/s]
    a_y: np.ndarray  #: (K,) acceleration of the CG to the left, level [m/s^2]
    omega_f: np.ndarray  #: (K,) wheel speed [rad/s]; NaN without the sensor
    omega_r: np.ndarray  #: (K,)
    yaw_rate_sd: np.ndarray  #: (K,) standard deviations of these channels
    a_y_sd: np.ndarray  #: (K,)
    omega_f_sd: np.ndarray  #: (K,)
    omega_r_sd: np.ndarray  #: (K,)

    @property
    def step(self) -> float:
        """Time between instants [s]."""
        return float(self.t[1] - self.t[0])


class Drive(NamedTuple):
    """What drives the kinematics, a row per instant; the sensors' offsets are still in it."""

    a: FloatArray  #: (K, 3) acceleration of the CG, body axes [m/s^2]
    rates: FloatArray  #: (K, 3) roll, pitch and yaw rate [rad/s]
    step: float  #: [s]
    Q: FloatArray  #: (10,) variances of the process noise of a step


class Readings(NamedTuple):
    """Measurements in the order of time."""

    instant: np.ndarray  #: (M,) index of the nearest instant
    later: FloatArray  #: (M,) time after that instant [s]
    kind: np.ndarray  #: (M,)
    value: FloatArray  #: (M,)
    sd: FloatArray  #: (M,)


class Pass(NamedTuple):
    """What the forward pass leaves for the backward one, a row per instant."""

    means: FloatArray  #: (K, 10) filtered, then smoothed
    covs: FloatArray  #: (K, 10, 10)
    ahead: FloatArray  #: (K, 10) predicted
    ahead_covs: FloatArray  #: (K, 10, 10)
    slopes: FloatArray  #: (K, 10, 10) of the motion from the instant before


@kernel
def _level(x: FloatArray, a: FloatArray) -> tuple[float, float]:
    """Acceleration forward and to the left, level; alike whether the sensor feels gravity or not."""
    sin, cos = math.sin(x[ROLL]), math.cos(x[ROLL])
    up = sin * a[1] + cos * a[2]
    forward = math.cos(x[PITCH]) * a[0] - math.sin(x[PITCH]) * up - x[B_X]
    return forward, cos * a[1] - sin * a[2] - x[B_Y]


@kernel
def _turning(x: FloatArray, rates: FloatArray) -> tuple[float, float, float]:
    """Rates of roll, pitch (nose up) and heading [rad/s] from the gyros, whose axes move with the body.

    The rates of Euler's angles in the order heading, pitch, roll.
    """
    sin, cos = math.sin(x[ROLL]), math.cos(x[ROLL])
    body_yaw = rates[2] - x[B_YAW]
    heading = (cos * body_yaw - sin * rates[1]) / math.cos(x[PITCH])
    return rates[0] - heading * math.sin(x[PITCH]), cos * rates[1] + sin * body_yaw, heading


@kernel
def _advance(x: FloatArray, a: FloatArray, rates: FloatArray, h: float, out: FloatArray) -> None:
    """Kinematics over ``h`` [s] under mean accelerations (3,) and rates (3,)."""
    roll_rate, pitch_rate, rate = _turning(x, rates)
    forward, left = _level(x, a)
    # Half of the velocity change before the turn, half after it: of second order, and exact at rest.
    u, w = x[V_X] + 0.5 * h * forward, x[V_Y] + 0.5 * h * left
    sin, cos = math.sin(rate * h), math.cos(rate * h)
    for i in range(_SIZE):
        out[i] = x[i]
    out[V_X] = cos * u + sin * w + 0.5 * h * forward
    out[V_Y] = cos * w - sin * u + 0.5 * h * left
    out[YAW] = x[YAW] + h * rate
    sin, cos = math.sin(x[YAW]), math.cos(x[YAW])
    sin_2, cos_2 = math.sin(out[YAW]), math.cos(out[YAW])
    out[X] += 0.5 * h * (cos * x[V_X] - sin * x[V_Y] + cos_2 * out[V_X] - sin_2 * out[V_Y])
    out[Y] += 0.5 * h * (sin * x[V_X] + cos * x[V_Y] + sin_2 * out[V_X] + cos_2 * out[V_Y])
    out[PITCH] = x[PITCH] + h * pitch_rate
    out[ROLL] = x[ROLL] + h * roll_rate


@kernel
def _heading_rows(states: FloatArray, drive: Drive) -> tuple[FloatArray, FloatArray]:
    """Rate of the heading [rad/s] and acceleration to the left, level [m/s^2], at every instant."""
    rate, left = np.empty(states.shape[0]), np.empty(states.shape[0])
    for k in range(states.shape[0]):
        _, _, rate[k] = _turning(states[k], drive.rates[k])
        _, left[k] = _level(states[k], drive.a[k])
    return rate, left


@kernel
def _measured(x: FloatArray, kind: int) -> float:
    """Reading of a sensor of this kind."""
    if kind == AT_SPEED:
        speed: float = math.hypot(x[V_X], x[V_Y])
        return speed
    if kind == AT_COURSE:
        course: float = x[YAW] + math.atan2(x[V_Y], x[V_X])
        return course
    state: float = x[kind]
    return state


@kernel
def _slopes(x: FloatArray, a: FloatArray, rates: FloatArray, h: float, F: FloatArray) -> None:
    """Jacobian (10, 10) of `_advance` by central differences: the kinematics is smooth and of order one."""
    high, low = np.empty(_SIZE), np.empty(_SIZE)
    for j in range(_SIZE):
        kept = x[j]
        x[j] = kept + 1e-5
        _advance(x, a, rates, h, high)
        x[j] = kept - 1e-5
        _advance(x, a, rates, h, low)
        x[j] = kept
        for i in range(_SIZE):
            F[i, j] = (high[i] - low[i]) / 2e-5


@kernel
def _update(mean: FloatArray, P: FloatArray, H: FloatArray, innovation: float, variance: float) -> None:
    """Kalman update by one number, in place; covariance in Joseph's form (I - g H) P (I - g H)' + r g g'."""
    gain, row, half = np.empty(_SIZE), np.empty(_SIZE), np.empty(_SIZE)
    total = variance
    for i in range(_SIZE):
        gain[i] = row[i] = 0.0
        for j in range(_SIZE):
            gain[i] += P[i, j] * H[j]
            row[i] += H[j] * P[j, i]
        total += H[i] * gain[i]
    for i in range(_SIZE):
        gain[i] /= total
        mean[i] += gain[i] * innovation
    for i in range(_SIZE):
        half[i] = 0.0
        for j in range(_SIZE):
            P[i, j] -= gain[i] * row[j]
            half[i] += P[i, j] * H[j]
    for i in range(_SIZE):
        for j in range(_SIZE):
            P[i, j] += (variance * gain[i] - half[i]) * gain[j]


@kernel
def _take(
    mean: FloatArray, P: FloatArray, point: FloatArray, drive: Drive, readings: Readings, m: int
) -> None:
    """Update by measurement ``m``, linearised at ``point``."""
    k, h = readings.instant[m], readings.later[m]
    a, rates = drive.a[k], drive.rates[k]
    kind, H, moved = readings.kind[m], np.zeros(_SIZE), np.empty(_SIZE)
    _advance(point, a, rates, h, moved)
    base = _measured(moved, kind)
    for j in range(_SIZE):
        kept = point[j]
        point[j] = kept + 1e-5
        _advance(point, a, rates, h, moved)
        point[j] = kept
        H[j] = (_measured(moved, kind) - base) / 1e-5
    innovation = readings.value[m] - base
    for j in range(_SIZE):
        innovation -= H[j] * (mean[j] - point[j])
    if kind in (AT_YAW, AT_COURSE):
        innovation = (innovation + math.pi) % (2.0 * math.pi) - math.pi
    _update(mean, P, H, innovation, readings.sd[m] ** 2)


@kernel
def _predict(
    mean: FloatArray, P: FloatArray, point: FloatArray, drive: Drive, k: int, F: FloatArray, work: FloatArray
) -> None:
    """From the instant before ``k`` to it, linearised at ``point``; the Jacobian into ``F`` (10, 10)."""
    a, rates = np.empty(3), np.empty(3)
    for i in range(3):
        a[i] = 0.5 * (drive.a[k - 1, i] + drive.a[k, i])
        rates[i] = 0.5 * (drive.rates[k - 1, i] + drive.rates[k, i])
    _slopes(point, a, rates, drive.step, F)
    moved = np.empty(_SIZE)
    _advance(point, a, rates, drive.step, moved)
    for i in range(_SIZE):
        for j in range(_SIZE):
            moved[i] += F[i, j] * (mean[j] - point[j])
    for i in range(_SIZE):
        mean[i] = moved[i]
    multiply(F, P, work)
    multiply_transposed(work, F, P)
    for i in range(_SIZE):
        P[i, i] += drive.Q[i]


@kernel
def _keep(mean: FloatArray, P: FloatArray, k: int, means: FloatArray, covs: FloatArray) -> None:
    """Mean and covariance into row ``k``."""
    for i in range(_SIZE):
        means[k, i] = mean[i]
        for j in range(_SIZE):
            covs[k, i, j] = P[i, j]


@kernel
def _look_from(mean: FloatArray, guess: FloatArray, k: int, point: FloatArray) -> None:
    """The point of linearisation at the instant ``k``: of ``guess``, or the mean where that is empty."""
    for i in range(_SIZE):
        point[i] = guess[k, i] if guess.shape[0] > 0 else mean[i]


@kernel
def _forward(
    start: FloatArray, P_0: FloatArray, drive: Drive, readings: Readings, guess: FloatArray, done: Pass
) -> None:
    """Kalman filter linearised along ``guess`` (K, 10), or along itself where that is empty."""
    mean, P, work = start.copy(), P_0.copy(), np.empty((_SIZE, _SIZE))
    point, level = np.empty(_SIZE), np.zeros(_SIZE)
    m = 0
    for k in range(done.means.shape[0]):
        if k > 0:
            _look_from(mean, guess, k - 1, point)
            _predict(mean, P, point, drive, k, done.slopes[k], work)
        _keep(mean, P, k, done.ahead, done.ahead_covs)
        while m < readings.instant.shape[0] and readings.instant[m] == k:
            _look_from(mean, guess, k, point)
            _take(mean, P, point, drive, readings, m)
            m += 1
        for i in (PITCH, ROLL):
            level[i] = 1.0
            # Once a second in all.
            _update(mean, P, level, -mean[i], _LEVEL**2 / drive.step)
            level[i] = 0.0
        _keep(mean, P, k, done.means, done.covs)


@kernel
def _gain(slopes: FloatArray, cov: FloatArray, ahead: FloatArray, scaled: FloatArray, G: FloatArray) -> None:
    """Transposed gain of the smoother: the solution of ahead G = slopes cov, into ``G``.

    Unit diagonal first: positions and offsets differ by orders of magnitude.
    """
    multiply(slopes, cov, G)
    for i in range(_SIZE):
        scale = math.sqrt(ahead[i, i])
        for j in range(_SIZE):
            G[i, j] /= scale
            scaled[i, j] = ahead[i, j] / scale / math.sqrt(ahead[j, j])
    solve_in_place(scaled, G)
    for i in range(_SIZE):
        for j in range(_SIZE):
            G[i, j] /= math.sqrt(ahead[i, i])


@kernel
def _backward(done: Pass) -> None:
    """Pass of Rauch, Tung & Striebel: filtered becomes smoothed, in place."""
    means, covs = done.means, done.covs
    G, late, work = np.empty((_SIZE, _SIZE)), np.empty((_SIZE, _SIZE)), np.empty((_SIZE, _SIZE))
    for back in range(means.shape[0] - 1):
        k = means.shape[0] - 2 - back
        _gain(done.slopes[k + 1], covs[k], done.ahead_covs[k + 1], work, G)
        for i in range(_SIZE):
            for j in range(_SIZE):
                means[k, i] += G[j, i] * (means[k + 1, j] - done.ahead[k + 1, j])
                late[i, j] = covs[k + 1, i, j] - done.ahead_covs[k + 1, i, j]
        multiply(late, G, work)
        for i in range(_SIZE):
            for j in range(_SIZE):
                for h in range(_SIZE):
                    covs[k, i, j] += G[h, i] * work[h, j]
        for i in range(_SIZE):
            for j in range(i):
                covs[k, i, j] = covs[k, j, i] = 0.5 * (covs[k, i, j] + covs[k, j, i])


def _on_grid(log: Log, name: str, t: np.ndarray) -> np.ndarray:
    """A channel at the instants ``t`` (K,), straight between its samples."""
    times, values = log.samples(name)
    return np.asarray(np.interp(t, times, values))


def _smooth(log: Log, name: str, t: np.ndarray, sd: float | None = None) -> SmoothChannel:
    """A channel without its noise; one of a lower rate has its samples at the nearest instants."""
    times, values = log.samples(name)
    step = float(t[1] - t[0])
    if sd is None:
        sd = noise_sd(values)
    if len(times) < 2 or float(np.median(np.diff(times))) < 1.5 * step:
        return smooth_channel(_on_grid(log, name, t), step, sd)
    rows = np.full(len(t), np.nan)
    nearest = np.rint((times - t[0]) / step).astype(int)
    inside = (nearest >= 0) & (nearest < len(t))
    rows[nearest[inside]] = values[inside]
    return smooth_channel(rows, step, sd)


def _drive_of(log: Log, t: np.ndarray, yaw: SmoothChannel) -> Drive:
    """Accelerations at the CG and rates."""
    step, (x, y, z) = float(t[1] - t[0]), log.imu.position
    a = np.stack([_on_grid(log, name, t) for name in ("a_x", "a_y", "a_z")], axis=1)
    pitch = _smooth(log, "pitch_rate", t, log.imu.sd_rate)
    known_roll = "roll_rate" in log.channels
    r, p = yaw.value, pitch.value
    # A body without roll still turns about its x axis, as its pitch axis turns with the heading.
    roll, roll_slope = np.zeros(len(t)), r * p
    if known_roll:
        measured = _smooth(log, "roll_rate", t, log.imu.sd_rate)
        roll, roll_slope = measured.value, measured.slope
    # The lever arm off: a_cg = a - omega_dot x r - omega x (omega x r), as `physics.imu.imu_reading`.
    a[:, 0] += yaw.slope * y + pitch.slope * z + (r**2 + p**2) * x + roll * (p * y - r * z)
    a[:, 1] += -yaw.slope * x + roll_slope * z + (r**2 + roll**2) * y + p * (r * z + roll * x)
    a[:, 2] += -pitch.slope * x - roll_slope * y + (p**2 + roll**2) * z + r * (p * y - roll * x)
    Q = np.zeros(_SIZE)
    Q[[V_X, V_Y]] = (log.imu.sd_a * step) ** 2
    Q[[YAW, PITCH, ROLL]] = (log.imu.sd_rate * step) ** 2
    if not known_roll:
        # An accelerometer that feels gravity shows the roll; else nothing does.
        Q[ROLL] = 0.0 if log.imu.kinematic else _ROLL_WALK**2 * step
    Q[[B_X, B_Y]], Q[B_YAW] = _DRIFT_A**2 * step, _DRIFT_YAW**2 * step
    return Drive(a=a, rates=np.stack([roll, p, r], axis=1), step=step, Q=Q)


def _noise_of(log: Log, name: str, t: np.ndarray) -> np.ndarray | float:
    """Standard deviation of the samples of a channel at ``t`` (M,)."""
    gnss = log.config.gnss
    if name in ("x", "y"):
        return _SPEED_SD if gnss is None else gnss.sd_position
    speed = _SPEED_SD if gnss is None or gnss.sd_speed is None else gnss.sd_speed
    if name == "course":
        travelled = _on_grid(log, "speed", t) if "speed" in log.channels else np.full(len(t), _COURSE_SPEED)
        # At a crawl the direction of travel is noise: without weight rather than left out.
        return np.where(travelled > _COURSE_SPEED, speed / np.maximum(travelled, _COURSE_SPEED), 1e3)
    return _YAW_SD if name == "yaw" else speed


def _readings_of(log: Log, t: np.ndarray) -> Readings:
    """All measurements of pose and speed; of wheel speed where no other sensor measures the speed."""
    step, age, rows = float(t[1] - t[0]), pose_age(log), []
    for name, kind in _KINDS.items():
        if name not in log.channels:
            continue
        times, values = log.samples(name)
        values = unwrapped(values) if kind in (AT_YAW, AT_COURSE) else values
        sd = np.broadcast_to(_noise_of(log, name, times), times.shape)
        rows.append((times - age, np.full(times.shape, float(kind)), values, sd))
    if not {"v_x", "speed"} & set(log.channels):
        for name in ("omega_f", "omega_r"):
            if name in log.channels:
                rim = log.vehicle.r * _on_grid(log, name, t)
                # Slip lasts: the samples of a second count as one.
                sd = (_SLIP_SD * np.abs(rim) + 0.1) / math.sqrt(step)
                rows.append((t, np.full(t.shape, float(AT_V_X)), rim, sd))
    if not rows:
        raise DataError(f"{log.name}: has neither position nor speed, so windows cannot start from it")
    times, kinds, value, sds = (np.concatenate(column) for column in zip(*rows, strict=True))
    order = np.argsort(times, kind="stable")
    order = order[(times[order] > t[0] - 0.5 * step) & (times[order] < t[-1] + 0.5 * step)]
    instant = np.clip(np.rint((times - t[0]) / step).astype(np.int64), 0, len(t) - 1)
    columns = (instant, times - t[instant], kinds.astype(np.int64), value, sds)
    return Readings(*(np.ascontiguousarray(column[order]) for column in columns))


def _start_of(log: Log, readings: Readings) -> np.ndarray:
    """First guess of the state: the heading along the way, or as the description states it."""
    start, spec = np.zeros(_SIZE), log.config.start
    start[[X, Y, YAW, V_X]] = spec.x, spec.y, spec.yaw, spec.v_x
    for kind in (AT_X, AT_Y, AT_V_X):
        found = readings.value[readings.kind == kind]
        if len(found):
            start[kind] = found[0]
    if "yaw" in log.channels:
        start[YAW] = log.samples("yaw")[1][0]
    elif {"x", "y"} <= set(log.channels):
        # A receiver may lose one of the two.
        both = np.stack([log.channels["x"], log.channels["y"]])
        both = both[:, ~np.isnan(both).any(axis=0)]
        way_x, way_y = both - both[:, :1]
        far = np.flatnonzero(np.hypot(way_x, way_y) > _WAY)
        if len(far):
            start[YAW] = math.atan2(way_y[far[0]], way_x[far[0]])
    if "speed" in log.channels and "v_x" not in log.channels:
        start[V_X] = log.samples("speed")[1][0]
    return start


def smooth_motion(log: Log, t: np.ndarray) -> PlanarMotion:
    """The most probable horizontal motion of the vehicle at the instants ``t`` (K,) [s], equally apart.

    Raises
    ------
    DataError
        For a wheel-rig log, one with neither position nor speed, or one whose channels contradict each other.
    """
    step = float(t[1] - t[0])
    yaw = _smooth(log, "yaw_rate", t, log.imu.sd_rate)
    drive, readings = _drive_of(log, t, yaw), _readings_of(log, t)
    K = len(t)
    vectors, matrices = np.zeros((2, K, _SIZE)), np.zeros((3, K, _SIZE, _SIZE))
    done = Pass(vectors[0], matrices[0], vectors[1], matrices[1], matrices[2])
    guess, start = np.empty((0, _SIZE)), _start_of(log, readings)
    for _ in range(_PASSES):
        _forward(start, np.diag(_START**2), drive, readings, guess, done)
        _backward(done)
        guess = done.means.copy()
    if not np.isfinite(guess).all():
        raise DataError(f"{log.name}: no motion agrees with all channels - one of them in another unit?")
    rate, left = _heading_rows(done.means, drive)
    left_smooth = smooth_channel(left, step, log.imu.sd_a)
    nothing = SmoothChannel(value=np.full(K, np.nan), slope=np.full(K, np.nan), sd=np.full(K, np.nan))
    front, rear = (
        _smooth(log, name, t) if name in log.channels else nothing for name in ("omega_f", "omega_r")
    )
    return PlanarMotion(
        t=t,
        states=done.means.copy(),
        sd=np.sqrt(np.diagonal(done.covs, axis1=1, axis2=2)),
        yaw_rate=rate,
        a_y=left_smooth.value,
        omega_f=front.value,
        omega_r=rear.value,
        yaw_rate_sd=yaw.sd,
        a_y_sd=left_smooth.sd,
        omega_f_sd=front.sd,
        omega_r_sd=rear.sd,
    )
