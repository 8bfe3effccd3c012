"""Landmarks that one map puts somewhere else than all the others do: exchanged labels, wrong associations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from ..landmarks.landmark_map import LandmarkMap
from .consensus import Consensus


@dataclass(frozen=True, slots=True)
class Outlier:
    """Map `owner` puts landmark `id` `residual` [m] from where the others do.

    belongs_to: the label it should carry where labels look exchanged (then mended), else None (then its variance is
    raised by residual^2). alone: only two maps hold it, so that either may be wrong.
    """

    owner: int
    id: str
    residual: float
    belongs_to: str | None = None
    alone: bool = False


def find_outliers(cluster: Consensus) -> list[Outlier]:
    """The landmarks of the cluster that do not fit, worst first, each judged against the maps that still count.

    On return they count no more in `cluster`, whose maps are laid over each other again without them.
    """
    outliers: list[Outlier] = []
    while True:
        judged = {k: _leave_one_out(cluster, k) for k in sorted(cluster.placed)}
        k = max(judged, key=lambda k: judged[k][0].max(initial=0.0))
        ratio, residuals = judged[k]
        if ratio.max(initial=0.0) <= 1.0:
            break
        i = int(np.argmax(ratio))
        e, residual = int(cluster.entries.begin[k]) + i, float(residuals[i])
        name = cluster.entries.name[e]
        here = np.flatnonzero((cluster.entries.name == name) & cluster.counts)
        alone = len(here) == 2
        for entry in here if alone else [e]:
            cluster.drop(np.array([entry]))
            owner = int(cluster.entries.owner[entry])
            outliers.append(Outlier(owner, cluster.entries.ids[name], residual, None, alone))
    return outliers


def find_exchanged(cluster: Consensus, outliers: Sequence[Outlier]) -> list[Outlier]:
    """`outliers` with `belongs_to` filled in where a map's doubted places fit its doubted labels in another order."""
    out = list(outliers)
    settled: set[str] = set()
    for k in sorted({d.owner for d in outliers}, reverse=True):
        mine = [i for i, d in enumerate(out) if d.owner == k and d.id not in settled]
        if len(mine) < 2:
            continue
        index = {name: i for i, name in enumerate(cluster.entries.ids)}
        names = np.array([index[out[i].id] for i in mine])
        at = cluster.entries.of_map(k)
        own = {int(n): e for e, n in enumerate(cluster.entries.name[at], int(cluster.entries.begin[k]))}
        here = cluster.position[[own[int(n)] for n in names]]
        there = np.stack([_elsewhere(cluster, int(n), k) for n in names])
        distance = np.hypot(*np.moveaxis(here[:, None] - there[None], -1, 0))
        distance = np.where(np.isfinite(distance), distance, 1e6)
        for a, b in zip(*linear_sum_assignment(np.minimum(distance, 1e3)), strict=True):
            residual = out[mine[a]].residual
            if a != b and distance[a, b] < min(cluster.cfg.gate, 0.5 * residual):
                d = out[mine[a]]
                out[mine[a]] = Outlier(k, d.id, d.residual, cluster.entries.ids[names[b]], d.alone)
        sent = {out[i].id for i in mine if out[i].belongs_to}
        got = {out[i].belongs_to for i in mine if out[i].belongs_to}
        if sent != got:  # a chain that does not close would leave one label twice
            for i in mine:
                out[i] = Outlier(k, out[i].id, out[i].residual, None, out[i].alone)
        else:
            settled |= sent
    mended = {d.id for d in out if d.belongs_to}
    return [d for d in out if d.belongs_to or not (d.alone and d.id in mended)]


def relabelled(landmarks: LandmarkMap, outliers: Sequence[Outlier]) -> LandmarkMap:
    """The map with exchanged labels put back."""
    new = {d.id: d.belongs_to for d in outliers if d.belongs_to}
    return LandmarkMap(tuple(new.get(i, i) for i in landmarks.ids), landmarks.mean, landmarks.cov, landmarks.frame)


def inflated(landmarks: LandmarkMap, outliers: Sequence[Outlier]) -> LandmarkMap:
    """The map with the variance of doubted landmarks raised, so that they hardly count."""
    wide = {d.id: d.residual**2 for d in outliers if not d.belongs_to}
    if not wide:
        return landmarks
    extra = np.repeat([wide.get(i, 0.0) for i in landmarks.ids], 2)
    return LandmarkMap(landmarks.ids, landmarks.mean, landmarks.cov + np.diag(extra), landmarks.frame)


def _leave_one_out(cluster: Consensus, k: int) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Each landmark's distance [m] from where the others put it, and that over its gate; zero where none do."""
    known, place, _ = cluster.others(k)
    at = cluster.entries.of_map(k)
    residual = np.hypot(*(cluster.position[at] - place).T) * known * cluster.counts[at]
    return residual / cluster.gates(k, cluster.cfg.gate), residual


def _elsewhere(cluster: Consensus, name: int, k: int) -> Float[np.ndarray, "2"]:
    """Where maps other than k put a landmark, those that count if any do; NaN where none has it."""
    held = (cluster.entries.name == name) & (cluster.entries.owner != k)
    held &= np.isin(cluster.entries.owner, list(cluster.placed))
    if (held & cluster.counts).any():
        held &= cluster.counts
    return cluster.position[held].mean(axis=0) if held.any() else np.full(2, np.nan)
