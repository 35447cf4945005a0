"""The report of a diagnosis as one HTML page: ten parts, from the verdict to its checks."""

from __future__ import annotations

import platform
from typing import Any

import numpy as np

from agents.figures import diagnosis_page as figures
from agents.report import Section, Table, figure_picture, render_page
from estimators.discrepancy.diagnosis import Diagnosis
from estimators.discrepancy.evidence import SEED, Evidence
from estimators.discrepancy.misfit import WORST
from estimators.discrepancy.verdict import (
    advice_of,
    ground_of,
    isolability_of,
    scores_of,
    sentence_of,
    unknown_lines,
)

__all__ = ["made_by", "percent", "render_diagnosis"]

#: Pairs of effects that are listed.
_PAIRS = 12


def made_by() -> str:
    """Versions of what made the page."""
    from importlib.metadata import version

    from offroad_env import __version__

    return (
        f"OffroadBekker {__version__}; Python {platform.python_version()}, NumPy {version('numpy')}, "
        f"Numba {version('numba')}, SciPy {version('scipy')}, {platform.system()} {platform.machine()}"
    )


def render_diagnosis(diagnosis: Diagnosis, evidence: Evidence, command: str) -> str:
    """The page as HTML text; parts that were not reached say why."""
    parts = (
        _verdict(diagnosis),
        _misfit(diagnosis, evidence),
        _dependence(diagnosis, evidence),
        _causes(diagnosis),
        _isolability(diagnosis),
        _gain(diagnosis, evidence),
        _prediction(diagnosis, evidence),
        _parameters(diagnosis, evidence),
        _next(diagnosis, evidence),
        _checks(diagnosis, evidence, command),
    )
    names = ", ".join(log.name for log in diagnosis.logs)
    return render_page(
        parts,
        title=f"{diagnosis.verdict}: {names}",
        intro=_runs(diagnosis),
        footer=f"{command} — {made_by()}",
    )


def _runs(diagnosis: Diagnosis) -> str:
    seconds = sum(log.duration for log in diagnosis.logs)
    runs = f"{len(diagnosis.logs)} runs" if len(diagnosis.logs) > 1 else "one run"
    hard = bool(diagnosis.logs) and diagnosis.logs[0].config.soil.rigid > 0.5
    fitted = "stiffnesses of its tyres" if hard else "n"
    return (
        f"What the simulation of {runs} ({seconds:.0f} s) gets wrong, what explains it, how sure that is, "
        "and what it gains. Errors are measured less simulated; the nominal model is the one that the log "
        f"states, with {fitted} fitted; the extended model has the causes in it."
    )


