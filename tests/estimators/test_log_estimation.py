"""Filters on logs: what comes out of a simulated drive, and what a log must have."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.filters.registry import ONLINE_FILTERS
from estimators.log_estimation import LOG_FILTERS, LOG_MAP_FILTERS, estimate_log, log_samples, usable_range
from estimators.logs import Log, TerrainSpec, log_from_run
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate, simulate_commands
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES

STEP = 0.01
TRUE_N, BELIEVED_N = 0.55, 0.7


def full_log(duration=8.0, soil="dry_sand", mass=1.0):
    """A slalom of the full model on level ground, measured; ``mass``: the true one over the nominal."""
    plant = make_plant(VEHICLES["mrzr"], make_soil(soil, n=TRUE_N), flat())
    heavy = plant._replace(vehicle=plant.vehicle._replace(m=mass * plant.vehicle.m))
    t = STEP * np.arange(round(duration / STEP))
    commands = np.column_stack([0.15 * np.sin(1.3 * t), 1500.0 + 700.0 * np.sin(0.9 * t), np.zeros(len(t))])
    state, warm = settled_state(heavy, v_x=4.0)
    run = simulate_commands(heavy, state, warm, commands, interval=STEP)
    sensors = SensorSuite(imu=ImuConfig(), wheel=WheelSpeedConfig(), gnss=GnssConfig())
    belief = plant._replace(soil=make_soil(soil, n=BELIEVED_N))
    return log_from_run(run, plant, commands, sensors, np.random.default_rng(7), belief=belief, name="slalom")


def paper_log(duration=8.0):
    """The paper's half-car weaving over its ground, measured."""
    plant = make_plant(VEHICLES["paper"], make_soil("clay"), paper_terrain(0.05), model="paper", slip=0.0275)
    state, warm = settled_state(plant, v_x=5.0)

    def steer(t):
        return 0.2 * math.sin(t)

    def force(t):
        return VEHICLES["paper"].m * (0.8 + 0.5 * math.sin(0.8 * t))

    run = simulate(plant, state, warm, steer=steer, force=force, duration=duration, dt=STEP)
    commands = np.column_stack([[steer(t) for t in run.t], [force(t) for t in run.t]])
    sensors = SensorSuite(imu=ImuConfig(body_axes=False), gnss=GnssConfig())
    belief = plant._replace(soil=make_soil("clay", n=0.6))
    return log_from_run(
        run,
        plant,
        commands,
        sensors,
        np.random.default_rng(7),
        belief=belief,
        hold="linear",
        name="weave",
    )


@pytest.fixture(scope="module")
def full():
    return full_log()


@pytest.fixture(scope="module")
def paper():
    return paper_log()


def changed(log: Log, *, drop=(), **channels) -> Log:
    kept = {name: values for name, values in (log.channels | channels).items() if name not in drop}
    return replace(log, channels=kept)


@pytest.mark.parametrize("name", ONLINE_FILTERS)
def test_what_a_vehicle_carries_finds_n_in_the_log_of_a_drive(name, full):
    shares = []
    result = estimate_log(full, name, progress=shares.append)
    assert abs(result.stated.n[-1] - TRUE_N) < 0.03
    assert result.stated.low[-1] < TRUE_N < result.stated.high[-1]
    assert result.stated.valid[-1]
    assert result.stated.n[0] == pytest.approx(BELIEVED_N, abs=0.01)
    assert shares == sorted(shares)
    assert 0.0 < shares[-1] < 1.0


#: A bank and an extended Kalman filter are compiled for longer than what they test here.
_LONG = ("map_ukf_bank", "map_ekf")


@pytest.mark.parametrize(
    "name",
    ["joint", *(pytest.param(name, marks=[pytest.mark.check] * (name in _LONG)) for name in LOG_MAP_FILTERS)],
)
def test_the_papers_filters_work_on_the_log_of_its_vehicle(name, paper):
    result = estimate_log(paper, name, sd=0.1)
    assert abs(result.stated.n[-1] - 0.5) < 0.05
    assert result.stated.sd[-1] < 0.05
    assert 0.5 < np.nanmean(result.stated.nis) / result.stated.channels < 1.5


