"""Hypothesis strategies that more than one test may need."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Soil, Wheel
from offroad_env.world.soils import SOILS, make_soil

__all__ = ["actions", "any_soils", "any_wheels"]


def actions(largest: float = 1.0) -> st.SearchStrategy[np.ndarray]:
    """Actions (2,) of finite numbers up to ``largest`` either way, in both floating-point types."""
    kinds = st.sampled_from([(np.float64, 64), (np.float32, 32)])
    return kinds.flatmap(
        lambda kind: npst.arrays(kind[0], 2, elements=st.floats(-largest, largest, width=kind[1]))
    )


def _factors(low: float, high: float) -> st.SearchStrategy[float]:
    """Powers of ten between two exponents."""
    return st.floats(low, high).map(lambda power: 10.0**power)


@st.composite
def _wild_soils(draw: st.DrawFn) -> Soil | None:
    """A soil with parameters from anywhere in their ranges, or None where the factory refuses it."""
    slope = st.floats(-0.5, 0.5)
    try:
        return make_soil(
            k_c=draw(st.just(0.0) | _factors(2.0, 7.0)),
            k_phi=draw(_factors(4.0, 8.5)),
            n=draw(st.floats(0.06, 2.5)),
            c=draw(st.just(0.0) | _factors(2.0, 5.5)),
            phi=draw(st.floats(0.01, 1.5)),
            k_x=draw(_factors(-4.0, -0.5)),
            k_y=draw(_factors(-4.0, -0.5)),
            a_0=draw(st.floats(-0.5, 0.9)),
            a_1=draw(slope),
            b_0=draw(st.floats(-0.5, 0.1)),
            b_1=draw(slope),
        )
    except InvalidParameter:
        return None


def any_soils() -> st.SearchStrategy[Soil]:
    """Deformable soils: of the catalogue, and whatever else the factory lets through."""
    known = [name for name in SOILS if SOILS[name].rigid < 0.5]
    wild = _wild_soils().filter(lambda soil: soil is not None)
    return st.sampled_from(known).map(lambda name: SOILS[name]) | wild


def any_wheels() -> st.SearchStrategy[Wheel]:
    """Wheels from a small robot's to a tractor's."""
    return st.builds(Wheel, r=_factors(-1.3, 0.1), b=_factors(-1.7, -0.2))
