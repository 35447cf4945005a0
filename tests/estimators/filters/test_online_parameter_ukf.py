"""The estimator on board: is it right, does it know when it is not, and does it see sensors only?"""

from __future__ import annotations

import numpy as np
import pytest
from on_board import N_RANGE, PRIOR, estimates_of, parameter_filter, pose_of

from estimators.experiments.buzhardt_tallapragada import ROWS, noisy_imu, row_truth
from estimators.filters.navigation import NavigationFilter
from estimators.filters.online_parameter_ukf import CHANGING_SOIL, OnlineParameterSettings, OnlineParameterUKF
from estimators.filters.protocol import Pose
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES, make_vehicle


@pytest.fixture(scope="module")
def episodes(drive):
    """(true n, estimates) of twenty random drives of 10 s: sand over the whole range, and clay that bears."""
    rng = np.random.default_rng(2024)
    found = []
    for seed in range(20):
        soil, high = ("clay", 0.55) if seed % 4 == 3 else ("dry_sand", 1.1)
        n = rng.uniform(0.3, high)
        found.append((n, estimates_of(drive(n, seed=seed, soil=soil), parameter_filter(soil))))
    return found


def test_within_ten_seconds_n_is_known_to_a_few_per_cent(episodes):
    errors = [abs(estimates[-1].mean - n) / n for n, estimates in episodes]
    assert np.median(errors) < 0.03
    assert max(errors) < 0.15


@pytest.mark.parametrize("time", [2.0, 5.0, 10.0])
def test_the_interval_covers_the_truth(episodes, time):
    row = round(100 * time) - 1
    inside = [abs(e[row].mean - n) < 1.96 * e[row].sd for n, e in episodes]
    assert np.mean(inside) >= 0.9


def test_the_twin_is_always_valid_and_needs_no_repair(episodes):
    for _, estimates in episodes:
        assert all(estimate.valid for estimate in estimates)
        assert estimates[-1].repairs == 0


def test_driving_narrows_the_belief(episodes):
    for _, estimates in episodes:
        assert estimates[-1].sd < 0.25 * PRIOR[1]


def test_at_rest_the_estimate_holds_and_its_sd_grows():
    estimator = parameter_filter()
    first = estimator.reset(0.6, 0.05, Pose(0.0, 0.0, 0.0, 0.0))
    rng = np.random.default_rng(0)
    noise = np.array([0.2, 0.2, 0.2, 0.0175, 0.0175])
    sds = [first.sd]
    for _ in range(2000):
        imu = noise * rng.normal(size=5)
        estimate = estimator.update((0.0, 0.0, 5000.0), imu, np.zeros(2), np.full(4, np.nan))
        sds.append(estimate.sd)
    assert estimator.held
    assert estimate.mean == pytest.approx(
        first.mean, abs=2e-3
    )  # the skew of a wider belief moves it a little
    assert np.all(np.diff(sds) > 0.0)
    assert sds[-1] > 1.1 * sds[0]


def test_a_stuck_vehicle_keeps_what_it_learnt(drive):
    drive = drive(0.54, seed=1, soil="clay", duration=20.0, driver=lambda t, v: (0.0, 2500.0, 0.0))
    assert drive.states[-1, at.V_X] < 0.3
    estimator = parameter_filter("clay")
    estimates = estimates_of(drive, estimator)
    assert estimator.held
    assert estimates[-1].mean == pytest.approx(0.54, abs=2.0 * estimates[-1].sd)
    assert estimates[-1].sd > estimates[1000].sd


def test_it_wakes_up_after_a_stop(drive):
    def stop_and_go(t, v):
        if 3.0 < t < 6.0:
            return 0.0, 0.0, 4000.0
        return 0.1 * np.sin(t), 1800.0, 0.0

    drive = drive(0.5, seed=6, duration=14.0, driver=stop_and_go)
    assert drive.states[600, at.V_X] < 0.1
    estimates = estimates_of(drive, parameter_filter())
    assert estimates[-1].mean == pytest.approx(0.5, abs=0.05)
    assert estimates[-1].sd < estimates[600].sd


def test_a_wrong_mass_moves_the_estimate_towards_more_resistance(drive):
    # A lighter vehicle than believed is taken to roll on firmer ground, and the other way round.
    drive = drive(0.7, seed=9)
    heavier = make_vehicle("mrzr", m=1.1 * VEHICLES["mrzr"].m)
    right = estimates_of(drive, parameter_filter())[-1].mean
    assert estimates_of(drive, parameter_filter(vehicle=heavier))[-1].mean < right - 0.03


@pytest.fixture(scope="module")
def edges(edge_drives):
    return [(truth, estimates_of(drive, parameter_filter())) for truth, drive in edge_drives]


def test_another_soil_is_followed_within_three_seconds(edges):
    for truth, estimates in edges:
        begin = int(np.argmax(truth != truth[0]))
        assert 300 < begin < len(truth) - 300
        mean = np.array([estimate.mean for estimate in estimates])
        half = np.abs(mean[begin : begin + 150] - truth[0]) > 0.5 * abs(truth[-1] - truth[0])
        assert half.any()  # half way within 1.5 s
        assert abs(mean[begin + 300] - truth[-1]) < 0.05 * truth[-1]


