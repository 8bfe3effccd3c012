"""Two robots' laser maps made one, whose starts nobody knows, or refused with the reason.

Submaps of one are searched for in those of the other, and places that agree make a transform. The maps become one when
what speaks for it and against it makes it probable enough, no other transform is allowed, and it is held in every
direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import symmetrise
from ..core.names import robot_name
from ..core.records import frozen
from ..core.rows import spread
from ..laser.consistency import adjoint, cycle_squares, largest_clique
from ..laser.place_search import refine
from .map_overlap import KeyframeMap, seen_alike, wall_overlap
from .merge_ambiguity import Grip, Grounds, Pair, allowed, doubtful, grip, words
from .merge_search import (
    AGREE,
    AGREE_TURN,
    BEND_TURN,
    DRIFT,
    DRIFT_TURN,
    KNOWN_ALIKE,
    START_SDS,
    Candidate,
    Hypothesis,
    MergeConfig,
    Start,
    along_start,
    apart,
    candidate,
    candidates,
    hypotheses,
    same_place,
    whole_place,
)

SAID_SD, SAID_SD_TURN = 0.1, 0.03  # [m], [rad] of a transform that somebody tells,
NUDGE, NUDGE_TURN = 0.5, 0.1  # [m], [rad] that walls may move it by
MOST_CLOSURES = 80  # places of one transform that are asked whether they confirm it
KNOWN_VOTES = 3  # submaps that confirm, at least, inside the window of a start that was given
START_ALONG = 1.0  # [m] sd, at most, of a start that alone holds maps along a corridor
LEAST_SEEN = 100  # points that both saw alike, at least
BEND_PATH = 0.02  # [m] that a map is bent between two of its keyframes, beside how it drifts
CYCLE_GATE = 4.0 * 11.34  # squared sd of a cycle: twice the 99 % of 3 degrees of freedom in sd, maps bend


@dataclass(frozen=True, slots=True)
class MapClosure:
    """Keyframe `second` of map b as seen from keyframe `first` of map a.

    measured: (3,); information: (3, 3) in second's frame; score, ratio: of the search; share: of inliers; nis: squared
    sd from the transform decided on; accepted: whether it holds the maps together.
    """

    first: int
    second: int
    measured: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    score: float
    ratio: float
    share: float
    nis: float
    accepted: bool
    reason: str


@dataclass(frozen=True, slots=True)
class Merge:
    """What was decided on maps a and b, and why.

    transform: T_a_b, covariance: of an error in b's frame, both None when refused; overlap: share of the walls of one
    that lie on the other's, of the two the larger, under the best transform; score: median of the submaps that agree
    on it; second: that of the next best transform, over it; agreeing: submaps that confirm it; chi2: of their
    closures; alike: of what both robots saw, the share on which they agree; rival: the next best transform; best: the
    transform that all this was asked of, T_a_b, also when refused, None where no submap was found. said: what somebody
    said of the pair, empty where it is the scans that decide; scans: whether they merge it; grounds: what the decision
    rests on in numbers, None where a start was given or somebody said.
    """

    a: str
    b: str
    merged: bool
    reason: str
    transform: Float[np.ndarray, "3"] | None = None
    covariance: Float[np.ndarray, "3 3"] | None = None
    overlap: float | None = None
    score: float | None = None
    second: float | None = None
    agreeing: int = 0
    chi2: float | None = None
    alike: float | None = None
    rival: Float[np.ndarray, "3"] | None = None
    best: Float[np.ndarray, "3"] | None = None
    closures: tuple[MapClosure, ...] = ()
    said: str = ""
    scans: bool | None = None
    grounds: Grounds | None = None

    @property
    def probability_wrong(self) -> float | None:
        """That the maps do not lie as `transform` has them; of refused ones, that they do lie as `best` has them.

        None where a start was given or somebody said how they lie.
        """
        if self.grounds is None or self.said:
            return None
        right = self.grounds.probability()
        return 1.0 - right if self.merged else right

    def row(self) -> dict[str, Any]:
        """The pair as `metrics.json` tells it under `fusion`."""
        return {
            "a": self.a,
            "b": self.b,
            "overlap": self.overlap,
            "score": self.score,
            "second": self.second,
            "agreeing": self.agreeing,
            "chi2": self.chi2,
            "alike": self.alike,
            "probability_wrong": self.probability_wrong,
            "transform": None if self.transform is None else self.transform.tolist(),
            "decision": "merged" if self.merged else "refused",
            "said": self.said or None,
            "reason": self.reason,
        }


def merge_maps(a: KeyframeMap, b: KeyframeMap, cfg: MergeConfig | None = None, start: Start | None = None) -> Merge:
    """Whether the two maps are one building's, and how they lie.

    start: where b is said to lie in a: searched first; of places that fit alike it decides. Where nothing fits there,
    the scans alone decide.
    """
    if len(b.pose) > len(a.pose) and start is None:  # a start tells where b began: seen from b it would be vague
        return swapped(merge_maps(b, a, cfg))
    pair = Pair(a, b, whole_place(a, featured=b.q is not None), (cfg or MergeConfig()).sure)
    if start is None:
        return _decided(pair)
    near = _decided(pair._replace(start=start))
    if near.merged:
        return near
    free = merge_maps(a, b, cfg)
    if free.transform is None:
        held = _held_by_start(pair._replace(start=start), near, free)
        reason = f"near the start that was given: {near.reason}; everywhere: {free.reason}{held}"
        return held if isinstance(held, Merge) else replace(free, reason=reason)
    away = se2.between(start.transform, free.transform)
    if (np.abs(away) > START_SDS * np.asarray(start.sd)).any():
        how_far = f"{np.hypot(*away[:2]):.2f} m and {np.degrees(abs(away[2])):.1f} degrees"
        free = replace(free, reason=f"{free.reason}; the scans overrule the start that was given, by {how_far}")
    return free


def merge_as_said(a: KeyframeMap, b: KeyframeMap, T: Float[np.ndarray, "3"]) -> Merge:
    """The two maps merged where somebody says that b lies in a, moved a little where its walls lie on those of a."""
    place = whole_place(a, featured=False)
    laid = refine(place, b.walls, T).pose
    away = se2.between(T, laid)
    T = laid if np.hypot(*away[:2]) <= NUDGE and abs(away[2]) <= NUDGE_TURN else np.asarray(T, dtype=float)
    seen = seen_alike(a, b, T)
    P = np.diag(np.square([SAID_SD, SAID_SD, SAID_SD_TURN]))
    told = "said to be together"
    return Merge(
        a.robot,
        b.robot,
        merged=True,
        reason=f"{told}: {seen.share:.0%} of what both robots saw there is alike",
        transform=frozen(T),
        covariance=frozen(P),
        overlap=wall_overlap(place.points, b, T),
        agreeing=1,
        alike=seen.share,
        best=frozen(T),
        closures=(_tie(a, b, T, P, 0.0, seen.share, told),),
        said="together",
        scans=False,
    )


def _tie(
    a: KeyframeMap, b: KeyframeMap, T: np.ndarray, P: np.ndarray, score: float, share: float, reason: str
) -> MapClosure:
    """The first keyframe of b seen from the nearest of a, as T has it; P: covariance of T in b's frame."""
    first = int(np.argmin(np.hypot(*(a.pose[:, :2] - se2.compose(T, b.pose[0])[:2]).T)))
    A = adjoint(se2.inverse(b.pose[0]))
    measured = frozen(se2.between(a.pose[first], se2.compose(T, b.pose[0])))
    information = symmetrise(np.linalg.inv(symmetrise(A @ P @ A.T)))
    return MapClosure(first, 0, measured, information, score, 0.0, share, 0.0, True, reason)


