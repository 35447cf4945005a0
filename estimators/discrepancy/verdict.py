"""A diagnosis in words and as plain numbers: what the terminal, the JSON file and the report say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.discrepancy.diagnosis import OVERLAP, Diagnosis
from estimators.discrepancy.rig import RigRest
from estimators.discrepancy.search import Cause, Rival
from offroad_env.effects import EFFECTS

if TYPE_CHECKING:
    from estimators.discrepancy.evidence import Evidence
    from estimators.discrepancy.open_loop import Prediction

__all__ = [
    "Score", "advice_of", "amount", "extension_of", "ground_of", "isolability_of", "lines_of", "scores_of",
    "sentence_of", "to_dict", "unknown_lines",
]  # fmt: skip

_Z = 1.959964  #: of a 95 % interval
#: How to vary what one cannot vary alone.
_CHANGES = {
    "time": "drive the same line again, later",
    "position x": "drive the same ground the other way and at another speed",
    "position y": "drive the same ground the other way and at another speed",
}
#: Lines for the terminal, besides the names of the files.
_LINES = 21


@dataclass(frozen=True, kw_only=True)
class Score:
    """How strongly the nominal model's residuals ask for an effect."""

    effect: str
    z: float  #: standard deviations, over all its places
    limit: float  #: smallest size that would have been seen; infinite where nothing would
    reason: str  #: why these data cannot test it; empty where they can


def _interval(rival: Rival) -> tuple[float, float]:
    return rival.size - _Z * rival.deviation, rival.size + _Z * rival.deviation


def amount(effect: str, size: float) -> str:
    """A size of an effect with its unit."""
    return f"{size:.3g} {EFFECTS[effect].size.unit}".removesuffix(" -")


def _phrase(rival: Rival) -> str:
    effect = EFFECTS[rival.candidate.effect]
    low, high = _interval(rival)
    return f"{effect.describe(rival.size)} (95 %: {low:.3g} to {amount(effect.id, high)})"


def _doubt_phrase(diagnosis: Diagnosis) -> str:
    """Causes that do not stand on their own, after what is left; or nothing."""
    names = [" or ".join(rival.candidate.effect for rival in cause.rivals) for cause in diagnosis.causes]
    halves = [name for name, half in zip(names, diagnosis.halves, strict=True) if half]
    others = [
        name
        for name, half, stands in zip(names, diagnosis.halves, diagnosis.stands, strict=True)
        if not half and not stands
    ]
    phrase = f", which may also stand behind {', '.join(others)}" if others else ""
    if halves:
        phrase += f"; {', '.join(halves)} may be one cause that the library lacks: their sizes hang together"
    return phrase


def _cause_phrase(diagnosis: Diagnosis, cause: Cause) -> str:
    """A cause that the verdict names; where something is left, with its size beside unknown forces, too."""
    own = _beside_dict(diagnosis, diagnosis.causes.index(cause))
    first, *others = (_phrase(rival) for rival in cause.rivals)
    if own is not None:
        high = amount(cause.best.candidate.effect, own["high"])
        first += f", {own['low']:.3g} to {high} beside unknown forces"
    return "one of: " + "; or ".join([first, *others]) if others else first


def sentence_of(diagnosis: Diagnosis) -> str:
    """The verdict in one plain sentence."""
    verdict = diagnosis.verdict
    if verdict == "DATA PROBLEM":
        return f"The data must be mended first: {diagnosis.findings[0].sentence}."
    if verdict == "NUMERICS" and not diagnosis.checks.get("converged", True):
        return "The fit found no clean minimum: drive faster, or log positions."
    if verdict == "NUMERICS":
        return "The solver's own error is as large as what could be found: refine the step first."
    if verdict == "NOT TESTABLE":
        unseen = len(diagnosis.not_testable) + len(diagnosis.missing)
        total = len(diagnosis.limits) + len(diagnosis.missing)
        return f"These data cannot tell: {unseen} of {total} effects would stay unseen at any plausible size."
    if verdict == "NO EFFECT":
        seen = len(diagnosis.limits) - len(diagnosis.not_testable)
        return f"Nothing is wrong that these data could show; {seen} effects were tested."
    if verdict == "UNEXPLAINED":
        rest = f"{_rest_phrase(diagnosis)}{_doubt_phrase(diagnosis)}"
        return f"Something is wrong that no effect of the library explains: {rest}."
    causes = "; and ".join(_cause_phrase(diagnosis, cause) for cause in diagnosis.named)
    sentence = causes[0].upper() + causes[1:]
    if verdict == "NAMED + UNEXPLAINED REST":
        sentence += f"; and something is left: {_rest_phrase(diagnosis)}{_doubt_phrase(diagnosis)}"
    elif diagnosis.checks.get("overlap", 0.0) > OVERLAP:
        sentence += "; or one cause behind these, which the library lacks: their traces overlap"
    return sentence + "."


