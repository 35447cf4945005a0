"""Errors of real sensors wander, come late, get lost, are counted and saturate as it is stated of them."""

from __future__ import annotations

import math
from dataclasses import fields

import gymnasium as gym
import numpy as np
import pytest

from offroad_env import make_vec
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.imu import imu_reading
from offroad_env.physics.imu_attitude import Attitude, imu_reading_at_attitude
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.drive import simulate_drive
from offroad_env.simulation.sensor_configs import ALLAN_PEAK_TIME, allan_deviation, noise_sd
from offroad_env.simulation.sensor_presets import SENSORS, make_sensors
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0}
SILENT = {"noise": 0.0, "scale_sd": 0.0}
EXACT = {"position_sd": 0.0, "velocity_sd": 0.0}
RADIUS = 0.35


def at_speed(v=0.0, x=0.0, readings=at.READINGS_SIZE, size=at.STATE_SIZE):
    """State and readings of a vehicle that rolls straight ahead."""
    state, read = np.zeros(size), np.zeros(readings)
    state[[at.X, at.V_X]] = x, v
    read[at.R_OMEGA], read[at.AXLE + at.R_OMEGA] = v, v
    return state, read


def measured(suite, motion, count, seed=0):
    """(count, 11) samples of a motion (tick -> state, readings)."""
    suite.reset(np.random.default_rng(seed), radius=RADIUS)
    return np.array([suite.sample(*motion(k)).channels for k in range(count)])


def standing(k):
    return at_speed()


