"""What every named record can do, in compiled kernels and in plain Python alike.

`replace` is ``_replace`` for kernels, which numba does not know; `numbers_of` and `record_from` take a
record apart into one array of numbers and put it together again. None of them lists a field: a new
field of a record is one edit, in its class.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar, get_type_hints

import numba
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.imputils import impl_ret_borrowed, lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic

from offroad_env.physics._kernel_notes import hands_on
from offroad_env.physics.records import FloatArray

__all__ = ["array_count", "number_count", "numbers_of", "record_from", "replace"]

R = TypeVar("R", bound=tuple[Any, ...])


def replace(record: R, **fields: Any) -> R:
    """The same record with other values in these fields.

    A number keeps the type of its field (an int becomes a float): one version of a kernel serves all.
    """
    return record._replace(**fields)  # type: ignore[attr-defined, no-any-return]  # of a NamedTuple


class _Replace(AbstractTemplate):  # type: ignore[misc]  # numba has no types
    """Type of a call of `replace`: field names become parameters, as in the constructor of a record."""

    def generic(self, args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> Any:
        if len(args) != 1 or not isinstance(args[0], types.BaseNamedTuple):
            return None
        record = args[0]
        unknown = sorted(set(kws) - set(record.fields))
        if unknown:
            raise TypingError(f"{record.instance_class.__name__} has no field {', '.join(unknown)}")
        kinds = [
            kind if name not in kws or _is_number(kind) else types.unliteral(kws[name])
            for name, kind in zip(record.fields, record, strict=True)
        ]
        given = inspect.Parameter.POSITIONAL_OR_KEYWORD
        called_with = inspect.Signature([inspect.Parameter(name, given) for name in ("record", *kws)])
        replaced = types.BaseTuple.from_types(kinds, record.instance_class)
        return signature(replaced, record, *kws.values()).replace(pysig=called_with)


def _is_number(kind: types.Type) -> bool:
    return isinstance(kind, (types.Number, types.Boolean))


def _lower_replace(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
    values = cgutils.unpack_tuple(builder, args[0])
    _, *names = sig.pysig.parameters
    for name, value, kind in zip(names, args[1:], sig.args[1:], strict=True):
        place = sig.return_type.fields.index(name)
        values[place] = context.cast(builder, value, kind, sig.return_type[place])
    changed = context.make_tuple(builder, sig.return_type, values)
    return impl_ret_borrowed(context, builder, sig.return_type, changed)


infer_global(replace)(_Replace)
lower_builtin(replace, types.VarArg(types.Any))(_lower_replace)
hands_on(replace)


@cache
def _parts(record_class: type) -> tuple[Any, ...]:
    """Of each field: ``float``, ``bool``, the class of a nested record, or None for an array."""
    hints = get_type_hints(record_class)
    kinds = (hints[name] for name in record_class._fields)  # type: ignore[attr-defined]  # a NamedTuple
    return tuple(kind if kind in (float, bool) or _is_record(kind) else None for kind in kinds)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple)


@cache
def number_count(record_class: type) -> int:
    """How many numbers a record has, those of nested records included."""
    return sum(
        number_count(part) if _is_record(part) else int(part is not None) for part in _parts(record_class)
    )


@cache
def array_count(record_class: type) -> int:
    """How many arrays a record has, those of nested records included."""
    return sum(array_count(part) if _is_record(part) else int(part is None) for part in _parts(record_class))


@cache
def _number_names(record_class: type) -> tuple[str, ...]:
    """Dotted names of every number of a record, those of nested records where they stand."""
    fields: tuple[str, ...] = record_class._fields  # type: ignore[attr-defined]  # a NamedTuple
    names: list[str] = []
    for name, part in zip(fields, _parts(record_class), strict=True):
        if _is_record(part):
            names += [f"{name}.{inner}" for inner in _number_names(part)]
        elif part is not None:
            names.append(name)
    return tuple(names)


@cache
def _numbers(record_class: type) -> Callable[[Any], tuple[Any, ...]]:
    """One call that takes every number of a record: twice as fast as a loop over its parts."""
    names = _number_names(record_class)
    take = attrgetter(*names)
    return take if len(names) > 1 else lambda record: (take(record),)


def numbers_of(record: tuple[Any, ...]) -> list[float]:
    """Every number of a record in the order of its fields, those of nested records where they stand."""
    return list(map(float, _numbers(type(record))(record)))


class _Supply(NamedTuple):
    """Where the fields of a record come from: number ``i``, array ``i``, and how fields become a record."""

    number: Callable[[int], Any]
    flag: Callable[[int], Any]
    array: Callable[[int], Any]
    join: Callable[[type, list[Any]], Any]


def _assembled(record_class: type, supply: _Supply, number: int = 0, array: int = 0) -> Any:
    """A record from number ``number`` and array ``array`` of the supply on."""
    values = []
    for part in _parts(record_class):
        if part is None:
            values.append(supply.array(array))
            array += 1
        elif _is_record(part):
            values.append(_assembled(part, supply, number, array))
            number += number_count(part)
            array += array_count(part)
        else:
            values.append((supply.flag if part is bool else supply.number)(number))
            number += 1
    return supply.join(record_class, values)


def _plain_record_from(record_class: type[R], numbers: FloatArray, arrays: tuple[Any, ...]) -> R:
    """A record from its numbers, as `numbers_of` gives them, and its arrays in the order of the fields.

    ``numbers`` (N,); what `numbers_of` makes of a bool is above 0.5 for True. In a kernel the class and
    the number of arrays are known when it is compiled.
    """
    supply = _Supply(
        number=lambda i: numbers[i],
        flag=lambda i: bool(numbers[i] > 0.5),
        array=lambda i: arrays[i],
        join=lambda cls, values: cls(*values),
    )
    return _assembled(record_class, supply)  # type: ignore[no-any-return]  # of any record


def _record_from(_context: Any, record_class: Any, numbers: Any, arrays: Any) -> Any:
    """`_plain_record_from` for kernels."""
    cls = record_class.instance_class
    kinds = _Supply(
        number=lambda i: types.float64,
        flag=lambda i: types.boolean,
        array=lambda i: arrays[i],
        join=lambda part, values: types.BaseTuple.from_types(values, part),
    )
    record = _assembled(cls, kinds)

    def generate(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        array = context.make_array(numbers)(context, builder, args[1])
        given = cgutils.unpack_tuple(builder, args[2])

        def number(i: int) -> tuple[types.Type, Any]:
            index = [context.get_constant(types.intp, i)]
            place = cgutils.get_item_pointer(context, builder, numbers, array, index)
            return types.float64, context.unpack_value(builder, types.float64, place)

        def flag(i: int) -> tuple[types.Type, Any]:
            half = context.get_constant(types.float64, 0.5)
            return types.boolean, builder.fcmp_ordered(">", number(i)[1], half)

        def join(part: type, values: list[tuple[types.Type, Any]]) -> tuple[types.Type, Any]:
            kind = types.BaseTuple.from_types([kind for kind, _ in values], part)
            return kind, context.make_tuple(builder, kind, [value for _, value in values])

        supply = _Supply(number=number, flag=flag, array=lambda i: (arrays[i], given[i]), join=join)
        return impl_ret_borrowed(context, builder, sig.return_type, _assembled(cls, supply)[1])

    return signature(record, record_class, numbers, arrays), generate


record_from = _plain_record_from if numba.config.DISABLE_JIT else intrinsic(_record_from)
