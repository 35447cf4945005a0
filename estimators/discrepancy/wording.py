"""A diagnosis in sentences: the verdict, the advice and the lines of the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.discrepancy.checks.forecast import Prediction
from estimators.discrepancy.search.stepwise import MOST
from estimators.discrepancy.stopping import Stop
from estimators.discrepancy.structure_comparison import ADEQUATE, StructureComparison
from estimators.discrepancy.summary import CauseSummary, DiagnosisSummary, UnknownInput, UnknownInputShape
from estimators.discrepancy.verdict import (
    NOMINAL,
    OVERLAP,
    SEARCH,
    Diagnosis,
    RigDiagnosis,
    VehicleDiagnosis,
    Verdict,
)
from estimators.logs.immobile_findings import IMMOBILE
from estimators.replay.replay import CHANNELS
from offroad_env.effects import EFFECTS
from offroad_env.effects.protocol import Effect

__all__ = [
    "advice_sentence",
    "amount",
    "correlation_phrase",
    "interval_text",
    "limitation_sentences",
    "open_points",
    "structure_lines",
    "structure_sentence",
    "terminal_lines",
    "verdict_sentence",
]

#: How to vary a quantity that cannot be varied alone.
_CHANGES = {
    "time": "drive the same line again, later",
    "position x": "drive the same ground the other way and at another speed",
    "position y": "drive the same ground the other way and at another speed",
}
#: Structural cause -> what the wheel does that the log's model does not.
_STRUCTURES = {
    "pressure_distribution": "the pressure follows the own sinkage of every rim point, not Wong-Reece angles",
    "pressure_direction": "the pressure acts along the undeformed ground's normal, not the rim's",
    "soil_frame_shear": "shear displacement follows a point's path in the soil, not in the wheel's frame",
    "shear_strengths": "the shear stresses along and across the wheel have a strength each",
    "effective_width": "the soil bears over the width of the contact's hull, not of the rim",
}
#: Correlation from which an unknown input is said to depend on a quantity.
_CORRELATED = 0.5
#: Rests by channel and regime that a page notes.
_RESTS = 2
#: What may stop a vehicle in words; the rest by name.
_STOPPERS = 4
#: Lines for the terminal, besides the names of the files.
_LINES = 21


def amount(effect: str, size: float) -> str:
    """A size of an effect with its unit."""
    return f"{size:.3g} {EFFECTS[effect].size.unit}".removesuffix(" -")


def interval_text(effect: Effect, low: float, high: float) -> str:
    """An interval of sizes with its unit, by the sign and in the unit of the sentence for its middle."""
    _, sign = effect.wording(0.5 * (low + high))
    first, last = sorted((sign * low, sign * high))
    if effect.amount(1.0).endswith("%"):
        return f"{100.0 * first:.3g} to {effect.amount(last)}"
    return f"{first:.3g} to {effect.amount(last)}"


# ------------------------------------------------------------------ the verdict


def verdict_sentence(
    verdict: Verdict,
    diagnosis: Diagnosis,
    causes: Sequence[CauseSummary] = (),
    unexplained: Sequence[UnknownInput] = (),
) -> str:
    """The verdict on a diagnosis in one plain sentence."""
    if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.restructured is not None:
        return _structure_sentence(diagnosis.restructured, diagnosis.stand_ins)
    if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.beyond_structures is not None:
        return _beyond_sentence(diagnosis.beyond_structures)
    if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.only_stopped:
        return " ".join(_stop_sentence(stop) for stop in diagnosis.stops)
    if verdict is Verdict.UNEXPLAINED:
        rest = _discrepancy_phrase(diagnosis, causes, unexplained)
        return f"The model is wrong in a way that no effect of the library explains: {rest}."
    if verdict in (Verdict.NAMED, Verdict.ONE_OF, Verdict.NAMED_WITH_REST):
        named = "; and ".join(_cause_phrase(cause) for cause in causes if cause.named)
        sentence = named[0].upper() + named[1:]
        if verdict is Verdict.NAMED_WITH_REST:
            sentence += f"; and a discrepancy remains: {_discrepancy_phrase(diagnosis, causes, unexplained)}"
        elif isinstance(diagnosis, VehicleDiagnosis) and diagnosis.overlapping:
            sentence += "; or a single cause that the library lacks: their sizes are correlated"
        if isinstance(diagnosis, VehicleDiagnosis) and any(diagnosis.inadequate):
            sentence += f"; or another law of the same cause: {_rest_phrase(diagnosis)}"
        if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.rivalled:
            sentence += "; or laws of wheel and soil that were not tried: another structure predicts as well"
        return sentence + "."
    return _sentence_without_causes(verdict, diagnosis)


def _rest_phrase(diagnosis: VehicleDiagnosis) -> str:
    """The largest rest that takes the certainty from a cause."""
    wrong = [k for k, one in enumerate(diagnosis.inadequate) if one]
    rest = next(r for r in diagnosis.significant_rests if any(r.alike[k] > OVERLAP for k in wrong))
    return f"what remains of {rest.channel} ({rest.regime}) resembles it and is not noise"


def _structure_sentence(found: StructureComparison, effects: Sequence[str]) -> str:
    parts = "; ".join(cause.sentence for cause in found.causes)
    sentence = (
        f"The structure of the model is wrong: {parts}. With another one the errors of predictions fall by "
        f"{100.0 * found.gain:.0f} % on windows to which nothing was fitted."
    )
    if found.tied:
        sentence += (
            f" Or its numbers are: {', '.join(effects)} together predict as well as another structure."
        )
    return sentence


def _beyond_sentence(found: StructureComparison) -> str:
    left = zip(found.best.channels(), found.best.pooled, strict=True)
    errors = ", ".join(f"{value:.2g} {CHANNELS[name]} in {name}" for name, value in left if value is not None)
    return (
        "The structure of the model is wrong, and no other one that was tried predicts the runs: the best "
        f"leaves {errors} within 3 s. Are torques, mass and soil as stated, and is the ground soil at all?"
    )


def structure_lines(summary: DiagnosisSummary) -> list[str]:
    """The other structure in lines: its causes, its n, what it gains and what is as good."""
    found = summary.comparison
    if found is None or not found.found:
        return []
    lines = [
        f"cause: {cause.id}: {cause.sentence} (errors grow by {100.0 * cause.gain:.0f} % without it)"
        for cause in found.causes
        if found.adequate
    ]
    case = found.best.case
    if not found.adequate:
        lines.append(f"errors over those of a right structure: {found.misfit:.1f} (named up to {ADEQUATE:g})")
    lines.append(f"structure: {case.structure}, vehicle model {case.vehicle_model}, n {found.n:.3f}")
    lines += [f"as good: {one.structure}, vehicle model {one.vehicle_model}" for one in found.equals]
    lines += [
        f"error within 3 s, {gain.channel}: {gain.nominal:.3g} -> {gain.extended:.3g} "
        f"({100.0 * gain.low:.0f} to {100.0 * gain.high:.0f} % less)"
        for gain in found.gains
    ]
    if summary.stand_ins and found.tied:
        lines.append(f"as good: the nominal structure with {', '.join(summary.stand_ins)}")
    elif summary.stand_ins:
        lines.append(f"not judged within the wrong structure: {', '.join(summary.stand_ins)}")
    return lines


def _sentence_without_causes(verdict: Verdict, diagnosis: Diagnosis) -> str:
    if verdict is Verdict.DATA_PROBLEM:
        return f"The data must be corrected first: {diagnosis.findings[0].sentence}."
    if verdict is Verdict.OUTSIDE:
        sentence = diagnosis.findings[0].sentence
        if diagnosis.findings[0].kind == IMMOBILE:
            stops = diagnosis.stops if isinstance(diagnosis, VehicleDiagnosis) else ()
            more = [f" {_stop_sentence(stop)}" for stop in stops]
            return "".join([f"There is no drive to diagnose: {sentence}.", *more])
        return f"No model of this kind can be right: {sentence}"
    if verdict is Verdict.NUMERICS:
        for section in (NOMINAL, SEARCH):
            if section in diagnosis.failed:
                return f"The {section} breaks down on these runs: {diagnosis.failed[section]}."
        if diagnosis.checks is not None and not diagnosis.checks.converged:
            return "The fit did not converge: drive faster, or log positions."
        return "The error of the solver is as large as the effects sought: refine the step first."
    total = len(diagnosis.limits) + len(diagnosis.missing)
    if verdict is Verdict.NOT_TESTABLE:
        untestable = len(diagnosis.not_testable) + len(diagnosis.missing)
        return (
            f"These data are not informative enough: {untestable} of {total} effects would remain undetected "
            "at any plausible size."
        )
    testable = len(diagnosis.limits) - len(diagnosis.not_testable)
    return f"No error of the model is detected; {testable} effects were testable."


def _stop_sentence(stop: Stop) -> str:
    """What may hold a vehicle that is stuck and would drive off as stated."""
    sentence = (
        f"Where the vehicle is stuck, from t = {stop.begin:.1f} s on, it would drive off as stated, at "
        f"{stop.speed:.1f} m/s after 3 s, and at {stop.least:.1f} m/s with mass and soil at the unfavourable "
        "ends of their tolerances"
    )
    if not stop.effects:
        return f"{sentence}; no effect of the library alone holds it: is the soil softer there?"
    held = "; or ".join(EFFECTS[name].describe(size) for name, size in stop.effects[:_STOPPERS])
    others = [name.replace("_", " ") for name, _ in stop.effects[_STOPPERS:]]
    more = f"; or another {' or '.join(others)}" if others else ""
    return f"{sentence}. What may hold it, from this size on: {held}{more}; or soil that is softer there."


def structure_sentence(laws: Sequence[str]) -> str:
    """What the wheel does under these structural causes."""
    return ", and ".join(_STRUCTURES[law] for law in laws) or "the laws of the log's own model"


def _cause_phrase(cause: CauseSummary) -> str:
    """A cause that the verdict names; its size with unknown inputs fitted jointly, where they are present."""
    first, *others = (member.phrase for member in cause.members)
    if cause.joint is not None:
        interval = interval_text(EFFECTS[cause.best.effect], cause.joint.low, cause.joint.high)
        first += f", {interval} with unknown inputs fitted jointly"
    if not others:
        return first
    # One family: that is certain, and only the variant is not.
    family = f"{cause.families[0]}, " if len(cause.families) == 1 else ""
    return f"{family}one of: " + "; or ".join([first, *others])


def _discrepancy_phrase(
    diagnosis: Diagnosis, causes: Sequence[CauseSummary], unexplained: Sequence[UnknownInput]
) -> str:
    """What the causes leave, and the causes that are confounded with it or with each other."""
    phrase = "effects that improve the fit in one part of the runs make it worse in another"
    if isinstance(diagnosis, RigDiagnosis):
        phrase = "no effect of a physical size explains it on the conditions of the hold-out test, too"
    elif diagnosis.search is not None and diagnosis.search.capped:
        phrase = f"more effects are significant than the {MOST} that one model holds"
    elif diagnosis.search is not None and diagnosis.search.strayed:
        moved = ", ".join(name.replace("_", " ") for name in diagnosis.search.strayed)
        phrase = f"numbers would have to lie beyond any tolerance of theirs ({moved})"
    if unexplained:
        phrase = _largest(unexplained).phrase
    if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.misled:
        phrase = _misled_phrase(diagnosis)
    effects = [cause.best.effect for cause in causes if not cause.structural]
    impossible = [
        effect for effect, possible in zip(effects, diagnosis.physical, strict=True) if not possible
    ]
    if impossible:
        phrase += f"; {', '.join(impossible)} would explain it with a size that physics does not allow"
    names = [" or ".join(cause.effects) for cause in causes if not cause.structural]
    confounded = diagnosis.confounded
    mutually = [name for name, one in zip(names, confounded, strict=True) if one]
    with_inputs = [
        name
        for name, one, identifiable in zip(names, confounded, diagnosis.identifiable, strict=True)
        if not one and not identifiable and name not in impossible
    ]
    if with_inputs:
        phrase += f", confounded with {', '.join(with_inputs)}"
    if mutually:
        phrase += (
            f"; {', '.join(mutually)} may be one cause that the library lacks: their sizes are correlated"
        )
    return phrase


def _misled_phrase(diagnosis: VehicleDiagnosis) -> str:
    """The forecast by which the causes are refuted most clearly."""
    if diagnosis.worsened:
        worst = max(diagnosis.worsened, key=lambda one: one.extended / max(one.nominal, 1e-300))
        return (
            f"what improves the fit makes forecasts worse (error of the {worst.quantity} after "
            f"{worst.horizon:.0f} s: {worst.nominal:.3g} -> {worst.extended:.3g} {worst.unit})"
        )
    worst = diagnosis.unpredicted[-1]
    return (
        f"the model predicts the speed after {worst.horizon:.0f} s with an error of {worst.extended:.3g} "
        "m/s, with or without effects, where a speed that stays as it is errs by "
        f"{worst.kept:.3g} m/s: are the torques those of the wheels, mass and soil as stated?"
    )


def _largest(unexplained: Sequence[UnknownInput]) -> UnknownInput:
    return max(unexplained, key=lambda one: one.excess)


def correlation_phrase(shapes: Sequence[UnknownInputShape]) -> str:
    """The quantity that an unknown input is correlated with most; empty where the correlation is weak."""
    if not shapes or abs(shapes[0].correlation) <= _CORRELATED:
        return ""
    quantity = shapes[0].quantity.split(" [")[0]
    return f", correlated with the {quantity} (r = {shapes[0].correlation:.2f})"


# ------------------------------------------------------------------ advice


def advice_sentence(
    verdict: Verdict, causes: Sequence[CauseSummary], unexplained: Sequence[UnknownInput]
) -> str | None:
    """What to do next by rule; what is unexplained comes first. None where there is nothing to advise."""
    if unexplained and _largest(unexplained).shapes:
        quantity = _largest(unexplained).shapes[0].quantity.split(" [")[0]
        how = _CHANGES.get(quantity, f"vary the {quantity} alone")
        return (
            f"to identify the remaining discrepancy: {how}; the unknown input is correlated most with "
            f"the {quantity}"
        )
    for cause in causes:
        if len(cause.members) > 1:
            names = " from ".join(cause.effects[:2])
            advice = (EFFECTS[name].separated_by for name in cause.effects if name in EFFECTS)
            return f"to distinguish {names}: {next((text for text in advice if text), 'another manoeuvre')}"
    if verdict is Verdict.NOT_TESTABLE:
        return "drive with steering, acceleration and braking, and log position or speed over ground"
    return None


def limitation_sentences(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Effects that are not judged, and what was fitted in their place."""
    lines = []
    if diagnosis.not_judged:
        names = ", ".join(diagnosis.not_judged)
        lines.append(f"not judged, because the logs state too much as unknown: {names}")
    if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.checks is not None and diagnosis.checks.unknowns:
        parts = [
            f"{name} {of['value']:.3f} ± {of['deviation']:.3f} {of['unit']}"
            for name, of in diagnosis.checks.unknowns.items()
        ]
        lines.append(f"fitted instead: {', '.join(parts)}")
    if isinstance(diagnosis, VehicleDiagnosis) and diagnosis.search is not None:
        stops = () if diagnosis.only_stopped else diagnosis.stops
        lines += [_stop_sentence(stop).removesuffix(".") for stop in stops]
    return tuple(lines)


