"""Where bodies lie to each other, from ranges alone and from no guess: several hypotheses until one is left.

A range is a circle, so that a body that joins others may lie in several places. From a grid of headings and directions
all minima of a robust cost are found; those that explain the ranges about as well are all kept, and bodies that come
later decide between them. What is still open at the end is reported, not chosen.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.rows import spread
from .network import Bodies, RangeNetwork, in_pieces

HEADINGS, DIRECTIONS = 16, 8  # from which minima are sought
MOST = 240  # ranges looked at, of one body to those placed: evenly spread
ROUNDS = 40  # of Levenberg-Marquardt, at most
ROUGH = 0.15  # [m] sd of a range against paths that drift, in the search
KERNEL = 2.0  # [sd] beyond which a range counts less
BIAS_SD = 0.5  # [m] by which radios read too long, before anything is known
APART_XY, APART_THETA = 0.3, 0.2  # [m], [rad] from which two minima are two
LEAD = 9.0  # of cost, per unit of how well the best fits, by which a hypothesis must be worse to be given up
MOST_KEPT = 24  # hypotheses of the whole team followed at once
BEGINNERS = 3  # bodies from which layouts are begun, in turn
SURE_XY, SURE_THETA = 1.5, 0.6  # [m], [rad] sd beyond which ranges do not place a body
LEAST = 6  # ranges that place a body, a beacon takes two less
MOST_TIED = 4  # layouts that are worked out whole, to see which explains the ranges best
UNSURE = "too little motion: its ranges fit along a line"  # why a body is loose, though it has ranges enough


@dataclass(frozen=True, slots=True)
class Placement:
    """One way in which a body may lie: `T` (3,) of its frame, how sure, and the robust cost of the ranges."""

    T: Float[np.ndarray, "3"]
    cost: float
    sd: Float[np.ndarray, "2"]  # of its middle [m] and heading [rad]

    @property
    def sure(self) -> bool:
        return bool(self.sd[0] < SURE_XY and self.sd[1] < SURE_THETA)


@dataclass(frozen=True, slots=True)
class BodyLayout:
    """One way in which the whole team may lie: body -> frame, and the cost of all ranges between them."""

    frames: Mapping[int, Float[np.ndarray, "3"]]
    cost: float


@dataclass(frozen=True, slots=True)
class ColdStart:
    """layouts: what is left, the best first; loose: bodies that ranges do not place, and why."""

    layouts: tuple[BodyLayout, ...]
    loose: Mapping[int, str]


def lay_out(net: RangeNetwork, bodies: Bodies, members: Sequence[int]) -> ColdStart:
    """How the bodies `members`, which ranges connect, may lie; the frame is that of the first placed.

    A body is placed by what lies already, which may be little and bent, and what is missed then is missed for good; so
    that several begin in turn. The layouts that each finds best come first.
    """
    firsts = _firsts(net, bodies, members)
    starts = [_laid_from(first, net, bodies, members) for first in firsts]
    most = max(starts, key=lambda start: len(start.layouts[0].frames))
    middle = {k: bodies.pose[bodies.of == k, :2].mean(axis=0) for k in most.layouts[0].frames}
    holds = next(k for k in (*firsts, *middle) if k in middle)
    layouts: list[BodyLayout] = []
    for one in (one for rank in zip_longest(*(start.layouts for start in starts)) for one in rank):
        if one is None or one.frames.keys() != middle.keys():
            continue
        to = se2.inverse(one.frames[holds])
        moved = BodyLayout({k: np.asarray(se2.compose(to, T)) for k, T in one.frames.items()}, one.cost)
        if not any(all(_alike(moved.frames[k], a.frames[k], middle[k]) for k in middle) for a in layouts):
            layouts.append(moved)
    return ColdStart(tuple(layouts), most.loose)


def _laid_from(first: int, net: RangeNetwork, bodies: Bodies, members: Sequence[int]) -> ColdStart:
    """What comes of placing the others one by one; frames are in that of `first`, the best layout first."""
    r = net.ranges
    of_a, of_b = bodies.of[r.a], bodies.of[r.b]
    p_a, p_b = se2.act(bodies.pose[r.a], r.lever_a), se2.act(bodies.pose[r.b], r.lever_b)

    def between(body: int, layout: BodyLayout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Known ends, own ends in the body's frame, and ranges."""
        known = np.array(sorted(layout.frames))
        here, there = (of_a == body) & np.isin(of_b, known), (of_b == body) & np.isin(of_a, known)
        frames = np.zeros((len(bodies.turns), 3))
        for k, T in layout.frames.items():
            frames[k] = T
        q = np.concatenate([se2.act(frames[of_b[here]], p_b[here]), se2.act(frames[of_a[there]], p_a[there])])
        p, z, t = (
            np.concatenate(x) for x in ((p_a[here], p_b[there]), (r.z[here], r.z[there]), (r.t[here], r.t[there]))
        )
        rows = np.argsort(t, kind="stable")[spread(len(t), MOST)]
        return q[rows], p[rows], z[rows]

    layouts = [BodyLayout({first: np.zeros(3)}, 0.0)]
    waiting = [k for k in members if k != first]
    loose: dict[int, str] = {}
    while waiting:
        tried: list[tuple[tuple[bool, int, int], int, list[tuple[BodyLayout, list[Placement]]]]] = []
        seen = {body: [between(body, layout) for layout in layouts] for body in waiting}
        for body in sorted(waiting, key=lambda k: (-len(seen[k][0][2]), k)):
            turns, n = bool(bodies.turns[body]), len(seen[body][0][2])
            if n < (LEAST if turns else LEAST - 2):
                loose[body] = f"{n} ranges to those whose place is known"
                continue
            ways = [(layout, placements(*data, turns=turns)) for layout, data in zip(layouts, seen[body], strict=True)]
            sure, count = all(way.sure for _, found in ways for way in found), sum(len(found) for _, found in ways)
            tried.append(((not sure, count, -n), body, ways))
            if sure and count == len(layouts):
                break  # nobody is placed more clearly
        if not tried:
            break
        (unsure, _, _), body, ways = min(tried, key=lambda one: one[0])
        if unsure:
            loose |= {b: UNSURE for _, b, _ in tried}
            break
        loose.pop(body, None)
        waiting.remove(body)
        layouts = _kept(
            [BodyLayout({**old.frames, body: way.T}, old.cost + way.cost) for old, found in ways for way in found]
        )
    return ColdStart(tuple(layouts), {k: loose[k] for k in waiting})