def _rest_phrase(diagnosis: Diagnosis) -> str:
    if not diagnosis.unexplained:
        return "what would explain it in one part of the run makes another part worse"
    rest = max(diagnosis.unexplained, key=lambda one: one.excess)
    size = float(np.sqrt(max(np.average(rest.force**2, weights=1.0 / rest.deviation**2), 0.0)))
    if isinstance(rest, RigRest):
        phrase = f"about {size:.3g} {rest.unit} of the {rest.equation.replace('_', ' ')}"
    else:
        unit = "N m" if rest.equation == "yaw" else "N"
        phrase = f"a force of about {size:.3g} {unit} in the {rest.equation} equation"
    if rest.shapes and abs(rest.shapes[0].correlation) > 0.5:
        shape = rest.shapes[0]
        phrase += f" that follows the {shape.quantity.split(' [')[0]} (correlation {shape.correlation:.2f})"
    return phrase


def advice_of(diagnosis: Diagnosis) -> str | None:
    """What to do next, from what the library knows of its effects; what is unexplained comes first."""
    if diagnosis.unexplained:
        rest = max(diagnosis.unexplained, key=lambda one: one.excess)
        if rest.shapes:
            quantity = rest.shapes[0].quantity.split(" [")[0]
            how = _CHANGES.get(quantity, f"vary the {quantity} alone")
            return f"to learn what is left: {how}; the unnamed force follows the {quantity} most"
    for cause in diagnosis.causes:
        if len(cause.rivals) > 1:
            names = " from ".join(rival.candidate.effect for rival in cause.rivals[:2])
            advice = [EFFECTS[rival.candidate.effect].separated_by for rival in cause.rivals]
            return f"to tell {names}: {next((text for text in advice if text), 'another manoeuvre')}"
    if diagnosis.verdict == "NOT TESTABLE":
        return "drive with steering, acceleration and braking, and log position or speed over ground"
    return None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _beside_dict(diagnosis: Diagnosis, k: int) -> dict[str, float] | None:
    """What becomes of a cause when forces without a name are fitted beside it."""
    if diagnosis.beside is None:
        return None
    own = diagnosis.beside
    size, reach = float(own.sizes[k]), _Z * float(own.deviations[k])
    return {
        "value": size,
        "low": size - reach,
        "high": size + reach,
        "kept": float(own.kept[k]),
        "alike": float(own.alike[k].max()),
    }


def _cause_dict(diagnosis: Diagnosis, k: int) -> dict[str, Any]:
    cause = diagnosis.causes[k]
    best = cause.best
    effect = EFFECTS[best.candidate.effect]
    low, high = _interval(best)
    parameters = {effect.size.name: {"value": best.size, "low": low, "high": high, "unit": effect.size.unit}}
    for other in effect.others:
        value = best.candidate.place[other.name]
        parameters[other.name] = {"value": value, "low": None, "high": None, "unit": other.unit}
    return {
        "set": [rival.candidate.effect for rival in cause.rivals],
        "parameters": parameters,
        "p": cause.chance,
        "delta_loglik": 0.5 * cause.delta,
        "named": cause in diagnosis.named,
        "beside_unknown_forces": _beside_dict(diagnosis, k),
        "members": [
            {
                "effect": rival.candidate.effect,
                "size": rival.size,
                "deviation": rival.deviation,
                "lacks_loglik": 0.5 * rival.loss,
                "sentence": EFFECTS[rival.candidate.effect].describe(rival.size),
            }
            for rival in cause.rivals
        ],
    }


