"""Sizes that physics allows: a fit of a drive stays within them, and their ends are never named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.manoeuvres import MENU, driven
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.physical_ranges import NEVER_NEGATIVE, at_end, drive_range
from estimators.discrepancy.search.refitting import refit
from estimators.discrepancy.search.result import Alternative, Cause
from estimators.discrepancy.search.score_test import _possible_share, score_test
from estimators.discrepancy.stated_model import model_with
from estimators.discrepancy.verdict import VehicleDiagnosis
from offroad_env.effects import EFFECTS, Setup
from offroad_env.errors import DataError
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES


@pytest.fixture(scope="module")
def pulled():
    """The nominal fit to a drive that something pulls along: a resistance of negative sign."""
    log = simulated_log(draw_case(41, road="flat", duration=12.0), FAULTS["rolling_resistance"](-0.04))
    return fit_runs([RunModel(log, use=FIT)])


@pytest.mark.parametrize("name", VEHICLES)
def test_every_range_holds_the_stated_vehicle_and_what_is_believable_of_a_resistance(name):
    setup = SimpleNamespace(plant=make_plant(VEHICLES[name], SOILS["clay"], flat()))
    for effect in EFFECTS.values():
        low, high = drive_range(effect.id, setup)
        assert low <= effect.size.off <= high
        assert effect.size.low <= low < high <= effect.size.high
    for effect in NEVER_NEGATIVE:
        assert drive_range(effect, setup)[0] == EFFECTS[effect].size.off


def test_a_vehicle_stays_one_within_the_ranges_of_its_numbers():
    """The centre of gravity above the hubs, the mass and inertia of a vehicle, springs that hold a body."""
    plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], flat())
    setup, v = SimpleNamespace(plant=plant), plant.vehicle
    low, high = drive_range("cg_height", setup)
    assert v.h_cg * (1.0 + low) == pytest.approx(v.r)
    assert v.h_cg * (1.0 + high) == pytest.approx(4.0 * v.r)
    index = [(1.0 + end) * v.I_z / (v.m * v.l_f * v.l_r) for end in drive_range("inertia", setup)]
    assert index == pytest.approx([0.4, 2.0])
    assert drive_range("payload", setup) == pytest.approx((-0.4, 1.0))
    assert drive_range("cg_shift", setup) == pytest.approx((-0.5 * v.l_f, 0.5 * v.l_r))
    bounce = [
        np.sqrt((1.0 + end) * (v.k_f + v.k_r) / v.m) / (2.0 * np.pi)
        for end in drive_range("spring_rate", setup)
    ]
    assert bounce == pytest.approx(np.array([0.7, 3.0]) * np.sqrt(2.5 / (v.l_f + v.l_r)))
    assert drive_range("cohesion", setup)[0] == -plant.soil.c
    assert drive_range("rolling_resistance", setup)[1] == 3.0 * EFFECTS["rolling_resistance"].plausible(v)


def test_soil_that_would_have_to_pull_has_no_score_and_no_size(pulled):
    scores = score_test(pulled, [Candidate(effect="rut_drag"), Candidate(effect="rolling_resistance")])
    assert scores.z[0] == 0.0
    assert scores.z[1] < -3.0
    fitted = refit(pulled, [Candidate(effect="rut_drag")], [1e3])
    assert 0.0 <= fitted.sizes[0] < fitted.size_deviations()[0]


def test_soil_that_would_bear_less_the_faster_it_is_pressed_has_no_score(pulled):
    """A drag that the model lacks slows a vehicle as soil would that is softer at speed."""
    names = [Candidate(effect=name) for name in ("rate_damping", "rut_drag", "aero_drag")]
    assert _possible_share(pulled, names, np.full(3, -1e-3)).tolist() == [0.0, 0.0, 1.0]


def test_residuals_that_do_not_change_move_no_score(pulled):
    """The priors of starts and nuisances pull at every fit, and have no part in the error of a solver."""
    scores = score_test(pulled, [Candidate(effect="rolling_resistance"), Candidate(effect="payload")])
    nothing, some = np.zeros_like(pulled.residual), 0.1 * pulled.residual
    assert scores.scores(pulled, nothing) == pytest.approx([0.0, 0.0], abs=1e-9)
    once, twice = scores.scores(pulled, some), scores.scores(pulled, 2.0 * some)
    assert twice == pytest.approx(2.0 * once)


def test_a_score_counts_what_a_size_within_its_range_explains(pulled):
    """Half of a step explains three quarters of the square of its score."""
    name = Candidate(effect="payload")
    low, high = pulled.runs[0].size_limits("payload")
    shares = _possible_share(pulled, [name] * 4, np.array([2.0 * high, 0.5 * high, 4.0 * low, 0.0]))
    assert shares == pytest.approx([0.5, 1.0, 0.25, 1.0])
    free = score_test(pulled, [Candidate(effect="exit_angle")])
    reach = abs(free.size[0]) / 4.0
    pulled.runs[0].size_limits = lambda effect: (-reach, reach)
    try:
        held = score_test(pulled, [Candidate(effect="exit_angle")])
    finally:
        del pulled.runs[0].size_limits
    assert held.size[0] == free.size[0]
    assert held.z[0] == pytest.approx(free.z[0] * np.sqrt(0.4375))


def test_the_model_of_the_named_causes_keeps_their_sizes_and_fits_the_rest(pulled):
    names = [Candidate(effect=name) for name in ("rolling_resistance", "accel_bias_y")]
    both = refit(pulled, names, [-0.04, 0.0])
    kept = model_with(both, [1], [0.05])
    assert [candidate.effect for candidate in kept.candidates] == ["accel_bias_y"]
    assert kept.sizes.tolist() == [0.05]
    assert kept.nuisances[0] != both.nuisances[0]
    assert kept.minus_log_likelihood > both.minus_log_likelihood
    assert pulled.runs[0].size_limits("accel_bias_y") != (0.05, 0.05)


def test_an_end_of_a_range_is_never_named(pulled):
    run = pulled.runs[0]
    low, high = run.size_limits("payload")
    search = SimpleNamespace(nominal=pulled)

    def physical(effect: str, size: float) -> bool:
        best = Alternative(
            candidate=Candidate(effect=effect),
            size=size,
            deviation=0.01,
            likelihood_ratio=0.0,
            ground=0.0,
            ground_deviation=0.1,
        )
        cause = Cause(alternatives=(best,), likelihood_ratio=50.0, p_value=1e-6)
        return VehicleDiagnosis(logs=(run.log,), search=search, causes=(cause,)).physical[0]

    assert physical("payload", 0.3)
    for size in (low, high, high - 0.002 * (high - low)):
        assert not physical("payload", size)
    assert physical("payload", high - 0.01 * (high - low))
    # A small size of what can only be there is a size; and sand has no cohesion.
    assert physical("steer_lag", 1e-3)
    assert not at_end("cohesion", 0.0, (0.0, 1e4))
    assert at_end("cohesion", -1.0, (0.0, 1e4))


def test_a_description_that_is_unusual_itself_is_possible_as_stated():
    plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], flat())
    odd = plant._replace(vehicle=plant.vehicle._replace(I_z=0.2 * plant.vehicle.I_z))
    setup = replace(Setup(plant=odd, mount=None), plant=odd)
    assert drive_range("inertia", setup)[0] == 0.0


def test_a_manoeuvre_of_which_nothing_can_be_compared_is_refused(pulled, monkeypatch):
    """As on hard ground, where a vehicle stands: an experiment is proposed from the others."""
    assert len(driven(pulled, MENU[0], usual=4.0).runs[0].windows) > 0
    monkeypatch.setattr(RunModel, "_usable", lambda self: np.zeros(self.count, dtype=bool))
    with pytest.raises(DataError, match=f"no window of {MENU[0].name} can be compared"):
        driven(pulled, MENU[0], usual=4.0)
