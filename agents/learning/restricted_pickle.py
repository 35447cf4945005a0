"""Pickles of the state of a training run, of which nothing but that state can come back.

A pickle names the classes of what it holds, and functions that make them; reading an ordinary one can call
any function there is. Here names are taken from a list: arrays and generators of NumPy, spaces of Gymnasium,
statistics and buffers of stable-baselines3, and classes of the parts of this project that an environment is
made of. Of these only a few are called, which run no command, import no module by name and open no file; of
all other classes empty objects are made, whose fields are then set, so that no constructor runs. Neither a
class is changed, nor does a field stand for a method that reading would call.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from pickle import _Unpickler as PlainUnpickler  # the one written in Python, whose steps can be replaced
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.random import PCG64, SeedSequence

from offroad_env.environment.scenarios import Scenario
from offroad_env.errors import DataError

__all__ = ["pack", "unpack"]

#: Names of other packages.
_ALLOWED = {
    "builtins": ("slice",),
    "collections": ("OrderedDict", "deque"),
    "gymnasium.envs.registration": ("EnvSpec",),
    "gymnasium.spaces.box": ("Box",),
    "gymnasium.spaces.dict": ("Dict",),
    "gymnasium.vector.vector_env": ("AutoresetMode",),
    "numpy": ("dtype", "ndarray"),
    "numpy._core.multiarray": ("_reconstruct", "scalar"),
    "numpy._core.numeric": ("_frombuffer",),
    "numpy.core.multiarray": ("_reconstruct", "scalar"),
    "numpy.core.numeric": ("_frombuffer",),
    "numpy.random._pcg64": ("PCG64",),
    "numpy.random._pickle": ("__bit_generator_ctor", "__generator_ctor"),
    "numpy.random.bit_generator": ("SeedSequence", "__pyx_unpickle_SeedSequence"),
    "stable_baselines3.common.buffers": ("DictReplayBuffer",),
    "stable_baselines3.common.running_mean_std": ("RunningMeanStd",),
    "stable_baselines3.common.vec_env.stacked_observations": ("StackedObservations",),
    "stable_baselines3.common.vec_env.vec_normalize": ("VecNormalize",),
    "torch": ("device",),
}
#: What may be called, with arguments as `_CALLS` has them; all others are only named.
_CALLED = (
    "slice", "OrderedDict", "deque", "AutoresetMode", "dtype", "_reconstruct", "scalar", "_frombuffer",
    "__bit_generator_ctor", "__generator_ctor", "__pyx_unpickle_SeedSequence", "device",
)  # fmt: skip
#: Of what has no fields to set, or is filled by other steps.
_NO_FIELDS = ("slice", "OrderedDict", "deque", "AutoresetMode", "device")
#: Numbers, and records of them (V): no objects, text or dates.
_NUMBERS = re.compile(r"b1|[iu][1248]|f[248]|V[1-9]\d{0,8}")
#: Where classes of this project may come from; functions never do.
_OWN = (
    "agents.controllers.",
    "agents.learning.",
    "estimators.filters.",
    "estimators.models.",
    "estimators.numerics.",
    "offroad_env.effects.",
    "offroad_env.environment.",
    "offroad_env.physics.",
    "offroad_env.simulation.",
    "offroad_env.world.",
)
#: The scenario of the run is no part of its state: it holds the function that draws courses.
_SCENARIO = "scenario"


class _Writer(pickle.Pickler):
    """Writes the scenario as a name."""

    def persistent_id(self, value: Any) -> str | None:
        """The name of what is not stored."""
        return _SCENARIO if isinstance(value, Scenario) else None


class _TypeState(NamedTuple):
    """State of a type of numbers, as NumPy writes it."""

    version: Any
    order: Any  #: of the bytes
    base: Any  #: (type, shape) of an array in each place, or None
    names: Any  #: of the fields of a record, or None
    fields: Any  #: name -> (type, offset)
    size: Any
    alignment: Any
    flags: Any


class _ArrayState(NamedTuple):
    """State of an array, as NumPy writes it."""

    version: Any
    shape: Any
    kind: Any
    by_columns: Any
    content: Any


class _SeedState(NamedTuple):
    """State of seeds, as NumPy writes it."""

    entropy: Any
    children: Any
    pool: Any
    size: Any
    key: Any


class _Named:
    """A class or function that a pickle names: only the two steps that call it look inside.

    It stands on the stack in place of what it names, so that this is nowhere kept as a value.
    """

    def __init__(self, named: Any, *, called: bool) -> None:
        self.named = named
        self.called = called  #: as it is; of others empty objects are made


class _Reader(PlainUnpickler):
    """Finds listed names only, and calls few of them.

    The reader in C calls whatever a pickle names, and takes room for as many bytes as it states.
    """

    dispatch: ClassVar[dict[int, Callable[..., None]]] = {**PlainUnpickler.dispatch}
    stack: list[Any]
    metastack: list[list[Any]]

    def __init__(self, content: bytes, scenario: Scenario) -> None:
        super().__init__(io.BytesIO(content))
        self._scenario = scenario
        self._length = len(content)
        self._unfinished: list[np.dtype[Any]] = []  # types that were called and have no state yet

    def load_reduce(self) -> None:
        """Call a listed function, or class, with the arguments on the stack."""
        function, arguments = self.stack[-2:]
        if not isinstance(function, _Named) or not function.called:
            named = getattr(function, "named", function)
            raise pickle.UnpicklingError(f"it calls {getattr(named, '__name__', 'an object')!s}"[:160])
        name = function.named.__name__
        if type(arguments) is not tuple or not _CALLS[name](self, arguments):
            raise pickle.UnpicklingError(f"it calls {name} with something else than a run does")
        self.stack[-2:] = [function.named, tuple(map(_plain, arguments))]
        super().load_reduce()  # type: ignore[misc]
        if name == "dtype":
            self._unfinished.append(self.stack[-1])

    def load_newobj(self) -> None:
        """An empty object of a class; of tuples with names, a full one."""
        named, arguments = self.stack[-2:]
        if not isinstance(named, _Named) or named.called or not _is_made_empty(named.named):
            raise pickle.UnpicklingError("it calls the constructor of what is no class of a run")
        if type(arguments) is not tuple or (arguments and not issubclass(named.named, tuple)):
            raise pickle.UnpicklingError(f"it calls {named.named.__name__} with arguments"[:160])
        if any(map(_is_code, arguments)):
            raise pickle.UnpicklingError("it keeps a class or a function as a value")
        self.stack[-2] = named.named
        super().load_newobj()  # type: ignore[misc]

    def load_bytearray(self) -> None:
        """Bytes that may be written to; no room is taken for more than there are."""
        length = int.from_bytes(self.read(8), "little")  # type: ignore[attr-defined]
        if length > self._length:
            raise pickle.UnpicklingError("it ends within an array")
        self.append(bytearray(self.read(length)))  # type: ignore[attr-defined]

    def load_build(self) -> None:
        """Set the fields of an object, none of which stands for a method of it or of its class."""
        built, state = self.stack[-2:]
        if isinstance(built, _Named):
            raise pickle.UnpicklingError("it changes a class or a function")
        if isinstance(built, np.dtype):
            self.stack[-1] = self._state_of_type(built, state)
        elif isinstance(built, np.ndarray):
            self._check_array(built, state)
        elif isinstance(built, PCG64):
            _require(_is_generator_state(state), "the state of a random generator is none")
        elif isinstance(built, SeedSequence):
            _require(_is_seed_state(state), "the state of seeds is none")
        else:
            _check_fields(built, state)
        super().load_build()  # type: ignore[misc]

    def _state_of_type(self, built: np.dtype[Any], state: Any) -> tuple[Any, ...]:
        """The state of a type of numbers, made anew from what it is to be: flags come from NumPy alone."""
        place = next((i for i, one in enumerate(self._unfinished) if one is built), None)
        _require(place is not None, "it changes a type of numbers")
        del self._unfinished[place or 0]
        _require(type(state) is tuple and len(state) == 8, "the state of a type of numbers is none")
        given = _TypeState(*state)
        if given.base is not None:
            of, shape = given.base
            _require(self.is_sound(of) and _is_shape(shape), "a type holds what are no numbers")
            made = np.dtype((of, shape))
        elif given.names is not None:
            listed = [given.fields[name] for name in given.names]
            _require(all(self.is_sound(one[0]) for one in listed), "a type holds what are no numbers")
            made = np.dtype(
                {
                    "names": list(given.names),
                    "formats": [one[0] for one in listed],
                    "offsets": [one[1] for one in listed],
                    "itemsize": built.itemsize,
                },
                align=bool(given.flags & _ALIGNED),
            )
        else:
            made = np.dtype(built.str).newbyteorder(given.order)
        found = made.__reduce__()
        same = made.kind == built.kind and made.itemsize == built.itemsize and found[2] == state
        _require(same and not made.hasobject, "a type is none of numbers")
        return tuple(found[2])

    def is_sound(self, given: Any) -> bool:
        """Whether it is a finished type of numbers, or of records of them."""
        return (
            isinstance(given, np.dtype)
            and not given.hasobject
            and given.kind in "biufV"
            and not any(given is one for one in self._unfinished)
        )

    def are_numbers(self, given: Any, content: Any, count: int) -> bool:
        """Whether bytes are so many numbers of a type."""
        if not self.is_sound(given) or given.subdtype is not None:
            return False
        whole = type(content) in (bytes, bytearray) and len(content) == count * given.itemsize
        return whole and (count == 0 or not _misread(np.frombuffer(content, given)))

    def _check_array(self, built: np.ndarray, state: Any) -> None:
        """An array takes its numbers once, as many as its shape has."""
        _require(built.size == 0 and built.base is None, "it changes an array")
        _require(type(state) is tuple and len(state) == 5, "the state of an array is none")
        given = _ArrayState(*state)
        known = given.version == 1 and _is_shape(given.shape) and type(given.by_columns) in (bool, int)
        numbers = known and self.are_numbers(given.kind, given.content, math.prod(given.shape))
        _require(numbers, "an array is none of numbers")

    def load_append(self) -> None:
        """Put an item into a list."""
        _check_filled(self.stack[-2], (list, deque))
        super().load_append()  # type: ignore[misc]

    def load_appends(self) -> None:
        """Put items into a list."""
        _check_filled(self.metastack[-1][-1], (list, deque))
        super().load_appends()  # type: ignore[misc]

    def load_additems(self) -> None:
        """Put items into a set."""
        _check_filled(self.metastack[-1][-1], (set,))
        super().load_additems()  # type: ignore[misc]

    def load_setitem(self) -> None:
        """Put a value into a mapping."""
        _check_filled(self.stack[-3], (dict, OrderedDict))
        super().load_setitem()  # type: ignore[misc]

    def load_setitems(self) -> None:
        """Put values into a mapping."""
        _check_filled(self.metastack[-1][-1], (dict, OrderedDict))
        super().load_setitems()  # type: ignore[misc]

    def load_refused(self) -> None:
        """What calls a constructor in other ways than a state of a run needs, or shares bytes with others."""
        raise pickle.UnpicklingError("it is written in another way")

    dispatch[pickle.REDUCE[0]] = load_reduce
    dispatch[pickle.NEWOBJ[0]] = load_newobj
    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.APPEND[0]] = load_append
    dispatch[pickle.APPENDS[0]] = load_appends
    dispatch[pickle.ADDITEMS[0]] = load_additems
    dispatch[pickle.SETITEM[0]] = load_setitem
    dispatch[pickle.SETITEMS[0]] = load_setitems
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray
    for _code in (
        *(pickle.INST, pickle.OBJ, pickle.NEWOBJ_EX, pickle.EXT1, pickle.EXT2, pickle.EXT4),
        *(pickle.NEXT_BUFFER, pickle.READONLY_BUFFER),
    ):
        dispatch[_code[0]] = load_refused

    def persistent_load(self, name: Any) -> Scenario:
        """The scenario of the run that goes on."""
        if name != _SCENARIO:
            raise pickle.UnpicklingError(f"it refers to {str(name)[:60]!r}")
        return self._scenario

    def find_class(self, module: str, name: str) -> Any:
        """A class or function of the list, which is no value."""
        own = module.startswith(_OWN)
        if name in _ALLOWED.get(module, ()) or own:
            found = super().find_class(module, name)
            if not own or (isinstance(found, type) and found.__module__ == module):
                return _Named(found, called=not own and name in _CALLED)
        raise pickle.UnpicklingError(f"it names {module}.{name}, which is no part of a training run"[:160])


#: Flag of NumPy: fields lie where C has them.
_ALIGNED = 0x80
#: Most dimensions of an array.
_DIMENSIONS = 32
#: Most words of the state of seeds; NumPy has 4.
_WORDS = 64


def _require(condition: bool, reason: str) -> None:
    if not condition:
        raise pickle.UnpicklingError(reason)


def _plain(given: Any) -> Any:
    return given.named if isinstance(given, _Named) else given


def _is_made_empty(named: Any) -> bool:
    """Whether a run's objects of it begin without fields: a class, but none of NumPy."""
    return isinstance(named, type) and not named.__module__.startswith("numpy")


