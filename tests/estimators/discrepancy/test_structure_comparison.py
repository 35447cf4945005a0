"""Structure is a cause: other laws of wheel and soil are named, where the nominal ones cannot be right."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.reports.diagnosis import render_diagnosis
from estimators.discrepancy import diagnosis as diagnosis_module
from estimators.discrepancy import structure_trials
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.search import from_stated, lower_minimum
from estimators.discrepancy.structure_comparison import (
    ADEQUATE,
    STRUCTURAL_CAUSES,
    StructureComparison,
    _pruned,
    _rivalled,
    compare_structures,
    gains_with,
)
from estimators.discrepancy.structure_trials import FLOORS, Case, StructureTrial
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import VehicleDiagnosis
from estimators.discrepancy.wording import terminal_lines
from estimators.logs import read_log
from estimators.logs.log import Log
from helpers import measured_data
from offroad_env import OffroadBekkerEnv
from offroad_env.effects import Extension, read_extension
from offroad_env.errors import DataError, SolverFailure


@pytest.fixture(scope="module")
def sand() -> tuple[Log, Log]:
    """Two drives of another program's vehicle on a soil grid, straight on and weaving."""
    folder = measured_data("chrono_scm")
    return read_log(folder / "sand_0.01_straight_R0.csv"), read_log(folder / "sand_0.01_sin02_R0.csv")


@pytest.fixture(scope="module")
def found(sand) -> StructureComparison:
    return compare_structures(sand[:1])


def test_the_laws_of_a_soil_grid_are_named_with_its_n(found, sand):
    assert found.found
    assert {"pressure_distribution", "ruts"} <= {cause.id for cause in found.causes}
    assert found.n == pytest.approx(sand[0].config.soil.n, abs=0.06)
    assert abs(found.nominal.change) > 0.1  # n of the wrong structure absorbs what it lacks


@pytest.mark.check
def test_four_wheels_are_tried_where_two_axles_gain_little():
    """On this slalom other laws gain 14 % with two axles, and 38 % with four wheels."""
    log = read_log(measured_data("scm_drives") / "train_31_slalom_waves_const.parquet")
    found = compare_structures([log])
    assert found.found
    assert found.best.case.vehicle_model == "four_wheel"
    assert found.n == pytest.approx(log.config.soil.n, abs=0.06)


def test_on_a_drive_that_was_not_used_the_error_falls_with_nothing_fitted(found, sand):
    gains = {gain.channel: 1.0 - gain.extended / gain.nominal for gain in gains_with(found, sand[1])}
    assert gains["v_x"] > 0.8
    assert gains["yaw_rate"] > 0.5
    assert gains["omega_f"] > 0.8


def test_no_structure_is_named_where_an_effect_is_the_cause():
    log = simulated_log(draw_case(102, duration=24.0), FAULTS["rolling_resistance"](0.05))
    assert not compare_structures([log]).found


def test_no_other_structure_is_looked_at_closely_that_is_far_behind_the_effects():
    case = draw_case(103, duration=19.0)
    log = simulated_log(case)
    setup = RunModel(log).setup
    trials = structure_trials.Trials([log])
    right, wrong = (
        replace(setup, plant=setup.plant._replace(soil=setup.plant.soil._replace(n=n)))
        for n in (case.n, case.n + 0.4)
    )
    assert compare_structures([log], [right]) is None
    assert compare_structures([log], [wrong]) is not None
    own = trials.coarse(Case("grid", "half_car"))
    assert trials.reaches(own.case, trials.cost(own) + 1e-6)
    assert not trials.reaches(own.case, trials.cost(own) - 1e-6)


@pytest.mark.parametrize(("behind", "near"), [(0.39, True), (0.41, False)])
@pytest.mark.parametrize(
    "rival", [Case("grid", "half_car"), Case("field", "half_car"), Case("full", "four_wheel")]
)
def test_a_structure_is_near_the_effects_by_its_mean_logarithm(rival, behind, near):
    class Stub:
        def cost(self, trial):
            return 7.0

        def reaches(self, case, most, change=None):
            assert change == (0.1 if case.vehicle_model == "four_wheel" else None)
            return case == rival and most > 7.0 + behind * len(FLOORS)

    effects = StructureTrial(case=Case("full", "half_car"), change=0.1, errors=np.zeros((2, len(FLOORS))))
    assert _rivalled(Stub(), effects) is near


