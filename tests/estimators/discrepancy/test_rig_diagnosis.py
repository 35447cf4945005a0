"""Diagnoses of the trials of a wheel rig: simulated with a fault, and measured."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from agents.studies.rig_fault_detection.figure import rig_figure
from estimators.discrepancy.faults.rig import (
    RIG_FAULTS,
    UNMODELLED_RIG_FAULTS,
    draw_rig_case,
    simulated_trials,
)
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT
from estimators.discrepancy.rig.fit import fit_rig
from estimators.discrepancy.rig.other_trials import transfer_to
from estimators.discrepancy.rig.repeat_noise import RepeatNoise, RigNoise
from estimators.discrepancy.rig.settings import measured_trials, reliability_of
from estimators.discrepancy.rig.trial_model import RigModel
from estimators.discrepancy.rig.trial_table import Trials
from estimators.discrepancy.rig_diagnosis import diagnose_rig, rig_library
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import Verdict
from estimators.discrepancy.wording import terminal_lines
from estimators.logs import Log, read_log
from estimators.rig.cmu_soil_bin import cmu_rig_log
from helpers import REPOSITORY, measured_data
from offroad_env.effects import EFFECTS, Extension, RigSetup, apply
from offroad_env.errors import DataError, OffroadError
from offroad_env.simulation.wheel import wheel_forces

#: Injects a fault in a process of its own: the fault, its size and sign, and the rig are drawn from no seed.
_INJECT = """
import json, sys
import numpy as np
from estimators.discrepancy.faults.rig import RIG_FAULTS, draw_rig_case, simulated_trials
from estimators.logs import write_log

rng = np.random.default_rng()
case = draw_rig_case(int(rng.integers(10_000, 1_000_000)))
SIZES = {  # several times what such trials show
    "slip_sinkage": 0.4, "slip_exponent": 0.15, "grouser_thrust": 0.04, "friction_angle": 0.05,
    "exit_angle": -0.12, "peak_angle": 0.1, "load_scale": 0.12, "sinkage_offset": 0.03 * case.r,
    "bulldozing": 0.05 * case.load / (0.2 * case.r * case.r),
}
name = str(rng.choice(list(SIZES)))
# Soil only resists, and leaves the wheel behind its bottom: these faults have one sign.
signs = (1.0,) if name in ("slip_sinkage", "grouser_thrust", "bulldozing", "exit_angle") else (-1.0, 1.0)
size = SIZES[name] * float(rng.uniform(1.0, 1.5)) * float(rng.choice(signs))
write_log(sys.argv[1] + "/trials.csv", simulated_trials(case, RIG_FAULTS[name](size)))
with open(sys.argv[1] + "/sealed.json", "w") as file:
    json.dump({"effect": name, "size": size, "seed": case.seed}, file)
