"""Sensors measure what a rigid body does at the place where they sit, plus their stated errors."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.imu import OFFSET, SCALE, imu_reading
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig

QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0}


class Motion:
    """A tumbling, smooth motion of a rigid body, known at any time."""

    @staticmethod
    def position(t):
        return np.array([3.0 * t + 0.4 * math.sin(1.3 * t), math.cos(0.9 * t), 0.2 * math.sin(2.1 * t)])

    @staticmethod
    def yaw(t):
        return 0.7 * t + 0.3 * math.sin(1.7 * t)

    @staticmethod
    def pitch(t):
        return 0.25 * math.sin(2.3 * t + 0.5)

    @classmethod
    def axes(cls, t, pitched=True):
        """Columns: forward, left, up axes of the body (or of the level heading frame) in the world."""
        c, s = math.cos(cls.yaw(t)), math.sin(cls.yaw(t))
        heading = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        p = cls.pitch(t) if pitched else 0.0
        # Nose up: the forward axis gains height.
        return heading @ np.array([[math.cos(p), 0, -math.sin(p)], [0, 1, 0], [math.sin(p), 0, math.cos(p)]])


def derivative(function, t, order, d=2e-3):
    """First or second derivative by central differences of fourth order."""
    samples = [np.asarray(function(t + i * d)) for i in (-2, -1, 0, 1, 2)]
    weights = {1: (1, -8, 0, 8, -1), 2: (-1, 16, -30, 16, -1)}[order]
    return sum(w * v for w, v in zip(weights, samples, strict=True)) / (12.0 * d**order)


def reading_at(t, mount):
    heading = Motion.axes(t, pitched=False)
    acceleration = tuple(float(a) for a in heading.T @ derivative(Motion.position, t, 2))
    rates = [float(derivative(angle, t, order)) for order in (1, 2) for angle in (Motion.yaw, Motion.pitch)]
    return imu_reading(acceleration, *rates, Motion.pitch(t), mount)


TIMES = np.linspace(0.1, 6.0, 12)
#: Truncation of the differences: d^4 times a derivative of order 6 of up to 1e3.
TOLERANCE = 1e-6


@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.0), (1.2, -0.4, 0.7), (-0.8, 0.5, -0.3)])
def test_the_accelerometers_feel_the_second_derivative_of_their_own_place(lever):
    mount = ImuConfig(lever_arm=lever).mount()
    for t in TIMES:
        inertial = derivative(lambda u: Motion.position(u) + Motion.axes(u) @ lever, t, 2)
        assert reading_at(t, mount)[:3] == pytest.approx(Motion.axes(t).T @ inertial, abs=TOLERANCE)


def test_a_real_accelerometer_feels_that_minus_gravity():
    mount = ImuConfig(lever_arm=(0.9, 0.2, 0.5), kind="specific_force").mount()
    for t in TIMES:
        inertial = derivative(lambda u: Motion.position(u) + Motion.axes(u) @ mount.lever, t, 2)
        felt = Motion.axes(t).T @ (inertial - np.array([0.0, 0.0, -GRAVITY]))
        assert reading_at(t, mount)[:3] == pytest.approx(felt, abs=TOLERANCE)


def test_the_left_axis_of_a_forward_left_up_gyro_reads_minus_the_pitch_rate():
    mount = ImuConfig().mount()
    for t in TIMES:
        spin = Motion.axes(t).T @ derivative(Motion.axes, t, 1)  # skew matrix of omega in body axes
        omega = (spin[2, 1], spin[0, 2], spin[1, 0])
        *_, pitch_rate, yaw_rate = reading_at(t, mount)
        assert pitch_rate == pytest.approx(-omega[1], abs=TOLERANCE)
        assert pitch_rate == pytest.approx(float(derivative(Motion.pitch, t, 1)), abs=TOLERANCE)
        assert yaw_rate == pytest.approx(omega[2], abs=TOLERANCE)


def test_parked_nose_up_an_accelerometer_reads_gravity_forward_and_up():
    still = ((0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.1)
    felt = imu_reading(*still, ImuConfig(kind="specific_force", lever_arm=(1.0, 1.0, 1.0)).mount())
    assert felt == pytest.approx((GRAVITY * math.sin(0.1), 0.0, GRAVITY * math.cos(0.1), 0.0, 0.0))
    assert imu_reading(*still, ImuConfig().mount()) == (0.0,) * 5


def test_a_level_imu_does_not_notice_the_pitch():
    mount = ImuConfig(body_axes=False).mount()
    motion = ((1.0, -2.0, 0.5), 0.4, 0.3, 0.2, 0.1)
    assert imu_reading(*motion, 0.2, mount) == pytest.approx((1.0, -2.0, 0.5, 0.3, 0.4), abs=1e-15)
    assert imu_reading(*motion, 0.2, mount) == imu_reading(*motion, -0.3, mount)


def test_a_misaligned_imu_sees_the_motion_in_turned_axes():
    motion = ((1.0, 2.0, 3.0), 0.0, 0.0, 0.0, 0.0, 0.0)
    c, s = math.cos(0.1), math.sin(0.1)
    turned_left = imu_reading(*motion, ImuConfig().mount((0.0, 0.0, 0.1)))
    assert turned_left[:3] == pytest.approx((c + 2.0 * s, 2.0 * c - s, 3.0))
    nose_up = imu_reading(*motion, ImuConfig().mount((0.0, 0.1, 0.0)))
    assert nose_up[:3] == pytest.approx((c + 3.0 * s, 2.0, 3.0 * c - s))
    right_down = imu_reading(*motion, ImuConfig().mount((0.1, 0.0, 0.0)))
    assert right_down[:3] == pytest.approx((1.0, 2.0 * c + 3.0 * s, 3.0 * c - 2.0 * s))
    # Rolled by a quarter turn the left axis points up and the gyros trade places.
    yawing = imu_reading(
        (0.0, 0.0, 0.0), 0.5, 0.0, 0.0, 0.0, 0.0, ImuConfig().mount((0.5 * math.pi, 0.0, 0.0))
    )
    assert yawing[3:] == pytest.approx((-0.5, 0.0), abs=1e-15)


def moving(v_x=8.0, v_y=-1.0, yaw=0.6):
    """A vehicle's state and readings with distinct entries."""
    state, readings = np.zeros(at.STATE_SIZE), np.zeros(at.READINGS_SIZE)
    state[[at.X, at.Y, at.YAW, at.V_X, at.V_Y]] = 12.0, -7.0, yaw, v_x, v_y
    readings[at.R_OMEGA], readings[at.AXLE + at.R_OMEGA] = 8.5, 9.0
    return state, readings


