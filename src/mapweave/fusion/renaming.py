"""Robots that call landmarks by other names than the rest: where names contradict, places are asked without them.

A map whose names put its landmarks elsewhere than the others do is matched with theirs by geometry alone
(`match_maps`). The renaming that follows is believed only where chance, another alignment and another place explain
what fits much worse: a map that is refused can be looked into, two places made one cannot be parted again.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull

from ..core import se2
from ..core.names import unused
from ..landmarks.landmark_map import LandmarkMap
from .alignment import JointFit, joint_fit, left_out, spread_area
from .cluster import ENOUGH
from .config import FUSE_GATE, FUSE_ODDS, VARIANCE_PRIOR, FuseConfig
from .full_covariance import join
from .identities import IDENTITY_LINKS, IdentityConfig, match_maps
from .initial_frames import Consensus, Outlier, PlaceTest, arrange, as_cluster, find_outliers

SURROUNDED = 0.6  # share of a map's landmarks among those linked that must be linked: both robots have been there
SURE = 0.95  # probability of a link from which its landmark is renamed
REPEATED = 0.6  # share of the links that another alignment may have: what repeats itself proves nothing
PAIRED = 2e8  # distances worked out for one match, about


@dataclass(frozen=True, slots=True)
class Renaming:
    """Map `owner` calls landmarks otherwise than the maps `others`: names[own] is what they call it.

    apart: names that mean another landmark there, and which of theirs the owner's is, if any, is not known; each with
    the name that it got for it.
    """

    owner: int
    others: tuple[int, ...]
    names: Mapping[str, str]
    apart: Mapping[str, str]


@dataclass(slots=True)
class Arranged:
    """How the maps of a test lie: what `arrange` gives of it, and from whom maps took names meanwhile.

    outliers: what does not fit in the clusters, where that was asked; given[k]: the maps whose names map k took.
    """

    test: PlaceTest
    clusters: list[Consensus]
    refused: dict[int, str]
    outliers: list[Outlier] = field(default_factory=list)
    given: dict[int, frozenset[int]] = field(default_factory=dict)

    @classmethod
    def of(cls, test: PlaceTest, given: Mapping[int, frozenset[int]] | None = None) -> "Arranged":
        return cls(test, *arrange(test), [], dict(given or {}))

    def called(self, members: Iterable[int], new: Mapping[str, str], others: Iterable[int]) -> "Arranged":
        """The same with maps `members` renamed after `others`, and arranged anew."""
        named, given = set(members), dict(self.given)
        for k in named:
            given[k] = given.get(k, frozenset()) | frozenset(others)
        maps = [_called(m, new) if k in named else m for k, m in enumerate(self.test.maps)]
        return Arranged.of(replace(self.test, maps=maps), given)

    def together(self, members: Iterable[int]) -> bool:
        """Whether these maps are in one cluster."""
        return any(set(members) <= set(c.placed) for c in self.clusters)

    def doubted(self) -> "Arranged":
        """With the outliers of its clusters, which count no more."""
        self.outliers = [d for c in self.clusters for d in find_outliers(c)]
        return self


def arrange_renamed(test: PlaceTest) -> Arranged:
    """The maps of `test` arranged, those refused for their names under the names that they should carry.

    Every map renamed is part of a larger cluster than before: one that its new names do not join keeps its own.
    """
    now = Arranged.of(test)
    tried: set[tuple[frozenset[int], frozenset[int]]] = set()
    while (found := _next(now.test, now.clusters, tried)) is not None:
        small, large, new = found
        then = now.called(small, new, large)
        if then.together(small | large):
            now = then
    return now


def rename_doubted(now: Arranged) -> Arranged:
    """Maps that lie right but for landmarks which do not fit, these under the names that they should carry.

    now.outliers: those that no exchange of a map's own names mends. Fewer are left: else the names stay.
    """
    asked: set[int] = set()
    while True:
        k = max((d.owner for d in now.outliers if d.owner not in asked), default=None)
        if k is None:
            return now
        asked.add(k)
        cluster = next(c for c in now.clusters if k in c.placed)
        others = sorted(set(cluster.placed) - {k})
        rest = Consensus(cluster.entries, cluster.cfg)
        for j in others:
            rest.place(j, cluster.placed[j])
        own, target = now.test.maps[k], _whole(now.test, rest)
        links = sure_links(own, target, now.test.cfg)
        wrong = {d.id for d in now.outliers if d.owner == k}
        fits = set(own.ids) - wrong
        links = links[[own.ids[i] in wrong and target.ids[j] not in fits for i, j in links]]
        new = _new_names(own, target, links, now.test.robots[k])
        reused = set(new.values())
        new = {name: to for name, to in new.items() if name in wrong and (to in target.ids or name in reused)}
        then = now.called([k], new, others).doubted() if new else now
        if then.together(cluster.placed) and len(then.outliers) < len(now.outliers):
            now = then


def _next(
    test: PlaceTest, clusters: Sequence[Consensus], tried: set[tuple[frozenset[int], frozenset[int]]]
) -> tuple[frozenset[int], frozenset[int], dict[str, str]] | None:
    """The maps of a cluster that are to be renamed, those of a larger one it is part of then, and the new names.

    None where there is none left. Pairs that were asked are in `tried`, and not asked again.
    """
    for at, one in enumerate(clusters):
        for other in clusters[:at]:
            pair = frozenset(one.placed), frozenset(other.placed)
            if pair in tried or np.count_nonzero((one.count > 0) & (other.count > 0)) < ENOUGH:
                continue
            tried.add(pair)
            source, target = _whole(test, one), _whole(test, other)
            links = sure_links(source, target, test.cfg)
            if len(links):
                return *pair, _new_names(source, target, links, test.robots[min(one.placed)])
    return None


def _called(m: LandmarkMap, new: Mapping[str, str]) -> LandmarkMap:
    return LandmarkMap(tuple(new.get(name, name) for name in m.ids), m.mean, m.cov, m.frame)


def renamings(now: Arranged, before: Sequence[LandmarkMap], but: Mapping[int, Collection[str]]) -> list[Renaming]:
    """What became of the names that the maps had `before`; but[k]: names of map k that changed for another reason."""
    out = []
    for k, others in sorted(now.given.items()):
        after = now.test.maps
        theirs = {name for j in others for name in after[j].ids}
        pairs = zip(before[k].ids, after[k].ids, strict=True)
        new = {own: name for own, name in pairs if own != name and own not in but.get(k, ())}
        names = {own: name for own, name in new.items() if name in theirs}
        apart = {own: name for own, name in new.items() if name not in theirs}
        out.append(Renaming(k, tuple(sorted(others)), names, apart))
    return out


def _whole(test: PlaceTest, cluster: Consensus) -> LandmarkMap:
    """All landmarks of a cluster, joined."""
    members = sorted(cluster.placed)
    if len(members) == 1:
        return test.maps[members[0]]
    cfg, maps = test.cfg, [test.maps[k] for k in members]
    start = as_cluster(cluster, test.maps)
    joined = join(maps, start, scale_sigma=cfg.scale_sigma, floor=cfg.floor, variance_prior=VARIANCE_PRIOR)
    return LandmarkMap(joined.ids, joined.mean, joined.cov)


def sure_links(source: LandmarkMap, target: LandmarkMap, cfg: FuseConfig) -> Int[np.ndarray, "k 2"]:
    """Which landmarks of both maps are one, names ignored, where that is beyond doubt; none where it is not.

    Asked beyond `match_maps`: odds of `FUSE_ODDS` against chance; no other alignment that links `REPEATED` as many;
    of either map's landmarks among those linked, `SURROUNDED` linked, since both robots have been there; and of every
    link, that it is right by `SURE`.
    """
    none = np.zeros((0, 2), dtype=np.intp)
    if min(len(source), len(target)) < IDENTITY_LINKS:
        return none
    most = int(max(100, min(cfg.matching.hypotheses, PAIRED / (len(source) * len(target)))))
    match = match_maps(source, target, replace(cfg.matching, hypotheses=most))
    k = len(match.links)
    if not match.accepted or match.evidence < np.log(FUSE_ODDS) or match.rival > REPEATED * k:
        return none
    fit = joint_fit(source, target, match.links, match.T_target_source, cfg.matching.noise, cfg.matching.scale_sigma)
    moved = se2.act(fit.T, fit.scale * source.mean)
    linked = target.mean[match.links[:, 1]]
    among = [int(np.count_nonzero(_surrounded(p, linked))) for p in (moved, target.mean)]
    if k < SURROUNDED * max(among):
        return none
    return match.links[_certainty(source, target, match.links, fit, cfg.matching) >= SURE]


def _certainty(
    source: LandmarkMap, target: LandmarkMap, links: Int[np.ndarray, "k 2"], fit: JointFit, cfg: IdentityConfig
) -> Float[np.ndarray, " k"]:
    """The probability of each link, against every other of its two landmarks and against none.

    Where a landmark should lie, the other links tell. Those that are not linked may lie anywhere.
    """
    r, V = left_out(source, target, links, fit, cfg.noise, cfg.scale_sigma)
    moved = se2.act(fit.T, fit.scale * source.mean)
    i, j = links.T
    H, root = np.linalg.inv(V), 2 * np.pi * np.sqrt(np.linalg.det(V))
    rivals = []
    for other in (target.mean[j][:, None] - target.mean, moved - moved[i][:, None]):  # the link itself is among them
        off = r[:, None] + other
        rivals.append(np.exp(-0.5 * np.einsum("kni,kij,knj->kn", off, H, off)).sum(axis=1) / root)
    own = np.exp(-0.5 * np.einsum("ki,kij,kj->k", r, H, r)) / root
    left = max(len(source), len(target)) - len(links) + 1
    elsewhere = left / min(spread_area(source), spread_area(target))
    return np.asarray(own / (np.maximum(*rivals) + elsewhere))


def _surrounded(points: Float[np.ndarray, "n 2"], by: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, " n"]:
    """Which points lie within the convex hull of others."""
    faces = ConvexHull(by, qhull_options="QJ").equations
    return np.asarray((points @ faces[:, :2].T + faces[:, 2] <= FUSE_GATE).all(axis=1))


def _new_names(source: LandmarkMap, target: LandmarkMap, links: Int[np.ndarray, "k 2"], robot: str) -> dict[str, str]:
    """What every landmark of `source` is to be called, by its own name, where that is another.

    Linked ones as in `target`. Of the rest, a name that means another landmark in `target` gets the robot's before it.
    """
    new = {source.ids[i]: target.ids[j] for i, j in links}
    taken = {*target.ids, *source.ids}
    for name in source.ids:
        if name not in new and name in target.ids:
            own = f"{robot}:{name}"
            new[name] = unused(own, taken) if own in taken else own
            taken.add(new[name])
    return {own: name for own, name in new.items() if own != name}
