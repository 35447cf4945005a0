"""Several causes at once: hidden, proposed by the scores, and fitted where the road is rough."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.faults.combined import combined
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.fit import fit_runs
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.search import stepwise as search_module
from estimators.discrepancy.search.alternatives import order_of
from estimators.discrepancy.search.holdout import HoldOutResult
from estimators.discrepancy.search.pair_search import linearised_gain, proposed_pairs
from estimators.discrepancy.search.refitting import refit
from estimators.discrepancy.search.result import Alternative, Cause, separation
from estimators.discrepancy.summarise import summarise_causes
from estimators.discrepancy.verdict import VehicleChecks, VehicleDiagnosis, Verdict
from estimators.discrepancy.wording import verdict_sentence

_NAMES = ("payload", "grade", "torque_scale", "aero_drag", "bank")


def _scores(inside: int, sizes: np.ndarray) -> tuple[SimpleNamespace, SimpleNamespace]:
    """A fit with the first effects in the model, and the scores of all others, in white residuals.

    The third effect's trace lies between those of the first two; their sizes are ``sizes``.
    """
    rng = np.random.default_rng(7)
    traces = rng.standard_normal((4000, len(_NAMES)))
    traces[:, 2] = traces[:, 0] + traces[:, 1] + 0.5 * traces[:, 2]
    data = traces[:, :2] @ sizes
    held = traces[:, :inside]
    fitted = np.linalg.lstsq(held, data, rcond=None)[0]
    left = data - held @ fitted
    free = traces[:, inside:] - held @ np.linalg.lstsq(held, traces[:, inside:], rcond=None)[0]
    information = free.T @ free
    candidates = [Candidate(effect=name) for name in _NAMES]
    result = SimpleNamespace(
        candidates=tuple(candidates[inside:]),
        z=free.T @ left / np.sqrt(np.diag(information)),
        size=free.T @ left / np.diag(information),
        information=information,
        joint=traces.T @ traces,
    )
    return SimpleNamespace(candidates=tuple(candidates[:inside]), sizes=fitted), result


def test_two_causes_are_proposed_where_a_third_is_confounded_with_both():
    sizes = np.array([0.1, 0.12])
    fit, result = _scores(0, sizes)
    assert result.candidates[int(np.argmax(np.abs(result.z)))].effect == "torque_scale"
    best = proposed_pairs(fit, result, [], 3)[0]
    assert {candidate.effect for candidate in best.candidates} == {"payload", "grade"}
    assert np.array(best.sizes) == pytest.approx(sizes)
    assert best.gain > np.max(result.z**2) + 10.0


def _model(residual: np.ndarray, null: np.ndarray | None, off: float = 0.0) -> SimpleNamespace:
    """A fit with these whitened residuals, one nuisance ``off`` its prior, and null residuals (M, K)."""
    return SimpleNamespace(
        residual=residual,
        cost=0.5 * float(residual @ residual) + 0.5 * off**2,
        noise=SimpleNamespace(whiten=lambda columns: columns),
        without_states=lambda table: table,
        null=None if null is None else SimpleNamespace(white=null),
        problem=SimpleNamespace(nuisance_prior_cost=lambda point: 0.5 * off**2),
        point=None,
    )


def test_a_likelihood_ratio_is_worth_less_where_road_and_soil_scatter_along_the_difference():
    """Null residuals with nine times the variance along the difference, and none across it."""
    noise = np.random.default_rng(3).standard_normal(400)
    apart = np.zeros(400)
    apart[:100] = 0.5
    unit = apart / np.linalg.norm(apart)
    scatter = 3.0 * np.outer(unit, np.array([1.0, -1.0]))
    plain = separation(_model(noise, None), _model(noise + apart, None))
    assert plain == pytest.approx(float(apart @ apart + 2.0 * noise @ apart))
    assert separation(_model(noise, scatter), _model(noise + apart, scatter)) == pytest.approx(plain / 9.0)
    across = np.roll(scatter, 200, axis=0)
    assert separation(_model(noise, across), _model(noise + apart, across)) == pytest.approx(plain)
    # An implausible tolerance is no residual.
    far = separation(_model(noise, scatter), _model(noise + apart, scatter, off=4.0))
    assert far == pytest.approx(plain / 9.0 + 16.0)


@pytest.mark.parametrize(
    ("gap", "gain", "replaces"),
    [
        (20.0, 12.0, True),
        (8.0, 12.0, False),
        (20.0, 1.0, False),
        (20.0, None, True),
        # Far more than noise in the fitted windows, and none of the two is rejected by those apart.
        (37.0, 1.0, True),
        (35.0, 1.0, False),
        (37.0, -6.0, False),
    ],
)
def test_a_pair_takes_the_place_of_one_cause_where_windows_apart_reject_the_one_or_the_gain_is_large(
    monkeypatch, gap, gain, replaces
):
    result = None if gain is None else HoldOutResult(gain=gain, expected=4.0, deviation=4.0)
    monkeypatch.setattr(search_module, "separation", lambda better, other: gap)
    test = SimpleNamespace(result=lambda larger, smaller: result)
    assert search_module._replaces(None, None, 3.0, test) is replaces


def test_a_size_at_an_end_of_its_range_comes_after_all_that_are_possible():
    """Sand cannot have the cohesion that would explain best."""

    def fitted(effect: str, size: float, cost: float) -> SimpleNamespace:
        runs = (SimpleNamespace(size_limits=lambda name: (-0.1, 0.1)),)
        return SimpleNamespace(candidates=(Candidate(effect=effect),), sizes=[size], cost=cost, runs=runs)

    trials = [fitted("friction_angle", 0.1, 10.0), fitted("grade", 0.05, 30.0), fitted("bank", 0.02, 20.0)]
    order = sorted(trials, key=order_of)
    assert [trial.candidates[0].effect for trial in order] == ["bank", "grade", "friction_angle"]


def test_a_pair_counts_the_same_from_every_model():
    """With one effect in the model: the same pairs gain the same, and what is kept stays."""
    sizes = np.array([0.1, 0.12])
    fit, result = _scores(1, sizes)
    fresh = proposed_pairs(*_scores(0, sizes), [], 10)
    assert [pair.gain for pair in proposed_pairs(fit, result, [], 10)] == pytest.approx(
        [pair.gain for pair in fresh]
    )
    kept = proposed_pairs(fit, result, [0], 2)
    assert all(pair.candidates[0].effect == "payload" for pair in kept)
    assert kept[0].gain >= fresh[0].gain > linearised_gain(fit, result)


@pytest.mark.parametrize("name", ["rolling_resistance", "steer_offset", "payload", "accel_scale"])
def test_what_is_hidden_together_acts_together(name):
    """Half of it twice is the whole: forces, commands, the vehicle's record, samples."""
    case = draw_case(21, road="flat", duration=6.0)
    size = 0.02
    whole = simulated_log(case, FAULTS[name](size))
    halves = simulated_log(case, combined([FAULTS[name](0.5 * size), FAULTS[name](0.5 * size)]))
    plain = simulated_log(case)
    for channel, values in whole.channels.items():
        moved = np.nanmax(np.abs(values - plain.channels[channel]))
        assert np.nanmax(np.abs(halves.channels[channel] - values)) <= 0.03 * moved + 1e-9, channel


