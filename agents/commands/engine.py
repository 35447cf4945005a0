"""Where many runs are computed: in local processes, on a Dask cluster or on Ray.

All studies hand their runs to joblib, so one switch around them moves all of them. A run is a function
of a module and its arguments, seeds included: the engine cannot change a result, only when it comes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from joblib import parallel_config

from offroad_env.errors import InvalidParameter, OffroadError

__all__ = ["ENGINES", "EngineError", "using_engine"]

ENGINES = ("local", "dask", "ray")


class EngineError(OffroadError, RuntimeError):
    """An engine is not installed, or its cluster cannot be reached."""


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def using_engine(name: str = "local") -> Iterator[None]:
    """Within it, joblib's runs are computed by that engine.

    Parameters
    ----------
    name
        "local" (processes of this machine), "dask" or "ray" (a cluster of their own on this machine),
        "dask:ADDRESS" or "ray:ADDRESS" (one that runs already).

    Raises
    ------
    InvalidParameter
        For an unknown name.
    EngineError
        When its package is not installed or the cluster does not answer.
    """
    kind, _, address = name.partition(":")
    if kind not in ENGINES or (address and kind == "local"):
        raise InvalidParameter(f"engine must be one of {', '.join(ENGINES)} (or dask:ADDRESS), got {name!r}")
    with ExitStack() as stack:
        if kind == "dask":
            _enter_dask(stack, address)
        elif kind == "ray":
            _enter_ray(stack, address)
        yield


def _enter_dask(stack: ExitStack, address: str) -> None:
    try:
        from dask.distributed import Client, LocalCluster
    except ImportError as error:
        raise EngineError(f"Dask is not installed ({error}): pip install offroad-bekker[dask]") from error
    if not address:
        cluster = LocalCluster(  # type: ignore[no-untyped-call]  # so in dask
            n_workers=_processors(), threads_per_worker=1, dashboard_address=None
        )
        address = stack.enter_context(cluster).scheduler_address
    try:
        stack.enter_context(Client(address, timeout="10s"))  # type: ignore[no-untyped-call]  # so in dask
    except (OSError, ValueError) as error:
        raise EngineError(f"no Dask scheduler answers at {address!r}: {error}") from error
    # One run a task: joblib's batches are meant for functions that take less than a message.
    stack.enter_context(parallel_config(backend="dask", wait_for_workers_timeout=30))


def _enter_ray(stack: ExitStack, address: str) -> None:
    try:
        import ray
        from ray.util.joblib.ray_backend import RayBackend
    except ImportError as error:
        raise EngineError(f"Ray is not installed ({error}): pip install offroad-bekker[ray]") from error
    try:
        ray.init(address=address or None, ignore_reinit_error=True, include_dashboard=False)
    except (ConnectionError, ValueError) as error:
        raise EngineError(f"no Ray cluster answers at {address!r}: {error}") from error
    stack.callback(ray.shutdown)

    class Generating(RayBackend):  # type: ignore[misc]  # Ray has no types
        """Ray's pool, whose results may be taken as they come."""

        supports_return_generator = True

    stack.enter_context(parallel_config(backend=Generating()))
