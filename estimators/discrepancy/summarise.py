"""From a diagnosis and its evidence to the `DiagnosisSummary`."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import t as student

from estimators.discrepancy.checks.unmodelled_forces import JointSizes, UnmodelledForce
from estimators.discrepancy.evidence import Evidence
from estimators.discrepancy.families import DRIVE_FAMILIES, RIG_FAMILIES, families_of
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.rig.jackknife import jackknife_deviation
from estimators.discrepancy.rig_diagnosis import RigRest
from estimators.discrepancy.search.alternatives import p_value_of_score
from estimators.discrepancy.search.result import Alternative, Cause
from estimators.discrepancy.summary import (
    CauseMember,
    CauseSummary,
    DiagnosisSummary,
    Estimate,
    JointEstimate,
    NextExperiment,
    Parameter,
    RunSummary,
    Score,
    SinkageExponent,
    StructureRow,
    UnknownInput,
    UnknownInputShape,
)
from estimators.discrepancy.verdict import Diagnosis, RigDiagnosis, VehicleDiagnosis
from estimators.discrepancy.wording import (
    advice_sentence,
    amount,
    correlation_phrase,
    interval_text,
    limitation_sentences,
    structure_sentence,
    verdict_sentence,
)
from offroad_env.effects import EFFECTS
from offroad_env.world.structures import structure_text

__all__ = ["summarise", "summarise_causes"]

_Z = 1.959964  #: standard deviations to the ends of a 95 % interval


def summarise(diagnosis: Diagnosis, evidence: Evidence | None = None) -> DiagnosisSummary:
    """Everything that is shown of a diagnosis.

    Parameters
    ----------
    diagnosis
    evidence
        From `gather`; None leaves out what only the report shows.
    """
    causes = (*_structural_causes(diagnosis), *summarise_causes(diagnosis))
    unexplained = tuple(_unknown_input(rest) for rest in diagnosis.unexplained)
    verdict = diagnosis.verdict
    advised = advice_sentence(verdict, causes, unexplained)
    first = diagnosis.logs[0].config
    isolability: tuple[tuple[str, ...], np.ndarray] = ((), np.empty((0, 0)))
    if diagnosis.search is not None:
        names, cosines = diagnosis.search.first.by_effect()
        isolability = tuple(names), cosines
    return DiagnosisSummary(
        verdict=verdict,
        sentence=verdict_sentence(verdict, diagnosis, causes, unexplained),
        runs=tuple(RunSummary(name=log.name, hash=log.hash, duration=log.duration) for log in diagnosis.logs),
        model="rig" if isinstance(diagnosis, RigDiagnosis) else first.model,
        hard_ground=first.soil.rigid > 0.5,
        fitted=diagnosis.search is not None,
        findings=tuple(finding.sentence for finding in diagnosis.findings),
        causes=causes,
        unexplained=unexplained,
        limits=diagnosis.limits,
        not_testable=diagnosis.not_testable,
        missing_channels=diagnosis.missing,
        not_judged=diagnosis.not_judged,
        gains=diagnosis.gains,
        n=_sinkage_exponent(diagnosis),
        next_experiment=_next_experiment(advised, evidence, unexplained=bool(unexplained)),
        checks=diagnosis.checks,
        noise_memory=_noise_memory(diagnosis.model),
        scores=_scores(diagnosis),
        isolability=isolability,
        extension=_extension(diagnosis),
        failed={**diagnosis.failed, **({} if evidence is None else evidence.failed)},
        structures=_structures(diagnosis),
        structure=_structure_name(diagnosis),
        limitations=limitation_sentences(diagnosis),
        evidence=evidence,
        comparison=diagnosis.structure if isinstance(diagnosis, VehicleDiagnosis) else None,
        stand_ins=diagnosis.stand_ins if isinstance(diagnosis, VehicleDiagnosis) else (),
        rests=diagnosis.significant_rests if isinstance(diagnosis, VehicleDiagnosis) else (),
        stops=diagnosis.stops if isinstance(diagnosis, VehicleDiagnosis) else (),
    )


# ------------------------------------------------------------------ causes


def summarise_causes(diagnosis: Diagnosis) -> tuple[CauseSummary, ...]:
    """The causes with their members, sizes and intervals."""
    return tuple(_cause(diagnosis, k) for k in range(len(diagnosis.causes)))


def _structural_causes(diagnosis: Diagnosis) -> tuple[CauseSummary, ...]:
    """Laws of the wheel that are not those of the log, one cause each."""
    if not isinstance(diagnosis, RigDiagnosis) or diagnosis.structure is None or diagnosis.search is None:
        return ()
    found, first = diagnosis.structure, diagnosis.search.first
    lacks = {row.laws: 0.5 * row.lacks for row in found.trials}
    causes = []
    for law in found.laws:
        members = [_structural_member((law,), 0.0)]
        # Structures that do as well without this law have others in its place.
        for laws in found.alternatives:
            if law not in laws:
                instead = tuple(other for other in laws if other not in found.laws)
                members.append(_structural_member(instead, lacks.get(laws, 0.0)))
        causes.append(
            CauseSummary(
                members=tuple(members),
                parameters=(),
                p_value=p_value_of_score(first, math.sqrt(found.likelihood_ratio)),
                delta_loglik=0.5 * found.likelihood_ratio,
                named=diagnosis.explained,
                joint=None,
                structural=True,
                families=families_of((member.effect for member in members), RIG_FAMILIES),
            )
        )
    return tuple(causes)


def _structural_member(laws: tuple[str, ...], lacks: float) -> CauseMember:
    sentence = structure_sentence(laws)
    return CauseMember(
        effect=" + ".join(laws) or "own_structure",
        size=1.0,
        deviation=0.0,
        low=1.0,
        high=1.0,
        lacks_loglik=lacks,
        sentence=sentence,
        phrase=sentence,
    )


def _structures(diagnosis: Diagnosis) -> tuple[StructureRow, ...]:
    if not isinstance(diagnosis, RigDiagnosis) or diagnosis.structure is None:
        return ()
    return tuple(
        StructureRow(
            laws=row.laws,
            structure=row.text,
            effects=row.effects,
            n=row.ground,
            lacks_loglik=0.5 * row.lacks,
            holdout_gain=row.holdout_gain,
        )
        for row in diagnosis.structure.trials
    )


def _structure_name(diagnosis: Diagnosis) -> str | None:
    if not isinstance(diagnosis, RigDiagnosis) or diagnosis.structure is None:
        return None
    return structure_text(diagnosis.structure.structure)


def _cause(diagnosis: Diagnosis, k: int) -> CauseSummary:
    cause = diagnosis.causes[k]
    return CauseSummary(
        members=tuple(_member(one) for one in cause.alternatives),
        parameters=_parameters(cause),
        p_value=cause.p_value,
        delta_loglik=0.5 * cause.likelihood_ratio,
        named=diagnosis.identifiable[k],
        joint=None if diagnosis.joint is None else _joint(diagnosis.joint, k),
        families=families_of(
            (one.candidate.effect for one in cause.alternatives),
            RIG_FAMILIES if isinstance(diagnosis, RigDiagnosis) else DRIVE_FAMILIES,
        ),
        adequate=not (isinstance(diagnosis, VehicleDiagnosis) and diagnosis.inadequate[k]),
    )


def _member(one: Alternative) -> CauseMember:
    effect = EFFECTS[one.candidate.effect]
    low, high = one.size - _Z * one.deviation, one.size + _Z * one.deviation
    sentence = effect.describe(one.size)
    return CauseMember(
        effect=effect.id,
        size=one.size,
        deviation=one.deviation,
        low=low,
        high=high,
        lacks_loglik=0.5 * one.likelihood_ratio,
        sentence=sentence,
        phrase=f"{sentence} (95 %: {interval_text(effect, low, high)})",
    )


def _parameters(cause: Cause) -> tuple[Parameter, ...]:
    best = cause.best
    effect, member = EFFECTS[best.candidate.effect], _member(best)
    size = Parameter(
        name=effect.size.name, value=best.size, low=member.low, high=member.high, unit=effect.size.unit
    )
    places = (
        Parameter(
            name=other.name, value=best.candidate.place[other.name], low=None, high=None, unit=other.unit
        )
        for other in effect.others
    )
    return size, *places


def _joint(joint: JointSizes, k: int) -> JointEstimate:
    size, reach = float(joint.sizes[k]), _Z * float(joint.deviations[k])
    return JointEstimate(
        value=size,
        low=size - reach,
        high=size + reach,
        kept=float(joint.kept[k]),
        alike=float(joint.correlations[k].max()),
    )


def _extension(diagnosis: Diagnosis) -> tuple[tuple[str, dict[str, float]], ...]:
    fit = diagnosis.model
    if not diagnosis.stated or fit is None:
        return ()
    pairs = zip(fit.candidates, fit.sizes, strict=True)
    return tuple((candidate.effect, candidate.values(float(size))) for candidate, size in pairs)


# ------------------------------------------------------------------ what remains


def _unknown_input(rest: UnmodelledForce) -> UnknownInput:
    size = float(np.sqrt(max(np.average(rest.force**2, weights=1.0 / rest.deviation**2), 0.0)))
    if isinstance(rest, RigRest):
        phrase = f"a residual of about {size:.3g} {rest.unit} in the {rest.equation.replace('_', ' ')}"
    else:
        unit = "N m" if rest.equation == "yaw" else "N"
        phrase = f"an unknown input of about {size:.3g} {unit} in the {rest.equation} equation"
    shapes = tuple(
        UnknownInputShape(quantity=shape.quantity, correlation=shape.correlation, slope=shape.slope)
        for shape in rest.shapes
    )
    return UnknownInput(
        equation=rest.equation,
        p_value=rest.p_value,
        excess=rest.excess,
        phrase=phrase + correlation_phrase(shapes),
        shapes=shapes,
    )


def _next_experiment(
    advised: str | None, evidence: Evidence | None, *, unexplained: bool
) -> NextExperiment | None:
    """Advice by rule where a discrepancy remains; else the best of the simulated menu, where there is one."""
    plan = None if evidence is None else evidence.advice
    if plan is None:
        return None if advised is None else NextExperiment(sentence=advised)
    if advised is not None and unexplained:
        return NextExperiment(sentence=advised, alternative=plan.sentence, plan=plan)
    return NextExperiment(sentence=plan.sentence, alternative=advised, plan=plan, planned=True)


# ------------------------------------------------------------------ scores and soil


def _scores(diagnosis: Diagnosis) -> tuple[Score, ...]:
    """All effects that were sought, strongest first, then those that these data cannot test."""
    if diagnosis.search is None:
        return ()
    first, vehicle = diagnosis.search.first, diagnosis.search.nominal.runs[0].setup.plant.vehicle
    strongest: dict[str, float] = {}
    for candidate, z in zip(first.candidates, np.abs(first.z), strict=True):
        strongest[candidate.effect] = max(strongest.get(candidate.effect, 0.0), float(z))
    # Limits with the causes in the model, on a rig, do not cover the causes themselves.
    limits = {**first.limits(), **diagnosis.limits}
    found = []
    for name, z in strongest.items():
        limit, reason = limits[name], ""
        if not math.isfinite(limit):
            reason = "not excited in these runs"
        elif name in diagnosis.not_testable:
            most = amount(name, EFFECTS[name].plausible(vehicle))
            reason = f"detectable from {amount(name, limit)} only; more than {most} is not plausible"
        found.append(Score(effect=name, z=z, limit=limit, reason=reason))
    for name, channels in diagnosis.missing.items():
        found.append(Score(effect=name, z=0.0, limit=math.inf, reason=f"the log has no {channels}"))
    for name, what in diagnosis.not_judged.items():
        found.append(Score(effect=name, z=0.0, limit=math.inf, reason=f"unknown in the log: {what}"))
    return tuple(sorted(found, key=lambda score: (score.reason != "", -score.z)))


def _estimate(value: float, deviation: float) -> Estimate:
    return Estimate(
        value=float(value),
        deviation=float(deviation),
        low=float(value - _Z * deviation),
        high=float(value + _Z * deviation),
    )


def _sinkage_exponent(diagnosis: Diagnosis) -> SinkageExponent | None:
    if diagnosis.search is None:
        return None
    nominal = diagnosis.search.nominal
    soil = nominal.runs[0].setup.plant.soil
    if soil.rigid > 0.5:
        return None
    after = {
        one.candidate.effect: _estimate(soil.n + one.ground, one.ground_deviation)
        for cause in diagnosis.causes
        for one in cause.alternatives
    }
    before = _estimate(soil.n + nominal.nuisances[0], nominal.deviations()[0])
    best = after[diagnosis.causes[0].best.candidate.effect] if diagnosis.causes else before
    agreed = all(best.low <= entry.value <= best.high for entry in after.values())
    return SinkageExponent(
        prior=float(soil.n),
        before=before,
        after=after,
        single=best if agreed and not diagnosis.incomplete else None,
        wide=_wide(diagnosis),
    )


def _wide(diagnosis: Diagnosis) -> Estimate | None:
    """n of the fitted model with the interval by the slip angles that are left out."""
    if not isinstance(diagnosis, RigDiagnosis) or diagnosis.checks is None or diagnosis.model is None:
        return None
    values = diagnosis.checks.ground_by_blocks
    deviation = jackknife_deviation(values)
    if not math.isfinite(deviation):
        return None
    model, reach = diagnosis.model, student.ppf(0.975, len(values) - 1) * deviation
    value = float(model.runs[0].setup.plant.soil.n + model.nuisances[0])
    return Estimate(value=value, deviation=deviation, low=float(value - reach), high=float(value + reach))


def _noise_memory(model: FitResult | None) -> dict[str, int] | None:
    if model is None:
        return None
    return model.noise.orders
