"""The report of a diagnosis as one HTML page: from the verdict to its checks."""

from __future__ import annotations

import platform
from collections.abc import Sequence

import numpy as np

from agents.reports import diagnosis_figures as figures
from agents.reports.diagnosis_drive import drive_section, page_verdict
from agents.reports.diagnosis_structure import structure_section
from agents.reports.page import Picture, Section, Table, figure_picture, render_page
from estimators.discrepancy.checks.forecast import Prediction
from estimators.discrepancy.checks.misfit import WORST
from estimators.discrepancy.evidence import SEED, Evidence
from estimators.discrepancy.summary import CauseSummary, DiagnosisSummary, Estimate
from estimators.discrepancy.verdict import Verdict
from estimators.discrepancy.wording import open_points
from estimators.logs.log import Log

__all__ = ["made_by", "percent", "render_diagnosis"]

#: Pairs of effects that are listed.
_PAIRS = 12
#: |cosine| from which two effects can hardly be distinguished.
_SAME = 0.99
#: Names of the uses of the data.
_USES = {"search": "search", "gate": "hold-out test", "report": "test data"}


def made_by() -> str:
    """Versions of what made the page."""
    from importlib.metadata import version

    from offroad_env import __version__

    return (
        f"OffroadBekker {__version__}; Python {platform.python_version()}, NumPy {version('numpy')}, "
        f"Numba {version('numba')}, SciPy {version('scipy')}, {platform.system()} {platform.machine()}"
    )


def render_diagnosis(summary: DiagnosisSummary, command: str, log: Log | None = None) -> str:
    """The page as HTML text; parts that were not reached state why. A ``log`` is played back."""
    evidence = Evidence(quality=()) if summary.evidence is None else summary.evidence
    drive = None if log is None else drive_section(summary, log)
    parts = (
        _verdict(summary),
        *(() if drive is None else (drive,)),
        _misfit(summary, evidence),
        _dependence(summary, evidence),
        _causes(summary),
        _isolability(summary),
        _gain(summary, evidence),
        _prediction(summary, evidence),
        _sizes(summary, evidence),
        _next(summary),
        _checks(summary, evidence, command),
    )
    names = ", ".join(run.name for run in summary.runs)
    return render_page(
        parts,
        title=f"OffroadBekker: diagnosis of {names}",
        intro=_intro(summary),
        footer=f"{command} — {made_by()}",
        verdict=page_verdict(summary),
    )


def _intro(summary: DiagnosisSummary) -> str:
    seconds = sum(run.duration for run in summary.runs)
    runs = f"{len(summary.runs)} runs" if len(summary.runs) > 1 else "one run"
    fitted = "the stiffnesses of its tyres" if summary.hard_ground else "n"
    return (
        f"Errors of the simulation of {runs} ({seconds:.0f} s): their causes, the certainty of each cause, "
        "and the gain from modelling it. Errors are measured less simulated. The nominal model is the one "
        f"that the log states, with {fitted} fitted; the extended model has the causes in it."
    )


def _unreached(summary: DiagnosisSummary) -> str:
    if summary.verdict is Verdict.DATA_PROBLEM:
        return "Not reached: the data must be corrected before any model is fitted."
    if summary.verdict is Verdict.OUTSIDE:
        return "Not reached: no model of this kind can be right, or the vehicle is stuck, so none is fitted."
    if summary.comparison is not None and summary.comparison.found:
        if not summary.comparison.adequate:
            return "Not judged: neither effects nor another structure predict the runs."
        return (
            "Not judged: the structure of the model is wrong, and effects within it would stand in for that."
        )
    if not summary.extended:
        return "Nothing to show: no cause is named, so there is no extended model."
    return "Nothing to show: the runs are too short to keep test data."


# ------------------------------------------------------------------ 1 to 3: what is wrong