def _names(given: Any, named: Any) -> bool:
    return isinstance(given, _Named) and given.named is named


def _is_code(value: Any) -> bool:
    """Whether it could be called."""
    return isinstance(value, _Named) or callable(value)


def _is_number(value: Any) -> bool:
    return type(value) is int


def _is_shape(given: Any) -> bool:
    known = type(given) is tuple and len(given) <= _DIMENSIONS
    return known and all(_is_number(one) and one >= 0 for one in given)


def _misread(numbers: np.ndarray) -> bool:
    """Whether truth values are other bytes than 0 and 1: NumPy counts them by these."""
    if numbers.dtype.names is not None:
        return any(_misread(numbers[name]) for name in numbers.dtype.names)
    return numbers.dtype.kind == "b" and bool((numbers.view(np.uint8) > 1).any())


def _check_fields(built: Any, state: Any) -> None:
    """Fields of an object of a class of this project, or of another listed one."""
    kind = type(built)
    known = kind.__name__ in _ALLOWED.get(kind.__module__, ()) or kind.__module__.startswith(_OWN)
    _require(known and kind.__name__ not in _NO_FIELDS, f"it sets fields of {kind.__name__}"[:160])
    parts = state if type(state) is tuple and len(state) == 2 else (state,)
    for fields in parts:
        _require(fields is None or type(fields) is dict, "the fields of an object are none")
        for key, value in (fields or {}).items():
            _require(type(key) is str and not key.startswith("__"), f"it sets {key!s}"[:160])
            _require(not _is_code(value), f"it sets {key} to a class or a function"[:160])


