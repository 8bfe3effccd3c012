"""Pieces of one robot's map are tied into one, and a wrong piece does not push out those that are right."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.landmark_map import LandmarkMap, Submap
from mapweave.landmarks.without_odometry import join_pieces

NAMES = tuple("abcdefghij")

CFG = EkfSlamConfig()


def truth():
    return np.random.default_rng(0).uniform(-4, 4, (len(NAMES), 2))


def piece(names, seed, sigma=0.02):
    """Landmarks of `truth` in a frame of the piece's own, with noise."""
    rng = np.random.default_rng(seed)
    T = np.array([*rng.uniform(-3, 3, 2), rng.uniform(-3, 3)])
    points = se2.act(se2.inverse(T), truth()[[NAMES.index(n) for n in names]])
    return LandmarkMap(tuple(names), points + sigma * rng.normal(size=points.shape), sigma**2 * np.eye(2 * len(names)))


def rmse(tied):
    points = truth()[[NAMES.index(n) for n in tied.ids]]
    return np.sqrt(((se2.act(se2.align(tied.mean, points), tied.mean) - points) ** 2).sum(axis=1).mean())


def test_overlapping_pieces_give_one_map_more_certain_than_each():
    pieces = [piece("abcdef", 1), piece("efghij", 2), piece("defg", 3)]
    tied = join_pieces(pieces)
    assert tied.ids == NAMES
    assert set(tied.frames) == {0, 1, 2}
    assert rmse(tied) < 0.08
    shared = [2 * NAMES.index(n) for n in "ef"]
    assert np.all(np.diag(tied.landmark_cov)[shared] < 0.02**2 + 0.005**2)


def test_errors_are_what_the_covariance_says():
    nees = []
    for seed in range(60):
        pieces = [piece("abcdef", 10 * seed + 1), piece("efghij", 10 * seed + 2), piece("defg", 10 * seed + 3)]
        tied = join_pieces(pieces)
        points = truth()[[NAMES.index(n) for n in tied.ids]]
        T = se2.align(tied.mean, points)
        q, R = se2.act(T, tied.mean), np.kron(np.eye(len(tied.ids)), se2.rotation(T[2]))
        W = np.linalg.inv(R @ tied.landmark_cov @ R.T)
        G = np.zeros((2 * len(q), 3))
        G[0::2, 0] = G[1::2, 1] = 1.0
        G[0::2, 2], G[1::2, 2] = -q[:, 1], q[:, 0]
        e = (q - points).ravel()
        e -= G @ np.linalg.solve(G.T @ W @ G, G.T @ W @ e)
        nees.append(e @ W @ e / (2 * len(q) - 3))
    assert 0.8 < np.mean(nees) < 1.15  # the 5 mm floor makes it a little cautious


def test_a_large_piece_that_is_wrong_is_left_out():
    wrong = piece("abcdefghi", 4)
    bent = LandmarkMap(wrong.ids, wrong.mean * np.array([1.0, 0.4]), wrong.cov)
    tied = join_pieces([bent, piece("abcdef", 1), piece("efghij", 2), piece("cdefgh", 3)])
    assert 0 not in tied.frames
    assert tied.ids == NAMES
    assert rmse(tied) < 0.06


def test_a_piece_that_shares_one_landmark_is_left_out():
    tied = join_pieces([piece("abcde", 1), piece("efgh", 2)])
    assert tied.ids == tuple("abcde")
    assert list(tied.frames) == [0]


def test_a_piece_whose_fit_runs_away_is_left_out():
    """Two maps whose landmarks were mixed up: Gauss-Newton finds no minimum between them."""
    shared = LandmarkMap(
        ("6", "8", "7"), np.array([[3.21, -1.67], [3.09, -0.83], [3.62, -0.39]]), 0.002 * np.eye(6) + 0.015
    )
    bent = np.array(
        [
            [0.157, 0.274, -0.005, 0.201, -0.047, 0.318],
            [0.274, 0.817, -0.149, 0.577, -0.271, 0.915],
            [-0.005, -0.149, 0.086, -0.105, 0.106, -0.169],
            [0.201, 0.577, -0.105, 0.411, -0.192, 0.651],
            [-0.047, -0.271, 0.106, -0.192, 0.166, -0.301],
            [0.318, 0.915, -0.169, 0.651, -0.301, 1.035],
        ]
    )
    other = LandmarkMap(("6", "8", "7"), np.array([[4.24, -1.54], [2.97, 0.46], [4.66, 1.06]]), bent)
    tied = join_pieces([shared, other])
    assert list(tied.frames) == [0]
    assert np.isfinite(tied.cov).all()
    np.testing.assert_allclose(tied.mean[list(tied.ids).index("6")], [3.21, -1.67])


@pytest.mark.parametrize(("n", "size"), [(1, 7), (2, 5)])
def test_a_submap_whose_covariance_or_places_are_not_those_of_its_ids_is_refused(n, size):
    assert Submap("r", np.zeros(3), ("a", "b"), np.zeros((2, 2)), np.eye(7), "local").landmarks.ids == ("a", "b")
    with pytest.raises(ValueError, match="2 ids do not belong to"):
        Submap("r", np.zeros(3), ("a", "b"), np.zeros((n, 2)), np.eye(size), "local")