def _held_by_start(pair: Pair, near: Merge, free: Merge) -> Merge | str:
    """Maps of a corridor merged along it by a start alone, where the walls allow what it says; else why it does not.

    near, free: what was decided near the start and everywhere. The reason goes on after theirs; it is empty where
    neither found a corridor.
    """
    a, b, place, _, start = pair[:5]
    slid = [merge for merge in (near, free) if merge.reason.startswith("a corridor")]
    if not slid or start is None:
        return ""
    away = "; the start alone does not hold them: "
    if (way := along_start(a, b, place, start)) is None or not start.near(way.transform):
        return away + "no wall of theirs lies on another where it puts them"
    T = way.transform
    seen = seen_alike(a, b, T)
    if seen.alike < LEAST_SEEN:
        return away + f"where it puts them both saw {seen.alike} points of the same walls, {LEAST_SEEN} are needed"
    if seen.share < KNOWN_ALIKE:
        return away + f"{seen.share:.0%} of what both saw there is alike, {KNOWN_ALIKE:.0%} are needed"
    if way.sd > START_ALONG:
        return away + f"it says where along the corridor to {way.sd:.2f} m, {START_ALONG:.2f} m are needed"
    why = "it confirms the transform: the start that was given, and the walls across it"
    tie = _tie(a, b, T, way.covariance, slid[0].score or 0.0, seen.share, why)
    degrees = np.degrees(np.arctan2(way.along[1], way.along[0])) % 180.0
    direction = (
        f"along {degrees:.0f} degrees in the map of {robot_name(a.robot)} nothing else holds it, to {way.sd:.2f} m"
    )
    return replace(
        slid[0],
        merged=True,
        reason=f"merged on the start that was given: a corridor, {direction} (standard deviation)",
        transform=frozen(T),
        covariance=frozen(way.covariance),
        overlap=wall_overlap(place.points, b, T),
        agreeing=1,
        chi2=None,
        alike=seen.share,
        best=frozen(T),
        closures=(tie,),
    )


