"""Hypothesis strategies that more than one test may need."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

__all__ = ["actions"]


def actions(largest: float = 1.0) -> st.SearchStrategy[np.ndarray]:
    """Actions (2,) of finite numbers up to ``largest`` either way, in both floating-point types."""
    kinds = st.sampled_from([(np.float64, 64), (np.float32, 32)])
    return kinds.flatmap(
        lambda kind: npst.arrays(kind[0], 2, elements=st.floats(-largest, largest, width=kind[1]))
    )