def _check_filled(filled: Any, kinds: tuple[type, ...]) -> None:
    """In other objects than these a field could stand for the method that takes the items."""
    if type(filled) not in kinds:
        raise pickle.UnpicklingError("it fills what is neither a list, a set nor a mapping")


def _is_generator_state(state: Any) -> bool:
    """(numbers of PCG64, its seeds) as NumPy writes them."""
    if type(state) is not tuple or len(state) != 2:
        return False
    numbers, seeds = state
    inner = numbers.get("state") if type(numbers) is dict else None
    return type(inner) is dict and all(map(_is_number, inner.values())) and isinstance(seeds, SeedSequence)


def _is_seed_state(state: Any) -> bool:
    """(entropy, children, pool, its size, key) as NumPy writes them."""
    if type(state) is not tuple or len(state) != 5:
        return False
    given = _SeedState(*state)
    listed = given.entropy if type(given.entropy) in (list, tuple) else (given.entropy,)
    return (
        (given.entropy is None or all(_is_number(one) and one >= 0 for one in listed))
        and _is_number(given.children)
        and type(given.pool) is np.ndarray
        and given.pool.dtype == np.uint32
        and _is_number(given.size)
        and given.pool.shape == (given.size,)
        and given.size <= _WORDS
        and type(given.key) is tuple
        and all(map(_is_number, given.key))
    )


