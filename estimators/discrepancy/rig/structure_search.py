"""Which laws the wheel of a rig follows: structures compared with the effects that each of them needs.

A law of the wheel is a choice, not a size: no derivative leads from one to another, and what is missing under
one law is another effect than under the next. So the search for effects runs again under other laws, and the
models that come out compete: on the fitted conditions with a penalty for each law and effect, and on the
conditions of the hold-out test.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.rig.fit import fit_rig
from estimators.discrepancy.rig.search import deviance, holdout_gain, pruned, search_rig, without_stand_ins
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
from estimators.discrepancy.search.result import EQUIVALENT, SearchResult
from offroad_env.errors import OffroadError
from offroad_env.physics.records import Structure
from offroad_env.world.structures import LAWS, make_structure, structure_laws, structure_text

__all__ = ["STRUCTURAL_CAUSES", "StructuralCause", "StructureTrial", "search_structures"]

#: Cause -> the choice of `offroad_env.world.structures.LAWS` that is another than the log's. A single wheel
#: runs on virgin soil, without ruts; its slip sinkage is an effect, which counts slip across the wheel, too.
STRUCTURAL_CAUSES: Mapping[str, str] = MappingProxyType(
    {
        "pressure_distribution": "pressure_from",
        "pressure_direction": "pressure_direction",
        "soil_frame_shear": "shear",
        "shear_strengths": "strength",
        "effective_width": "width",
    }
)
#: Structures that get a search of their own: the most promising with the effects of the first one.
_SEARCHED = 3
#: Most laws that a structure may change.
_MOST_LAWS = 4


@dataclass(frozen=True, kw_only=True)
class StructureTrial:
    """A structure that was compared."""

    laws: tuple[str, ...]  #: causes that it stands for, of `STRUCTURAL_CAUSES`; empty for the log's own
    text: str  #: as `offroad_env.world.structures.read_structure` takes it
    effects: tuple[str, ...]  #: that its best model has
    ground: float  #: n fitted [-]
    lacks: float  #: penalised twice the log-likelihood less than that of the best structure
    holdout_gain: float | None  #: over the log's own structure on the hold-out conditions, if searched


@dataclass(frozen=True, kw_only=True)
class StructuralCause:
    """Laws of the wheel that are not those of the log's model."""

    laws: tuple[str, ...]  #: causes, of `STRUCTURAL_CAUSES`
    alternatives: tuple[tuple[str, ...], ...]  #: other sets of laws that explain the trials as well
    structure: Structure
    likelihood_ratio: float  #: penalised twice the log-likelihood gained over the log's own structure
    trials: tuple[StructureTrial, ...]  #: all that were compared, best first

    @property
    def ambiguous(self) -> bool:
        """Whether a structure without one of these laws explains the trials as well."""
        return any(not set(self.laws) <= set(other) for other in self.alternatives)


@dataclass(frozen=True, kw_only=True)
class _Model:
    """A structure with a fitted model."""

    laws: tuple[str, ...]
    fit: FitResult
    found: SearchResult | None = None  #: of a search of its own

    @property
    def run(self) -> RigModel:
        return trials_of(self.fit.runs)

    def penalised(self, penalty: float) -> float:
        """Twice minus the log-likelihood, and the price of laws and effects."""
        return deviance(self.fit) + penalty * (len(self.laws) + len(self.fit.candidates))


