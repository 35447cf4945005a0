"""The belief over the soil: it finds the soil of a drive, states its errors, and does not read the answer."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from estimators.belief import soil_belief
from estimators.belief.fit import Fit, fit_unknowns
from estimators.belief.forecast import prediction_errors
from estimators.belief.limits import HELD, limits_of, sampled_limits
from estimators.belief.soil_belief import SoilBelief, StructureFit, believe_log, mixture
from estimators.belief.structure_choice import structure_weights
from estimators.belief.unknowns import MODULUS, PHI, UNKNOWN_NAMES, N, Tolerances, applied, unknowns_of
from estimators.belief.windows import COMPARED, LogWindows, cut
from estimators.logs import Log, log_from_run
from estimators.replay.structures import Case, plant_for
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, make_plant, settled_state, simulate_commands
from offroad_env.simulation.soil_holds import what_soil_holds
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

STEP, TRUE_N, TRUE_PHI = 0.01, 0.62, 0.55


def drive(structure: str = "grid", duration: float = 11.0) -> Log:
    """A vehicle that weaves, drives and slows down on sand; its description states another n and phi."""
    soil = make_soil(k_c=20e3, k_phi=1.2e6, n=TRUE_N, c=1200.0, phi=TRUE_PHI, k_x=0.015)
    plant = make_plant(VEHICLES["mrzr"], soil, flat(), structure=structure)
    t = STEP * np.arange(round(duration / STEP))
    effort = 900.0 + 800.0 * np.sin(1.1 * t)
    commands = np.column_stack([0.14 * np.sin(1.6 * t), np.maximum(effort, 0.0), np.maximum(-effort, 0.0)])
    run = simulate_commands(plant, *settled_state(plant, v_x=4.0), commands, interval=STEP)
    sensors = SensorSuite(
        imu=ImuConfig(),
        wheel=WheelSpeedConfig(rate=100.0, noise=0.01, scale_sd=0.0),
        gnss=GnssConfig(rate=5.0, position_sd=0.03, velocity_sd=0.03),
    )
    stated = plant._replace(soil=soil._replace(n=0.8, phi=0.45))
    log = log_from_run(run, plant, commands, sensors, np.random.default_rng(2), belief=stated, name="weave")
    # As a log from elsewhere, which states no structure.
    return replace(log, config=replace(log.config, structure="full"))


@pytest.fixture(scope="module")
def log() -> Log:
    return drive()


@pytest.fixture(scope="module")
def belief(log) -> SoilBelief:
    return believe_log(log, structures=("full", "grid"))


def test_the_soil_of_a_drive_is_found_without_its_structure(belief):
    n, phi = belief.marginal(N), belief.marginal(PHI)
    assert n.low < TRUE_N < n.high
    assert phi.low < TRUE_PHI < phi.high
    assert abs(n.mean - TRUE_N) < 0.06
    assert abs(phi.mean - TRUE_PHI) < 0.08
    assert n.high - n.low < 0.25
    assert belief.answered
    assert belief.parts[0].case.structure == "grid"
    assert sum(part.weight for part in belief.parts) == pytest.approx(1.0)


def test_n_and_phi_of_the_description_are_not_read(log):
    other = replace(log, config=replace(log.config, soil=log.config.soil._replace(n=1.1, phi=0.3)))
    values, case = unknowns_of().mean, Case("grid", "half_car")
    first, second = (cut(one).residuals(plant_for(one, case), values) for one in (log, other))
    np.testing.assert_array_equal(first, second)


def test_what_the_soil_holds_is_covered(log, belief):
    truth = log.config.soil._replace(n=TRUE_N, phi=TRUE_PHI)
    held = what_soil_holds(make_plant(log.vehicle, truth, flat(), structure="grid"))
    found = limits_of(sampled_limits(belief, draws=60))
    assert set(found) == set(HELD)
    for name in ("lateral", "pull", "resistance", "sinkage", "stopping"):
        assert found[name].low < getattr(held, name) < found[name].high, name
        assert found[name].sd < 0.3 * found[name].mean, name


def test_the_fitted_model_predicts_the_drive_some_seconds_ahead(belief):
    errors = prediction_errors(belief)
    assert set(errors) == {"1", "3", "10"}
    assert errors["3"]["position"] < 0.1
    assert errors["1"]["speed"] < 0.05


def test_a_drive_on_hard_ground_or_without_torque_is_refused(log):
    hard = log.config.soil._replace(rigid=1.0)
    with pytest.raises(DataError, match="no sinkage exponent"):
        believe_log(replace(log, config=replace(log.config, soil=hard)))
    channels = {name: values for name, values in log.channels.items() if not name.startswith("torque")}
    with pytest.raises(DataError, match="torque_f or torque_r"):
        believe_log(replace(log, channels=channels))


# ------------------------------------------------------------------ tolerances


def test_a_less_certain_description_gives_a_wider_interval(log):
    """Half as wide a tolerance, or twice, changes the width of n by a fifth at least."""
    windows, case = cut(log), Case("grid", "half_car")
    start = unknowns_of().mean.copy()
    start[[N, PHI]] = TRUE_N, TRUE_PHI
    sds = []
    for soil in (0.025, 0.05, 0.1):
        unknowns = unknowns_of(Tolerances(soil=soil))
        fit = fit_unknowns(windows, plant_for(log, case), unknowns, start, iterations=1)
        sds.append(np.sqrt(fit.covariance[N, N]))
    assert sds[1] > 1.1 * sds[0]
    assert sds[2] > 1.2 * sds[1]


@pytest.mark.parametrize("value", [0.0, -0.1, 5.0])
def test_an_impossible_tolerance_is_refused(value):
    with pytest.raises(InvalidParameter, match=r"tolerance of mass must be in \(0, 0.5\]"):
        Tolerances(mass=value)


def test_unknowns_change_what_they_are_named_after(log):
    plant, windows = plant_for(log, Case("full", "half_car")), cut(log)
    for name, field in (("modulus", "k_phi"), ("c", "c"), ("K", "k_x")):
        values = unknowns_of().mean.copy()
        values[UNKNOWN_NAMES.index(name)] = np.log(1.1)
        moved, _ = applied(plant, windows.inputs, values)
        assert getattr(moved.soil, field) == pytest.approx(1.1 * getattr(plant.soil, field))
        assert moved.soil.n == values[N]
    values[UNKNOWN_NAMES.index("mass")] = np.log(1.02)
    assert applied(plant, windows.inputs, values)[0].vehicle.m == pytest.approx(1.02 * plant.vehicle.m)
    values[UNKNOWN_NAMES.index("torque")] = np.log(1.02)
    moved_inputs = applied(plant, windows.inputs, values)[1]
    np.testing.assert_allclose(moved_inputs.begin[:, 1:], 1.02 * windows.inputs.begin[:, 1:])


# ------------------------------------------------------------------ structures and flags


def fake_fit(residual: float | np.ndarray, n: float = 0.7, sd: float = 0.02, *, noise: float = 0.0) -> Fit:
    """A fit whose windows all miss by this much."""
    windows = 12
    values = unknowns_of().mean.copy()
    values[N] = n
    alone = np.ones((windows, 4, len(COMPARED))) * np.reshape(residual, (-1, 1, 1))
    return Fit(
        values=values,
        covariance=sd**2 * np.eye(len(values)),
        loss=0.0,
        alone=alone,
        noise=np.full(windows, noise),
    )


def fake_belief(*parts: tuple[Fit, float]) -> SoilBelief:
    chosen = tuple(
        StructureFit(case=Case(f"s{i}", "half_car"), weight=weight, fit=fit)
        for i, (fit, weight) in enumerate(parts)
    )
    windows = object.__new__(LogWindows)
    return SoilBelief(log="x", parts=chosen, windows=windows, unknowns=unknowns_of(), left_out=())


def test_structures_between_which_windows_do_not_decide_share_the_weight():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0.3, 0.5, (2, 12))
    a[::2], b[1::2] = b[::2], a[1::2]
    even = structure_weights([fake_fit(a), fake_fit(a[::-1])])
    np.testing.assert_allclose(even, 0.5, atol=0.2)
    clear = structure_weights([fake_fit(0.3), fake_fit(0.6)])
    assert clear[0] > 0.99


def test_a_gross_miss_in_one_window_does_not_outweigh_the_others():
    """The sum of squares would: one window of twelve is missed five times as far, eleven are met better."""
    odd = np.full(12, 0.2)
    odd[5] = 1.5
    weights = structure_weights([fake_fit(0.3), fake_fit(odd)])
    assert (odd**2).sum() > 12 * 0.3**2
    assert weights[1] > 0.1


def test_an_interval_spans_structures_that_disagree():
    both = mixture([0.5, 0.5], np.array([0.5, 0.9]), np.array([0.02, 0.02]))
    assert both.mean == pytest.approx(0.7)
    assert both.low < 0.5
    assert both.high > 0.9
    single = mixture([1.0], np.array([0.5]), np.array([0.02]))
    assert single.high - single.low == pytest.approx(2.0 * 1.96 * 0.02, rel=1e-3)


def test_the_flag_goes_down_where_no_structure_predicts_the_drive():
    limit = soil_belief.ADEQUATE
    assert fake_belief((fake_fit(0.7 * limit), 1.0)).valid
    assert not fake_belief((fake_fit(1.4 * limit), 1.0)).valid


def test_an_unknown_at_an_end_of_its_range_takes_the_flag_down():
    """Torques of a motor, say, before its gears: no soil explains the drive, though a fit may follow it."""
    for place, value, name in ((PHI, 0.899, "phi"), (N, 0.055, "n"), (MODULUS, -0.699, "modulus")):
        fit = fake_fit(0.3)
        fit.values[place] = value
        ended = fake_belief((fit, 1.0))
        assert ended.at_ends == (name,)
        assert not ended.valid
        fit.values[place] += 0.03 * (1.0 if value < 0.5 else -1.0)
        assert fake_belief((fit, 1.0)).valid


def test_an_interval_ends_where_the_range_does():
    wide = fake_belief((fake_fit(0.3, sd=1.0), 1.0)).marginal(PHI)
    assert (wide.low, wide.high) == (0.03, 0.9)


def test_a_window_counts_as_predicted_up_to_its_scale():
    """Moved by a factor of two either way, the limit would count other windows."""
    halves = np.repeat([0.7, 1.4], 6)
    assert fake_belief((fake_fit(halves), 1.0)).valid_share == pytest.approx(0.5)


def test_an_answer_needs_a_narrow_interval():
    assert fake_belief((fake_fit(0.2, sd=0.05), 1.0)).answered
    assert not fake_belief((fake_fit(0.2, sd=0.1), 1.0)).answered


def test_what_the_best_model_leaves_unexplained_widens_every_interval():
    narrow, wide = (fake_belief((fake_fit(left, sd=1e-6), 1.0)) for left in (0.4, 0.8))
    assert 0.7 < narrow.marginal(N).sd / 0.02 < 1.4
    assert 0.7 < narrow.marginal(PHI).sd / 0.032 < 1.4
    assert wide.marginal(N).sd == pytest.approx(2.0 * narrow.marginal(N).sd, rel=1e-3)
    assert fake_belief((fake_fit(0.3, sd=0.01), 1.0)).marginal(MODULUS).sd == pytest.approx(0.01, rel=1e-3)


def test_what_the_noise_of_the_sensors_explains_is_no_model_error():
    """Moved by a factor of two, the noise would leave a discrepancy, or hide one."""
    sds = [fake_belief((fake_fit(left, sd=1e-3, noise=0.4), 1.0)).marginal(N).sd for left in (0.3, 0.4, 0.5)]
    assert sds[:2] == pytest.approx([1e-3, 1e-3])
    assert 0.7 < sds[2] / (0.05 * 0.3) < 1.4
    assert fake_belief((fake_fit(1.3, noise=1.0), 1.0)).valid
    assert not fake_belief((fake_fit(1.6, noise=1.0), 1.0)).valid


def test_the_noise_of_the_sensors_is_that_which_a_true_model_leaves(log):
    """It is an upper bound: speeds that are wrong at the start of a window become right again."""
    truth = unknowns_of().mean.copy()
    truth[[N, PHI]] = TRUE_N, TRUE_PHI
    windows = cut(log)
    left = windows.residuals(plant_for(log, Case("grid", "half_car")), truth)
    found = float(np.median(np.sqrt((left**2).mean(axis=(1, 2)))))
    assert 0.3 < found / float(np.median(windows.noise)) < 0.8


def test_most_of_a_drive_must_be_predicted():
    """A quarter is too little, three quarters are enough."""
    for count, valid in ((4, False), (8, True)):
        windows = np.where(np.arange(12) < count, 0.3, 3.0)
        assert fake_belief((fake_fit(windows), 1.0)).valid is valid


def test_the_wheels_that_are_stated_count_more_where_the_drive_does_not_decide():
    even = [fake_fit(0.4), fake_fit(0.4)]
    assert structure_weights(even)[1] == pytest.approx(0.5)
    found = structure_weights(even, [1.0, soil_belief._FOUR_WHEELS])[1]
    assert 0.87 < found < 0.94  # 5 to 1 gives 0.83, 20 to 1 gives 0.95
    clear = structure_weights([fake_fit(0.3), fake_fit(0.6)], [1.0, soil_belief._FOUR_WHEELS])
    assert clear[0] > 0.99


def test_a_window_that_gave_way_only_at_the_start_counts_in_the_end() -> None:
    unknowns = unknowns_of()
    true = unknowns.mean.copy()
    true[N] += 0.3
    slopes = 0.3 * np.random.default_rng(0).normal(size=(12, 4, 6, len(true)))
    slopes[..., N] *= 30.0

    class Windows:
        noise = np.zeros(12)

        def residuals(self, plant: object, values: np.ndarray) -> np.ndarray:
            found: np.ndarray = slopes @ (values - true)
            if values[N] < unknowns.mean[N] + 0.05:
                found[:6] = np.nan
            return found

    shares: list[float] = []
    windows, plant = cast("LogWindows", Windows()), cast("Plant", None)
    fit = fit_unknowns(windows, plant, unknowns, unknowns.mean, report=shares.append)
    assert 0.0 < shares[0] < shares[1] <= shares[-1] < 1.0
    assert fit.values[N] == pytest.approx(true[N], abs=0.01)
    assert np.isfinite(fit.alone).all()
    assert (fit.misfit < 0.5).all()


def test_a_value_at_the_end_of_its_range_lies_in_its_interval(belief) -> None:
    """The mean of a mixture is rounded: an interval that ended below it could not be drawn."""
    high = belief.unknowns.bounds[1]
    part = belief.parts[0]
    values = part.fit.values.copy()
    values[PHI] = high[PHI] * (1.0 + 1e-15)
    ended = replace(belief, parts=(replace(part, weight=1.0, fit=replace(part.fit, values=values)),))
    phi = ended.marginal(PHI)
    assert phi.low <= phi.mean <= phi.high == high[PHI]
