"""Verdicts by their rules, and a summary that JSON, terminal and page can share."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace

import numpy as np
import pytest

from agents.reports.diagnosis import render_diagnosis
from estimators.discrepancy.checks.unmodelled_forces import UnmodelledForce
from estimators.discrepancy.faults.rig import draw_rig_case, simulated_trials
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.result import Alternative, Cause
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import REST_RATE, RigChecks, RigDiagnosis, Verdict
from estimators.discrepancy.wording import terminal_lines
from estimators.logs import Finding
from offroad_env.errors import DataError

_PROBLEM = Finding(kind="unit", channel="sinkage", severity="problem", sentence="sinkage is in mm")


def _diagnosis(**parts) -> RigDiagnosis:
    """A finished diagnosis without causes, whose limits are all testable."""
    search = SimpleNamespace(first=SimpleNamespace(z=np.array([2.0])), refused=False)
    checks = RigChecks(
        solver=0.01, gate=(), converged=True, threshold=3.0, trials=9, left_out=0, conditions={"search": 3}
    )
    return RigDiagnosis(**({"search": search, "checks": checks, "limits": {"cohesion": 100.0}} | parts))


def _cause(*effects: str) -> Cause:
    members = tuple(
        Alternative(
            candidate=Candidate(effect=effect),
            size=0.1,
            deviation=0.01,
            likelihood_ratio=0.0,
            ground=0.0,
            ground_deviation=0.1,
        )
        for effect in effects
    )
    return Cause(alternatives=members, likelihood_ratio=50.0, p_value=1e-6)


def _residual(p_value: float) -> UnmodelledForce:
    return UnmodelledForce(
        equation="drawbar",
        gain=30.0,
        freedom=10,
        p_value=p_value,
        force=np.ones(3),
        deviation=np.ones(3),
        shapes=(),
    )


def test_the_data_come_first_then_the_numerics_then_what_remains():
    assert RigDiagnosis(findings=(_PROBLEM,)).verdict is Verdict.DATA_PROBLEM
    fine = _diagnosis()
    assert fine.verdict is Verdict.NO_EFFECT
    assert replace(fine, not_testable=dict(fine.limits)).verdict is Verdict.NOT_TESTABLE
    assert replace(fine, checks=replace(fine.checks, converged=False)).verdict is Verdict.NUMERICS
    assert replace(fine, checks=replace(fine.checks, solver=1.5)).verdict is Verdict.NUMERICS
    remainder = replace(fine, unknown_inputs=(_residual(0.1 * REST_RATE),))
    assert remainder.verdict is Verdict.UNEXPLAINED
    assert replace(remainder, unknown_inputs=(_residual(10.0 * REST_RATE),)).verdict is Verdict.NO_EFFECT


def test_causes_are_named_where_they_have_no_alternative_and_explain_most_of_the_excess():
    one, two = (
        _diagnosis(causes=(_cause("cohesion"),)),
        _diagnosis(causes=(_cause("cohesion", "peak_angle"),)),
    )
    assert one.verdict is Verdict.NAMED
    assert two.verdict is Verdict.ONE_OF
    remainder = replace(one, unknown_inputs=(_residual(0.1 * REST_RATE),))
    assert replace(remainder, nominal_excess=100.0).verdict is Verdict.NAMED_WITH_REST
    assert replace(remainder, nominal_excess=30.0).verdict is Verdict.UNEXPLAINED


def test_a_summary_of_unusable_data_is_complete_and_cannot_be_changed():
    log = simulated_trials(draw_rig_case(1))
    summary = summarise(RigDiagnosis(logs=(log,), findings=(_PROBLEM,)))
    numbers = summary.to_dict()
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert numbers["verdict"] == "DATA PROBLEM"
    assert numbers["checks"]["logs"] == {log.name: log.hash}
    assert terminal_lines(summary)[0] == f"DATA PROBLEM: {summary.sentence}"
    assert summary.sentence in render_diagnosis(summary, "offroad diagnose trials.csv --rig")
    with pytest.raises(FrozenInstanceError):
        summary.sentence = "all is well"


def test_a_rig_log_has_a_wheel_and_refuses_what_only_a_vehicle_has():
    log = simulated_trials(draw_rig_case(1))
    assert log.wheel.r > 0.0
    for name in ("vehicle", "imu", "times"):
        with pytest.raises(DataError, match="wheel-rig log"):
            getattr(log, name)
