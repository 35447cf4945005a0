"""All effects, found by their files, and the compiled laws of all of them in one.

Every module of this package that holds an ``EFFECT`` is part of the library: a new effect is a new file.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np

from offroad_env.effects.protocol import Effect, Setup, Values
from offroad_env.errors import InvalidParameter
from offroad_env.physics import hooks

__all__ = ["EFFECTS", "apply", "find_effect"]

_PACKAGE = "offroad_env.effects"
#: Hook of an effect -> argument of `hooks.install`.
_HOOKS = {"soil state": "soil", "wheel force": "wheel", "suspension": "load", "body force": "body"}


def _find() -> dict[str, Effect]:
    found = {}
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        effect = getattr(importlib.import_module(f"{_PACKAGE}.{module.name}"), "EFFECT", None)
        if effect is not None:
            if effect.id != module.name:
                raise InvalidParameter(f"effect {effect.id!r} must stand in the file {effect.id}.py")
            found[effect.id] = effect
    return found


#: The library by id.
EFFECTS: dict[str, Effect] = _find()

_ROWS = {name: row for row, name in enumerate(name for name, e in EFFECTS.items() if e.law is not None)}


def _compiled(function: Callable) -> Callable:
    """Inlined and not cached by itself: the models that it becomes part of are."""
    if numba.config.DISABLE_JIT:
        return function
    return numba.njit(function, forceinline=True, error_model="numpy", fastmath={"contract"})


def _nothing_two(effects, passed, a, b):
    return passed


def _nothing_three(effects, passed, a, b, c):
    return passed


def _chain_two(before: Callable, law: Callable, row: int) -> Callable:
    def chained(effects, passed, a, b):
        result = before(effects, passed, a, b)
        if effects[row, 0] > 0.5:
            result = law(result, effects[row, 1:], a, b)
        return result

    return _compiled(chained)


def _chain_three(before: Callable, law: Callable, row: int) -> Callable:
    def chained(effects, passed, a, b, c):
        result = before(effects, passed, a, b, c)
        if effects[row, 0] > 0.5:
            result = law(result, effects[row, 1:], a, b, c)
        return result

    return _compiled(chained)


def _composed(hook: str) -> Callable:
    wheel = hook == "wheel force"
    laws = _compiled(_nothing_three if wheel else _nothing_two)
    for name, row in _ROWS.items():
        if EFFECTS[name].hook == hook:
            laws = (_chain_three if wheel else _chain_two)(laws, EFFECTS[name].law, row)
    return laws


hooks.install(**{name: _composed(hook) for hook, name in _HOOKS.items()})


def find_effect(name: str) -> Effect:
    """The effect of this id.

    Raises
    ------
    InvalidParameter
        If there is none.
    """
    if name not in EFFECTS:
        raise InvalidParameter(f"no effect {name!r}; known: {', '.join(EFFECTS)}")
    return EFFECTS[name]


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
        if values[effect.size.name] == effect.size.off:
            continue
        setup = _with_law(setup, effect, values) if effect.law is not None else effect.change(setup, values)
    return setup


def _check(effect: Effect, setup: Setup, values: Values) -> None:
    names = [parameter.name for parameter in effect.parameters]
    if set(values) != set(names):
        raise InvalidParameter(f"effect {effect.id} takes {', '.join(names)}, got {', '.join(values)}")
    for parameter in effect.parameters:
        value = values[parameter.name]
        if not parameter.low <= value <= parameter.high:
            allowed = f"[{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
            raise InvalidParameter(f"{effect.id}: {parameter.name} must be in {allowed}, got {value:g}")
    if setup.model not in effect.models:
        raise InvalidParameter(f"effect {effect.id} means nothing in the {setup.model} model")
    if effect.soil_only and setup.plant.soil.rigid > 0.5:
        raise InvalidParameter(f"effect {effect.id} means nothing on hard ground")
    if effect.hard_only and setup.plant.soil.rigid < 0.5:
        raise InvalidParameter(f"effect {effect.id} means nothing on soil")


def _with_law(setup: Setup, effect: Effect, values: Values) -> Setup:
    plant = setup.plant
    rows = np.zeros((len(_ROWS), hooks.ROW)) if plant.effects is None else plant.effects.copy()
    rows[_ROWS[effect.id]] = 0.0
    numbers = [values[parameter.name] for parameter in effect.parameters]
    rows[_ROWS[effect.id], : len(numbers) + 1] = (1.0, *numbers)
    return replace(setup, plant=plant._replace(effects=rows))
