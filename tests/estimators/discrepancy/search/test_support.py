"""Evidence of the fitted windows for a larger model, each part in the noise in which it was measured."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.stepwise import _support


def model(cost: float, sizes: dict[str, tuple[float, float]], inflation: float) -> SimpleNamespace:
    """A fit with sizes and their standard deviations by effect."""
    return SimpleNamespace(
        cost=cost,
        candidates=tuple(Candidate(effect=name) for name in sizes),
        sizes=np.array([size for size, _ in sizes.values()]),
        size_inflation=np.full(len(sizes), inflation),
        size_deviations=lambda: np.array([deviation for _, deviation in sizes.values()]),
    )


def test_a_gain_is_divided_by_the_scatter_beside_the_noise_in_which_it_was_gained():
    """The larger model has less noise, beside which roads and soil scatter six times as much."""
    nominal = model(9055.0, {}, 1.0)
    trial = model(8969.0, {"torque_scale": (-0.155, 0.0277)}, 4.4)
    settled = model(9300.0, {"torque_scale": (-0.177, 0.0317)}, 27.0)
    assert _support(nominal, trial, settled) == pytest.approx(0.5 * (0.177 / 0.0317) ** 2)
    assert _support(nominal, model(9044.0, {"torque_scale": (-0.155, 0.0277)}, 4.4), settled) == 11.0 / 4.4


def test_the_least_of_several_new_effects_decides_and_effects_that_were_there_do_not():
    nominal = model(9000.0, {"payload": (0.1, 0.1)}, 1.0)
    larger = model(8900.0, {"payload": (0.1, 0.1), "grade": (0.04, 0.01), "bank": (0.09, 0.01)}, 1.0)
    assert _support(nominal, larger, larger) == pytest.approx(8.0)
