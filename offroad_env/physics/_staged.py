"""Kernels in two editions: one for Python, one for the kernels that call it.

Numba makes machine code of every function that it compiles, with two wrappers for calls from
outside, and optimises it; a caller then takes the optimised code in and optimises all of it again.
Of a hundred functions in a chain Python calls one, so most of that is for nothing. Here a kernel that
another kernel calls is only translated; optimised, made machine code and wrapped are those that
Python calls, each as a whole.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numba
import numba.core.caching
import numba.core.codegen
import numba.core.compiler
import numba.core.errors
import numba.core.extending
import numba.core.registry
import numba.core.typed_passes
import numba.core.untyped_passes
from numba import types
from numba.core.compiler_machinery import register_pass

from offroad_env.physics._kernel_cache import DurableCache
from offroad_env.physics._kernel_folder import own_folder
from offroad_env.physics._kernel_notes import APART, HANDING_ON

__all__ = ["Kernel"]


#: In the metadata of a translation: whether it counts references to arrays.
_COUNTS = "counts_references"
#: Thresholds of Python's garbage collector while numba compiles. It makes millions of objects that live until
#: the end of a kernel; with Python's own thresholds an eighth of the time would go into looking for garbage
#: among them. With these the memory of a first step grows by 20 MB.
_SELDOM = 50_000, 20, 100


class _Collector:
    """Makes garbage collections rare for a while; several threads may ask for it at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked, self._usual = 0, gc.get_threshold()

    @contextmanager
    def seldom(self) -> Iterator[None]:
        """Rare collections within; afterwards what was set before the first that asked."""
        with self._lock:
            if self._asked == 0 and (usual := gc.get_threshold())[0] > 0:  # 0: there is no collection at all
                self._usual = usual
                gc.set_threshold(*_SELDOM)
            self._asked += 1
        try:
            yield
        finally:
            with self._lock:
                self._asked -= 1
                if self._asked == 0 and gc.get_threshold() == _SELDOM:
                    gc.set_threshold(*self._usual)


_COLLECTOR = _Collector()


