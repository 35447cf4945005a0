"""The world is natural: numbers have tolerances and soil scatters; neither is an error of a model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.corrected_log import corrected_log
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.faults.natural import natural_plant
from estimators.discrepancy.faults.other_forms import FAMILIES, OTHER_FORMS, WRONG_NUMBERS
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.natural_world import null_simulations
from estimators.discrepancy.model.nuisances import NUISANCES, acts, with_nuisances
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.search.holdout import HoldOutTest
from estimators.discrepancy.search.score_test import candidates_for, score_test
from estimators.logs import read_log, write_log
from estimators.logs.tolerances import TOLERANCES
from offroad_env.effects import EFFECTS, apply
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.natural_soil import SoilSpread, natural_soil, spread_within
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES


@pytest.fixture(scope="module")
def run() -> RunModel:
    log = simulated_log(draw_case(51, road="flat", duration=12.0, gnss=True, natural=True))
    return RunModel(log, use=FIT)


@pytest.fixture(scope="module")
def fitted(run) -> FitResult:
    return fit_runs([run])


def test_every_stated_number_has_a_tolerance_that_moves_the_drive_and_an_exact_log_has_none(run):
    exact = RunModel(replace(run.log, config=replace(run.log.config, exact=True)), use=FIT)
    tolerated = [nuisance for nuisance in NUISANCES if nuisance.tolerated]
    assert len(tolerated) >= len(TOLERANCES)
    for nuisance in tolerated:
        values = np.array([float(own is nuisance) for own in NUISANCES])
        assert acts(nuisance, run)
        assert not acts(nuisance, exact)
        before, after = run.setup.plant, with_nuisances(run, values).plant
        assert (before.vehicle, before.soil) != (after.vehicle, after.soil), nuisance.name
        same = with_nuisances(exact, values).plant
        assert (same.vehicle, same.soil) == (exact.setup.plant.vehicle, exact.setup.plant.soil)


def test_uneven_soil_widens_what_resistance_would_need_to_be_seen_and_even_soil_does_not(run, fitted):
    even = RunModel(replace(run.log, config=replace(run.log.config, exact=True)), use=FIT)
    names = ["rolling_resistance", "accel_bias_y"]
    fits = [fitted, fit_runs([even])]
    assert fits[0].null is not None
    assert fits[1].null is None
    natural, exact = (score_test(fit, candidates_for(fit, names)).limits() for fit in fits)
    assert natural["rolling_resistance"] > 2.0 * exact["rolling_resistance"]
    assert natural["accel_bias_y"] < 1.5 * exact["accel_bias_y"]


@pytest.mark.parametrize(
    ("n", "spread"), [(0.053, 0.001), (0.11, 0.02), (0.8, 0.03), (2.47, 0.01), (2.5, 0.0)]
)
def test_near_the_ends_of_its_range_n_varies_less(n, spread):
    assert spread_within(n).n == pytest.approx(spread)
    assert replace(spread_within(n), n=0.03) == SoilSpread()
    natural_soil(make_soil(SOILS["dry_sand"], n=n), 0, spread=spread_within(n))


def test_a_fit_that_ends_where_no_more_n_is_possible_has_null_simulations(fitted):
    """A vehicle with a large hidden cause did; its whole diagnosis was lost."""
    names = [nuisance.name for nuisance in fitted.problem.nuisances]
    low, _ = fitted.problem.limits(())
    nuisances = fitted.nuisances.copy()
    nuisances[names.index("ground")] = low[names.index("ground")]
    there = fitted.moved(replace(fitted.point, nuisances=nuisances))
    (setup,) = there.linearisation.setups
    assert setup.plant.soil.n == pytest.approx(0.05)
    assert null_simulations(there) is not None


def test_the_description_says_whether_its_numbers_are_exact(tmp_path):
    for natural in (False, True):
        log = simulated_log(draw_case(9, duration=5.0, natural=natural))
        assert read_log(write_log(tmp_path / f"{natural}.csv", log)).config.exact is not natural


def test_natural_vehicles_scatter_by_their_tolerances():
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat())
    drawn = [natural_plant(plant, np.random.default_rng([i])) for i in range(200)]
    for name, tolerance in (("m", "m"), ("I_z", "I_z"), ("k_f", "springs"), ("c_r", "dampers")):
        share = [getattr(one.vehicle, name) / getattr(plant.vehicle, name) - 1.0 for one in drawn]
        assert np.std(share) == pytest.approx(TOLERANCES[tolerance], rel=0.2), name
    strength = [math.log(math.tan(one.soil.phi) / math.tan(plant.soil.phi)) for one in drawn]
    assert np.std(strength) == pytest.approx(TOLERANCES["tan_phi"], rel=0.2)
    assert all(one.soil_field is not None for one in drawn)


def test_every_fault_of_another_form_has_a_family_and_departs_from_the_library(run):
    assert set(FAMILIES) == {*OTHER_FORMS, *WRONG_NUMBERS}
    assert all(effect in EFFECTS for family in FAMILIES.values() for effect in family)
    case = draw_case(9, road="flat", duration=8.0, gnss=True)
    sizes = {"steer_lag": 0.1, "steer_gain": 0.1, "payload": 0.3, "grouser_thrust": 0.1, "torque_scale": 0.1}
    plain = simulated_log(case).channels
    for name, size in sizes.items():
        other, own = (simulated_log(case, make(size)).channels for make in (OTHER_FORMS[name], FAULTS[name]))
        channel = "yaw_rate" if name.startswith("steer") else "omega_f"
        assert not np.array_equal(other[channel], plain[channel]), name
        assert not np.array_equal(other[channel], own[channel]), name


def test_a_corrected_log_has_lost_the_errors_of_its_sensors_and_inputs(run):
    effects = {"accel_bias_y": 0.4, "wheel_radius_scale": 0.05, "steer_offset": 0.02}
    effects |= {"drive_scale": 0.1, "brake_scale": -0.2}
    values = [(name, {EFFECTS[name].size.name: size}) for name, size in effects.items()]
    # With brakes that act now and then.
    torque = run.log.channels["torque_f"] - 600.0
    log = replace(run.log, channels=run.log.channels | {"torque_f": torque})
    found = corrected_log(log, apply(run.setup, values), run.setup).channels
    assert found["a_y"] == pytest.approx(log.channels["a_y"] - 0.4)
    assert found["omega_r"] == pytest.approx(log.channels["omega_r"] / 1.05, nan_ok=True)
    rows = ~np.isnan(log.channels["steer"])
    assert found["steer"][rows] == pytest.approx(log.channels["steer"][rows] + 0.02, abs=1e-6)
    torque = torque[rows]
    assert torque.min() < 0.0 < torque.max()
    assert found["torque_f"][rows] == pytest.approx(np.where(torque > 0.0, 1.1, 0.8) * torque, rel=1e-6)
    same = corrected_log(log, run.setup, run.setup).channels
    assert same["a_y"] == pytest.approx(log.channels["a_y"])


@pytest.mark.check
def test_a_load_that_a_tolerance_could_stand_in_for_is_not_refused_by_windows_that_scatter():
    fault = OTHER_FORMS["payload"](0.173)
    result = diagnose([simulated_log(draw_case(7000, road="unknown", natural=True), fault)])
    assert not result.search.refused
    named = {one.candidate.effect for cause in result.causes for one in cause.alternatives}
    assert named & set(FAMILIES["payload"])


def test_the_hold_out_test_of_a_natural_drive_simulates_the_scatter_of_its_own_windows(run, fitted):
    # A descent from far away, which ends beside the minimum: the models must differ.
    begun = fitted.with_effects([Candidate(effect="rolling_resistance")], np.array([0.05]))
    larger = GaussNewton().descend(begun, fresh=False)
    result = HoldOutTest(fitted, [run]).result(larger)
    assert result.inflation > 2.0
    exact = replace(fitted, null=None)
    assert HoldOutTest(exact, [run]).result(replace(larger, null=None)).inflation == 1.0
