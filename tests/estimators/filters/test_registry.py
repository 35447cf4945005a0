"""One id for every filter: what stands under it, and the short names that lead to it."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from estimators.experiments import filter_comparison, mismatch_comparison
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.filter_comparison import row_run
from estimators.experiments.simulated_rows import simulate_row
from estimators.filters.belief_history import BeliefHistory, history_of_estimates
from estimators.filters.joint_ukf import run_joint_filter
from estimators.filters.navigation import NavigationNoise
from estimators.filters.online import KINDS, OnBoard, Thinned, make_estimator
from estimators.filters.protocol import Estimate
from estimators.filters.registry import FILTERS, MAP_FILTERS, ONLINE_FILTERS, SENSORS, SOIL_FILTERS, filter_id
from estimators.filters.whole_run import run_filter
from estimators.log_estimation import LOG_FILTERS
from estimators.models.half_car_on_map import CHANNELS, ETA, JointSettings
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES


def test_every_table_of_filters_holds_ids_of_the_registry():
    for table in (filter_comparison.COMPARED, mismatch_comparison.COMPARED, LOG_FILTERS, KINDS):
        assert set(table) <= set(FILTERS)
    assert not set(ONLINE_FILTERS) & set(MAP_FILTERS)


@pytest.mark.parametrize("name", FILTERS)
def test_an_entry_names_its_module_and_sensors(name):
    entry = FILTERS[name]
    assert importlib.import_module(entry.module).__doc__
    assert max(SENSORS[entry.sensors]) < len(CHANNELS)
    assert entry.id == name
    assert name not in entry.aliases


@pytest.mark.parametrize(
    ("short", "among", "meant"),
    [
        ("joint", ONLINE_FILTERS, "online_joint_ukf"),
        ("joint", filter_comparison.COMPARED, "map_joint_ukf"),
        ("bank", mismatch_comparison.COMPARED, "map_ukf_bank"),
        ("bank", LOG_FILTERS, "online_ukf_bank"),
        ("map_bank", LOG_FILTERS, "map_ukf_bank"),
        ("robust", FILTERS, "augmented_ekf_bank"),
        ("embedded", FILTERS, "online_parameter_ukf"),
        ("map_ekf", FILTERS, "map_ekf"),
    ],
)
def test_a_short_name_means_one_filter_where_it_is_written(short, among, meant):
    assert filter_id(short, among) == meant


def test_an_unknown_name_is_refused_with_the_names_there_are():
    with pytest.raises(InvalidParameter, match=r"kind must be one of .*online_ukf_bank.*'kalman'"):
        filter_id("kalman", ONLINE_FILTERS, label="kind")
    assert filter_id("none", ONLINE_FILTERS, besides=("none",)) == "none"


def test_a_kind_is_kept_under_its_id():
    assert OnBoard(kind="joint") == OnBoard(kind="online_joint_ukf") == OnBoard()


_APART = ("parameter_ukf_known_state", *SOIL_FILTERS)
#: Compiled for longer than all others together.
_LONG = ("augmented_ekf_bank", "map_ekf", "map_particle_filter", "map_smoother", "map_ukf_bank")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.check] * (name in _LONG))
        for name in FILTERS
        if name not in _APART
    ],
)
def test_every_filter_runs_on_the_same_description_of_a_run(name):
    drive = simulate_row(ROWS[6], 101, JointSettings(), duration=0.3)
    history = run_filter(name, row_run(drive, sensors="imu+wheels+gnss"))
    assert isinstance(history, BeliefHistory)
    for column in (history.t, history.n, history.sd, history.low, history.high, history.nis, history.flag):
        assert column.shape == drive.n.shape
    assert (history.low <= history.n).all()
    assert (history.n <= history.high).all()
    assert history.channels
    assert history.seconds is not None


def test_a_belief_over_whole_soils_keeps_no_history_of_n_alone():
    drive = simulate_row(ROWS[6], 101, JointSettings(), duration=0.1)
    with pytest.raises(InvalidParameter, match="filter must be one of"):
        run_filter("online_soil_belief", row_run(drive, sensors="imu+wheels+gnss"))


def test_a_known_state_must_be_given():
    drive = simulate_row(ROWS[6], 101, JointSettings(), duration=0.1)
    with pytest.raises(InvalidParameter, match="needs the true states"):
        run_filter("parameter_ukf_known_state", row_run(drive))


def test_only_the_filter_of_known_states_sees_them():
    drive = simulate_row(ROWS[6], 101, JointSettings(), duration=0.3)
    run, states = row_run(drive), np.zeros((len(drive.z), at.STATE_SIZE))
    states[:, :ETA] = drive.truth[:, :ETA]
    blind, seeing = (run_filter("parameter_ukf", one) for one in (run, replace(run, known=states)))
    known = run_filter("parameter_ukf_known_state", replace(run, known=states))
    assert (seeing.n == blind.n).all()
    assert (known.n != blind.n).any()


def test_a_history_of_estimates_has_an_interval_inside_the_range():
    estimates = [Estimate(0.5, 0.3, np.nan, False, 0), Estimate(0.6, 0.01, 3.0, True, 2)]
    history = history_of_estimates(np.array([0.0, 0.01]), estimates, (0.2, 1.4), channels=3)
    assert history.low[0] == 0.2
    assert history.high[1] == pytest.approx(0.6196, abs=1e-4)
    assert (history.repairs, history.channels) == (2, 3)
    assert list(history.flag) == [False, True]


def test_a_history_without_flag_or_time_refuses_to_make_them_up():
    t = np.array([0.0, 0.01])
    history = BeliefHistory(t=t, n=t, sd=t, low=t, high=t, nis=t)
    with pytest.raises(InvalidParameter, match="no validity flag"):
        _ = history.flag
    with pytest.raises(InvalidParameter, match="not timed"):
        _ = history.real_time_factor


def test_the_flag_and_the_count_of_channels_are_added_to_a_filter_without_them():
    drive = simulate_row(ROWS[6], 101, JointSettings(), duration=0.3)
    run = row_run(drive)
    model_run = run_filter("map_joint_ukf", run)
    assert model_run.channels == 5
    assert not model_run.flag.any(), "not before the innovations have been watched for 2 s"
    assert run_joint_filter.__module__ == FILTERS["map_joint_ukf"].module


@pytest.mark.parametrize("name", [name for name, entry in FILTERS.items() if entry.make is not None])
def test_every_filter_on_board_navigates_with_the_noise_of_its_sensors(name: str) -> None:
    imu = ImuConfig(accel_bias_sd=0.2, misalignment_sd=(0.02, 0.0, 0.0))
    receiver = GnssConfig(position_sd=2.0, velocity_sd=0.3, latency=0.1)
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat(), model="full")
    own = make_estimator(OnBoard(kind=name), plant, (0.3, 1.1), imu, receiver)
    inner = own.inner if isinstance(own, Thinned) else own
    assert inner.navigation.noise == NavigationNoise.of(receiver, imu)
