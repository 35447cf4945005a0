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
from estimators.discrepancy.search import alternatives, from_stated, stepwise, unfitted
from estimators.discrepancy.search.lower_minimum import _ASTRAY, _ASTRAY_N, LEFT
from estimators.discrepancy.search.result import EQUIVALENT
from estimators.discrepancy.search.unfitted import Begin
from estimators.logs.tolerances import TOLERANCES
from offroad_env.effects import EFFECTS
from offroad_env.errors import SolverFailure


def scores_of(away, z, *, alike=1.0):
    """Two numbers, of `payload` and `inertia`, ``away`` from what is stated, and four candidates."""
    numbers = [SimpleNamespace(effect=name) for name in ("payload", "inertia")]
    problem = SimpleNamespace(nuisances=numbers, nuisance_spread=np.ones(2), hard=False)
    problem.exponent, problem.stated = lambda n: n, lambda: 0.6
    plant = SimpleNamespace(vehicle=SimpleNamespace(m=1000.0))
    run = SimpleNamespace(setup=SimpleNamespace(plant=plant), size_limits=lambda name: (-0.9, 2.0))
    fit = SimpleNamespace(
        nuisances=np.array(away), problem=problem, runs=[run], cost=100.0, candidates=(), sizes=np.empty(0)
    )
    fit.point = 0.6
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
    numbers = {candidate.effect: own for candidate, own in suspects}
    assert list(numbers) == ["payload", "inertia", "steer_gain"] if found else ["payload", "steer_gain"]
    assert numbers["payload"] == (0,)
    assert numbers.get("inertia", (1,)) == (1,)
    assert numbers["steer_gain"] == ()


def by_size(best, least=10.0, asked=None):
    """Costs before anything is fitted: least at a size (in plausible ones) and n for every effect."""

    def cost(fit, candidates, sizes, n):
        if asked is not None:
            asked.append((*(one.effect for one in candidates), *sizes, n))
        if any(one.effect not in best for one in candidates):
            return math.inf
        reaches = [EFFECTS[one.effect].plausible(fit.runs[0].setup.plant.vehicle) for one in candidates]
        there = [best[one.effect] for one in candidates]
        off = sum(abs(x / reach - share) for x, reach, (share, _) in zip(sizes, reaches, there, strict=True))
        return least + 100.0 * off + 100.0 * max(abs(n - where) for _, where in there)

    return cost


@pytest.mark.parametrize("share", [-1.0, -0.6, 0.2, 0.8])
@pytest.mark.parametrize("n", [0.4, 0.62, 1.2])
def test_a_fit_begins_at_the_size_and_the_exponent_that_cost_least_unfitted(monkeypatch, share, n):
    asked = []
    monkeypatch.setattr(unfitted, "unfitted_cost", by_size({"payload": (share, n)}, asked=asked))
    fit = scores_of((6.0, 0.0), (0.0, 0.0, 0.0, 0.0)).fit
    monkeypatch.setattr(fit.runs[0], "size_limits", lambda name: (-9.0, 9.0))
    reach = EFFECTS["payload"].plausible(fit.runs[0].setup.plant.vehicle)
    begin = unfitted.begin_of(fit, Candidate(effect="payload"))
    assert begin.sizes[0] / reach == pytest.approx(share)
    assert begin.n == pytest.approx(n, abs=0.051)
    # What is outside of the physical range is not tried.
    asked.clear()
    monkeypatch.setattr(fit.runs[0], "size_limits", lambda name: (-0.5 * reach, 9.0))
    unfitted.begin_of(fit, Candidate(effect="payload"))
    assert min(size for _, size, _ in asked) >= -0.5 * reach
    # On hard ground there is no exponent.
    asked.clear()
    fit.problem.hard = True
    unfitted.begin_of(fit, Candidate(effect="payload"))
    assert {n for _, _, n in asked} == {0.6}
    assert unfitted.begin_of(fit, Candidate(effect="inertia")) is None


def wide_fit(monkeypatch):
    fit = scores_of((6.0, 0.0), (0.0, 0.0, 0.0, 0.0)).fit
    monkeypatch.setattr(fit.runs[0], "size_limits", lambda name: (-1e9, 1e9))
    return fit


