"""Where every map lies, roughly, before anything is weighed: best overlap first, robust to wrong landmarks.

And whether two maps show the same place at all: how much better "equal names are one landmark" explains them than
chance. Names alone prove nothing: two rooms may use the same ones. Compared are two statements about the n landmarks
that two maps both name. Same place: up to one rigid transform and a scale near 1 they lie where the covariances say,
but for a few wrong names. Different places: the second map's lie anywhere in it. Two or three that agree by luck leave
the Bayes factor small.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from ..core import se2
from ..core.names import in_order
from ..core.rows import spread
from ..landmarks.landmark_map import LandmarkMap
from .alignment import RigidFit, align_robust, joint_fit, log_evidence, spread_area
from .cluster import ENOUGH, Cluster
from .config import (
    FUSE_GATE,
    FUSE_ODDS,
    FUSE_REFUSE,
    FUSE_WEIGHED,
    GATE_SIGMAS,
    MISLABELLED,
    MISLABELLED_CHI2,
    FuseConfig,
)

FUSE_ODDS_WITHIN = 0.1  # how much likelier than chance for maps of one recording, whose names have one meaning
FUSE_DISTRUST = 4.0  # factor on covariances while it is judged whether two places are one


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
        return np.asarray(np.maximum(metres, GATE_SIGMAS * np.sqrt(both)))

    def fit(self, k: int) -> RigidFit | None:
        """Map k laid over what the others hold; None with fewer than two landmarks in common."""
        known, place, _ = self.others(k)
        if known.sum() < 2:
            return None
        source = self.entries.local[self.entries.of_map(k)]
        return align_robust(source[known], place[known], self.gates(k, FUSE_GATE)[known])

    def agrees(self, k: int, fit: RigidFit) -> bool:
        """Whether half of map k's shared landmarks lie where the others put them, grossly."""
        known, _, _ = self.others(k)
        return float(np.median(fit.residual / self.gates(k, FUSE_REFUSE)[known])) <= 1.0

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
        ratio, residuals = _left_out(cluster)
        if ratio.max(initial=0.0) <= 1.0:
            break
        e = int(np.argmax(ratio))
        residual, name = float(residuals[e]), cluster.entries.name[e]
        here = np.flatnonzero((cluster.entries.name == name) & cluster.counts)
        alone = len(here) == 2
        for entry in here if alone else [e]:
            cluster.drop(np.array([entry]))
            owner = int(cluster.entries.owner[entry])
            outliers.append(Outlier(owner, cluster.entries.ids[name], residual, None, alone))
    return outliers


def find_contradicting(cluster: Consensus) -> list[int]:
    """Maps of which half the landmarks that others hold lie grossly elsewhere, or that share too few; worst first.

    On return they are no part of `cluster` any more.
    """
    out: list[int] = []
    while len(cluster.placed) > 1:
        _, residual = _left_out(cluster)
        names = cluster.entries.name
        known = cluster.counts & (cluster.count[names] > 1)
        off = {}
        for k in cluster.placed:
            at = cluster.entries.of_map(k)
            ratio = (residual[at] / cluster.gates(k, FUSE_REFUSE))[known[at]]
            off[k] = float(np.median(ratio)) if len(ratio) >= ENOUGH else np.inf
        worst = max(off, key=lambda k: (off[k], k))
        if off[worst] <= 1.0:
            break
        cluster.drop(cluster.entries.of_map(worst))
        del cluster.placed[worst]
        out.append(worst)
    return out


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
            if a != b and distance[a, b] < min(FUSE_GATE, 0.5 * residual):
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


def _left_out(cluster: Consensus) -> tuple[Float[np.ndarray, " e"], Float[np.ndarray, " e"]]:
    """Each entry's distance [m] from where the other maps put it, over its gate, and by itself; zero where none do."""
    names, own = cluster.entries.name, cluster.counts
    count = cluster.count[names] - own
    some = np.maximum(count, 1)
    place = (cluster.total[names] - own[:, None] * cluster.position) / some[:, None]
    variance = (cluster.variance[names] - own * cluster.entries.variance) / some**2
    residual = np.hypot(*(cluster.position - place).T) * (count > 0) * own
    gate = np.maximum(FUSE_GATE, GATE_SIGMAS * np.sqrt(np.maximum(variance + cluster.entries.variance, 0.0)))
    return residual / gate, residual


