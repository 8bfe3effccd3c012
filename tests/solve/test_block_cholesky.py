"""The factorisation over blocks of three against dense linear algebra."""

import numpy as np
import pytest
import scipy.sparse as sp

from mapweave.solve import Information, Pattern, Problem, SingularError
from mapweave.solve.information import BlockCholesky, BlockOrder
from mapweave.solve.problem import Factor


def random_graph(n, ties, seed):
    """A positive definite matrix of a chain of n blocks with `ties` more, both triangles stored."""
    rng = np.random.default_rng(seed)
    i = np.concatenate([np.arange(n - 1), rng.integers(0, n, ties)])
    j = np.concatenate([np.arange(1, n), rng.integers(0, n, ties)])
    i, j = i[i != j], j[i != j]
    A = 0.5 * np.eye(3 * n)
    for a, b in zip(i, j, strict=True):
        J = rng.normal(size=(3, 6))
        at = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
        A[np.ix_(at, at)] += J.T @ J
    whole = np.kron(np.abs(A).reshape(n, 3, n, 3).sum(axis=(1, 3)) > 0, np.ones((3, 3), bool))
    held = sp.csc_matrix(whole.astype(float))
    held.sort_indices()
    column = np.repeat(np.arange(3 * n), np.diff(held.indptr))
    held.data = A[held.indices, column]
    return held, A


@pytest.mark.parametrize(("n", "ties"), [(1, 0), (2, 0), (3, 2), (17, 9), (60, 40), (60, 400)])
def test_solutions_pivots_and_blocks_are_those_of_the_dense_matrix(n, ties):
    held, A = random_graph(n, ties, seed=n + ties)
    factor = BlockCholesky.of(held.data, BlockOrder.of(held))
    b = np.random.default_rng(1).normal(size=(3 * n, 4))
    np.testing.assert_allclose(factor.solve(b), np.linalg.solve(A, b), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(factor.solve(b[:, 0]), np.linalg.solve(A, b[:, 0]), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(np.log(factor.pivots()).sum(), np.linalg.slogdet(A)[1], rtol=1e-10)
    P, index = np.linalg.inv(A), np.arange(3 * n).reshape(n, 3)[:, [2, 0]]
    asked = np.stack([P[np.ix_(k, k)] for k in index])
    np.testing.assert_allclose(factor.blocks(index), asked, rtol=1e-9, atol=1e-11)
    row, column = np.nonzero(np.abs(A).reshape(n, 3, n, 3).sum(axis=(1, 3)) > 0)
    row, column = row[row != column], column[row != column]
    if len(row):
        diagonal, tied = factor.pairs(row, column)
        blocks = P.reshape(n, 3, n, 3).swapaxes(1, 2)
        np.testing.assert_allclose(tied, blocks[row, column], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(diagonal, blocks[np.arange(n), np.arange(n)], rtol=1e-8, atol=1e-10)


def test_nothing_is_solved_in_no_time():
    nothing = sp.csc_matrix((0, 0))
    factor = BlockCholesky.of(nothing.data, BlockOrder.of(nothing))
    assert factor.solve(np.zeros(0)).shape == (0,)
    assert factor.pivots().shape == (0,)


def test_a_matrix_that_is_not_positive_is_an_error():
    held, _ = random_graph(12, 6, seed=3)
    order = BlockOrder.of(held)
    bad = held - 40.0 * sp.eye(36, format="csc")
    bad.sort_indices()
    with pytest.raises(SingularError, match="block"):
        Information.of(bad.tocsc(), order)


def test_the_fill_of_a_chain_is_the_chain():
    held, _ = random_graph(200, 0, seed=0)
    order = BlockOrder.of(held)
    assert order.begin[-1] == 199


def test_variables_that_are_not_threes_are_refused():
    unit = np.eye(2)[None]
    term = Factor(np.arange(2)[None], lambda x: x[None], lambda _: unit, 2)
    with pytest.raises(ValueError, match="multiple of 3"):
        Pattern.of(Problem(np.zeros(2), [term])).in_threes()