def _verdict(summary: DiagnosisSummary) -> Section:
    rows = [row for number, cause in enumerate(summary.causes, 1) for row in _cause_rows(number, cause)]
    heading = ("cause", "family", "effect", "size", "95 % interval", "log-likelihood gained", "p-value")
    notes = [f"Finding: {finding}." for finding in summary.findings]
    notes += [figures.sentence(line) for line in summary.limitations]
    notes += open_points(summary)
    effects = (Table(heading=heading, rows=tuple(rows), texts=3),) if rows else ()
    if summary.comparison is not None and summary.comparison.found:
        return structure_section(summary, summary.comparison, effects, notes)
    if not summary.causes and summary.limits:
        notes.append("The score tests list the smallest detectable size of every effect.")
    return Section(
        name="verdict",
        title=f"Verdict: {summary.verdict}",
        sees=figures.raised(summary.sentence),
        tables=effects,
        notes=tuple(notes),
    )


def _cause_rows(number: int, cause: CauseSummary) -> list[tuple[str, ...]]:
    """One line a member; alternatives follow the best."""
    rows: list[tuple[str, ...]] = []
    for member in cause.members:
        first = member is cause.best
        place = f"{number}" if cause.named else f"{number}, confounded"
        p_value = f"{cause.p_value:.1g}" if cause.p_value > 1e-99 else "< 1e-99"
        rows.append(
            (
                place if first else "or",
                " or ".join(cause.families) if first else "",
                member.effect,
                figures.amount(member.effect, member.size),
                f"{member.low:.3g} to {figures.amount(member.effect, member.high)}",
                f"{cause.delta_loglik:.0f}" if first else f"{member.lacks_loglik:.1f} less",
                p_value if first else "",
            )
        )
    return rows


def _misfit(summary: DiagnosisSummary, evidence: Evidence) -> Section:
    title, misfit = "Errors by driving regime", evidence.misfit
    if misfit is None:
        return Section(name="wrong", title=title, sees=_unreached(summary))
    ratio = misfit.nominal / misfit.extended[:, :1]
    i, j = np.unravel_index(int(np.nanargmax(ratio)), ratio.shape)
    regime = "over the whole run" if j == 0 else f"while {misfit.regimes[j]}".replace("\n", " ")
    better = "the extended model" if summary.extended else "the same model"
    sees = (
        f"The nominal simulation is worst in {misfit.channels[i]} {regime}: its error there is "
        f"{ratio[i, j]:.1f} times that of {better} in that channel over the whole run."
    )
    extended = summary.extended
    pictures = [
        figure_picture(
            figures.misfit_figure(misfit, extended=extended),
            "Error by channel and driving regime, relative to the error that remains in that channel over "
            "the whole run. 1 is noise, empty: too few samples; a moment may belong to several regimes.",
        )
    ]
    if misfit.worst:
        pictures.append(
            figure_picture(
                figures.worst_figure(misfit, extended=extended),
                f"The worst {WORST:.0f} s, in {misfit.worst_run}: the channels with the largest errors. "
                "Lines break where a window ends, because the start of every window is fitted.",
            )
        )
    notes = ("Windows of the search (the checks state how the time is divided).",)
    return Section(name="wrong", title=title, sees=sees, pictures=tuple(pictures), notes=notes)


def _dependence(summary: DiagnosisSummary, evidence: Evidence) -> Section:
    title, misfit = "Error against state", evidence.misfit
    if misfit is None or not misfit.dependences:
        return Section(name="state", title=title, sees=_unreached(summary))
    most = misfit.dependences[0]
    sees = (
        f"The error of {most.channel} depends on {most.quantity.split(' [')[0]} most, which explains "
        f"{100.0 * most.share:.0f} % of its variance"
    )
    sees += (
        f", {100.0 * most.share_extended:.0f} % with the causes in the model." if summary.extended else "."
    )
    picture = figure_picture(
        figures.dependence_figure(misfit, extended=summary.extended),
        "Mean error in bins of equal counts, for every channel over the quantity that explains most of it. "
        "Bars are simultaneous 95 % intervals; samples of one second count as one draw.",
    )
    return Section(name="state", title=title, sees=sees, pictures=(picture,))


