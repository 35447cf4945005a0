"""All effects, found by their files, and the compiled laws of all of them in one.

Every module below this package that holds an ``EFFECT``, or a ``TABLE`` of them, is part of the library: a
new law is a new file, a new shift of a number is a new row.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from offroad_env.effects.protocol import Effect, Setup, Values
from offroad_env.errors import InvalidParameter
from offroad_env.physics import hooks
from offroad_env.physics._jit import part_kernel
from offroad_env.physics.records import FloatArray

__all__ = ["EFFECTS", "FORMER_IDS", "apply", "find_effect"]

_PACKAGE = "offroad_env.effects"
#: Hook of an effect -> argument of `hooks.install`.
_HOOKS = {"soil state": "soil", "wheel force": "wheel", "suspension": "load", "body force": "body"}


def _effects_of(module: ModuleType) -> tuple[Effect, ...]:
    """Effects that a module defines.

    Raises
    ------
    InvalidParameter
        If a file with one law does not have the name of its effect.
    """
    effect: Effect | None = getattr(module, "EFFECT", None)
    if effect is None:
        return getattr(module, "TABLE", ())
    if effect.id != module.__name__.rpartition(".")[2]:
        raise InvalidParameter(f"effect {effect.id!r} must stand in the file {effect.id}.py")
    return (effect,)


def _first_id(effect: Effect) -> str:
    """The id under which an effect entered the library."""
    return effect.former_ids[0] if effect.former_ids else effect.id


def _find() -> dict[str, Effect]:
    """Effects by id, in the order of their first ids: rows of laws and ties of a search depend on it."""
    modules = pkgutil.walk_packages([str(Path(__file__).parent)], f"{_PACKAGE}.")
    names = [module.name for module in modules if not module.ispkg]
    effects = [effect for name in names for effect in _effects_of(importlib.import_module(name))]
    found: dict[str, Effect] = {}
    for effect in sorted(effects, key=_first_id):
        if effect.id in found:
            raise InvalidParameter(f"two effects have the id {effect.id!r}")
        found[effect.id] = effect
    return found


#: The library by id.
EFFECTS: dict[str, Effect] = _find()

#: Id in files of older versions -> id today. A former id may name another law today (`slip_sinkage`).
FORMER_IDS: dict[str, str] = {
    former: name for name, effect in EFFECTS.items() for former in effect.former_ids
}

_ROWS = {name: row for row, name in enumerate(name for name, e in EFFECTS.items() if e.law is not None)}


def _unchanged(effects: FloatArray, passed: Any, a: Any, b: Any) -> Any:
    return passed


def _chained(before: Callable[..., Any], law: Callable[..., Any], row: int) -> Callable[..., Any]:
    """The laws before, and then this one where its row is active."""

    def chained(effects: FloatArray, passed: Any, a: Any, b: Any) -> Any:
        result = before(effects, passed, a, b)
        if effects[row, 0] > 0.5:
            result = law(result, effects[row, 1:], a, b)
        return result

    return part_kernel(chained)


def _composed(hook: str) -> Callable[..., Any]:
    """All laws of a hook, one after the other."""
    laws = part_kernel(_unchanged)
    for name, row in _ROWS.items():
        law = EFFECTS[name].law
        if law is not None and EFFECTS[name].hook == hook:
            laws = _chained(laws, law, row)
    return laws


hooks.install(**{name: _composed(hook) for hook, name in _HOOKS.items()})


def find_effect(name: str) -> Effect:
    """The effect of this id, or of this former id where no effect has it today.

    Raises
    ------
    InvalidParameter
        If there is none.
    """
    known = name if name in EFFECTS else FORMER_IDS.get(name)
    if known is None:
        raise InvalidParameter(f"no effect {name!r}; known: {', '.join(EFFECTS)}")
    return EFFECTS[known]


def apply(setup: Setup, effects: Iterable[tuple[str, Values]]) -> Setup:
    """The setup with these effects, one after the other; a size at its off-value changes nothing.

    Raises
    ------
    InvalidParameter
        For an unknown effect, a missing or unknown parameter, a number out of range, or a model in
        which the effect means nothing.
    """
    for name, values in effects:
        effect = find_effect(name)
        _check(effect, setup, values)
        size = values[effect.size.name]
        if size != effect.size.off:
            if effect.change is None:
                setup = _with_law(setup, effect, values)
            else:
                setup = effect.change(setup, size, *(values[other.name] for other in effect.others))
    return setup


def _check(effect: Effect, setup: Setup, values: Values) -> None:
    names = [parameter.name for parameter in effect.parameters]
    if set(values) != set(names):
        former = EFFECTS.get(FORMER_IDS.get(effect.id, ""))
        hint = f" - {former.id} had this id before" if former and former.size.name in values else ""
        raise InvalidParameter(f"effect {effect.id} takes {', '.join(names)}, got {', '.join(values)}{hint}")
    for parameter in effect.parameters:
        parameter.check(values[parameter.name], effect.id)
    if setup.model not in effect.models:
        raise InvalidParameter(f"effect {effect.id} means nothing in the {setup.model} model")
    if effect.soil_only and setup.plant.soil.rigid > 0.5:
        raise InvalidParameter(f"effect {effect.id} means nothing on hard ground")
    if effect.tyres_only and (setup.plant.structure is None or setup.plant.structure.tyre is None):
        raise InvalidParameter(f"effect {effect.id} means nothing on rigid rims")
    if effect.hard_only and setup.plant.soil.rigid < 0.5:
        raise InvalidParameter(f"effect {effect.id} means nothing on soil")


def _with_law(setup: Setup, effect: Effect, values: Values) -> Setup:
    plant = setup.plant
    rows = np.zeros((len(_ROWS), hooks.ROW)) if plant.effects is None else plant.effects.copy()
    rows[_ROWS[effect.id]] = 0.0
    numbers = [values[parameter.name] for parameter in effect.parameters]
    rows[_ROWS[effect.id], : len(numbers) + 1] = (1.0, *numbers)
    return replace(setup, plant=plant._replace(effects=rows))
