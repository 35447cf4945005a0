"""Summary of a diagnosis: everything that JSON, terminal and page show, computed once and immutable."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from estimators.discrepancy.checks.holdout_gain import ChannelGain
from estimators.discrepancy.checks.regime_rest import RegimeRest
from estimators.discrepancy.evidence import Evidence, rounded
from estimators.discrepancy.next_experiment import Advice
from estimators.discrepancy.stopping import Stop
from estimators.discrepancy.structure_comparison import StructureComparison
from estimators.discrepancy.verdict import STATING, FitChecks, Verdict
from offroad_env.effects import Extension

__all__ = [
    "CauseMember",
    "CauseSummary",
    "DiagnosisSummary",
    "Estimate",
    "JointEstimate",
    "NextExperiment",
    "Parameter",
    "RunSummary",
    "Score",
    "SinkageExponent",
    "StructureRow",
    "UnknownInput",
    "UnknownInputShape",
]


#: Rests that are listed.
_RESTS = 5


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """A log of the diagnosis."""

    name: str
    hash: str
    duration: float  #: [s]


@dataclass(frozen=True, kw_only=True)
class Score:
    """Score test of one effect against the nominal model."""

    effect: str
    z: float  #: standard deviations, the largest over all its places
    limit: float  #: smallest detectable size; infinite where there is none
    reason: str  #: why these data cannot test it; empty where they can


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of a cause; its interval is None where it is not fitted."""

    name: str
    value: float
    low: float | None  #: 95 % interval
    high: float | None
    unit: str


@dataclass(frozen=True, kw_only=True)
class CauseMember:
    """An effect that explains the data about as well as the best of its cause."""

    effect: str
    size: float
    deviation: float
    low: float  #: 95 % interval
    high: float
    lacks_loglik: float  #: log-likelihood less than that of the best
    sentence: str  #: the effect with its size
    phrase: str  #: the same with the interval


@dataclass(frozen=True, kw_only=True)
class JointEstimate:
    """Size of a cause with unknown inputs fitted jointly."""

    value: float
    low: float  #: 95 % interval
    high: float
    kept: float  #: share of the information about the size that the unknown inputs leave
    alike: float  #: largest correlation with the size of another cause


@dataclass(frozen=True, kw_only=True)
class CauseSummary:
    """A cause, its alternatives and what the verdict makes of it."""

    members: tuple[CauseMember, ...]  #: best first
    parameters: tuple[Parameter, ...]  #: of the best
    p_value: float
    delta_loglik: float  #: gain of the log-likelihood
    named: bool  #: whether the verdict names it
    joint: JointEstimate | None  #: where unknown inputs are present
    structural: bool = False  #: whether the members are laws of the wheel, which have no sizes
    families: tuple[str, ...] = ()  #: of the members; one: the family is certain, whichever variant is right
    adequate: bool = True  #: whether the whitened residuals leave nothing that resembles it

    @property
    def best(self) -> CauseMember:
        """The effect that the extended model has."""
        return self.members[0]

    @property
    def effects(self) -> list[str]:
        """Names of the members."""
        return [member.effect for member in self.members]

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "set": self.effects,
            "families": list(self.families),
            "adequate": self.adequate,
            "structural": self.structural,
            "parameters": {
                one.name: {"value": one.value, "low": one.low, "high": one.high, "unit": one.unit}
                for one in self.parameters
            },
            "p": self.p_value,
            "delta_loglik": self.delta_loglik,
            "named": self.named,
            "with_unknown_inputs": None if self.joint is None else asdict(self.joint),
            "members": [
                {
                    "effect": member.effect,
                    "size": member.size,
                    "deviation": member.deviation,
                    "lacks_loglik": member.lacks_loglik,
                    "sentence": member.sentence,
                }
                for member in self.members
            ],
        }