def _decided(pair: Pair) -> Merge:
    """The decision on the places that submaps of either map have in the other."""
    a, b = pair.a, pair.b
    matches = hypotheses(a, b)
    if not matches:
        reason = f"too little overlap: none of {len(b.submaps)} submaps is found in the other map"
        return Merge(a.robot, b.robot, False, reason, grounds=Grounds() if pair.start is None else None)
    return _weighed(pair, candidates(a, b, matches), matches)


def _weighed(pair: Pair, ways: Sequence[Candidate], matches: Sequence[Hypothesis]) -> Merge:
    """The decision between transforms."""
    a, b, place, _, start = pair[:5]
    pair = pair.lit_by(ways)
    best = max(ways, key=pair.preference)
    if start is not None and not start.near(best.transform):
        elsewhere = f"{robot_name(b.robot)} at {words(best.transform)} in the map of {robot_name(a.robot)}"
        return Merge(a.robot, b.robot, False, f"no place fits there as well as elsewhere: {elsewhere}")
    checked = _closures(pair, best, matches)
    held = [h for h, c in checked if c.accepted]
    if len(held) > 1:
        best = candidate(a, b, held)._replace(votes=best.votes)
    pair = pair.levelled(best)
    others = [c for c in ways if not same_place(b, c.transform, best.transform)]
    rival = max(
        others,
        key=lambda c: (allowed(pair, c, best), doubtful(pair, best, c), pair.against(c, best)),
        default=None,
    )
    hold = grip(pair, best) if best.seen.alike else None
    grounds = _grounds(pair, best, others, rival, hold)
    if start is None and not held and grounds.probability() >= pair.sure:
        checked += [(h, _closure(a, b, h, best, whole=True)) for h in best.members[:1]]
        held = [h for h, c in checked if c.accepted]
    score = _score(held or best.members)
    merge = Merge(
        a.robot,
        b.robot,
        merged=False,
        reason="",
        overlap=wall_overlap(place.points, b, best.transform),
        score=score,
        second=None if rival is None else _score(rival.members) / score,
        agreeing=len(held),
        chi2=best.chi2 if held else None,
        alike=best.seen.share,
        rival=None if rival is None else frozen(rival.transform),
        best=frozen(best.transform),
        closures=tuple(c for _, c in checked),
        grounds=grounds if start is None else None,
    )
    why = _why_refused(pair, merge, best, rival, grounds, hold)
    if why:
        return replace(merge, reason=why, overlap=None if "too little overlap" in why else merge.overlap)
    on = f"{len(held)} closures that agree within {_spread(held, b, best.transform):.2f} m"
    if len(held) == 1:
        on = f"the whole maps: {best.seen.alike} places of walls that both saw agree"
    reason = f"merged on {on}: {100 * best.seen.share:.0f} % of what both robots saw is alike"
    if any(pair.darkened(c) for c in ways):
        reason += ", and at other places their walls do not shine alike"
    return replace(
        merge, merged=True, reason=reason, transform=frozen(best.transform), covariance=frozen(best.covariance)
    )


