"""How well a trajectory keeps known relations between its poses (Kuemmerle et al., 2009)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.records import Track
from ..core.truth import Relations

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
