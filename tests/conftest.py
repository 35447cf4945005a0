"""Fixtures and settings of all tests."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from helpers import data_root, measured_data, unlabelled

# Tests open no window, whatever the machine has. Set before anything imports pygame or matplotlib.
os.environ["MPLBACKEND"] = "Agg"
os.environ["SDL_VIDEODRIVER"] = "dummy"
os.environ["SDL_AUDIODRIVER"] = "dummy"
os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"

# The code under test, in this process or a new one, finds the data where the tests do.
if data_root().is_dir():
    os.environ["OFFROAD_DATA"] = str(data_root())

# The same examples in every run. No deadline: the first call of a kernel compiles it.
settings.register_profile("offroad", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("offroad")


def pytest_collection_finish() -> None:
    """What collecting has made lives until the end: no garbage collection of a test needs to look at it."""
    gc.collect()
    gc.freeze()
    # Tests leave little behind: with the thresholds of Python 4 % of their time would go into looking for it.
    gc.set_threshold(20_000, 20, 50)


@pytest.fixture(scope="session")
def offroad_data() -> Callable[[str], Path]:
    """``offroad_data(name)`` is the folder of a measured data set, or skips the test."""
    return measured_data


@pytest.fixture(scope="session", autouse=True)
def every_figure_is_labelled() -> Iterator[None]:
    """No test writes a figure with an axis that lacks its quantity or unit."""
    from matplotlib.figure import Figure

    write = Figure.savefig

    def checked(figure: Figure, *arguments: object, **options: object) -> None:
        assert unlabelled(figure) == []
        write(figure, *arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", checked)
        yield
