"""Structure as a cause: other laws of wheel and soil, or four wheels with roll, on windows kept apart.

A structure has no size that could be fitted, so none is a small step from the nominal model, and single steps
can make a fit worse (shear that stays in the soil without ruts to carry it). Presets are therefore tried
whole, each with its own n; the best is pruned by putting its laws back one by one. Everything is judged by
the open-loop errors of `estimators.replay` on every second window, while n is fitted to the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from estimators.discrepancy.checks.holdout_gain import ChannelGain
from estimators.discrepancy.structure_trials import FLOORS, StructureTrial, Trials
from estimators.discrepancy.tyre_trials import has_tyre, near_on_tyres, on_rigid_rims, on_tyres
from estimators.logs.log import Log
from estimators.replay.structures import Case
from offroad_env.effects.protocol import Setup
from offroad_env.errors import DataError
from offroad_env.world.structures import STRUCTURES

__all__ = [
    "ADEQUATE",
    "STRUCTURAL_CAUSES",
    "StructuralCause",
    "StructureComparison",
    "StructureTrial",
    "compare_structures",
    "gains_with",
]

#: Structural causes: what the vehicle or the soil does that the nominal model does not.
STRUCTURAL_CAUSES: Mapping[str, str] = MappingProxyType(
    {
        "pressure_direction": "pressure acts along the ground's normal, so that compaction loads the torque",
        "pressure_distribution": (
            "contact ends where the soil's own sinkage ends it, not at the angles of Wong and Reece"
        ),
        "soil_frame_shear": "shear grows along the path of the wheel in the soil",
        "ruts": "rear wheels run in ruts that the front wheels have compacted and sheared",
        "effective_width": "pressure follows the width of the whole contact patch",
        "slip_sinkage": "slip digs wheels in",
        "shaft_torque": "torques act on the wheels without a reaction on the body",
        "four_wheels_and_roll": "four wheels bear their own loads, and the body rolls",
        "flexible_tyre": "tyres flatten under their load and bear along the ground's normal",
    }
)
#: Law by cause, and what must go with it where the law is put back.
_LAWS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "pressure_direction": {"pressure_direction": "rim_normal"},
        "pressure_distribution": {"pressure_from": "wong_reece", "ruts": "none"},
        "soil_frame_shear": {"shear": "wheel_frame", "ruts": "pressure"},
        "ruts": {"ruts": "none"},
        "effective_width": {"width": "rim"},
        "slip_sinkage": {"slip_sinkage": "none"},
        "shaft_torque": {"shaft_torque": "reacted"},
    }
)
#: Presets that are tried whole, besides the nominal structure, and models of the vehicle.
_PRESETS, _VEHICLES = ("grid", "field"), ("half_car", "four_wheel")
_FOUR = "four_wheels_and_roll"
_TYRE = "flexible_tyre"
#: Laws without which there is no tyre: they are part of it.
_OF_TYRES = ("pressure_direction", "pressure_distribution")
#: A preset is looked at closely if it costs this much less than the nominal structure.
_WORTH = 0.3
#: A structure is named if errors fall by this share of themselves at least (mean logarithm over channels),
#: with this p-value over the windows apart, of which there must be so many.
_GAIN, _P_VALUE, _WINDOWS = 0.35, 1e-2, 3
#: Share of that gain, in the fitted windows, from which all models of the vehicle are tried.
_ONWARD = 0.25
#: A law stays if errors grow by this mean logarithm without it, and is named with this p-value.
_LOSS, _LOSS_P = 0.03, 0.01
#: Errors that differ by less than this share (mean logarithm over channels) do not decide between a structure
#: and effects.
_AS_GOOD = 0.1
#: A structure whose errors exceed those with effects by this mean logarithm over channels, with any n, is not
#: looked at closely: in windows apart it would not come within `_AS_GOOD`.
_BEHIND = 0.4


#: Largest errors of a structure that is named, over `FLOORS`: drives of another simulator leave 1.1 to 2.5,
#: laws that no structure here resembles (a friction circle, described as sand) 5.8.
ADEQUATE = 4.0
#: Errors that rigid rims on natural soil leave, up to which tyres are not tried, and the mean logarithm that
#: these must take from larger ones.
_RIGID, _TYRES = 2.0, 0.15


@dataclass(frozen=True, kw_only=True)
class StructuralCause:
    """A part of the structure that the nominal model lacks."""

    id: str  #: of `STRUCTURAL_CAUSES`
    gain: float  #: share by which errors grow without it
    p_value: float

    @property
    def sentence(self) -> str:
        """What it is."""
        return STRUCTURAL_CAUSES[self.id]


@dataclass(frozen=True, kw_only=True)
class StructureComparison:
    """Outcome of the comparison of structures."""

    nominal: StructureTrial
    best: StructureTrial
    trials: tuple[StructureTrial, ...]  #: presets, best first
    equals: tuple[Case, ...]  #: presets that are as good
    causes: tuple[StructuralCause, ...]  #: empty where the nominal structure is adequate
    gain: float  #: share by which the errors fall
    p_value: float
    n: float  #: with the best structure [-]
    gains: tuple[ChannelGain, ...]  #: by channel, on windows apart
    #: Share by which errors fall from those of the nominal structure as fitted; None if that is not known.
    gain_over_effects: float | None = None
    adequate_nominal: bool = False  #: whether nothing else shows that the nominal structure is wrong

    @property
    def found(self) -> bool:
        """Whether another structure is named.

        Effects of the nominal one must not predict better. They must predict worse where the other one does
        not predict well either; where nothing else shows that the nominal one is wrong, so must its numbers
        as fitted.
        """
        least = _AS_GOOD if self.adequate_nominal or not self.adequate else -_AS_GOOD
        return bool(self.causes) and (self.gain_over_effects is None or self.gain_over_effects > least)

    @property
    def undecided(self) -> bool:
        """Whether effects and another structure predict equally well, and neither does it well."""
        if not self.causes or self.gain_over_effects is None or self.adequate or self.adequate_nominal:
            return False
        return -_AS_GOOD < self.gain_over_effects <= _AS_GOOD

    @property
    def misfit(self) -> float:
        """Errors of the best structure over `FLOORS`, geometric mean over windows and channels."""
        return self.best.misfit

    @property
    def adequate(self) -> bool:
        """Whether the best structure predicts the runs, not only better than a nominal one that does not."""
        return self.misfit <= ADEQUATE

    @property
    def tied(self) -> bool:
        """Whether the nominal structure with effects predicts as well, so that neither is certain."""
        return self.found and self.gain_over_effects is not None and self.gain_over_effects < _AS_GOOD

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "found": self.found,
            "tied": self.tied,
            "misfit": self.misfit,
            "adequate": self.adequate,
            "structure": self.best.case.structure,
            "vehicle_model": self.best.case.vehicle_model,
            "n": self.n,
            "n_nominal": self.n - self.best.change + self.nominal.change,
            "gain": self.gain,
            "gain_over_effects": self.gain_over_effects,
            "p": self.p_value,
            "causes": [
                {"id": one.id, "gain": one.gain, "p": one.p_value, "sentence": one.sentence}
                for one in self.causes
            ],
            "equally_good": [
                {"structure": c.structure, "vehicle_model": c.vehicle_model} for c in self.equals
            ],
            "trials": [
                {
                    "structure": one.case.structure,
                    "vehicle_model": one.case.vehicle_model,
                    "change_of_n": one.change,
                    "error": dict(zip(FLOORS, one.pooled, strict=True)),
                }
                for one in (self.nominal, *self.trials)
            ],
        }


def compare_structures(
    logs: Sequence[Log], setups: Sequence[Setup] | None = None, *, adequate_nominal: bool = False
) -> StructureComparison | None:
    """Whether another structure predicts these runs better than the nominal one can with any n.

    None where it cannot be compared: on hard ground, by the paper's model, without torques at the wheels or
    positions, or with too few windows; and where no other is near what the nominal one predicts with effects.

    Parameters
    ----------
    setups
        The runs with the effects that were found, and numbers as fitted: a structure must predict better than
        these, too. Default: they are not known.
    adequate_nominal
        Whether nothing else shows that the nominal structure is wrong: then a tie speaks for it.
    """
    first = logs[0].config
    if first.model != "full" or first.soil.rigid > 0.5:
        return None
    try:
        trials = Trials(logs)
    except DataError:
        return None
    if int((~trials.fitted).sum()) < _WINDOWS:
        return None
    own = Case(first.structure, _VEHICLES[0])
    effects = None if setups is None else trials.with_effects(own, setups)
    rivalled = effects is None or _rivalled(trials, effects)
    if effects is not None and not rivalled and effects.misfit <= _RIGID:
        return None
    nominal = trials.best(own)
    found = _presets(trials, nominal) if rivalled else []
    found = _with_tyres(trials, logs[0], nominal if effects is None else effects, nominal, found)
    if not found:
        return None
    best = found[0]
    gain, p_value = trials.apart(nominal, best)
    causes: tuple[StructuralCause, ...] = ()
    equals: tuple[Case, ...] = ()
    if _named(trials, nominal, best):
        equals = tuple(one.case for one in found[1:] if not _worse(trials, one, best))
        best, causes = _pruned(trials, nominal, best)
        gain, p_value = trials.apart(nominal, best)
    over: float | None = None
    if causes and effects is not None:
        over = 1.0 - math.exp(-trials.apart(effects, best)[0])
    return StructureComparison(
        nominal=nominal,
        best=best,
        trials=tuple(found),
        equals=equals,
        causes=causes,
        gain=1.0 - math.exp(-gain),
        p_value=p_value,
        n=trials.stated + best.change,
        gains=trials.gains(nominal, best),
        gain_over_effects=over,
        adequate_nominal=adequate_nominal,
    )


def _named(trials: Trials, nominal: StructureTrial, best: StructureTrial) -> bool:
    """Whether a structure predicts so much better than the nominal one that it is the better model."""
    gain, p_value = trials.apart(nominal, best)
    return gain > _GAIN and p_value < _P_VALUE and trials.inside(best)


def _with_tyres(
    trials: Trials,
    log: Log,
    known: StructureTrial,
    nominal: StructureTrial,
    found: list[StructureTrial],
) -> list[StructureTrial]:
    """The presets with those on tyres before them, where these take much of what rigid rims leave.

    Parameters
    ----------
    known
        The nominal structure with effects, or without where they are not known.
    found
        Presets on rigid rims, best first.
    """
    rigid = [known, *(one for one in found[:1] if _named(trials, nominal, one))]
    best = min(rigid, key=lambda one: one.misfit)
    if best.misfit <= _RIGID or not near_on_tyres(trials, log, trials.cost(best) + _BEHIND * len(FLOORS)):
        return found
    tyres = on_tyres(trials, log)
    gain, _ = trials.apart(best, tyres[0])
    # Of a short drive few windows are apart, and two numbers cannot make up what tyres gain in the others.
    _, p_value = trials.apart(best, tyres[0], everywhere=True)
    better = gain > _TYRES and p_value < _P_VALUE and trials.inside(tyres[0])
    return [*tyres, *found] if better and tyres[0].misfit <= ADEQUATE else found


def _rivalled(trials: Trials, effects: StructureTrial) -> bool:
    """Whether a preset comes near the nominal structure with effects, with any n."""
    most = trials.cost(effects) + _BEHIND * len(FLOORS)
    half, four = _VEHICLES
    cases = [Case(name, half) for name in _PRESETS if name != effects.case.structure]
    near = Case(effects.case.structure, four)
    return any(trials.reaches(case, most) for case in cases) or trials.reaches(near, most, effects.change)


def _presets(trials: Trials, nominal: StructureTrial) -> list[StructureTrial]:
    """The presets, best first; with their best n only where one of them looks better than the nominal.

    With four wheels, which cost most, only where a quarter of what a structure must gain is gained without.
    """
    half, four = _VEHICLES
    names = [name for name in _PRESETS if name != nominal.case.structure]
    found = [trials.coarse(Case(name, half)) for name in names]
    found.append(trials.near(Case(nominal.case.structure, four), nominal.change))
    if min(map(trials.cost, found)) < trials.cost(nominal) - _WORTH:
        found = [trials.best(one.case, start=one.change) for one in found]
        if min(map(trials.cost, found)) < trials.cost(nominal) - _ONWARD * _GAIN * len(FLOORS):
            found += [trials.best(Case(one.case.structure, four), start=one.change) for one in found[:-1]]
    return sorted(found, key=trials.cost)


def gains_with(found: StructureComparison, log: Log) -> tuple[ChannelGain, ...]:
    """Errors of the nominal and of the other structure by channel on another run; nothing is fitted.

    Raises
    ------
    DataError
        If the run is too short or lacks inputs or pose.
    """
    trials = Trials([log])
    pair = [replace(one, errors=trials.errors(one.case, one.change)) for one in (found.nominal, found.best)]
    trials.fitted[:] = False
    return trials.gains(pair[0], pair[1])


def _worse(trials: Trials, one: StructureTrial, best: StructureTrial) -> bool:
    loss, p_value = trials.apart(one, best)
    return loss > _LOSS and p_value < _LOSS_P


# ------------------------------------------------------------------ pruning


def _parts(case: Case, nominal: Case) -> list[str]:
    """Structural causes by which a case departs from the nominal one."""
    own, usual = (_laws(one.structure) for one in (case, nominal))
    found = [
        cause for cause, laws in _LAWS.items() if own.get(next(iter(laws))) != usual.get(next(iter(laws)))
    ]
    if has_tyre(case.structure) and not has_tyre(nominal.structure):
        found = [_TYRE, *(name for name in found if name not in _OF_TYRES)]
    return found + ([_FOUR] if case.vehicle_model != nominal.vehicle_model else [])


def _laws(structure: str) -> dict[str, str]:
    """Departures of a structure from "full", by law."""
    preset, *changes = structure.split(",")
    named = dict(change.split("=") for change in changes)
    return {
        law: option
        for law, option in {**STRUCTURES[preset], **named}.items()
        if option != _LAWS_PUT_BACK.get(law)
    }


#: Option of every law in the structure "full".
_LAWS_PUT_BACK: Mapping[str, str] = MappingProxyType(
    {law: laws[law] for cause, laws in _LAWS.items() for law in laws if law == next(iter(laws))}
)


def _without(case: Case, cause: str, nominal: Case) -> Case:
    """The case with one cause put back, and with it what needs it."""
    if cause == _FOUR:
        return Case(case.structure, nominal.vehicle_model)
    if cause == _TYRE:
        return Case(on_rigid_rims(case.structure), case.vehicle_model)
    preset, *changes = case.structure.split(",")
    named = dict(change.split("=") for change in changes)
    back = dict(_LAWS[cause])
    if "ruts" in back and named.get("ruts") == "none":
        back["ruts"] = "none"
    return Case(
        ",".join([preset, *(f"{law}={option}" for law, option in {**named, **back}.items())]),
        case.vehicle_model,
    )


def _pruned(
    trials: Trials, nominal: StructureTrial, best: StructureTrial
) -> tuple[StructureTrial, tuple[StructuralCause, ...]]:
    """The best preset, but for laws without which it predicts better, and those that the windows show.

    What makes no difference here stays as the preset has it: its laws belong together, on other soils they
    may all matter, and a law that is put back moves n. It is not named.
    """
    causes: dict[str, StructuralCause] = {}
    for cause in reversed(_parts(best.case, nominal.case)):
        less = _without(best.case, cause, nominal.case)
        trial = trials.near(less, best.change)
        # Both have one n, so that all windows compare them fairly.
        loss, p_value = trials.apart(trial, best, everywhere=True)
        if loss > _LOSS:
            # Another n may make up for what is left out; that of rigid rims is far off.
            trial = trials.best(less, start=None if cause == _TYRE else best.change)
            loss, p_value = trials.apart(trial, best, everywhere=True)
        if loss > _LOSS:
            causes[cause] = StructuralCause(id=cause, gain=math.exp(loss) - 1.0, p_value=p_value)
        elif _worse(trials, best, trial):
            best = trial
    left = _parts(best.case, nominal.case)
    shown = [one for name, one in causes.items() if name in left and one.p_value < _LOSS_P]
    kept = sorted(shown, key=lambda one: -one.gain)
    return best, tuple(kept)