@pytest.mark.check
def test_on_bumps_a_fit_ends_where_it_ends_from_the_truth():
    """Bumps make of a small force another road: descents with coarse derivatives stopped half way."""
    size = 0.7
    log = simulated_log(draw_case(600, duration=30.0), FAULTS["aero_drag"](size))
    assert log.config.terrain.kind == "waves"
    nominal = fit_runs([RunModel(log, use=FIT)])
    candidate = Candidate(effect="aero_drag")
    ends = [refit(nominal, [candidate], [start]) for start in (0.0, size)]
    deviation = ends[0].deviations()[-1]
    assert abs(ends[0].sizes[0] - ends[1].sizes[0]) < 0.5 * deviation
    assert abs(ends[0].sizes[0] - size) < 3.0 * deviation


def test_a_discrepancy_remains_where_the_hold_out_test_refuses_a_significant_effect():
    rival = Alternative(
        candidate=Candidate(effect="grade"),
        size=0.01,
        deviation=0.001,
        likelihood_ratio=0.0,
        ground=0.0,
        ground_deviation=0.1,
    )
    cause = Cause(alternatives=(rival,), likelihood_ratio=50.0, p_value=1e-6)
    kept, refused = (
        SimpleNamespace(refused=own, capped=False, strayed=(), uncertain=(), beyond_null_logs=False)
        for own in (False, True)
    )
    incomplete = VehicleDiagnosis(causes=(cause,), search=refused)
    assert incomplete.incomplete
    assert not VehicleDiagnosis(causes=(cause,), search=kept).incomplete
    # Nothing was named: the hold-out test has only prevented a false alarm.
    assert not VehicleDiagnosis(search=refused).incomplete
    sentence = verdict_sentence(Verdict.NAMED_WITH_REST, incomplete, summarise_causes(incomplete))
    assert "climbs by 1 %" in sentence
    assert "make it worse in another" in sentence


