"""Effects that are fitted from stated numbers, where a fit has left these."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from agents.studies.closed_loop import study
from agents.studies.closed_loop.planning import careful, make_world, shipped_knobs
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.model.fit import HOPELESS
from estimators.discrepancy.model.linearisation import Jacobian
from estimators.discrepancy.model.parameters import Candidate, Point
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.search import alternatives, from_stated, stepwise
from estimators.discrepancy.search.lower_minimum import LEFT
from estimators.discrepancy.search.result import EQUIVALENT
from estimators.logs.tolerances import TOLERANCES
from offroad_env.errors import SolverFailure


def scores_of(away, z, *, alike=1.0):
    """Two numbers, of `payload` and `inertia`, ``away`` from what is stated, and four candidates."""
    numbers = [SimpleNamespace(effect=name) for name in ("payload", "inertia")]
    problem = SimpleNamespace(nuisances=numbers, nuisance_spread=np.ones(2))
    problem.exponent, problem.stated = lambda n: n, lambda: 0.7
    plant = SimpleNamespace(vehicle=SimpleNamespace(m=1000.0))
    run = SimpleNamespace(setup=SimpleNamespace(plant=plant), size_limits=lambda name: (-0.9, 2.0))
    fit = SimpleNamespace(
        nuisances=np.array(away), problem=problem, runs=[run], cost=100.0, candidates=(), sizes=np.empty(0)
    )
    fit.point = 0.7
    names = ("payload", "inertia", "steer_gain", "torque_scale")
    white = np.column_stack([np.eye(2), alike * np.eye(2), np.ones((2, 2))])
    return SimpleNamespace(
        fit=fit,
        candidates=tuple(Candidate(effect=name) for name in names),
        z=np.array(z),
        size=np.array(z),
        white=white,
    )


@pytest.mark.parametrize(("inertia", "found"), [(2.4, False), (2.6, True)])
def test_a_number_that_is_far_off_is_suspected_of_its_own_effect(monkeypatch, inertia, found):
    monkeypatch.setattr(from_stated, "_WHATEVER", 1)
    suspects = from_stated._suspects(scores_of((6.0, -inertia), (0.0, 0.0, 3.0, 1.0)))
    signs = {candidate.effect: sign for candidate, sign, _ in suspects}
    assert list(signs) == ["payload", "inertia", "steer_gain"] if found else ["payload", "steer_gain"]
    assert signs["payload"] == 1.0
    assert signs.get("inertia", -1.0) == -1.0


def test_an_effect_that_undoes_its_number_begins_with_the_other_sign():
    suspects = from_stated._suspects(scores_of((6.0, -6.0), (0.0, 0.0, 0.0, 0.0), alike=-1.0))
    assert {c.effect: (sign, numbers) for c, sign, numbers in suspects}["payload"] == (-1.0, (0,))


@pytest.mark.parametrize(("away", "asked"), [(LEFT - 0.1, 0), (LEFT + 0.1, 12)])
def test_nothing_is_fitted_where_the_numbers_are_about_as_stated(monkeypatch, away, asked):
    begun = []
    monkeypatch.setattr(from_stated, "_exchanged", lambda *arguments: None)

    def fitted(fit, candidates, sizes, near, *, n, numbers):
        begun.append((candidates[-1].effect, float(sizes[-1])))
        raise SolverFailure("does not drive")

    monkeypatch.setattr(from_stated, "begun_afresh", fitted)
    scores = scores_of((away, 3.0), (0.0, 0.0, 3.0, -2.0))
    assert from_stated.fits_from_stated(scores, 3.0) == []
    assert len(begun) == asked
    # Beside another effect the model has been fitted from stated numbers already.
    scores.fit.candidates = (Candidate(effect="inertia"),)
    assert from_stated.fits_from_stated(scores, 3.0) == []
    assert len(begun) == asked


def descents(ended=None, least=None):
    """Descents that stay where they begin; ends of those to a minimum, and what they must reach."""

    def descent(rounds=8, enough=np.inf):
        def descend(fit, *, fresh=True):
            if ended is not None and not fresh:
                ended.append(float(fit.sizes[-1]))
            if least is not None and not fresh:
                least.append(enough)
            return fit

        return SimpleNamespace(descend=descend)

    return descent


@dataclass
class Rough:
    """A rough fit, whose derivatives are not by all numbers."""

    cost: float
    candidates: tuple
    sizes: tuple
    runs: list
    n: float | None
    jacobian: str = "rough"


def rough(costs, seen):
    """Rough fits of these costs by effect and size, and what they were given as `near`."""

    def begun(fit, candidates, sizes, near, *, n, numbers):
        assert not numbers
        effect, run = candidates[-1].effect, fit.runs[0]
        cost = costs[effect] if np.isscalar(costs[effect]) else costs[effect][len(seen.get(effect, ()))]
        seen.setdefault(effect, []).append(near)
        return Rough(cost=cost, candidates=candidates, sizes=sizes, runs=[run], n=n)

    return begun


def test_of_models_that_are_fitted_only_those_are_kept_that_explain_enough(monkeypatch):
    costs = {"payload": 80.0, "inertia": 96.0, "steer_gain": 80.5, "torque_scale": 60.0}
    least = []
    monkeypatch.setattr(from_stated, "begun_afresh", rough(costs, {}))
    monkeypatch.setattr(from_stated, "GaussNewton", descents(least=least))
    monkeypatch.setattr(from_stated, "_exchanged", lambda *arguments: None)
    found = from_stated.fits_from_stated(scores_of((6.0, 6.0), (0.0, 0.0, 3.0, -2.0)), 3.0)
    assert [one.candidates[-1].effect for one in found] == ["payload", "steer_gain", "torque_scale"]
    # What is no alternative to the best so far is not fitted to the end.
    assert least == [95.5, *[80.0 + 0.5 * EQUIVALENT] * 3]


def test_of_sizes_to_begin_from_the_one_is_fitted_to_the_end_that_explains_most_roughly(monkeypatch):
    """The derivatives of the first rough fit serve all others."""
    costs, seen, ended = {"payload": [190.0, 170.0, 180.0, 175.0], "inertia": [60.0, 50.0]}, {}, []
    monkeypatch.setattr(from_stated, "begun_afresh", rough(costs, seen))
    monkeypatch.setattr(from_stated, "GaussNewton", descents(ended))
    fit = scores_of((6.0, 0.0), (0.0, 0.0, 0.0, 0.0)).fit
    monkeypatch.setattr(fit.runs[0], "size_limits", lambda name: (-9.0, 9.0))
    best, near = from_stated._from_stated(fit, Candidate(effect="payload"), (1.0, -1.0), np.inf, None)
    assert best.cost == 170.0
    assert near.cost == 190.0
    assert seen["payload"] == [None, near, near, near]
    other, again = from_stated._from_stated(fit, Candidate(effect="inertia"), (1.0, -1.0), np.inf, near)
    assert other.cost == 50.0
    assert again is near
    assert seen["inertia"] == [near, near]  # better than the present fit: no other sign
    assert len(ended) == 2


@pytest.mark.parametrize(
    ("n", "begins"), [(0.7, [None]), (0.79, [None]), (0.81, [None, 0.81]), (0.4, [None, 0.4])]
)
def test_fits_begin_with_the_stated_n_and_with_another_that_a_fit_has_found(monkeypatch, n, begins):
    """A friction angle on soft soil was not found from the stated n, nor from that of a fit on firmer one."""
    asked = []

    def begun(fit, candidates, sizes, near, *, n, numbers):
        asked.append(n)
        return Rough(1.0, candidates, sizes, fit.runs, n)

    monkeypatch.setattr(from_stated, "begun_afresh", begun)
    monkeypatch.setattr(from_stated, "GaussNewton", descents())
    fit = scores_of((6.0, 0.0), (0.0, 0.0, 0.0, 0.0)).fit
    fit.point = n
    best, _ = from_stated._from_stated(fit, Candidate(effect="payload"), (1.0,), np.inf, None)
    assert asked == 2 * begins
    assert best.jacobian == Jacobian()


@pytest.mark.parametrize(("share", "kept"), [(0.95, True), (1.05, False)])
def test_no_descent_begins_where_the_vehicle_does_not_drive_as_logged(monkeypatch, share, kept):
    fit = scores_of((6.0, 0.0), (0.0, 0.0, 0.0, 0.0)).fit
    monkeypatch.setattr(from_stated, "begun_afresh", rough({"payload": share * HOPELESS * fit.cost}, {}))
    monkeypatch.setattr(from_stated, "GaussNewton", descents())
    best, near = from_stated._from_stated(fit, Candidate(effect="payload"), (1.0,), np.inf, None)
    assert (best is not None) == kept
    assert near is not None


def test_a_model_from_stated_numbers_whose_effect_was_refused_is_not_offered_again(monkeypatch):
    asked = []
    monkeypatch.setattr(stepwise, "_forward", lambda scores, threshold, enough: asked.append(enough) or [])
    monkeypatch.setattr(stepwise, "delayed", lambda *_: [])
    for module in (stepwise, alternatives):
        monkeypatch.setattr(module, "order_of", lambda one: (one.cost > 52.0, one.cost))
    scores = scores_of((6.0, 0.0), (0.0, 0.0, 3.0, -2.0))
    begun = [
        SimpleNamespace(candidates=(Candidate(effect=name),), cost=50.0) for name in ("payload", "inertia")
    ]
    assert stepwise._larger(scores, 3.0, None, begun, True) == begun
    scores.candidates = scores.candidates[1:]
    assert stepwise._larger(scores, 3.0, None, begun, True) == begun[1:]
    # The others are fitted to the end only where they may be as good; one at the end of its range is no bar.
    begun[1].cost = 53.0
    stepwise._larger(scores, 3.0, None, begun, True)
    assert asked == [50.0 + 0.5 * EQUIVALENT] * 2 + [np.inf]


def test_an_effect_begins_in_the_place_of_its_number_at_the_size_that_does_the_same(monkeypatch):
    monkeypatch.setattr(from_stated, "GaussNewton", descents())
    monkeypatch.setattr(from_stated, "_doing_the_same", lambda *_: None)
    scores = scores_of((6.0, 1.0), (0.0, 0.0, 0.0, 0.0), alike=2.0)
    scores.fit.point = Point(nuisances=scores.fit.nuisances, sizes=np.empty(0), starts=(), warm=(), centre=())
    scores.fit.moved = lambda point: point
    monkeypatch.setattr(scores.fit.runs[0], "size_limits", lambda name: (-0.9, 20.0))
    begun = from_stated._exchanged(scores, scores.candidates[0], (0,))
    assert begun.nuisances.tolist() == [0.0, 1.0]
    assert begun.sizes.tolist() == [3.0]
    assert scores.fit.nuisances.tolist() == [6.0, 1.0]
    monkeypatch.setattr(scores.fit.runs[0], "size_limits", lambda name: (-0.9, 2.0))
    assert from_stated._exchanged(scores, scores.candidates[0], (0,)).sizes.tolist() == [2.0]
    # By what it makes of the vehicle, and not by traces, if that is the same.
    monkeypatch.setattr(from_stated, "_doing_the_same", lambda *_: 0.7)
    assert from_stated._exchanged(scores, scores.candidates[0], (0,)).sizes.tolist() == [0.7]


@pytest.fixture(scope="module")
def run():
    return RunModel(simulated_log(draw_case(100, road="unknown", natural=True, duration=8.0)))


def moved(run, **numbers):
    """A fit with these numbers so many standard deviations off, and their places."""
    names = [nuisance.name for nuisance in run.nuisances]
    values, places = np.zeros(len(names)), [names.index(name) for name in numbers]
    values[places] = [*numbers.values()]
    problem = SimpleNamespace(nuisances=run.nuisances)
    return SimpleNamespace(runs=[run], problem=problem, nuisances=values), tuple(places)


@pytest.mark.parametrize("away", [-6.0, 3.0])
def test_an_effect_takes_the_place_of_a_number_exactly(run, away):
    fit, places = moved(run, strength=away)
    size = from_stated._doing_the_same(fit, Candidate(effect="friction_angle"), places)
    there = run.nuisances[places[0]].change(run.setup, run, away)
    assert size == pytest.approx(there.plant.soil.phi - run.setup.plant.soil.phi, abs=1e-6)
    fit, places = moved(run, springs_f=away, springs_r=away)
    size = from_stated._doing_the_same(fit, Candidate(effect="spring_rate"), places)
    assert size == pytest.approx(math.exp(TOLERANCES["springs"] * away) - 1.0, abs=1e-6)


def test_what_no_effect_does_is_left_to_the_traces(run, monkeypatch):
    fit, places = moved(run, radius=6.0)
    assert from_stated._doing_the_same(fit, Candidate(effect="wheel_radius_scale"), places) is None
    fit, places = moved(run, springs_f=6.0, springs_r=-6.0)
    assert from_stated._doing_the_same(fit, Candidate(effect="spring_rate"), places) is None
    fit, places = moved(run, strength=0.0)
    assert from_stated._doing_the_same(fit, Candidate(effect="friction_angle"), places) is None
    # A size that is held, or a range without nothing, leaves no choice.
    for limits in ((0.0, 0.0), (0.1, 0.2)):
        fit, places = moved(run, strength=6.0)
        fit.runs = [SimpleNamespace(setup=run.setup, log=run.log, size_limits=lambda name, own=limits: own)]
        assert from_stated._doing_the_same(fit, Candidate(effect="friction_angle"), places) is None


@pytest.mark.parametrize(("front", "found"), [(1.9, True), (1.6, False)])
def test_an_effect_that_does_most_of_what_two_numbers_do_takes_their_place(run, front, found):
    fit, places = moved(run, springs_f=front, springs_r=3.0)
    size = from_stated._doing_the_same(fit, Candidate(effect="spring_rate"), places)
    assert (size is not None) == found


@pytest.mark.check
def test_a_late_steering_is_named_although_the_inertia_has_taken_its_place():
    """Before, numbers were beyond any tolerance, and nothing was named."""
    world = make_world(study.true_model("steer_delay"))
    n, *_, logged = study._drawn(0, 6)
    model, verdict = study._diagnosed(world, careful(shipped_knobs(), 0.5), logged, n)
    assert verdict == "NAMED"
    ((name, values),) = model.effects
    assert name == "steer_delay"
    assert values["delay"] == pytest.approx(0.24, abs=0.04)
