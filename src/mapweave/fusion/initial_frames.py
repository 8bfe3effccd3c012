"""Where every map lies, roughly, before anything is weighed: best overlap first, robust to wrong landmarks."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from .alignment import align_robust
from .config import FuseConfig
from .consensus import Consensus, Entries, overlaps
from .overlap import ENOUGH, Cluster

SEEDS, PARTNERS = 12, 8  # how many maps are tried as the first, each against how many others


def arrange(maps: Sequence[LandmarkMap], cfg: FuseConfig) -> tuple[list[Consensus], dict[int, str]]:
    """The maps parted into clusters that hang together, the largest first, and why a map was refused by the rest.

    A map joins the cluster it shares most with, two landmarks at least, when half of these agree grossly. Clusters
    that come to share two landmarks are joined as well.
    """
    entries = Entries.of(maps)
    waiting = set(range(len(maps)))
    clusters: list[Consensus] = []
    refused: dict[int, str] = {}
    while waiting:
        seed = _seed(entries, cfg, waiting)
        cluster = Consensus(entries, cfg)
        cluster.place(seed, np.zeros(3))
        waiting.discard(seed)
        refused |= _grow(cluster, waiting)
        clusters.append(cluster)
    clusters = _merge(clusters)
    for cluster in clusters:
        cluster.settle()
    clusters.sort(key=lambda c: (-len(c.placed), min(c.placed)))
    largest = clusters[0].placed if clusters else {}
    return clusters, {k: why for k, why in refused.items() if k not in largest}


def as_cluster(consensus: Consensus, maps: Sequence[LandmarkMap]) -> Cluster:
    """The cluster as a start for joining, in the frame of its first member."""
    members = tuple(sorted(consensus.placed))
    T_ref_cluster = se2.inverse(consensus.placed[members[0]])
    frames = np.stack([se2.compose(T_ref_cluster, consensus.placed[k]) for k in members])
    frames[0] = 0.0
    order = dict.fromkeys(name for k in members for name in maps[k].ids)
    index = {name: i for i, name in enumerate(consensus.entries.ids)}
    rows = np.array([index[name] for name in order], dtype=np.intp)
    mean = consensus.means()[rows]
    return Cluster(
        members=members,
        frames=frames,
        ids=tuple(order),
        points=se2.act(T_ref_cluster, mean),
        shared=np.array([consensus.shared(k) for k in members]),
    )


def _seed(entries: Entries, cfg: FuseConfig, waiting: set[int]) -> int:
    """The map that agrees with most others: a bad map must not be the one that the rest is measured against."""
    shared = overlaps(entries, waiting)
    shared[shared < ENOUGH] = 0
    candidates = sorted(waiting, key=lambda k: (-int(shared[k].sum()), k))[:SEEDS]
    votes = {}
    for k in candidates:
        alone = Consensus(entries, cfg)
        alone.place(k, np.zeros(3))
        partners = [int(j) for j in np.argsort(-shared[k], kind="stable")[:PARTNERS] if shared[k, j] > 0]
        fits = ((j, alone.fit(j)) for j in partners)
        votes[k] = sum(int(fit.inliers.sum()) for j, fit in fits if fit is not None and alone.agrees(j, fit))
    return max(candidates, key=lambda k: votes[k])


def _grow(cluster: Consensus, waiting: set[int]) -> dict[int, str]:
    """`waiting` maps that agree join the cluster, most in common first; for the rest that share enough, the reason."""
    entries = cluster.entries
    has = _shared_counts(cluster, waiting)
    failed: dict[int, int] = {}
    reasons: dict[int, str] = {}
    while True:
        open_ = [k for k in waiting if has[k] >= ENOUGH and failed.get(k) != has[k]]
        if not open_:
            return reasons
        k = min(open_, key=lambda k: (-int(has[k]), k))
        fit = cluster.fit(k)
        if fit is None or not cluster.agrees(k, fit):
            failed[k] = int(has[k])
            left = 0.0 if fit is None else fit.median
            reasons[k] = (
                f"half of the {has[k]} landmarks it shares lie more than {left:.2f} m from where the others put them"
            )
            continue
        fresh = entries.name[entries.of_map(k)]
        fresh = fresh[cluster.count[fresh] == 0]
        cluster.place(k, fit.T_target_source)
        waiting.discard(k)
        reasons.pop(k, None)
        np.add.at(has, entries.owner[np.isin(entries.name, fresh)], 1)


def _shared_counts(cluster: Consensus, waiting: set[int]) -> Int[np.ndarray, " k"]:
    entries = cluster.entries
    held = cluster.count[entries.name] > 0
    counts = np.bincount(entries.owner[held], minlength=len(entries.begin) - 1)
    return np.array([c if k in waiting else 0 for k, c in enumerate(counts)])


def _merge(clusters: list[Consensus]) -> list[Consensus]:
    """Clusters that share two landmarks between them (no single pair of maps need) become one where they agree."""
    done = False
    while not done:
        done = True
        for a in range(len(clusters)):
            for b in range(a + 1, len(clusters)):
                if _absorb(clusters[a], clusters[b]):
                    del clusters[b]
                    done = False
                    break
            if not done:
                break
    return clusters


def _absorb(into: Consensus, other: Consensus) -> bool:
    both = (into.count > 0) & (other.count > 0)
    if both.sum() < ENOUGH:
        return False
    source = other.total[both] / other.count[both, None]
    target = into.total[both] / into.count[both, None]
    sigma = np.sqrt(other.variance[both] / other.count[both] ** 2 + into.variance[both] / into.count[both] ** 2)
    cfg = into.cfg
    fit = align_robust(source, target, np.maximum(cfg.gate, cfg.gate_sigmas * sigma))
    if float(np.median(fit.residual / np.maximum(cfg.refuse, cfg.gate_sigmas * sigma))) > 1.0:
        return False
    for k, T in other.placed.items():
        into.place(k, se2.compose(fit.T_target_source, T))
    return True
