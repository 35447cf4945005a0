"""Several causes at once: hidden, guessed from the scores, and fitted where the road is rough."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from agents.studies.diagnosis import together
from estimators.discrepancy import search as search_module
from estimators.discrepancy.diagnosis import Diagnosis, overlap_of
from estimators.discrepancy.fit import Candidate, fit_runs
from estimators.discrepancy.hide import HIDERS, draw_case, hidden_log
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.search import Cause, Rival, refit
from estimators.discrepancy.together import gain_of, guesses
from estimators.discrepancy.verdict import sentence_of
from estimators.discrepancy.windows import FIT

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
        information=information,
        joint=traces.T @ traces,
    )
    return SimpleNamespace(candidates=tuple(candidates[:inside]), sizes=fitted), result


def test_two_causes_are_guessed_where_a_third_stands_for_both():
    sizes = np.array([0.1, 0.12])
    fit, result = _scores(0, sizes)
    assert result.candidates[int(np.argmax(np.abs(result.z)))].effect == "torque_scale"
    best = guesses(fit, result, [], 3)[0]
    assert {candidate.effect for candidate in best.candidates} == {"payload", "grade"}
    assert np.array(best.sizes) == pytest.approx(sizes)
    assert best.gain > np.max(result.z**2) + 10.0


def test_a_guess_counts_the_same_from_every_model():
    """With one effect in the model: the same pairs gain the same, and what is kept stays."""
    sizes = np.array([0.1, 0.12])
    fit, result = _scores(1, sizes)
    fresh = guesses(*_scores(0, sizes), [], 10)
    assert [guess.gain for guess in guesses(fit, result, [], 10)] == pytest.approx(
        [guess.gain for guess in fresh]
    )
    kept = guesses(fit, result, [0], 2)
    assert all(guess.candidates[0].effect == "payload" for guess in kept)
    assert kept[0].gain >= fresh[0].gain > gain_of(fit, result)


@pytest.mark.parametrize("name", ["rolling_resistance", "steer_offset", "payload", "accel_scale"])
def test_what_is_hidden_together_acts_together(name):
    """Half of it twice is the whole: forces, commands, the vehicle's record, samples."""
    case = draw_case(21, road="flat", duration=6.0)
    size = 0.02
    whole = hidden_log(case, HIDERS[name](size))
    halves = hidden_log(case, together([HIDERS[name](0.5 * size), HIDERS[name](0.5 * size)]))
    plain = hidden_log(case)
    for channel, values in whole.channels.items():
        moved = np.nanmax(np.abs(values - plain.channels[channel]))
        assert np.nanmax(np.abs(halves.channels[channel] - values)) <= 0.03 * moved + 1e-9, channel


def test_on_bumps_a_fit_ends_where_it_ends_from_the_truth():
    """Bumps make of a small force another road: descents with coarse derivatives stopped half way."""
    size = 0.7
    log = hidden_log(draw_case(600, duration=30.0), HIDERS["aero_drag"](size))
    assert log.config.terrain.kind == "waves"
    nominal = fit_runs([RunModel(log, use=FIT)])
    candidate = Candidate(effect="aero_drag")
    ends = [refit(nominal, [candidate], [start])[0] for start in (0.0, size)]
    deviation = ends[0].deviations()[-1]
    assert abs(ends[0].sizes[0] - ends[1].sizes[0]) < 0.5 * deviation
    assert abs(ends[0].sizes[0] - size) < 3.0 * deviation


def test_a_name_is_in_doubt_where_the_search_asks_for_more_and_is_refused():
    rival = Rival(
        candidate=Candidate(effect="grade"),
        size=0.01,
        deviation=0.001,
        loss=0.0,
        ground=0.0,
        ground_deviation=0.1,
    )
    cause = Cause(rivals=(rival,), delta=50.0, chance=1e-6)
    kept, refused = SimpleNamespace(refused=False), SimpleNamespace(refused=True)
    assert Diagnosis(verdict="", causes=(cause,), search=refused).doubtful
    assert not Diagnosis(verdict="", causes=(cause,), search=kept).doubtful
    # Nothing was named: the windows apart have only kept a false alarm away.
    assert not Diagnosis(verdict="", search=refused).doubtful
    said = sentence_of(Diagnosis(verdict="NAMED + UNEXPLAINED REST", causes=(cause,), search=refused))
    assert "climbs by 0.01" in said
    assert "makes another part worse" in said


def test_causes_that_overlap_are_no_certain_names():
    """Their sizes hang together: one cause that the library lacks may stand behind both."""
    rivals = [
        Rival(
            candidate=Candidate(effect=name),
            size=0.1,
            deviation=0.01,
            loss=0.0,
            ground=0.0,
            ground_deviation=0.1,
        )
        for name in ("payload", "slip_sinkage")
    ]
    causes = tuple(Cause(rivals=(rival,), delta=50.0, chance=1e-6) for rival in rivals)
    for overlap, certain in ((0.05, True), (0.6, False)):
        diagnosis = Diagnosis(verdict="NAMED", causes=causes, checks={"overlap": overlap})
        assert ("one cause behind these" in sentence_of(diagnosis)) is not certain
    log = hidden_log(draw_case(22, road="flat", gnss=True, duration=30.0), HIDERS["payload"](0.1))
    nominal = fit_runs([RunModel(log, use=FIT)])
    names = [Candidate(effect=name) for name in ("payload", "torque_scale", "gyro_bias_pitch")]
    alike = refit(nominal, names[:2], [0.1, 0.0])[0]
    apart = refit(nominal, [names[0], names[2]], [0.1, 0.0])[0]
    assert overlap_of(alike) > 0.4 > 0.1 > overlap_of(apart)


def test_a_search_goes_on_where_its_first_choice_does_not_hold_once_it_is_fitted(monkeypatch):
    """A centre of gravity behind the axle may score highest and vanish: what stood in its shade may hold."""
    names = ("cg_shift", "steer_gain", "steer_lag")
    found = [SimpleNamespace(fit=SimpleNamespace(candidates=(Candidate(effect=name),))) for name in names]

    def larger(fit, last, bar, gate):
        return [trial for trial in found if trial.fit.candidates[0] in last.candidates][:1]

    def accepted(gate, trials, bars, *, white):
        holds = trials[0].fit.candidates[0].effect == "steer_lag"
        return (trials[0].fit, [5.0], False) if holds else (None, [], False)

    monkeypatch.setattr(search_module, "_larger", larger)
    monkeypatch.setattr(search_module, "_accepted", accepted)
    monkeypatch.setattr(search_module, "closely", lambda fit, last, bar, near: last)
    monkeypatch.setattr(search_module, "chance_threshold", lambda last, rate: 3.0)
    monkeypatch.setattr(search_module, "screen", lambda fit, left: SimpleNamespace(candidates=tuple(left)))
    first = SimpleNamespace(candidates=tuple(Candidate(effect=name) for name in names))
    gate = SimpleNamespace(fit=SimpleNamespace(candidates=()))
    taken, gains, _ = search_module._onward(gate, first, (3.0, 0.06), white=False)
    assert [candidate.effect for candidate in taken.candidates] == ["steer_lag"]
    assert gains == [5.0]
