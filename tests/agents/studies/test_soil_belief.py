"""The study of the online belief over whole soils."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.studies.soil_belief import study
from agents.studies.soil_belief.figure import soil_belief_figure
from agents.studies.soil_belief.study import (
    AT,
    BARS,
    SoilBelief,
    case_lines,
    limit_lines,
    run_unit,
    stuck_lines,
    widths_over_time,
)
from estimators.experiments.soil_belief import believe, limit_errors
from estimators.experiments.unknown_soils import CASES, SPLITS, TEST_CASES, draw_run
from offroad_env.errors import InvalidParameter
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import heights


def test_a_unit_is_a_drive_in_plain_numbers() -> None:
    unit = run_unit("phi_2", 0, "tuning")
    again = run_unit("phi_2", 0, "tuning")
    assert unit == again
    assert np.shape(unit["z"]) == np.shape(unit["width"]) == (len(AT), 6)
    widths = np.array(unit["width"])
    assert (widths[-1, 1:5] < widths[0, 1:5]).all()


def test_a_drive_counts_after_the_time_that_is_asked_for(tmp_path, monkeypatch) -> None:
    late, soon = run_unit("matched", 0, "tuning", 7.0), run_unit("matched", 0, "tuning", 6.0)
    assert late["z"][:2] == soon["z"][:2]
    assert late["z"][2] != soon["z"][2]
    seen = []

    def run_units(path, unit, units, **_):
        seen.extend(units)
        return {("matched", 0, "tuning"): _result(1.0, 0.1, 0.5, 0.0)}

    monkeypatch.setattr(study, "run_units", run_units)
    for after in (10.0, 60.0):
        SoilBelief(out=tmp_path, under=("matched",), case_seeds=1, after=after).run()
    assert seen == [("matched", 0, "test"), ("matched", 0, "test", 60.0)]
    for after in (5.0, 121.0):
        with pytest.raises(InvalidParameter, match="after must be above 5 and at most 120"):
            SoilBelief(out=tmp_path, after=after).run()


@pytest.mark.study
def test_intervals_hold_as_often_after_a_minute_as_after_ten_seconds() -> None:
    """Without `averaging_time` 70 to 78 % of the intervals of n held."""
    z = []
    for seed in range(500, 540):
        run = draw_run("level", seed, split="tuning", duration=60.0)
        z.append(limit_errors(run, believe(run)).z[-1])
    assert (np.abs(z) < 1.96).mean(axis=0).min() > 0.85


def test_cases_of_one_seed_differ_in_one_thing() -> None:
    cases = ("matched", "phi_2")
    plain, other = (draw_run(case, 1, split="tuning", duration=1.0).record.plant for case in cases)
    assert abs(other.soil.phi - plain.soil.phi) == pytest.approx(CASES["phi_2"].phi)
    assert other.soil._replace(phi=plain.soil.phi) == plain.soil
    assert plain.soil == SOILS["clay"]
    assert other.vehicle == plain.vehicle


def test_what_is_for_tests_only_has_no_drives_for_tuning() -> None:
    assert {"width_1", "clock_2", "together"} <= set(TEST_CASES) < set(CASES)
    with pytest.raises(InvalidParameter, match="for tests only"):
        draw_run("grade_1", 0, split="tuning")


def test_cases_for_tests_differ_as_they_say() -> None:
    plain = draw_run("matched", 2, duration=1.0).record
    wide, wind, climb, late, field = (
        draw_run(case, 2, duration=1.0).record
        for case in ("width_2", "wind_2", "grade_2", "clock_2", "scatter_1")
    )
    ratio = wide.plant.vehicle.b / plain.plant.vehicle.b
    assert max(ratio, 1.0 / ratio) == pytest.approx(1.2)
    assert wind.plant.vehicle.drag_area == pytest.approx(4.0 * plain.plant.vehicle.drag_area)
    assert abs(climb.plant.ground.S_x) == pytest.approx(0.05, rel=0.01)
    behind = np.nanmedian(plain.gnss[50:, 0] - late.gnss[50:, 0])
    assert behind == pytest.approx(0.3 * plain.gnss[50:, 2][np.isfinite(plain.gnss[50:, 2])].mean(), rel=0.25)
    assert field.plant.soil_field is not None
    assert not CASES["width_1"].is_modelled


def test_what_the_filter_is_told_differs_as_the_cases_say() -> None:
    start, waves, moved, tyre = (
        draw_run(case, 2, duration=0.5) for case in ("start_2", "waves_2", "map_2", "tyre_2")
    )
    assert abs(start.pose.X) == abs(start.pose.Y) == 1.5
    X, Y = np.linspace(0.0, 7.0, 20), np.linspace(-2.0, 4.0, 20)
    truth = heights(waves.record.plant.ground, X, Y)
    assert np.ptp(truth) > 0.03
    assert np.ptp(heights(waves.stated.ground, X, Y)) == 0.0
    np.testing.assert_allclose(heights(moved.stated.ground, X + 1.0, Y + 1.0), truth, atol=1e-12)
    ratio = tyre.record.plant.structure.tyre.inflation / tyre.stated.structure.tyre.inflation
    assert max(ratio, 1.0 / ratio) == pytest.approx(1.4)


def test_sizes_at_random_are_none_that_a_case_does_not_have() -> None:
    runs = [draw_run("random", seed, duration=0.5) for seed in range(3)]
    assert len({run.record.plant.vehicle.b for run in runs}) == 3
    for run in runs:
        plant = run.record.plant
        ratio = plant.vehicle.b / run.stated.vehicle.b
        assert 1.0 <= max(ratio, 1.0 / ratio) <= 1.2
        assert abs(run.pose.X) <= 1.5


def test_the_ground_slopes_with_all_nuisances_and_nothing_else_changes_without() -> None:
    hilly, level = (draw_run(case, 4, split="tuning", duration=0.5) for case in ("nuisances", "level"))
    assert hilly.slopes != level.slopes == (0.0, 0.0)
    assert hilly.record.plant.ground.S_x == pytest.approx(hilly.slopes[0])
    assert hilly.record.plant.soil == level.record.plant.soil
    assert hilly.record.plant.vehicle == level.record.plant.vehicle
    slopes = np.array([draw_run("nuisances", seed, duration=0.1).slopes for seed in range(12)])
    assert 0.02 < slopes.std() < 0.045


def test_soils_of_tuning_and_test_are_not_the_same() -> None:
    runs = [draw_run("nuisances", 0, split=split, duration=1.0).record for split in SPLITS]
    assert runs[0].plant.soil != runs[1].plant.soil


def _result(z: float, used: float, flag: float, outside: float) -> dict[str, object]:
    ones = np.ones((len(AT), 6))
    return {
        "z": (z * ones).tolist(),
        "error": (0.1 * ones).tolist(),
        "width": (0.3 * ones).tolist(),
        "used": [used, used],
        "valid": True,
        "flag": [round(100 * flag), 100],
        "outside": [[round(50 * outside)] + [0] * 5, 50],
        "stuck": math.inf,
        "foreseen": True,
        "over_bound": [[2.0] * 6, [1.0] * 6],
        "risk": [0.1, 0.9, 0.9],
        "no_pull": True,
        "announced": math.inf,
        "distance": 50.0,
    }


def test_lines_count_what_they_say() -> None:
    results = {("nuisances", i, "test"): _result(3.0 if i < 2 else 1.0, 0.1 * i, 0.5, 0.2) for i in range(10)}
    results |= {("grid", 0, "test"): _result(1.0, 0.0, 0.05, 0.0)}
    limits, cases = limit_lines(results), case_lines(results)
    assert [line.coverage for line in limits] == [0.8] * 6
    assert [line.runs_used for line in limits] == [4, 4, 0, 0, 0, 0]
    assert cases[0][:3] == ("nuisances", 10, 0.5)
    assert cases[0].outside == pytest.approx(0.2)
    assert cases[0].worst == "lateral"
    assert cases[0].over_bound == [[2.0] * 6, [1.0] * 6]
    assert cases[1].flag == pytest.approx(0.05)
    figure = soil_belief_figure(limits, widths_over_time(results), AT, BARS)
    assert len(figure.axes) == 2


@pytest.mark.parametrize(("announced", "share"), [(3.0, 1.0), (5.5, 0.0), (math.inf, 0.0)])
def test_an_immobilisation_counts_as_announced_two_seconds_ahead(announced: float, share: float) -> None:
    stuck = {**_result(1.0, 0.1, 0.5, 0.0), "stuck": 7.0, "announced": announced}
    early, sudden = {**stuck, "stuck": 1.0}, {**stuck, "foreseen": False}
    free = {**_result(1.0, 0.1, 0.5, 0.0), "announced": announced}
    line = stuck_lines(
        {("soft", i, "test"): unit for i, unit in enumerate((stuck, early, sudden, free, free))}
    )[0]
    assert (line.case, line.stuck, line.announced) == ("soft", 1, share)
    assert line.false == (0 if announced == math.inf else 2)
    assert line.kilometres == pytest.approx(0.1)
    # The one that was stuck after 1 s tells nothing of the risk after 5 s.
    assert line.risks[2] == (4, 1.0)


def test_what_is_not_a_case_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidParameter, match="under must name some of nuisances"):
        SoilBelief(out=tmp_path, under=("moon",)).run()
    with pytest.raises(InvalidParameter, match="case must be one of"):
        draw_run("moon", 0)


@pytest.mark.parametrize(("method", "name"), [("online", "soil_belief"), ("fitted", "fitted_belief")])
def test_each_method_has_its_own_results(tmp_path, monkeypatch, method, name) -> None:
    seen = []

    def run_units(path, unit, units, **_):
        seen.append((path.name, unit.__name__))
        return {("matched", 0, "tuning"): _result(1.0, 0.1, 0.5, 0.0)}

    monkeypatch.setattr(study, "run_units", run_units)
    SoilBelief(out=tmp_path, under=("matched",), case_seeds=1, tuning=True, method=method).run()
    assert seen == [(f"{name}.jsonl", "run_unit" if method == "online" else "run_fitted_unit")]