"""


def _blind_trial(folder) -> str:
    """Inject, diagnose, and only then open the answer; returns what went wrong, or nothing."""
    done = subprocess.run(
        [sys.executable, "-c", _INJECT, str(folder)],
        capture_output=True,
        text=True,
        check=False,
        cwd=REPOSITORY,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
    )
    assert done.returncode == 0, done.stderr
    diagnosis = diagnose_rig([read_log(folder / "trials.csv")])
    answer = json.loads((folder / "sealed.json").read_text())
    rivals = {rival.candidate.effect: rival for cause in diagnosis.causes for rival in cause.alternatives}
    if answer["effect"] not in rivals:
        return f"{answer} not among {sorted(rivals)}, {diagnosis.verdict}"
    size = rivals[answer["effect"]].size
    return "" if size == pytest.approx(answer["size"], rel=0.4) else f"{answer} found with size {size}"


def test_a_fault_that_another_process_has_injected_in_a_rig_is_found(tmp_path):
    """Drawn from no seed. A first miss must be followed by two finds."""
    folders = [tmp_path / name for name in ("first", "second", "third")]
    for folder in folders:
        folder.mkdir()
    if missed := _blind_trial(folders[0]):
        assert [_blind_trial(folder) for folder in folders[1:]] == ["", ""], missed


@pytest.fixture(scope="module")
def trials() -> Log:
    return simulated_trials(draw_rig_case(21))


def _model(log: Log) -> RigModel:
    return RigModel(log, Trials.of([log]))


def test_a_trial_of_the_model_is_a_wheel_of_the_library(trials):
    """The hooks of effects, unused, leave the forces as they are."""
    run = _model(trials)
    found = run.simulate(run.setup).readings
    table = run.trials
    known = wheel_forces(
        trials.config.soil,
        trials.config.wheel,
        load=table.load,
        slip=table.slip,
        slip_angle=table.slip_angle,
        shear="resultant",
    )
    values = run.predict(run.setup, run.simulate(run.setup)).reshape(len(run.channels), -1)
    assert found.shape[0] == len(table)
    for channel, expected in (("sinkage", known.sinkage), ("drawbar", known.F_x), ("torque", known.torque)):
        row = [c.name for c in run.channels].index(channel)
        assert values[row] == pytest.approx(expected, rel=1e-5, abs=1e-4 * np.max(np.abs(expected)))


def test_the_wheel_of_the_faults_is_a_second_one_that_agrees(trials):
    """Two implementations: without noise they differ by quadrature alone."""
    from estimators.discrepancy.faults import rig as rig_faults

    case, run = draw_rig_case(21), _model(trials)
    soil = trials.config.soil._replace(n=case.n)
    arrays = {name: np.full(len(run.trials), value) for name, value in soil._asdict().items()}
    table = {"slip": run.trials.slip, "slip_angle": run.trials.slip_angle, "load": run.trials.load}
    answer = rig_faults._equilibrium(arrays, table, case, rig_faults.RigFault())
    records = run.simulate(run.setup.with_soil(n=case.n))
    own = run.predict(run.setup, records).reshape(len(run.channels), -1)
    for channel, values in zip(run.channels, own, strict=True):
        assert np.max(np.abs(answer[channel.name] - values)) < 1e-4 * np.max(np.abs(values))


@pytest.mark.parametrize("name", rig_library())
def test_a_rigs_effect_leaves_no_trace_at_its_off_value_and_acts_at_its_plausible_size(name, trials):
    run, effect = _model(trials), EFFECTS[name]
    setup = run.setup
    assert isinstance(setup, RigSetup)
    assert apply(setup, [(name, {effect.size.name: effect.size.off})]) is setup
    reach = effect.plausible(setup.plant.vehicle)
    base = run.predict(setup, run.simulate(setup))
    away = []
    for share in (0.5, 1e-4):
        other = apply(setup, [(name, {effect.size.name: share * reach})])
        away.append(np.max(np.abs(run.predict(other, run.simulate(other)) - base)))
    assert away[0] > 1e-6
    assert away[1] < 0.05 * away[0]


def test_repeats_of_a_condition_stay_together_and_one_slip_angle_is_left_out(trials):
    table = Trials.of([trials])
    use = table.uses()
    for condition in np.unique(table.condition):
        assert len(np.unique(use[table.condition == condition])) == 1
    assert len(np.unique(table.slip_angle[use == REPORT])) == 1
    assert not np.isin(table.slip_angle[use == REPORT], table.slip_angle[use != REPORT]).any()
    assert 0.15 < np.mean(use == SELECT) < 0.3
    assert np.mean(use == FIT) > 0.4


def test_conditions_without_labels_are_found_by_nearness(trials):
    channels = {name: values for name, values in trials.channels.items() if name != "condition"}
    blind = Trials.of([replace(trials, channels=channels)])
    assert np.array_equal(blind.condition, Trials.of([trials]).condition)


def test_the_order_of_the_trials_changes_nothing(trials):
    order = np.random.default_rng(4).permutation(len(trials))
    shuffled = replace(trials, channels={name: v[order] for name, v in trials.channels.items()})
    table, other = Trials.of([trials]), Trials.of([shuffled])
    assert np.array_equal(other.condition, table.condition[order])
    assert np.array_equal(other.uses(), table.uses()[order])


def test_noise_is_told_apart_into_repeats_and_what_they_share():
    rng = np.random.default_rng(5)
    group = np.repeat(np.arange(400), 3)
    residual = 2.0 * rng.standard_normal(400)[group] + 0.5 * rng.standard_normal(1200)
    noise = RepeatNoise.fitted(residual, group, 0.0, white=False)
    assert noise.repeat == pytest.approx(0.5, rel=0.1)
    assert noise.between == pytest.approx(2.0, rel=0.1)
    alone = RepeatNoise.fitted(0.5 * rng.standard_normal(1200), group, 0.0, white=False)
    assert alone.between < 0.12


def test_repeats_that_agree_to_the_last_digit_are_solvable():
    """A simulation elsewhere has no noise, or forces of 1e-32 N where a rig would read 0.1 N."""
    group = np.repeat(np.arange(30), 2)
    residual = (100.0 * np.sin(np.arange(30.0)))[group] + 1e-13 * np.arange(60.0)
    noise = RepeatNoise.fitted(residual, group, 1.0, white=False)
    assert noise.between == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0.1)


def test_a_rig_with_nothing_wrong_says_so(trials):
    diagnosis = diagnose_rig([trials])
    assert diagnosis.verdict == "NO EFFECT"
    vehicle = diagnosis.search.nominal.runs[0].setup.plant.vehicle
    for name in ("slip_sinkage", "grouser_thrust", "load_scale"):
        assert 0.0 < diagnosis.limits[name] < EFFECTS[name].plausible(vehicle)


def test_what_no_effect_does_gets_no_name(trials):
    """A drive that stutters with slip follows no law of the library."""
    log = simulated_trials(draw_rig_case(22), UNMODELLED_RIG_FAULTS["stuttering_drive"](0.2))
    assert diagnose_rig([log]).verdict in ("UNEXPLAINED", "NAMED + UNEXPLAINED REST", "ONE OF")


def test_the_numbers_of_a_rig_are_those_of_a_vehicle_and_plain():
    log = simulated_trials(draw_rig_case(23), RIG_FAULTS["slip_exponent"](0.3))
    diagnosis = diagnose_rig([log])
    summary = summarise(diagnosis)
    numbers = summary.to_dict()
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert numbers["verdict"] == Verdict(numbers["verdict"]).value
    assert "slip_exponent" in numbers["causes"][0]["set"]
    assert numbers["gain"]["sinkage"]["extended"] < 0.8 * numbers["gain"]["sinkage"]["nominal"]
    case = draw_rig_case(23)
    member = numbers["n"]["after"]["slip_exponent"]
    assert abs(member["value"] - case.n) < max(4.0 * member["deviation"], 0.01)
    assert len(terminal_lines(summary)) <= 25
    extension = Extension(model=summary.model, effects=summary.extension)
    assert json.loads(json.dumps(extension.to_dict()))["model"] == "rig"
    figure = rig_figure(diagnosis)
    assert [axes.get_ylabel() for axes in figure.axes[:2]] == ["sinkage [mm]", "drawbar pull [N]"]


def test_sinkage_in_millimetres_ends_in_a_data_problem(trials):
    channels = trials.channels | {"sinkage": 1e3 * trials.channels["sinkage"]}
    assert diagnose_rig([replace(trials, channels=channels)]).verdict == "DATA PROBLEM"


def test_trials_of_two_wheels_are_refused(trials):
    other = simulated_trials(draw_rig_case(24))
    with pytest.raises(DataError, match="another wheel or soil"):
        diagnose_rig([trials, other])


# ------------------------------------------------------------------ settings are measured, too


def test_loads_that_scatter_on_paper_alone_are_told_from_loads_that_scatter(trials):
    """Repeats whose sinkage does not follow the load that is written down: the load cell scatters."""
    rng = np.random.default_rng(8)
    noisy = trials.channels["load"] * (1.0 + 0.1 * rng.standard_normal(len(trials)))
    written = replace(trials, channels=trials.channels | {"load": noisy})
    assert reliability_of(trials, Trials.of([trials])).load > 0.6
    assert reliability_of(written, Trials.of([written])).load < 0.2
    own, other = measured_trials([trials]), measured_trials([written])
    assert np.max(other.load_error) > 5.0 * np.max(own.load_error)
    for condition in np.unique(other.condition):
        assert np.ptp(other.load[other.condition == condition]) == 0.0


def test_a_load_written_down_wrongly_for_one_condition_is_taken_for_an_error_of_the_load(trials):
    """The latent load of a condition moves where sinkage and forces agree that it must."""
    table = measured_trials([trials])
    error = np.full(len(table), 0.1 * np.mean(table.load))
    wrong = table.load * np.where(table.condition == 12, 1.3, 1.0)
    fit = fit_rig(RigModel(trials, replace(table, load=wrong, load_error=error)))
    moved = fit.point.starts[0][:, 0] * error[0]
    expected = table.load[table.condition == 12][0] - wrong[table.condition == 12][0]
    assert moved[12] == pytest.approx(expected, rel=0.3)
    assert np.median(np.abs(moved)) < 0.2 * abs(expected)


# ------------------------------------------------------------------ physical ranges


def test_soil_never_pulls_and_no_wheel_hangs_above_the_sand(trials):
    run = _model(trials)
    for name in ("bulldozing", "front_bulldozing", "rut_drag", "slip_sinkage", "soil_loosening"):
        assert run.size_limits(name)[0] == 0.0
    soil = trials.config.soil
    assert run.size_limits("cohesion")[0] == -soil.c
    assert soil.phi + run.size_limits("friction_angle")[1] < np.radians(51.0)
    sinkage = trials.channels["sinkage"]
    least = min(np.mean(sinkage[run.trials.condition == c]) for c in np.unique(run.trials.condition))
    assert run.size_limits("sinkage_offset")[1] <= least + 1e-12


@pytest.mark.check
def test_a_force_that_only_soil_that_pulls_could_explain_is_not_named_bulldozing():
    """The sign of a bulldozing force turned round: no size of the library's effect may take it up."""
    case = replace(draw_rig_case(26), angles=(0.0, 0.35))
    stress = 0.2 * case.load / (0.2 * case.r * case.r)
    log = simulated_trials(case, RIG_FAULTS["bulldozing"](-stress))
    diagnosis = diagnose_rig([log], library=["bulldozing", "slip_sinkage"])
    assert "bulldozing" not in {cause.best.candidate.effect for cause in diagnosis.causes}
    assert diagnosis.verdict == "UNEXPLAINED"
    assert not any(cause.named for cause in summarise(diagnosis).causes)