def _firsts(net: RangeNetwork, bodies: Bodies, members: Sequence[int]) -> list[int]:
    """The body that priors place, else those with most ranges to others."""
    of = bodies.of[net.priors.node]
    if len(of) and of[0] in members:
        return [int(of[0])]
    a, b = bodies.of[net.ranges.a], bodies.of[net.ranges.b]
    count = np.bincount(np.concatenate([a[a != b], b[a != b]]), minlength=len(bodies.turns))
    order = sorted(members, key=lambda k: (not bodies.turns[k], -int(count[k]), k))
    return [order[0], *(k for k in order[1:BEGINNERS] if bodies.turns[k])]


def _kept(layouts: list[BodyLayout]) -> list[BodyLayout]:
    layouts = sorted(layouts, key=lambda one: one.cost)
    return [one for one in layouts if one.cost < layouts[0].cost + LEAD][:MOST_KEPT]


def placements(
    q: Float[np.ndarray, "k 2"], p: Float[np.ndarray, "k 2"], z: Float[np.ndarray, " k"], *, turns: bool
) -> list[Placement]:
    """All ways in which a body may lie whose points `p` (its frame) were `z` [m] from `q`, the best first.

    A bias that all ranges share is estimated beside. Those that explain the ranges clearly worse than the best are
    left out; there is always one.
    """
    middle = p.mean(axis=0)
    own = p - middle
    heading = np.arange(HEADINGS) * 2 * np.pi / HEADINGS if turns else np.zeros(1)
    direction = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    R = se2.rotation(heading)
    centre = q.mean(axis=0) - np.einsum("hij,kj->hki", R, own).mean(axis=1)
    away = float(np.median(z)) * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    X = np.zeros((len(heading) * DIRECTIONS, 4))
    X[:, :2] = (centre[:, None] + away).reshape(-1, 2)
    X[:, 2] = np.repeat(heading, DIRECTIONS)
    for sd in (4 * ROUGH, ROUGH):
        X, cost, H = _refined(q, own, z, X, sd, turns=turns)
    found: list[Placement] = []
    scale = max(1.0, float(np.min(cost)) / len(z))
    for k in np.argsort(cost).tolist():
        if cost[k] > np.min(cost) + LEAD * scale:
            break
        T = se2.compose(X[k, :3], np.array([*-middle, 0.0]))
        if any(_alike(T, other.T, middle) for other in found):
            continue
        spread_of = np.linalg.inv(H[k] + 1e-9 * np.eye(4))
        sd_xy = float(np.sqrt(scale * np.linalg.eigvalsh(spread_of[:2, :2])[-1]))
        sd_theta = float(np.sqrt(scale * spread_of[2, 2])) if turns else 0.0
        found.append(Placement(T, float(cost[k]) / scale, np.array([sd_xy, sd_theta])))
    return found


