"""The multifrontal factor equals dense algebra, whatever the graph looks like."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

from mapweave.kernels.dense import extend_add
from mapweave.solve.elimination import Cholesky, Elimination, NotPositiveError, _hops, dissect, hop_coordinates
from mapweave.solve.information import Information, SingularError


def laplacian(n, edges, block, rng):
    """A positive definite matrix with a random PSD coupling of `block` variables a node on each edge."""
    size = n * block
    H = sp.lil_matrix((size, size))
    for i, j in edges:
        J = rng.normal(size=(block, 2 * block))
        rows = np.concatenate([block * i + np.arange(block), block * j + np.arange(block)])
        H[np.ix_(rows, rows)] += J.T @ J
    H = sp.csc_matrix(H + sp.eye(size))
    H.sort_indices()
    return H


def graphs(rng):
    near = [(i, j) for i in range(400) for j in (i + 1, i + 20) if j < 400]
    yield "grid", 400, near
    yield "two pieces and loners", 420, [(i, i + 1) for i in range(150)] + [(i, i + 3) for i in range(200, 380)]
    yield "random", 200, [tuple(rng.choice(200, 2, replace=False)) for _ in range(400)]
    yield "star", 130, [(0, k) for k in range(1, 130)]
    yield "complete", 60, [(i, j) for i in range(60) for j in range(i)]
    yield "no edges", 100, []
    yield "one node", 1, []


@pytest.mark.parametrize("block", [1, 3])
def test_factor_solution_pivots_and_selected_inverse_equal_dense_algebra(block):
    rng = np.random.default_rng(8)
    for name, n, edges in graphs(rng):
        H = laplacian(n, edges, block, rng)
        group = np.repeat(np.arange(n), block)
        chol = Cholesky.of(H, Elimination.of(H, group))
        dense = np.linalg.inv(H.toarray())
        b = rng.normal(size=(len(dense), 2))
        np.testing.assert_allclose(chol.solve(b), dense @ b, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(chol.solve(b[:, 0]), dense @ b[:, 0], atol=1e-9, err_msg=name)
        some = b * (rng.random(b.shape) < 0.02)  # nearly all zeros, which are passed over
        np.testing.assert_allclose(chol.solve(some), dense @ some, atol=1e-9, err_msg=name)
        want = [float(c @ dense @ c) for c in np.hstack([b, some]).T]
        np.testing.assert_allclose(chol.squares(np.hstack([b, some])), want, atol=1e-9, err_msg=name)
        index = np.arange(n * block).reshape(n, block)
        want = np.stack([dense[np.ix_(r, r)] for r in index])
        np.testing.assert_allclose(chol.blocks(index), want, atol=1e-9, err_msg=name)
        assert np.log(chol.pivots()).sum() == pytest.approx(np.linalg.slogdet(H.toarray())[1])


def test_no_edge_crosses_a_separator():
    rng = np.random.default_rng(4)
    for name, n, edges in graphs(rng):
        i, j = np.array(edges, dtype=int).reshape(-1, 2).T
        graph = sp.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(n, n))
        part = dissect(graph, leaf=10).part
        a, b = np.maximum(part[i], part[j]), np.minimum(part[i], part[j])
        while (a > b).any():  # an ancestor in the heap is reached by halving
            a = np.where(a > b, a // 2, a)
        assert (a == b).all(), name


def test_information_reads_the_same_from_either_factor():
    rng = np.random.default_rng(3)
    edges = [(i, j) for i in range(300) for j in (i + 1, i + 17) if j < 300]
    H = laplacian(300, edges, 2, rng)
    index = np.arange(600).reshape(300, 2)
    plain, tree = Information.of(H), Information.of(H, Elimination.of(H, np.repeat(np.arange(300), 2)))
    np.testing.assert_allclose(tree.blocks(index), plain.blocks(index), atol=1e-11)
    np.testing.assert_allclose(tree.blocks(index[:, ::-1]), plain.blocks(index[:, ::-1]), atol=1e-11)
    apart = np.array([[0, 599], [7, 300]])
    np.testing.assert_allclose(tree.blocks(apart), plain.blocks(apart), atol=1e-11)
    assert tree.logdet() == pytest.approx(plain.logdet())
    b = rng.normal(size=(600, 3))
    np.testing.assert_allclose(tree.squares(b), plain.squares(b), rtol=1e-9)


def little_fill(H, group, last=0):
    return Elimination.least_fill(H, group, group >= group.max() + 1 - last)


@pytest.mark.kernel
@pytest.mark.parametrize("large", [300, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 4_000_000))])
def test_small_fronts_and_large_ones_give_what_dense_algebra_gives(large, monkeypatch):
    monkeypatch.setattr("mapweave.solve.elimination.LARGE", large)  # all to BLAS, some, none
    rng = np.random.default_rng(5)
    for name, n, edges in graphs(rng):
        block, last = int(rng.integers(1, 4)), min(n, int(rng.integers(0, 5)))
        H = laplacian(n, edges, block, rng)
        group = np.repeat(np.arange(n), block)
        elimination = little_fill(H, group, last)
        assert large == 300 or elimination.large.all() == (large == 0)
        chol, dense = Cholesky.of(H, elimination), np.linalg.inv(H.toarray())
        b = rng.normal(size=(len(dense), 2))
        np.testing.assert_allclose(chol.solve(b), dense @ b, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(chol.solve(b[:, 0]), dense @ b[:, 0], atol=1e-9, err_msg=name)
        index = np.arange(n * block).reshape(n, block)
        assert chol.together(index)
        want = np.stack([dense[np.ix_(r, r)] for r in index])
        np.testing.assert_allclose(chol.blocks(index), want, atol=1e-9, err_msg=name)
        assert np.log(chol.pivots()).sum() == pytest.approx(np.linalg.slogdet(H.toarray())[1])


def test_what_comes_last_is_eliminated_last_and_a_chain_fills_nothing():
    rng = np.random.default_rng(2)
    H = laplacian(300, [(i, i + 1) for i in range(299)], 3, rng)
    alone = little_fill(H, np.repeat(np.arange(300), 3))
    assert alone.panel[-1] < 2.6 * 3 * 6 * 300  # two poses a row, and what joined fronts store for nothing
    hub = [(i, k) for i in range(299) for k in (299,)]
    H = laplacian(300, [*((i, i + 1) for i in range(298)), *hub], 3, rng)
    tied = little_fill(H, np.repeat(np.arange(300), 3), last=1)
    assert set(range(897, 900)) <= set(tied.index[tied.begin[-2] :][-3:].tolist())
    assert tied.panel[-1] < 2.6 * 3 * 9 * 300


@pytest.mark.kernel
def test_a_front_that_is_not_positive_is_found_by_either_way(monkeypatch):
    H = laplacian(40, [(i, i + 1) for i in range(39)], 1, np.random.default_rng(1)) - 3.0 * sp.eye(40, format="csc")
    H = sp.csc_matrix(H)
    H.sort_indices()
    for large in (0, 10**9):
        monkeypatch.setattr("mapweave.solve.elimination.LARGE", large)
        with pytest.raises(NotPositiveError):
            Cholesky.of(H, little_fill(H, np.arange(40)))


def test_a_matrix_that_is_not_positive_is_refused():
    H = sp.csc_matrix(np.diag([1.0, -1.0]))
    with pytest.raises(NotPositiveError):
        Cholesky.of(H, Elimination.of(H))
    with pytest.raises(SingularError):
        Information.of(H, Elimination.of(H))


@pytest.mark.kernel
def test_a_child_is_added_into_the_lower_triangle_of_its_parent():
    rng = np.random.default_rng(0)
    where = np.array([0, 2, 5])
    update = np.asfortranarray(rng.normal(size=(3, 3)))
    front = np.zeros((6, 6), order="F")
    extend_add(front, update, where)
    want = np.zeros((6, 6))
    want[np.ix_(where, where)] = np.tril(update)
    np.testing.assert_array_equal(front, want)


def as_graph(n, edges):
    i, j = np.array(edges, dtype=int).reshape(-1, 2).T
    return sp.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(n, n))


def test_hops_are_the_fewest_edges_and_what_cannot_be_reached_lies_beyond():
    rng = np.random.default_rng(5)
    for name, n, edges in graphs(rng):
        graph = as_graph(n, edges)
        for start in (0, n // 2):
            want = dijkstra(graph, unweighted=True, indices=start)
            reached = np.isfinite(want)
            got = _hops(graph, start)
            np.testing.assert_array_equal(got[reached], want[reached], err_msg=name)
            if not reached.all():
                assert got[~reached].min() == got[~reached].max() > want[reached].max()


def test_hop_coordinates_are_smoother_over_the_graph_than_hops():
    side = 14
    edges = [(i, i + 1) for i in range(side**2) if (i + 1) % side] + [(i, i + side) for i in range(side * (side - 1))]
    graph = as_graph(side**2, edges)
    degree = np.diff(graph.indptr)[:, None]

    def roughness(x):
        x = (x - x.mean(axis=0)) / np.sqrt(x.var(axis=0).sum())
        return float(np.square(x - graph @ x / degree).sum(axis=1).mean())

    hops = np.stack([_hops(graph, k) for k in (0, side**2 - 1, side - 1)], axis=1)
    smooth = hop_coordinates(graph)
    assert smooth.shape == (side**2, 3)
    assert roughness(smooth) < 0.8 * roughness(hops)
    spread = smooth.var(axis=0)
    assert (np.diff(spread) <= 1e-12).all()  # principal axes, the widest first