def test_the_drifting_bias_has_the_stated_instability_where_its_allan_deviation_is_largest():
    config = ImuConfig(**QUIET, accel_instability=0.01, gyro_instability=0.002, bias_time=0.1)
    series = measured(SensorSuite(imu=config), standing, 8000, seed=2)
    peak = round(ALLAN_PEAK_TIME * config.bias_time * config.rate)
    # 80 s hold some 400 independent clusters of 0.19 s: 4 % for a channel, less for the mean of three.
    accel = np.mean([allan_deviation(series[:, i], peak) for i in range(3)])
    assert accel == pytest.approx(0.01, rel=0.08)
    assert allan_deviation(series[:, 4], peak) == pytest.approx(0.002, rel=0.12)
    assert all(allan_deviation(series[:, 0], length) < 1.05 * accel for length in (peak // 8, 8 * peak))


def test_the_position_error_is_correlated_over_the_stated_time_and_has_the_stated_size():
    gnss = GnssConfig(**EXACT, rate=100.0, drift_sd=2.0, drift_time=0.1)
    x, y = measured(SensorSuite(gnss=gnss), standing, 8000, seed=1)[:, 7:9].T
    for error in (x, y):
        lag = round(gnss.drift_time * 100.0)
        assert np.std(error) == pytest.approx(2.0, rel=0.12)  # 400 independent numbers
        assert np.corrcoef(error[lag:], error[:-lag])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.1)
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.15


def test_a_late_sensor_reads_what_was_true_exactly_its_latency_ago():
    def speeding_up(k):
        return at_speed(v=3.0 + 0.05 * k, x=0.02 * k * k)

    late = SensorSuite(
        imu=ImuConfig(**QUIET, latency=0.03),
        wheel=WheelSpeedConfig(**SILENT, rate=100.0, latency=0.05),
        gnss=GnssConfig(**EXACT, rate=100.0, latency=0.2),
    )
    prompt = SensorSuite(
        imu=ImuConfig(**QUIET),
        wheel=WheelSpeedConfig(**SILENT, rate=100.0),
        gnss=GnssConfig(**EXACT, rate=100.0),
    )

    def shaken(k):
        state, readings = speeding_up(k)
        readings[at.A_X] = math.sin(0.3 * k)
        return state, readings

    now, then = measured(prompt, shaken, 60), measured(late, shaken, 60)
    for columns, ticks in ((slice(0, 5), 3), (slice(5, 7), 5), (slice(7, 11), 20)):
        np.testing.assert_array_equal(then[ticks:, columns], now[:-ticks, columns])
    assert then[0, 7] == pytest.approx(-0.2 * 3.0), "before the start it had rolled at its speed"


def test_a_lost_imu_sample_repeats_the_last_one_and_a_lost_wheel_speed_or_fix_is_missing():
    lossy = {"dropout": 0.3, "outage": 0.05}
    suite = SensorSuite(
        imu=ImuConfig(**lossy),
        wheel=WheelSpeedConfig(rate=100.0, **lossy),
        gnss=GnssConfig(rate=100.0, **lossy),
    )
    rows = measured(suite, standing, 12_000, seed=4)
    repeats = np.all(rows[1:, :5] == rows[:-1, :5], axis=1)
    for lost in (repeats, np.isnan(rows[1:, 5]), np.isnan(rows[1:, 7])):
        assert lost.mean() == pytest.approx(0.3, abs=0.04)  # some 700 losses
        lengths = np.diff(np.flatnonzero(np.diff(np.concatenate(([0], lost, [0])))))[::2]
        assert lengths.mean() / 100.0 == pytest.approx(0.05, rel=0.12)
    assert np.isfinite(rows[:, :5]).all()
    suite.reset(np.random.default_rng(4))
    first = suite.sample(*standing(0))
    assert first.wheel_valid
    assert first.gnss_valid


def test_an_encoder_reads_speeds_in_steps_of_one_count_per_window_and_right_on_average():
    wheel = WheelSpeedConfig(**SILENT, rate=100.0, pulses_per_turn=96.0, window=0.1)
    step = 2.0 * math.pi * RADIUS / (96.0 * 0.1)
    speeds = measured(SensorSuite(wheel=wheel), lambda k: at_speed(4.0), 2000)[:, 5:7]
    counts = speeds / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert set(np.round(counts[:, 0])) == {math.floor(4.0 / step), math.ceil(4.0 / step)}
    assert speeds.mean(axis=0) == pytest.approx([4.0, 4.0], abs=step / 50.0)
    assert not np.array_equal(speeds[:, 0], speeds[:, 1]), "the wheels' encoders do not stand alike"
    backwards = measured(SensorSuite(wheel=wheel), lambda k: at_speed(-4.0), 2000)[:, 5]
    assert backwards.mean() == pytest.approx(-4.0, abs=step / 50.0)


def test_a_channel_saturates_at_its_range_and_scale_errors_spread_as_stated():
    imu = ImuConfig(**QUIET, accel_range=5.0, gyro_range=0.5, accel_scale_sd=0.03, gyro_scale_sd=0.01)
    suite, seen = SensorSuite(imu=imu), []

    def pushed(a, rate):
        state, readings = at_speed()
        readings[at.A_X], state[at.YAW_RATE] = a, rate
        return state, readings

    for seed in range(400):
        suite.reset(np.random.default_rng(seed))
        seen.append(suite.sample(*pushed(1.0, 0.1)).imu)
    scales = np.array(seen)[:, [0, 4]] / (1.0, 0.1) - 1.0
    assert scales.std(axis=0) == pytest.approx([0.03, 0.01], rel=0.12)  # 400 draws: 3.5 %
    assert suite.sample(*pushed(-80.0, 3.0)).imu[[0, 4]] == pytest.approx([-5.0, 0.5])


def test_the_noise_of_a_sample_follows_from_the_density_of_the_data_sheet():
    assert noise_sd(0.014, 100.0) == pytest.approx(0.014 * math.sqrt(50.0))


def test_parked_on_a_side_slope_the_accelerometers_measure_gravity_across_the_body():
    suite = SensorSuite(imu=ImuConfig(**QUIET, kind="specific_force", lever_arm=(0.5, 0.2, 0.8)))
    suite.reset(np.random.default_rng(0))
    state, readings = at_speed(readings=at.FOUR_WHEEL_READINGS, size=at.FOUR_WHEEL_SIZE)
    state[at.ROLL] = 0.2  # left side up
    s, c = math.sin(0.2), math.cos(0.2)
    assert suite.sample(state, readings).imu == pytest.approx([0.0, GRAVITY * s, GRAVITY * c, 0.0, 0.0])


def body_axes(t):
    """Columns: axes of a body that yaws, pitches and rolls, in the world."""
    (sy, sp, sr), (cy, cp, cr) = ([f(a(t)) for a in (yaw, pitch, roll)] for f in (math.sin, math.cos))
    heading = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    pitched = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    return heading @ pitched @ np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])


def yaw(t):
    return 0.7 * t + 0.3 * math.sin(1.7 * t)


