"""Two trajectories in space and what lies between them, as `evo_ape` and `evo_rpe` score them [Sturm12].

A trajectory is rows `t x y z qx qy qz qw`, ascending in time; a motion is a (4, 4) matrix.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

WITHIN = 0.01  # [s] by which stamps of one moment may differ


@dataclass(frozen=True, slots=True)
class Errors:
    """Of n values >= 0: the figures that are usual."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


@dataclass(frozen=True, slots=True)
class TrackScore:
    """How an estimate differs from the truth at n stamps.

    ape: distance of every pose from the true one [m], in the frames as they are; ape_aligned: after the one rigid
    motion `T_truth_estimate` that fits best; ape_rotation: angle between headings, frames as they are [deg]; rpe,
    rpe_rotation: of every step from one stamp to the next [m], [deg]; None where there is no step.
    """

    n: int
    ape: Errors
    ape_rotation: Errors
    ape_aligned: Errors
    rpe: Errors | None
    rpe_rotation: Errors | None
    T_truth_estimate: Float[np.ndarray, "4 4"]


def score_tracks(estimate: Float[np.ndarray, "n 8"], truth: Float[np.ndarray, "m 8"]) -> TrackScore | None:
    """The score over the stamps that both have, to 10 ms; None where they have none."""
    own, other = _associated(estimate[:, 0], truth[:, 0])
    if not len(own):
        return None
    E, T = _motions(estimate[own]), _motions(truth[other])
    fit = _umeyama(E[:, :3, 3], T[:, :3, 3])
    apart = np.linalg.norm(E[:, :3, 3] - T[:, :3, 3], axis=1)
    aligned = np.linalg.norm(E[:, :3, 3] @ fit[:3, :3].T + fit[:3, 3] - T[:, :3, 3], axis=1)
    step = _between(_between(T[:-1], T[1:]), _between(E[:-1], E[1:]))
    return TrackScore(
        n=len(own),
        ape=_errors(apart),
        ape_rotation=_errors(_angle(_between(T, E))),
        ape_aligned=_errors(aligned),
        rpe=_errors(np.linalg.norm(step[:, :3, 3], axis=1)) if len(step) else None,
        rpe_rotation=_errors(_angle(step)) if len(step) else None,
        T_truth_estimate=fit,
    )


def _associated(
    a: Float[np.ndarray, " n"], b: Float[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """For each stamp of the shorter the nearest of the longer, the earlier of two as near, where it is near enough."""
    if len(b) < len(a):
        second, first = _associated(b, a)
        return first, second
    right = np.clip(np.searchsorted(b, a), 1, len(b) - 1) if len(b) > 1 else np.zeros(len(a), np.int64)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(b[left] - a) <= np.abs(b[right] - a), left, right)
    held = np.flatnonzero(np.abs(b[nearest] - a) <= WITHIN)
    return held, nearest[held]


def _motions(rows: Float[np.ndarray, "n 8"]) -> Float[np.ndarray, "n 4 4"]:
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
    T[:, :3, 3] = rows[:, 1:4]
    return T


def _between(a: Float[np.ndarray, "n 4 4"], b: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    return np.asarray(np.linalg.inv(a) @ b)


def _angle(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.degrees(Rotation.from_matrix(T[:, :3, :3]).magnitude()))


def _umeyama(x: Float[np.ndarray, "n 3"], y: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "4 4"]:
    """The rigid motion of x that brings it nearest to y in squares; no scale [Umeyama91] eq. 40."""
    middle, wanted = x.mean(axis=0), y.mean(axis=0)
    U, _, Vt = np.linalg.svd((y - wanted).T @ (x - middle) / len(x))
    S = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    T = np.eye(4)
    T[:3, :3] = U @ S @ Vt
    T[:3, 3] = wanted - T[:3, :3] @ middle
    return T


def _errors(e: Float[np.ndarray, " n"]) -> Errors:
    rmse = float(np.sqrt((e**2).mean()))
    return Errors(rmse, float(e.mean()), float(np.median(e)), float(e.std()), float(e.min()), float(e.max()))