def test_causes_that_overlap_are_no_certain_names():
    """Their sizes are correlated: one cause that the library lacks may explain both."""
    rivals = [
        Alternative(
            candidate=Candidate(effect=name),
            size=0.1,
            deviation=0.01,
            likelihood_ratio=0.0,
            ground=0.0,
            ground_deviation=0.1,
        )
        for name in ("payload", "slip_exponent")
    ]
    causes = tuple(Cause(alternatives=(rival,), likelihood_ratio=50.0, p_value=1e-6) for rival in rivals)
    for overlap, certain in ((0.05, True), (0.6, False)):
        checks = VehicleChecks(
            solver=0.0,
            gate=(),
            converged=True,
            threshold=3.0,
            overlap=overlap,
            pose_age=(),
            unknowns={},
            nuisances={},
        )
        diagnosis = VehicleDiagnosis(causes=causes, checks=checks)
        sentence = verdict_sentence(Verdict.ONE_OF, diagnosis, summarise_causes(diagnosis))
        assert ("a single cause that the library lacks" in sentence) is not certain
    log = simulated_log(draw_case(22, road="flat", gnss=True, duration=30.0), FAULTS["payload"](0.1))
    nominal = fit_runs([RunModel(log, use=FIT)])
    names = [Candidate(effect=name) for name in ("payload", "torque_scale", "gyro_bias_pitch")]
    alike = refit(nominal, names[:2], [0.1, 0.0])
    apart = refit(nominal, [names[0], names[2]], [0.1, 0.0])
    assert alike.overlap > 0.4 > 0.1 > apart.overlap


def test_a_search_goes_on_where_its_first_choice_does_not_hold_once_it_is_fitted(monkeypatch):
    """A centre of gravity behind the axle may score highest and vanish: what stood in its shade may hold."""
    names = ("cg_shift", "steer_gain", "steer_lag")
    found = [SimpleNamespace(candidates=(Candidate(effect=name),)) for name in names]

    def larger(last, bar, test, begun, singly):
        return [trial for trial in found if trial.candidates[0] in last.candidates][:1]

    def accepted(test, trials, bars):
        holds = trials[0].candidates[0].effect == "steer_lag"
        fit, gains = (trials[0], [5.0]) if holds else (None, [])
        return search_module.Accepted(fit, gains, refused=False)

    monkeypatch.setattr(search_module, "_larger", larger)
    monkeypatch.setattr(search_module, "fits_from_stated", lambda *_, **__: [])
    monkeypatch.setattr(search_module, "accepted_of", accepted)
    monkeypatch.setattr(search_module, "refined_places", lambda last, bar, near: last)
    monkeypatch.setattr(search_module, "score_threshold", lambda last, rate: 3.0)
    monkeypatch.setattr(
        search_module,
        "score_test",
        lambda fit, left: SimpleNamespace(fit=None, candidates=tuple(left), z=np.zeros(len(left))),
    )
    first = search_module.score_test(None, [Candidate(effect=name) for name in names])
    test = SimpleNamespace(fit=SimpleNamespace(candidates=()))
    taken = search_module._onward(test, first, 3.0, 0.06, False)
    assert [candidate.effect for candidate in taken.fit.candidates] == ["steer_lag"]
    assert taken.gains == [5.0]