def pitch(t):
    return 0.25 * math.sin(2.3 * t + 0.5)


def roll(t):
    return 0.3 * math.sin(1.9 * t - 0.4)


def derivative(function, t, order, d=2e-3):
    samples = [np.asarray(function(t + i * d)) for i in (-2, -1, 0, 1, 2)]
    weights = {1: (1, -8, 0, 8, -1), 2: (-1, 16, -30, 16, -1)}[order]
    return sum(w * v for w, v in zip(weights, samples, strict=True)) / (12.0 * d**order)


def attitude_at(t, rolling=True):
    rates = [float(derivative(angle, t, order)) for order in (1, 2) for angle in (yaw, pitch, roll)]
    if not rolling:
        rates[2] = rates[5] = 0.0
    return Attitude(pitch(t), roll(t) if rolling else 0.0, *rates)


def test_on_a_body_that_rolls_the_imu_measures_the_acceleration_and_rotation_of_its_place():
    lever = np.array([0.9, -0.3, 0.6])
    mount = ImuConfig(lever_arm=tuple(lever), kind="specific_force").mount()
    for t in np.linspace(0.1, 5.0, 9):
        axes, spin = body_axes(t), body_axes(t).T @ derivative(body_axes, t, 1)
        inertial = derivative(lambda u: body_axes(u) @ lever, t, 2)
        reading = imu_reading_at_attitude((0.0, 0.0, 0.0), attitude_at(t), mount)
        # Truncation of the differences: d^4 times a sixth derivative of up to 1e3.
        assert reading[:3] == pytest.approx(axes.T @ (inertial + np.array([0.0, 0.0, GRAVITY])), abs=1e-6)
        assert reading[3:] == pytest.approx((-spin[0, 2], spin[1, 0]), abs=1e-6)


def test_without_roll_both_laws_of_the_imu_agree():
    for body in (True, False):
        mount = ImuConfig(lever_arm=(0.9, -0.3, 0.6), body_axes=body).mount((0.02, -0.03, 0.01))
        for t in (0.3, 1.1, 4.0):
            a = attitude_at(t, rolling=False)
            rates = (a.yaw_rate, a.pitch_rate, a.yaw_acc, a.pitch_acc)
            plain = imu_reading((1.0, -2.0, 0.5), *rates, a.pitch, mount)
            assert imu_reading_at_attitude((1.0, -2.0, 0.5), a, mount) == pytest.approx(plain, rel=1e-13)


def number(name, of):
    """A field of a preset."""
    part, field = of.split(".")
    return getattr(getattr(SENSORS[name], part), field)


@pytest.mark.parametrize(
    "of",
    [
        *("imu.accel_noise", "imu.accel_bias_sd", "imu.gyro_bias_sd", "imu.gyro_instability"),
        *("imu.accel_scale_sd", "imu.latency", "imu.dropout", "wheel.scale_sd", "wheel.latency"),
        *("gnss.total_position_sd", "gnss.velocity_sd", "gnss.latency", "gnss.dropout"),
    ],
)
def test_from_ideal_over_automotive_to_consumer_sensors_get_worse(of):
    ideal, automotive, consumer = (number(name, of) for name in ("ideal", "automotive", "consumer"))
    assert ideal < automotive < consumer


def test_every_number_of_a_preset_has_a_source():
    for name in ("automotive", "consumer"):
        preset = SENSORS[name]
        stated = " ".join(fields_ for fields_, _ in preset.sources)
        for part in ("imu", "wheel", "gnss"):
            default = type(getattr(preset, part))()
            changed = [
                item.name
                for item in fields(default)
                if getattr(default, item.name) != getattr(getattr(preset, part), item.name)
            ]
            for field in set(changed) - {"kind", "rate", "noise"}:
                assert any(word in stated for word in (field, *field.split("_", 1))), (name, part, field)


def test_parts_of_presets_can_be_exchanged_or_left_out():
    mixed = make_sensors("automotive", gnss="consumer", wheel=None, imu=ImuConfig())
    assert (mixed.gnss, mixed.wheel, mixed.imu) == (SENSORS["consumer"].gnss, None, ImuConfig())
    copied = make_sensors(mixed, wheel="ideal")
    assert (copied.gnss, copied.wheel) == (mixed.gnss, SENSORS["ideal"].wheel)


