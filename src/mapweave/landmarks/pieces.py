"""Pieces of one robot's map, each in a frame of its own, tied into one through the landmarks they share.

A robot without odometry is lost whenever it sees nothing for some seconds; it then begins a new piece instead of
guessing where it went. Pieces are independent: no noise enters two of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..solve import gauss_newton, wrapping
from .config import EkfSlamConfig
from .landmark_map import LandmarkMap

STEPS = 50  # at most
STILL = 1e-9  # [m], [rad] in a step, from which nothing moves any more
SUSPECTS = 4  # largest pieces any of which may be the wrong one


@dataclass(frozen=True, slots=True)
class JoinedPieces:
    """One map of several pieces, in the frame of piece `root`.

    frames: `T_root_piece` of each piece tied, by its index; cov: over all frames (3 each, x y theta, in the order of
    `frames`; the root's rows are zero), then the landmarks of `ids` (2 each).
    """

    root: int
    frames: dict[int, Float[np.ndarray, "3"]]
    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]

    def frame_rows(self, piece: int) -> slice:
        k = 3 * list(self.frames).index(piece)
        return slice(k, k + 3)

    @property
    def landmark_cov(self) -> Float[np.ndarray, "k k"]:
        first = 3 * len(self.frames)
        return self.cov[first:, first:]


def join_pieces(pieces: Sequence[LandmarkMap], cfg: EkfSlamConfig) -> JoinedPieces:
    """The largest map the pieces give; a piece that fits the others badly, or shares too little, is left out.

    A large piece that is wrong itself would push out all that are right: when pieces had to go, it is tried to do
    without one of the largest instead, and what ties most landmarks, then most pieces, is taken.
    """
    best = _tie(pieces, set(), cfg)
    if any(len(set(piece.ids) & set(best.ids)) > 2 for k, piece in enumerate(pieces) if k not in best.frames):
        large = sorted(range(len(pieces)), key=lambda k: (-len(pieces[k]), k))[:SUSPECTS]
        best = max([best, *(_tie(pieces, {k}, cfg) for k in large)], key=lambda tied: (len(tied.ids), len(tied.frames)))
    return best


def _tie(pieces: Sequence[LandmarkMap], without: set[int], cfg: EkfSlamConfig) -> JoinedPieces:
    """The map of all pieces but those in `without` and those that fit the others badly."""
    left_out = set(without)
    while True:
        frames, root, places = _start(pieces, left_out, cfg)
        tied, worst, misfit = _adjust(pieces, frames, root, places, cfg)
        if misfit <= cfg.piece_chi2 or len(frames) == 1:
            return tied
        left_out.add(worst)


def _start(
    pieces: Sequence[LandmarkMap], left_out: set[int], cfg: EkfSlamConfig
) -> tuple[dict[int, np.ndarray], int, dict[str, list[np.ndarray]]]:
    """Rigid fits, the piece with most landmarks first, then whichever shares most with those tied already."""
    free = [k for k in range(len(pieces)) if k not in left_out]
    root = max(free, key=lambda k: (len(pieces[k]), -k))
    frames = {root: np.zeros(3)}
    places = {name: [p] for name, p in zip(pieces[root].ids, pieces[root].mean, strict=True)}
    waiting = [k for k in free if k != root]
    while waiting:
        shared = {k: [name for name in pieces[k].ids if name in places] for k in waiting}
        k = max(waiting, key=lambda k: (len(shared[k]), -k))
        if len(shared[k]) < 2:
            break
        waiting.remove(k)
        here = pieces[k].select(shared[k]).mean
        there = np.array([np.mean(places[name], axis=0) for name in shared[k]])
        if len(here) == 2 and np.hypot(*(there[1] - there[0])) < cfg.piece_baseline:
            continue
        T = se2.align(here, there)
        if np.sqrt(((se2.act(T, here) - there) ** 2).sum(axis=1).mean()) > cfg.piece_misfit:
            continue
        frames[k] = T
        for name, p in zip(pieces[k].ids, se2.act(T, pieces[k].mean), strict=True):
            places.setdefault(name, []).append(p)
    return frames, root, places


def _adjust(
    pieces: Sequence[LandmarkMap],
    frames: dict[int, np.ndarray],
    root: int,
    places: dict[str, list[np.ndarray]],
    cfg: EkfSlamConfig,
) -> tuple[JoinedPieces, int, float]:
    """Gauss-Newton over frames and landmarks; the tied map, the piece that fits worst and its chi-square per dof.

    Pieces that contradict each other so much that no minimum is found misfit infinitely.
    """
    ids = tuple(sorted(places))
    where = {name: k for k, name in enumerate(ids)}
    order = list(frames)  # the root is first
    first = 3 * len(order)
    size = first + 2 * len(ids)
    points = [first + 2 * np.array([where[name] for name in pieces[k].ids]) for k in order]
    weights = [np.linalg.inv(pieces[k].cov + cfg.piece_floor**2 * np.eye(2 * len(pieces[k]))) for k in order]
    misfits = np.zeros(len(order))

    def normal(x: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, float]:
        H, g, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for a, (k, at, W) in enumerate(zip(order, points, weights, strict=True)):
            L = x[at[:, None] + np.arange(2)]
            columns, J, e = _linearise(pieces[k], x[3 * a : 3 * a + 3], L, 3 * a, at)
            H[np.ix_(columns, columns)] += J.T @ W @ J
            g[columns] += J.T @ W @ e
            misfits[a] = float(e @ W @ e) / max(len(e) - 3, 1)
            cost += float(e @ W @ e)
        return H, g, cost

    x0 = np.concatenate([*(frames[k] for k in order), *(np.mean(places[name], axis=0) for name in ids)])
    held = np.arange(size) < 3
    angles = wrapping(np.arange(2, first, 3))
    solution = gauss_newton(normal, x0, max_iterations=STEPS, step_tolerance=STILL, held=held, retract=angles)
    adjusted = {k: solution.x[3 * a : 3 * a + 3] for a, k in enumerate(order)}
    worst = int(np.argmax(misfits[1:])) + 1 if len(order) > 1 else 0
    misfit = float(misfits[worst])
    try:
        cov = solution.covariance()
    except np.linalg.LinAlgError:
        cov, misfit = np.full((size, size), np.inf), np.inf
    return JoinedPieces(root, adjusted, ids, solution.x[first:].reshape(-1, 2), cov), order[worst], misfit


def _linearise(
    piece: LandmarkMap, T: np.ndarray, L: np.ndarray, frame: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of the unknowns, and the residual of the piece's landmarks, `T^-1 L` less where it has them."""
    n = len(L)
    R = se2.rotation(float(T[2]))
    q = (L - T[:2]) @ R
    J = np.zeros((2 * n, 3 + 2 * n))
    J[0::2, :2], J[1::2, :2] = -R[:, 0], -R[:, 1]
    J[0::2, 2], J[1::2, 2] = q[:, 1], -q[:, 0]
    for k in range(n):
        J[2 * k : 2 * k + 2, 3 + 2 * k : 5 + 2 * k] = R.T
    columns = np.concatenate([frame + np.arange(3), (points[:, None] + np.arange(2)).ravel()])
    return columns, J, (q - piece.mean).ravel()
