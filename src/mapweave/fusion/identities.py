"""Which landmark of one map is which of another when nobody told: alignment first, then names, then the joint test.

Distances do not depend on the frame: two landmarks of one map and two of the other that lie equally far apart propose
an alignment. Those that bring most landmarks together name them by optimal assignment; names are then exchanged in
pairs while that makes the joint chi-square smaller. Of what is found the likeliest is believed, where it is likelier
than chance: so many ways there are to pair a few landmarks of two maps that some pairing nearly always fits.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from ..core import se2
from ..core.config import config
from ..landmarks.landmark_map import LandmarkMap
from .alignment import JointFit, joint_fit, log_correspondences, log_evidence, spread_area

IDENTITY_LINKS = 6  # landmarks that must agree before a match is believed
NAMED_LINKS = 3  # landmarks of one name that must agree before two maps are one
IDENTITY_CHANCE = 5.0  # how much likelier than chance, all ways to pair as many landmarks counted
IDENTITY_LOOKED = 1000.0  # the same where it is known where the robots looked: six right links are worth far more
IDENTITY_ODDS = 5.0  # how much likelier than any other alignment
IDENTITY_REPEATED = 0.5  # share of its links that another alignment beyond chance may have
IDENTITY_LOOSE = 0.05  # probability that maps err by noise and scale too, before they are compared
IDENTITY_TIGHT = 0.1  # share of noise and scale that is left where they do not
CHI2_PER_DOF = 3.0  # chi-square per degree of freedom up to which a match is believed
IDENTITY_RIVALS = 8  # distinct alignments that are worked out
IDENTITY_LONE = 18.0  # chi-square (two degrees) that one link alone may add
OVERLAPPING = np.log(4.0)  # over how many times one's area the other of two maps alike may lie and still touch it

CHUNK = 2_000_000  # distances held at once
GRID = 15  # points along either side of a map at which it is asked where its robot looked
BATCH = 320  # alignments compared with those chosen at once: nearly all near the first are among so many


@config
class IdentityConfig:
    """When a match is believed: links needed, evidence against chance and other alignments, chi-square per degree.

    gate: standard deviations within which two landmarks may be one. noise: what covariances do not know of [m];
    scale_sigma: deviation of one map's scale from the other's. Maps may have these errors, or (`tight`) hardly any:
    the evidence is that of the likelier of the two, `loose` the probability of the first.
    """

    gate: float = 3.0  # standard deviations within which two landmarks may be one
    noise: float = 0.01  # [m] what covariances do not know of
    scale_sigma: float = 0.02  # deviation of one map's scale from the other's
    hypotheses: int = 20_000  # alignments tried, at most


@dataclass(frozen=True, slots=True)
class Match:
    """links: (k, 2) indices into source and target; `accepted`, or the plain reason why not.

    T_target_source: the alignment found; rival: how many links the next best alignment has; evidence: logarithm of
    the odds for these links against chance; rival_evidence: the highest of any other alignment.
    """

    links: Int[np.ndarray, "k 2"]
    T_target_source: Float[np.ndarray, "3"]
    chi2: float
    dof: int
    rival: int
    accepted: bool
    reason: str
    evidence: float = -np.inf
    rival_evidence: float = -np.inf


@dataclass(frozen=True, slots=True)
class AlignmentCandidate:
    """An alignment worked out: its links (k, 2), the joint fit of these, and their `evidence`."""

    links: Int[np.ndarray, "k 2"]
    fit: JointFit
    evidence: float


Mapped = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
"""The probability that a robot has landmarks at n points of its frame in its map, if there are any."""


def match_maps(
    source: LandmarkMap,
    target: LandmarkMap,
    cfg: IdentityConfig | None = None,
    mapped: tuple[Mapped | None, Mapped | None] = (None, None),
) -> Match:
    """The landmarks that `source` and `target` have in common, names ignored; refused with a reason when unsure.

    mapped: of the robots that made `source` and `target`. With both, a landmark of one map that is none of the other's
    although it stands where the other's robot looked is evidence against an alignment.
    """
    cfg = cfg or IdentityConfig()
    here, there = mapped
    looked = None if here is None or there is None or not len(source) else _Looked.of(source, target, here, there)
    candidates = [_weighed(source, target, T, cfg, looked) for T in _proposals(source, target, cfg)]
    candidates = [c for c in candidates if len(c.links) >= 2]
    if not candidates:
        none = np.zeros((0, 2), dtype=np.intp)
        return Match(
            none, np.zeros(3), 0.0, 0, 0, accepted=False, reason="no two landmarks lie equally far apart in both"
        )
    candidates.sort(key=lambda c: (len(c.links) < IDENTITY_LINKS, -c.evidence, -len(c.links)))
    best = candidates[0]
    rivals = [c for c in candidates[1:] if _rivals(c, best, source, target, cfg)]
    rival = max((len(c.links) for c in rivals), default=0)
    second = max((c.evidence for c in rivals), default=-np.inf)
    k = len(best.links)
    chance = float(np.log(IDENTITY_CHANCE if looked is None else IDENTITY_LOOKED))
    reason = _refusal(best, rivals, chance) or _chance(best, len(source), len(target), chance)
    return Match(best.links, best.fit.T, best.fit.chi2, 2 * k - 3, rival, not reason, reason, best.evidence, second)


def match_names(source: LandmarkMap, target: LandmarkMap, cfg: IdentityConfig | None = None) -> Match:
    """How `source` lies in `target` by the names that both have; refused with a reason when these do not fit together.

    Three names are needed: the third is what can contradict.
    """
    cfg = cfg or IdentityConfig()
    there = {name: k for k, name in enumerate(target.ids)}
    links = np.array([(i, there[name]) for i, name in enumerate(source.ids) if name in there], dtype=np.intp)
    links = links.reshape(-1, 2)
    k = len(links)
    if k < NAMED_LINKS:
        reason = f"{k} landmarks in common, {NAMED_LINKS} are needed"
        return Match(links, np.zeros(3), 0.0, 0, 0, accepted=False, reason=reason)
    T = se2.align(source.mean[links[:, 0]], target.mean[links[:, 1]])
    fit = joint_fit(source, target, links, T, cfg.noise, cfg.scale_sigma)
    per_dof = fit.chi2 / (2 * k - 3)
    reason = "" if per_dof <= CHI2_PER_DOF else f"the {k} landmarks in common do not fit: {_per_dof(per_dof)}"
    return Match(links, fit.T, fit.chi2, 2 * k - 3, 0, not reason, reason, np.inf)


def _per_dof(value: float) -> str:
    return f"chi-square per degree of freedom {value:.1f}"


def _refusal(best: AlignmentCandidate, rivals: Sequence[AlignmentCandidate], chance: float) -> str:
    """Why `best` is not believed beside `rivals`; "" where there is no reason. chance: evidence that is beyond it.

    A rival beyond chance says that the place repeats itself: however much likelier the best one is, it may lay a part
    on another that is alike, unless it links far more than what repeats.
    """
    k = len(best.links)
    if k < IDENTITY_LINKS:
        return f"{k} landmarks fit together, {IDENTITY_LINKS} are needed"
    as_well = [len(c.links) for c in rivals if c.evidence > best.evidence - np.log(IDENTITY_ODDS)]
    if as_well:
        return f"{k} landmarks fit together, but {max(as_well)} do as well in another alignment"
    repeated = max((len(c.links) for c in rivals if c.evidence >= chance), default=0)
    if repeated > IDENTITY_REPEATED * k:
        return f"{k} landmarks fit together, and {repeated} in another alignment too: the place repeats itself"
    per_dof = best.fit.chi2 / (2 * k - 3)
    if per_dof > CHI2_PER_DOF:
        return f"the {k} landmarks that lie together do not fit: {_per_dof(per_dof)}"
    return ""


def _chance(best: AlignmentCandidate, n: int, m: int, chance: float) -> str:
    if best.evidence >= chance:
        return ""
    return f"that {len(best.links)} landmarks of {n} and {m} fit together may be chance"


def _rivals(
    c: AlignmentCandidate, best: AlignmentCandidate, source: LandmarkMap, target: LandmarkMap, cfg: IdentityConfig
) -> bool:
    """Whether `c` fits and is another alignment than `best`, no worse version of it with half the links alike."""
    alike = int(np.count_nonzero((c.links[:, None] == best.links).all(axis=2).any(axis=1)))
    return 2 * alike < len(c.links) and _distinct(c.fit.T, best.fit.T, source, target, cfg) and _fits(c)


def _fits(c: AlignmentCandidate) -> bool:
    return len(c.links) > 2 and c.fit.chi2 <= CHI2_PER_DOF * (2 * len(c.links) - 3)


def _weighed(
    source: LandmarkMap,
    target: LandmarkMap,
    T: Float[np.ndarray, "3"],
    cfg: IdentityConfig,
    looked: "_Looked | None" = None,
) -> AlignmentCandidate:
    """The alignment begun at T with the links that are most evidence, those that are none let go."""
    links, fit = _worked_out(source, target, T, cfg)
    if len(links) <= 2:
        return AlignmentCandidate(links, fit, -np.inf)
    area = max(min(spread_area(source), spread_area(target)), 1e-12)
    overlap = None if looked is None else looked.overlap(fit)
    models = (
        (cfg.noise, cfg.scale_sigma, IDENTITY_LOOSE),
        (IDENTITY_TIGHT * cfg.noise, IDENTITY_TIGHT * cfg.scale_sigma, 1 - IDENTITY_LOOSE),
    )
    best = (-np.inf, links)
    for noise, scale_sigma, share in models:
        kept, before = links, -np.inf
        while True:
            refit = joint_fit(source, target, kept, fit.T, noise, scale_sigma)
            known = log_evidence(source, target, kept, refit, area, noise, scale_sigma) + np.log(share)
            evidence = known + _log_pairing(kept, len(source), len(target), overlap)
            if evidence <= before:
                break
            best, before = max(best, (evidence, kept), key=lambda b: b[0]), evidence
            if len(kept) <= max(IDENTITY_LINKS, 3):
                break
            kept = np.delete(kept, int(np.argmax(refit.single)), axis=0)
    if len(best[1]) < len(links):
        links = best[1]
        fit = joint_fit(source, target, links, fit.T, cfg.noise, cfg.scale_sigma)
    return AlignmentCandidate(links, fit, float(best[0]))


@dataclass(frozen=True, slots=True)
class _Overlap:
    """Two maps laid on each other: where the robot of one looked among the other's landmarks.

    source, target: (n,) and (m,) the probability of each landmark to be in the other map too; expected: how many
    landmarks both should hold.
    """

    source: Float[np.ndarray, " n"]
    target: Float[np.ndarray, " m"]
    expected: float


@dataclass(frozen=True, slots=True)
class _Looked:
    """What overlaps are worked out from. grid: points where `source` lies; held: their probabilities there."""

    maps: tuple[LandmarkMap, LandmarkMap]
    mapped: tuple[Mapped, Mapped]
    grid: Float[np.ndarray, "g 2"]
    held: Float[np.ndarray, " g"]

    @classmethod
    def of(cls, source: LandmarkMap, target: LandmarkMap, here: Mapped, there: Mapped) -> "_Looked":
        x, y = (np.linspace(p.min(), p.max(), GRID) for p in source.mean.T)
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return cls((source, target), (here, there), grid, here(grid))

    def overlap(self, fit: JointFit) -> _Overlap:
        (source, target), (here, there) = self.maps, self.mapped
        both = there(np.concatenate([se2.act(fit.T, fit.scale * p) for p in (source.mean, self.grid)]))
        n = len(source)
        shared = n * float(both[n:] @ self.held) / max(float(self.held.sum()), 1e-12)
        return _Overlap(both[:n], here(se2.act(se2.inverse(fit.T), target.mean) / fit.scale), shared)


def _log_pairing(links: Int[np.ndarray, "k 2"], n: int, m: int, overlap: _Overlap | None) -> float:
    """Logarithm of how much likelier one place is than two for who is linked and who is not.

    Where nobody knows where the robots looked, all ways to pair as many landmarks are alike. Else landmarks are Poisson
    points, as dense as in the map of more: links are rare by chance, unlinked ones where both looked rare in one place.
    """
    k = len(links)
    if overlap is None:
        return -log_correspondences(k, n, m)
    alone = np.delete(overlap.source, links[:, 0]), np.delete(overlap.target, links[:, 1])
    missed = sum(float(np.log1p(-p).sum()) for p in alone)
    return float(overlap.expected - k * np.log(max(n, m)) + missed - OVERLAPPING)


def _distinct(
    T: Float[np.ndarray, "3"], U: Float[np.ndarray, "3"], source: LandmarkMap, target: LandmarkMap, cfg: IdentityConfig
) -> bool:
    """Whether two alignments put the source's landmarks in different places."""
    apart = np.hypot(*(se2.act(T, source.mean) - se2.act(U, source.mean)).T)
    return bool(np.median(apart) > np.median(_gates(source, target, cfg)))