# ------------------------------------------------------------------ few slip angles


def test_an_error_five_times_what_repeats_differ_by_is_testable_at_one_slip_angle():
    """What repeats share must not swallow an error that follows the slip."""
    case = replace(draw_rig_case(27), angles=(0.0,))
    log = simulated_trials(case, RIG_FAULTS["slip_sinkage"](1.0))
    fit = fit_rig(_model(log))
    noise = fit.noise.channels["sinkage"]
    assert noise.between > 5.0 * noise.repeat
    diagnosis = diagnose_rig([log], library=["slip_sinkage", "friction_angle", "drawbar_offset"])
    assert diagnosis.verdict in ("NAMED", "NAMED + UNEXPLAINED REST")
    assert [cause.best.candidate.effect for cause in diagnosis.causes] == ["slip_sinkage"]


def test_conditions_that_scatter_at_random_stay_noise():
    """Soil prepared a little differently for every condition is no error that follows the slip."""
    rng, slip = np.random.default_rng(9), np.repeat(np.linspace(-0.6, 0.8, 15), 3)
    group = np.repeat(np.arange(15), 3)
    shared = 1.0 * rng.standard_normal(15)[group]
    residual = shared + 0.1 * rng.standard_normal(45)
    noise = RigNoise(
        pieces={"sinkage": (slice(0, 45),)},
        groups={"sinkage": group},
        slips={"sinkage": slip[::3]},
        angles={"sinkage": np.zeros(15)},
    ).learned(residual, {})
    kept = noise.for_detection(residual).channels["sinkage"].between
    assert kept > 0.6 * noise.channels["sinkage"].between
    smooth = 3.0 * slip + 0.1 * rng.standard_normal(45)
    wavy = noise.learned(smooth, {})
    assert wavy.for_detection(smooth).channels["sinkage"].between < 0.2 * wavy.channels["sinkage"].between


