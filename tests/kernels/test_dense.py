"""Small dense matrices against NumPy."""

import numpy as np
import pytest

from mapweave.kernels.dense import add_product, product, put, solved, transposed

pytestmark = pytest.mark.kernel


def test_products_sums_and_transposes_equal_numpys():
    rng = np.random.default_rng(0)
    A, B, C = rng.normal(size=(3, 5)), rng.normal(size=(5, 4)), rng.normal(size=(3, 4))
    assert np.allclose(product(A, B), A @ B)
    assert np.array_equal(transposed(A), A.T)
    want = C - 2.0 * A @ B
    add_product(C, A, B, -2.0)
    assert np.allclose(C, want)
    part = np.zeros((2, 3))
    put(part, A)
    assert np.array_equal(part, A[:2, :3])


def test_a_positive_definite_system_is_solved():
    rng = np.random.default_rng(1)
    for n in (1, 2, 3, 5):
        A = rng.normal(size=(n, n))
        A = A @ A.T + 0.1 * np.eye(n)
        B = rng.normal(size=(n, 4))
        before = B.copy()
        assert np.allclose(solved(A, B), np.linalg.solve(A, B), rtol=1e-10)
        assert np.array_equal(B, before)
