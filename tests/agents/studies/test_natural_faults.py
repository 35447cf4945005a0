"""Counts of the study in a natural world."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from agents.studies.fault_detection import one_log
from agents.studies.natural_faults import study as study_module
from agents.studies.natural_faults.study import NaturalFaults, counted_naturally
from estimators.discrepancy.faults.other_forms import FAMILIES, OTHER_FORMS, WRONG_NUMBERS
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.score_test import DETECTABLE
from estimators.logs.immobile_findings import IMMOBILE
from estimators.logs.units import Finding


def stuck_after(driven: float) -> Finding:
    return Finding(
        kind=IMMOBILE, channel="t", severity="warning", sentence="it is stuck", numbers={"driven": driven}
    )


def _result(verdict: str, *sets: list[str], structure: bool = False) -> dict:
    return {"verdict": verdict, "sets": list(sets), "named": [s[0] for s in sets], "structure": structure}


def test_a_cause_counts_by_its_family_and_a_set_with_it_is_no_wrong_name():
    results = {
        ("natural", "", 0.0, 1): _result("NO EFFECT"),
        ("natural", "", 0.0, 2): _result("NAMED", ["n_step"]),
        ("wrong", "c x 1.5", 1.0, 1): _result("NAMED", ["friction_angle", "cohesion"]),
        ("wrong", "c x 1.5", 1.0, 2): _result("NAMED", ["friction_angle"]),
        ("wrong", "c x 1.5", 1.0, 3): _result("ONE OF", ["friction_angle"]),
        ("wrong", "c x 1.5", 1.0, 4): _result("NO EFFECT"),
        ("wrong", "I_z + 10 %", 1.0, 1): _result("NAMED", ["inertia"]),
        ("other", "steer_lag", 2.0, 1): _result("NAMED", ["steer_delay"]),
        ("other", "steer_lag", 2.0, 2): _result("NAMED", structure=True),
        ("other", "steer_lag", 2.0, 3): {"failed": "the vehicle drowned"},
    }
    numbers = counted_naturally(results)
    assert numbers["natural"]["detected"]["hits"] == 1
    wrong, other = numbers["wrong: c x 1.5"], numbers["other"]
    assert (wrong["family in the sets"]["hits"], wrong["another cause for certain"]["hits"]) == (1, 1)
    inertia = numbers["wrong: I_z + 10 %"]
    assert (inertia["family in the sets"]["hits"], inertia["family in the sets"]["count"]) == (1, 1)
    assert inertia["another cause for certain"]["hits"] == 0
    assert (other["detected"]["hits"], other["family in the sets"]["hits"]) == (2, 1)
    assert other["another cause for certain"]["hits"] == 1
    assert other["detected"]["count"] == 2


def test_every_log_is_a_unit_and_a_cause_without_a_limit_has_none(tmp_path):
    study = NaturalFaults(nulls=3, seeds=1, large=1, wrong=2, pairs=4, out=tmp_path)
    keys = study._keys({5000: _known(dict.fromkeys(OTHER_FORMS, 1.0), 10.0)})
    assert len(keys) == len(set(keys)) == 3 + 2 * len(WRONG_NUMBERS) + 3 * len(OTHER_FORMS) + 4 + 2
    assert len(study._keys({5000: _known({"payload": 0.1}, 10.0)})) == 3 + 2 * len(WRONG_NUMBERS) + 3


def _known(limits: dict[str, float], largest: float) -> dict:
    pairs = [f"{kind} {a}+{b}" for kind in ("two", "large two") for a in limits for b in limits]
    return {
        "limits": limits,
        "ranges": {name: [-largest, largest] for name in limits},
        "beside": {pair: [1.0, 1.0] for pair in pairs},
    }


def test_a_fault_that_no_vehicle_can_have_is_left_out(tmp_path):
    """Twice the limit must be a size that a diagnosis may name, and seven times for a large one."""
    study = NaturalFaults(nulls=0, seeds=1, large=1, wrong=0, out=tmp_path)
    for largest, kinds in ((0.21, []), (0.23, ["library", "other"]), (0.8, ["large", "library", "other"])):
        known = {5000: _known({"payload": 0.1}, largest)}
        assert sorted(str(key[0]) for key in study._keys(known)) == kinds


def test_two_causes_are_of_two_families_and_each_counts(tmp_path):
    study = NaturalFaults(nulls=0, seeds=0, large=0, wrong=0, pairs=30, out=tmp_path)
    keys = study._keys({5000: _known(dict.fromkeys(OTHER_FORMS, 1.0), 10.0)})
    assert {str(key[0]) for key in keys} == {"two", "large two"}
    for key in keys:
        first, second = str(key[1]).split("+")
        assert not set(FAMILIES[first]) & set(FAMILIES[second])
    results = {("two", "payload+steer_lag", 2.0, 1): _result("NAMED", ["placed_payload"], ["n_step"])}
    (numbers,) = counted_naturally(results).values()
    assert (numbers["family in the sets"]["hits"], numbers["family in the sets"]["count"]) == (1, 2)
    assert numbers["another cause for certain"]["hits"] == 1


def test_pairs_of_which_one_cause_never_shows_are_left_out(monkeypatch, tmp_path):
    """They have limits in the drive with both, which are found first."""
    asked: list[tuple[str, float]] = []

    def beside(pair, multiple, seed, known):
        asked.append((pair, multiple))
        return {"limits": [1.5, 1.0] if multiple == 2.0 and "payload" not in pair else None}

    monkeypatch.setattr(study_module, "limits_beside", beside)
    study = NaturalFaults(nulls=0, seeds=0, large=0, wrong=0, pairs=30, n_jobs=1, out=tmp_path)
    first = {5000: _known(dict.fromkeys(OTHER_FORMS, 1.0), 10.0)}
    known = study._with_pairs(tmp_path / "natural.jsonl", first, "stamp")
    assert sum(multiple == 2.0 for _, multiple in asked) == 30
    assert sum(multiple == 7.0 for _, multiple in asked) == 15
    left = [pair for pair, multiple in asked if multiple == 2.0 and "payload" not in pair]
    assert {(str(key[0]), str(key[1])) for key in study._keys(known)} == {("two", pair) for pair in left}
    assert known[5000]["beside"][f"two {left[0]}"] == [1.5, 1.0]


@pytest.mark.parametrize(
    ("own", "found"),
    [
        ([[0.05, 0.02]], [0.05, 0.02]),  # both show what they show alone
        ([[0.054, 0.02]], [0.05, 0.02]),  # that is the same
        ([[0.07, 0.01], [0.07, 0.02]], [0.07, 0.02]),  # one shows less beside the other
        ([[0.07, 0.01], [0.09, 0.02], [0.09, 0.02]], [0.09, 0.02]),
        ([[0.07, 0.01], [0.09, 0.02], [0.11, 0.02]], None),  # and less, the larger it is
        ([[0.6, 0.02]], None),  # twice this no vehicle can have
        ([[math.inf, math.inf]], None),  # nothing is driven
    ],
)
def test_two_causes_have_their_limits_in_the_drive_with_both(monkeypatch, own, found):
    limits, drives = iter(own), list[tuple[float, ...]]()

    def limits_in(log, names, sizes):
        drives.append(tuple(map(abs, sizes)))
        return next(limits)

    monkeypatch.setattr(one_log, "natural_case", lambda seed: SimpleNamespace(seed=seed))
    monkeypatch.setattr(one_log, "_with_both", lambda case, names, sizes: None)
    monkeypatch.setattr(one_log, "_limits_in", limits_in)
    known = {1: _known({"payload": 0.05, "steer_gain": 0.02}, 1.0)}
    assert one_log.limits_beside("payload+steer_gain", 2.0, 1, known=known) == {"limits": found}
    assert drives[0] == pytest.approx((0.1, 0.04))
    assert next(limits, None) is None
    assert one_log._CLOSE == 0.1


@pytest.mark.parametrize(
    ("large", "largest", "found"),
    [
        ([0.34, 0.13], 1.0, [0.05, 0.02]),  # both show more than their limit
        ([0.36, 0.13], 1.0, None),
        ([0.34, math.inf], 1.0, None),  # one is stuck
        ([0.0, 0.0], 0.38, None),  # seven times the limit no vehicle can have
    ],
)
def test_large_causes_have_limits_of_twice_and_each_must_show(monkeypatch, large, largest, found):
    drives: list[tuple[float, ...]] = []

    def limits_in(log, names, sizes):
        drives.append(tuple(map(abs, sizes)))
        return large if len(drives) > 1 else [0.05, 0.02]

    monkeypatch.setattr(one_log, "natural_case", lambda seed: SimpleNamespace(seed=seed))
    monkeypatch.setattr(one_log, "_with_both", lambda case, names, sizes: None)
    monkeypatch.setattr(one_log, "_limits_in", limits_in)
    known = {1: _known({"payload": 0.05, "steer_gain": 0.02}, largest)}
    assert one_log.limits_beside("payload+steer_gain", 7.0, 1, known=known) == {"limits": found}
    assert drives[0] == pytest.approx((0.1, 0.04))
    assert len(drives) == (2 if largest == 1.0 else 1)


def test_a_log_with_two_causes_has_sizes_by_their_limits_beside_each_other(monkeypatch):
    made: list[tuple[float, ...]] = []
    monkeypatch.setattr(one_log, "_diagnosed", lambda log, case: {})
    monkeypatch.setattr(one_log, "_with_both", lambda case, names, sizes: made.append(tuple(map(abs, sizes))))
    known = {1: _known({"payload": 0.05, "steer_gain": 0.02}, 1.0)}
    known[1]["beside"]["large two payload+steer_gain"] = [0.1, 0.03]
    monkeypatch.setattr(one_log, "natural_case", lambda seed: SimpleNamespace(seed=seed))
    result = one_log.run_unit("large two", "payload+steer_gain", 7.0, 1, known=known)
    assert made == [pytest.approx((0.7, 0.21))]
    assert result["limit_over_alone"] == pytest.approx([2.0, 1.5])


def test_a_study_that_is_stopped_early_has_logs_of_every_kind(tmp_path):
    study = NaturalFaults(nulls=60, seeds=2, large=1, wrong=4, pairs=6, out=tmp_path)
    known = {5000 + i: _known(dict.fromkeys(OTHER_FORMS, 1.0), 10.0) for i in range(2)}
    keys = study._keys(known)
    kinds = [str(key[0]) for key in keys]
    assert len(keys) == len(set(keys)) == len(study._by_kind(known))
    quarter = kinds[: len(kinds) // 4]
    for kind in set(kinds):
        assert quarter.count(kind) / len(quarter) == pytest.approx(kinds.count(kind) / len(kinds), abs=0.05)


def test_logs_of_vehicles_that_are_stuck_at_once_are_counted_and_left_out():
    results = {
        ("large", "payload", 7.0, 1): _result("NAMED", ["payload"]) | {"stuck": False},
        ("large", "rut_drag", 7.0, 1): _result("OUTSIDE THE MODEL") | {"stuck": True},
        ("library", "rut_drag", 2.0, 1): _result("OUTSIDE THE MODEL") | {"stuck": True},
        ("library", "payload", 2.0, 1): _result("NAMED", ["payload"]) | {"stuck": False},
        ("other", "payload", 2.0, 1): _result("NAMED", ["payload"]) | {"stuck": False},
    }
    numbers = counted_naturally(results)
    assert numbers["library, not stuck"]["family in the sets"]["count"] == 1
    assert "other, not stuck" not in numbers
    assert numbers["large"]["family in the sets"]["count"] == 2
    assert numbers["large, not stuck"]["family in the sets"]["count"] == 1


@pytest.mark.parametrize(
    ("deviation", "limit"),
    [
        (0.02, DETECTABLE * 0.02),  # the fault makes the ground scatter more
        (0.001, 0.05),  # never below that of the drive without the fault
        (None, 0.05),  # the model with the fault breaks down
    ],
)
def test_a_limit_is_that_of_the_drive_with_the_fault(monkeypatch, deviation, limit):
    sizes: list[float] = []

    def refitted(fit: object, candidates: list[Candidate], values: list[float]) -> SimpleNamespace | None:
        sizes.extend(abs(value) for value in values)
        return None if deviation is None else SimpleNamespace(size_deviations=lambda: [deviation])

    monkeypatch.setattr(one_log, "simulated_log", lambda case, fault: None)
    monkeypatch.setattr(one_log, "stuck_spans", lambda log: ())
    monkeypatch.setattr(one_log, "stuck_findings", lambda log: [])
    monkeypatch.setattr(one_log, "RunModel", lambda log, use: None)
    monkeypatch.setattr(one_log, "fit_runs", lambda runs: None)
    monkeypatch.setattr(one_log, "refit", refitted)
    monkeypatch.setattr(one_log, "settled", lambda trial, fresh: trial)
    found = one_log._limit_with_fault(SimpleNamespace(seed=1), "payload", 0.05, (-1.0, 1.0))
    assert found == pytest.approx(limit)
    assert sizes == [0.1]
    # Hardly anything is driven: there is nothing to fit.
    monkeypatch.setattr(one_log, "stuck_findings", lambda log: [stuck_after(7.0)])
    assert (one_log._limit_in(None, "payload", 0.1) < math.inf) == (deviation is not None)
    monkeypatch.setattr(one_log, "stuck_findings", lambda log: [stuck_after(5.0)])
    assert one_log._limit_in(None, "payload", 0.1) == math.inf


@pytest.mark.parametrize(
    ("limits", "stuck", "found"),
    [
        ([0.04], [True], 0.05),  # what is left before the vehicle gets stuck shows enough
        ([0.08, 0.07], [True, True], 0.08),  # with a larger one it does
        ([0.08, 0.09], [True, False], 0.09),  # and the drive with that one goes on
        ([math.inf], [True], 1.0),  # nothing is left: no vehicle can have twice this limit
        ([0.08, 0.2, 0.3], [True] * 3, 1.0),  # what is left never shows enough
        ([0.6], [True], 0.6),  # twice this is beyond what a vehicle can have
    ],
)
def test_a_fault_that_stops_the_vehicle_has_the_limit_of_what_is_left_before(
    monkeypatch, limits, stuck, found
):
    own, halts, sizes = iter(limits), iter(stuck), list[float]()

    def limit_in(log, name, size):
        sizes.append(abs(size))
        return next(own)

    monkeypatch.setattr(one_log, "simulated_log", lambda case, fault: None)
    monkeypatch.setattr(one_log, "stuck_spans", lambda log: next(halts))
    monkeypatch.setattr(one_log, "_limit_in", limit_in)
    case = SimpleNamespace(seed=1)
    assert one_log._limit_with_fault(case, "bulldozing", 0.05, (0.0, 1.0)) == pytest.approx(found)
    assert sizes == [2.0 * one for one in (0.05, *limits)][: len(sizes)]
    known = {1: {"limits": {"bulldozing": found}, "ranges": {"bulldozing": (0.0, 1.0)}}}
    assert one_log.possible("bulldozing", 2.0, 1, known) == (found < 0.45)


def test_a_fault_beyond_what_a_vehicle_can_have_keeps_its_limit():
    assert one_log._limit_with_fault(SimpleNamespace(seed=1), "bulldozing", 6e4, (0.0, 1e5)) == 6e4