# ------------------------------------------------------------------ laws of the wheel


@pytest.fixture(scope="module")
def own_sinkage() -> Log:
    """Trials of a wheel whose pressure follows each point's own sinkage, with soil pushed aside."""
    case = replace(draw_rig_case(31), angles=(0.0, 0.2, 0.4))
    log = simulated_trials(case)
    table, rng = log.channels, np.random.default_rng(10)
    forces = wheel_forces(
        log.config.soil._replace(n=case.n),
        log.config.wheel,
        load=table["load"],
        slip=table["slip"],
        slip_angle=table["slip_angle"],
        structure="full,pressure_from=own_sinkage",
    )
    scale = 0.005 * case.load
    found = {
        "sinkage": forces.sinkage + 0.003 * case.r * rng.standard_normal(len(log)),
        "drawbar": forces.F_x + scale * rng.standard_normal(len(log)),
        "side_force": forces.F_y + scale * rng.standard_normal(len(log)),
    }
    kept = {name: table[name] for name in ("slip", "slip_angle", "load", "condition")}
    return replace(log, channels=kept | found)


def test_the_laws_of_the_wheel_are_named_where_they_are_what_is_wrong(own_sinkage):
    library = ["friction_angle", "exit_angle"]
    diagnosis = diagnose_rig([own_sinkage], library=library)
    summary = summarise(diagnosis)
    assert diagnosis.structure is not None
    assert diagnosis.structure.laws == ("pressure_distribution",)
    assert summary.effects[0] == ["pressure_distribution"]
    assert summary.causes[0].named
    assert summary.structure == "full,pressure_from=own_sinkage"
    case = draw_rig_case(31)
    model = diagnosis.model
    assert model.runs[0].setup.plant.soil.n + model.nuisances[0] == pytest.approx(case.n, abs=0.02)
    numbers = summary.to_dict()
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert len(terminal_lines(summary)) <= 25