def _elsewhere(cluster: Consensus, name: int, k: int) -> Float[np.ndarray, "2"]:
    """Where maps other than k put a landmark, those that count if any do; NaN where none has it."""
    held = (cluster.entries.name == name) & (cluster.entries.owner != k)
    held &= np.isin(cluster.entries.owner, list(cluster.placed))
    if (held & cluster.counts).any():
        held &= cluster.counts
    return cluster.position[held].mean(axis=0) if held.any() else np.full(2, np.nan)


LISTED = 8  # contradicting landmarks told by name
SEEDS, PARTNERS = 12, 8  # how many maps are tried as the first, each against how many others


@dataclass(frozen=True, slots=True)
class FrameEvidence:
    """log_odds: natural logarithm of the Bayes factor for the same place; shared: names both maps have.

    contradicting: those that lie further apart than `FuseConfig.gate` under the alignment most agree on, the furthest
    first, and `distance`: how far [m].
    """

    log_odds: float
    shared: tuple[str, ...]
    contradicting: tuple[str, ...]
    distance: tuple[float, ...]

    def reason(self, other: str) -> str:
        """Why this is not enough to join `other`, in plain words."""
        n, wrong = len(self.shared), len(self.contradicting)
        if not wrong:
            named = ", ".join(self.shared[:LISTED])
            return f"that the {n} landmarks it shares with {other} ({named}{more(n)}) agree may be chance"
        named = ", ".join(sorted(self.contradicting[:LISTED], key=in_order))
        lie = "lies" if wrong == 1 else "lie"
        far = f"{self.distance[-1]:.2f} to {self.distance[0]:.2f}" if wrong > 1 else f"{self.distance[0]:.2f}"
        return (
            f"contradicts {other}: {n - wrong} of {n} shared landmarks agree; {named}{more(wrong)} {lie} {far} m "
            "from where the others put them"
        )


def more(n: int) -> str:
    """The end of a list of n things of which `LISTED` are told."""
    return f" and {n - LISTED} more" if n > LISTED else ""


def same_place(source: LandmarkMap, target: LandmarkMap, cfg: FuseConfig) -> FrameEvidence:
    """The evidence that the landmarks which both maps name (two at least) are the same ones.

    Both covariances are multiplied by `cfg.distrust` first: filters are too sure of themselves.
    """
    there = set(target.ids)
    shared = tuple(name for name in source.ids if name in there)
    weighed = tuple(shared[i] for i in spread(len(shared), FUSE_WEIGHED))
    a, b = _distrusted(source.select(weighed)), _distrusted(target.select(weighed))
    rough = align_robust(a.mean, b.mean, np.full(len(weighed), FUSE_GATE))
    apart = np.hypot(*(se2.act(rough.T_target_source, a.mean) - b.mean).T)
    far = [int(i) for i in np.argsort(-apart, kind="stable") if apart[i] > FUSE_GATE]
    area = max(min(spread_area(source), spread_area(target)), 1e-12)
    return FrameEvidence(
        log_odds=_log_odds(a, b, rough.T_target_source, area, cfg),
        shared=shared,
        contradicting=tuple(weighed[i] for i in far),
        distance=tuple(float(apart[i]) for i in far),
    )


@dataclass(slots=True)
class PlaceTest:
    """Which of `maps` may be joined; robots[k] drove map k, recordings[k] names the recording it is made from.

    Maps of one recording share a table of names, so that little evidence does; names of two recordings may have
    nothing to do with each other. Every pair is worked out once.
    """

    maps: Sequence[LandmarkMap]
    robots: Sequence[str]
    recordings: Sequence[str]
    cfg: FuseConfig
    _known: dict[tuple[int, int], FrameEvidence] = field(init=False, default_factory=dict)

    def evidence(self, i: int, k: int) -> FrameEvidence:
        """For maps i and k, which share two names at least, showing the same place; either order gives the same."""
        pair = (min(i, k), max(i, k))
        if pair not in self._known:
            self._known[pair] = same_place(self.maps[pair[1]], self.maps[pair[0]], self.cfg)
        return self._known[pair]

    def joins(self, i: int, k: int) -> bool:
        """Whether maps i and k show the same place."""
        return self.evidence(i, k).log_odds >= self.needed([i, k])

    def needed(self, members: Sequence[int]) -> float:
        """The log-odds from which these maps are one place."""
        one = len({self.recordings[k] for k in members}) == 1
        return float(np.log(FUSE_ODDS_WITHIN if one else FUSE_ODDS))