def search_structures(
    found: SearchResult,
    library: Sequence[str],
    rate: float,
    apart: RigModel | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> tuple[SearchResult, StructuralCause | None]:
    """The search's result under the laws of the wheel that explain the trials best.

    Parameters
    ----------
    found
        Of `search_rig` under the laws of the log.
    library, rate, apart, progress
        As for `search_rig`.

    Returns
    -------
    SearchResult
        With the nominal model and the first scores of ``found``.
    StructuralCause or None
        None where the log's own laws do as well.
    """
    own = _Model(laws=(), fit=found.extended, found=found)
    penalty = found.threshold**2
    models = [own]
    for laws in _choices(own.run):
        progress("structures")
        model = _carried(own, laws, found.threshold)
        if model is not None:
            models.append(model)
    models.sort(key=lambda model: model.penalised(penalty))
    searched = [own]
    for model in [one for one in models if one.laws][:_SEARCHED]:
        progress(", ".join(model.laws))
        result = _searched(model, library, rate, apart)
        if result is not None and _confirmed(own, result, apart):
            searched.append(result)
            models[models.index(model)] = result
    best = min(searched, key=lambda model: model.penalised(penalty))
    gain = own.penalised(penalty) - best.penalised(penalty)
    if not best.laws or best.found is None or gain < EQUIVALENT:
        return found, None
    close = [
        m for m in searched if m is not best and m.penalised(penalty) - best.penalised(penalty) < EQUIVALENT
    ]
    cause = StructuralCause(
        laws=best.laws,
        alternatives=tuple(model.laws for model in close),
        structure=_structure_of(best.run),
        likelihood_ratio=gain,
        trials=_table(own, models, best.penalised(penalty), penalty, apart),
    )
    extended = replace(
        best.found,
        nominal=found.nominal,
        first=found.first,
        threshold=found.threshold,
        holdout_gains=found.holdout_gains + best.found.holdout_gains,
    )
    return extended, cause


def _structure_of(run: RigModel) -> Structure:
    """The structure of a run, also of the two models that have wheels of their own."""
    if run.structure is not None:
        return run.structure
    return make_structure("full" if run.setup.plant.resultant > 0.5 else "paper")


def _changed(structure: Structure, laws: Sequence[str]) -> Structure:
    """The structure with the other option of the choices behind these causes."""
    chosen = structure_laws(structure)
    for cause in laws:
        choice = STRUCTURAL_CAUSES[cause]
        first, second, *_ = LAWS[choice]
        chosen[choice] = second if chosen[choice] == first else first
    return make_structure(
        elastic_modulus=structure.elastic_modulus,
        slip_sinkage_rate=structure.slip_sinkage_rate,
        damping=structure.damping,
        grouser_height=structure.grouser_height,
        **chosen,
    )


def _choices(run: RigModel) -> list[tuple[str, ...]]:
    """Sets of laws that are compared."""
    # A modulus without k_c does not know the width of the wheel.
    causes = [
        name for name in STRUCTURAL_CAUSES if name != "effective_width" or run.setup.plant.soil.k_c > 0.0
    ]
    return [laws for count in range(1, _MOST_LAWS + 1) for laws in combinations(causes, count)]


def _carried(own: _Model, laws: tuple[str, ...], threshold: float) -> _Model | None:
    """Other laws with those effects of the first model that they still need; None without a solution."""
    try:
        bare = fit_rig(own.run.with_structure(_changed(_structure_of(own.run), laws)))
    except OffroadError:
        return None
    models = [_Model(laws=laws, fit=bare)]
    try:
        fit = without_stand_ins(settled(bare.with_effects(own.fit.candidates, own.fit.sizes)))
        models.append(_Model(laws=laws, fit=pruned(fit, threshold)))
    except OffroadError:
        pass
    return min(models, key=lambda model: model.penalised(threshold**2))


def _searched(model: _Model, library: Sequence[str], rate: float, apart: RigModel | None) -> _Model | None:
    """The structure with a search of its own; None without a solution."""
    try:
        found = search_rig(fit_rig(model.run), library, rate, apart)
    except OffroadError:
        return None
    return _Model(laws=model.laws, fit=found.extended, found=found)


def _confirmed(own: _Model, other: _Model, apart: RigModel | None) -> bool:
    """Whether a structure gains on the conditions of the hold-out test, too."""
    try:
        return apart is None or holdout_gain(own.fit, other.fit, apart) > 0.0
    except OffroadError:
        return False


def _table(
    own: _Model, models: Sequence[_Model], best: float, penalty: float, apart: RigModel | None
) -> tuple[StructureTrial, ...]:
    """All structures, best first."""
    rows = [
        StructureTrial(
            laws=model.laws,
            text=structure_text(_structure_of(model.run)),
            effects=tuple(candidate.effect for candidate in model.fit.candidates),
            ground=float(model.run.setup.plant.soil.n + model.fit.nuisances[0]),
            lacks=model.penalised(penalty) - best,
            holdout_gain=None
            if apart is None or model.found is None or model is own
            else holdout_gain(own.fit, model.fit, apart),
        )
        for model in models
    ]
    return tuple(sorted(rows, key=lambda row: row.lacks))
