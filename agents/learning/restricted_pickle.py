"""Pickles of the state of a training run, of which nothing but that state can come back.

A pickle names the classes of what it holds, and functions that make them; reading an ordinary one can call
any function there is. Here names are taken from a list: arrays and generators of NumPy, spaces of Gymnasium,
statistics and buffers of stable-baselines3, and classes of the parts of this project that an environment is
made of. Of these only a few are called, which run no command, import no module by name and open no file; of
all other classes empty objects are made, whose fields are then set, so that no constructor runs. Neither a
class is changed, nor does a field stand for a method that reading would call.
"""

from __future__ import annotations

import inspect
import io
import pickle
from collections import deque
from collections.abc import Callable, Mapping
from pickle import _Unpickler as PlainUnpickler  # the one written in Python, whose steps can be replaced
from typing import Any, ClassVar

from numpy.random import PCG64

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
#: What may be called, with any arguments of the kinds that a pickle can hold; all others are only named.
_CALLED = (
    "slice", "OrderedDict", "deque", "AutoresetMode", "dtype", "_reconstruct", "scalar", "_frombuffer",
    "__bit_generator_ctor", "__generator_ctor", "__pyx_unpickle_SeedSequence", "device",
)  # fmt: skip
#: Of random generators: they call the class that they are given.
_MAKERS = ("__bit_generator_ctor", "__generator_ctor")
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


class _Reader(PlainUnpickler):
    """Finds listed names only, and calls few of them.

    The reader in C calls whatever a pickle names, and takes room for as many bytes as it states.
    """

    dispatch: ClassVar[dict[int, Callable[..., None]]] = {**PlainUnpickler.dispatch}

    def __init__(self, content: bytes, scenario: Scenario) -> None:
        super().__init__(io.BytesIO(content))
        self._scenario = scenario
        self._length = len(content)
        self._callable: list[Any] = []

    def load_reduce(self) -> None:
        """Call a listed function, or class, with the arguments on the stack."""
        function, arguments = self.stack[-2:]  # type: ignore[attr-defined]
        if not any(function is listed for listed in self._callable):
            raise pickle.UnpicklingError(f"it calls {getattr(function, '__name__', 'an object')!s}"[:160])
        if function.__name__ == "_reconstruct" and tuple(arguments[1]) != (0,):
            raise pickle.UnpicklingError("an array of it does not begin empty")
        if function.__name__ in _MAKERS and not _makes_generator(function.__name__, arguments):
            raise pickle.UnpicklingError("it calls the maker of a random generator with something else")
        super().load_reduce()  # type: ignore[misc]

    def load_bytearray(self) -> None:
        """Bytes that may be written to; no room is taken for more than there are."""
        length = int.from_bytes(self.read(8), "little")  # type: ignore[attr-defined]
        if length > self._length:
            raise pickle.UnpicklingError("it ends within an array")
        self.append(bytearray(self.read(length)))  # type: ignore[attr-defined]

    def load_build(self) -> None:
        """Set the fields of an object, none of which stands for a method of it or of its class."""
        built, state = self.stack[-2:]  # type: ignore[attr-defined]
        if isinstance(built, type) or inspect.isroutine(built):
            raise pickle.UnpicklingError("it changes a class or a function")
        for fields in state if isinstance(state, tuple) else (state,):
            special = [key for key in fields if str(key).startswith("__")] if isinstance(fields, dict) else []
            if special:
                raise pickle.UnpicklingError(f"it sets {special[0]}"[:160])
        super().load_build()  # type: ignore[misc]

    def load_append(self) -> None:
        """Put an item into a list."""
        self._check_filled(self.stack[-2])  # type: ignore[attr-defined]
        super().load_append()  # type: ignore[misc]

    def load_appends(self) -> None:
        """Put items into a list."""
        self._check_filled(self.metastack[-1][-1])  # type: ignore[attr-defined]
        super().load_appends()  # type: ignore[misc]

    def load_additems(self) -> None:
        """Put items into a set."""
        self._check_filled(self.metastack[-1][-1])  # type: ignore[attr-defined]
        super().load_additems()  # type: ignore[misc]

    @staticmethod
    def _check_filled(filled: Any) -> None:
        """In other objects than these a field could stand for the method that takes the items."""
        if type(filled) not in (list, deque, set):
            raise pickle.UnpicklingError("it fills what is neither a list nor a set")

    def load_refused(self) -> None:
        """What calls a constructor in other ways than a state of a run needs."""
        raise pickle.UnpicklingError("it is written in another way")

    dispatch[pickle.REDUCE[0]] = load_reduce
    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.APPEND[0]] = load_append
    dispatch[pickle.APPENDS[0]] = load_appends
    dispatch[pickle.ADDITEMS[0]] = load_additems
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray
    for _code in (pickle.INST, pickle.OBJ, pickle.NEWOBJ_EX, pickle.EXT1, pickle.EXT2, pickle.EXT4):
        dispatch[_code[0]] = load_refused

    def persistent_load(self, name: Any) -> Scenario:
        """The scenario of the run that goes on."""
        if name != _SCENARIO:
            raise pickle.UnpicklingError(f"it refers to {str(name)[:60]!r}")
        return self._scenario

    def find_class(self, module: str, name: str) -> Any:
        """A class or function of the list."""
        own = module.startswith(_OWN)
        if name in _ALLOWED.get(module, ()) or own:
            found = super().find_class(module, name)
            if not own and name in _CALLED:
                self._callable.append(found)
            if not own or (isinstance(found, type) and found.__module__ == module):
                return found
        raise pickle.UnpicklingError(f"it names {module}.{name}, which is no part of a training run"[:160])


def _makes_generator(maker: str, arguments: tuple[Any, ...]) -> bool:
    """Whether a maker is called with what NumPy calls it with: the one bit generator in use, or its name."""
    if len(arguments) != 1:
        return False
    given = arguments[0]
    if maker == "__bit_generator_ctor":
        return given is PCG64 or (isinstance(given, str) and given == "PCG64")
    return type(given) is PCG64 or (isinstance(given, str) and given == "PCG64")


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
