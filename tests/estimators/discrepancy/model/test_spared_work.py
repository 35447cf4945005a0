"""Work that a fit to a drive does not repeat."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model import fit as fit_module
from estimators.discrepancy.model import linearisation, run_model
from estimators.discrepancy.model.displacement import displaced, same_everywhere
from estimators.discrepancy.model.fit import fit_runs, settled
from estimators.discrepancy.model.linearisation import Linearisation
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.logs.tolerances import TOLERANCES
from offroad_env.effects import EFFECTS, apply, library
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.world.terrain import grade, rough_terrain


@pytest.fixture(scope="module")
def fit():
    log = simulated_log(draw_case(100, road="unknown", natural=True, duration=12.0))
    return fit_runs([RunModel(log)], white=True)


def test_inputs_are_prepared_once_for_all_starts_and_again_for_other_inputs(fit, monkeypatch):
    run, (setup,), count = fit.runs[0].refined(), fit.linearisation.setups, []
    real = run_model.actuator_states
    monkeypatch.setattr(run_model, "actuator_states", lambda *args: count.append(0) or real(*args))
    starts, warm = fit.point.starts[0], fit.point.warm[0]
    first = run.simulate(setup, starts, warm, run.windows)
    again = run.simulate(setup, starts, warm, run.windows)
    assert len(count) == 1
    assert np.array_equal(first.states, again.states)
    late = replace(setup, inputs=replace(setup.inputs, delay=0.05))
    other = run.simulate(late, starts, warm, run.windows)
    assert len(count) == 2
    assert not np.array_equal(first.states, other.states)


def test_on_the_way_to_a_minimum_derivatives_by_tolerated_numbers_serve_again(fit, monkeypatch):
    """And where a fit ends, all are new."""
    asked = []
    real = Linearisation.nuisance_columns

    def columns(self, known=None, effects=None):
        asked.append(known is None)
        return real(self, known, effects)

    monkeypatch.setattr(Linearisation, "nuisance_columns", columns)
    settled(fit)
    assert asked[0] is False
    assert asked[-1] is True
    known = np.full_like(fit.jacobian.nuisances, 7.0)
    mixed = real(fit.linearisation, known)
    tolerated = fit.problem.nuisances.index(next(n for n in fit.problem.nuisances if n.tolerated))
    assert (mixed[:, tolerated] == 7.0).all()
    assert not (mixed[:, 0] == 7.0).any()


def test_a_number_beside_its_own_effect_has_the_derivative_of_that_effect(fit):
    """Else both went far off on either side: 0.34 rad and 9.6 deviations in a log with 0.12 rad."""
    candidates = tuple(Candidate(effect=name) for name in ("friction_angle", "wheel_radius_scale"))
    point = replace(fit.point, candidates=candidates, sizes=np.array([-0.1, 0.0]))
    there = Linearisation.at(fit.problem, point)
    traces = {one.key: np.full(fit.problem.rows, 2.0 + k) for k, one in enumerate(candidates)}
    found = there.nuisance_columns(fit.jacobian.nuisances, traces)
    names = [nuisance.name for nuisance in fit.problem.nuisances]
    slope = np.tan(fit.runs[0].setup.plant.soil.phi)
    turn = TOLERANCES["tan_phi"] * slope / (1.0 + slope**2)
    assert found[:, names.index("strength")] == pytest.approx(np.full(fit.problem.rows, 2.0 * turn), rel=0.02)
    # A wheel speed that reads too much is no larger wheel.
    kept = [i for i, number in enumerate(fit.problem.nuisances) if number.tolerated]
    kept.remove(names.index("strength"))
    assert names.index("radius") in kept
    assert np.array_equal(found[:, kept], fit.jacobian.nuisances[:, kept])


@pytest.mark.parametrize(("more", "same"), [(0.0, True), (0.005, True), (0.02, False), (1.0, False)])
def test_an_effect_that_changes_other_things_than_a_number_gives_it_no_derivative(
    fit, monkeypatch, more, same
):
    def change(setup, share):
        soil = setup.plant.soil
        return setup.with_soil(k_x=(1.0 + share) * soil.k_x, k_y=(1.0 + (1.0 + more) * share) * soil.k_y)

    effect = replace(EFFECTS["shear_modulus"], change=change)
    monkeypatch.setattr(linearisation, "EFFECTS", {**EFFECTS, "shear_modulus": effect})
    monkeypatch.setattr(library, "EFFECTS", {**EFFECTS, "shear_modulus": effect})
    candidate = Candidate(effect="shear_modulus")
    there = Linearisation.at(fit.problem, replace(fit.point, candidates=(candidate,), sizes=np.zeros(1)))
    known = np.full_like(fit.jacobian.nuisances, 7.0)
    found = there.nuisance_columns(known, {candidate.key: np.full(fit.problem.rows, 1.0)})
    own = [number.name for number in fit.problem.nuisances].index("shear_moduli")
    assert (found[0, own] != 7.0) == same


@dataclass(frozen=True)
class Fit:
    """A fit, and what it would be with its noise learned."""

    minus_log_likelihood: float
    converged: bool = True
    learned: float = 0.0

    def with_learned_noise(self):
        return Fit(self.learned)


@pytest.mark.parametrize(
    ("converged", "hard", "behind", "begun"),
    [
        (False, False, 0.49, True),
        (False, False, 0.51, False),
        (False, True, 0.51, True),
        (True, False, 0.49, False),
        (True, True, 0.49, True),
    ],
)
def test_a_second_fit_goes_on_where_it_may_lead_somewhere(monkeypatch, converged, hard, behind, begun):
    """On soil only if the first has not converged, and if the second is not far from the data."""
    rows = 2000
    first, second = Fit(-5000.0, converged), Fit(-5001.0, learned=-5000.0 + behind * rows)
    monkeypatch.setattr(fit_module, "_begun", lambda *_, wide, **__: first if wide else second)
    monkeypatch.setattr(fit_module, "settled", lambda one: one)
    problem = SimpleNamespace(hard=hard, rows=rows, stated=lambda: None)
    assert fit_module._fitted_anew(problem, white=False) is (second if begun else first)


def test_steps_over_two_of_the_grid_predict_nearly_the_same(fit):
    """What lies between them is interpolated: an error of the solver, far below the noise of the sensors."""
    (run,), there = fit.runs, fit.linearisation
    rough, start = run.rough(), (there.setups[0], there.point.starts[0], there.point.warm[0], run.windows)
    records = rough.simulate(*start)
    assert np.isfinite(records.states).all()
    assert np.isfinite(records.readings).all()
    error = fit.noise.whiten(rough.predict(there.setups[0], records) - fit.prediction)
    assert 0.0 < np.sqrt(np.mean(error**2)) < 0.2


def test_steps_over_two_of_the_grid_are_not_taken_where_they_would_be_long(fit):
    """A small vehicle is quick, and a slow log has long steps."""
    (run,) = fit.runs
    assert run.rough()._stride == 2
    run._longest = 1.9 * run.step
    assert run.rough()._stride == 1
    run._longest = 0.02


@pytest.mark.parametrize("state", [at.X, at.Y, at.YAW])
def test_on_even_ground_a_window_that_begins_elsewhere_needs_no_simulation(fit, state):
    (run,), there, by = fit.runs, fit.linearisation, 0.3
    starts = there.point.starts[0].copy()
    starts[:, state] += by
    simulated = run.simulate(there.setups[0], starts, there.point.warm[0], run.windows)
    moved = displaced(there.setups[0], there.records[0], run.windows, state, by)
    assert np.allclose(moved.states, simulated.states, atol=1e-9)
    assert displaced(there.setups[0], there.records[0], run.windows, at.V_X, by) is None


def test_where_the_place_matters_windows_that_begin_elsewhere_are_simulated(fit):
    (setup,) = fit.linearisation.setups
    assert same_everywhere(setup)
    assert not same_everywhere(setup.with_ground(grade(0.05)))
    assert not same_everywhere(setup.with_ground(rough_terrain("A", np.random.default_rng(0))))
    step = {"place": 3.0, "direction": 0.0, EFFECTS["n_step"].size.name: 0.1}
    assert not same_everywhere(apply(setup, [("n_step", step)]))
    patches = setup.plant.soil_map._replace(patches=np.array([[0.0, 0.0, 5.0, 0.7]]))
    assert not same_everywhere(replace(setup, plant=setup.plant._replace(soil_map=patches)))


@pytest.mark.parametrize("fails", [("first",), ("second",), ("first", "second")])
def test_one_of_two_nominal_fits_is_enough(monkeypatch, fails):
    first, second = Fit(-5000.0, converged=False), Fit(-5001.0, learned=-5000.0)
    named = {id(first): "first", id(second): "second"}

    def settled(one):
        if named[id(one)] in fails:
            raise SolverFailure("sinks")
        return one

    monkeypatch.setattr(fit_module, "_begun", lambda *_, wide, **__: first if wide else second)
    monkeypatch.setattr(fit_module, "settled", settled)
    problem = SimpleNamespace(hard=False, rows=100, stated=lambda: None)
    if len(fails) == 2:
        with pytest.raises(SolverFailure, match="sinks"):
            fit_module._fitted_anew(problem, white=False)
        return
    assert fit_module._fitted_anew(problem, white=False) is (second if "first" in fails else first)