# ------------------------------------------------------------------ 4 and 5: causes


def _causes(summary: DiagnosisSummary) -> Section:
    title, scores = "Score tests", summary.scores
    if not scores:
        return Section(name="causes", title=title, sees=_unreached(summary))
    above = [score.effect for score in scores if score.z > summary.threshold]
    tested = sum(score.reason == "" for score in scores)
    members = sum(map(len, summary.effects))
    sees = (
        f"{len(above)} of {tested} testable effects alone are significant; "
        f"{members} {'belongs' if members == 1 else 'belong'} to a cause."
    )
    if not above:
        sees = f"None of {tested} testable effects is significant."
    picture = figure_picture(
        figures.cause_figure(scores, summary.threshold, summary.effects),
        "Score of every effect against the nominal model, and its smallest detectable size. Many effects "
        "resemble the true cause; those of the verdict are bold, and brackets join the alternatives that "
        "explain the data equally well. Grey: not testable, with the reason.",
    )
    return Section(name="causes", title=title, sees=sees, pictures=(picture,))


def _isolability(summary: DiagnosisSummary) -> Section:
    title = "Confounded effects"
    names, cosines = summary.isolability
    if len(names) < 2:
        return Section(name="alike", title=title, sees=_unreached(summary))
    upper = np.triu(np.abs(cosines), 1)
    order = np.argsort(-upper, axis=None)[:_PAIRS]
    pairs = [np.unravel_index(int(i), upper.shape) for i in order]
    count = int(np.sum(upper >= _SAME))
    sees = (
        f"{count} of {len(names) * (len(names) - 1) // 2} pairs of effects are confounded in these data "
        f"(|cosine| at least {_SAME:g})."
    )
    picture = figure_picture(
        figures.isolability_figure(names, cosines),
        "Similarity of the traces of two effects once n, the starts and small errors of the sensors are "
        "fitted: 1 is the same trace. Circles from 0.9, full ones from 0.99.",
    )
    rows = [(f"{names[i]} and {names[j]}", f"{upper[i, j]:.3f}") for i, j in pairs]
    return Section(
        name="alike",
        title=title,
        sees=sees,
        pictures=(picture,),
        tables=(Table(heading=("most similar", "|cosine|"), rows=tuple(rows)),),
    )


# ------------------------------------------------------------------ 6 to 8: what it gains


def _gain(summary: DiagnosisSummary, evidence: Evidence) -> Section:
    title = "Error on test data"
    if not summary.gains or not evidence.likelihood:
        return Section(name="gain", title=title, sees=_unreached(summary))
    best = max(summary.gains, key=lambda gain: gain.low)
    channels = {gain.channel for gain in summary.gains}
    sees = (
        f"The extended model lowers the error of {best.channel} by {100.0 * best.low:.0f} to "
        f"{100.0 * best.high:.0f} % (95 % interval), from {best.nominal:.3g} to {best.extended:.3g} "
        f"{figures.error_unit(best.channel, channels)}."
    )
    rows = []
    for gain, more in zip(summary.gains, evidence.likelihood, strict=True):
        rows.append(
            (
                gain.channel,
                figures.error_unit(gain.channel, channels),
                f"{gain.nominal:.3g}",
                f"{gain.extended:.3g}",
                percent(gain.low, gain.high),
                f"{more.gain:+.2f} [{more.low:+.2f}, {more.high:+.2f}]",
            )
        )
    heading = ("channel", "unit", "nominal", "extended", "reduction (95 %)", "log-likelihood gain per second")
    picture = figure_picture(
        figures.gain_figure(summary.gains, evidence.likelihood),
        "Root mean square error and log-likelihood of both models with 95 % intervals over blocks of a "
        "second, on data that no fit has used. Blue: better; red: worse; grey: not significant.",
    )
    return Section(
        name="gain",
        title=title,
        sees=sees,
        pictures=(picture,),
        tables=(Table(heading=heading, rows=tuple(rows), texts=2),),
    )


