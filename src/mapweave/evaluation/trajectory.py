"""Trajectories against truth: ATE and RPE of poses in the plane, relations between them; in space as evo scores them.

A trajectory in space is rows `t x y z qx qy qz qw`, ascending in time; a motion is a (4, 4) matrix [Sturm12].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from ..core import se2
from ..core.records import Track
from ..core.truth import Relations

THIN = 1.0  # [s] between truth poses that count, where truth is dense


def scored_stamps(truth: Track, estimate: Track, *, dense: bool) -> Int[np.ndarray, " k"]:
    """Which truth poses count: inside the estimate's span, and where truth is dense the first of every second."""
    if not len(estimate.t):
        return np.zeros(0, np.int64)
    where = np.flatnonzero((truth.t >= estimate.t[0]) & (truth.t <= estimate.t[-1])).astype(np.int64)
    if not dense or not len(where):
        return where
    second = np.floor((truth.t[where] - truth.t[where[0]]) / THIN)
    return np.asarray(where[np.diff(second, prepend=-1.0) > 0])


def paired(
    estimate: Track, truth: Track, *, dense: bool
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Estimated poses (interpolated) and true poses at the stamps that count, and those stamps [s]."""
    where = scored_stamps(truth, estimate, dense=dense)
    if not len(where):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    t = truth.t[where]
    return se2.interpolate(t, estimate.t, estimate.pose), truth.pose[where], t


def align_tracks(pairs: Sequence[tuple[Track, Track, bool]]) -> Float[np.ndarray, "3"] | None:
    """`T_truth_map` fitted to all (estimate, truth, dense) together, every pose counting once; None without two."""
    both = [paired(estimate, truth, dense=dense)[:2] for estimate, truth, dense in pairs]
    estimated = np.concatenate([e[:, :2] for e, _ in both]) if both else np.zeros((0, 2))
    true = np.concatenate([t[:, :2] for _, t in both]) if both else np.zeros((0, 2))
    return se2.align(estimated, true) if len(true) > 1 else None


def ate(estimate: Track, truth: Track, T_truth_map: Float[np.ndarray, "3"], *, dense: bool) -> tuple[float | None, int]:
    """RMS position error [m] under the alignment given, and over how many poses."""
    ours, true, _ = paired(estimate, truth, dense=dense)
    if not len(true):
        return None, 0
    error = se2.act(T_truth_map, ours[:, :2]) - true[:, :2]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), len(true)


def rpe(estimate: Track, truth: Track, seconds: float, *, dense: bool) -> tuple[float | None, float | None]:
    """RMS drift over stretches of about `seconds`: metres and radians; needs no alignment."""
    ours, true, t = paired(estimate, truth, dense=dense)
    if not len(t):
        return None, None
    later = np.searchsorted(t, t + seconds)
    first = np.flatnonzero(later < len(t))
    first = first[t[later[first]] - t[first] < 1.5 * seconds]
    if not len(first):
        return None, None
    last = later[first]
    d = se2.between(se2.between(true[first], true[last]), se2.between(ours[first], ours[last]))
    return float(np.sqrt(np.mean(d[:, 0] ** 2 + d[:, 1] ** 2))), float(np.sqrt(np.mean(d[:, 2] ** 2)))


NEAR = 0.006  # [s] within which a pose stands for a relation's end
EXACT = 0.001  # [s] within which an end must be at a scan whose stamp can be trusted
EXACT_HOSTS = ("flirt", "gfs")


@dataclass(frozen=True, slots=True)
class RelationScore:
    """n relations, of which `used` had a pose at both ends; errors of those, None when there are none."""

    n: int
    used: int
    trans_mean: float | None
    trans_std: float | None
    trans_max: float | None
    rot_mean_deg: float | None
    rot_std_deg: float | None

    def as_json(self) -> dict[str, float | int | None]:
        return {name: getattr(self, name) for name in self.__slots__}


def score_relations(track: Track, relations: Relations) -> RelationScore:
    """Translation [m] and absolute rotation [deg] errors, over the relations with a pose within 6 ms at both ends."""
    first, near1 = nearest(track.t, relations.t1)
    second, near2 = nearest(track.t, relations.t2)
    used = near1 & near2
    n, m = len(relations), int(used.sum())
    if not m:
        return RelationScore(n, 0, None, None, None, None, None)
    motion = se2.between(track.pose[first[used]], track.pose[second[used]])
    error = se2.between(relations.pose[used], motion)  # relation^-1 (+) (pose(t1)^-1 (+) pose(t2))
    trans = np.hypot(error[:, 0], error[:, 1])
    rot = np.degrees(np.abs(error[:, 2]))
    return RelationScore(
        n, m, float(trans.mean()), float(trans.std()), float(trans.max()), float(rot.mean()), float(rot.std())
    )


def exact_pairs(relations: Relations, scan_t: Float[np.ndarray, " m"], hosts: Sequence[str]) -> Bool[np.ndarray, " n"]:
    """Which relations have both ends within 1 ms of a scan of a host whose stamps are right."""
    good = np.sort(scan_t[np.isin(np.asarray(hosts, dtype=str), EXACT_HOSTS)])
    if not len(good):
        return np.zeros(len(relations), dtype=bool)
    return np.asarray(nearest(good, relations.t1, EXACT)[1] & nearest(good, relations.t2, EXACT)[1])


def nearest(
    stamps: Float[np.ndarray, " m"], t: Float[np.ndarray, " n"], within: float = NEAR
) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The index of the stamp (ascending, m >= 1) nearest to each t, and whether it is within reach [s]."""
    right = np.clip(np.searchsorted(stamps, t), 1, max(1, len(stamps) - 1))
    right = np.minimum(right, len(stamps) - 1)
    left = np.maximum(right - 1, 0)
    index = np.where(np.abs(stamps[left] - t) <= np.abs(stamps[right] - t), left, right)
    return index, np.abs(stamps[index] - t) <= within


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