@dataclass(frozen=True, kw_only=True)
class StructureRow:
    """A structure of the wheel that was compared."""

    laws: tuple[str, ...]  #: structural causes that it stands for; empty for the log's own
    structure: str  #: as `offroad_env.world.structures.read_structure` takes it
    effects: tuple[str, ...]  #: of its best model
    n: float
    lacks_loglik: float  #: penalised log-likelihood less than that of the best
    holdout_gain: float | None  #: gain over the log's own in the log-likelihood of the hold-out conditions

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self) | {"laws": list(self.laws), "effects": list(self.effects)}


@dataclass(frozen=True, kw_only=True)
class UnknownInputShape:
    """Correlation of an unknown input with a quantity."""

    quantity: str
    correlation: float
    slope: float  #: input per unit of the quantity


@dataclass(frozen=True, kw_only=True)
class UnknownInput:
    """A significant unknown input."""

    equation: str
    p_value: float
    excess: float  #: twice the log-likelihood that it explains beyond its degrees of freedom
    phrase: str  #: its size, and the quantity that it is correlated with
    shapes: tuple[UnknownInputShape, ...]  #: strongest first


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """An estimate with its 95 % interval."""

    value: float
    deviation: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class SinkageExponent:
    """The sinkage exponent n of the soil before and after the causes [-]."""

    prior: float
    before: Estimate  #: with the nominal model
    after: Mapping[str, Estimate]  #: with each member of each cause
    single: Estimate | None  #: the value to quote; None where members disagree or a discrepancy remains
    wide: Estimate | None = None  #: of trials: with the interval by the slip angles that are left out

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "prior": self.prior,
            "before": asdict(self.before),
            "after": {name: asdict(entry) for name, entry in self.after.items()},
            "single": None if self.single is None else asdict(self.single),
            "wide": None if self.wide is None else asdict(self.wide),
        }


@dataclass(frozen=True, kw_only=True)
class NextExperiment:
    """What to measure next."""

    sentence: str
    alternative: str | None = None  #: a second piece of advice
    plan: Advice | None = None  #: the simulated menu of manoeuvres
    planned: bool = False  #: whether the sentence is the best of that menu

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        if not self.planned or self.plan is None:
            return {"sentence": self.sentence}
        plan = self.plan
        return {
            "sentence": self.sentence,
            "question": plan.question,
            "manoeuvre": plan.best.name,
            "power": {"now": plan.power, "then": plan.best.power},
            "limits": {"now": plan.limits, "then": plan.best.limits},
            "also": self.alternative,
            "menu": [asdict(trial) for trial in plan.trials],
        }


