"""Errors of a swarm's shape: the paper's distance and angle errors, and the best fit of one shape upon another."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

SMALL = 40  # robots up to which all pairs and all triangles count
Points = Float[np.ndarray, "n d"]


@dataclass(frozen=True, slots=True)
class PaperErrors:
    """[Hamatani] section 3.2: mean errors of distances between robots [m] and of inner angles of triangles [deg]."""

    distance: float
    angle_deg: float


def paper_errors(estimate: Points, truth: Points, pairs: Int[np.ndarray, "p 2"]) -> PaperErrors | None:
    """The paper's errors, as it defines them: no alignment.

    Up to `SMALL` robots over all pairs and triangles; beyond over `pairs` (who sees whom) and the angles at an observer
    between two robots it sees one after the other. None when there is no triangle.
    """
    n = len(estimate)
    if n < 3:
        return None
    if n <= SMALL:
        sides = np.array(list(combinations(range(n), 2)))
        triples = np.array([p for a, b, c in combinations(range(n), 3) for p in ((a, b, c), (b, c, a), (c, a, b))])
    else:
        sides = np.unique(np.sort(pairs, axis=1), axis=0)
        triples = _seen(pairs)
    if not len(triples):
        return None
    distance = np.abs(_distance(estimate, sides) - _distance(truth, sides))
    angle = np.abs(_angle(estimate, triples) - _angle(truth, triples))
    return PaperErrors(float(distance.mean()), float(np.degrees(angle.mean())))


def seen_angle_error(estimate: Points, truth: Points, pairs: Int[np.ndarray, "p 2"]) -> float | None:
    """Median error of the angles at an observer between two robots it sees [rad]; None where nobody sees two."""
    triples = _seen(pairs)
    error = np.abs(_angle(estimate, triples) - _angle(truth, triples))
    return float(np.median(error)) if len(error) else None


def _seen(pairs: Int[np.ndarray, "p 2"]) -> Int[np.ndarray, "q 3"]:
    """Of `pairs` of observer and seen: an observer and two that it sees, one after the other."""
    order = np.unique(pairs, axis=0)
    same = order[1:, 0] == order[:-1, 0]
    return np.asarray(np.column_stack([order[1:, 0], order[:-1, 1], order[1:, 1]])[same])


def similarity(source: Points, target: Points, *, scale: bool, turn: bool) -> tuple[float, np.ndarray, np.ndarray]:
    """s, R, t of least squares with `target = s R source + t`; what is not asked for stays 1 or the identity."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    R = np.eye(source.shape[1])
    if turn:
        U, _, Vt = np.linalg.svd(b.T @ a)
        D = np.ones(source.shape[1])
        D[-1] = np.sign(np.linalg.det(U @ Vt)) or 1.0
        R = (U * D) @ Vt
    s = 1.0
    size = float(np.sum(a * a))
    if scale and size > 0.0:
        s = float(np.sum(b * (a @ R.T))) / size
    return s, R, target.mean(axis=0) - s * R @ source.mean(axis=0)


def _distance(p: Points, pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, " p"]:
    return np.asarray(np.linalg.norm(p[pairs[:, 1]] - p[pairs[:, 0]], axis=1))


def _angle(p: Points, triples: Int[np.ndarray, "q 3"]) -> Float[np.ndarray, " q"]:
    """The angle at the first robot of each triple between the other two [rad]."""
    a, b = p[triples[:, 1]] - p[triples[:, 0]], p[triples[:, 2]] - p[triples[:, 0]]
    dot = np.sum(a * b, axis=1)
    across = np.sqrt(np.maximum(np.sum(a * a, axis=1) * np.sum(b * b, axis=1) - dot * dot, 0.0))
    return np.asarray(np.arctan2(across, dot))
