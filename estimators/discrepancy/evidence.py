"""All that a report shows besides the verdict, gathered once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from estimators.discrepancy.adviser import Advice, advise
from estimators.discrepancy.diagnosis import Diagnosis, split_runs
from estimators.discrepancy.misfit import Misfit, misfit_of
from estimators.discrepancy.open_loop import Prediction, predictions
from estimators.discrepancy.profiles import Profile, profiles_of
from estimators.discrepancy.verdict import advice_of, isolability_of, scores_of
from estimators.discrepancy.whiteness import LikelihoodGain, Whiteness, likelihood_gains, whiteness_of
from estimators.discrepancy.windows import FIT, REPORT, SELECT
from estimators.logs.quality import QualityReport, quality

__all__ = ["SEED", "Evidence", "gather"]

#: Of the draws behind the intervals.
SEED = 0


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What stands behind a verdict; parts that were not reached are None or empty."""

    quality: tuple[QualityReport, ...]
    split: dict[str, float] = field(default_factory=dict)  #: use -> seconds of data
    misfit: Misfit | None = None
    whiteness: tuple[Whiteness, ...] = ()
    likelihood: tuple[LikelihoodGain, ...] = ()
    predictions: tuple[Prediction, ...] = ()
    profiles: tuple[Profile, ...] = ()
    advice: Advice | None = None

    def to_dict(self, diagnosis: Diagnosis) -> dict[str, Any]:
        """What the report shows besides the verdict's numbers, as JSON takes it."""
        names, alike = isolability_of(diagnosis)
        return {
            "prediction": [asdict(one) for one in self.predictions],
            "likelihood_gain": [asdict(one) for one in self.likelihood],
            "misfit": None if self.misfit is None else _rounded(asdict(self.misfit)),
            "scores": _rounded([asdict(score) for score in scores_of(diagnosis)]),
            "isolability": {"effects": names, "cosines": np.round(alike, 3).tolist()},
            "profiles": _rounded([asdict(profile) for profile in self.profiles]),
            "next_experiment": _next(diagnosis, self.advice),
            "whiteness": [asdict(one) | {"white": one.white} for one in self.whiteness],
            "split_seconds": self.split,
            "seed": SEED,
            "quality": [report.to_dict() for report in self.quality],
        }


def _next(diagnosis: Diagnosis, advice: Advice | None) -> dict[str, Any] | None:
    """The experiment that would change the verdict."""
    known = advice_of(diagnosis)
    if advice is None or (known is not None and diagnosis.unexplained):
        return None if known is None else {"sentence": known}
    return {
        "sentence": advice.sentence,
        "question": advice.question,
        "manoeuvre": advice.best.name,
        "power": {"now": advice.power, "then": advice.best.power},
        "limits": {"now": advice.limits, "then": advice.best.limits},
        "also": known,
        "menu": [asdict(trial) for trial in advice.trials],
    }


def _rounded(value: Any) -> Any:
    """Numbers with six digits: enough for any figure, and half the size of the file."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_rounded(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def gather(diagnosis: Diagnosis, progress: Callable[[str], None] = lambda stage: None) -> Evidence:
    """Everything for the report of a diagnosis.

    ``progress`` is called with the name of every stage that begins.
    """
    checked = tuple(quality(log) for log in diagnosis.logs)
    if diagnosis.search is None:
        return Evidence(quality=checked)
    nominal, extended = diagnosis.search.nominal, diagnosis.model
    parts = split_runs(diagnosis.logs)
    progress("forecasts")
    forecasts = predictions(nominal, extended, parts[REPORT], seed=SEED)
    progress("profiles")
    profiles = profiles_of(extended)
    progress("next experiment")
    advice = advise(diagnosis)
    return Evidence(
        quality=checked,
        split={
            name: sum(float(run.windows.count.sum()) * run.step for run in parts[use])
            for name, use in (("search", FIT), ("gate", SELECT), ("report", REPORT))
        },
        misfit=misfit_of(nominal, extended),
        whiteness=whiteness_of(extended),
        likelihood=likelihood_gains(*diagnosis.report, seed=SEED) if diagnosis.report else (),
        predictions=forecasts,
        profiles=profiles,
        advice=advice,
    )
