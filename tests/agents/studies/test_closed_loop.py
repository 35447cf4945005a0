"""What a diagnosis is worth to the one who drives."""

import numpy as np
import pytest

from agents.studies.closed_loop import study
from agents.studies.closed_loop.figure import closed_loop_figure
from agents.studies.closed_loop.planning import KNOBS, careful, make_world, plan_for, scores_in, shipped_knobs
from offroad_env.effects import Extension


def unit(nominal, extended, true, found=("payload",)):
    return {"found": list(found), "scores": {"nominal": nominal, "extended": extended, "true": true}}


def test_half_of_a_loss_is_recovered_where_half_of_it_is():
    results = {("payload", k, 2): unit([60.0 + k] * 2, [50.0 + k] * 2, [40.0 + k] * 2) for k in range(4)}
    (line,) = study.cause_lines(results)
    assert line.loss.value == pytest.approx(20.0)
    assert line.gain.value == pytest.approx(10.0)
    assert line.recovered.value == pytest.approx(0.5)
    assert (line.named, line.units) == (4, 4)


def test_no_share_is_given_of_a_loss_that_may_be_none():
    times = np.array([41.0, 39.0, 42.0, 38.0])
    results = {("payload", k, 1): unit([t], [t], [40.0], found=()) for k, t in enumerate(times)}
    (line,) = study.cause_lines(results)
    assert line.loss.low < 0.0 < line.loss.high
    assert line.recovered is None
    assert line.named == 0
    assert len(closed_loop_figure([line]).axes) == 1


def test_causes_without_a_loss_do_not_count_in_what_is_recovered_together():
    results = {("payload", k, 2): unit([60.0 + k] * 2, [50.0 + k] * 2, [40.0 + k] * 2) for k in range(4)}
    results |= {("cg_shift", k, 2): unit([90.0 + k] * 2, [50.0 + k] * 2, [50.0 + k] * 2) for k in range(4)}
    times = np.array([41.0, 39.0, 42.0, 38.0])
    results |= {("rut_drag", k, 2): unit([t], [99.0], [40.0], found=()) for k, t in enumerate(times)}
    lines = study.cause_lines(results)
    assert study.recovered_together(results, lines).value == pytest.approx(50.0 / 60.0)
    assert study.recovered_together(results, lines[2:]) is None
    # A soil on which one of the causes is missing is left out.
    del results["payload", 3, 2], results["cg_shift", 2, 2], results["cg_shift", 1, 2]
    assert study.recovered_together(results, lines) is None


def test_a_vehicle_whose_cause_is_not_named_is_driven_by_the_nominal_plan(monkeypatch):
    asked = []

    def planned(model, n, episodes, *, generations, seed):
        asked.append(model)
        return {"margin": 0.9 if model is None else 0.5}

    monkeypatch.setattr(study, "plan_for", planned)
    monkeypatch.setattr(study, "scores_in", lambda world, knobs, seeds, n: [knobs["margin"]] * len(seeds))
    monkeypatch.setattr(study, "_diagnosed", lambda *arguments: (None, "NO EFFECT"))
    result = study.run_unit("payload", 0, 2, nominal={0: study.planned(0, 2)})
    assert result["plans"]["extended"] == result["plans"]["nominal"]
    assert asked == [None, study.true_model("payload")]
    assert result["scores"] == {"nominal": [0.9] * 2, "extended": [0.9] * 2, "true": [0.5] * 2}


def test_the_first_drive_uses_a_share_of_the_planned_limit_only():
    knobs = shipped_knobs()
    assert careful(knobs, 0.5) == {**knobs, "margin": 0.5 * knobs["margin"]}


@pytest.mark.check
def test_a_plan_for_late_steering_arrives_where_the_nominal_one_leaves_the_corridor():
    late = Extension(model="full", effects=(("steer_delay", {"delay": 0.24}),))
    plan = plan_for(late, 0.7, [1, 2], generations=1, seed=0)
    assert all(low <= plan[name] <= high for name, (low, high) in KNOBS.items())
    world = make_world(late)
    assert np.mean(scores_in(world, shipped_knobs(), [1, 2], 0.7)) == 120.0
    assert np.mean(scores_in(world, plan, [1, 2], 0.7)) < 90.0