def _prediction(summary: DiagnosisSummary, evidence: Evidence) -> Section:
    title = "n and forecasts"
    if not summary.fitted:
        return Section(name="prediction", title=title, sees=_unreached(summary))
    pictures: list[Picture] = []
    tables: list[Table] = []
    if summary.n is not None:
        caption = "n of the soil with 95 % intervals, if the model is right in all other respects."
        pictures.append(figure_picture(figures.exponent_figure(summary.n), caption))
    if evidence.predictions:
        caption = (
            "Error of forecasts on the inputs alone, each started from one second of data, against measured "
            "position, speed and heading: both errors contain the noise of the sensors."
        )
        figure = figures.prediction_figure(evidence.predictions, extended=summary.extended)
        pictures.append(figure_picture(figure, caption))
        tables.append(_prediction_table(evidence.predictions, extended=summary.extended))
    sees = _exponent_sentence(summary)
    return Section(name="prediction", title=title, sees=sees, pictures=tuple(pictures), tables=tuple(tables))


def percent(low: float, high: float) -> str:
    """An interval of shares in words."""
    # Adding zero turns -0 into 0.
    return f"{round(100.0 * low) + 0} to {round(100.0 * high) + 0} %"


def _exponent_sentence(summary: DiagnosisSummary) -> str:
    n = summary.n
    if n is None:
        return "The ground is hard: there is no n."
    if n.single is None:
        values = [entry.value for entry in n.after.values()] or [n.before.value]
        return (
            f"No single n can be quoted: {n.before.value:.3f} with the nominal model, {min(values):.3f} to "
            f"{max(values):.3f} with the causes, and the explanation is incomplete or ambiguous."
        )
    if not summary.causes:
        return f"n = {n.single.value:.3f} (95 %: {_span(n.single)})."
    return (
        f"n was {n.before.value:.3f} with the nominal model and is {n.single.value:.3f} "
        f"(95 %: {_span(n.single)}) with the causes in it."
    )


def _span(entry: Estimate) -> str:
    return f"{entry.low:.3f} to {entry.high:.3f}"


def _prediction_table(predictions: Sequence[Prediction], *, extended: bool) -> Table:
    rows: list[tuple[str, ...]] = []
    for one in predictions:
        known = np.isfinite(one.low)
        span = percent(one.low, one.high) if known else "too few for an interval"
        row = (f"{one.quantity}, {one.horizon:.0f} s", one.unit, str(one.count), f"{one.nominal:.3g}")
        rows.append((*row, f"{one.extended:.3g}", span) if extended else row)
    heading = ("error of", "unit", "forecasts", "nominal", "extended", "reduction (95 %)")
    return Table(heading=heading if extended else heading[:4], rows=tuple(rows), texts=2)


def _sizes(summary: DiagnosisSummary, evidence: Evidence) -> Section:
    title = "Sizes of the causes"
    if not evidence.profiles:
        return Section(name="sizes", title=title, sees=_unreached(summary))
    rows = []
    curvature = {cause.best.effect: cause.best for cause in summary.causes}
    for profile in evidence.profiles:
        member = curvature[profile.effect]
        known = np.isfinite(profile.low) and np.isfinite(profile.high)
        rows.append(
            (
                profile.effect,
                figures.amount(profile.effect, profile.size),
                f"{profile.low:.3g} to {profile.high:.3g}" if known else "open",
                f"{member.low:.3g} to {member.high:.3g}",
            )
        )
    picture = figure_picture(
        figures.profile_figure(evidence.profiles),
        "Profile likelihood: loss where a size is fixed and all other parameters are fitted again. Where the "
        "profile follows the dashed parabola, the interval of the verdict holds; the dotted line marks 95 %.",
    )
    heading = ("effect", "size", "95 % by the profile", "95 % by the curvature")
    return Section(
        name="sizes",
        title=title,
        sees="Fitted jointly with n, the starts of the windows and the small errors of the sensors.",
        pictures=(picture,),
        tables=(Table(heading=heading, rows=tuple(rows)),),
    )


