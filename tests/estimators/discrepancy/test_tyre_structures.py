"""Flexible tyres are a structural cause: on rigid rims their drives have another n and other false causes."""

from dataclasses import replace

import numpy as np
import pytest

from agents.reports.output import write_json
from estimators.discrepancy import structure_comparison
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.structure_comparison import (
    StructureComparison,
    _parts,
    _with_tyres,
    _without,
    compare_structures,
)
from estimators.discrepancy.structure_trials import FLOORS, StructureTrial, Trials
from estimators.discrepancy.tyre_trials import has_tyre, near_on_tyres, on_rigid_rims
from estimators.logs import Log
from estimators.replay.structures import Case
from offroad_env import OffroadBekkerEnv
from offroad_env.effects import Extension
from offroad_env.simulation.drive import Faults
from offroad_env.world.structures import read_structure

CASE = draw_case(6, duration=24.0, gnss=True)
TRUTH = "field,tyre=mrzr,tyre_inflation=12e4"


@pytest.fixture(scope="module")
def log() -> Log:
    """A drive on tyres, described as one on rigid rims."""
    laws = read_structure(TRUTH)
    return simulated_log(CASE, Faults(plant=lambda plant: plant._replace(structure=laws)))


@pytest.fixture(scope="module")
def found(log) -> StructureComparison:
    return compare_structures([log])


def test_tyres_are_named_with_the_pressure_and_n(found):
    assert found.found
    assert "flexible_tyre" in {cause.id for cause in found.causes}
    assert found.n == pytest.approx(CASE.n, abs=0.05)
    assert abs(found.nominal.change + found.n - found.best.change - CASE.n) > 0.1  # rigid rims, another n
    assert 80e3 <= read_structure(found.best.case.structure).tyre.inflation <= 180e3
    assert found.misfit < 2.0 < found.nominal.misfit


def test_what_a_tyre_needs_is_no_cause_besides_it(found):
    assert not {"pressure_direction", "pressure_distribution"} & {cause.id for cause in found.causes}
    nominal, best = Case("full", "half_car"), Case("grid,tyre=mrzr", "half_car")
    assert "flexible_tyre" in _parts(best, nominal)
    assert "flexible_tyre" not in _parts(best, Case("field,tyre=mrzr", "half_car"))
    assert _without(best, "flexible_tyre", nominal).structure == "grid"


def test_the_extended_model_is_driven_on_tyres(found, tmp_path):
    structure = found.best.case.structure
    content = Extension(model="full", effects=(), structure=structure).to_dict()
    path = write_json(tmp_path / "extended.json", content)
    env = OffroadBekkerEnv(model=str(path), structure=None)
    env.reset(seed=1)
    assert env.unwrapped.plant.structure == read_structure(structure)
    assert np.isfinite(env.step(env.action_space.sample())[0]["imu"]).all()


def test_tyres_that_are_stated_are_not_tried(log):
    stated = replace(log, config=replace(log.config, structure="grid,tyre=mrzr"))
    trials = Trials([stated])
    assert not near_on_tyres(trials, stated, np.inf)
    assert near_on_tyres(Trials([log]), log, np.inf)


def test_a_structure_is_put_on_rigid_rims():
    for text in ("grid,tyre=mrzr,ruts=none", "grid,tyre_r=0.33,ruts=none,tyre_b=0.2,tyre_inflation=1e5"):
        assert has_tyre(text)
        assert on_rigid_rims(text) == "grid,ruts=none"
        assert not has_tyre("grid,ruts=none")


def _trial(misfit: float) -> StructureTrial:
    floors = np.array([*FLOORS.values()])
    errors = np.tile(floors * np.sqrt(misfit**2 - 1.0), (6, 1))
    return StructureTrial(case=Case("full", "half_car"), change=0.0, errors=errors)


class _Known:
    """Trials whose gain is by their misfits."""

    def cost(self, trial):
        return len(FLOORS) * np.log(trial.misfit)

    def apart(self, worse, better, *, everywhere=False):
        return float(np.log(worse.misfit / better.misfit)), 1e-3

    def inside(self, trial):
        return True


@pytest.mark.parametrize(
    ("known", "tyres", "taken"),
    [
        (1.9, 1.2, False),  # rigid rims on natural soil leave as much
        (2.2, 1.2, True),
        (3.0, 2.65, False),  # hardly better
        (3.0, 2.5, True),
        (9.0, 4.2, False),  # no good either
        (9.0, 3.8, True),
    ],
)
def test_tyres_must_take_much_of_what_rigid_rims_leave(known, tyres, taken, log, monkeypatch):
    monkeypatch.setattr(structure_comparison, "near_on_tyres", lambda trials, log, most: True)
    monkeypatch.setattr(structure_comparison, "on_tyres", lambda trials, log: [_trial(tyres)])
    found = _with_tyres(_Known(), log, _trial(known), _trial(known), [])
    assert bool(found) == taken


@pytest.mark.parametrize(("rigid", "tried"), [(1.9, False), (2.2, True)])
def test_a_structure_on_rigid_rims_that_is_named_may_leave_as_much_as_natural_soil(
    rigid, tried, log, monkeypatch
):
    asked = []
    monkeypatch.setattr(structure_comparison, "near_on_tyres", lambda trials, log, most: asked.append(most))
    _with_tyres(_Known(), log, _trial(9.0), _trial(9.0), [_trial(rigid)])
    assert bool(asked) == tried
