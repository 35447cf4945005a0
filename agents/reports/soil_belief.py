"""The soil under a drive in words and numbers: one number a quantity, the interval to quote, one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from agents.reports.output import console, say, table
from estimators.belief.limits import HELD
from estimators.belief.soil_belief import ADEQUATE, Marginal, SoilBelief
from estimators.belief.unknowns import UNKNOWN_NAMES, N
from estimators.replay.structures import Case, title_of

__all__ = ["Report", "show_details", "show_report"]

_TITLES = {
    "n": ("sinkage exponent n", "-"),
    "phi": ("friction angle phi", "rad"),
    "lateral": ("largest lateral acceleration", "m/s²"),
    "pull": ("largest pull", "N"),
    "pull_slip": ("slip of the largest pull", "-"),
    "resistance": ("rolling resistance", "N"),
    "sinkage": ("sinkage", "m"),
    "stopping": ("stopping distance from 5 m/s", "m"),
}


@dataclass(frozen=True, kw_only=True)
class Report:
    """What is reported of one log."""

    belief: SoilBelief
    holds: Mapping[str, Marginal]  #: by name as `HELD`
    prediction: Mapping[str, Mapping[str, float]]  #: horizon [s] -> errors of position [m] and speed [m/s]

    @property
    def sentence(self) -> str:
        """The result in plain words."""
        belief, n = self.belief, self.belief.marginal(N)
        share = f"{100.0 * belief.valid_share:.0f} % of the drive"
        if belief.at_ends:
            return (
                f"{' and '.join(belief.at_ends)} would have to lie beyond what is possible: do not use these "
                "numbers. Are the torques those of the wheels, and mass and moduli of the soil as stated?"
            )
        if not belief.valid:
            return f"No structure that was tried predicts this drive ({share}): do not use these numbers."
        interval = f"{n.mean:.2f} (95 %: {n.low:.2f} to {n.high:.2f})"
        if not belief.answered:
            return f"This drive does not determine n: {interval}. The models predict {share}."
        return f"Quote n = {interval}; {_named(belief.parts[0].case)} predicts {share}."

    def numbers(self) -> dict[str, Any]:
        """The entry of the JSON."""
        belief = self.belief
        return {
            "log": belief.log,
            "soil": belief.soil(),
            "holds": dict(self.holds),
            "valid_share": belief.valid_share,
            "answered": belief.answered,
            "structure": [
                {
                    "structure": part.case.structure,
                    "vehicle_model": part.case.vehicle_model,
                    "weight": part.weight,
                    "values": dict(zip(UNKNOWN_NAMES, part.fit.values.tolist(), strict=True)),
                    "sd": dict(zip(UNKNOWN_NAMES, _sds(part.fit.covariance), strict=True)),
                }
                for part in belief.parts
            ],
            "left_out": list(belief.left_out),
            "prediction": {name: dict(errors) for name, errors in self.prediction.items()},
            "sentence": self.sentence,
        }


def _sds(covariance: Any) -> list[float]:
    return [float(value) ** 0.5 for value in covariance.diagonal()]


def _named(case: Case) -> str:
    """A case for a sentence."""
    wheels = {"half_car": "as a half-car", "four_wheel": "with four wheels"}
    return f'structure "{title_of(case.structure)}" {wheels.get(case.vehicle_model, case.vehicle_model)}'


def _figures(value: float) -> str:
    """Three significant figures without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _line(name: str, found: Marginal) -> tuple[str, ...]:
    title, unit = _TITLES[name]
    return title, _figures(found.mean), f"{_figures(found.low)} to {_figures(found.high)}", unit


def show_report(report: Report) -> None:
    """One number a quantity and its interval, then the sentence."""
    soil = report.belief.soil()
    rows = [_line(name, soil[name]) for name in ("n", "phi")]
    rows += [_line(name, report.holds[name]) for name in HELD]
    heading = ("quantity", "value", "95 % interval", "unit")
    console().print(table(f"{report.belief.log}: the soil under the drive", heading, rows))
    say(report.sentence)


def show_details(report: Report) -> None:
    """Structure by structure, what the description states, and prediction."""
    belief = report.belief
    rows = []
    for part in belief.parts:
        values, sds = part.fit.values, _sds(part.fit.covariance)
        rows.append(
            (
                title_of(part.case.structure),
                part.case.vehicle_model,
                f"{part.weight:.2f}",
                *(f"{values[i]:.3f} ± {sds[i]:.3f}" for i in range(2)),
                f"{100.0 * float((part.fit.unexplained < ADEQUATE).mean()):.0f} %",
            )
        )
    heading = ("structure", "vehicle", "weight", "n given it", "phi given it", "predicted")
    console().print(table("structures", heading, rows, texts=2))
    if belief.left_out:
        say(f"far off already in the search: {', '.join(belief.left_out)}")
    soil = belief.soil()
    stated = [(name, _figures(soil[name].mean), _interval(soil[name])) for name in ("k_phi", "c", "K")]
    console().print(table("stated in the description", ("", "value", "95 % interval"), stated))
    _show_prediction(report.prediction)


def _interval(found: Marginal) -> str:
    return f"{_figures(found.low)} to {_figures(found.high)}"


def _show_prediction(prediction: Mapping[str, Mapping[str, float]]) -> None:
    rows: Sequence[tuple[str, ...]] = [
        (f"{name} s", f"{errors['position']:.2f} m", f"{errors['speed']:.2f} m/s")
        for name, errors in prediction.items()
    ]
    console().print(table("errors on this drive, open loop", ("ahead", "position", "speed"), rows))
