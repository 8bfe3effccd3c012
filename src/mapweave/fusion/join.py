"""The front door of fusing: local maps in, one map for each component out, with a reason for every robot.

A map whose names put its landmarks elsewhere than the others do is matched with theirs by geometry alone
(`match_maps`). The renaming that follows is believed only where chance, another alignment and another place explain
what fits much worse: a map that is refused can be looked into, two places made one cannot be parted again.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull

from ..core import se2
from ..core.findings import Finding
from ..core.gaussian import is_positive_definite
from ..core.names import in_order, robot_key, unused
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .alignment import JointFit, joint_fit, left_out, spread_area
from .cluster import ENOUGH, Cluster, JoinedMap, average
from .config import CONSTANT_VARIANCE, FUSE_DELTA, FUSE_GATE, FUSE_ODDS, SIGHTING_EVERY, VARIANCE_PRIOR, FuseConfig
from .full_covariance import join
from .identities import IDENTITY_LINKS, IdentityConfig, identify, match_maps
from .initial_frames import (
    LISTED,
    Consensus,
    Outlier,
    PlaceTest,
    arrange,
    as_cluster,
    find_exchanged,
    find_outliers,
    inflated,
    more,
    relabelled,
    widened,
)
from .relative import FrameSightings, RelativeConfig, frame_sightings, fuse_relative, sighting_factor
from .result import APART, Component, Decision, Fusion

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


SIGHTING_RANGE = 0.3  # [m] standard deviation of a range to a robot that ties frames
SIGHTING_BEARING = 0.1  # [rad] and of a bearing: tracks err more than cameras


def fuse(
    maps: Sequence[LocalMap], cfg: FuseConfig | None = None, recordings: Mapping[str, str] | None = None
) -> Fusion:
    """One map from `maps`, whose robots must have distinct names; the largest component first.

    A log that comes twice (by its hash) counts once. Labels exchanged in one robot are mended, a landmark that one
    robot alone misplaces hardly counts, a map that is grossly wrong is refused; all of it is told. The order of
    `maps` does not matter: each component stands in the first pose of its lowest-numbered robot.

    recordings: robot -> the recording it belongs to, all to one without it. Names of two recordings may mean different
    landmarks: their maps are joined only where geometry proves the same place (`same_place`).
    """
    cfg = cfg or FuseConfig()
    ordered = sorted(maps, key=lambda m: in_order(m.robot))
    if len({m.robot for m in ordered}) != len(ordered):
        raise ValueError("two local maps carry the same robot's name")
    used, decisions, findings = _single_use(ordered)
    faults = {m.robot: why for m in used if (why := unsound(m)) is not None}
    decisions += [Decision(robot, 0, "refused", why) for robot, why in faults.items()]
    sound = [m for m in used if m.robot not in faults]
    landmarks = [m.submap.landmarks for m in sound]
    names = [m.robot for m in sound]
    labels: dict[str, dict[str, str]] = {}
    nameless: dict[int, str] = {}
    if cfg.identities == "unknown":
        mapped = [None if m.view is None else partial(m.view.mapped, m.track) for m in sound]
        identified = identify(landmarks, names, cfg.matching, mapped)
        landmarks, nameless = list(identified.maps), dict(identified.reasons)
        labels = {names[k]: dict(new) for k, new in identified.labels.items() if new}
        recordings = None  # names were found from geometry: they have one meaning now
    before = landmarks
    origins = ["" if recordings is None else recordings.get(name, "") for name in names]
    landmarks, starts, outliers, refused, renamed = _prepare(PlaceTest(landmarks, names, origins, cfg))
    refused = nameless | refused
    otherwise = {r.owner: len(r.names) for r in renamed}
    for k, (old, new) in enumerate(zip(before, landmarks, strict=True)):
        _relabel(labels, sound[k], dict(zip(old.ids, new.ids, strict=True)))
    findings += [_renaming_finding(names, before[r.owner], r) for r in renamed]
    findings += outlier_findings(names, outliers)
    if cfg.repeats != 1:
        findings.append(Finding("maps-repeated", value=cfg.repeats))
    components = []
    for start in starts:
        own = [inflated(landmarks[k], [d for d in outliers if d.owner == k]) for k in start.members]
        seen = _sightings([sound[k] for k in start.members], start.frames) if cfg.robot_sightings else []
        joined = _join(own, start, cfg, seen) if len(own) > 1 else _alone(own[0])
        robots = tuple(names[k] for k in start.members)
        doubted = {names[k]: widened([d for d in outliers if d.owner == k]) for k in start.members}
        components.append(_component(robots, own, joined, {r: wide for r, wide in doubted.items() if wide}))
        decisions += [
            _decide(robots, i, joined, start, refused.get(k), otherwise.get(k, 0), first=not len(components) > 1)
            for i, k in enumerate(start.members)
        ]
    order = {m.robot: i for i, m in enumerate(ordered)}
    in_given_order = tuple(sorted(decisions, key=lambda d: order[d.robot]))
    return Fusion(tuple(components), in_given_order, tuple(findings), labels)


def _relabel(labels: dict[str, dict[str, str]], m: LocalMap, corrected: dict[str, str]) -> None:
    """`labels` of this robot with labels that were put back taken into account."""
    known = labels.get(m.robot, {})
    new = {own: corrected[known.get(own, own)] for own in m.submap.ids}
    changed = {own: name for own, name in new.items() if own != name}
    labels.pop(m.robot, None)
    if changed:
        labels[m.robot] = changed


def _sightings(maps: Sequence[LocalMap], frames: Float[np.ndarray, "m 3"]) -> list[FrameSightings]:
    """What the robots of a cluster saw of each other, as `cfg` trusts it."""
    return frame_sightings(
        maps, frames, range_sigma=SIGHTING_RANGE, bearing_sigma=SIGHTING_BEARING, every=SIGHTING_EVERY
    )


def _prepare(
    test: PlaceTest,
) -> tuple[list[LandmarkMap], list[Cluster], list[Outlier], dict[int, str], list[Renaming]]:
    """Maps with names put right, how they lie, what is still doubted, which were refused, and what was renamed."""
    known = test.cfg.identities == "known"
    now = arrange_renamed(test) if known else Arranged.of(test)
    outliers = [d for c in now.clusters for d in find_exchanged(c, find_outliers(c))]
    mended = [d for d in outliers if d.belongs_to]
    if mended:
        maps = [relabelled(m, [d for d in mended if d.owner == k]) for k, m in enumerate(now.test.maps)]
        now = Arranged.of(replace(now.test, maps=maps), now.given).doubted()
    else:
        now.outliers = outliers
    now = rename_doubted(now) if known else now
    for cluster in now.clusters:
        cluster.converge()
    landmarks = list(now.test.maps)
    exchanged = {k: {d.id for d in mended if d.owner == k} for k in now.given}
    told = renamings(now, test.maps, exchanged)
    starts = [as_cluster(c, landmarks) for c in now.clusters]
    return landmarks, starts, mended + now.outliers, now.refused, told


def _join(
    maps: Sequence[LandmarkMap], start: Cluster, cfg: FuseConfig, seen: Sequence[FrameSightings] = ()
) -> JoinedMap:
    m = 3 * len(maps)  # the frames come first, then the scales
    extra = [sighting_factor(s, 3 * s.a + np.arange(3), 3 * s.b + np.arange(3), (m + s.a, m + s.b)) for s in seen]
    match cfg.weights:
        case "naive":
            return average(maps, start)
        case "full-scaled":
            return join(
                maps,
                start,
                scale_sigma=cfg.scale_sigma,
                floor=cfg.floor,
                variance_prior=VARIANCE_PRIOR,
                extra=extra,
            )
        case "full" if cfg.repeats == 1:  # what the relative form gives, to first order in the noise, in fewer steps
            return join(maps, start, extra=extra)
        case weights:
            how = RelativeConfig(weights=weights, delta=FUSE_DELTA, variance=CONSTANT_VARIANCE, repeats=cfg.repeats)
            return _relative(maps, start, how, seen)


def _relative(
    maps: Sequence[LandmarkMap], start: Cluster, cfg: RelativeConfig, seen: Sequence[FrameSightings]
) -> JoinedMap:
    fused = fuse_relative(maps, cfg, start=start, sightings=seen)
    one, landmarks, solution = np.ones(len(maps)), fused.landmarks(), fused.solution
    return JoinedMap(
        ids=fused.ids,
        mean=landmarks.mean,
        cov=landmarks.cov,
        frames=fused.frames,
        frame_cov=fused.frame_cov(),
        scales=one,
        variance_factors=one,
        chi2=solution.chi2,
        dof=solution.dof,
    )


def _alone(landmarks: LandmarkMap) -> JoinedMap:
    one = np.ones(1)
    return JoinedMap(
        landmarks.ids, landmarks.mean, landmarks.cov, np.zeros((1, 3)), np.zeros((1, 3, 3)), one, one, 0.0, 0
    )


def _component(
    robots: tuple[str, ...], maps: Sequence[LandmarkMap], joined: JoinedMap, doubted: Mapping[str, Mapping[str, float]]
) -> Component:
    members = {name: tuple(r for r, m in zip(robots, maps, strict=True) if name in m.ids) for name in joined.ids}
    ids = sorted(joined.ids, key=in_order)
    return Component(
        robots=robots,
        map=LandmarkMap(joined.ids, joined.mean, joined.cov).select(ids),
        frames=dict(zip(robots, joined.frames, strict=True)),
        frame_cov=dict(zip(robots, joined.frame_cov, strict=True)),
        members={name: members[name] for name in ids},
        scales=dict(zip(robots, (float(s) for s in joined.scales), strict=True)),
        widened=doubted,
    )


def _decide(
    robots: tuple[str, ...],
    i: int,
    joined: JoinedMap,
    start: Cluster,
    refused: str | None,
    otherwise: int,
    *,
    first: bool,
) -> Decision:
    """otherwise: how many of its landmarks the robot called by other names than the rest."""
    shared, robot = int(start.shared[i]), robots[i]
    scale, factor = float(joined.scales[i]), float(joined.variance_factors[i])
    if refused is not None:
        return Decision(robot, shared, "refused", refused, scale, factor)
    if len(robots) == 1 and not first:
        why = f"shares fewer than {ENOUGH} landmarks with the others{APART}"
        return Decision(robot, shared, "refused", why, scale, factor)
    if i == 0:
        return Decision(robot, shared, "reference", "its first pose is the map's frame", scale, factor)
    names = f", {otherwise} under other names" if otherwise else ""
    return Decision(robot, shared, "merged", f"shares {shared} landmarks with the others{names}", scale, factor)


def _single_use(maps: Sequence[LocalMap]) -> tuple[list[LocalMap], list[Decision], list[Finding]]:
    first: dict[str, str] = {}
    used, decisions, findings = [], [], []
    for m in maps:
        same = first.setdefault(m.log_hash, m.robot) if m.log_hash else m.robot
        if same == m.robot:
            used.append(m)
            continue
        decisions.append(Decision(m.robot, 0, "refused", f"made from the same log as {same}: counted once"))
        findings.append(Finding("log-twice", m.robot, value=same, action="counted once"))
    return used, decisions, findings


def unsound(m: LocalMap) -> str | None:
    landmarks = m.submap.landmarks
    if not (np.isfinite(landmarks.mean).all() and np.isfinite(landmarks.cov).all()):
        return "its map holds numbers that are not finite"
    if not is_positive_definite(landmarks.cov):
        return "its covariance is not positive definite"
    return None


def _renaming_finding(robots: Sequence[str], m: LandmarkMap, r: Renaming) -> Finding:
    """Which landmarks of its map `m` robot `robots[r.owner]` calls otherwise than the others, in words."""
    alone = len(r.others) == 1
    others, call = (f"robot {robot_key(robots[r.others[0]])}", "calls") if alone else ("the others", "call")
    names = sorted(r.names, key=in_order)
    told = [f"{own} what {others} {call} {r.names[own]}" for own in names[:LISTED]]
    apart = sorted(r.apart, key=in_order)
    left = f"; what they call its {', '.join(apart[:LISTED])}{more(len(apart))} is not known" if apart else ""
    either = " (or the other way round: only two see them)" if alone else ""
    value: dict[str, float | str] = {
        "value": len(names),
        "all": len(m),
        "names": ", ".join(told) + more(len(names)) + either + left,
    }
    return Finding("landmarks-renamed", robots[r.owner], value=value, action="taken as the same ones")


def outlier_findings(names: Sequence[str], outliers: Sequence[Outlier]) -> list[Finding]:
    findings: list[Finding] = []
    for k in sorted({d.owner for d in outliers}):
        mine = [d for d in outliers if d.owner == k]
        exchanged = [d for d in mine if d.belongs_to]
        if exchanged:
            labels = " and ".join(sorted((d.id for d in exchanged), key=in_order))
            which = " (or the other robot's: only two see them)" if any(d.alone for d in exchanged) else ""
            worst = max(d.residual for d in exchanged)
            told: dict[str, float | str] = {"labels": labels, "which": which, "value": worst}
            findings.append(Finding("labels-exchanged", names[k], value=told, action="put back"))
        for d in mine:
            if not d.belongs_to:
                alone = " (only two see it: either may be wrong)" if d.alone else ""
                told = {"name": d.id, "value": d.residual, "which": alone}
                findings.append(Finding("landmark-elsewhere", names[k], value=told, action="hardly counted"))
    return findings