def scores_of(diagnosis: Diagnosis) -> list[Score]:
    """All effects that were looked for, strongest first, then those that these data cannot test."""
    if diagnosis.search is None:
        return []
    first, vehicle = diagnosis.search.first, diagnosis.search.nominal.runs[0].setup.plant.vehicle
    strongest: dict[str, float] = {}
    for candidate, z in zip(first.candidates, np.abs(first.z), strict=True):
        strongest[candidate.effect] = max(strongest.get(candidate.effect, 0.0), float(z))
    found = []
    for name, z in strongest.items():
        limit, reason = diagnosis.limits[name], ""
        if not math.isfinite(limit):
            reason = "these drives do not excite it"
        elif name in diagnosis.not_testable:
            most = amount(name, EFFECTS[name].plausible(vehicle))
            reason = f"would show from {amount(name, limit)} on only; more than {most} is not plausible"
        found.append(Score(effect=name, z=z, limit=limit, reason=reason))
    for name, channels in diagnosis.missing.items():
        found.append(Score(effect=name, z=0.0, limit=math.inf, reason=f"the log has no {channels}"))
    for name, what in diagnosis.unjudged.items():
        found.append(Score(effect=name, z=0.0, limit=math.inf, reason=f"the log does not know {what}"))
    return sorted(found, key=lambda score: (score.reason != "", -score.z))


def isolability_of(diagnosis: Diagnosis) -> tuple[list[str], np.ndarray]:
    """Effects that the data see, and how alike each two look (E, E): cosines of their whitened traces."""
    if diagnosis.search is None:
        return [], np.empty((0, 0))
    return diagnosis.search.first.by_effect()


def _ground_entry(value: float, deviation: float) -> dict[str, float]:
    low, high = value - _Z * deviation, value + _Z * deviation
    return {"value": float(value), "deviation": float(deviation), "low": float(low), "high": float(high)}


