"""Result of a diagnosis, and the rules by which it becomes a verdict."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from estimators.discrepancy.checks.forecast import Prediction
from estimators.discrepancy.checks.holdout_gain import ChannelGain, Held
from estimators.discrepancy.checks.regime_rest import RegimeRest
from estimators.discrepancy.checks.unmodelled_forces import JointSizes, UnmodelledForce
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.physical_ranges import at_end
from estimators.discrepancy.rig.structure_search import StructuralCause
from estimators.discrepancy.search.result import Cause, SearchResult
from estimators.discrepancy.stopping import Stop
from estimators.discrepancy.structure_comparison import StructureComparison
from estimators.logs.channel_checks import OUTSIDE
from estimators.logs.immobile_findings import IMMOBILE
from estimators.logs.log import Log
from estimators.logs.quality import QualityReport
from estimators.logs.units import Finding

__all__ = [
    "JOINT_SIZES",
    "NOMINAL",
    "OVERLAP",
    "REST_RATE",
    "SEARCH",
    "STATING",
    "STOPS",
    "Diagnosis",
    "FitChecks",
    "RigChecks",
    "RigDiagnosis",
    "VehicleChecks",
    "VehicleDiagnosis",
    "Verdict",
    "solver_limit",
]

#: Sections without which a verdict is less certain, as `Diagnosis.failed` calls them.
NOMINAL, SEARCH, JOINT_SIZES = "nominal model", "search", "sizes with unknown inputs"
#: Section on vehicles that get stuck.
STOPS = "what stops the vehicle"
#: p-value below which an unknown input counts as present in one equation of motion.
REST_RATE = 0.002
#: Causes whose sizes are correlated by more than this may be one that the library lacks.
OVERLAP = 0.2
#: A cause is identifiable although unknown inputs are fitted jointly if they leave the first share of the
#: information about its size, or if it explains the second share of what it and they explain together. Its
#: size must then be the same within its 95 % interval or within the third share of itself.
_OWN, _MOST, _SAME, _Z = 0.5, 0.9, 0.5, 1.96
#: The error of the solver moves scores by less than this, absolutely or as a share of the largest.
_SOLVER, _SOLVER_SHARE = 1.0, 0.1
#: A log can test the library if it would show this share of it at the largest plausible size.
_TESTABLE = 0.5
#: A forecast is made worse if its error grows by this factor, and its 95 % interval excludes no change.
_MISLED = 2.0
#: A model predicts nothing if its error of the speed, up to so far ahead [s], is larger than this [m/s] and
#: than that of a speed that stays as it is; significantly, where there are forecasts enough to tell.
_AHEAD, _NOTHING = 3.0, 0.5
#: Share of the excess of the nominal model that may remain if the causes are to count as an explanation.
#: Repeats on a rig agree far better than any law of soil: more remains than in the log of a vehicle.
_REMAINING = 1.0 / 3.0


class Verdict(StrEnum):
    """Outcome of a diagnosis."""

    DATA_PROBLEM = "DATA PROBLEM"  #: the data must be corrected before any model is fitted
    OUTSIDE = "OUTSIDE THE MODEL"  #: no model of this kind can be right; or the vehicle is stuck
    NUMERICS = "NUMERICS"  #: the fit or the solver is not accurate enough
    NOT_TESTABLE = "NOT TESTABLE"  #: the data are not informative enough
    UNEXPLAINED = "UNEXPLAINED"  #: a model error that no effect of the library explains
    NAMED_WITH_REST = "NAMED + UNEXPLAINED REST"  #: causes, and a discrepancy that they do not explain
    ONE_OF = "ONE OF"  #: causes, at least one of which has an alternative
    NAMED = "NAMED"  #: causes without alternative
    NO_EFFECT = "NO EFFECT"  #: no model error is detected


def solver_limit(search: SearchResult) -> float:
    """Largest change of a score by a finer solver with which a search counts as accurate."""
    strongest = float(np.abs(search.first.z).max(initial=0.0))
    return max(_SOLVER, _SOLVER_SHARE * strongest)


#: Verdicts that state causes.
STATING = (Verdict.NAMED_WITH_REST, Verdict.ONE_OF, Verdict.NAMED)


@dataclass(frozen=True, kw_only=True)
class FitChecks:
    """Numerical checks of a search."""

    solver: float  #: largest change of a score by a finer solver [standard deviations]
    gate: tuple[float, ...]  #: gains of the models tried in the hold-out test, in the log-likelihood
    converged: bool
    threshold: float  #: of the first score test

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "solver": self.solver,
            "gate": list(self.gate),
            "converged": self.converged,
            "threshold": self.threshold,
        }


@dataclass(frozen=True, kw_only=True)
class VehicleChecks(FitChecks):
    """Checks of a diagnosis of vehicle logs, with the fitted parameters that are not causes."""

    overlap: float  #: largest correlation of two sizes in the extended model
    pose_age: tuple[float, ...]  #: by log [s]
    unknowns: Mapping[
        str, Mapping[str, float | str]
    ]  #: what the logs state as unknown: value, deviation, unit
    nuisances: Mapping[str, float]  #: by name, in the unit of each

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return super().to_dict() | {
            "overlap": self.overlap,
            "pose_age": list(self.pose_age),
            "unknowns": {name: dict(entry) for name, entry in self.unknowns.items()},
            "nuisances": dict(self.nuisances),
        }


@dataclass(frozen=True, kw_only=True)
class RigChecks(FitChecks):
    """Checks of a diagnosis of rig trials."""

    trials: int
    left_out: int  #: trials that could not be used
    conditions: Mapping[str, int]  #: by use: "search", "gate" (hold-out test), "report" (test data)
    #: Fitted change of n without each slip angle in turn [-].
    ground_by_blocks: tuple[float, ...] = ()
    #: Standard deviations of the mean load [N] and slip [-] of a condition, the largest.
    setting_errors: tuple[float, float] = (0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return super().to_dict() | {
            "trials": {"used": self.trials, "left_out": self.left_out},
            "conditions": dict(self.conditions),
            "n_without_each_angle": list(self.ground_by_blocks),
            "setting_errors": {"load": self.setting_errors[0], "slip": self.setting_errors[1]},
        }


@dataclass(frozen=True, kw_only=True)
class Diagnosis(ABC):
    """Result of a diagnosis; parts that were not reached are None or empty."""

    logs: tuple[Log, ...] = ()
    quality: tuple[QualityReport, ...] = ()  #: by log
    findings: tuple[Finding, ...] = ()  #: problems of the data, or else what a fit takes from the sensors
    search: SearchResult | None = None
    causes: tuple[Cause, ...] = ()
    unknown_inputs: tuple[UnmodelledForce, ...] = ()  #: by equation, beyond the causes
    failed: Mapping[str, str] = field(default_factory=dict)  #: part that could not be computed -> why
    joint: JointSizes | None = None  #: the causes with unknown inputs fitted jointly, where such are present
    limits: Mapping[str, float] = field(default_factory=dict)  #: smallest detectable size by effect
    not_testable: Mapping[str, float] = field(default_factory=dict)  #: limits beyond all plausible sizes
    missing: Mapping[str, str] = field(default_factory=dict)  #: effect -> channels that the log lacks
    not_judged: Mapping[str, str] = field(default_factory=dict)  #: effect -> what the log states as unknown
    gains: tuple[ChannelGain, ...] = ()
    checks: FitChecks | None = None
    on_test_data: tuple[Held, Held] | None = None  #: nominal and extended model on windows that no fit uses
    #: The fit with the causes that are named alone, where others were found besides.
    partial: FitResult | None = None

    @property
    @abstractmethod
    def verdict(self) -> Verdict:
        """Outcome by the rules of this kind of log."""

    @property
    def model(self) -> FitResult | None:
        """The fit with the causes that are stated, or the nominal one without; None if nothing was fitted."""
        if self.search is None:
            return None
        # A larger model that the hold-out test refused is not used, nor a cause that is not named.
        if not self.stated:
            return self.search.nominal
        return self.search.extended if len(self.stated) == len(self.causes) else self.partial

    @property
    def unexplained(self) -> tuple[UnmodelledForce, ...]:
        """Unknown inputs that are significant."""
        return tuple(rest for rest in self.unknown_inputs if rest.p_value < REST_RATE)

    @property
    def identifiable(self) -> tuple[bool, ...]:
        """Of every cause, whether it may be named: of a possible size, also with unknown inputs fitted."""
        if self.joint is None:
            # A section that broke down must not make a name certain.
            return (False,) * len(self.causes) if JOINT_SIZES in self.failed else self._possible
        # Two that may be one missing cause make every name uncertain, also those of the others.
        certain = not any(self.confounded)
        pairs = zip(self._stable(self.joint), self._possible, strict=True)
        return tuple(bool(stable) and certain and possible for stable, possible in pairs)

    @property
    def _possible(self) -> tuple[bool, ...]:
        """Of every cause, whether its size is physical, and neither windows apart nor numbers refute it.

        A number beyond its own tolerance undoes what the effect does.
        """
        search = self.search
        if search is None or not (self.causes and (search.strayed or search.uncertain)):
            return self.physical
        numbers = search.extended.problem.nuisances
        undone = {number.effect for number in numbers if number.name in search.strayed}
        wrong = [
            k in search.uncertain or cause.best.candidate.effect in undone
            for k, cause in enumerate(self.causes)
        ]
        return tuple(one and not bad for one, bad in zip(self.physical, wrong, strict=True))

    @property
    def physical(self) -> tuple[bool, ...]:
        """Of every cause, whether its size lies within its physical range, and not at an end of it."""
        if self.search is None or not self.logs or self.logs[0].rig:
            return (True,) * len(self.causes)
        best, run = [cause.best for cause in self.causes], self.search.nominal.runs[0]
        return tuple(
            not at_end(one.candidate.effect, one.size, run.size_limits(one.candidate.effect)) for one in best
        )

    @property
    def confounded(self) -> tuple[bool, ...]:
        """Of every cause, whether it and another identifiable one may be a single cause that is missing."""
        if self.joint is None:
            return (False,) * len(self.causes)
        stable = self._stable(self.joint)
        correlated = np.any(stable & (self.joint.correlations > OVERLAP), axis=1)
        return tuple(bool(one) for one in stable & correlated)

    def _stable(self, joint: JointSizes) -> np.ndarray:
        """Of every cause, whether unknown inputs leave its size and most of its information, (E,) bool."""
        if self.search is None:
            return np.zeros(0, dtype=bool)
        sizes = self.search.extended.sizes
        strength = np.abs(joint.sizes) / joint.deviations
        share = strength**2 / (strength**2 + self.remaining)
        reach = np.maximum(_Z * joint.deviations, _SAME * np.abs(sizes))
        same = (strength > self.search.threshold) & (np.abs(joint.sizes - sizes) <= reach)
        stable: np.ndarray = same & ((joint.kept >= _OWN) | (share >= _MOST))
        return stable

    @property
    def remaining(self) -> float:
        """Twice the log-likelihood that the causes leave to unknown inputs, or to other effects."""
        inputs = sum(rest.excess for rest in self.unknown_inputs)
        left = 0.0
        if self.search is not None and (self.search.refused or self.search.capped):
            left = float(np.max(self.search.last.z**2, initial=0.0))
        return max(inputs, left)

    @property
    def named(self) -> tuple[Cause, ...]:
        """Causes that the verdict names."""
        pairs = zip(self.causes, self.identifiable, strict=True)
        return tuple(cause for cause, identifiable in pairs if identifiable)

    @property
    def stated(self) -> tuple[Cause, ...]:
        """Causes that the extended model holds: those that a verdict of this kind names."""
        return self.named if self.verdict in STATING else ()

    @property
    def incomplete(self) -> bool:
        """Whether a discrepancy remains: an unknown input, or effects that are refused or one too many."""
        if self.unexplained or not all(self.physical):
            return True
        search = self.search
        if search is None:
            return False
        left = bool(self.causes) and (search.refused or search.capped)
        return left or (search.refused and search.beyond_null_logs) or bool(search.strayed)

    @property
    def crowded(self) -> bool:
        """Whether all that remains are effects beyond the most that a model holds."""
        if self.search is None or not self.search.capped or self.search.refused:
            return False
        return bool(self.causes) and not self.unexplained and all(self.physical)

    @property
    def inaccurate(self) -> bool:
        """Whether the fit has not converged, or the solver is not accurate enough for the scores."""
        if self.search is None or self.checks is None:
            return False
        limit = solver_limit(self.search)
        return self.checks.solver > limit or not self.checks.converged or SEARCH in self.failed

    def _without_causes(self, asked: int) -> Verdict:
        """The verdict where nothing was found, by how many of the effects asked for were testable."""
        testable = len(self.limits) - len(self.not_testable)
        return Verdict.NOT_TESTABLE if testable < _TESTABLE * asked else Verdict.NO_EFFECT

    def _with_alternatives(self) -> bool:
        return any(len(cause.alternatives) > 1 for cause in self.causes)


@dataclass(frozen=True, kw_only=True)
class VehicleDiagnosis(Diagnosis):
    """Result of a diagnosis of vehicle logs."""

    checks: VehicleChecks | None = None
    structure: StructureComparison | None = None  #: where the nominal structure is inadequate
    #: Effects that improve the nominal model where another structure is named; alternatives if both predict
    #: equally well.
    stand_ins: tuple[str, ...] = ()
    #: Of the whitened residuals with all causes in the model, by channel and regime, largest first.
    rests: tuple[RegimeRest, ...] = ()
    #: Errors of forecasts of the nominal model and of that with the causes; empty where none would be named.
    forecasts: tuple[Prediction, ...] = ()
    #: By log in which the vehicle is stuck and would drive on as stated: what would stop it.
    stops: tuple[Stop, ...] = ()

    @property
    def worsened(self) -> tuple[Prediction, ...]:
        """Forecasts that the causes make worse, although they improve the fit: they stand in for another."""
        return tuple(one for one in self.forecasts if one.high < 0.0 and one.extended > _MISLED * one.nominal)

    @property
    def unpredicted(self) -> tuple[Prediction, ...]:
        """Forecasts of the speed in which the model with the causes is worse than none."""
        speeds = (one for one in self.forecasts if one.quantity == "speed" and one.horizon <= _AHEAD)
        worse = (one for one in speeds if one.extended > max(one.kept, _NOTHING))
        return tuple(one for one in worse if not one.kept_high >= 0.0)

    @property
    def misled(self) -> bool:
        """Whether forecasts refute the causes."""
        return bool(self.worsened or self.unpredicted)

    @property
    def identifiable(self) -> tuple[bool, ...]:
        """Of every cause, whether it may be named: as of all logs, and no forecast may become worse.

        Nor may another structure predict better, however badly, or as well where something remains.
        """
        refuted = self.misled or self.beyond_structures is not None
        if refuted or (self.rivalled and self.incomplete and not self.crowded):
            return (False,) * len(self.causes)
        return super().identifiable

    @property
    def significant_rests(self) -> tuple[RegimeRest, ...]:
        """What the causes leave beyond noise; empty without causes, as then nothing is named."""
        return tuple(rest for rest in self.rests if self.causes and rest.p_value < REST_RATE)

    @property
    def inadequate(self) -> tuple[bool, ...]:
        """Of every cause, whether something is left that resembles it: its law may be another one.

        Beside unknown inputs and refused effects this is not asked: there, unknown inputs fitted jointly
        decide. Of a model that holds as many effects as one may it is: they may do together what one does
        that the library lacks.
        """
        rests = self.significant_rests if self.crowded or not self.incomplete else ()
        return tuple(any(rest.alike[k] > OVERLAP for rest in rests) for k in range(len(self.causes)))

    @property
    def restructured(self) -> StructureComparison | None:
        """The comparison of structures, if it names another one."""
        found = self.structure
        return found if found is not None and found.found and found.adequate else None

    @property
    def beyond_structures(self) -> StructureComparison | None:
        """The comparison, if another structure predicts the runs better, and still not well."""
        found = self.structure
        return found if found is not None and found.found and not found.adequate else None

    @property
    def rivalled(self) -> bool:
        """Whether another structure predicts as well as the causes, and neither does it well."""
        return bool(self.causes) and self.structure is not None and self.structure.undecided

    @property
    def overlapping(self) -> bool:
        """Whether the sizes of two causes are so correlated that they may be one that is missing."""
        return self.checks is not None and self.checks.overlap > OVERLAP

    @property
    def only_stopped(self) -> bool:
        """Whether nothing is found wrong where the vehicle drives, and something where it is stuck."""
        return bool(self.stops) and self._where_it_drives in (Verdict.NO_EFFECT, Verdict.NOT_TESTABLE)

    @property
    def verdict(self) -> Verdict:
        """Outcome by what is driven; if that is fine, by what may stop a vehicle that gets stuck."""
        if not self.only_stopped:
            return self._where_it_drives
        return Verdict.ONE_OF if any(stop.effects for stop in self.stops) else Verdict.UNEXPLAINED

    @property
    def _where_it_drives(self) -> Verdict:
        """Outcome; the data come first, then the numerics, then what remains unexplained."""
        if self.restructured is not None:
            return Verdict.ONE_OF if self.restructured.tied else Verdict.NAMED
        if self.beyond_structures is not None:
            return Verdict.UNEXPLAINED
        if NOMINAL in self.failed:
            return Verdict.NUMERICS
        if self.search is None:
            outside = {finding.kind for finding in self.findings} in ({OUTSIDE}, {IMMOBILE})
            return Verdict.OUTSIDE if outside else Verdict.DATA_PROBLEM
        if self.inaccurate:
            return Verdict.NUMERICS
        if self.misled:
            return Verdict.UNEXPLAINED
        together = self.overlapping or any(self.inadequate) or self.rivalled
        if self.incomplete and not (self.crowded and together):
            return Verdict.NAMED_WITH_REST if self.named else Verdict.UNEXPLAINED
        if self.causes:
            return Verdict.ONE_OF if together or self._with_alternatives() else Verdict.NAMED
        return self._without_causes(len(self.limits) + len(self.missing))


@dataclass(frozen=True, kw_only=True)
class RigDiagnosis(Diagnosis):
    """Result of a diagnosis of rig trials; unknown inputs are what the means of the conditions leave."""

    checks: RigChecks | None = None
    structure: StructuralCause | None = None  #: laws of the wheel that are not those of the log
    nominal_excess: float = 0.0  #: excess of the nominal model, as `UnmodelledForce.excess`

    @property
    def model(self) -> FitResult | None:
        """The fit with all causes, named or not, and laws of the wheel, or the nominal one without any."""
        if self.search is None:
            return None
        return self.search.extended if self.causes or self.structure else self.search.nominal

    @property
    def explained(self) -> bool:
        """Whether the causes remove most of what the nominal model leaves."""
        excess = sum(rest.excess for rest in self.unknown_inputs)
        found = bool(self.causes) or self.structure is not None
        return not self.unexplained or bool(found and excess <= _REMAINING * self.nominal_excess)

    @property
    def identifiable(self) -> tuple[bool, ...]:
        """No cause is named beside a discrepancy that the causes do not explain."""
        return (self.explained,) * len(self.causes)

    @property
    def verdict(self) -> Verdict:
        """Outcome; causes count as an explanation if they remove most of what the nominal model leaves."""
        if self.search is None:
            return Verdict.DATA_PROBLEM
        if self.inaccurate:
            return Verdict.NUMERICS
        if self.unexplained:
            return Verdict.NAMED_WITH_REST if self.explained else Verdict.UNEXPLAINED
        if self.search.refused and self.structure is None:
            # Significant scores, and no effect of a physical size that would hold on other conditions.
            return Verdict.UNEXPLAINED
        if self.causes or self.structure is not None:
            several = self.structure is not None and self.structure.ambiguous
            return Verdict.ONE_OF if several or self._with_alternatives() else Verdict.NAMED
        return self._without_causes(len(self.limits))
