"""Counting of the fault-detection study, on results whose rates are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from agents.studies.fault_detection.results import counted
from agents.studies.fault_detection.study import FaultDetection
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.search.score_test import DETECTABLE

_THRESHOLD = 3.1


def _result(verdict: str, **more) -> dict:
    plain = {
        "verdict": verdict,
        "road": "flat",
        "sets": [],
        "sizes": [],
        "named": [],
        "threshold": _THRESHOLD,
        "seconds": 1.0,
    }
    return plain | more


def _single(multiple: float, seen: bool, members: tuple[str, ...] = ("payload",), size: float = 0.1) -> dict:
    sizes = [[(size, 0.01) for _ in members]]
    return _result(
        "NAMED" if seen else "NO EFFECT",
        sets=[list(members)] if seen else [],
        sizes=sizes if seen else [],
        sizes_true=[0.1],
        multiples={"payload": multiple},
        alike={"payload": 1.0, "torque_scale": 0.99},
    )


def test_false_alarms_are_counted_by_road_with_their_interval():
    results = {("null", "", 0.0, i): _result("NAMED" if i == 0 else "NO EFFECT") for i in range(50)}
    null = counted(results)["null"]
    assert (null["hits"], null["count"]) == (1, 50)
    assert null["flat"]["hits"] == 1
    assert null["unknown"]["count"] == 0
    assert (null["low"], null["high"]) == pytest.approx((0.0035, 0.105), abs=0.002)
    assert (null["unknown"]["low"], null["unknown"]["high"]) == (0.0, 1.0)


def test_the_ratio_to_the_bound_is_that_of_the_logs():
    rng = np.random.default_rng(3)
    results = {}
    for i in range(1500):
        multiple = float(rng.choice((0.5, 1.0, 2.0, 4.0)))
        seen = bool(rng.random() < norm.cdf(DETECTABLE * multiple / 1.3 - _THRESHOLD))
        results["single", "payload", multiple, i] = _single(multiple, seen)
    power = counted(results)["power"]
    assert power["ratio"] == pytest.approx(1.3, rel=0.05)
    assert power["low"] < power["ratio"] < power["high"]
    assert power["high"] / power["low"] < 1.15


def test_sets_intervals_and_false_second_causes_are_counted():
    results = {
        ("single", "payload", 2.0, 1): _single(2.0, True, ("torque_scale", "payload")),
        ("single", "payload", 2.0, 2): _single(2.0, True, size=0.2),
        ("single", "payload", 2.0, 3): _single(2.0, False),
    }
    false = _single(2.0, True)
    false["sets"].append(["n_step"])
    false["sizes"].append([(1.0, 0.1)])
    results["single", "payload", 2.0, 4] = false
    found = counted(results)["single at 2"]
    assert found["detected"]["hits"] == 3
    assert found["truth in a set"]["hits"] == 3
    assert found["interval holds the truth"]["hits"] == 2
    assert (found["sets without a truth"]["hits"], found["sets without a truth"]["count"]) == (1, 4)
    assert found["mean set size"] == pytest.approx(4.0 / 3.0)


def test_names_are_wrong_unless_they_have_the_same_trace_or_a_discrepancy_remains():
    """One with the trace of the removed effect, one without, one with a rest, a set; an unmodelled fault."""
    copied = _single(4.0, True, ("torque_scale",)) | {"mimicry": 0.95}
    wrong = _single(4.0, True, ("aero_drag",)) | {"mimicry": 0.3}
    incomplete = wrong | {"verdict": "NAMED + UNEXPLAINED REST"}
    one_of = wrong | {"verdict": "ONE OF"}
    results = {
        ("removed", "payload", 4.0, i): result for i, result in enumerate((copied, wrong, incomplete, one_of))
    }
    results["unmodelled", "tow_rope", 1.0, 1] = _single(4.0, True, ("grade",)) | {"alike": {}}
    numbers = counted(results)
    assert (numbers["removed"]["hits"], numbers["unmodelled"]["hits"]) == (1, 1)
    assert (numbers["wrong name"]["hits"], numbers["wrong name"]["count"]) == (2, 5)
    assert numbers["wrong name or set"]["hits"] == 3


def test_every_bar_is_beside_its_share():
    nulls = {("null", "", 0.0, i): _result("NO EFFECT") for i in range(300)}
    singles = {("single", "payload", 2.0, i): _single(2.0, i > 9) for i in range(100)}
    bars = {bar["what"]: bar for bar in counted(nulls | singles)["bars"]}
    assert bars["false alarms, upper end"]["met"]
    assert bars["false alarms, upper end"]["high"] < 0.07
    assert bars["one effect: detected"]["met"] is False
    assert bars["one effect: detected"]["share"] == pytest.approx(0.9)
    # Nothing of it was run: neither met nor missed.
    assert bars["two effects: truths in the sets"]["met"] is None


def test_a_receiver_has_no_fault_where_there_is_none():
    study = FaultDetection(nulls=0, whites=0, seeds=2, power_seeds=0, pairs=2, removed=2, unmodelled_seeds=0)
    known = {1000: {"limits": dict.fromkeys(FAULTS, 1.0)}, 1001: {"limits": {"payload": 1.0, "grade": 1.0}}}
    keys = study._keys(known)
    own = {
        kind: {key[1] for key in keys if key[0] == kind and key[3] == 1001} for kind in ("single", "removed")
    }
    assert own["single"] == own["removed"] == {"payload", "grade"}
    assert ("pair", "grade+payload", 2.0, 1001) in keys
    assert ("single", "pose_delay", 2.0, 1000) in keys


def test_names_beside_a_rest_are_wrong_where_they_do_not_have_the_trace_of_the_fault():
    def result(name):
        return _result("NAMED + UNEXPLAINED REST", named=[name], alike={"payload": 1.0, "grade": 0.5})

    results = {("unmodelled", "tow_rope", 1.0, i): result(n) for i, n in enumerate(("payload", "grade"))}
    wrong = counted(results)["wrong name beside a rest"]
    assert (wrong["hits"], wrong["count"]) == (1, 2)


def test_pairs_can_be_combined():
    study = FaultDetection()
    pairs = [study._pair(seed).split("+") for seed in range(200)]
    assert all(len(set(pair)) == 2 and set(pair) <= set(FAULTS) for pair in pairs)
    soils = {"slip_exponent", "n_step", "n_trend"}
    assert not any(set(pair) <= soils for pair in pairs)
