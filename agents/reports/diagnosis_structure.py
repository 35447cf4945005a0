"""The verdict of a diagnosis where another structure predicts a run better than the nominal one."""

from __future__ import annotations

from collections.abc import Sequence

from agents.reports import diagnosis_figures as figures
from agents.reports.page import Section, Table
from estimators.discrepancy.structure_comparison import StructureComparison, StructureTrial
from estimators.discrepancy.summary import DiagnosisSummary
from estimators.discrepancy.wording import structure_lines

__all__ = ["structure_section"]


def structure_section(
    summary: DiagnosisSummary, found: StructureComparison, effects: Sequence[Table], notes: Sequence[str]
) -> Section:
    """Other laws of wheel and soil, or of the vehicle: what each is worth, and the errors by structure.

    Parameters
    ----------
    effects
        Table of the effects that are listed beside it, if any are.
    notes
        What else is to be said.
    """
    first = "cause" if found.adequate else "part of the best structure"
    causes = tuple(
        (one.id, one.sentence, f"{100.0 * one.gain:.0f} %", f"{one.p_value:.1g}") for one in found.causes
    )
    trials = tuple(
        (
            one.case.structure,
            one.case.vehicle_model.replace("_", " "),
            f"{found.n - found.best.change + one.change:.3f}",
            *("-" if value is None else f"{value:.3g}" for value in one.pooled),
        )
        for one in (found.nominal, *found.trials)
    )
    units = [f"{name} [{figures.error_unit(name, set())}]" for name in StructureTrial.channels()]
    lines = [line for line in structure_lines(summary) if not line.startswith("cause: ")]
    return Section(
        name="verdict",
        title=f"Verdict: {summary.verdict}",
        sees=figures.raised(summary.sentence),
        tables=(
            *effects,
            Table(
                heading=(first, "what it is", "errors grow without it by", "p-value"), rows=causes, texts=2
            ),
            Table(heading=("structure", "vehicle", "n", *units), rows=trials, texts=2),
        ),
        notes=(*notes, *(f"{line[0].upper()}{line[1:]}." for line in lines)),
    )
