"""How two maps may lie: submaps of one searched for in those of the other, and transforms on which they agree."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from ..core import se2
from ..core.config import config
from ..core.gaussian import symmetrise
from ..core.rows import spread
from ..laser.consistency import adjoint, largest_clique
from ..laser.place_search import (
    Fit,
    LikelihoodField,
    Window,
    likelihood_field,
    refine,
    search,
)
from ..laser.pose_graph import PoseGraph
from ..laser.robust_graph import RobustGraphConfig, solve_graph
from .map_overlap import KeyframeMap, SeenAlike, lit_alike, seen_alike
from .places import PlaceIndex, PlaceMatch

MOST_MATCHES = 250  # pairs of submaps that candidates are made of, those that fit best
WALLS = 0.05  # [m] points of a whole map are means of squares this wide
WHOLE = 1000  # points of a whole map that are searched with
ALONG_TIMES = 2  # maps are moved along a corridor to where a start has them, and laid on its walls again
AGREE = 0.6  # [m] and
AGREE_TURN = 0.1  # [rad] that hypotheses which agree may differ at each other's place
MOST_CANDIDATES = 40  # transforms looked into
LEAST_ALIKE = 0.9  # share of what both saw alike at which a place has no evidence
KNOWN_ALIKE = 0.8  # the same near a start that was given
START_SDS = 3.0  # standard deviations of a start within which it is looked for,
START_REACH = 1.0  # [m] and
START_TURN = 0.2  # [rad] to either side at least
SLIPPED = (0.3, 0.3, 0.05)  # [m, m, rad] that a map's first keyframes may be off the rest, beside what a start may be
BLUNDER = 0.05  # chance that a start is false: what its likelihood never falls below
DRIFT = 0.01  # [m per m] sd of a map's own trajectories,
DRIFT_TURN = 0.002  # [rad per sqrt m] and of their headings,
BEND = 0.03  # [m] to which this is added where maps meet,
BEND_TURN = 0.002  # [rad] in headings,
BEND_SUBMAP = 0.005  # [rad] in headings of submaps


@config
class MergeConfig:
    sure: float = 0.9  # probability from which on maps are one
    start_sd: float = 0.5  # [m] and
    start_turn_sd: float = 0.1  # [rad] standard deviations of a start that is given without


class Start(NamedTuple):
    """Where map b is said to lie in map a, and with what standard deviations [m, m, rad]."""

    transform: Float[np.ndarray, "3"]
    sd: Float[np.ndarray, "3"]

    def near(self, T: Float[np.ndarray, "3"]) -> bool:
        """Whether it allows a transform, which lies within some standard deviations, or as near as is searched."""
        sd, e = START_SDS * np.asarray(self.sd), se2.between(self.transform, T)
        reach = max(START_SDS * np.hypot(*self.sd[:2]), START_REACH)
        return bool(np.hypot(*e[:2]) <= reach and abs(e[2]) <= max(sd[2], START_TURN))

    def likelihood(self, T: Float[np.ndarray, "3"]) -> float:
        """Of a transform, 1 where it is said to be; never under `BLUNDER`, the chance that what was said is false.

        What a map slips in its first metres counts as error of the start too.
        """
        e = se2.between(self.transform, T) / np.hypot(np.asarray(self.sd), SLIPPED)
        return float(BLUNDER + (1.0 - BLUNDER) * np.exp(-0.5 * e @ e))


def start_between(starts: Mapping[int, Start], i: int, j: int) -> Start | None:
    """Where robot j's frame is said to lie in robot i's; None when either is not told (the first one's is zero)."""
    zero = Start(np.zeros(3), np.zeros(3))
    a, b = (starts.get(k, zero if k == 0 else None) for k in (i, j))
    if a is None or b is None or not starts:
        return None
    return Start(se2.between(a.transform, b.transform), np.hypot(a.sd, b.sd))


class Hypothesis(NamedTuple):
    """The submap around keyframe `anchor` of map b lies at `fit.pose` in map a; so the maps lie as `transform` says.

    at: the keyframe of map a whose submap it was found in; score: of the search; ratio: of the next best place over it;
    clear: whether the two submaps leave no doubt.
    """

    at: int
    anchor: int
    transform: Float[np.ndarray, "3"]
    score: float
    ratio: float
    fit: Fit
    clear: bool = True


class Candidate(NamedTuple):
    """A transform T_a_b some hypotheses agree on, its covariance in b's frame, and what the views of both say of it.

    light: correlation of the brightness of walls that meet, None where too few have any; votes: submaps of b with a
    clear place that agrees.
    """

    transform: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    chi2: float
    members: tuple[Hypothesis, ...]
    seen: SeenAlike
    light: float | None = None
    votes: int = 0

    def evidence(self, alike: float) -> float:
        """Points seen alike less those seen through, weighed so that it is 0 where the share alike is `alike`."""
        return self.seen.alike - alike / (1.0 - alike) * self.seen.through


def whole_place(a: KeyframeMap, *, featured: bool) -> LikelihoodField:
    """All walls of a map as one place; with brightness when it has some and it is `featured`."""
    cloud, q = a.cloud(WALLS, a.q if featured else None)
    return likelihood_field(cloud, q)


def hypotheses(a: KeyframeMap, b: KeyframeMap, most: int | None = None) -> list[Hypothesis]:
    """Where the submaps of b may lie in those of a: the best and the next best place of each pair of them.

    most: pairs that are searched, about: of more, some submaps of b, spread over it. None: all of them.
    """
    index = PlaceIndex()
    for submap in a.submaps:
        index.add(submap)
    asked = len(b.submaps) if most is None else max(most // max(len(a.submaps), 1), 1)
    found = []
    for k in spread(len(b.submaps), asked):
        found += index.search(index.add(b.submaps[k]), range(len(a.submaps)), every=True)
    return [_hypothesis(a, b, index, match) for match in found]


def _hypothesis(a: KeyframeMap, b: KeyframeMap, index: PlaceIndex, match: PlaceMatch) -> Hypothesis:
    at, anchor = index.submaps[match.first].anchor, index.submaps[match.second].anchor
    pose = np.asarray(se2.compose(a.pose[at], match.measured))
    weak = se2.rotation(float(a.pose[at, 2])) @ match.weak
    points = len(index.submaps[match.first].points)
    fit = Fit(pose, match.covariance, points, match.share, 0.0, np.array(match.held), weak)
    transform = np.asarray(se2.compose(pose, se2.inverse(b.pose[anchor])))
    return Hypothesis(at, anchor, transform, match.score, match.ratio, fit, match.clear)


def candidates(a: KeyframeMap, b: KeyframeMap, matches: Sequence[Hypothesis]) -> list[Candidate]:
    """The transforms that most hypotheses agree on, each from hypotheses of its own; most evidence first."""
    matches = [
        matches[k] for k in np.argsort([-h.score - h.clear for h in matches], kind="stable")[:MOST_MATCHES].tolist()
    ]
    agreeing = agreement(b, matches)
    ways = np.array([h.transform for h in matches]).reshape(-1, 3)
    anchor, clear = np.array([h.anchor for h in matches]), np.array([h.clear for h in matches])
    left = list(range(len(matches)))
    out: list[Candidate] = []
    while left and len(out) < MOST_CANDIDATES:
        members = largest_clique(agreeing[np.ix_(left, left)]).members
        if len(members) < 2:  # of single ones the best scores, of those that are clear
            left.sort(key=lambda k: (not clear[k], -matches[k].score))
            members = (0,)
        group = [matches[left[k]] for k in members]
        new = candidate(a, b, group)
        agree = anchor[clear & (apart(b, matches, new.transform, AGREE, AGREE_TURN) <= 1.0)]
        out.append(new._replace(votes=len(set(agree.tolist()))))
        gone = same_place(b, ways, new.transform)
        gone[[left[k] for k in members]] = True
        left = [k for k in left if not gone[k]]
    return sorted(out, key=lambda c: -c.evidence(LEAST_ALIKE))


def _shifted(pose: Float[np.ndarray, "3"], u: Float[np.ndarray, "2"], to: Float[np.ndarray, "3"]) -> np.ndarray:
    """The pose moved along the direction u until it is beside `to`."""
    return np.array([*(pose[:2] + u * (u @ (to[:2] - pose[:2]))), pose[2]])


class AlongStart(NamedTuple):
    """Where a start and walls together put map b: across `along`, (2,) unit in map a's frame, and in heading the walls.

    covariance: (3, 3) of the transform in b's frame; sd: [m] along, of what the start says and nothing else.
    """

    transform: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    along: Float[np.ndarray, "2"]
    sd: float


def along_start(a: KeyframeMap, b: KeyframeMap, place: LikelihoodField, start: Start) -> AlongStart | None:
    """The place near a start in a corridor, whose walls hold nothing along it; None where no wall fits."""
    window = _start_window(start, np.zeros(3))
    thin = b.walls[spread(len(b.walls), WHOLE)]
    close = search(place, thin, window).best
    if close is None:
        return None
    ways = [_whole(a, b, place, at, close.score) for at in (window.centre, close.pose)]
    fit = refine(place, b.walls, max(ways, key=lambda c: c.evidence(KNOWN_ALIKE)).transform)
    for _ in range(ALONG_TIMES):
        u = fit.weak
        fit = refine(place, b.walls, _shifted(fit.pose, u, start.transform))
    u, across = fit.weak, np.array([-fit.weak[1], fit.weak[0]])
    said = se2.rotation(float(start.transform[2])).T @ u
    sd = np.hypot(np.asarray(start.sd), SLIPPED)
    # the start's heading may err at the other end of the line between the origins
    variance = float(np.square(said * sd[:2]).sum() + (sd[2] * (across @ start.transform[:2])) ** 2)
    T = _shifted(fit.pose, u, start.transform)
    v = se2.rotation(float(T[2])).T @ u
    A = np.eye(3)
    A[:2, :2] -= np.outer(v, v)
    there = int(np.argmin(cKDTree(a.pose[:, :2]).query(se2.compose(T, b.pose)[:, :2])[0]))
    bent = BEND_TURN + DRIFT_TURN * np.sqrt(float(np.ptp(a.path) + np.ptp(b.path)))
    swung = bent * float(np.hypot(*b.pose[there, :2]) + np.hypot(*T[:2]))  # bent from where they meet to the origins
    P = fit.covariance + np.diag(np.square([BEND + swung, BEND + swung, bent]))
    P = A @ P @ A.T
    P[:2, :2] += variance * np.outer(v, v)
    return AlongStart(T, symmetrise(P), u, float(np.sqrt(variance)))


def _whole(a: KeyframeMap, b: KeyframeMap, place: LikelihoodField, start: np.ndarray, score: float) -> Candidate:
    """All walls of b laid onto those of a from `start` on, as one hypothesis."""
    fit = refine(place, b.walls, start)
    at = se2.compose(fit.pose, b.pose)
    tree = cKDTree(a.pose[:, :2])
    anchor = int(np.argmin(tree.query(at[:, :2])[0]))
    far = np.abs(b.path - b.path[anchor]).max()
    bent = BEND_TURN + 0.5 * DRIFT_TURN * np.sqrt(far)
    P = symmetrise(fit.covariance + np.diag(np.square([BEND, BEND, bent])))
    A = adjoint(se2.inverse(b.pose[anchor]))
    seen_there = replace(fit, pose=at[anchor], covariance=symmetrise(A @ P @ A.T))
    there = int(np.argmin(np.hypot(*(a.pose[:, :2] - at[anchor, :2]).T)))
    member = Hypothesis(there, anchor, fit.pose, score, 0.0, seen_there)
    return Candidate(fit.pose, P, 0.0, (member,), seen_alike(a, b, fit.pose), lit_alike(a, b, fit.pose))


def candidate(a: KeyframeMap, b: KeyframeMap, group: Sequence[Hypothesis]) -> Candidate:
    """The transform on which a group of hypotheses meets."""
    T, P, chi2 = meeting(b, group)
    return Candidate(T, P, chi2, tuple(group), seen_alike(a, b, T), lit_alike(a, b, T))


def apart(
    b: KeyframeMap, places: Sequence[Hypothesis], transform: Float[np.ndarray, "3"], xy: float, turn: float
) -> Float[np.ndarray, " n"]:
    """How far each place lies from where the transform has it, 1 where it is `xy` [m] or `turn` [rad]."""
    if not places:
        return np.zeros(0)
    e = se2.between(se2.compose(transform, b.pose[[h.anchor for h in places]]), np.array([h.fit.pose for h in places]))
    return np.asarray(np.maximum(np.hypot(e[:, 0], e[:, 1]) / xy, np.abs(e[:, 2]) / turn))


def agreement(b: KeyframeMap, matches: Sequence[Hypothesis]) -> Bool[np.ndarray, "n n"]:
    """Which hypotheses put each other's submap into the same place; those of one submap never do."""
    if not matches:
        return np.zeros((0, 0), dtype=bool)
    T = np.array([h.transform for h in matches])
    anchor = np.array([h.anchor for h in matches], dtype=np.int64)
    at = b.pose[anchor]
    here = se2.compose(T[:, None], at[None, :])  # [k, l]: submap l as hypothesis k has it
    own = se2.compose(T, at)
    d = se2.between(own[None, :], here)
    far = np.abs(b.path[anchor][:, None] - b.path[anchor][None, :])
    near = (np.hypot(d[..., 0], d[..., 1]) <= AGREE + DRIFT * far) & (
        np.abs(d[..., 2]) <= AGREE_TURN + DRIFT_TURN * np.sqrt(far)
    )
    return np.asarray(near & near.T & (anchor[:, None] != anchor[None, :]))


def same_place(
    b: KeyframeMap, ways: Float[np.ndarray, "... 3"], other: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "..."]:
    """Whether transforms put the middle of b's way where another does, twice the agreement apart at most."""
    middle = np.array([*b.pose[:, :2].mean(axis=0), 0.0])
    d = se2.between(se2.compose(ways, middle), se2.compose(other, middle))
    near = np.hypot(d[..., 0], d[..., 1]) <= 2.0 * AGREE
    return np.asarray(near & (np.abs(d[..., 2]) <= 2.0 * AGREE_TURN))


def meeting(
    b: KeyframeMap, group: Sequence[Hypothesis]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], float]:
    """T_a_b on which a group of hypotheses meets, its covariance in b's frame, and their chi-square.

    Each counts by its match and by how far its map may be bent between it and the middle of the group.
    """
    middle = float(np.median([b.path[h.anchor] for h in group]))
    z, information = [], []
    for h in group:
        far = abs(float(b.path[h.anchor]) - middle)
        aside = BEND + DRIFT * far
        bent = np.array([aside, aside, BEND_SUBMAP + DRIFT_TURN * np.sqrt(far)])
        A = adjoint(b.pose[h.anchor])
        z.append(h.transform)
        information.append(symmetrise(np.linalg.inv(A @ (h.fit.covariance + np.diag(bent**2)) @ A.T)))
    first = max(group, key=lambda h: h.score).transform
    graph = PoseGraph.of(np.stack([np.zeros(3), first]), [(0, 1)] * len(z), z, information)
    solved = solve_graph(graph, RobustGraphConfig(method="cauchy"), doubtful=np.ones(len(z), dtype=bool))
    T = solved.graph.pose[1]
    R = np.eye(3)
    R[:2, :2] = se2.rotation(float(T[2]))
    covariance = solved.covariances()[1] if solved.component.max() == 0 else np.diag([1.0, 1.0, 0.1])
    return T, symmetrise(R.T @ covariance @ R), solved.chi2


def _start_window(start: Start, pose: np.ndarray) -> Window:
    """Some standard deviations round where the start puts a keyframe."""
    sd = np.maximum(START_SDS * np.asarray(start.sd), [START_REACH, START_REACH, START_TURN])
    reach = float(np.hypot(sd[0], sd[1]) + min(float(sd[2]), 1.0) * np.hypot(*pose[:2]))
    return Window(se2.compose(start.transform, pose), (reach, reach), float(sd[2]))
