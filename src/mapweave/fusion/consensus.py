"""Several maps laid over each other: where each puts every landmark, and where the others put it.

Landmarks that one map puts somewhere else than all the others do: exchanged labels, wrong associations.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from .alignment import RigidFit, align_robust
from .config import FuseConfig


@dataclass(frozen=True, slots=True)
class Entries:
    """Every landmark of every map in one list of e entries, map by map.

    owner: (e,) which map; name: (e,) which landmark, as an index into `ids`; local: (e, 2) [m] in the map's frame;
    variance: (e,) [m^2] both axes together; begin: (k + 1,) where each map's entries start.
    """

    ids: tuple[str, ...]
    owner: Int[np.ndarray, " e"]
    name: Int[np.ndarray, " e"]
    local: Float[np.ndarray, "e 2"]
    variance: Float[np.ndarray, " e"]
    begin: Int[np.ndarray, " k"]

    @classmethod
    def of(cls, maps: Sequence[LandmarkMap]) -> "Entries":
        index = {name: i for i, name in enumerate(dict.fromkeys(name for m in maps for name in m.ids))}
        sizes = np.array([len(m) for m in maps], dtype=np.intp)
        return cls(
            ids=tuple(index),
            owner=np.repeat(np.arange(len(maps)), sizes),
            name=np.array([index[name] for m in maps for name in m.ids], dtype=np.intp),
            local=np.concatenate([np.zeros((0, 2)), *(m.mean for m in maps)]),
            variance=np.concatenate([np.zeros(0), *(np.diag(m.cov).reshape(-1, 2).sum(axis=1) for m in maps)]),
            begin=np.concatenate([[0], np.cumsum(sizes)]),
        )

    def of_map(self, k: int) -> slice:
        return slice(int(self.begin[k]), int(self.begin[k + 1]))


@dataclass(slots=True)
class Consensus:
    """A cluster while it is put together: poses of its maps' frames and the mean place of every landmark.

    `placed[k]` is `T_cluster_local` of map k; total, count, variance: (n,) sums over the entries that count, in the
    cluster's frame; position, counts: (e, 2) and (e,) of every entry.
    """

    entries: Entries
    cfg: FuseConfig
    placed: dict[int, np.ndarray] = field(default_factory=dict)
    total: np.ndarray = field(init=False)
    count: np.ndarray = field(init=False)
    variance: np.ndarray = field(init=False)
    position: np.ndarray = field(init=False)
    counts: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        n, e = len(self.entries.ids), len(self.entries.owner)
        self.total, self.count, self.variance = np.zeros((n, 2)), np.zeros(n), np.zeros(n)
        self.position, self.counts = np.zeros((e, 2)), np.zeros(e, dtype=bool)

    def place(self, k: int, T: np.ndarray) -> None:
        """Map k joins at `T_cluster_local` and all its landmarks count; moved, those that counted still do."""
        at = self.entries.of_map(k)
        counted = np.arange(at.start, at.stop)
        if k in self.placed:
            counted = counted[self.counts[at]]
            self.drop(at)
        self.placed[k] = T
        self.position[at] = se2.act(T, self.entries.local[at])
        self.add(counted)

    def add(self, at: slice | Int[np.ndarray, " i"]) -> None:
        """The entries `at` (of one map) count from now on."""
        names = self.entries.name[at]
        self.total[names] += self.position[at]
        self.count[names] += 1
        self.variance[names] += self.entries.variance[at]
        self.counts[at] = True

    def drop(self, at: slice | Int[np.ndarray, " i"]) -> None:
        """The entries `at` (of one map) count no more."""
        held = self.counts[at]
        names = self.entries.name[at][held]
        self.total[names] -= self.position[at][held]
        self.count[names] -= 1
        self.variance[names] -= self.entries.variance[at][held]
        self.counts[at] = False

    def others(self, k: int) -> tuple[Bool[np.ndarray, " m"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
        """Of map k's landmarks: which the other maps hold, where they put them, and the variance of that."""
        at = self.entries.of_map(k)
        names, own = self.entries.name[at], self.counts[at]
        count = self.count[names] - own
        total = self.total[names] - own[:, None] * self.position[at]
        variance = self.variance[names] - own * self.entries.variance[at]
        some = np.maximum(count, 1)
        return np.asarray(count > 0), np.asarray(total / some[:, None]), np.asarray(variance / some**2)

    def shared(self, k: int) -> int:
        return int(np.count_nonzero(self.others(k)[0]))

    def gates(self, k: int, metres: float) -> Float[np.ndarray, " m"]:
        """How far [m] each of map k's landmarks may lie from where the others put it."""
        _, _, variance = self.others(k)
        both = variance + self.entries.variance[self.entries.of_map(k)]
        return np.asarray(np.maximum(metres, self.cfg.gate_sigmas * np.sqrt(both)))

    def fit(self, k: int) -> RigidFit | None:
        """Map k laid over what the others hold; None with fewer than two landmarks in common."""
        known, place, _ = self.others(k)
        if known.sum() < 2:
            return None
        source = self.entries.local[self.entries.of_map(k)]
        return align_robust(source[known], place[known], self.gates(k, self.cfg.gate)[known])

    def agrees(self, k: int, fit: RigidFit) -> bool:
        """Whether half of map k's shared landmarks lie where the others put them, grossly."""
        known, _, _ = self.others(k)
        return float(np.median(fit.residual / self.gates(k, self.cfg.refuse)[known])) <= 1.0

    def means(self) -> Float[np.ndarray, "n 2"]:
        """Where every landmark lies: the mean of the entries that count, of all where none does; NaN if not held."""
        here = np.isin(self.entries.owner, list(self.placed))
        weight = np.where(self.counts, 1.0, 1e-9) * here
        names, n = self.entries.name, len(self.entries.ids)
        total = np.stack([np.bincount(names, weight * self.position[:, a], minlength=n) for a in (0, 1)], axis=1)
        held = np.bincount(names, weight, minlength=n)
        return np.where(held[:, None] > 0, total / np.where(held > 0, held, 1.0)[:, None], np.nan)

    def converge(self, sweeps: int = 2) -> None:
        """Every map laid over the mean of the others again, now that all are there."""
        for _ in range(sweeps):
            for k in sorted(self.placed):
                fit = self.fit(k)
                if fit is not None:
                    self.place(k, fit.T_target_source)


def overlaps(entries: Entries, members: Iterable[int]) -> Int[np.ndarray, "k k"]:
    """How many landmarks each pair of maps has in common; zero on the diagonal and outside `members`."""
    k = len(entries.begin) - 1
    inside = np.isin(entries.owner, list(members))
    A = sp.csr_matrix((inside.astype(np.int64), (entries.owner, entries.name)), shape=(k, len(entries.ids)))
    out = sp.csr_matrix(A @ A.T).toarray()
    np.fill_diagonal(out, 0)
    return out


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


def widened(outliers: Sequence[Outlier]) -> dict[str, float]:
    """The variance [m^2] added to each landmark that is doubted."""
    return {d.id: d.residual**2 for d in outliers if not d.belongs_to}


def inflated(landmarks: LandmarkMap, outliers: Sequence[Outlier]) -> LandmarkMap:
    """The map with the variance of doubted landmarks raised, so that they hardly count."""
    wide = widened(outliers)
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
