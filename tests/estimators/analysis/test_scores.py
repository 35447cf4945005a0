"""Scores of a run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.scores import mean_square_error, time_to_5pct

T = np.linspace(0.0, 40.0, 401)


def test_a_constant_error_has_its_square_as_mean():
    n = np.full(T.shape, 0.52)
    assert mean_square_error(n, 0.5) == pytest.approx(4e-4)
    assert time_to_5pct(T, n, 0.5) == 0.0


def test_time_to_5pct_is_where_the_error_of_the_start_ends():
    n = np.where(T < 19.95, 1.0, 0.5)
    assert time_to_5pct(T, n, 0.5) == pytest.approx(20.0)


def test_an_error_that_comes_back_is_not_settled():
    n = np.full(T.shape, 0.5)
    n[-1] = 0.6
    assert time_to_5pct(T, n, 0.5) == math.inf