def _unreached(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "DATA PROBLEM":
        return "Not reached: the data must be mended before any model is blamed."
    if not diagnosis.causes:
        return "Nothing to show: no cause was named, so there is no extended model."
    return "Nothing to show: the runs are too short to keep a part that no fit has seen."


# ------------------------------------------------------------------ 1 to 3: what is wrong


def _verdict(diagnosis: Diagnosis) -> Section:
    rows = []
    for number, cause in enumerate(diagnosis.causes, 1):
        place = f"{number}" if cause in diagnosis.named else f"{number}, no name"
        for rival in cause.rivals:
            name = rival.candidate.effect
            low, high = (rival.size + side * 1.96 * rival.deviation for side in (-1.0, 1.0))
            chance = f"{cause.chance:.1g}" if cause.chance > 1e-99 else "< 1e-99"
            first = rival is cause.best
            rows.append(
                (
                    place if first else "or",
                    name,
                    figures.amount(name, rival.size),
                    f"{low:.3g} to {figures.amount(name, high)}",
                    f"{0.5 * cause.delta:.0f}" if first else f"{0.5 * rival.loss:.1f} less",
                    chance if first else "",
                )
            )
    heading = (
        "cause",
        "effect",
        "size",
        "95 % interval",
        "log-likelihood gained",
        "chance if none",
    )
    notes = [f"Finding: {finding.sentence}." for finding in diagnosis.findings]
    notes += [f"{line[0].upper()}{line[1:]}." for line in unknown_lines(diagnosis)]
    if not diagnosis.causes and diagnosis.limits:
        notes.append("What would have been seen stands in part 4, effect by effect.")
    return Section(
        name="verdict",
        title="Verdict",
        sees=figures.raised(sentence_of(diagnosis)),
        tables=(Table(heading=heading, rows=tuple(rows), texts=2),) if rows else (),
        notes=tuple(notes),
    )


def _misfit(diagnosis: Diagnosis, evidence: Evidence) -> Section:
    title, misfit = "What the simulation gets wrong", evidence.misfit
    if misfit is None:
        return Section(name="wrong", title=title, sees=_unreached(diagnosis))
    ratio = misfit.nominal / misfit.extended[:, :1]
    i, j = np.unravel_index(int(np.nanargmax(ratio)), ratio.shape)
    regime = "over the whole run" if j == 0 else f"while {misfit.regimes[j]}".replace("\n", " ")
    better = "the extended model" if diagnosis.causes else "the same model"
    sees = (
        f"The nominal simulation misses {misfit.channels[i]} most {regime}: its error is then "
        f"{ratio[i, j]:.1f} times what {better} leaves in that channel over the whole run."
    )
    extended = bool(diagnosis.causes)
    pictures = [
        figure_picture(
            figures.misfit_figure(misfit, extended=extended),
            "Error by channel and driving regime, in multiples of what is left in that channel over the "
            "whole run. 1 is noise; a moment may belong to several regimes.",
        )
    ]
    if misfit.worst:
        pictures.append(
            figure_picture(
                figures.worst_figure(misfit, extended=extended),
                f"The worst {WORST:.0f} s, in {misfit.worst_run}: the channels with the largest errors. "
                "Lines break where a window ends, because every window has a fitted start of its own.",
            )
        )
    notes = ("Windows of the search (part 10 says how the time is divided).",)
    return Section(name="wrong", title=title, sees=sees, pictures=tuple(pictures), notes=notes)


def _dependence(diagnosis: Diagnosis, evidence: Evidence) -> Section:
    title, misfit = "Error against state", evidence.misfit
    if misfit is None or not misfit.dependences:
        return Section(name="state", title=title, sees=_unreached(diagnosis))
    most = misfit.dependences[0]
    sees = (
        f"{most.channel} hangs on {most.quantity.split(' [')[0]} most: {100.0 * most.share:.0f} % of the "
        "variance of its error"
    )
    sees += (
        f", {100.0 * most.share_extended:.0f} % with the causes in the model." if diagnosis.causes else "."
    )
    picture = figure_picture(
        figures.dependence_figure(misfit, extended=bool(diagnosis.causes)),
        "Mean error in bins of equal counts, for every channel over the quantity that explains most of it. "
        "Bars hold all bins together in 95 % of cases; what lies in one second counts as one draw.",
    )
    return Section(name="state", title=title, sees=sees, pictures=(picture,))


# ------------------------------------------------------------------ 4 and 5: causes


def _causes(diagnosis: Diagnosis) -> Section:
    title, scores = "Causes", scores_of(diagnosis)
    if not scores:
        return Section(name="causes", title=title, sees=_unreached(diagnosis))
    threshold = float(diagnosis.checks["threshold"])
    above = [score.effect for score in scores if score.z > threshold]
    tested = sum(score.reason == "" for score in scores)
    sets = [[rival.candidate.effect for rival in cause.rivals] for cause in diagnosis.causes]
    sees = (
        f"{len(above)} of {tested} testable effects alone explain more than chance would; "
        f"{sum(map(len, sets))} {'is' if sum(map(len, sets)) == 1 else 'are'} needed."
    )
    if not above:
        sees = f"None of {tested} testable effects explains more than chance would."
    picture = figure_picture(
        figures.cause_figure(scores, threshold, sets),
        "Score of every effect against the nominal model, and from which size on it would be seen. Many look "
        "like the true cause; bold ones stand in the verdict, brackets tie those that explain the data as "
        "well. Grey: not testable, and why.",
    )
    return Section(name="causes", title=title, sees=sees, pictures=(picture,))


def _isolability(diagnosis: Diagnosis) -> Section:
    title = "What looks alike in these data"
    names, alike = isolability_of(diagnosis)
    if len(names) < 2:
        return Section(name="alike", title=title, sees=_unreached(diagnosis))
    upper = np.triu(np.abs(alike), 1)
    order = np.argsort(-upper, axis=None)[:_PAIRS]
    pairs = [np.unravel_index(int(i), upper.shape) for i in order]
    count = int(np.sum(upper >= 0.99))
    sees = (
        f"{count} of {len(names) * (len(names) - 1) // 2} pairs of effects can hardly be told apart by these "
        "data (|cosine| at least 0.99)."
    )
    picture = figure_picture(
        figures.isolability_figure(names, alike),
        "How alike two effects look once n, the starts and small sensor errors are fitted: 1 is the same "
        "trace. Circles from 0.9, full ones from 0.99.",
    )
    rows = [(f"{names[i]} and {names[j]}", f"{upper[i, j]:.3f}") for i, j in pairs]
    return Section(
        name="alike",
        title=title,
        sees=sees,
        pictures=(picture,),
        tables=(Table(heading=("most alike", "|cosine|"), rows=tuple(rows)),),
    )


# ------------------------------------------------------------------ 6 to 8: what it gains


def _gain(diagnosis: Diagnosis, evidence: Evidence) -> Section:
    title = "Gain on data that no fit has seen"
    if not diagnosis.gains:
        return Section(name="gain", title=title, sees=_unreached(diagnosis))
    best = max(diagnosis.gains, key=lambda gain: gain.low)
    channels = {gain.channel for gain in diagnosis.gains}
    sees = (
        f"The extended model lowers the error of {best.channel} by {100.0 * best.low:.0f} to "
        f"{100.0 * best.high:.0f} % (95 % interval), from {best.nominal:.3g} to {best.extended:.3g} "
        f"{figures.error_unit(best.channel, channels)}."
    )
    rows = []
    for gain, more in zip(diagnosis.gains, evidence.likelihood, strict=True):
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
    heading = ("channel", "unit", "nominal", "extended", "less by (95 %)", "log-likelihood more per second")
    picture = figure_picture(
        figures.gain_figure(diagnosis.gains, evidence.likelihood),
        "Root mean square error and log-likelihood of both models with 95 % intervals over blocks of a "
        "second. Blue: better; red: worse; grey: cannot be told.",
    )
    return Section(
        name="gain",
        title=title,
        sees=sees,
        pictures=(picture,),
        tables=(Table(heading=heading, rows=tuple(rows), texts=2),),
    )


def _prediction(diagnosis: Diagnosis, evidence: Evidence) -> Section:
    title, ground = "n and prediction", ground_of(diagnosis)
    if diagnosis.search is None:
        return Section(name="prediction", title=title, sees=_unreached(diagnosis))
    pictures, tables = [], []
    sees = _ground_sentence(diagnosis, ground)
    if ground is not None:
        caption = "n of the soil with 95 % intervals, if the model is right in all else."
        pictures.append(figure_picture(figures.ground_figure(ground), caption))
    if evidence.predictions:
        caption = (
            "Error of forecasts on the inputs alone, each started from one second of data, against position, "
            "speed and heading as measured: the sensors' own noise is in both."
        )
        figure = figures.prediction_figure(evidence.predictions, extended=bool(diagnosis.causes))
        pictures.append(figure_picture(figure, caption))
        tables.append(_prediction_table(diagnosis, evidence))
    return Section(name="prediction", title=title, sees=sees, pictures=tuple(pictures), tables=tuple(tables))


def percent(low: float, high: float) -> str:
    """An interval of shares in words."""
    # Adding zero makes no minus of it.
    return f"{round(100.0 * low) + 0} to {round(100.0 * high) + 0} %"


def _ground_sentence(diagnosis: Diagnosis, ground: dict[str, Any] | None) -> str:
    if ground is None:
        return "The ground is hard: there is no n."
    before, single = ground["before"], ground["single"]
    if single is None:
        values = [entry["value"] for entry in ground["after"].values()] or [before["value"]]
        return (
            f"No single n can be quoted: {before['value']:.3f} with the nominal model, {min(values):.3f} to "
            f"{max(values):.3f} with what explains the data, and something is open."
        )
    if not diagnosis.causes:
        return f"n = {single['value']:.3f} (95 %: {_span(single)})."
    return (
        f"n was {before['value']:.3f} with the nominal model and is {single['value']:.3f} "
        f"(95 %: {_span(single)}) with the causes in it."
    )


def _span(entry: dict[str, float]) -> str:
    return f"{entry['low']:.3f} to {entry['high']:.3f}"


def _prediction_table(diagnosis: Diagnosis, evidence: Evidence) -> Table:
    rows = []
    for one in evidence.predictions:
        known = np.isfinite(one.low)
        span = percent(one.low, one.high) if known else "too few for an interval"
        row = (f"{one.quantity}, {one.horizon:.0f} s", one.unit, str(one.count), f"{one.nominal:.3g}")
        rows.append((*row, f"{one.extended:.3g}", span) if diagnosis.causes else row)
    heading = ("error of", "unit", "forecasts", "nominal", "extended", "less by (95 %)")
    return Table(heading=heading if diagnosis.causes else heading[:4], rows=tuple(rows), texts=2)


def _parameters(diagnosis: Diagnosis, evidence: Evidence) -> Section:
    title = "Sizes of the causes"
    if not evidence.profiles:
        return Section(name="sizes", title=title, sees=_unreached(diagnosis))
    rows = []
    for profile in evidence.profiles:
        low, high = (profile.size + side * 1.96 * profile.deviation for side in (-1.0, 1.0))
        known = np.isfinite(profile.low) and np.isfinite(profile.high)
        rows.append(
            (
                profile.effect,
                figures.amount(profile.effect, profile.size),
                f"{profile.low:.3g} to {profile.high:.3g}" if known else "open",
                f"{low:.3g} to {high:.3g}",
            )
        )
    picture = figure_picture(
        figures.profile_figure(evidence.profiles),
        "What is lost when a size is held elsewhere and all else is fitted anew. Where the profile is the "
        "dashed parabola, the interval of the verdict holds; the dotted line marks 95 %.",
    )
    heading = ("effect", "size", "95 % by the profile", "95 % by the curvature")
    return Section(
        name="sizes",
        title=title,
        sees="Fitted together with n, the starts of the windows and the small errors of healthy sensors.",
        pictures=(picture,),
        tables=(Table(heading=heading, rows=tuple(rows)),),
    )


# ------------------------------------------------------------------ 9 and 10


def _next(diagnosis: Diagnosis, evidence: Evidence) -> Section:
    title, known, advice = "Next experiment", advice_of(diagnosis), evidence.advice
    if advice is None:
        sees = _sentence(known) if known else _unreached(diagnosis)
        return Section(name="next", title=title, sees=sees)
    if diagnosis.unexplained and known is not None:
        sees, notes = _sentence(known), (_sentence(advice.sentence),)
    else:
        sees, notes = _sentence(advice.sentence), (_sentence(f"or, {known}"),) if known else ()
    caption = (
        "What every manoeuvre of the menu would do if it were driven once and added to these data, by the "
        "fitted model and this log's sensors: "
    )
    caption += (
        "the chance that it settles the question."
        if advice.power is not None
        else "the smallest visible size of an effect, as a share of what it is now."
    )
    rows = [(trial.name, trial.sentence) for trial in advice.trials]
    return Section(
        name="next",
        title=title,
        sees=sees,
        pictures=(figure_picture(figures.menu_figure(advice), caption),),
        tables=(Table(heading=("manoeuvre", "what to do"), rows=tuple(rows), texts=2),),
        notes=notes,
    )


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _checks(diagnosis: Diagnosis, evidence: Evidence, command: str) -> Section:
    checks, rows = diagnosis.checks, []
    if diagnosis.search is not None:
        white = [one.channel for one in evidence.whiteness if not one.white]
        rows += [
            ("noise is white", f"all but {', '.join(white)}" if white else "in all channels"),
            ("half the solver's step moves a score by", f"{checks['solver']:.2g} standard deviations"),
            ("the nominal fit", "has converged" if checks["converged"] else "has not converged"),
            ("threshold of a score", f"{checks['threshold']:.2f} (from 20,000 draws, seed 2004)"),
            ("causes on the gate's windows", _gate(checks["gate"])),
            *((f"seconds for the {name}", f"{seconds:.1f}") for name, seconds in evidence.split.items()),
        ]
    rows += [
        ("seed of the intervals", str(SEED)),
        ("command", command),
        *((f"SHA-256 of {log.name}", log.hash) for log in diagnosis.logs),
    ]
    tables = [Table(heading=("check", "result"), rows=tuple(rows), texts=2)]
    if evidence.whiteness:
        heading = ("innovations", "samples", "memory", "spread", "largest correlation", "chance stays below")
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
        tables.append(Table(heading=heading, rows=lines))
    for report in evidence.quality:
        heading, lines = report.table()
        tables.append(Table(heading=tuple(heading), rows=tuple(tuple(line) for line in lines), texts=2))
    return Section(
        name="checks",
        title="Checks",
        sees="What the verdict rests on: noise, solver, division of the time, seeds, quality of the data.",
        tables=tuple(tables),
    )


def _gate(gains: list[float]) -> str:
    """What every effect of the search has gained on the gate's windows; the last may have been refused."""
    if not gains:
        return "nothing to try"
    return ", ".join(f"{gain:+.1f}" for gain in gains) + " in the log-likelihood"