@pytest.mark.check
@pytest.mark.parametrize("stated", [0.3, 1.45])
def test_a_stated_n_that_is_far_off_is_no_reason_to_name_a_structure(stated):
    log = simulated_log(draw_case(103, duration=19.0))
    soil = log.config.soil._replace(n=stated)
    compared = compare_structures([replace(log, config=replace(log.config, soil=soil))])
    assert not compared.found
    assert stated + compared.nominal.change == pytest.approx(draw_case(103).n, abs=0.02)


def test_a_structure_whose_n_lies_at_the_end_of_the_range_is_not_named(sand, monkeypatch):
    # With the wrong n on both sides a structure looks better than one that cannot be right either.
    least = sand[0].config.soil.n
    monkeypatch.setattr(structure_trials, "_LEAST", least)
    monkeypatch.setattr(structure_trials, "_GRID", (least, 1.3, 1.6))
    compared = compare_structures(sand[:1])
    assert compared.gain > 0.6
    assert compared.p_value < 1e-3
    assert compared.n == pytest.approx(least)
    assert not compared.found


@pytest.mark.parametrize(
    ("gain", "found_then", "tied"),
    [(None, True, False), (0.3, True, False), (0.0, True, True), (-0.3, False, False)],
)
def test_a_structure_is_certain_only_where_effects_predict_worse(found, gain, found_then, tied):
    compared = replace(found, gain_over_effects=gain)
    assert compared.found is found_then
    assert compared.tied is tied


@pytest.mark.parametrize(("gain", "found_then"), [(0.11, True), (0.09, False), (0.0, False), (-0.3, False)])
def test_where_nothing_shows_that_the_nominal_structure_is_wrong_another_must_predict_better(
    found, gain, found_then
):
    compared = replace(found, gain_over_effects=gain, adequate_nominal=True)
    assert compared.found is found_then
    assert not compared.tied


def _inadequate(found: StructureComparison) -> StructureComparison:
    """A structure that leaves 1.25 times the errors up to which one is named."""
    # An error e counts as hypot(e, floor).
    errors = np.sqrt((1.25 * ADEQUATE) ** 2 - 1.0) * np.array([*FLOORS.values()])
    return replace(found, best=replace(found.best, errors=np.full_like(found.best.errors, errors)))


@pytest.mark.parametrize(
    ("gain", "found_then", "undecided"),
    [
        (None, True, False),
        (0.11, True, False),
        (0.09, False, True),
        (-0.09, False, True),
        (-0.11, False, False),
    ],
)
def test_a_structure_that_predicts_badly_must_predict_better_than_effects(found, gain, found_then, undecided):
    compared = replace(_inadequate(found), gain_over_effects=gain)
    assert not compared.adequate
    assert compared.found is found_then
    assert compared.undecided is undecided
    assert not replace(found, gain_over_effects=gain).undecided
    assert not replace(compared, adequate_nominal=True).undecided
    assert not replace(compared, causes=()).undecided


@pytest.fixture(scope="module")
def named() -> VehicleDiagnosis:
    """A drive whose steering gain is wrong, as is named."""
    log = simulated_log(draw_case(103, road="flat", duration=19.0), FAULTS["steer_gain"](0.1))
    diagnosis = diagnose([log], library=["steer_gain"])
    assert diagnosis.verdict == "NAMED"
    return diagnosis


@pytest.mark.parametrize(("gain", "verdict"), [(-0.3, "NAMED"), (0.0, "ONE OF"), (0.3, "UNEXPLAINED")])
def test_effects_are_kept_beside_a_structure_that_predicts_badly(found, named, monkeypatch, gain, verdict):
    """Large faults leave errors in the open loop that no structure explains, and effects do."""
    compared = replace(_inadequate(found), gain_over_effects=gain)
    monkeypatch.setattr(diagnosis_module, "compare_structures", lambda *_args, **_kwargs: compared)
    fit = named.search.extended
    diagnosis = diagnosis_module._with_structures(named, fit, {}, lambda stage: None)
    assert diagnosis.causes == named.causes
    assert diagnosis.stand_ins == ()
    assert diagnosis.verdict == verdict
    assert diagnosis.identifiable == (verdict != "UNEXPLAINED",)
    summary = summarise(diagnosis)
    assert ("another structure predicts as well" in summary.sentence) is (verdict == "ONE OF")
    assert ("no other one that was tried" in summary.sentence) is (verdict == "UNEXPLAINED")
    assert any("steer_gain" in line for line in terminal_lines(summary))
    # Beside a rest nothing is certain either.
    search = replace(diagnosis.search, refused=True)
    rest = replace(diagnosis, search=search, joint=None)
    assert (rest.verdict == "NAMED + UNEXPLAINED REST") is (verdict == "NAMED")
    assert rest.identifiable == (verdict == "NAMED",)
    full = replace(diagnosis, search=replace(search, refused=False, capped=True), joint=None)
    assert (full.verdict == "ONE OF") is (verdict == "ONE OF")
    page = render_diagnosis(summary, "offroad diagnose run.csv")
    assert ("part of the best structure" in page) is (verdict == "UNEXPLAINED")
    assert "?." not in page


