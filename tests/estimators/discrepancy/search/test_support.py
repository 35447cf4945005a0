"""Evidence of the fitted windows for a larger model, in units of what the ground scatters along it."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.acceptance import support_of

#: Null simulations that scatter along the first row with a variance of 4, along the second with 9.
_NULL = np.array([[2.0, -2.0, 2.0, -2.0], [3.0, 3.0, -3.0, -3.0]])


def model(
    cost: float,
    sizes: dict[str, tuple[float, float]],
    residual: tuple[float, float],
    null: np.ndarray | None = _NULL,
    nuisance: tuple[float, float] = (0.0, 0.0),
    inflation: float = 1.0,
    number: float = 0.0,
    effect: str = "",
) -> SimpleNamespace:
    """A fit with sizes and their standard deviations by effect, and derivatives by one nuisance."""
    columns = np.array(nuisance)[:, None]
    return SimpleNamespace(
        completed=lambda: SimpleNamespace(white_shared=lambda: columns),
        problem=SimpleNamespace(
            nuisance_information=np.zeros(1),
            nuisance_spread=np.ones(1),
            nuisances=[SimpleNamespace(name="mass", tolerated=True, effect=effect)],
            nuisance_prior_cost=lambda point: 0.5 * float(point.nuisances @ point.nuisances),
        ),
        nuisances=np.array([number]),
        point=SimpleNamespace(nuisances=np.array([number])),
        cost=cost,
        candidates=tuple(Candidate(effect=name) for name in sizes),
        sizes=np.array([size for size, _ in sizes.values()]),
        size_deviations=lambda: np.array([deviation for _, deviation in sizes.values()]),
        residual=np.array(residual),
        size_inflation=np.full(len(sizes), inflation),
        noise=SimpleNamespace(whiten=lambda table: table),
        without_states=lambda table: table,
        null=None if null is None else SimpleNamespace(white=null),
    )


def test_a_gain_is_divided_by_the_scatter_beside_the_noise_in_which_it_was_gained():
    """The larger model has less noise, beside which roads and soil scatter six times as much."""
    nominal = model(9055.0, {}, (0.0, 0.0))
    trial = model(8969.0, {"torque_scale": (-0.155, 0.0277)}, (0.0, 5.0), inflation=4.4)
    settled = model(9300.0, {"torque_scale": (-0.177, 0.0317)}, (0.0, 5.0), inflation=27.0)
    assert support_of(nominal, trial, settled) == pytest.approx(0.5 * (0.177 / 0.0317) ** 2)
    less = model(9044.0, {"torque_scale": (-0.155, 0.0277)}, (0.0, 5.0), inflation=4.4)
    assert support_of(nominal, less, settled) == 11.0 / 4.4


@pytest.mark.parametrize(("residual", "variance"), [((7.0, 0.0), 4.0), ((0.0, 7.0), 9.0), ((1.0, 1.0), 6.5)])
def test_an_effect_that_makes_the_ground_scatter_more_keeps_its_evidence(residual, variance):
    """Bulldozing at twice its limit: its own deviation had grown to a third of its size."""
    nominal = model(9000.0, {}, (0.0, 0.0))
    trial = model(8941.5, {"bulldozing": (8.3e4, 1.2e4)}, residual, inflation=11.6)
    settled = model(9100.0, {"bulldozing": (9.2e4, 3.3e4)}, residual)
    assert support_of(nominal, trial, settled) == pytest.approx(58.5 / variance)


def test_what_the_numbers_of_the_smaller_model_can_take_away_does_not_count():
    """Beside a large effect they move, and the ground scatters most along them."""
    nominal = model(9055.0, {}, (0.0, 0.0), nuisance=(0.0, 2.0))
    larger = model(8969.0, {"rut_drag": (6e3, 6e3)}, (1.0, 20.0))
    assert support_of(nominal, larger, larger) == pytest.approx(86.0 / 4.0)


def test_the_least_of_several_new_effects_decides_and_effects_that_were_there_do_not():
    nominal = model(9000.0, {"payload": (0.1, 0.1)}, (0.0, 0.0))
    sizes = {"payload": (0.1, 0.1), "grade": (0.04, 0.01), "bank": (0.09, 0.01)}
    larger = model(8900.0, sizes, (5.0, 0.0))
    assert support_of(nominal, larger, larger) == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("number", "effect", "evidence"),
    [
        (5.9, "", 0.0),
        (6.1, "", 0.5 * 6.1**2 - 0.5),
        (4.4, "payload", 0.0),
        (4.6, "payload", 0.5 * 4.6**2 - 0.5),
    ],
)
def test_a_number_that_returns_from_beyond_any_tolerance_is_evidence_that_no_scatter_widens(
    number, effect, evidence
):
    nominal = model(9000.0, {}, (0.0, 0.0), number=number, effect=effect)
    larger = model(8999.0, {"payload": (0.3, 1.0)}, (7.0, 0.0), inflation=100.0, number=1.0)
    assert support_of(nominal, larger, larger) == pytest.approx(0.25 + evidence)