def test_the_same_seed_gives_the_same_drive_and_readings_and_another_one_others():
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat())
    runs = [
        simulate_drive(plant, lambda t, v: (0.1 * t, 400.0, 0.0), "automotive", seed, duration=1.0)
        for seed in (5, 5, 6)
    ]
    np.testing.assert_array_equal(runs[0].samples, runs[1].samples)
    assert not np.array_equal(runs[0].imu, runs[2].imu)
    np.testing.assert_array_equal(runs[0].states, runs[2].states)
    assert runs[0].imu[:, 2].mean() == pytest.approx(GRAVITY, abs=0.5)


def test_drift_and_losses_do_not_shift_the_white_noise():
    plain = measured(SensorSuite(gnss=GnssConfig()), standing, 50)
    drifting = measured(
        SensorSuite(imu=ImuConfig(accel_scale_sd=0.1, latency=0.02), gnss=GnssConfig(drift_sd=1.0)),
        standing,
        50,
    )
    np.testing.assert_array_equal(plain[:, :5], drifting[:, :5])
    np.testing.assert_array_equal(plain[:, 9:], drifting[:, 9:])


def driven(env, steps=70):
    shown, samples = [env.reset(seed=8)[0]], []
    for k in range(steps):
        shown.append(env.step(np.array([0.2 * math.sin(0.1 * k), 0.3]))[0])
        samples.append(env.unwrapped.measurements().samples)
    return shown, np.concatenate(samples)


@pytest.fixture(scope="module")
def automotive_drive():
    return driven(gym.make("offroad_env:OffroadBekker-v0", sensors="automotive"))


def test_readings_do_not_depend_on_what_is_observed(automotive_drive):
    truth = gym.make("offroad_env:OffroadBekker-v0", sensors="automotive", terrain_info="truth")
    np.testing.assert_array_equal(driven(truth)[1], automotive_drive[1])


def test_vector_and_single_environment_agree_to_the_last_bit(automotive_drive):
    envs = make_vec(3, sensors="automotive", threads=1)
    shown = [envs.reset(seed=[8, 3, 8])[0]]
    for k in range(70):
        shown.append(envs.step(np.tile([0.2 * math.sin(0.1 * k), 0.3], (3, 1)))[0])
    for many, single in zip(shown, automotive_drive[0], strict=True):
        for key in single:
            np.testing.assert_array_equal(many[key][0], single[key])
            np.testing.assert_array_equal(many[key][2], single[key])
    assert not np.array_equal(shown[-1]["imu"][1], shown[-1]["imu"][0])


def test_the_environment_measures_with_its_sensors_what_they_measure_alone(automotive_drive):
    """Latency apart, the a_z of a specific force holds gravity, and rim speeds come in counts."""
    samples = automotive_drive[1]
    assert np.nanmean(samples[:, 2]) == pytest.approx(GRAVITY, abs=0.5)
    assert len(set(samples[np.isfinite(samples[:, 5]), 5].tolist())) < 20


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: make_sensors("perfect"), "one of paper, ideal, automotive, consumer"),
        (lambda: ImuConfig(latency=20.0), "latency.*ms"),
        (lambda: GnssConfig(dropout=5.0), "dropout.*per cent"),
        (lambda: measured(SensorSuite(imu=ImuConfig(latency=0.015)), standing, 1), "multiple"),
        (lambda: measured(SensorSuite(gnss=GnssConfig(dropout=0.9)), standing, 1), "outage"),
        (
            lambda: measured(
                SensorSuite(wheel=WheelSpeedConfig(latency=0.6, window=0.2, pulses_per_turn=4)), standing, 1
            ),
            "reach back",
        ),
        (
            lambda: SensorSuite(wheel=WheelSpeedConfig(pulses_per_turn=40.0)).reset(np.random.default_rng(0)),
            "radius",
        ),
        (
            lambda: gym.make(
                "offroad_env:OffroadBekker-v0", sensors=make_sensors("ideal", imu=ImuConfig(rate=200.0))
            ),
            "imu.rate.*100 Hz",
        ),
    ],
)
def test_sensors_that_cannot_be_are_refused_with_a_reason(make, words):
    with pytest.raises(InvalidParameter, match=words):
        make()