def _is_frombuffer(reader: _Reader, given: tuple[Any, ...]) -> bool:
    """(bytes, type, shape, order, for the order K: that of the axes)."""
    if len(given) not in (4, 5) or not _is_shape(given[2]):
        return False
    axes = given[4] if len(given) == 5 else None
    ordered = type(given[3]) is str and (axes is None or _is_shape(axes))
    return ordered and reader.are_numbers(given[1], given[0], math.prod(given[2]))


def _is_generator(_: _Reader, given: tuple[Any, ...]) -> bool:
    """The one bit generator in use, or its name."""
    return len(given) == 1 and (type(given[0]) is PCG64 or given == ("PCG64",))


#: What may be called -> whether these are arguments that a state of a run calls it with.
_CALLS: Mapping[str, Callable[[_Reader, tuple[Any, ...]], bool]] = {
    "slice": lambda _, given: len(given) == 3 and all(one is None or _is_number(one) for one in given),
    "OrderedDict": lambda _, given: not given,
    "deque": lambda _, given: (
        len(given) in (1, 2)
        and type(given[0]) in (list, tuple)
        and all(one is None or _is_number(one) for one in given[1:])
    ),
    "AutoresetMode": lambda _, given: len(given) == 1 and type(given[0]) is str,
    "dtype": lambda _, given: (
        len(given) == 3
        and type(given[0]) is str
        and _NUMBERS.fullmatch(given[0]) is not None
        and given[1:] == (False, True)
    ),
    "_reconstruct": lambda _, given: (
        len(given) == 3 and _names(given[0], np.ndarray) and given[1] == (0,) and given[2] in (b"b", "b")
    ),
    "scalar": lambda reader, given: len(given) == 2 and reader.are_numbers(*given, 1),
    "_frombuffer": _is_frombuffer,
    "__bit_generator_ctor": lambda _, given: (
        len(given) == 1 and (_names(given[0], PCG64) or given == ("PCG64",))
    ),
    "__generator_ctor": _is_generator,
    "__pyx_unpickle_SeedSequence": lambda _, given: (
        len(given) == 3
        and _names(given[0], SeedSequence)
        and _is_number(given[1])
        and (given[2] is None or _is_seed_state(given[2]))
    ),
    "device": lambda _, given: (
        len(given) in (1, 2) and type(given[0]) is str and all(map(_is_number, given[1:]))
    ),
}


def pack(state: Mapping[str, Any]) -> bytes:
    """The state of a run as bytes."""
    sink = io.BytesIO()
    _Writer(sink, protocol=5).dump(dict(state))
    return sink.getvalue()


def unpack(content: bytes, file: str, scenario: Scenario) -> dict[str, Any]:
    """The state that `pack` has packed; ``scenario`` is put where it was.

    Raises
    ------
    DataError
        For anything else, before any of it is run.
    """
    try:
        state = _Reader(content, scenario).load()
    except Exception as error:  # what is damaged fails anywhere inside the reader, in many ways
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise DataError(f"{file}: is no state of a training run, or damaged: {reason}") from None
    if not isinstance(state, dict):
        raise DataError(f"{file}: is no state of a training run")
    return state