def _alike(a: np.ndarray, b: np.ndarray, middle: np.ndarray) -> bool:
    d = se2.act(a, middle) - se2.act(b, middle)
    return bool(np.hypot(*d) < APART_XY and abs(se2.wrap_angle(a[2] - b[2])) < APART_THETA)


def _refined(
    q: np.ndarray, p: np.ndarray, z: np.ndarray, X: Float[np.ndarray, "h 4"], sd: float, *, turns: bool
) -> tuple[Float[np.ndarray, "h 4"], Float[np.ndarray, " h"], Float[np.ndarray, "h 4 4"]]:
    """Each of `X` (x, y, theta, bias) moved to a minimum of the Cauchy cost nearby; costs and informations there."""

    def normal(X: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        arm = se2.rotation(X[:, 2]) @ p.T
        d = X[:, :2, None] + arm - q.T
        r = np.hypot(d[:, 0], d[:, 1])
        J = np.ones((len(X), 4, len(z)))
        J[:, :2] = u = d / np.maximum(r, 1e-6)[:, None]
        J[:, 2] = u[:, 1] * arm[:, 0] - u[:, 0] * arm[:, 1] if turns else 0.0
        J /= sd
        e = (r + X[:, 3:] - z) / sd
        w = 1.0 / (1.0 + np.square(e) / KERNEL**2)
        cost = KERNEL**2 * np.log1p(np.square(e) / KERNEL**2).sum(axis=1) + np.square(X[:, 3] / BIAS_SD)
        wJ = J * w[:, None]
        H, g = wJ @ J.swapaxes(1, 2), (wJ @ e[..., None])[..., 0]
        H[:, 3, 3] += 1.0 / BIAS_SD**2
        g[:, 3] += X[:, 3] / BIAS_SD**2
        if not turns:
            H[:, 2, 2] = 1.0
        return cost, g, H

    damping = np.full(len(X), 1e-2)
    cost, g, H = normal(X)
    for _ in range(ROUNDS):
        D = damping[:, None, None] * (H * np.eye(4)) + 1e-9 * np.eye(4)
        step = -np.linalg.solve(H + D, g[..., None])[..., 0]
        tried = X + step
        new, new_g, new_H = normal(tried)
        better = new < cost
        done = float(np.abs(step[better]).max(initial=0.0)) < 1e-4
        X, cost = np.where(better[:, None], tried, X), np.where(better, new, cost)
        g, H = np.where(better[:, None], new_g, g), np.where(better[:, None, None], new_H, H)
        damping = np.where(better, 0.3 * damping, 8.0 * damping)
        if done:
            break
    X[:, 2] = se2.wrap_angle(X[:, 2])
    return X, cost, H


class LaidBodies(NamedTuple):
    """The bodies `placed`, whose `nodes` may begin at any of `poses`, and why others are loose."""

    placed: Collection[int]
    nodes: Int[np.ndarray, " n"]
    poses: list[Float[np.ndarray, "n 3"]]
    loose: Mapping[int, str]


def laid_in_pieces(net: RangeNetwork, bodies: Bodies, waiting: Sequence[int], pieces: int) -> LaidBodies:
    """How the bodies `waiting` may lie, ways in so many pieces.

    One that ranges do not place goes on from the one before it, or else leads to the next.
    """
    fine, whose = in_pieces(bodies, pieces)
    start = lay_out(net, fine, np.flatnonzero(np.isin(whose, waiting)).tolist())
    known = np.array(sorted(start.layouts[0].frames))
    placed = np.unique(whose[known])
    nodes = np.flatnonzero(np.isin(bodies.of, placed))
    like = np.arange(len(whose))
    for k in np.setdiff1d(np.flatnonzero(np.isin(whose, placed)), known).tolist():
        mine = known[whose[known] == whose[k]]
        like[k] = mine[max(int(np.searchsorted(mine, k)) - 1, 0)]
    poses = []
    for layout in start.layouts[:MOST_TIED]:
        frames = np.zeros((len(whose), 3))
        frames[list(layout.frames)] = np.array(list(layout.frames.values()))
        poses.append(np.asarray(se2.compose(frames[like[fine.of[nodes]]], bodies.pose[nodes])))
    loose = {int(whose[k]): why for k, why in start.loose.items() if whose[k] not in placed}
    return LaidBodies(placed.tolist(), nodes, poses, loose)