def open_points(summary: DiagnosisSummary) -> list[str]:
    """What the causes leave beyond noise, the largest first, and the sections that could not be computed."""
    rests = [
        f"Not noise: what the causes leave of {rest.channel} ({rest.regime}), {abs(rest.z):.1f} standard "
        "deviations."
        for rest in summary.rests[:_RESTS]
    ]
    return rests + [f"Missing: {section} ({why})." for section, why in summary.failed.items()]


# ------------------------------------------------------------------ the terminal


def terminal_lines(summary: DiagnosisSummary) -> list[str]:
    """The summary for a terminal: with the names of the files that follow it, at most 25 lines."""
    lines = [f"{summary.verdict}: {summary.sentence}"]
    lines += [f"missing: {section}: {why}" for section, why in summary.failed.items()]
    lines += structure_lines(summary)
    for cause in summary.causes:
        what = "cause" if cause.named else "candidate, confounded with a discrepancy that remains"
        family = f" ({' or '.join(cause.families)})" if cause.families else ""
        lines.append(
            f"{what}{family}: log-likelihood gain {cause.delta_loglik:.0f}, p-value {cause.p_value:.1g}"
        )
        lines += [f"  {member.effect}: {member.phrase}" for member in cause.members[:4]]
    lines += _exponent_lines(summary)
    lines += _gain_lines(summary)
    lines += _forecast_lines(summary)
    lines += [f"finding: {finding}" for finding in summary.findings[:6]]
    if summary.not_testable:
        lines.append(f"not testable with these data: {', '.join(summary.not_testable)}")
    if summary.missing_channels:
        lines.append(f"no channel for: {', '.join(summary.missing_channels)}")
    lines += summary.limitations
    advice = summary.next_experiment
    last = [] if advice is None else [f"next experiment: {advice.sentence}"]
    return [*lines[: _LINES - len(last)], *last]