def test_numbers_within_their_tolerances_do_not_hide_a_wrong_structure(monkeypatch):
    """No effect shows near the first minimum: shear moduli 4.4 off and n 0.13 too low hide it."""
    for module in (from_stated, lower_minimum):
        monkeypatch.setattr(module, "astray", lambda fit: False)
    log = read_log(measured_data("chrono_scm") / "clay_0.01_sin02_R0.csv")
    diagnosis = diagnose([log])
    assert diagnosis.verdict == "NAMED"
    assert diagnosis.restructured is not None
    assert diagnosis.restructured.adequate_nominal
    assert not diagnosis.search.causes
    assert diagnosis.restructured.gain_over_effects > 0.3
    assert diagnosis.restructured.n == pytest.approx(log.config.soil.n, abs=0.06)


@pytest.mark.parametrize(
    ("gain", "converged", "refined"),
    [
        (0.11, True, False),
        (0.09, True, True),
        (0.21, False, False),
        (0.19, False, True),
        (None, True, True),
        (None, False, True),
    ],
)
def test_no_finer_solver_is_asked_for_effects_of_a_structure_that_is_clearly_wrong(
    found, monkeypatch, gain, converged, refined
):
    asked = []
    search = diagnosis_module.search

    def stopped(*args, **kwargs):
        done = search(*args, **kwargs)
        return replace(done, extended=replace(done.extended, converged=converged))

    def refine(done, *_args, **_kwargs):
        asked.append(done)
        return done

    monkeypatch.setattr(diagnosis_module._Searched, "accurate", False)
    monkeypatch.setattr(diagnosis_module, "search", stopped)
    monkeypatch.setattr(diagnosis_module, "_refined", refine)
    compared = replace(found, gain_over_effects=gain)
    monkeypatch.setattr(diagnosis_module, "compare_structures", lambda *_args, **_kwargs: compared)
    diagnosis = diagnose([simulated_log(draw_case(103, duration=19.0))])
    assert bool(asked) is refined
    assert diagnosis.restructured is compared


@pytest.mark.check
def test_effects_that_explain_a_straight_drive_are_not_named_for_certain(sand):
    diagnosis = diagnose(sand[:1])
    assert diagnosis.restructured is not None
    assert diagnosis.verdict in ("NAMED", "ONE OF")
    assert not diagnosis.causes


def test_every_structural_cause_has_its_sentence(found):
    assert {cause.id for cause in found.causes} <= set(STRUCTURAL_CAUSES)
    assert all(cause.sentence and cause.gain > 0.0 for cause in found.causes)


def test_an_extended_model_with_another_structure_drives_the_environment(found, tmp_path):
    case = found.best.case
    extension = Extension(
        model="full", effects=(), structure=case.structure, vehicle_model=case.vehicle_model
    )
    path = tmp_path / "extended.json"
    path.write_text(json.dumps(extension.to_dict()))
    assert read_extension(path) == extension
    env = OffroadBekkerEnv(model=str(path))
    env.reset(seed=1)
    assert env.plant.structure is not None
    for _ in range(3):
        _, reward, *_ = env.step(np.array([0.0, 0.3]))
    assert np.isfinite(reward)
    path.write_text(json.dumps(extension.to_dict() | {"structure": "grid,ruts=deep"}))
    with pytest.raises(DataError, match="ruts"):
        read_extension(path)


