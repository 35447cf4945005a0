"""A diagnosis in words and as plain numbers: what the terminal, the JSON file and the report say."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from estimators.discrepancy.diagnosis import Diagnosis
from estimators.discrepancy.rig import RigRest
from estimators.discrepancy.search import Cause, Rival
from offroad_env.effects import EFFECTS

__all__ = ["extension_of", "lines_of", "next_experiment", "sentence_of", "to_dict"]

_Z = 1.959964  #: of a 95 % interval


def _interval(rival: Rival) -> tuple[float, float]:
    return rival.size - _Z * rival.deviation, rival.size + _Z * rival.deviation


def _phrase(rival: Rival) -> str:
    effect = EFFECTS[rival.candidate.effect]
    low, high = _interval(rival)
    unit = "" if effect.size.unit == "-" else f" {effect.size.unit}"
    return f"{effect.describe(rival.size)} (95 %: {low:.3g} to {high:.3g}{unit})"


def _cause_phrase(cause: Cause) -> str:
    if len(cause.rivals) == 1:
        return _phrase(cause.best)
    return "one of: " + "; or ".join(_phrase(rival) for rival in cause.rivals)


def sentence_of(diagnosis: Diagnosis) -> str:
    """The verdict in one plain sentence."""
    verdict = diagnosis.verdict
    if verdict == "DATA PROBLEM":
        return f"The data must be mended first: {diagnosis.findings[0].sentence}."
    if verdict == "NUMERICS" and not diagnosis.checks.get("converged", True):
        return "The fit of the nominal model found no clean minimum: drive faster, or log positions."
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
        return f"Something is wrong that no effect of the library explains: {_rest_phrase(diagnosis)}."
    causes = "; and ".join(_cause_phrase(cause) for cause in diagnosis.causes)
    sentence = causes[0].upper() + causes[1:]
    if verdict == "NAMED + UNEXPLAINED REST":
        sentence += f"; and something is left: {_rest_phrase(diagnosis)}"
    return sentence + "."


def _rest_phrase(diagnosis: Diagnosis) -> str:
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


def next_experiment(diagnosis: Diagnosis) -> str | None:
    """What to drive next, from what the library knows of its effects."""
    for cause in diagnosis.causes:
        if len(cause.rivals) > 1:
            names = " from ".join(rival.candidate.effect for rival in cause.rivals[:2])
            advice = [EFFECTS[rival.candidate.effect].separated_by for rival in cause.rivals]
            return f"to tell {names}: {next((text for text in advice if text), 'another manoeuvre')}"
    if diagnosis.verdict == "NOT TESTABLE":
        return "drive with steering, acceleration and braking, and log position or speed over ground"
    if diagnosis.verdict == "UNEXPLAINED" and diagnosis.unexplained:
        rest = max(diagnosis.unexplained, key=lambda one: one.excess)
        if rest.shapes:
            return (
                f"vary the {rest.shapes[0].quantity.split(' [')[0]} alone: the unnamed force follows it most"
            )
    return None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _cause_dict(cause: Cause) -> dict[str, Any]:
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


def _ground(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """n of the soil before and after, under every member of every set; None on hard ground."""
    if diagnosis.search is None:
        return None
    nominal = diagnosis.search.nominal
    soil = nominal.runs[0].setup.plant.soil
    if soil.rigid > 0.5:
        return None
    before = float(soil.n + nominal.nuisances[0])
    after = {
        f"{rival.candidate.effect}": {"value": soil.n + rival.ground, "deviation": rival.ground_deviation}
        for cause in diagnosis.causes
        for rival in cause.rivals
    }
    return {
        "prior": float(soil.n),
        "before": {"value": before, "deviation": float(nominal.deviations()[0])},
        "after": after,
    }


def to_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Everything as JSON takes it."""
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
        "causes": [_cause_dict(cause) for cause in diagnosis.causes],
        "unexplained": rest or None,
        "not_testable": {name: _finite(limit) for name, limit in diagnosis.not_testable.items()},
        "missing_channels": diagnosis.missing,
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
        "n": _ground(diagnosis),
        "next_experiment": next_experiment(diagnosis),
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
    return {name: noise.order for name, noise in diagnosis.search.extended.whitener.noise.items()}


def lines_of(diagnosis: Diagnosis) -> list[str]:
    """The summary for a terminal, at most 25 lines."""
    lines = [f"{diagnosis.verdict}: {sentence_of(diagnosis)}"]
    for cause in diagnosis.causes:
        lines.append(
            f"cause, gains {0.5 * cause.delta:.0f} in the log-likelihood, chance {cause.chance:.1g}:"
        )
        lines += [f"  {rival.candidate.effect}: {_phrase(rival)}" for rival in cause.rivals[:4]]
    ground = _ground(diagnosis)
    if ground is not None and diagnosis.causes:
        after = ", ".join(f"{entry['value']:.3f} with {name}" for name, entry in ground["after"].items())
        lines.append(f"n: {ground['prior']:.3f} stated, {ground['before']['value']:.3f} before; {after}")
    gains = sorted(diagnosis.gains, key=lambda gain: -(1.0 - gain.extended / max(gain.nominal, 1e-300)))
    for gain in gains[:4]:
        lines.append(
            f"on unseen data {gain.channel}: {gain.nominal:.3g} -> {gain.extended:.3g} "
            f"({100.0 * gain.low:.0f} to {100.0 * gain.high:.0f} % less)"
        )
    lines += [f"finding: {finding.sentence}" for finding in diagnosis.findings[:6]]
    if diagnosis.not_testable:
        lines.append(f"not testable with these data: {', '.join(diagnosis.not_testable)}")
    if diagnosis.missing:
        lines.append(f"no channel for: {', '.join(diagnosis.missing)}")
    if (advice := next_experiment(diagnosis)) is not None:
        lines.append(f"next experiment: {advice}")
    return lines[:25]


def extension_of(diagnosis: Diagnosis) -> list[tuple[str, dict[str, float]]]:
    """Effects of the extended model with their parameters, as `offroad_env.effects.apply` takes them."""
    if not diagnosis.causes:
        return []
    fit = diagnosis.search.extended
    pairs = zip(fit.candidates, fit.sizes, strict=True)
    return [(candidate.effect, candidate.values(float(size))) for candidate, size in pairs]
