"""Products and solutions of small matrices are those of NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.numerics.small_matrices import multiply, multiply_transposed, solve_in_place


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_products_are_those_of_numpy(rng):
    a, b, out = rng.normal(size=(3, 4)), rng.normal(size=(4, 5)), np.empty((3, 5))
    multiply(a, b, out)
    np.testing.assert_allclose(out, a @ b, rtol=0.0, atol=1e-14)
    multiply_transposed(a, np.ascontiguousarray(b.T), out)
    np.testing.assert_allclose(out, a @ b, rtol=0.0, atol=1e-14)


def test_a_solution_is_that_of_numpy_also_where_rows_must_change_places(rng):
    for size in (1, 2, 10):
        matrix, right = rng.normal(size=(size, size)), rng.normal(size=(size, 3))
        matrix[0, 0] = 0.0 if size > 1 else 2.0
        expected = np.linalg.solve(matrix, right)
        solve_in_place(matrix, right)
        np.testing.assert_allclose(right, expected, rtol=1e-11, atol=1e-12)


def test_the_largest_pivot_keeps_the_digits_of_a_badly_scaled_matrix():
    # Without change of rows 1 / 1e-20 swallows the other equation (Golub & Van Loan, section 3.4).
    matrix, right = np.array([[1e-20, 1.0], [1.0, 1.0]]), np.array([[1.0], [2.0]])
    solve_in_place(matrix, right)
    np.testing.assert_allclose(right, [[1.0], [1.0]], rtol=1e-15)


def test_a_singular_matrix_leaves_no_number():
    matrix, right = np.ones((2, 2)), np.array([[1.0], [2.0]])
    solve_in_place(matrix, right)
    assert not np.isfinite(right).all()
