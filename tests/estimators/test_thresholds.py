"""Thresholds that decide flags, widths and gates, and the behaviour on either side of those in plain code.

A threshold is a decision: the false alarms and the power that the pages state were measured with it. Whoever
changes one changes this list, and measures again.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.analysis.consistency import innovation_flag
from estimators.analysis.scores import score
from estimators.discrepancy.checks.unmodelled_forces import JointSizes
from estimators.discrepancy.search.holdout import HoldOutResult
from estimators.discrepancy.search.lower_minimum import strayed
from estimators.discrepancy.verdict import RigChecks, RigDiagnosis, VehicleDiagnosis, Verdict
from estimators.discrepancy.wording import _discrepancy_phrase
from estimators.filters.belief_history import BeliefHistory
from estimators.filters.model_evidence import EvidenceSettings, RobustPosterior

THRESHOLDS = (
    ("estimators.filters.joint_bank", "BankSettings", "sure", 0.99),
    ("estimators.filters.joint_bank", "BankSettings", "widest", 0.1),
    ("estimators.filters.joint_bank", "BankSettings", "watch_time", 2.0),
    ("estimators.filters.joint_bank", "BankSettings", "surprise", 5.0),
    ("estimators.filters.joint_bank", "BankSettings", "renew", 10.0),
    ("estimators.filters.joint_bank", "BankSettings", "change_time", 1.0),
    ("estimators.filters.joint_bank", "BankSettings", "change_level", 6.0),
    ("estimators.filters.joint_bank", "BankSettings", "drop", 1e-08),
    ("estimators.filters.joint_bank", "BankSettings", "merge", 0.5),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "sure", 0.99),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "widest", 0.15),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "watch_time", 2.0),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "surprise", 5.0),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "renew", 10.0),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "drop", 1e-06),
    ("estimators.filters.augmented_ekf_bank", "AugmentedBankSettings", "merge", 1.0),
    ("estimators.filters.model_evidence", "EvidenceSettings", "memory", 20.0),
    ("estimators.filters.model_evidence", "EvidenceSettings", "speed", 0.05),
    ("estimators.filters.model_evidence", "EvidenceSettings", "error_time", 0.3),
    ("estimators.filters.model_evidence", "EvidenceSettings", "widest", 0.15),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "alpha", 1.0),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "drift", 0.03),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "error_time", 0.3),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "hold_speed", 1.0),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "least_information", 0.02),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "surprise", 25.0),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "change_time", 0.5),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "change_level", 1.25),
    ("estimators.filters.online_parameter_ukf", "OnlineParameterSettings", "change_settle", 1.0),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "drift", 0.02),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "push_time", 0.3),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "hold_speed", 1.0),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "surprise", 25.0),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "drop", 0.0001),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "change_time", 1.0),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "change_level", 3.0),
    ("estimators.filters.online_joint_ukf", "OnlineJointSettings", "change_settle", 1.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "drift", 0.03),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "error_time", 0.3),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "settle_time", 1.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "hold_speed", 1.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "mass", 0.05),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "acceleration_bias", 0.1),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "rate_bias", 0.005),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "rim_scale", 0.01),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "grade", 0.03),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "reserve", 2.5),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "short_time", 0.5),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "memory_time", 5.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "misfit_time", 2.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "surprise", 15.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "misfit", 0.6),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "rejected_time", 10.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "test_time", 2.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "early_time", 0.6),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "early_surprise", 0.4),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "discrepancy", 2.5),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "widening", 0.2),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "unsettled_time", 3.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "slowing_time", 1.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "refresh_time", 2.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "refresh_move", 0.6),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "refresh_latest", 8.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "refresh_far", 1.8),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "information_n", 0.6),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "averaging_time", 10.0),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "fading", (0.33, 1.0)),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "error", (0.15, 0.3, 0.03, 0.07, 0.22)),
    ("estimators.filters.online_soil_belief", "SoilBeliefSettings", "stuck", (2.5, 5.0)),
    (
        "estimators.filters.online_soil_belief",
        "SoilBeliefSettings",
        "information",
        (1.4, 1.2, 1.0, 3.3, 1.0, 1.0),
    ),
    ("estimators.belief.soil_belief", "", "ADEQUATE", 1.0),
    ("estimators.belief.soil_belief", "", "DISCREPANCY", (0.05, 0.08)),
    ("estimators.belief.soil_belief", "", "_ANSWER", 0.3),
    ("estimators.belief.soil_belief", "", "_PREDICTED", 0.5),
    ("estimators.belief.soil_belief", "", "_FOUR_WHEELS", 10.0),
    ("estimators.belief.soil_belief", "", "_HOPELESS", 0.001),
    ("estimators.belief.soil_belief", "", "_PROMISING", 0.05),
    ("estimators.belief.structure_choice", "", "_FINEST", 0.1),
    ("estimators.belief.fit", "", "_NU", 6.0),
    ("estimators.belief.fit", "", "FAILED", 20.0),
    ("estimators.belief.drive_errors", "", "_FACTOR_SD", 0.7),
    ("estimators.belief.drive_fit", "", "_FIRST_SCALES", 1.5),
    ("estimators.belief.drive_problem", "", "_STUCK", 30.0),
    ("estimators.belief.drive_posterior", "PosteriorSettings", "tempered", 1.5),
    ("estimators.belief.drive_limits", "FittedLimitSettings", "adequate", 3.0),
    ("estimators.belief.drive_limits", "FittedLimitSettings", "adequate_sideways", 1.7),
    ("estimators.belief.drive_fit", "", "LEAST_SCATTER", 0.8),
    ("estimators.belief.drive_scatter", "", "CORRELATION_LENGTH", 5.0),
    ("estimators.belief.drive_numbers", "", "VEHICLE_SD", (0.05, 0.2, 0.2)),
    ("estimators.belief.drive_samples", "", "BLOCK", 0.2),
    ("estimators.belief.windows", "", "WINDOW", 2.0),
    ("estimators.belief.windows", "", "_BLOCK", 0.5),
    ("estimators.belief.unknowns", "Tolerances", "soil", 0.05),
    ("estimators.belief.unknowns", "Tolerances", "mass", 0.02),
    ("estimators.belief.unknowns", "Tolerances", "radius", 0.003),
    ("estimators.belief.unknowns", "Tolerances", "torque", 0.02),
    ("estimators.belief.unknowns", "Tolerances", "steer", 0.003),
    ("estimators.filters.parameter_ukf", "ParameterSettings", "alpha", 0.5),
    ("estimators.filters.parameter_ukf", "ParameterSettings", "drift", 0.01),
    ("estimators.filters.online_base", "", "MEAN_TIME", 2.0),
    ("estimators.filters.online_base", "", "WIDEST", 1.0),
    ("estimators.filters.online_base", "", "_MARGIN", 0.15),
    ("estimators.filters.gaussian_sum", "", "APART", 3.0),
    ("estimators.filters.gaussian_sum", "", "DISTRUST", 4.0),
    ("estimators.filters.gaussian_sum", "", "_LOWER", 0.025),
    ("estimators.filters.gaussian_sum", "", "_UPPER", 0.975),
    ("estimators.analysis.consistency", "", "_LARGEST_EXCESS", 5.0),
    ("estimators.analysis.consistency", "", "_WATCH_TIME", 2.0),
    ("estimators.analysis.consistency", "", "_NARROW", 0.08),
    ("estimators.analysis.scores", "", "SETTLED", 20.0),
    ("estimators.analysis.scores", "", "WRONG", 0.05),
    ("estimators.analysis.scores", "", "_DIVERGED", 0.2),
    ("estimators.analysis.scores", "", "_LASTING", 2.0),
    ("estimators.discrepancy.checks.regime_rest", "", "_LEAST", 50),
    ("estimators.discrepancy.physical_ranges", "", "_MOST", 3.0),
    ("estimators.discrepancy.physical_ranges", "", "_NEAR", 0.005),
    ("estimators.discrepancy.verdict", "", "REST_RATE", 0.002),
    ("estimators.discrepancy.verdict", "", "OVERLAP", 0.2),
    ("estimators.discrepancy.verdict", "", "_OWN", 0.5),
    ("estimators.discrepancy.verdict", "", "_MOST", 0.9),
    ("estimators.discrepancy.verdict", "", "_SAME", 0.5),
    ("estimators.discrepancy.verdict", "", "_Z", 1.96),
    ("estimators.discrepancy.verdict", "", "_SOLVER", 1.0),
    ("estimators.discrepancy.verdict", "", "_SOLVER_SHARE", 0.1),
    ("estimators.discrepancy.verdict", "", "_TESTABLE", 0.5),
    ("estimators.discrepancy.verdict", "", "_REMAINING", 0.3333333333333333),
    ("estimators.discrepancy.diagnosis", "", "SCREEN_RATE", 0.06),
    ("estimators.discrepancy.model.linearisation", "", "_JUMP", 1.0),
    ("estimators.discrepancy.model.linearisation", "", "_APART", 0.25),
    ("estimators.discrepancy.model.linearisation", "", "_SHARE", 0.05),
    ("estimators.logs.plausibility", "", "_BRIDGED", 3),
    ("estimators.logs.axle_speeds", "", "_DRIVEN", 3.0),
    ("estimators.logs.agreement", "", "_TURNED", 6.0),
    ("estimators.logs.immobile", "", "_PUSHED", 0.1),
    ("estimators.logs.immobile", "", "_UNEVEN", 3.0),
    ("estimators.logs.immobile", "", "_ALIKE", 1.5),
    ("estimators.logs.immobile", "", "_MOMENT", 0.3),
    ("estimators.logs.immobile", "", "_SAMPLES", 5),
    ("estimators.discrepancy.search.holdout", "", "_AGAINST", 2.33),
    ("estimators.discrepancy.search.result", "", "EQUIVALENT", 6.63),
    ("estimators.discrepancy.search.score_test", "", "_NOTHING", 0.4),
    ("estimators.discrepancy.search.score_test", "", "_CLOSE", 0.5),
    ("estimators.discrepancy.search.score_test", "", "_CLOSER", 0.1),
    ("estimators.discrepancy.search.score_test", "", "DETECTABLE", 4.42),
    ("estimators.discrepancy.search.stepwise", "", "MOST", 4),
    ("estimators.discrepancy.search.stepwise", "", "_CONFIRMED", 0.2),
    ("estimators.discrepancy.search.acceptance", "", "TESTED", 3),
    ("estimators.discrepancy.search.alternatives", "", "NEAR_BEST", 0.6),
    ("estimators.discrepancy.search.alternatives", "", "_SHARE_LEFT", 0.5),
    ("estimators.discrepancy.search.acceptance", "", "LARGE", 2.0),
    ("estimators.discrepancy.search.alternatives", "", "_WIDER", 4.0),
    ("estimators.discrepancy.search.stepwise", "", "_BEYOND", 0.005),
    ("estimators.discrepancy.search.acceptance", "", "IMPOSSIBLE", 6.0),
    ("estimators.discrepancy.search.from_stated", "", "_SUSPECT", 2.5),
    ("estimators.discrepancy.search.from_stated", "", "_OF_NUMBERS", 5),
    ("estimators.discrepancy.search.from_stated", "", "_OF_SCORES", 8),
    ("estimators.discrepancy.search.from_stated", "", "_WHATEVER", 3),
    ("estimators.discrepancy.search.from_stated", "", "_NEAR_LEAST", 1.6),
    ("estimators.discrepancy.search.from_stated", "", "_FIRST", 3),
    ("estimators.discrepancy.search.from_stated", "", "_SAME", 0.1),
    ("estimators.discrepancy.search.from_stated", "", "_BEGUN", 8),
    ("estimators.discrepancy.search.second_look", "", "_RARE", 0.005),
    ("estimators.discrepancy.search.unfitted", "", "_SHARES", (-0.8, -0.4, 0.4, 0.8)),
    ("estimators.discrepancy.search.unfitted", "", "_FINER", 0.2),
    ("estimators.discrepancy.search.unfitted", "", "_NEAR_N", 0.1),
    ("estimators.discrepancy.search.unfitted", "", "_CLOSELY", 3),
    ("estimators.discrepancy.search.unfitted", "", "_FIRSTS", 3),
    ("estimators.discrepancy.search.unfitted", "", "_BESIDE", 2),
    ("estimators.discrepancy.search.unfitted", "", "_PAIRS", 4),
    ("estimators.discrepancy.search.lower_minimum", "", "_ASTRAY", 3.5),
    ("estimators.discrepancy.search.lower_minimum", "", "_ASTRAY_N", 0.25),
    ("estimators.discrepancy.search.lower_minimum", "", "_EXPONENTS", (0.3, 0.5, 0.7, 0.9, 1.1)),
    ("estimators.discrepancy.model.linearisation", "", "_ALIKE", 0.01),
    ("estimators.discrepancy.structure_comparison", "", "_BEHIND", 0.4),
    ("estimators.discrepancy.search.lower_minimum", "", "LEFT", 4.5),
    ("estimators.discrepancy.model.fit", "", "HOPELESS", 10.0),
    ("estimators.discrepancy.model.fit", "", "_BEHIND", 0.5),
    ("agents.studies.fault_detection.one_log", "", "_WITHIN", 0.9),
    ("estimators.discrepancy.checks.holdout_gain", "", "_BAD", 1.5),
    ("estimators.discrepancy.checks.holdout_gain", "", "_BESIDE", 0.25),
    ("estimators.discrepancy.checks.likelihood_profiles", "", "LEVEL", 3.841),
    ("estimators.discrepancy.checks.misfit", "", "WORST", 5.0),
    ("estimators.logs.mounting_leaks", "", "_ANGLE", 0.2),
    ("estimators.logs.mounting_leaks", "", "_ANTENNA", 1.5),
    ("estimators.logs.mounting_leaks", "", "_ALONG", 0.6),
    ("estimators.logs.mounting_leaks", "", "_UP", 1.0),
    ("estimators.logs.mounting_leaks", "", "_ENOUGH", 10),
    ("offroad_env.environment.control_period", "", "_STUCK_TIME", 4.0),
    ("offroad_env.environment.control_period", "", "_STUCK_DRIVE", 0.3),
    ("offroad_env.environment.control_period", "", "_ROLLOVER_TIME", 0.2),
)


@pytest.mark.parametrize(("module", "settings", "name", "value"), THRESHOLDS)
def test_a_threshold_is_the_one_with_which_its_rates_were_measured(module, settings, name, value):
    place = importlib.import_module(module)
    assert getattr(getattr(place, settings)() if settings else place, name) == value


def history(n, sd=0.01, valid=True, nis=3.0):
    n = np.asarray(n, dtype=float)
    t = 0.1 * np.arange(len(n))
    return BeliefHistory(
        t=t,
        n=n,
        sd=np.full(len(n), sd),
        low=n - 2.0 * sd,
        high=n + 2.0 * sd,
        nis=np.full(len(n), nis),
        channels=3,
        valid=np.full(len(n), valid),
    )


@pytest.mark.parametrize(
    ("end", "valid", "wrong"), [(0.74, True, False), (0.76, True, True), (0.76, False, False)]
)
def test_an_estimate_is_wrong_where_its_flag_is_up_for_another_soil(end, valid, wrong):
    assert score(history([0.7] * 9 + [end], valid=valid), 0.7).wrong is wrong


@pytest.mark.parametrize(
    ("factor", "count", "sd", "silent"),
    [(1.25, 25, 0.01, True), (1.15, 25, 0.01, False), (1.25, 15, 0.01, False), (1.25, 25, 0.2, False)],
)
def test_a_run_diverges_silently_by_a_fifth_for_two_seconds_outside_of_its_interval(
    factor, count, sd, silent
):
    n = [0.7 * factor] * count + [0.7] * (60 - count)
    assert score(history(n, sd=sd), 0.7).silent is silent
    assert not score(history(n, sd=sd, valid=False), 0.7).silent


def test_the_late_error_counts_from_twenty_seconds_on():
    found = score(history([0.8] * 200 + [0.7] * 100), 0.7)
    assert found.late_mse == 0.0
    assert found.mse == pytest.approx(0.01 * 200 / 300)
    assert score(history([0.7] * 200 + [0.8] * 100), 0.7).late_mse == pytest.approx(0.01)


def test_an_estimate_has_settled_where_its_error_stays_below_five_per_cent():
    truth = 0.7
    assert score(history([1.07 * truth] * 10 + [1.03 * truth] * 20), truth).time_to_5pct == pytest.approx(1.0)
    assert score(history([1.03 * truth] * 10 + [1.07 * truth] * 20), truth).time_to_5pct == math.inf


def test_a_flag_without_one_needs_innovations_as_expected_a_narrow_interval_and_time():
    calm, dt = np.full(600, 3.0), 0.01
    narrow, wide = np.full(600, 0.079), np.full(600, 0.081)
    flag = innovation_flag(calm, narrow, 3, dt)
    assert not flag[:200].any()
    assert flag[205:].all()
    assert not innovation_flag(calm, wide, 3, dt).any()
    assert not innovation_flag(np.full(600, 30.0), narrow, 3, dt)[205:].any()


@pytest.mark.parametrize(
    ("gain", "expected", "deviation", "contradicts"),
    [(-3.0, 5.0, 2.0, True), (1.0, 5.0, 1.0, False), (-0.1, 5.0, 2.0, True), (-0.1, 5.0, 4.0, False)],
)
def test_a_larger_model_is_refused_where_it_gains_less_than_a_true_one_in_a_hundredth_of_logs(
    gain, expected, deviation, contradicts
):
    assert HoldOutResult(gain=gain, expected=expected, deviation=deviation).contradicts is contradicts


@pytest.mark.parametrize(
    ("gain", "expected", "deviation", "surpasses"),
    [(1.0, 5.0, 2.0, True), (-0.1, 5.0, 2.0, False), (1.5, 5.0, 3.0, False), (2.1, 5.0, 3.0, True)],
)
def test_another_model_takes_a_place_where_the_present_one_would_lose_as_much_in_a_hundredth_of_logs(
    gain, expected, deviation, surpasses
):
    assert HoldOutResult(gain=gain, expected=expected, deviation=deviation).surpasses is surpasses


def test_a_robust_flag_is_down_where_the_possible_soils_are_wider_than_a_share_of_the_estimate():
    share = EvidenceSettings().widest
    n = np.array([0.5, 0.7])
    posterior = RobustPosterior(n=n, weights=np.array([[0.0, 1.0], [0.5, 0.5]]), widest=share)
    sd, valid = posterior.robust(np.array([0.7, 0.7]), np.array([0.03, 0.03]), np.array([True, True]))
    assert sd == pytest.approx([0.03, math.hypot(0.03, 0.2 / math.sqrt(2.0))])
    assert valid.tolist() == [True, False]
    _, valid = posterior.robust(np.array([0.7, 0.7]), np.array([0.03, 0.03]), np.array([False, False]))
    assert not valid.any()
    assert posterior.mean == pytest.approx([0.7, 0.6])
    assert posterior.sd == pytest.approx([0.0, 0.1])


def diagnosis(solver=0.01, strongest=2.0, **parts):
    search = SimpleNamespace(
        first=SimpleNamespace(z=np.array([strongest])), refused=False, capped=False, strayed=(), uncertain=()
    )
    checks = RigChecks(
        solver=solver, gate=(), converged=True, threshold=3.0, trials=9, left_out=0, conditions={"search": 3}
    )
    return RigDiagnosis(**{"search": search, "checks": checks, "limits": {"cohesion": 1.0}, **parts})


@pytest.mark.parametrize(
    ("solver", "strongest", "accurate"),
    [(0.9, 2.0, True), (1.1, 2.0, False), (1.9, 20.0, True), (2.1, 20.0, False), (2.1, -20.0, False)],
)
def test_a_solver_may_move_scores_by_one_or_by_a_tenth_of_the_largest(solver, strongest, accurate):
    assert diagnosis(solver, strongest).inaccurate is not accurate


@pytest.mark.parametrize(("lost", "verdict"), [(1, Verdict.NO_EFFECT), (3, Verdict.NOT_TESTABLE)])
def test_a_log_tests_the_library_if_it_would_show_half_of_it(lost, verdict):
    limits = dict.fromkeys("abcd", 1.0)
    gone = dict.fromkeys("abcd"[:lost], 1.0)
    assert diagnosis(limits=limits, not_testable=gone)._without_causes(4) is verdict


def test_a_larger_model_that_the_hold_out_test_refused_is_not_used():
    search = SimpleNamespace(
        extended="larger", nominal="nominal", refused=False, capped=False, strayed=(), uncertain=()
    )
    assert VehicleDiagnosis(search=search).model == "nominal"
    cause = SimpleNamespace(alternatives=(1,))
    assert VehicleDiagnosis(search=search, causes=(cause,)).model == "larger"


def test_a_model_holds_the_causes_that_are_named_and_no_others():
    search = SimpleNamespace(
        extended=SimpleNamespace(sizes=np.array([1.0, 1.0])),
        nominal="nominal",
        refused=True,
        capped=False,
        strayed=(),
        uncertain=(),
        beyond_null_logs=False,
        threshold=3.0,
        last=SimpleNamespace(z=np.array([5.0])),
    )
    cause = SimpleNamespace(alternatives=(1,))
    log = SimpleNamespace(rig=True)  # no vehicle that bounds the sizes
    parts = {"logs": (log,), "search": search, "causes": (cause, cause), "partial": "partial"}
    models = [
        VehicleDiagnosis(**parts, joint=own).model
        for own in (joint(), joint(size=1.55), joint(deviation=0.4))
    ]
    assert models == [search.extended, "partial", "nominal"]


def test_a_score_beyond_null_logs_that_the_hold_out_test_refuses_leaves_a_discrepancy():
    found = [
        VehicleDiagnosis(
            search=SimpleNamespace(
                refused=refused, capped=False, strayed=(), uncertain=(), beyond_null_logs=True
            )
        )
        for refused in (True, False)
    ]
    assert [one.verdict for one in found] == [Verdict.UNEXPLAINED, Verdict.NO_EFFECT]


@pytest.mark.parametrize(("refused", "capped"), [(True, False), (False, True), (False, False)])
def test_effects_that_are_refused_or_one_too_many_leave_a_discrepancy(refused, capped):
    last = SimpleNamespace(z=np.array([-5.0, 2.0]))
    search = SimpleNamespace(
        refused=refused, capped=capped, strayed=(), uncertain=(), last=last, beyond_null_logs=False
    )
    log = SimpleNamespace(rig=True)  # no vehicle that bounds the sizes
    parts = {"logs": (log,), "search": search, "causes": (SimpleNamespace(alternatives=(1,)),)}
    found = VehicleDiagnosis(**parts)
    assert found.incomplete is (refused or capped)
    assert found.remaining == (25.0 if refused or capped else 0.0)
    best = SimpleNamespace(effect="payload")
    shown = SimpleNamespace(best=best, effects=["payload"], structural=False)
    if capped:
        assert "more effects are significant than the 4" in _discrepancy_phrase(found, (shown,), ())


def test_a_number_that_no_tolerance_explains_is_a_discrepancy_where_nothing_is_found():
    search = {"refused": False, "capped": False, "beyond_null_logs": False}
    found = VehicleDiagnosis(search=SimpleNamespace(**search, strayed=("shear_moduli",), uncertain=()))
    assert found.verdict is Verdict.UNEXPLAINED
    found = replace(
        found, search=SimpleNamespace(**search, strayed=("shear_moduli",), uncertain=(), first=None)
    )
    assert "beyond any tolerance of theirs (shear moduli)" in _discrepancy_phrase(found, (), ())
    assert (
        VehicleDiagnosis(search=SimpleNamespace(**search, strayed=(), uncertain=())).verdict
        is Verdict.NO_EFFECT
    )


def test_numbers_stray_where_a_fit_moves_them_far_from_the_stated_ones():
    nuisances = [
        SimpleNamespace(name=name, tolerated=name != "shift") for name in ("shift", "mass", "cohesion")
    ]
    problem = SimpleNamespace(nuisances=nuisances, nuisance_spread=np.array([1.0, 0.5, 2.0]))
    fit = SimpleNamespace(nuisances=np.array([9.0, -1.6, 5.9]), problem=problem)
    assert strayed(fit, 3.0) == ["mass"]
    assert strayed(fit, 2.9) == ["mass", "cohesion"]


def joint(kept=0.6, size=1.0, correlation=0.1, deviation=0.1):
    matrix = np.array([[0.0, correlation], [correlation, 0.0]])
    return JointSizes(
        sizes=np.array([size, 1.0]),
        deviations=np.full(2, deviation),
        kept=np.array([kept, 0.6]),
        correlations=matrix,
    )


def named(found, remaining=0.0):
    """Which of two causes may be named with unknown inputs fitted jointly."""
    search = SimpleNamespace(
        extended=SimpleNamespace(sizes=np.array([1.0, 1.0])),
        first=SimpleNamespace(z=np.array([9.0])),
        refused=False,
        capped=False,
        strayed=(),
        uncertain=(),
        beyond_null_logs=False,
        threshold=3.0,
    )
    cause = SimpleNamespace(alternatives=(1,))
    inputs = (SimpleNamespace(excess=remaining, p_value=1.0),)
    log = SimpleNamespace(rig=True)  # no vehicle that bounds the sizes
    parts = {"search": search, "causes": (cause, cause), "joint": found, "unknown_inputs": inputs}
    return VehicleDiagnosis(logs=(log,), **parts).identifiable


@pytest.mark.parametrize(("effect", "kept"), [("shear_modulus", False), ("payload", True)])
def test_no_cause_is_certain_that_a_number_undoes_beyond_its_own_tolerance(effect, kept):
    number = SimpleNamespace(name="shear_moduli", effect="shear_modulus")
    problem = SimpleNamespace(nuisances=[number])
    search = SimpleNamespace(
        extended=SimpleNamespace(problem=problem), strayed=("shear_moduli",), uncertain=()
    )
    cause = SimpleNamespace(best=SimpleNamespace(candidate=SimpleNamespace(effect=effect)))
    found = VehicleDiagnosis(logs=(SimpleNamespace(rig=True),), search=search, causes=(cause,))
    assert found.identifiable == (kept,)


def test_no_cause_is_certain_that_windows_apart_contradict():
    problem = SimpleNamespace(nuisances=[])
    search = SimpleNamespace(extended=SimpleNamespace(problem=problem), strayed=(), uncertain=(1,))
    cause = SimpleNamespace(best=SimpleNamespace(candidate=SimpleNamespace(effect="payload")))
    found = VehicleDiagnosis(logs=(SimpleNamespace(rig=True),), search=search, causes=(cause,) * 3)
    assert found.identifiable == (True, False, True)


def test_causes_are_identifiable_by_their_information_their_share_and_their_size():
    assert named(joint()) == (True, True)
    assert named(joint(kept=0.4), remaining=1.0) == (True, True)  # it explains almost everything
    assert named(joint(kept=0.4), remaining=30.0) == (False, True)
    assert named(joint(size=1.45)) == (True, True)
    assert named(joint(size=1.55)) == (False, True)
    assert named(joint(deviation=0.3)) == (True, True)
    assert named(joint(deviation=0.4)) == (False, False)  # not significant any more
    assert named(joint(correlation=0.25)) == (False, False)
    assert named(joint(correlation=0.15)) == (True, True)