# ------------------------------------------------------------------ transfer


def test_causes_of_one_wheel_are_applied_to_another_with_nothing_fitted():
    first = draw_rig_case(33)
    second = replace(first, seed=34, r=1.4 * first.r, b=1.2 * first.b, load=1.6 * first.load)
    fault = RIG_FAULTS["slip_sinkage"](0.8)
    library = ["slip_sinkage", "friction_angle", "soil_stiffness"]
    diagnosis = diagnose_rig([simulated_trials(first, fault)], library=library)
    (other,) = transfer_to(diagnosis, [simulated_trials(second, fault)])
    gains = {gain.channel: gain for gain in other.gains}
    assert gains["sinkage"].extended < 0.4 * gains["sinkage"].nominal
    assert gains["sinkage"].extended < 0.4 * other.stated["sinkage"]
    (same,) = transfer_to(diagnosis, [simulated_trials(second, fault)])
    assert same.gains == other.gains


# ------------------------------------------------------------------ nothing is lost


def _random_trials(seed: int) -> Log:
    """Trials as users may have them: few angles, loads of any size, faults too large, missing channels."""
    rng = np.random.default_rng([seed, 77])
    case = draw_rig_case(int(rng.integers(1, 100_000)))
    angles = ((0.0,), (0.0, 0.3), (0.0, 0.15, 0.35, 0.6), (0.0, 0.3, 0.6, 0.9, 1.2))[rng.integers(0, 4)]
    case = replace(case, angles=angles, load=case.load * float(rng.choice([0.3, 1.0, 3.0])))
    sizes = {
        "slip_sinkage": 1.5,
        "friction_angle": -0.4,
        "peak_angle": 0.7,
        "load_scale": 0.8,
        "cohesion": -1e5,
    }
    name = str(rng.choice(list(sizes)))
    log = simulated_trials(case, RIG_FAULTS[name](sizes[name]))
    rows = rng.random(len(log)) < rng.choice([1.0, 0.5])
    rows[:4] = True
    channels = {key: values[rows] for key, values in log.channels.items()}
    channels.pop(str(rng.choice(["drawbar", "side_force", "torque", "sinkage"])))
    return replace(log, channels=channels)


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_a_diagnosis_of_any_trials_ends_with_a_verdict(seed):
    library = ["slip_sinkage", "friction_angle", "sinkage_offset", "peak_angle", "cohesion"]
    try:
        diagnosis = diagnose_rig([_random_trials(seed)], library=library)
    except OffroadError:
        return
    summary = summarise(diagnosis)
    assert summary.verdict in Verdict
    assert not diagnosis.failed
    assert json.dumps(summary.to_dict(), allow_nan=False)


def test_a_part_that_breaks_down_loses_nothing_else(trials, monkeypatch):
    def broken(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("estimators.discrepancy.rig_diagnosis.search_rig", broken)
    diagnosis = diagnose_rig([trials])
    summary = summarise(diagnosis)
    assert diagnosis.limits
    assert "Singular matrix" in summary.failed["search"]
    assert any(line.startswith("missing: search") for line in terminal_lines(summary))


# ------------------------------------------------------------------ the measured wheel


@pytest.mark.check
def test_the_soil_bin_is_explained_on_a_slip_angle_that_the_search_has_not_seen():
    """Bars: sinkage and drawbar pull at least 60 % better, side force 55 %."""
    path = measured_data("cmu_single_wheel") / "original" / "all_grouser_data.mat"
    diagnosis = diagnose_rig([cmu_rig_log(path)])
    numbers = summarise(diagnosis).to_dict()
    assert numbers["verdict"] == "NAMED + UNEXPLAINED REST"
    less = {name: 1.0 - g["extended"] / g["nominal"] for name, g in numbers["gain"].items()}
    assert less["sinkage"] > 0.6
    assert less["drawbar"] > 0.6
    assert less["side_force"] > 0.55
    assert all(gain["low"] > 0.0 for gain in numbers["gain"].values())
    assert {"slip sinkage", "soil pushed aside", "distribution of the pressure"} <= {
        family for families in numbers["families"] for family in families
    }