def test_other_effects_are_looked_at_about_one_exponent_and_the_best_closely(monkeypatch):
    names = ("payload", "inertia", "steer_gain", "torque_scale")
    asked, best = [], {name: (0.3 + 0.02 * i, 0.6) for i, name in enumerate(names)}
    monkeypatch.setattr(
        unfitted, "unfitted_cost", by_size({**best, "gyro_bias_yaw": (0.4, 0.6)}, asked=asked)
    )
    monkeypatch.setattr(unfitted, "_CLOSELY", 2)
    fit = wide_fit(monkeypatch)
    every = [Candidate(effect=name) for name in (*names, "gyro_bias_yaw", "spring_rate")]
    found = unfitted.looked_at(fit, every, 0.6)
    # What a sensor does is seen by scores; what has no solution is none.
    assert {one.candidates[0].effect for one in found} == set(names)
    assert not any(effect == "gyro_bias_yaw" for effect, *_ in asked)
    assert {n for *_, n in asked} == {0.6, 0.5, 0.7}
    # At 0.4 of a plausible size the last is nearest, and comes first.
    assert [one.candidates[0].effect for one in found[:2]] == ["torque_scale", "steer_gain"]


def test_pairs_begin_where_two_effects_of_different_families_cost_less_than_one(monkeypatch):
    asked = []
    best = {
        "torque_scale": (-0.4, 0.9),
        "steer_gain": (0.8, 0.9),
        "payload": (0.4, 0.9),
        "inertia": (0.4, 0.9),
    }
    sizes = {"torque_scale": -0.3, "payload": 0.3, "inertia": 0.3, "steer_gain": 0.3}
    fit = wide_fit(monkeypatch)
    reach = {name: EFFECTS[name].plausible(fit.runs[0].setup.plant.vehicle) for name in best}
    begins = [
        Begin(cost, (Candidate(effect=name),), (sizes[name] * reach[name],), 0.9)
        for name, cost in (("torque_scale", 50.0), ("payload", 55.0), ("inertia", 60.0), ("steer_gain", 90.0))
    ]
    monkeypatch.setattr(unfitted, "unfitted_cost", by_size(best, asked=asked))
    found = unfitted.begins_of_pairs(fit, begins)
    names = [tuple(one.effect for one in begin.candidates) for begin in found]
    # Payload and inertia are one family; of the pairs with them the first is the better.
    assert {frozenset(pair) for pair in names} >= {frozenset(("torque_scale", "steer_gain"))}
    assert frozenset(("payload", "inertia")) not in {frozenset(pair) for pair in names}
    assert len({frozenset(pair) for pair in names}) == len(names) <= 4
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    pair = found[names.index(("torque_scale", "steer_gain"))]
    assert pair.sizes[0] / reach["torque_scale"] == pytest.approx(-0.5, abs=0.21)
    assert pair.sizes[1] / reach["steer_gain"] == pytest.approx(0.8, abs=0.01)
    # Nothing where one effect costs less than any two.
    assert unfitted.begins_of_pairs(fit, [one._replace(cost=5.0) for one in begins]) == []


def test_firsts_and_seconds_of_pairs_are_of_different_families(monkeypatch):
    tried = []
    names = ("payload", "inertia", "torque_scale", "drive_scale", "steer_gain", "bulldozing")

    def coarse(fit, candidate, ns, first):
        tried.append((first.candidates[0].effect, candidate.effect))
        return Begin(1.0 + len(tried), (*first.candidates, candidate), (*first.sizes, 0.1), first.n)

    monkeypatch.setattr(unfitted, "_coarse", coarse)
    monkeypatch.setattr(unfitted, "_closely", lambda fit, begin: begin)
    monkeypatch.setattr(unfitted, "_PAIRS", 99)
    begins = [Begin(100.0 + i, (Candidate(effect=name),), (0.1,), 0.6) for i, name in enumerate(names)]
    found = unfitted.begins_of_pairs(None, begins)
    assert list(dict.fromkeys(first for first, _ in tried)) == ["payload", "torque_scale", "steer_gain"]
    pairs = [tuple(one.effect for one in begin.candidates) for begin in found]
    assert pairs == [
        ("payload", "torque_scale"),
        ("payload", "steer_gain"),
        ("torque_scale", "steer_gain"),
    ]


@dataclass
class Rough:
    """A rough fit, whose derivatives are not by all numbers."""

    cost: float
    candidates: tuple
    sizes: tuple
    runs: list
    jacobian: str = "rough"


def descents(least=None, seen=None):
    """Descents that stay where they begin; what those to a minimum must reach, and where they begin."""

    def descent(rounds=8, enough=np.inf):
        def descend(fit, *, fresh=True):
            if least is not None and not fresh:
                least.append(enough)
            if seen is not None and fresh:
                seen.append(fit)
            return fit

        return SimpleNamespace(descend=descend)

    return descent


def rough(costs, asked=None):
    """Rough fits of these costs by effect, and what they began from."""

    def begun(fit, candidates, sizes, *, n, numbers):
        assert not numbers
        effect = candidates[-1].effect
        if asked is not None:
            asked.append((effect, sizes[-1], n))
        if costs.get(effect) is None:
            raise SolverFailure("does not drive")
        return Rough(costs[effect], candidates, sizes, fit.runs)

    return begun