def parked():
    return np.zeros(at.STATE_SIZE), np.zeros(at.READINGS_SIZE)


def test_parked_the_imu_measures_bias_noise_and_gravity():
    suite = SensorSuite(imu=ImuConfig(kind="specific_force", accel_bias_sd=0.3, gyro_bias_sd=0.02))
    suite.reset(np.random.default_rng(5))
    samples = np.array([suite.sample(*parked()).imu for _ in range(4000)])
    bias = suite.errors[OFFSET, :5]
    assert np.all(bias != 0.0)
    sd = np.array([0.2, 0.2, 0.2, 0.0175, 0.0175])
    # Means of 4000 samples scatter by sd / 63, standard deviations by sd / 89: four of those.
    assert np.all(np.abs(samples.mean(axis=0) - bias - [0, 0, GRAVITY, 0, 0]) < 4.0 * sd / 63.0)
    assert samples.std(axis=0) == pytest.approx(sd, rel=4.0 / 89.0)
    lagged = np.corrcoef(samples[1:].T, samples[:-1].T)
    assert np.abs(lagged[:5, 5:]).max() < 0.07, "noise repeats or is correlated"
    assert np.abs(lagged[:5, :5] - np.eye(5)).max() < 0.07, "channels share their noise"


def test_constant_errors_last_an_episode_and_spread_over_episodes_as_stated():
    suite = SensorSuite(
        imu=ImuConfig(accel_bias_sd=0.3, misalignment_sd=(0.01, 0.02, 0.03)),
        wheel=WheelSpeedConfig(scale_sd=0.02),
    )
    rng, biases, scales, angles = np.random.default_rng(0), [], [], []
    for _ in range(600):
        suite.reset(rng)
        biases.append(suite.errors[OFFSET, :3])
        scales.append(suite.errors[SCALE, 5:7])
        R = suite.mount.rotation
        angles.append((R[2, 1], R[2, 0], R[1, 0]))  # small angles: roll, pitch (nose up), yaw
    # A standard deviation from 600 (1800, 1200) draws is good to 2.9 % (1.7 %, 2 %).
    assert np.std(biases) == pytest.approx(0.3, rel=0.06)
    assert np.std(scales) == pytest.approx(0.02, rel=0.08)
    assert np.std(angles, axis=0) == pytest.approx([0.01, 0.02, 0.03], rel=0.12)


