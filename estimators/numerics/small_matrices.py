"""Products and solutions for small matrices, as kernels of plain loops.

NumPy's own (``@``, ``outer``, ``linalg.solve``) give the same inside a kernel, but with them a kernel is
compiled for seconds longer, and for ten states a call of BLAS costs more than the sums.
"""

from __future__ import annotations

from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["multiply", "multiply_transposed", "solve_in_place"]


@kernel
def multiply(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """The product of ``a`` (I, K) and ``b`` (K, J) into ``out`` (I, J), which is neither of them."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@kernel
def multiply_transposed(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """The product of ``a`` (I, K) and ``b`` (J, K) transposed into ``out`` (I, J), another array."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[j, k]
            out[i, j] = total


@kernel
def solve_in_place(matrix: FloatArray, right: FloatArray) -> None:
    """Solve ``matrix`` (I, I) X = ``right`` (I, J): X replaces ``right``, and ``matrix`` is used up.

    Gauss's elimination with partial pivoting (Golub & Van Loan, Matrix Computations, section 3.4). A matrix
    that is singular leaves NaN or infinity.
    """
    size, columns = matrix.shape[0], right.shape[1]
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        for j in range(size):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for j in range(columns):
            right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k, size):
                matrix[i, j] -= factor * matrix[k, j]
            for j in range(columns):
                right[i, j] -= factor * right[k, j]
    for back in range(size):
        k = size - 1 - back
        for j in range(columns):
            for i in range(k + 1, size):
                right[k, j] -= matrix[k, i] * right[i, j]
            right[k, j] /= matrix[k, k]