def test_structures_are_tried_where_the_nominal_model_cannot_drive_at_all(found, sand, monkeypatch):
    def stuck(*_args, **_kwargs):
        raise SolverFailure("a wheel has sunk to its axle")

    monkeypatch.setattr(diagnosis_module, "fit_runs", stuck)
    monkeypatch.setattr(diagnosis_module, "compare_structures", lambda logs: found)
    diagnosis = diagnose(sand[:1])
    assert diagnosis.verdict == "NAMED"
    assert diagnosis.failed == {"nominal model": "SolverFailure: a wheel has sunk to its axle"}
    summary = summarise(diagnosis)
    assert "structure of the model is wrong" in summary.sentence
    assert summary.extended_model.structure == found.best.case.structure
    assert any(line.startswith("missing: nominal model") for line in terminal_lines(summary))
    assert "Missing: nominal model" in render_diagnosis(summary, "offroad diagnose run.csv")


def test_a_structure_is_found_although_every_window_of_the_nominal_one_fails(found):
    """Errors of a model that cannot drive are infinite, not missing."""
    nominal = replace(found.nominal, errors=np.full_like(found.nominal.errors, np.inf))
    assert np.isfinite(nominal.logarithms()).all()
    assert nominal.pooled == [None] * len(nominal.pooled)
    assert np.nanmean(nominal.logarithms() - found.best.logarithms()) > 1.0


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "NAMED"), (0.8, "NAMED"), (1.25, "UNEXPLAINED")])
def test_a_structure_that_does_not_predict_the_runs_is_not_named(found, sand, monkeypatch, factor, verdict):
    """However much better than the nominal one it is: here a nominal one that cannot drive at all."""

    def stuck(*_args, **_kwargs):
        raise SolverFailure("a wheel has sunk to its axle")

    floors = np.array([*FLOORS.values()])
    if factor != 1.0:
        errors = np.full_like(found.best.errors, np.sqrt((factor * ADEQUATE) ** 2 - 1.0)) * floors
        found = replace(found, best=replace(found.best, errors=errors))
        assert found.misfit == pytest.approx(factor * ADEQUATE)
    assert ADEQUATE == 4.0
    monkeypatch.setattr(diagnosis_module, "fit_runs", stuck)
    monkeypatch.setattr(diagnosis_module, "compare_structures", lambda logs: found)
    summary = summarise(diagnose(sand[:1]))
    assert summary.verdict == verdict
    if verdict == "UNEXPLAINED":
        assert "no other one that was tried predicts the runs: the best leaves" in summary.sentence
        assert summary.extended_model is None
        assert not any(line.startswith("cause:") for line in terminal_lines(summary))
        assert any("named up to 4" in line for line in terminal_lines(summary))
        assert "no other one that was tried" in render_diagnosis(summary, "offroad diagnose run.csv")


class _Costs:
    """Errors of structures by how many laws of the preset ``grid`` are put back: a stub of `Trials`."""

    def __init__(self, losses: dict[str, float]) -> None:
        self._losses = losses

    def near(self, case: Case, change: float) -> StructureTrial:
        rng = np.random.default_rng(0)
        back = sum(loss for law, loss in self._losses.items() if law in case.structure)
        errors = np.exp(back + 1e-3 * rng.standard_normal((20, len(FLOORS))))
        return StructureTrial(case=case, change=change, errors=errors)

    def best(self, case: Case, start: float) -> StructureTrial:
        return self.near(case, start)

    def apart(
        self, worse: StructureTrial, better: StructureTrial, *, everywhere: bool = False
    ) -> tuple[float, float]:
        loss = float(np.mean(worse.logarithms() - better.logarithms()))
        return loss, 1e-6 if loss > 0.01 else 0.5


@pytest.mark.parametrize(
    ("loss", "stays", "named"), [(0.3, True, True), (0.0, True, False), (-0.3, False, False)]
)
def test_a_law_that_makes_no_difference_stays_as_the_preset_has_it_and_is_not_named(
    loss: float, stays: bool, named: bool
) -> None:
    """What the drive speaks against is put back."""
    trials = _Costs({"shaft_torque=reacted": loss, "ruts=none": 0.5})
    nominal, best = (trials.near(Case(name, "half_car"), 0.0) for name in ("full", "grid"))
    kept, causes = _pruned(trials, nominal, best)
    assert ("shaft_torque=reacted" not in kept.case.structure) is stays
    assert ("shaft_torque" in {cause.id for cause in causes}) is named
    assert "ruts" in {cause.id for cause in causes}