def test_wheel_speed_is_off_by_its_scale_and_comes_at_its_rate():
    suite = SensorSuite(wheel=WheelSpeedConfig(rate=25.0, noise=0.0, scale_sd=0.05))
    suite.reset(np.random.default_rng(1))
    samples = [suite.sample(*moving()) for _ in range(12)]
    assert [s.wheel_valid for s in samples] == [True, False, False, False] * 3
    assert [bool(np.isnan(s.wheel).any()) for s in samples] == [False, True, True, True] * 3
    scale = suite.errors[SCALE, 5:7]
    assert samples[0].wheel == pytest.approx([8.5, 9.0] * (1.0 + scale))
    assert scale[0] != scale[1]
    assert not any(s.gnss_valid for s in samples), "a sensor that is not there delivers"


def test_gnss_gives_position_speed_and_the_direction_of_travel_at_its_rate():
    suite = SensorSuite(gnss=GnssConfig(rate=20.0, position_sd=0.0, velocity_sd=0.0))
    suite.reset(np.random.default_rng(1))
    samples = [suite.sample(*moving()) for _ in range(10)]
    assert [s.gnss_valid for s in samples] == [True, False, False, False, False] * 2
    assert np.isnan(samples[1].gnss).all()
    course = 0.6 + math.atan2(-1.0, 8.0)  # heading plus side slip
    assert samples[0].gnss == pytest.approx([12.0, -7.0, math.hypot(8.0, 1.0), course])


def test_gnss_errors_have_the_stated_size():
    suite = SensorSuite(gnss=GnssConfig(rate=100.0, position_sd=0.5, velocity_sd=0.1, offset_sd=2.0))
    suite.reset(np.random.default_rng(2))
    fixes = np.array([suite.sample(*moving(v_x=10.0, v_y=0.0, yaw=0.3)).gnss for _ in range(3000)])
    # A speed error is the velocity error along, a course error the one across over the speed.
    assert fixes.std(axis=0) == pytest.approx([0.5, 0.5, 0.1, 0.01], rel=0.06)
    offset = suite.errors[OFFSET, 7:9]
    assert np.all(np.abs(offset) > 0.1)
    assert fixes[:, :2].mean(axis=0) == pytest.approx(np.array([12.0, -7.0]) + offset, abs=0.04)


CONFIGURATIONS = {
    "imu only": {},
    "all": {"wheel": WheelSpeedConfig(), "gnss": GnssConfig()},
    "other rates": {"wheel": WheelSpeedConfig(rate=100.0), "gnss": GnssConfig(rate=5.0, offset_sd=1.0)},
}


def test_the_imu_noise_and_the_callers_generator_do_not_depend_on_the_other_sensors():
    runs, after = [], []
    for configuration in CONFIGURATIONS.values():
        rng = np.random.default_rng(9)
        suite = SensorSuite(**configuration)
        suite.reset(rng)
        runs.append([suite.sample(*moving()).imu for _ in range(150)])
        after.append(rng.random())
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])
    assert after[0] == after[1] == after[2]