@pytest.mark.parametrize(
    ("away", "n", "asked"),
    [
        (_ASTRAY - 0.1, 0.6, 0),
        (_ASTRAY + 0.1, 0.6, 4),
        (0.0, 0.6 + _ASTRAY_N - 0.01, 0),
        (0.0, 0.6 - _ASTRAY_N - 0.01, 4),
    ],
)
def test_nothing_is_fitted_where_the_numbers_are_about_as_stated(monkeypatch, away, n, asked):
    begun, everywhere = [], dict.fromkeys(("payload", "inertia", "steer_gain", "torque_scale"), (0.4, 0.6))
    monkeypatch.setattr(from_stated, "_exchanged", lambda *arguments: None)
    monkeypatch.setattr(from_stated, "begins_of_pairs", lambda *arguments: [])
    monkeypatch.setattr(unfitted, "unfitted_cost", by_size(everywhere))
    monkeypatch.setattr(from_stated, "begun_afresh", rough({}, begun))
    scores = scores_of((away, 3.0), (0.0, 0.0, 3.0, -2.0))
    scores.fit.point = n
    assert from_stated.fits_from_stated(scores, 3.0, wide=True) == []
    assert len(begun) == asked
    # Beside another effect the model has been fitted from stated numbers already.
    scores.fit.candidates = (Candidate(effect="inertia"),)
    assert from_stated.fits_from_stated(scores, 3.0, wide=True) == []
    assert len(begun) == asked
    # On hard ground the exponent means nothing.
    scores.fit.candidates, scores.fit.problem.hard = (), True
    from_stated.fits_from_stated(scores, 3.0, wide=True)
    assert len(begun) == asked + (4 if away > _ASTRAY else 0)


def test_effects_that_cost_least_unfitted_come_first_and_those_are_kept_that_explain_enough(monkeypatch):
    costs = {"steer_gain": 96.0, "inertia": 80.0, "torque_scale": 80.5, "payload": 60.0}
    begin = {
        "payload": (0.1, 0.6),
        "inertia": (0.25, 0.6),
        "steer_gain": (0.4, 0.6),
        "torque_scale": (0.33, 0.6),
    }
    least, asked, seen = [], [], []
    monkeypatch.setattr(from_stated, "begins_of_pairs", lambda *arguments: [])
    monkeypatch.setattr(unfitted, "unfitted_cost", by_size(begin, least=100.0))
    monkeypatch.setattr(from_stated, "begun_afresh", rough(costs, asked))
    monkeypatch.setattr(from_stated, "GaussNewton", descents(least, seen))
    monkeypatch.setattr(from_stated, "_exchanged", lambda *arguments: None)
    found = from_stated.fits_from_stated(scores_of((6.0, 6.0), (0.0, 0.0, 3.0, -2.0)), 3.0, wide=True)
    assert [effect for effect, *_ in asked] == ["steer_gain", "inertia", "torque_scale", "payload"]
    assert [one.candidates[-1].effect for one in found] == ["inertia", "torque_scale", "payload"]
    # What is no alternative to the best so far is not fitted to the end.
    assert least == [95.5, 95.5, *[80.0 + 0.5 * EQUIVALENT] * 2]
    # Rough fits have no derivatives by numbers; the next step takes all.
    assert all(one.jacobian == Jacobian() for one in seen)


@pytest.mark.parametrize(("times", "asked"), [(1.55, 2), (1.65, 1)])
def test_what_costs_far_more_than_the_least_unfitted_is_only_fitted_in_its_number_s_place(
    monkeypatch, times, asked
):
    begun, exchanged = [], []
    first, second = Candidate(effect="payload"), Candidate(effect="inertia")

    def begin(fit, candidate):
        return Begin(100.0 if candidate == first else 100.0 * times, (candidate,), (0.3,), 0.6)

    def in_place(scores, candidate, numbers):
        exchanged.append(candidate)

    monkeypatch.setattr(from_stated, "_suspects", lambda scores: [(second, (1,)), (first, (0,))])
    monkeypatch.setattr(from_stated, "begin_of", begin)
    monkeypatch.setattr(from_stated, "looked_at", lambda *arguments: [])
    monkeypatch.setattr(from_stated, "begins_of_pairs", lambda *arguments: [])
    monkeypatch.setattr(from_stated, "_exchanged", in_place)
    monkeypatch.setattr(from_stated, "begun_afresh", rough({}, begun))
    assert from_stated.fits_from_stated(scores_of((6.0, 6.0), (0.0, 0.0, 0.0, 0.0)), 3.0, wide=True) == []
    assert [effect for effect, *_ in begun] == ["payload", "inertia"][:asked]
    assert exchanged == [first, second]
    # What is not wide does no more than that.
    begun.clear()
    assert from_stated.fits_from_stated(scores_of((6.0, 6.0), (0.0, 0.0, 0.0, 0.0)), 3.0, wide=False) == []
    assert not begun
    assert len(exchanged) == 4