def _grounds(
    pair: Pair, best: Candidate, others: Sequence[Candidate], rival: Candidate | None, hold: Grip | None
) -> Grounds:
    """What the decision rests on, as numbers."""
    return pair.grounds(best)._replace(
        others=max((c.votes for c in others), default=0),
        rival=0.0 if rival is None else pair.against(rival, best),
        allowed=rival is not None and allowed(pair, rival, best),
        pushed=1.0 if hold is None else min(hold.pushed, 1.0),
        held=0.0 if hold is None else hold.held,
    )


def _why_refused(
    pair: Pair, merge: Merge, best: Candidate, rival: Candidate | None, grounds: Grounds, hold: Grip | None
) -> str:
    """The reason in words, empty when there is none; the most telling cause first.

    hold: how the place holds, None where the robots saw nothing in common.
    """
    seen = best.seen
    few = seen.alike < LEAST_SEEN
    if pair.start is None:
        good, enough = (g.probability() >= pair.sure and not few for g in (grounds.alone(), grounds))
        contradicted = not good and grounds.alone().uncontradicted().probability() >= pair.sure
    else:
        good, enough = seen.share >= KNOWN_ALIKE and not few, merge.agreeing >= KNOWN_VOTES
        contradicted = not good and seen.alike + seen.through >= LEAST_SEEN
    if good and hold is not None and hold.slides():
        return f"a corridor: {hold.along} is not held, the maps may slide along it"
    if good and rival is not None and doubtful(pair, best, rival):
        which = f"two places of {robot_name(pair.b.robot)} in the map of {robot_name(pair.a.robot)}"
        first, second = (f"{words(c.transform)}, {100 * c.seen.share:.0f} %" for c in (best, rival))
        return f"{which} fit equally well: {first} of what both saw is alike, and {second}"
    if contradicted:
        what = f"{len(pair.b.submaps)} submaps"
        return (
            f"too little overlap: no place fits {what}; in the best, {robot_name(pair.b.robot)} at "
            f"{words(best.transform)} in the map of {robot_name(pair.a.robot)}, each robot saw "
            f"through walls of the other ({100 * best.seen.share:.0f} % alike)"
        )
    if good and not enough and pair.start is None and grounds.others:
        return (
            f"too little overlap: {merge.agreeing} submaps agree on a place, where {100 * seen.share:.0f} % of what "
            f"both robots saw is alike, and {grounds.others} on another: {100 * grounds.probability():.0f} % sure, "
            f"{100 * pair.sure:.0f} % are asked"
        )
    if not good or not enough:
        return (
            f"too little overlap: {merge.agreeing} submaps agree on a place, and both robots saw {best.seen.alike} "
            "points of walls there"
        )
    return ""


def _closures(pair: Pair, best: Candidate, matches: Sequence[Hypothesis]) -> list[tuple[Hypothesis, MapClosure]]:
    """Every place that is clear and lies about where the best transform has it, and whether it confirms that."""
    a, b = pair.a, pair.b
    far = apart(b, matches, best.transform, 2.0 * AGREE, 2.0 * AGREE_TURN).tolist()
    near = [h for h, away in zip(matches, far, strict=True) if h.clear and away <= 1.0]
    near = [near[k] for k in spread(len(near), MOST_CLOSURES).tolist()]
    rows = [_closure(a, b, h, best) for h in near]
    fit = [k for k, c in enumerate(rows) if c.accepted]
    held = {fit[k] for k in _consistent(pair, [near[k] for k in fit], [rows[k] for k in fit])}
    for k in fit:
        if k not in held:
            rows[k] = replace(rows[k], accepted=False, reason="it contradicts the other closures")
    return list(zip(near, rows, strict=True))