def test_references_stay_unseen(full):
    spoilt = replace(full, references={name: values * math.nan for name, values in full.references.items()})
    assert np.array_equal(estimate_log(spoilt, "joint").stated.n, estimate_log(full, "joint").stated.n)


def test_the_table_has_a_row_a_sample_and_reads_back(full):
    result = estimate_log(full, "parameter")
    head, *rows = result.csv().splitlines()
    assert head == "t,n,sd,low,high,valid,nis,robust_sd,robust_valid,evidence_n,evidence_sd"
    assert len(rows) == len(result.stated.t) == len(full.t)
    last = rows[-1].split(",")
    columns = [getattr(result.stated, name)[-1] for name in ("t", "n", "sd", "low", "high")]
    assert [float(value) for value in last[:5]] == columns
    assert rows[0].split(",")[6] == ""  # the prior has no innovation
    assert float(last[7]) == result.robust.sd[-1]
    assert bool(int(last[8])) == result.robust.valid[-1]


@pytest.mark.parametrize("mass", [1.0, 1.1])
def test_the_robust_interval_holds_the_truth_for_a_vehicle_that_is_heavier_than_said(mass):
    result = estimate_log(full_log(mass=mass), "parameter", n_prior=0.6)
    late = result.stated.t > 4.0
    error = np.abs(result.stated.n - TRUE_N)[late]
    # As stated the filter is certain either way, and right for the nominal vehicle only.
    assert result.stated.valid[late].all()
    assert (error < 2.0 * result.stated.sd[late]).mean() == (1.0 if mass == 1.0 else 0.0)
    assert (error < 2.0 * result.robust.sd[late]).all()
    assert (result.robust.sd > result.stated.sd).all()
    assert (result.robust.valid <= result.stated.valid).all()


def test_a_prior_of_ones_own_replaces_that_of_the_description(full):
    assert estimate_log(full, "joint", n_prior=0.5, sd=0.1).stated.n[0] == pytest.approx(0.5, abs=0.01)


# ---------------------------------------------------------------------- samples


def test_slow_sensors_stand_beside_their_stamps_and_nothing_is_interpolated(full):
    samples = log_samples(full)
    assert samples.dt == pytest.approx(STEP)
    assert np.array_equal(samples.imu[:, 0], full.channels["a_x"])
    assert np.isfinite(samples.gnss[:, 0]).sum() == np.isfinite(full.channels["x"]).sum()
    assert np.array_equal(samples.commands[1:, 0], full.channels["steer"][:-1])


def test_a_lost_sample_leaves_a_hole(full):
    kept = np.ones(len(full.t), bool)
    kept[300:310] = False
    channels = {name: values[kept] for name, values in full.channels.items()}
    samples = log_samples(replace(full, t=full.t[kept], channels=channels))
    assert samples.missing == 10
    assert np.isnan(samples.imu[300:310]).all()
    assert len(samples.t) == len(full.t)


def test_rounded_stamps_are_even_enough(full):
    rounded = replace(full, t=np.round(full.t + 0.0004, 3))
    assert log_samples(rounded).dt == pytest.approx(STEP, rel=1e-6)


def test_body_speeds_serve_where_there_is_no_course(full):
    speed, slide = full.channels["speed"], np.full(len(full.t), 0.02)
    body = changed(full, drop=("speed", "course"), v_x=speed * np.cos(slide), v_y=speed * np.sin(slide))
    samples = log_samples(body)
    fixed = np.isfinite(speed)
    assert samples.gnss[fixed, 2] == pytest.approx(speed[fixed])
    assert samples.slide[fixed] == pytest.approx(0.02)
    assert np.isnan(samples.gnss[:, 3]).all()
    assert abs(estimate_log(body, "joint").stated.n[-1] - TRUE_N) < 0.05


def test_without_satellite_fixes_no_map_is_believed(full):
    """The place is lost within seconds; slopes read at the wrong place would be taken for soil."""
    lost = changed(full, drop=("x", "y", "speed", "course"))
    hills = replace(lost, config=replace(lost.config, terrain=TerrainSpec(kind="paper", H_0=0.3)))
    assert np.array_equal(estimate_log(hills, "joint").stated.n, estimate_log(lost, "joint").stated.n)
    mapped = replace(full, config=replace(full.config, terrain=TerrainSpec(kind="paper", H_0=0.3)))
    assert not np.array_equal(estimate_log(mapped, "joint").stated.n, estimate_log(full, "joint").stated.n)