def only_begun(monkeypatch, fitted, others=(), pairs=()):
    """One suspect without a number, other effects and pairs, each ``fitted`` from where it begins."""
    monkeypatch.setattr(from_stated, "order_of", lambda one: one.cost)
    monkeypatch.setattr(from_stated, "as_good_as", lambda found: found[0].cost)
    monkeypatch.setattr(from_stated, "_exchanged", lambda *arguments: None)
    monkeypatch.setattr(from_stated, "_from_stated", fitted)
    monkeypatch.setattr(from_stated, "_suspects", lambda scores: [(scores.candidates[0], ())])
    monkeypatch.setattr(from_stated, "begin_of", lambda fit, one: Begin(9.0, (one,), (0.3,), 0.6))
    monkeypatch.setattr(from_stated, "looked_at", lambda *arguments: list(others))
    monkeypatch.setattr(from_stated, "begins_of_pairs", lambda *arguments: list(pairs))


@pytest.mark.parametrize(("away", "counts"), [(LEFT - 0.1, False), (LEFT + 0.1, True)])
def test_what_a_tolerance_alone_releases_is_no_evidence_before_a_number_is_suspected(
    monkeypatch, away, counts
):
    """The data gain 1 in the log-likelihood, and the number that returns the rest."""
    scores = scores_of((away, 0.0), (0.0, 0.0, 0.0, 0.0))
    fit = scores.fit
    fit.problem.nuisance_prior_cost = lambda point: point
    fit.point, prior = 0.6, 0.5 * away**2
    cost = fit.cost - 1.0 - prior

    def fitted(fit, begin, enough):
        return SimpleNamespace(cost=cost, candidates=begin.candidates, point=0.6 - prior)

    only_begun(monkeypatch, fitted)
    assert bool(from_stated.fits_from_stated(scores, 3.0, wide=True)) is counts


@pytest.mark.parametrize(("cost", "kept"), [(75.4, True), (75.6, False)])
def test_pairs_follow_that_explain_more_than_one_effect_by_as_much_as_one_must(monkeypatch, cost, kept):
    pair = tuple(Candidate(effect=name) for name in ("payload", "steer_gain"))
    least: list[float] = []

    def fitted(fit, begin, enough):
        if len(begin.candidates) == 2:
            least.append(enough)
        return SimpleNamespace(cost=cost if len(begin.candidates) == 2 else 80.0, candidates=begin.candidates)

    only_begun(monkeypatch, fitted, pairs=[Begin(5.0, pair, (0.3, 0.1), 0.6)])
    found = from_stated.fits_from_stated(scores_of((6.0, 6.0), (0.0, 0.0, 0.0, 0.0)), 3.0, wide=True)
    assert [len(one.candidates) for one in found] == ([1, 2] if kept else [1])
    assert least == [75.5]


def test_not_more_than_so_many_effects_are_fitted_from_where_they_cost_least(monkeypatch):
    begun: list[str] = []
    names = [name for name in EFFECTS if name != "payload"][:11]
    others = [Begin(9.1 + 0.1 * i, (Candidate(effect=name),), (0.3,), 0.6) for i, name in enumerate(names)]
    only_begun(monkeypatch, lambda fit, begin, enough: begun.append(begin.candidates[0].effect), others)
    assert from_stated.fits_from_stated(scores_of((6.0, 6.0), (0.0, 0.0, 0.0, 0.0)), 3.0, wide=True) == []
    assert begun == ["payload", *names[:7]]


@pytest.mark.parametrize(("share", "kept"), [(0.95, True), (1.05, False)])
def test_no_descent_begins_where_the_vehicle_does_not_drive_as_logged(monkeypatch, share, kept):
    fit = scores_of((6.0, 0.0), (0.0, 0.0, 0.0, 0.0)).fit
    monkeypatch.setattr(from_stated, "begun_afresh", rough({"payload": share * HOPELESS * fit.cost}))
    monkeypatch.setattr(from_stated, "GaussNewton", descents())
    begin = Begin(1.0, (Candidate(effect="payload"),), (0.4,), 0.6)
    best = from_stated._from_stated(fit, begin, np.inf)
    assert (best is not None) == kept


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