def test_biases_do_not_shift_the_noise():
    plain, biased = SensorSuite(), SensorSuite(imu=ImuConfig(accel_bias_sd=0.5))
    for suite in (plain, biased):
        suite.reset(np.random.default_rng(4))
    bias = biased.errors[OFFSET, :5]
    for _ in range(70):
        assert biased.sample(*moving()).imu == pytest.approx(plain.sample(*moving()).imu + bias, abs=1e-12)


def test_the_same_seed_repeats_an_episode_and_the_next_one_differs():
    suite, rng = SensorSuite(**CONFIGURATIONS["all"]), np.random.default_rng(3)
    episodes = []
    for generator in (rng, rng, np.random.default_rng(3)):
        suite.reset(generator)
        episodes.append(np.array([np.concatenate(suite.sample(*moving())[:3]) for _ in range(100)]))
    assert np.array_equal(episodes[0], episodes[2], equal_nan=True)
    assert not np.array_equal(episodes[0], episodes[1], equal_nan=True)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda suite: pickle.loads(pickle.dumps(suite))])
def test_a_copied_suite_goes_on_with_the_same_noise(duplicate):
    suite = SensorSuite(**CONFIGURATIONS["all"])
    suite.reset(np.random.default_rng(3))
    for _ in range(30):
        suite.sample(*moving())
    twin = duplicate(suite)
    ahead = [np.concatenate(suite.sample(*moving())[:3]) for _ in range(100)]
    assert np.array_equal(
        ahead, [np.concatenate(twin.sample(*moving())[:3]) for _ in range(100)], equal_nan=True
    )


def test_every_sample_is_made_of_new_arrays():
    suite = SensorSuite(**CONFIGURATIONS["all"])
    suite.reset(np.random.default_rng(0))
    state, readings = moving()
    first = suite.sample(state, readings)
    kept = first.imu.copy()
    second = suite.sample(state, readings)
    state[:], readings[:] = 1e9, 1e9
    assert np.array_equal(first.imu, kept)
    assert not np.shares_memory(first.imu, second.imu)


def test_a_quiet_imu_at_the_cg_reads_the_models_accelerations():
    suite = SensorSuite(imu=ImuConfig(**QUIET, body_axes=False))
    suite.reset(np.random.default_rng(0))
    state, readings = moving()
    readings[[at.A_X, at.A_Y, at.A_Z]] = 1.0, 2.0, 3.0
    state[[at.PITCH, at.PITCH_RATE, at.YAW_RATE]] = 0.1, 0.2, 0.3
    assert suite.sample(state, readings).imu == pytest.approx([1.0, 2.0, 3.0, 0.2, 0.3], abs=1e-15)


@pytest.mark.parametrize(
    ("make", "name", "reason"),
    [
        (lambda: ImuConfig(rate=0.01), "rate", "period"),
        (lambda: ImuConfig(gyro_noise=5.0), "gyro_noise", "degrees/s"),
        (lambda: ImuConfig(accel_noise=-0.1), "accel_noise", "-0.1"),
        (lambda: ImuConfig(misalignment_sd=(1.0, 0.0, 0.0)), "misalignment_sd", "degrees"),
        (lambda: ImuConfig(misalignment_sd=0.1), "misalignment_sd", "3 numbers"),
        (lambda: ImuConfig(lever_arm=(120.0, 0.0, 0.0)), "lever_arm", "cm"),
        (lambda: ImuConfig(kind="proper"), "kind", "specific_force"),
        (lambda: WheelSpeedConfig(scale_sd=2.0), "scale_sd", "per cent"),
        (lambda: GnssConfig(position_sd=math.inf), "position_sd", "inf"),
        (lambda: SensorSuite(gnss=GnssConfig(rate=30.0)), "gnss.rate", "divide"),
        (lambda: SensorSuite(wheel=WheelSpeedConfig(rate=200.0)), "wheel.rate", "divide"),
        (lambda: SensorSuite().sample(*parked()), "reset", "first"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused_with_name_and_reason(make, name, reason):
    with pytest.raises(InvalidParameter, match=name) as caught:
        make()
    assert reason in str(caught.value)