class _Translation(numba.core.codegen.JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """Code that waits for a caller: linked with what it calls, neither optimised nor made machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    @classmethod
    def of_bitcode(cls, codegen: Any, name: str, bitcode: bytes) -> _Translation:
        """What was stored."""
        library = cls(codegen, name)
        library._final_module = numba.core.codegen.ll.parse_bitcode(bitcode)
        library._finalized = True
        return library


@register_pass(mutates_CFG=True, analysis_only=False)
class _Translate(numba.core.typed_passes.NativeLowering):  # type: ignore[misc]  # likewise
    """Lowering into a `_Translation`."""

    _name = "translate"

    def run_pass(self, state: Any) -> bool:
        if not _owns_arrays(state):
            try:
                return self._translate(state, counts=False)
            except numba.core.errors.NumbaRuntimeError:
                pass  # a step wants room of its own after all, as `a[i] = a[j]` of rows
        return self._translate(state, counts=True)

    def _translate(self, state: Any, *, counts: bool) -> bool:
        state.flags.nrt = counts
        state.targetctx = state.targetctx.subtarget(enable_nrt=counts)
        state.metadata[_COUNTS] = counts
        state.library = _Translation(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        if state.func_id.func in APART:
            code = state.library._final_module.get_function(state["cr"].fndesc.llvm_func_name)
            code.add_function_attribute("noinline")
        entry = _Entry()
        state.targetctx.insert_user_function(entry, state["cr"].fndesc, [state.library])
        state["cr"] = state["cr"]._replace(cfunc=entry)
        return True


def _owns_arrays(state: Any) -> bool:
    """Whether a kernel makes arrays, or hands any out: then numba counts references to them.

    All other arrays belong to a caller, who keeps them until the kernel returns; counting them costs a
    fifth of the time of a step. Who counts and who does not must agree on what a call returns, so a
    kernel counts where it calls one that hands out arrays.
    """
    return _holds_arrays(state.return_type) or any(
        signature is not None
        and _holds_arrays(signature.return_type)
        and not _is_borrowed(step, signature, state.typemap)
        for step, signature in state.calltypes.items()
    )


def _is_borrowed(step: Any, signature: Any, typemap: dict[str, types.Type]) -> bool:
    """Whether the arrays that come out of a step of a kernel are views of some that another keeps."""
    kind = getattr(step, "op", "")
    if kind in ("getitem", "static_getitem"):
        return not any(map(_holds_arrays, signature.args[1:]))
    if kind != "call":
        return False
    called = typemap[step.func.name]
    if isinstance(called, types.Dispatcher):
        return not called.dispatcher.overloads[signature.args].metadata[_COUNTS]
    if isinstance(called, types.BoundFunction):
        return bool(called.template.key == "array.reshape")
    # A record of arrays, or an intrinsic: those of this project give room in the caller's own frame.
    key = getattr(called, "typing_key", None)
    return (
        isinstance(called, types.NamedTupleClass)
        or isinstance(key, numba.core.extending._Intrinsic)
        or key in HANDING_ON
    )


def _holds_arrays(kind: types.Type) -> bool:
    if isinstance(kind, types.BaseTuple):
        return any(_holds_arrays(part) for part in kind)
    return isinstance(kind, types.Array)


class _Entry:
    """By this a caller finds the code; nobody can call it."""


class _Compiler(numba.core.compiler.CompilerBase):  # type: ignore[misc]  # likewise
    """Numba's own stages but for the last, and without the search for closures: no kernel has any."""

    def define_pipelines(self) -> list[Any]:
        pm = numba.core.compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        pm.passes = [
            (_Translate, text) if step is numba.core.typed_passes.NativeLowering else (step, text)
            for step, text in pm.passes
            if step is not numba.core.untyped_passes.InlineClosureLikes
        ]
        pm.finalize()
        return [pm]


class _Stored(NamedTuple):
    """A translation as it lies on disk."""

    name: str
    bitcode: bytes
    fndesc: Any
    environment: Any
    signature: Any
    counts: bool


class _CacheImpl(numba.core.caching.CompileResultCacheImpl):  # type: ignore[misc]  # likewise
    """A translation on disk: types and bitcode."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return f"inner-{super().get_filename_base(fullname, abiflags)}"

    def reduce(self, cres: Any) -> _Stored:
        cres.fndesc.typemap = cres.fndesc.calltypes = None
        library = cres.library
        bitcode = library._get_module_for_linking().as_bitcode()
        counts = cres.metadata[_COUNTS]
        return _Stored(library.name, bitcode, cres.fndesc, cres.environment, cres.signature, counts)

    def rebuild(self, target_context: Any, payload: _Stored) -> Any:
        codegen, entry = target_context.codegen(), _Entry()
        library = _Translation.of_bitcode(codegen, payload.name, payload.bitcode)
        return numba.core.compiler.compile_result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            library=library,
            environment=payload.environment,
            entry_point=entry,
            fndesc=payload.fndesc,
            signature=payload.signature,
            metadata={_COUNTS: payload.counts},
            objectmode=False,
            lifted=(),
            reload_init=[],
            referenced_envs=[],
        )


class _Cache(DurableCache):
    _impl_class = _CacheImpl


class _Inner(numba.core.registry.CPUDispatcher):  # type: ignore[misc]  # likewise
    """The edition for callers that are kernels."""

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres

    def enable_caching(self) -> None:
        self._cache = _Cache(self.py_func)


class Kernel(numba.core.registry.CPUDispatcher):  # type: ignore[misc]  # likewise
    """The edition for Python; a kernel that calls it finds the other one."""

    def __init__(
        self, py_func: Callable[..., Any], locals: dict[str, Any], targetoptions: dict[str, Any]
    ) -> None:
        super().__init__(py_func, locals, targetoptions)
        self._folder: str | None = None
        self._inner: _Inner | None = None
        self._met = False

    def keep_in(self, folder: str) -> None:
        """Store both editions in this folder, if it is nobody else's."""
        self._folder = folder

    def enable_caching(self) -> None:
        """With checked files."""
        self._cache = DurableCache(self.py_func)

    def compile(self, sig: Any) -> Any:
        """Both editions of what the kernel calls are compiled within, unless they are stored."""
        with _COLLECTOR.seldom():
            if not self._met:  # of hundreds of kernels Python calls a few, so folders are looked up here
                _enable_caching(self, self._folder)
                self._met = True
            return super().compile(sig)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        """What a kernel finds under this name."""
        if self._inner is None:
            options = {**self.targetoptions, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
            inner = _Inner(self.py_func, {}, options, pipeline_class=_Compiler)
            _enable_caching(inner, self._folder)
            self._inner = inner
        return self._inner._numba_type_


def _enable_caching(edition: numba.core.registry.CPUDispatcher, folder: str | None) -> None:
    """Store an edition in a folder. Numba reads its name from the configuration, when caching is enabled."""
    if folder is None or not own_folder(folder):
        return
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder
    try:
        edition.enable_caching()
    finally:
        numba.config.CACHE_DIR = before