def _closure(a: KeyframeMap, b: KeyframeMap, h: Hypothesis, best: Candidate, *, whole: bool = False) -> MapClosure:
    """A hypothesis as a measurement from the nearest keyframe of a. whole: of the whole map, which is believed."""
    pose, near = h.fit.pose, h.at
    e = se2.between(se2.compose(best.transform, b.pose[h.anchor]), pose)
    A = adjoint(se2.inverse(b.pose[h.anchor]))
    S = A @ best.covariance @ A.T + h.fit.covariance + np.diag([0.05**2, 0.05**2, 0.01**2])
    reason = "it confirms the transform"
    if whole:
        reason = "it confirms the transform: the whole maps laid on each other"
    elif np.hypot(*e[:2]) > AGREE or abs(e[2]) > AGREE_TURN:
        reason = f"it lies {np.hypot(*e[:2]):.2f} m and {np.degrees(abs(e[2])):.1f} degrees from the transform"
    return MapClosure(
        first=near,
        second=h.anchor,
        measured=frozen(se2.between(a.pose[near], pose)),
        information=h.fit.information,
        score=h.score,
        ratio=h.ratio,
        share=h.fit.share,
        nis=float(e @ np.linalg.solve(S, e)),
        accepted=reason.startswith("it confirms"),
        reason=reason,
    )


def _consistent(pair: Pair, matches: Sequence[Hypothesis], rows: Sequence[MapClosure]) -> list[int]:
    """The largest set of closures whose cycles are all within the covariances of matches and trajectories."""
    if not rows:
        return []
    a, b = pair.a, pair.b
    first, second = [c.first for c in rows], [c.second for c in rows]
    P = np.array([h.fit.covariance for h in matches])
    squares = cycle_squares(
        a.pose[first],
        b.pose[second],
        np.array([c.measured for c in rows]),
        P,
        _ways(a, first),
        _ways(b, second),
    )
    return list(largest_clique((squares <= CYCLE_GATE) & ~np.eye(len(rows), dtype=bool)).members)


def _ways(m: KeyframeMap, at: Sequence[int]) -> np.ndarray:
    """(n, n, 3, 3) covariance of the trajectory between two keyframes by its length: what a map may be bent by."""
    path = m.path[list(at)]
    length = np.abs(path[:, None] - path[None, :])
    out = np.zeros((*length.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.square(BEND_PATH + DRIFT * length)
    out[..., 2, 2] = np.square(BEND_TURN + DRIFT_TURN * np.sqrt(length))
    return out


def _score(members: Sequence[Hypothesis]) -> float:
    return float(np.median([h.score for h in members]))


def _spread(held: Sequence[Hypothesis], b: KeyframeMap, T: np.ndarray) -> float:
    e = np.array([se2.between(se2.compose(T, b.pose[h.anchor]), h.fit.pose) for h in held])
    return float(np.sqrt(np.mean(np.square(e[:, :2]).sum(axis=1))))


def swapped(m: Merge) -> Merge:
    """The same decision with a and b exchanged."""
    T = P = None
    if m.transform is not None and m.covariance is not None:
        T = frozen(se2.inverse(m.transform))
        A = adjoint(m.transform)
        P = frozen(symmetrise(A @ m.covariance @ A.T))
    closures = tuple(
        replace(
            c,
            first=c.second,
            second=c.first,
            measured=frozen(se2.inverse(c.measured)),
            information=_turned(c.measured, c.information),
        )
        for c in m.closures
    )
    rival, best = (None if way is None else frozen(se2.inverse(way)) for way in (m.rival, m.best))
    return replace(m, a=m.b, b=m.a, transform=T, covariance=P, rival=rival, best=best, closures=closures)


def _turned(measured: np.ndarray, information: np.ndarray) -> np.ndarray:
    """The information of the inverse pose, in the other end's frame."""
    A = adjoint(se2.inverse(measured))
    return symmetrise(A.T @ information @ A)