def ground_of(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """n of the soil before and after, under every member of every set; None on hard ground.

    ``single`` is the one value that may be quoted: None where a cause that explains the data as well puts n
    outside the interval that the best gives.
    """
    if diagnosis.search is None:
        return None
    nominal = diagnosis.search.nominal
    soil = nominal.runs[0].setup.plant.soil
    if soil.rigid > 0.5:
        return None
    after = {
        rival.candidate.effect: _ground_entry(soil.n + rival.ground, rival.ground_deviation)
        for cause in diagnosis.causes
        for rival in cause.rivals
    }
    before = _ground_entry(soil.n + nominal.nuisances[0], nominal.deviations()[0])
    best = after[diagnosis.causes[0].best.candidate.effect] if diagnosis.causes else before
    agreed = all(best["low"] <= entry["value"] <= best["high"] for entry in after.values())
    return {
        "prior": float(soil.n),
        "before": before,
        "after": after,
        "single": best if agreed and not diagnosis.doubtful else None,
    }


def to_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """The verdict and its numbers as JSON takes them."""
    advice = advice_of(diagnosis)
    rest = [
        {
            "equation": one.equation,
            "p": one.chance,
            "shape": [
                {"quantity": s.quantity, "correlation": s.correlation, "slope": s.slope}
                for s in one.shapes[:3]
            ],
        }
        for one in diagnosis.unexplained
    ]
    return {
        "verdict": diagnosis.verdict,
        "sentence": sentence_of(diagnosis),
        "causes": [_cause_dict(diagnosis, k) for k in range(len(diagnosis.causes))],
        "unexplained": rest or None,
        "not_testable": {name: _finite(limit) for name, limit in diagnosis.not_testable.items()},
        "missing_channels": diagnosis.missing,
        "not_judged": diagnosis.unjudged,
        "limits": {name: _finite(limit) for name, limit in diagnosis.limits.items()},
        "gain": {
            gain.channel: {
                "nominal": gain.nominal,
                "extended": gain.extended,
                "low": gain.low,
                "high": gain.high,
            }
            for gain in diagnosis.gains
        },
        "n": ground_of(diagnosis),
        "next_experiment": None if advice is None else {"sentence": advice},
        "checks": {
            **diagnosis.checks,
            "noise_memory": _memory(diagnosis),
            "findings": [finding.sentence for finding in diagnosis.findings],
            "logs": {log.name: log.hash for log in diagnosis.logs},
        },
    }


def _memory(diagnosis: Diagnosis) -> dict[str, int] | None:
    """How many samples the noise of each channel remembers."""
    if diagnosis.search is None:
        return None
    return {name: noise.order for name, noise in diagnosis.model.whitener.noise.items()}


def lines_of(diagnosis: Diagnosis, evidence: Evidence | None = None) -> list[str]:
    """The summary for a terminal: with the names of the files that follow it, at most 25 lines."""
    lines = [f"{diagnosis.verdict}: {sentence_of(diagnosis)}"]
    for cause in diagnosis.causes:
        what = "cause" if cause in diagnosis.named else "no name yet, something unknown may stand behind it"
        lines.append(
            f"{what}, gains {0.5 * cause.delta:.0f} in the log-likelihood, chance {cause.chance:.1g}:"
        )
        lines += [f"  {rival.candidate.effect}: {_phrase(rival)}" for rival in cause.rivals[:4]]
    lines += _ground_lines(diagnosis)
    gains = sorted(diagnosis.gains, key=lambda gain: -(1.0 - gain.extended / max(gain.nominal, 1e-300)))
    for gain in gains[:4]:
        lines.append(
            f"on unseen data {gain.channel}: {gain.nominal:.3g} -> {gain.extended:.3g} "
            f"({100.0 * gain.low:.0f} to {100.0 * gain.high:.0f} % less)"
        )
    advice = advice_of(diagnosis)
    if evidence is not None:
        lines += _prediction_lines(evidence, causes=bool(diagnosis.causes))
        if evidence.advice is not None and (advice is None or not diagnosis.unexplained):
            advice = evidence.advice.sentence
    lines += [f"finding: {finding.sentence}" for finding in diagnosis.findings[:6]]
    if diagnosis.not_testable:
        lines.append(f"not testable with these data: {', '.join(diagnosis.not_testable)}")
    if diagnosis.missing:
        lines.append(f"no channel for: {', '.join(diagnosis.missing)}")
    lines += unknown_lines(diagnosis)
    last = [] if advice is None else [f"next experiment: {advice}"]
    return [*lines[: _LINES - len(last)], *last]


def unknown_lines(diagnosis: Diagnosis) -> list[str]:
    """What the log does not know: effects that are not judged, and what was fitted instead."""
    lines = []
    if diagnosis.unjudged:
        lines.append(f"not judged, since the log knows too little: {', '.join(diagnosis.unjudged)}")
    fitted = diagnosis.checks.get("unknowns", {})
    if fitted:
        parts = [
            f"{name} {of['value']:.3f} ± {of['deviation']:.3f} {of['unit']}" for name, of in fitted.items()
        ]
        lines.append(f"fitted instead: {', '.join(parts)}")
    return lines


def _ground_lines(diagnosis: Diagnosis) -> list[str]:
    ground = ground_of(diagnosis)
    if ground is None or not diagnosis.causes:
        return []
    after = ", ".join(f"{entry['value']:.3f} with {name}" for name, entry in ground["after"].items())
    lines = [f"n: {ground['prior']:.3f} stated, {ground['before']['value']:.3f} before; {after}"]
    if ground["single"] is None:
        lines.append("n: no single value can be quoted, the explanations differ")
    return lines


def _prediction_lines(evidence: Evidence, *, causes: bool) -> list[str]:
    """The longest forecasts of every quantity in one line."""
    longest: dict[str, Prediction] = {}
    for one in evidence.predictions:
        longest[one.quantity] = one
    parts = [
        f"{one.quantity} {one.nominal:.3g}{f' -> {one.extended:.3g}' if causes else ''} {one.unit}"
        for one in longest.values()
    ]
    if not parts:
        return []
    horizon = next(iter(longest.values())).horizon
    return [f"error after {horizon:.0f} s alone: {', '.join(parts)}"]


def extension_of(diagnosis: Diagnosis) -> list[tuple[str, dict[str, float]]]:
    """Effects of the extended model with their parameters, as `offroad_env.effects.apply` takes them."""
    if not diagnosis.causes:
        return []
    fit = diagnosis.model
    pairs = zip(fit.candidates, fit.sizes, strict=True)
    return [(candidate.effect, candidate.values(float(size))) for candidate, size in pairs]