def test_while_a_change_is_followed_the_flag_is_down_or_the_band_holds_the_truth(edges):
    for truth, estimates in edges:
        begin = int(np.argmax(truth != truth[0]))
        # Half a second passes before it can be noticed: then, until it has been followed.
        after = zip(estimates[begin + 120 : begin + 300], truth[begin + 120 : begin + 300], strict=True)
        honest = [not e.valid or abs(e.mean - n) < 1.96 * e.sd for e, n in after]
        assert np.mean(honest) > 0.9
        assert not all(estimates[k].valid for k in range(begin, begin + 150))


def test_no_change_is_noticed_where_there_is_none(drive):
    for seed, n in ((510, 0.4), (511, 0.9)):
        estimator = parameter_filter()
        estimates_of(drive(n, seed=seed, duration=20.0), estimator)
        assert estimator.changes == 0


@pytest.fixture(scope="module")
def told(edge_drives):
    """As `edges`, by a filter that is told that the soil changes."""
    return [estimates_of(drive, parameter_filter(settings=CHANGING_SOIL)) for _, drive in edge_drives]


def test_who_is_told_that_the_soil_changes_knows_the_new_one_in_half_a_second(edges, told):
    for (truth, untold), estimates in zip(edges, told, strict=True):
        begin = int(np.argmax(truth != truth[0]))
        after = slice(begin, begin + 100)
        errors = [np.array([e.mean for e in run[after]]) - truth[after] for run in (untold, estimates)]
        assert abs(errors[1][50]) < 0.1
        assert np.square(errors[1]).mean() < 0.5 * np.square(errors[0]).mean()


def test_who_is_told_that_the_soil_changes_is_honest_all_along(edges, told):
    for (truth, _), estimates in zip(edges, told, strict=True):
        assert np.mean([abs(e.mean - n) < 1.96 * e.sd for e, n in zip(estimates, truth, strict=True)]) > 0.95
        assert np.mean([estimate.valid for estimate in estimates]) > 0.95


def test_soil_that_rests_is_known_less_well_by_who_is_told_that_it_changes(drive):
    drive = drive(0.4, seed=510, duration=20.0)
    told = parameter_filter(settings=CHANGING_SOIL)
    last = [estimates_of(drive, estimator)[-1] for estimator in (parameter_filter(), told)]
    assert told.changes == 0
    assert abs(last[1].mean - 0.4) < 1.96 * last[1].sd
    assert last[1].sd > 2.0 * last[0].sd


@pytest.mark.parametrize(("settings", "heard"), [(OnlineParameterSettings(), False), (CHANGING_SOIL, True)])
def test_rims_tell_of_the_soil_only_where_it_is_known_to_change(drive, settings, heard):
    drive = drive(0.6, seed=15, duration=2.0)
    navigation = NavigationFilter(VEHICLES["mrzr"])
    navigation.reset(*pose_of(drive.states[0]))
    plant = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=0.7), flat())
    hearing, deaf = (
        OnlineParameterUKF(plant, N_RANGE, settings=settings, navigation=navigation) for _ in range(2)
    )
    for estimator in (hearing, deaf):
        estimator.reset(*PRIOR, navigation.pose)
    for command, imu, rims, gnss in drive.samples():
        navigation.update(imu, rims, command[0], gnss, 0.01)
        estimates = (
            hearing.update(command, imu, rims, gnss),
            deaf.update(command, imu, np.full(2, np.nan), gnss),
        )
    assert (estimates[0] != estimates[1]) == heard


def test_a_rim_error_of_nothing_is_refused():
    with pytest.raises(InvalidParameter, match="rim_error must be > 0"):
        OnlineParameterSettings(rim_error=0.0)


def test_the_papers_plant_is_a_belief_too():
    row = ROWS[6]
    truth = row_truth(row, duration=20.0)
    plant = make_plant(
        VEHICLES["paper"], make_soil(row.soil), paper_terrain(row.H0), model="paper", slip=truth.slip
    )
    estimator = OnlineParameterUKF(plant, (0.4, 1.4))
    estimator.reset(0.8, 0.2, pose_of(truth.run.states[0]))
    rng = np.random.default_rng(0)
    x, nothing = truth.run.states, np.full(4, np.nan)
    for k, imu in enumerate(noisy_imu(truth, 0)[1:], start=1):
        fix = nothing
        if k % 10 == 0:
            speed = np.hypot(x[k, at.V_X], x[k, at.V_Y])
            course = x[k, at.YAW] + np.arctan2(x[k, at.V_Y], x[k, at.V_X])
            fix = np.array([x[k, at.X], x[k, at.Y], speed, course]) + 0.03 * rng.normal(size=4)
        command = (float(truth.inputs[2 * k - 1, 0]), float(truth.inputs[2 * k - 1, 1]), np.nan)
        estimate = estimator.update(command, imu, nothing[:2], fix)
    assert estimate.mean == pytest.approx(truth.n, abs=0.1)
    assert estimate.sd < 0.1