# ---------------------------------------------------------------------- refusals


def test_hard_ground_has_no_exponent(full):
    hard = replace(full, config=replace(full.config, soil=make_soil("hard_ground")))
    with pytest.raises(DataError, match="slalom: stands on hard ground, which has no sinkage exponent"):
        estimate_log(hard, "joint")


@pytest.mark.parametrize("name", LOG_MAP_FILTERS)
def test_filters_of_the_papers_half_car_refuse_another_model(name, full):
    with pytest.raises(
        DataError,
        match="the log is of model full - use online_parameter_ukf, online_joint_ukf, online_ukf_bank",
    ):
        estimate_log(full, name)


def test_filters_with_a_map_refuse_unknown_ground(paper):
    lost = replace(paper, config=replace(paper.config, terrain=TerrainSpec(kind="unknown", rms=0.02)))
    with pytest.raises(DataError, match="needs a map"):
        estimate_log(lost, "map_joint")


def test_uneven_stamps_are_refused_with_their_time(full):
    t = full.t.copy()
    t[401] += 0.004
    with pytest.raises(DataError, match=r"samples unevenly \(at t = 4\.01\d s by 4 ms of 10 ms\)"):
        estimate_log(replace(full, t=t), "joint")


def test_a_slow_inertial_unit_is_refused(full):
    slow = replace(full, t=4.0 * full.t)
    with pytest.raises(DataError, match="has 25 Hz, a filter needs 50 to 1000 Hz"):
        estimate_log(slow, "joint")


def test_the_wrong_drive_is_refused(full):
    wrong = replace(full, config=replace(full.config, model="paper"))
    with pytest.raises(DataError, match="model paper is driven by force, but drivetrain is torque"):
        estimate_log(wrong, "joint")


def test_soil_that_drowns_the_vehicle_is_refused(full):
    bog = full.config.soil._replace(k_phi=2e3, k_c=0.0)
    with pytest.raises(DataError, match="does not carry the vehicle"):
        estimate_log(replace(full, config=replace(full.config, soil=bog)), "joint")


def test_a_prior_with_which_the_soil_drowns_the_vehicle_is_blamed_on_the_option(full):
    bog = full.config.soil._replace(k_phi=2e3, k_c=0.0)
    soft = replace(full, config=replace(full.config, soil=bog))
    blamed = r"does not carry the vehicle with n_prior = 0\.5 \(its own n is 0\.7\)"
    with pytest.raises(DataError, match=blamed):
        estimate_log(soft, "joint", n_prior=0.5)


@pytest.mark.parametrize("n", [9.0, math.nan, math.inf, -0.7, 0.29, 1.31])
def test_a_prior_beyond_the_range_of_n_is_refused_as_the_option_that_it_is(n, full):
    with pytest.raises(InvalidParameter, match=rf"^n_prior must be in \[0\.3, 1\.3\], got {n}$"):
        estimate_log(full, "joint", n_prior=n)


@pytest.mark.parametrize("n", [0.3, 1.3])
def test_the_ends_of_the_range_of_priors_leave_room_to_look_in(n):
    low, high = usable_range(make_plant(VEHICLES["f1tenth"], make_soil("dry_sand"), flat()), n)
    assert low < n < high


def test_a_soil_beyond_the_range_of_priors_asks_for_the_option(full):
    steep = full.config.soil._replace(n=1.6)
    with pytest.raises(DataError, match=r"soil\.n of the description is 1\.6: give n_prior"):
        estimate_log(replace(full, config=replace(full.config, soil=steep)), "joint")


def test_an_unknown_filter_is_refused(full):
    with pytest.raises(InvalidParameter, match="filter must be one of " + ", ".join(LOG_FILTERS)):
        estimate_log(full, "kalman")


def test_a_prior_too_wide_for_the_range_is_refused(full):
    with pytest.raises(InvalidParameter, match="sd must be in"):
        estimate_log(full, "joint", sd=0.9)
