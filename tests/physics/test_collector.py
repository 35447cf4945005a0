"""Python's garbage collector while numba compiles: rare, and afterwards as it was."""

from __future__ import annotations

import gc

import numba
import numba.core.event
import pytest

from offroad_env.physics import _jit

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT or _jit._staged() is None, reason="kernels are numba's own"
)


@pytest.fixture
def usual():
    """Thresholds that nobody else sets."""
    before = gc.get_threshold()
    gc.set_threshold(701, 11, 12)
    yield 701, 11, 12
    gc.set_threshold(*before)


class Watch(numba.core.event.Listener):
    """Thresholds of the collector when a compilation begins."""

    def __init__(self):
        self.seen = []

    def on_start(self, event):
        self.seen.append(gc.get_threshold())

    def on_end(self, event):
        pass


def test_collections_are_rare_while_a_kernel_compiles(usual, monkeypatch, tmp_path):
    monkeypatch.setenv("OFFROAD_CACHE", str(tmp_path))  # what an earlier run has kept would not be compiled

    @_jit.kernel
    def doubled(x):
        return x + x

    watch = Watch()
    with numba.core.event.install_listener("numba:compile", watch):
        assert doubled(2.0) == 4.0
    assert watch.seen
    assert all(seen[0] > 10 * usual[0] for seen in watch.seen)
    assert gc.get_threshold() == usual


def test_afterwards_all_is_as_it_was(usual):
    collector = _jit._staged()._Collector()
    first, second = collector.seldom(), collector.seldom()  # of two threads
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert gc.get_threshold()[0] > 10 * usual[0]  # the second is not done
    second.__exit__(None, None, None)
    assert gc.get_threshold() == usual


def test_what_the_user_sets_meanwhile_stays(usual):
    with _jit._staged()._Collector().seldom():
        gc.set_threshold(5, 6, 7)
    assert gc.get_threshold() == (5, 6, 7)


def test_a_collector_that_is_off_stays_off(usual):
    gc.set_threshold(0)
    with _jit._staged()._Collector().seldom():
        assert gc.get_threshold()[0] == 0
    assert gc.get_threshold()[0] == 0


def test_an_error_within_restores_them_too(usual):
    with pytest.raises(ZeroDivisionError), _jit._staged()._Collector().seldom():
        1 / 0  # noqa: B018
    assert gc.get_threshold() == usual