@dataclass(frozen=True, kw_only=True)
class DiagnosisSummary:
    """Everything that is shown of a diagnosis; parts that were not reached are None or empty."""

    verdict: Verdict
    sentence: str
    runs: tuple[RunSummary, ...]
    model: str  #: of the logs: "full", "paper" or "rig"
    hard_ground: bool
    fitted: bool  #: whether a model was fitted at all
    findings: tuple[str, ...]
    causes: tuple[CauseSummary, ...]
    unexplained: tuple[UnknownInput, ...]
    limits: Mapping[str, float]  #: smallest detectable size by effect
    not_testable: Mapping[str, float]
    missing_channels: Mapping[str, str]
    not_judged: Mapping[str, str]
    gains: tuple[ChannelGain, ...]
    n: SinkageExponent | None  #: None on hard ground
    next_experiment: NextExperiment | None
    checks: FitChecks | None
    noise_memory: Mapping[str, int] | None  #: samples that the noise of each channel is correlated over
    scores: tuple[Score, ...]  #: strongest first, then the effects that these data cannot test
    isolability: tuple[tuple[str, ...], np.ndarray]  #: effects, and cosines of their whitened traces (E, E)
    extension: tuple[tuple[str, dict[str, float]], ...]  #: causes as `offroad_env.effects.apply` takes them
    structures: tuple[StructureRow, ...]  #: compared with each other, best first
    structure: str | None  #: of the extended model, where it is not the log's
    failed: Mapping[str, str]  #: part of the diagnosis that could not be computed -> why
    limitations: tuple[str, ...]  #: effects that are not judged, and what was fitted in their place
    evidence: Evidence | None  #: None where none was asked for
    comparison: StructureComparison | None = None  #: of structures, where effects leave a discrepancy
    stand_ins: tuple[str, ...] = ()  #: effects that are not judged, because the structure is wrong
    rests: tuple[RegimeRest, ...] = ()  #: what the causes leave in the whitened residuals beyond noise
    stops: tuple[Stop, ...] = ()  #: by log in which the vehicle is stuck and would not be as stated

    @property
    def families(self) -> list[list[str]]:
        """Families of the members of every cause."""
        return [list(cause.families) for cause in self.causes]

    @property
    def extended(self) -> bool:
        """Whether there is a model with causes; those that are found and not named are in none."""
        return bool(self.extension)

    @property
    def extended_model(self) -> Extension | None:
        """The model with the causes for the environment; None where there is none."""
        if self.comparison is not None and self.comparison.found and self.comparison.adequate:
            case = self.comparison.best.case
            return Extension(
                model=self.model,
                effects=(),
                structure=case.structure,
                vehicle_model=case.vehicle_model,
            )
        if self.verdict not in STATING or (not self.extension and self.structure is None):
            return None
        return Extension(model=self.model, effects=self.extension, structure=self.structure)

    @property
    def effects(self) -> list[list[str]]:
        """Names of the members of every cause."""
        return [cause.effects for cause in self.causes]

    @property
    def threshold(self) -> float:
        """Threshold of the first score test; infinite where nothing was fitted."""
        return math.inf if self.checks is None else self.checks.threshold

    def to_dict(self) -> dict[str, Any]:
        """All numbers as JSON takes them."""
        numbers: dict[str, Any] = {
            "verdict": self.verdict.value,
            "sentence": self.sentence,
            "causes": [cause.to_dict() for cause in self.causes],
            "families": self.families,
            "rests": [
                {"channel": one.channel, "regime": one.regime, "z": one.z, "p": one.p_value}
                for one in self.rests[:_RESTS]
            ],
            "structure": self.structure,
            "stops": [stop.to_dict() for stop in self.stops],
            "failed": dict(self.failed),
            "structures": [row.to_dict() for row in self.structures],
            "unexplained": [self._unexplained_dict(one) for one in self.unexplained] or None,
            "not_testable": {name: _finite(limit) for name, limit in self.not_testable.items()},
            "missing_channels": dict(self.missing_channels),
            "structure_comparison": None if self.comparison is None else self.comparison.to_dict(),
            "stand_ins": list(self.stand_ins),
            "not_judged": dict(self.not_judged),
            "limits": {name: _finite(limit) for name, limit in self.limits.items()},
            "gain": {gain.channel: self._gain_dict(gain) for gain in self.gains},
            "n": None if self.n is None else self.n.to_dict(),
            "next_experiment": None if self.next_experiment is None else self.next_experiment.to_dict(),
            "checks": {
                **({} if self.checks is None else self.checks.to_dict()),
                "noise_memory": None if self.noise_memory is None else dict(self.noise_memory),
                "findings": list(self.findings),
                "logs": {run.name: run.hash for run in self.runs},
            },
        }
        return numbers if self.evidence is None else numbers | self._evidence_dict(self.evidence)

    def _evidence_dict(self, evidence: Evidence) -> dict[str, Any]:
        names, cosines = self.isolability
        return evidence.to_dict() | {
            "scores": rounded([asdict(score) for score in self.scores]),
            "isolability": {"effects": list(names), "cosines": np.round(cosines, 3).tolist()},
        }

    @staticmethod
    def _unexplained_dict(one: UnknownInput) -> dict[str, Any]:
        return {
            "equation": one.equation,
            "p": one.p_value,
            "shape": [asdict(shape) for shape in one.shapes[:3]],
        }

    @staticmethod
    def _gain_dict(gain: ChannelGain) -> dict[str, float]:
        return {"nominal": gain.nominal, "extended": gain.extended, "low": gain.low, "high": gain.high}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