def _distrusted(m: LandmarkMap) -> LandmarkMap:
    return LandmarkMap(m.ids, m.mean, FUSE_DISTRUST * m.cov, m.frame)


def _log_odds(a: LandmarkMap, b: LandmarkMap, T: Float[np.ndarray, "3"], area: float, cfg: FuseConfig) -> float:
    """The log Bayes factor of landmark i of `a` being landmark i of `b`; -inf where under half of them can be.

    The transform, uniform over the area and all headings, and the scale are integrated over (Laplace's method).
    """
    n = len(a)
    links = np.stack([np.arange(n)] * 2, axis=1)
    fit = joint_fit(a, b, links, T, cfg.floor, cfg.scale_sigma)
    while len(links) > ENOUGH and fit.single.max() > MISLABELLED_CHI2:
        if 2 * (len(links) - 1) < n:
            return -np.inf
        links = np.delete(links, int(np.argmax(fit.single)), axis=0)
        fit = joint_fit(a, b, links, fit.T, cfg.floor, cfg.scale_sigma)
    k = len(links)
    names = k * np.log1p(-MISLABELLED) + (n - k) * np.log(MISLABELLED)
    return log_evidence(a, b, links, fit, area, cfg.floor, cfg.scale_sigma) + float(names)


def arrange(test: PlaceTest) -> tuple[list[Consensus], dict[int, str]]:
    """The test's maps parted into connected clusters, the largest first, and why that one refused a map.

    A map joins the cluster it shares most with, two landmarks at least, when half of these agree grossly and the
    evidence for the same place suffices. Clusters that come to share two landmarks are joined as well.
    """
    entries = Entries.of(test.maps)
    waiting = set(range(len(test.maps)))
    clusters: list[Consensus] = []
    while waiting:
        seed = _seed(entries, test, waiting)
        cluster = Consensus(entries, test.cfg)
        cluster.place(seed, np.zeros(3))
        waiting.discard(seed)
        _grow(cluster, test, waiting)
        clusters.append(cluster)
    clusters = _merge(clusters, test)
    for cluster in clusters:
        cluster.converge()
    clusters.sort(key=lambda c: (-len(c.placed), min(c.placed)))
    left = [k for cluster in clusters[1:] for k in sorted(cluster.placed)]
    reasons = ((k, _contradiction(clusters[0], test, k)) for k in left)
    return clusters, {k: reason for k, reason in reasons if reason is not None}


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


def _seed(entries: Entries, test: PlaceTest, waiting: set[int]) -> int:
    """The map that agrees with most others: a bad map must not be the one that the rest is measured against."""
    shared = overlaps(entries, waiting)
    shared[shared < ENOUGH] = 0
    candidates = sorted(waiting, key=lambda k: (-int(shared[k].sum()), k))[:SEEDS]
    votes = {}
    for k in candidates:
        alone = Consensus(entries, test.cfg)
        alone.place(k, np.zeros(3))
        partners = [int(j) for j in np.argsort(-shared[k], kind="stable")[:PARTNERS] if shared[k, j] > 0]
        fits = ((j, alone.fit(j)) for j in partners if test.joins(j, k))
        votes[k] = sum(int(fit.inliers.sum()) for j, fit in fits if fit is not None and alone.agrees(j, fit))
    return max(candidates, key=lambda k: votes[k])


def _grow(cluster: Consensus, test: PlaceTest, waiting: set[int]) -> None:
    """`waiting` maps that agree join the cluster, most in common first."""
    entries = cluster.entries
    has = _shared_counts(cluster, waiting)
    failed: dict[int, int] = {}
    while True:
        open_ = [k for k in waiting if has[k] >= ENOUGH and failed.get(k) != has[k]]
        if not open_:
            return
        k = min(open_, key=lambda k: (-int(has[k]), k))
        T = place_in(cluster, test, k)
        if T is None:
            failed[k] = int(has[k])
            continue
        fresh = entries.name[entries.of_map(k)]
        fresh = fresh[cluster.count[fresh] == 0]
        cluster.place(k, T)
        waiting.discard(k)
        np.add.at(has, entries.owner[np.isin(entries.name, fresh)], 1)


def place_in(cluster: Consensus, test: PlaceTest, k: int) -> Float[np.ndarray, "3"] | None:
    """Where map k lies in the cluster; None where it does not agree, or nothing shows that it is the same place."""
    fit = cluster.fit(k)
    if fit is None or not cluster.agrees(k, fit) or not _belongs(cluster, test, k):
        return None
    return np.asarray(fit.T_target_source)