# ------------------------------------------------------------------ 9 and 10


def _next(summary: DiagnosisSummary) -> Section:
    title, advised = "Next experiment", summary.next_experiment
    if advised is None or advised.plan is None:
        sees = _unreached(summary) if advised is None else figures.sentence(advised.sentence)
        return Section(name="next", title=title, sees=sees)
    plan = advised.plan
    notes: tuple[str, ...] = ()
    if advised.alternative is not None:
        also = f"or, {advised.alternative}" if advised.planned else advised.alternative
        notes = (figures.sentence(also),)
    caption = (
        "Every manoeuvre of the menu, driven once and added to these data, simulated with the fitted model "
        "and the sensors of this log: "
    )
    caption += (
        "the probability that it answers the question."
        if plan.power is not None
        else "the smallest detectable size of an effect, relative to the present one."
    )
    rows = [(trial.name, trial.sentence) for trial in plan.trials]
    return Section(
        name="next",
        title=title,
        sees=figures.sentence(advised.sentence),
        pictures=(figure_picture(figures.menu_figure(plan), caption),),
        tables=(Table(heading=("manoeuvre", "what to do"), rows=tuple(rows), texts=2),),
        notes=notes,
    )


def _checks(summary: DiagnosisSummary, evidence: Evidence, command: str) -> Section:
    rows: list[tuple[str, str]] = []
    if summary.checks is not None:
        coloured = [one.channel for one in evidence.whiteness if not one.white]
        rows += [
            ("innovations are white", f"all but {', '.join(coloured)}" if coloured else "in all channels"),
            (
                "half the step of the solver moves a score by",
                f"{summary.checks.solver:.2g} standard deviations",
            ),
            ("the fit", "has converged" if summary.checks.converged else "has not converged"),
            ("threshold of a score", f"{summary.threshold:.2f} (from 20,000 draws, seed 2004)"),
            ("hold-out test of the causes", _holdout_gains(summary.checks.gate)),
            *((f"seconds for the {_USES[use]}", f"{seconds:.1f}") for use, seconds in evidence.split.items()),
        ]
    rows += [
        ("seed of the intervals", str(SEED)),
        ("command", command),
        *((f"SHA-256 of {run.name}", run.hash) for run in summary.runs),
    ]
    tables = [Table(heading=("check", "result"), rows=tuple(rows), texts=2)]
    if evidence.whiteness:
        names = (
            "innovations",
            "samples",
            "memory",
            "standard deviation",
            "largest correlation",
            "95 % bound",
        )
        lines = tuple(
            (
                one.channel,
                str(one.count),
                str(one.memory),
                f"{one.spread:.2f}",
                f"{one.correlation:+.3f} at lag {one.lag}",
                f"{one.bound:.3f}",
            )
            for one in evidence.whiteness
        )
        tables.append(Table(heading=names, rows=lines))
    for report in evidence.quality:
        heading, cells = report.table()
        tables.append(Table(heading=heading, rows=tuple(cells), texts=2))
    return Section(
        name="checks",
        title="Checks",
        sees="Checks behind the verdict: noise, solver, division of the time, seeds, quality of the data.",
        tables=tuple(tables),
    )


def _holdout_gains(gains: Sequence[float]) -> str:
    """Gains of the models that were tried in the hold-out test; the last may have been refused."""
    if not gains:
        return "no model was tried"
    return ", ".join(f"{gain:+.1f}" for gain in gains) + " in the log-likelihood"