def _variances(m: LandmarkMap) -> Float[np.ndarray, " n"]:
    """Of each landmark, the mean of both axes [m^2]."""
    return np.asarray(0.5 * np.diag(m.cov).reshape(-1, 2).sum(axis=1))


def _gates(
    source: LandmarkMap, target: LandmarkMap, cfg: IdentityConfig, scale_sigma: float | None = None
) -> Float[np.ndarray, "n m"]:
    """How far apart two landmarks may be and still be one [m], whatever the scale (or within `scale_sigma` of it)."""
    scale = cfg.scale_sigma if scale_sigma is None else scale_sigma
    both = _variances(source)[:, None] + _variances(target)[None] + 2 * cfg.noise**2
    off = np.hypot(*(source.mean - source.mean.mean(axis=0)).T)
    return np.asarray(cfg.gate * np.sqrt(both + (scale * off[:, None]) ** 2))


def _proposals(source: LandmarkMap, target: LandmarkMap, cfg: IdentityConfig) -> list[np.ndarray]:
    """Distinct alignments, the one that brings most landmarks together first."""
    turn, shift = _hypotheses(source, target, cfg)
    if not len(turn):
        return []
    s, t = source.mean @ (1, 1j), target.mean @ (1, 1j)
    gates2 = _gates(source, target, cfg) ** 2
    score = np.empty(len(turn))
    step = max(1, CHUNK // (len(s) * len(t)))
    for a in range(0, len(turn), step):
        aligned = turn[a : a + step, None] * s + shift[a : a + step, None]
        d = aligned[:, :, None] - t
        near = 1.0 - (d.real**2 + d.imag**2) / gates2
        score[a : a + step] = np.maximum(near.max(axis=2), 0.0).sum(axis=1)
    near2 = np.median(gates2)
    out: list[np.ndarray] = []
    best = np.argsort(-score, kind="stable")
    for a in range(0, len(best), BATCH):
        left = best[a : a + BATCH]
        for U in out:
            left = left[_moved_by(turn[left], shift[left], U, s) > near2]
        while len(left) and len(out) < IDENTITY_RIVALS:
            out.append(se2.pose(shift[left[0]].real, shift[left[0]].imag, float(np.angle(turn[left[0]]))))
            left = left[_moved_by(turn[left], shift[left], out[-1], s) > near2]
        if len(out) == IDENTITY_RIVALS:
            break
    return out


def _moved_by(
    turn: np.ndarray, shift: np.ndarray, U: Float[np.ndarray, "3"], points: np.ndarray
) -> Float[np.ndarray, " h"]:
    """How far from where U puts them each of h alignments puts points of the complex plane, squared, the median."""
    apart = (turn - np.exp(1j * U[2]))[:, None] * points + (shift - complex(U[0], U[1]))[:, None]
    return np.asarray(np.median(apart.real**2 + apart.imag**2, axis=1))


def _hypotheses(source: LandmarkMap, target: LandmarkMap, cfg: IdentityConfig) -> tuple[np.ndarray, np.ndarray]:
    """Rigid transforms, as rotation and shift of the complex plane, of pairs equally far apart; longest first."""
    i, j, long, u = _pairs(source, cfg)
    k, l, far, v = _pairs(target, cfg)
    order = np.argsort(-long, kind="stable")
    by_length = np.argsort(far, kind="stable")
    sure = float(v.max(initial=0.0))
    reach = cfg.gate * np.sqrt(u + sure + (cfg.scale_sigma * long) ** 2)
    first = np.searchsorted(far[by_length], (long - reach)[order])
    last = np.searchsorted(far[by_length], (long + reach)[order])
    count = last - first
    keep = np.cumsum(count) <= max(cfg.hypotheses // 2, int(count[:1].sum()))
    order, first, count = order[keep], first[keep], count[keep]
    a = np.repeat(order, count)
    b = by_length[np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(count.sum())]
    fits = np.abs(long[a] - far[b]) < cfg.gate * np.sqrt(u[a] + v[b] + (cfg.scale_sigma * long[a]) ** 2)
    a, b = a[fits], b[fits]
    s, t = source.mean @ (1, 1j), target.mean @ (1, 1j)
    turns, shifts = [], []
    for p, q in ((k[b], l[b]), (l[b], k[b])):
        turn = (t[q] - t[p]) * np.conj(s[j[a]] - s[i[a]])
        turn /= np.maximum(np.abs(turn), 1e-300)
        turns.append(turn)
        shifts.append(0.5 * (t[p] + t[q]) - turn * 0.5 * (s[i[a]] + s[j[a]]))
    return np.concatenate(turns), np.concatenate(shifts)


def _pairs(m: LandmarkMap, cfg: IdentityConfig) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every pair: the two, how far apart [m], and the variance of that [m^2]."""
    i, j = np.triu_indices(len(m), 1)
    v = _variances(m) + cfg.noise**2
    d = np.hypot(*(m.mean[i] - m.mean[j]).T)
    keep = d > 3 * np.sqrt(v[i] + v[j])  # shorter ones do not tell a direction
    return i[keep], j[keep], d[keep], (v[i] + v[j])[keep]


def _worked_out(
    source: LandmarkMap, target: LandmarkMap, T: Float[np.ndarray, "3"], cfg: IdentityConfig
) -> tuple[Int[np.ndarray, "k 2"], JointFit]:
    """Names by assignment, alignment by the names, until still; then exchanges and the joint test of every link."""
    gates2 = _gates(source, target, cfg) ** 2
    links = np.zeros((0, 2), dtype=np.intp)
    for _ in range(6):
        before, links = links, _assigned(se2.act(T, source.mean), target.mean, gates2)
        if len(links) < 2 or np.array_equal(links, before):
            break
        T = se2.align(source.mean[links[:, 0]], target.mean[links[:, 1]])
    fit = JointFit(T, 1.0, 0.0, np.zeros(len(links)))
    tight2 = _gates(source, target, cfg, 0.0) ** 2
    for _ in range(6):  # now with the scale that was found, no longer with any that may be
        if len(links) < 3:
            return links, fit
        fit = joint_fit(source, target, links, fit.T, cfg.noise, cfg.scale_sigma)
        before, links = links, _assigned(se2.act(fit.T, fit.scale * source.mean), target.mean, tight2)
        if np.array_equal(links, before):
            break
    if len(links) < 3:
        return links, fit
    fit = joint_fit(source, target, links, fit.T, cfg.noise, cfg.scale_sigma)
    links, fit = _exchanged(source, target, links, fit, cfg)
    while len(links) > 2 and fit.single.max() > IDENTITY_LONE:
        links = np.delete(links, int(np.argmax(fit.single)), axis=0)
        fit = joint_fit(source, target, links, fit.T, cfg.noise, cfg.scale_sigma)
    return links, fit


def _assigned(
    aligned: Float[np.ndarray, "n 2"], there: Float[np.ndarray, "m 2"], gates2: Float[np.ndarray, "n m"]
) -> Int[np.ndarray, "k 2"]:
    """Links within their gates of least squared distance together."""
    cost = np.minimum(np.square(aligned[:, None] - there).sum(axis=2) / gates2, 1.0)
    rows, columns = linear_sum_assignment(cost)
    near = cost[rows, columns] < 1.0
    return np.stack([rows[near], columns[near]], axis=1)


def _exchanged(
    source: LandmarkMap, target: LandmarkMap, links: Int[np.ndarray, "k 2"], fit: JointFit, cfg: IdentityConfig
) -> tuple[Int[np.ndarray, "k 2"], JointFit]:
    """The links with names exchanged in pairs, or given to a free landmark near by, while chi-square falls."""
    gates = _gates(source, target, cfg, 0.0)
    while True:
        best = (fit.chi2, links, fit)
        for changed in _neighbours(se2.act(fit.T, fit.scale * source.mean), target.mean, links, gates):
            new = joint_fit(source, target, changed, fit.T, cfg.noise, cfg.scale_sigma)
            if new.chi2 < best[0] - 1e-9:
                best = (new.chi2, changed, new)
        if best[1] is links:
            return links, fit
        _, links, fit = best


def _neighbours(
    aligned: Float[np.ndarray, "n 2"], there: Float[np.ndarray, "m 2"], links: np.ndarray, gates: np.ndarray
) -> Sequence[np.ndarray]:
    """Assignments one exchange away in which everything still lies within twice its gate."""
    near = np.hypot(*np.moveaxis(aligned[:, None] - there, -1, 0)) < 2 * gates
    out = []
    free = np.setdiff1d(np.arange(len(there)), links[:, 1])
    for a in range(len(links)):
        for b in range(a + 1, len(links)):
            if near[links[a, 0], links[b, 1]] and near[links[b, 0], links[a, 1]]:
                changed = links.copy()
                changed[a, 1], changed[b, 1] = links[b, 1], links[a, 1]
                out.append(changed)
        for other in free[near[links[a, 0], free]]:
            changed = links.copy()
            changed[a, 1] = other
            out.append(changed)
    return out


@dataclass(frozen=True, slots=True)
class Identified:
    """maps: with common names, in the order given; labels[k]: own name -> common name; reasons[k]: why map k was
    matched with no other.
    """

    maps: tuple[LandmarkMap, ...]
    labels: Mapping[int, Mapping[str, str]]
    reasons: Mapping[int, str] = field(default_factory=dict)


def identify(
    maps: Sequence[LandmarkMap],
    robots: Sequence[str],
    cfg: IdentityConfig | None = None,
    mapped: Sequence[Mapped | None] = (),
) -> Identified:
    """`maps` with names that mean the same landmark in all of them; the names they came with mean nothing.

    Every pair of maps is matched, the surest matches are believed first, and no landmark is one with two of another
    map. A common name is the one it has in its first map, prefixed by the robot where that is taken already. mapped:
    what `match_maps` takes, of every robot or of none.
    """
    mapped = mapped or [None] * len(maps)
    classes: dict[tuple[int, str], set[tuple[int, str]]] = {(k, i): {(k, i)} for k, m in enumerate(maps) for i in m.ids}
    matched: set[int] = set()
    refusals: dict[int, str] = {}
    matches = []
    for a in range(len(maps)):
        for b in range(a + 1, len(maps)):
            match = match_maps(maps[a], maps[b], cfg, (mapped[a], mapped[b]))
            if match.accepted:
                matches.append((-len(match.links), match.chi2 / max(match.dof, 1), a, b, match.links))
                matched |= {a, b}
            else:
                refusals.setdefault(a, f"with {robots[b]}: {match.reason}")
                refusals.setdefault(b, f"with {robots[a]}: {match.reason}")
    for _, _, a, b, links in sorted(matches, key=lambda f: f[:4]):
        for i, j in links:
            one, two = classes[a, maps[a].ids[i]], classes[b, maps[b].ids[j]]
            if one is not two and not {k for k, _ in one} & {k for k, _ in two}:
                one |= two
                classes.update(dict.fromkeys(two, one))
    names = _names(maps, robots, classes)
    renamed = [LandmarkMap(tuple(names[k, i] for i in m.ids), m.mean, m.cov, m.frame) for k, m in enumerate(maps)]
    labels = {k: {i: names[k, i] for i in m.ids if names[k, i] != i} for k, m in enumerate(maps)}
    lonely = {k: why for k, why in refusals.items() if k not in matched}
    return Identified(tuple(renamed), labels, lonely)


def _names(
    maps: Sequence[LandmarkMap], robots: Sequence[str], classes: Mapping[tuple[int, str], set[tuple[int, str]]]
) -> dict[tuple[int, str], str]:
    names: dict[tuple[int, str], str] = {}
    taken: set[str] = set()
    for k, m in enumerate(maps):
        for i in m.ids:
            if (k, i) in names:
                continue
            name = i if i not in taken else f"{robots[k]}:{i}"
            taken.add(name)
            names.update(dict.fromkeys(classes[k, i], name))
    return names
