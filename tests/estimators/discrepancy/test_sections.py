"""Where one section of a diagnosis breaks down the others are kept, and the report says what is missing."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from agents.commands.diagnose import Diagnose
from agents.reports.diagnosis import render_diagnosis
from estimators.discrepancy import data_quality as data_quality_module
from estimators.discrepancy import diagnosis as diagnosis_module
from estimators.discrepancy import evidence as evidence_module
from estimators.discrepancy.data_quality import quality_of
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.evidence import gather
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.sections import attempt
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.wording import terminal_lines
from offroad_env.errors import SolverFailure

_LIBRARY = ("steer_delay", "payload")


@pytest.fixture(scope="module")
def late():
    """A short run whose steering acts 0.15 s late."""
    return simulated_log(draw_case(31, road="flat", duration=14.0), FAULTS["steer_delay"](0.15))


def _broken(*_args, **_kwargs):
    raise np.linalg.LinAlgError("Singular matrix")


def _stuck(*_args, **_kwargs):
    raise SolverFailure("a wheel has sunk to its axle")


def _blas_threads() -> set[int]:
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_a_diagnosis_uses_one_thread_of_blas_and_gives_the_others_back(monkeypatch):
    """With two, a diagnosis beside another one took 1.8 times as long."""
    seen = []
    monkeypatch.setattr(diagnosis_module, "_diagnosed", lambda *_, **__: seen.append(_blas_threads()))
    monkeypatch.setattr(diagnosis_module, "_with_stops", lambda result, *_: seen.append(_blas_threads()))
    with threadpool_limits(limits=2, user_api="blas"):
        diagnose([])
        assert _blas_threads() == {2}
    assert seen == [{1}, {1}]


def test_a_section_that_fails_is_replaced_and_its_reason_kept():
    failed: dict[str, str] = {}
    assert attempt("sum", lambda: 1 + 1, 0, failed) == 2
    assert attempt("quotient", lambda: 1 // 0, 0, failed) == 0
    assert failed == {"quotient": "ZeroDivisionError: integer division or modulo by zero"}


@pytest.mark.check
def test_a_crash_in_any_section_loses_no_other(late, monkeypatch, tmp_path, capsys):
    """Unknown inputs, rest by regime, test data and all sections of the report but one break down."""
    for name in ("unmodelled_forces", "regime_rests", "_on_test_data"):
        monkeypatch.setattr(diagnosis_module, name, _broken)
    for name in ("predictions", "profiles_of", "advise", "misfit_of"):
        monkeypatch.setattr(evidence_module, name, _broken)
    found = diagnose([late], library=_LIBRARY)
    assert [cause.best.candidate.effect for cause in found.named] == ["steer_delay"]
    summary = summarise(found, gather(found))
    missing = {"unknown inputs", "rest by regime", "test data", "forecasts", "profiles", "next experiment",
               "errors by regime"}  # fmt: skip
    assert set(summary.failed) == missing
    assert summary.evidence.whiteness
    lines = terminal_lines(summary)
    assert sum(line.startswith("missing: ") for line in lines) == len(missing)
    page = render_diagnosis(summary, "offroad diagnose run.csv")
    assert "Missing: forecasts (LinAlgError: Singular matrix)." in page
    Diagnose(logs=(), out=tmp_path).publish(found, summary)
    assert set((tmp_path / "diagnosis.json").read_text().split('"')) >= missing
    assert (tmp_path / "extended.json").exists()
    assert "missing: profiles" in capsys.readouterr().out


def test_a_crash_in_the_checks_of_the_data_loses_nothing_else(late, monkeypatch):
    """Of several logs the report says whose checks are missing; an unchecked log has no findings."""
    real = data_quality_module.quality
    monkeypatch.setattr(
        data_quality_module, "quality", lambda log: _broken() if log.name == "run" else real(log)
    )
    other, failed = replace(late, name="other"), {}
    reports = quality_of([late, other], failed)
    assert failed == {"data quality of run": "LinAlgError: Singular matrix"}
    assert (reports[0].name, reports[0].channels, reports[0].problems) == ("run", (), ())
    assert reports[1].channels
    monkeypatch.setattr(diagnosis_module, "fit_runs", _stuck)
    monkeypatch.setattr(diagnosis_module, "compare_structures", lambda logs: None)
    found = diagnose([late])
    assert set(found.failed) == {"data quality", "nominal model"}
    summary = summarise(found)
    assert "missing: data quality: LinAlgError: Singular matrix" in terminal_lines(summary)
    page = render_diagnosis(summary, "offroad diagnose run.csv")
    assert "Missing: data quality (LinAlgError: Singular matrix)." in page


@pytest.mark.check
def test_where_the_search_breaks_down_the_scores_remain_and_nothing_is_named(late, monkeypatch):
    monkeypatch.setattr(diagnosis_module, "search", _broken)
    found = diagnose([late], library=_LIBRARY)
    assert found.verdict == "NUMERICS"
    assert found.limits["steer_delay"] > 0.0
    assert "search breaks down on these runs: LinAlgError" in summarise(found).sentence


def test_a_model_that_cannot_drive_and_has_no_better_structure_is_a_matter_of_numerics(late, monkeypatch):
    monkeypatch.setattr(diagnosis_module, "fit_runs", _stuck)
    monkeypatch.setattr(diagnosis_module, "compare_structures", lambda logs: None)
    found = diagnose([late])
    assert found.verdict == "NUMERICS"
    assert summarise(found).sentence.startswith("The nominal model breaks down on these runs: SolverFailure")


@pytest.mark.check
def test_a_log_without_a_pitch_gyro_is_diagnosed_and_no_section_is_missing(late):
    channels = {name: values for name, values in late.channels.items() if name != "pitch_rate"}
    found = diagnose([replace(late, channels=channels)], library=_LIBRARY)
    assert [cause.best.candidate.effect for cause in found.named] == ["steer_delay"]
    assert not summarise(found, gather(found)).failed