def _belongs(cluster: Consensus, test: PlaceTest, k: int) -> bool:
    """Whether map k shows the same place as a map of the cluster, or as all of them together."""
    if any(test.joins(j, k) for j in _partners(cluster, k)):
        return True
    names = cluster.entries.name[cluster.entries.of_map(k)]
    shared = np.unique(names[cluster.count[names] > 0])
    evidence = same_place(test.maps[k], _as_map(cluster, shared), test.cfg)
    return evidence.log_odds >= test.needed([k, *_holders(cluster, shared)])


def _partners(cluster: Consensus, k: int) -> list[int]:
    """The placed maps that map k shares most with, two landmarks at least."""
    entries = cluster.entries
    shared = np.isin(entries.name, entries.name[entries.of_map(k)]) & np.isin(entries.owner, list(cluster.placed))
    count = np.bincount(entries.owner[shared], minlength=len(entries.begin) - 1)
    return [int(j) for j in np.argsort(-count, kind="stable")[:PARTNERS] if count[j] >= ENOUGH and j != k]


def _holders(cluster: Consensus, names: Int[np.ndarray, " n"]) -> list[int]:
    """The placed maps in which landmarks `names` count."""
    entries = cluster.entries
    return [int(j) for j in np.unique(entries.owner[np.isin(entries.name, names) & cluster.counts])]


def _as_map(cluster: Consensus, names: Int[np.ndarray, " n"]) -> LandmarkMap:
    """Where the cluster puts landmarks `names`, each as unsure as its maps are one by one."""
    count = cluster.count[names]
    variance = cluster.variance[names] / (2 * count)  # of one axis
    ids = tuple(cluster.entries.ids[n] for n in names)
    return LandmarkMap(ids, cluster.total[names] / count[:, None], np.diag(np.repeat(variance, 2)))


def _contradiction(cluster: Consensus, test: PlaceTest, k: int) -> str | None:
    """Why map k is no part of the cluster; None where they share fewer than two landmarks."""
    partners = _partners(cluster, k)
    if partners:
        return test.evidence(partners[0], k).reason(test.robots[partners[0]])
    names = cluster.entries.name[cluster.entries.of_map(k)]
    shared = np.unique(names[cluster.count[names] > 0])
    if len(shared) < ENOUGH:
        return None
    return same_place(test.maps[k], _as_map(cluster, shared), test.cfg).reason("the other robots")


def _shared_counts(cluster: Consensus, waiting: set[int]) -> Int[np.ndarray, " k"]:
    entries = cluster.entries
    held = cluster.count[entries.name] > 0
    counts = np.bincount(entries.owner[held], minlength=len(entries.begin) - 1)
    return np.array([c if k in waiting else 0 for k, c in enumerate(counts)])


def _merge(clusters: list[Consensus], test: PlaceTest) -> list[Consensus]:
    """Clusters that share two landmarks between them (no single pair of maps need) become one where they agree."""
    done = False
    while not done:
        done = True
        for a in range(len(clusters)):
            for b in range(a + 1, len(clusters)):
                if absorbed(clusters[a], clusters[b], test) is not None:
                    del clusters[b]
                    done = False
                    break
            if not done:
                break
    return clusters


def absorbed(into: Consensus, other: Consensus, test: PlaceTest) -> Float[np.ndarray, "3"] | None:
    """Where `other` lies in `into`, whose maps are placed there; None, and nothing done, where nothing shows it."""
    both = np.flatnonzero((into.count > 0) & (other.count > 0))
    if len(both) < ENOUGH:
        return None
    source = other.total[both] / other.count[both, None]
    target = into.total[both] / into.count[both, None]
    sigma = np.sqrt(other.variance[both] / other.count[both] ** 2 + into.variance[both] / into.count[both] ** 2)
    cfg = into.cfg
    fit = align_robust(source, target, np.maximum(FUSE_GATE, GATE_SIGMAS * sigma))
    if float(np.median(fit.residual / np.maximum(FUSE_REFUSE, GATE_SIGMAS * sigma))) > 1.0:
        return None
    evidence = same_place(_as_map(other, both), _as_map(into, both), cfg)
    if evidence.log_odds < test.needed([*_holders(into, both), *_holders(other, both)]):
        return None
    for k, T in other.placed.items():
        into.place(k, se2.compose(fit.T_target_source, T))
    return np.asarray(fit.T_target_source)
