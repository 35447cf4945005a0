"""Checks of a finished diagnosis that only a report shows: forecasts, profiles, whiteness, misfit, advice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from estimators.discrepancy.checks.forecast import Prediction, predictions
from estimators.discrepancy.checks.likelihood_profiles import Profile, profiles_of
from estimators.discrepancy.checks.misfit import Misfit, misfit_of
from estimators.discrepancy.checks.whiteness import LikelihoodGain, Whiteness, likelihood_gains, whiteness_of
from estimators.discrepancy.diagnosis import split_runs
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT
from estimators.discrepancy.next_experiment import Advice, advise
from estimators.discrepancy.sections import attempt
from estimators.discrepancy.verdict import VehicleDiagnosis
from estimators.logs.quality import QualityReport

__all__ = ["SEED", "Evidence", "gather", "rounded"]

#: Of the draws behind the intervals.
SEED = 0


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Checks behind a verdict; parts that were not reached are None or empty."""

    quality: tuple[QualityReport, ...]
    split: Mapping[str, float] = field(default_factory=dict)  #: use -> seconds of data
    misfit: Misfit | None = None
    whiteness: tuple[Whiteness, ...] = ()
    likelihood: tuple[LikelihoodGain, ...] = ()
    predictions: tuple[Prediction, ...] = ()
    profiles: tuple[Profile, ...] = ()
    advice: Advice | None = None
    failed: Mapping[str, str] = field(default_factory=dict)  #: section that broke down -> why

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it; the advice is part of the summary."""
        return {
            "prediction": [asdict(one) for one in self.predictions],
            "likelihood_gain": [asdict(one) for one in self.likelihood],
            "misfit": None if self.misfit is None else rounded(asdict(self.misfit)),
            "profiles": rounded([asdict(profile) for profile in self.profiles]),
            "whiteness": [asdict(one) | {"white": one.white} for one in self.whiteness],
            "split_seconds": dict(self.split),
            "seed": SEED,
            "quality": [report.to_dict() for report in self.quality],
        }


def rounded(value: Any) -> Any:
    """Numbers with six digits: enough for any figure, and half the size of the file."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [rounded(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def gather(diagnosis: VehicleDiagnosis, progress: Callable[[str], None] = lambda stage: None) -> Evidence:
    """All checks for the report of a diagnosis.

    ``progress`` is called with the name of every stage that begins.
    """
    extended = diagnosis.model
    if diagnosis.search is None or extended is None:
        return Evidence(quality=diagnosis.quality)
    nominal = diagnosis.search.nominal
    # Causes that are not named have sizes, too.
    found = diagnosis.search.extended if diagnosis.causes else nominal
    parts = split_runs(diagnosis.logs)
    failed: dict[str, str] = {}
    progress("forecasts")
    forecasts: tuple[Prediction, ...] = diagnosis.forecasts or attempt(
        "forecasts", lambda: predictions(nominal, extended, parts[REPORT], seed=SEED), (), failed
    )
    progress("profiles")
    profiles: tuple[Profile, ...] = attempt("profiles", lambda: profiles_of(found), (), failed)
    progress("next experiment")
    advice = attempt("next experiment", lambda: advise(diagnosis), None, failed)
    pair = diagnosis.on_test_data
    return Evidence(
        quality=diagnosis.quality,
        split={
            name: sum(float(run.windows.count.sum()) * run.step for run in parts[use])
            for name, use in (("search", FIT), ("gate", SELECT), ("report", REPORT))
        },
        misfit=attempt("errors by regime", lambda: misfit_of(nominal, extended), None, failed),
        whiteness=attempt("whiteness", lambda: whiteness_of(extended), (), failed),
        likelihood=()
        if pair is None
        else attempt("likelihood on test data", lambda: likelihood_gains(*pair, seed=SEED), (), failed),
        predictions=forecasts,
        profiles=profiles,
        advice=advice,
        failed=failed,
    )