def _exponent_lines(summary: DiagnosisSummary) -> list[str]:
    n = summary.n
    if n is None or not summary.causes:
        return []
    after = ", ".join(f"{entry.value:.3f} with {name}" for name, entry in n.after.items())
    lines = [f"n: {n.prior:.3f} stated, {n.before.value:.3f} with the nominal model; {after}"]
    if (wide := n.wide) is not None:
        lines.append(
            f"n: {wide.value:.2f}, {wide.low:.2f} to {wide.high:.2f} (95 %) with slip angles left out in turn"
        )
    if n.single is None:
        lines.append("n: no single value can be quoted, the explanations differ")
    return lines


def _gain_lines(summary: DiagnosisSummary) -> list[str]:
    gains = sorted(summary.gains, key=lambda gain: -(1.0 - gain.extended / max(gain.nominal, 1e-300)))
    return [
        f"error on test data, {gain.channel}: {gain.nominal:.3g} -> {gain.extended:.3g} "
        f"({100.0 * gain.low:.0f} to {100.0 * gain.high:.0f} % less)"
        for gain in gains[:4]
    ]


def _forecast_lines(summary: DiagnosisSummary) -> list[str]:
    """The longest forecasts of every quantity in one line."""
    if summary.evidence is None or not summary.evidence.predictions:
        return []
    longest: dict[str, Prediction] = {}
    for one in summary.evidence.predictions:
        longest[one.quantity] = one
    parts = [
        f"{one.quantity} {one.nominal:.3g}{f' -> {one.extended:.3g}' if summary.extended else ''} {one.unit}"
        for one in longest.values()
    ]
    horizon = next(iter(longest.values())).horizon
    return [f"error of a forecast over {horizon:.0f} s: {', '.join(parts)}"]
