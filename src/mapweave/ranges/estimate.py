"""Everybody's trajectory from ranges and odometry: laid out from no guess, then one robust problem.

Every pair of radios has a bias and a noise of its own, estimated from its residuals; a noise that the log states is the
least it has. Ranges past a wall or a person are
too long by metres: they fade by a redescending kernel, and are counted. Errors of ranges last (they follow how antennas
face each other), so that a range counts by as much less as they last longer than a range.

A robot that was carried, whose wheels slipped or whose odometry began anew is cut where ranges say so, when that
explains them better: what came before and after are two bodies.

Position fixes are one more factor of the same problem, which then lies in their world.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.rows import spread
from ..solve import (
    Cauchy,
    Factor,
    GemanMcClure,
    Information,
    Kernel,
    Pattern,
    Problem,
    Solution,
    SolveConfig,
    minimise,
    wrapping,
)
from .factors import (
    PRUNED,
    columns_of,
    common_factor,
    geometry,
    lasting,
    motion_factor,
    number_factor,
    prior_factor,
    range_factor,
)
from .fixes import FAR2, Laid, Sights, lay_among
from .network import Bodies, Motions, Priors, RangeNetwork, Ranges, bodies_of
from .start import LEAD, LEAST, ROUGH, BodyLayout, lay_out, placements

FIRST_SD = 0.15  # [m] noise of a range before residuals tell it
LEAST_SD = 0.01  # [m] noise of a range, whatever its residuals say: radios count in centimetres
SHRUNK = 0.02  # [m] sd of biases over all pairs, at least: a smaller one would hold them where they began
BIAS_SD = 0.3  # [m] of what the biases of all pairs have in common: antennas whose delay nobody trimmed
SPREAD = 0.15  # [m] of the biases beside what they have in common, before they tell it
FEW = 3  # pairs that tell it, at least
ANY_HEADING = 2.0  # [rad] sd of a heading that nothing tells
TO_SD = 1.4826  # times half the width of its densest half is the sd of a Gaussian
ANYTHING = 3.0  # [m] by up to which one that went another way is too long
FAR = 3.0  # [sd] from which a range is taken for one that went another way
WITHIN_FAR = 1.0136  # times what scatters within it is the sd of a Gaussian
WIDE = Cauchy(2.0)  # while the noise is still a guess
TIGHT = GemanMcClure(3.0)
# Noise and biases are estimated and all is solved again, with these kernels; at the end without those that are far.
ROUNDS: tuple[Kernel | None, ...] = (WIDE, TIGHT, TIGHT, None, None)
AMONG_FIXES: tuple[Kernel | None, ...] = (WIDE, None)  # the same, where ranges alone have told the noise
LEFT_OUT = 1e6  # times its sd: a range that is left out
STRAIGHT = 0.3  # of how far a path spreads, by which it differs from its mirror image: odometry bends straight ones
MOST_CUTS = 6  # of tracks where ranges deny their odometry, a whole solve each
CUTS = 12  # times spread over a track at which it is tried to be cut,
LOOKED = 60  # by so many ranges before and after
SHORT, SHORT_SHARE = 0.3, 0.02  # [m] by which ranges are too short, which no wall makes them, and their share to look
CUT_GAIN = 0.02  # share of a track's ranges that must agree with its two parts beside those that agree with the whole
MOST_TIED = 4  # layouts that are worked out whole, to see which explains the ranges best
SOLVE = SolveConfig(max_iterations=30, damping=1e-4, step_tolerance=1e-5, cost_tolerance=1e-6)


@dataclass(frozen=True, slots=True)
class Radio:
    """What a pair of radios turned out to be. bias, sd: [m]; lasting: ranges for which an error lasts; far: how many of
    `n` went another way.
    """

    a: str
    b: str
    n: int
    bias: float
    bias_sd: float
    sd: float
    lasting: float
    far: int


@dataclass(frozen=True, slots=True)
class PlacedPart:
    """What ranges and motions tie: `nodes` (m,) of the network, `first` of which holds the frame, or None where priors
    do; pose: (m, 3); cov: (m, 3, 3), without priors in the frame that fits all places best; beacon_cov: (2b, 2b), of
    its b beacons together; mirrored: other ways in which it may lie that explain the ranges as well; still: robots
    whose heading nothing tells; frame_cov: (3, 3), of a part in the world of fixes, how sure the whole lies there,
    told at the world's origin.
    """

    nodes: Int[np.ndarray, " m"]
    first: int | None
    pose: Float[np.ndarray, "m 3"]
    cov: Float[np.ndarray, "m 3 3"]
    beacon_cov: Float[np.ndarray, "c c"]
    converged: bool
    mirrored: tuple[Float[np.ndarray, "m 3"], ...]
    still: tuple[str, ...]
    frame_cov: Float[np.ndarray, "3 3"] | None = None


@dataclass(frozen=True, slots=True)
class RangeEstimate:
    """parts: the largest first; residual: (k,) [m] of each range, bias off, NaN where an end is not placed; far: (k,)
    which went another way; loose: robots and beacons that ranges do not place, and why; cost: as of a layout, of all
    parts; denied: motions of the network that ranges deny, which are not used.
    """

    parts: tuple[PlacedPart, ...]
    radios: tuple[Radio, ...]
    residual: Float[np.ndarray, " k"]
    far: Bool[np.ndarray, " k"]
    loose: dict[str, str]
    cost: float = 0.0
    denied: tuple[int, ...] = ()


class LaidParts(NamedTuple):
    """estimate: with the parts as one, which is `part`; laid: by the fixes; cost: as of a layout."""

    estimate: RangeEstimate
    part: PlacedPart
    laid: Laid
    cost: float


def estimate(net: RangeNetwork) -> RangeEstimate:
    """All trajectories and beacons of `net`, in as many parts as ranges leave, without the motions that ranges deny."""
    found = _worked_out(net)
    for _ in range(MOST_CUTS):
        k = _denied(net.without(found.denied), found)
        if k is None:
            break
        cut = (*found.denied, *np.flatnonzero((net.motions.first == k) & (net.motions.second == k + 1)).tolist())
        again = _worked_out(net.without(cut))
        if again.cost > found.cost - LEAD or len(again.parts) > len(found.parts) or again.loose.keys() - found.loose:
            break
        found = replace(again, denied=cut)
    return found


def _denied(net: RangeNetwork, found: RangeEstimate) -> int | None:
    """The node after which ranges deny what odometry says most clearly: both sides fit it, and not as one."""
    bodies, r = bodies_of(net), net.ranges
    pose = np.full((len(net.owner), 3), np.nan)
    for part in found.parts:
        pose[part.nodes] = part.pose
    most, where = 0, None
    used = np.flatnonzero(np.isfinite(found.residual))
    for body in np.unique(bodies.of[~net.is_beacon]).tolist():
        ours = np.stack([bodies.of[r.a[used]], bodies.of[r.b[used]]]) == body
        rows, by_a = used[ours[0] ^ ours[1]], ours[0][ours[0] ^ ours[1]]
        order = np.argsort(r.t[rows], kind="stable")
        rows, by_a = rows[order], by_a[order]
        if not len(rows) or (found.residual[rows] < -SHORT).mean() <= SHORT_SHARE:
            continue
        node, lever = np.where(by_a, r.a[rows], r.b[rows]), np.where(by_a[:, None], r.lever_a[rows], r.lever_b[rows])
        other, there = np.where(by_a, r.b[rows], r.a[rows]), np.where(by_a[:, None], r.lever_b[rows], r.lever_a[rows])
        p, q = se2.act(bodies.pose[node], lever), se2.act(pose[other], there)
        alone = int(_agreeing(p, q, r.z[rows], slice(None)).sum())
        for k in spread(len(rows), CUTS + 2)[1:-1].tolist():
            if min(k, len(rows) - k) < 2 * LEAST:
                continue
            before, after = (_agreeing(p, q, r.z[rows], part) for part in (slice(k), slice(k, None)))
            agree = np.cumsum(before) + after.sum() - np.cumsum(after)  # cut after each range
            at = int(np.argmax(agree[:-1]))
            gain = int(agree[at]) - alone
            if gain > max(most, CUT_GAIN * len(rows)) and bodies.of[(node[at] + 1) % len(bodies.of)] == body:
                most, where = gain, int(node[at])
    return where


def _agreeing(
    p: Float[np.ndarray, "k 2"], q: Float[np.ndarray, "k 2"], z: Float[np.ndarray, " k"], part: slice
) -> Bool[np.ndarray, " k"]:
    """Which ranges agree with where those of `part` place the body best."""
    rows = np.arange(len(z))[part]
    looked = rows[spread(len(rows), LOOKED)]
    T = placements(q[looked], p[looked], z[looked], turns=True)[0].T
    off = z - np.hypot(*(se2.act(T, p) - q).T)
    return np.asarray(np.abs(off - np.median(off[looked])) < 3 * ROUGH)


def _worked_out(net: RangeNetwork) -> RangeEstimate:
    """All trajectories and beacons of `net`, in as many parts as ranges leave."""
    bodies = bodies_of(net)
    residual, far = np.full(len(net.ranges), np.nan), np.zeros(len(net.ranges), bool)
    parts: list[PlacedPart] = []
    radios: list[Radio] = []
    loose: dict[int, str] = {}
    cost = 0.0
    waiting = list(range(len(bodies.turns)))
    robots = set(np.unique(bodies.of[~net.is_beacon]).tolist())
    while robots & set(waiting):
        start = lay_out(net, bodies, waiting)
        solved = sorted((_of_layout(net, bodies, layout) for layout in start.layouts[:MOST_TIED]), key=lambda s: s.cost)
        if (image := _mirrored(net, bodies, solved[0])) is not None:
            solved = sorted([*solved, _start_at(net, bodies, solved[0].nodes, image)], key=lambda s: s.cost)
        best = solved[0]
        others: list[np.ndarray] = []
        for s in solved[1:]:
            pose = s.pose if len(net.priors.node) else se2.compose(se2.align(s.pose[:, :2], best.pose[:, :2]), s.pose)
            if s.cost < best.cost + LEAD and all(_differ(pose, other) for other in (best.pose, *others)):
                others.append(pose)
        parts.append(best.part(tuple(others)))
        cost += best.cost
        radios += best.radios()
        residual[best.rows], far[best.rows] = best.noise.residual, best.noise.far
        loose |= start.loose
        waiting = [body for body in waiting if body not in start.layouts[0].frames]
    parts.sort(key=_largest_first(net))
    apart = {net.everybody[net.owner[k]] for part in parts[1:] for k in part.nodes.tolist()}
    told = {net.everybody[net.owner[np.argmax(bodies.of == body)]]: why for body, why in loose.items()}
    lost = {net.everybody[net.owner[np.argmax(bodies.of == body)]] for body in waiting}
    return RangeEstimate(
        tuple(parts), tuple(radios), residual, far,
        {name: told.get(name, "no ranges to anybody") for name in net.everybody if name in apart | lost}, cost,
    )  # fmt: skip


def laid_parts(
    net: RangeNetwork,
    found: RangeEstimate,
    parts: Sequence[PlacedPart],
    poses: Sequence[Float[np.ndarray, "_ 3"]],
    sights: Sights,
    others: Sequence[tuple[int, Float[np.ndarray, "_ 3"]]] = (),
) -> LaidParts | None:
    """`found` with `parts` of it as one, in the world of `sights`; None where they do not hold it.

    poses: about where each part lies there; sights: on nodes of the network; others: which part may lie elsewhere too,
    and where.
    """
    nodes = np.concatenate([part.nodes for part in parts])
    order = np.argsort(nodes)
    solved = _solved(net, bodies_of(net), nodes[order], np.concatenate(poses)[order], found, sights)
    if solved is None or solved.laid is None:
        return None
    mirrored = []
    for k, pose in others:
        mirrored.append(solved.pose.copy())
        mirrored[-1][np.isin(nodes[order], parts[k].nodes)] = pose
    part, ours = solved.part(tuple(mirrored)), solved.radios()
    pairs = {(radio.a, radio.b) for radio in ours}
    residual, far = found.residual.copy(), found.far.copy()
    residual[solved.rows], far[solved.rows] = solved.noise.residual, solved.noise.far
    gone = {id(one) for one in parts}
    all_parts = sorted([part, *(one for one in found.parts if id(one) not in gone)], key=_largest_first(net))
    main = {net.everybody[k] for k in net.owner[all_parts[0].nodes].tolist()}
    every = RangeEstimate(
        tuple(all_parts),
        (*ours, *(radio for radio in found.radios if (radio.a, radio.b) not in pairs)),
        residual,
        far,
        {
            name: found.loose.get(name, "no ranges to those that fixes place")
            for name in net.everybody
            if name not in main
        },
        found.cost,
        found.denied,
    )
    return LaidParts(every, part, solved.laid, solved.cost)


def laid_as_fixes_fit(
    net: RangeNetwork,
    found: RangeEstimate,
    part: PlacedPart,
    poses: Sequence[Float[np.ndarray, "_ 3"]],
    sights: Sights,
) -> list[Float[np.ndarray, "_ 3"]]:
    """Where the part lies in the world by its fixes: the best of what comes of `poses`, about where it may lie, first,
    and those that explain ranges and fixes as well.
    """
    ways: list[tuple[float, np.ndarray]] = []
    for pose in poses:
        tried = laid_parts(net, found, (part,), (pose,), sights)
        if tried is not None:
            laid, of = tried.laid, tried.laid.receivers
            n = np.bincount(sights.of, minlength=len(of.scale)) / of.lasting
            far = np.bincount(sights.of[laid.far], minlength=len(n)) / of.lasting
            # less twice the logarithm of the likelihood, in which a fix has two coordinates of a noise that is found
            cost = tried.cost + float((4 * n * np.log(of.scale) + FAR2 * far).sum())
            ways.append((cost, tried.part.pose))
    out: list[np.ndarray] = []
    for cost, pose in sorted(ways, key=lambda way: way[0]):
        if cost < min(ways, key=lambda way: way[0])[0] + LEAD and all(_differ(pose, other) for other in out):
            out.append(pose)
    return out


def _differ(one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]) -> bool:
    """Whether anybody lies elsewhere."""
    return bool(np.hypot(*(one - other)[:, :2].T).max() > 10 * FIRST_SD)


def _largest_first(net: RangeNetwork) -> Callable[[PlacedPart], tuple[int, int]]:
    return lambda part: (-len(np.unique(net.owner[part.nodes])), int(part.nodes[0]))


@dataclass(frozen=True, slots=True)
class _Noise:
    """What residuals tell: of each pair the noise [m] and for how many ranges an error lasts; which ranges are far."""

    residual: Float[np.ndarray, " k"]
    far: Bool[np.ndarray, " k"]
    sd: Float[np.ndarray, " p"]
    lasting: Float[np.ndarray, " p"]

    @classmethod
    def of(cls, r: Ranges, which: Int[np.ndarray, " k"], pairs: int, residual: Float[np.ndarray, " k"]) -> "_Noise":
        far, sd, long = np.zeros(len(residual), bool), np.empty(pairs), np.empty(pairs)
        for k in range(pairs):
            mine = np.flatnonzero(which == k)
            e = residual[mine]
            kept = np.ones(len(e), bool)
            for _ in range(PRUNED):
                middle, half = _densest_half(e[kept])
                sd[k] = max(LEAST_SD, TO_SD * half)
                kept = np.abs(e - middle) <= FAR * sd[k]
                kept = np.abs(e - np.median(e[kept])) <= FAR * sd[k]
            far[mine] = ~kept
            sd[k] = max(LEAST_SD, WITHIN_FAR * float(e[kept].std()))
            good = mine[~far[mine]]
            long[k] = lasting(residual[good[np.argsort(r.t[good], kind="stable")]])
        return cls(residual, far, sd, long)


@dataclass(frozen=True, slots=True)
class _Solved:
    """One layout, worked out. nodes, rows: of the network; names: (p, 2) the pairs, which: (k,) each range's;

    first: the node that holds the frame; unturned: (n,) nodes whose heading nothing tells; cost: less twice the
    logarithm of the likelihood of all it rests on, but for what is the same of every layout.
    """

    net: RangeNetwork
    nodes: Int[np.ndarray, " n"]
    rows: Int[np.ndarray, " k"]
    names: Int[np.ndarray, "p 2"]
    which: Int[np.ndarray, " k"]
    first: int | None
    unturned: Bool[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    bias: Float[np.ndarray, " p"]
    bias_sd: Float[np.ndarray, " p"]
    noise: _Noise
    solution: Solution
    laid: Laid | None
    cost: float

    def part(self, mirrored: tuple[np.ndarray, ...]) -> PlacedPart:
        n, beacon = len(self.nodes), self.net.is_beacon[self.nodes]
        at = (3 * np.flatnonzero(beacon)[:, None] + np.arange(2)).ravel()
        cov, joint, frame = np.full((n, 3, 3), np.nan), np.full((len(at), len(at)), np.nan), None
        if self.solution.information is not None:
            cov, joint = self.solution.blocks(columns_of(np.arange(n))), self.solution.covariance(at)
            if self.first is not None:
                cov, joint, frame = self._about_all(self.solution.information, cov, at, joint)
        still = np.unique(self.net.owner[self.nodes[self.unturned & ~beacon]]).tolist()
        return PlacedPart(
            nodes=self.nodes,
            first=self.first,
            pose=self.pose,
            cov=cov,
            beacon_cov=joint,
            converged=self.solution.converged,
            mirrored=mirrored,
            still=tuple(self.net.robots[k] for k in still),
            frame_cov=None if self.laid is None else frame,
        )

    def _about_all(
        self, information: Information, cov: np.ndarray, at: Int[np.ndarray, " c"], joint: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The covariances `cov` of all nodes and `joint` of the entries `at`, in the frame that fits all places best.

        And that of this frame, which is where the whole lies as fixes tell it.

        Nothing says where a team without priors lies. Seen from one pose, whose heading odometry tells to a degree or
        two, everything a few metres away is unsure by decimetres, and all alike; that is no error of the map. An
        S-transformation [Baarda, 1973] takes it out: x - G c, where c (3) is how the whole lies, by its places.
        """
        n = len(self.nodes)
        G = np.zeros((n, 3, 3))  # how poses change as the frame does: moved in x, in y, turned
        G[:] = np.eye(3)
        G[:, 0, 2], G[:, 1, 2] = -self.pose[:, 1], self.pose[:, 0]
        flat = G[:, :2].reshape(-1, 3)
        M = np.linalg.inv(flat.T @ flat)
        U = np.zeros((len(self.solution.x), 3))
        U[columns_of(np.arange(n))[:, :2].ravel()] = flat @ M  # c = U^T x
        V = np.zeros_like(U)
        V[self.solution.free] = information.solve(U[self.solution.free])
        C, held = U.T @ V, V[: 3 * n].reshape(n, 3, 3)
        across = held @ G.swapaxes(1, 2)
        out = cov - across - across.swapaxes(1, 2) + G @ C @ G.swapaxes(1, 2)
        row = G.reshape(-1, 3)[at]
        mixed = V[at] @ row.T
        return out, joint - mixed - mixed.T + row @ C @ row.T, C

    def radios(self) -> list[Radio]:
        who = self.net.everybody
        return [
            Radio(
                a=who[a],
                b=who[b],
                n=int((self.which == k).sum()),
                bias=float(self.bias[k]),
                bias_sd=float(self.bias_sd[k]),
                sd=float(self.noise.sd[k]),
                lasting=float(self.noise.lasting[k]),
                far=int(self.noise.far[self.which == k].sum()),
            )
            for k, (a, b) in enumerate(self.names.tolist())
        ]


def _of_layout(net: RangeNetwork, bodies: Bodies, layout: BodyLayout) -> _Solved:
    """The team worked out from `layout`."""
    nodes = np.flatnonzero(np.isin(bodies.of, list(layout.frames)))
    frames = np.zeros((len(bodies.turns), 3))
    frames[list(layout.frames)] = np.array(list(layout.frames.values()))
    return _start_at(net, bodies, nodes, se2.compose(frames[bodies.of[nodes]], bodies.pose[nodes]))


def _start_at(
    net: RangeNetwork, bodies: Bodies, nodes: Int[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]
) -> _Solved:
    """`nodes` worked out from `pose`."""
    solved = _solved(net, bodies, nodes, pose)
    assert solved is not None  # noqa: S101  (only fixes may fail to hold it)
    return solved


def _mirrored(net: RangeNetwork, bodies: Bodies, best: _Solved) -> Float[np.ndarray, "n 3"] | None:
    """The mirror image of `best`, about; None where priors or robots that turned deny it.

    Of robots that drove straight nothing tells the two apart but the errors of their odometry, which bend their paths
    and may have decided for one side.
    """
    if len(net.priors.node):
        return None
    image, of = best.pose * (1.0, -1.0, -1.0), bodies.of[best.nodes]
    for body in np.unique(of[~net.is_beacon[best.nodes]]).tolist():
        mine, own = of == body, bodies.pose[best.nodes[of == body]]
        there = image[mine, :2]
        laid = se2.compose(se2.align(own[:, :2], there), own)
        if np.square(laid[:, :2] - there).sum() > STRAIGHT**2 * np.square(there - there.mean(axis=0)).sum():
            return None
        image[mine] = laid
    return image


def _solved(
    net: RangeNetwork,
    bodies: Bodies,
    nodes: Int[np.ndarray, " n"],
    start: Float[np.ndarray, "n 3"],
    known: RangeEstimate | None = None,
    sights: Sights | None = None,
) -> _Solved | None:
    """`nodes` worked out from where they `start`, noise and biases of the radios with it.

    known: what was found without `sights`; with them it lies in their world, or is None where they do not hold it.
    """
    place = np.full(len(net.owner), -1)
    place[nodes] = np.arange(len(nodes))
    rows = np.flatnonzero((place[net.ranges.a] >= 0) & (place[net.ranges.b] >= 0))
    r = net.ranges.select(rows)
    r = replace(r, a=place[r.a], b=place[r.b])
    terms, held = _ties(net, place)
    names, of_all = net.pairs()
    there, which = np.unique(of_all[rows], return_inverse=True)
    n, pairs, beacon = len(nodes), len(there), net.is_beacon[nodes]
    biases, of = 3 * n + np.arange(pairs), bodies.of[nodes]
    common = 3 * n + pairs  # what the biases have in common
    x = np.append(start.ravel(), np.zeros(pairs + 1))
    fixed = np.zeros(len(x), bool)
    fixed[3 * np.flatnonzero(beacon) + 2] = True
    first = None if held else int(np.argmin(beacon))
    if first is not None and sights is None:
        fixed[3 * first : 3 * first + 3] = True
    heads = np.unique(of, return_index=True)[1]
    begins = np.array([k for k in heads if not (beacon[k] or (k == first and sights is None))], np.int64)
    if len(begins):  # the heading of one that stands is anything, and the problem stays regular
        terms.append(number_factor(3 * begins + 2, x[3 * begins + 2], ANY_HEADING, "headings"))
    angles = wrapping(3 * np.arange(n) + 2)
    terms.append(number_factor(np.array([common]), np.zeros(1), BIAS_SD, "common bias"))
    spread, pattern = (SHRUNK if np.isfinite(r.sd).all() else SPREAD), None
    noise, x[biases] = _known(net, known, names[there], rows)
    ordered, laid, P = _order(fixed, beacon, pairs), None, None
    for kernel in ROUNDS if sights is None else AMONG_FIXES:
        sd = np.fmax(r.sd, noise.sd[which]) * np.sqrt(noise.lasting[which])
        if kernel is None:
            sd[noise.far] *= LEFT_OUT
        ranges = range_factor(r, biases[which], sd, kernel)
        every = [*terms, ranges, common_factor(biases, common, spread)]
        if sights is None:
            problem = Problem(x, every, fixed, angles)
            pattern = pattern or ordered(Pattern.of(problem))
            solution = minimise(problem, SOLVE, pattern)
        else:
            laid = lay_among(x, n, every, replace(sights, node=place[sights.node]), fixed, ordered)
            if laid is None:
                return None
            solution = laid.solution
        x = solution.x
        pose, bias = x[: 3 * n].reshape(-1, 3), x[biases]
        P = solution.covariance(np.append(biases, common)) if solution.information is not None else None
        if P is not None and pairs >= FEW:
            spread = _spread_of(bias - x[common], P)
        noise = _Noise.of(r, which, pairs, r.z - geometry(r, pose)[0] - bias[which])
    bias_sd = np.full(pairs, np.nan) if P is None else np.sqrt(np.diag(P)[:-1])
    unturned = ~bodies.turns[of] & (len(heads) > 1 or sights is not None)
    return _Solved(
        net, nodes, rows, names[there], which, first, unturned, pose, bias, bias_sd, noise, solution, laid,
        cost=solution.cost - float(np.square(noise.residual / sd).sum()) + _unlikely(noise, r, which),
    )  # fmt: skip


def _unlikely(noise: _Noise, r: Ranges, which: Int[np.ndarray, " k"]) -> float:
    """Less twice the logarithm of the likelihood of the ranges: each but the far ones goes on from its pair's last.

    A layout that is wrong is made up for by noise that is greater and lasts longer, which squares over the noise hide.
    """
    sd = np.fmax(r.sd, noise.sd[which])
    long = noise.lasting[which]
    new = sd * 2.0 * np.sqrt(long) / (long + 1.0)  # of an error, beside what is left of the last, as it lasts so long
    each = np.square(noise.residual / sd) + 2.0 * np.log(new) + np.log(2.0 * np.pi)
    return float(np.where(noise.far, 2.0 * np.log(ANYTHING), each).sum())


def _spread_of(off: Float[np.ndarray, " p"], P: Float[np.ndarray, "q q"]) -> float:
    """[m] of biases `off` what they have in common; P: covariance of biases and, last, of that."""
    apart = np.diag(P)[:-1] + P[-1, -1] - 2 * P[:-1, -1]
    return max(SHRUNK, float(np.sqrt(np.mean(np.square(off) + apart))))


def _ties(net: RangeNetwork, place: Int[np.ndarray, " m"]) -> tuple[list[Factor], bool]:
    """Motions and priors of the nodes that have a `place`, and whether there are priors."""
    m, p = net.motions, net.priors
    here, held = place[m.first] >= 0, place[p.node] >= 0
    terms = []
    if here.any():
        terms.append(motion_factor(Motions(place[m.first[here]], place[m.second[here]], m.z[here], m.cov[here])))
    if held.any():
        terms.append(prior_factor(Priors(place[p.node[held]], p.z[held], p.cov[held])))
    return terms, bool(held.any())


def _known(
    net: RangeNetwork, found: RangeEstimate | None, names: Int[np.ndarray, "p 2"], rows: Int[np.ndarray, " k"]
) -> tuple[_Noise, Float[np.ndarray, " p"]]:
    """The noise of the ranges `rows`, of the pairs `names`, as they were found, if so, and the pairs' biases [m]."""
    pairs, k = len(names), len(rows)
    if found is None:
        return _Noise(np.zeros(k), np.zeros(k, bool), np.full(pairs, FIRST_SD), np.ones(pairs)), np.zeros(pairs)
    radios = {(radio.a, radio.b): radio for radio in found.radios}
    told = [radios.get((net.everybody[a], net.everybody[b])) for a, b in names.tolist()]
    each = [(0.0, FIRST_SD, 1.0) if radio is None else (radio.bias, radio.sd, radio.lasting) for radio in told]
    bias, sd, long = np.array(each).reshape(-1, 3).T
    return _Noise(found.residual[rows], found.far[rows], sd, long), bias


def _order(fixed: Bool[np.ndarray, " m"], beacon: Bool[np.ndarray, " n"], pairs: int) -> Callable[[Pattern], Pattern]:
    """Trajectories eliminated first, beacons and biases last: they touch most of all."""
    n = len(beacon)
    group = np.concatenate([np.repeat(np.arange(n), 3), n + np.arange(pairs + 1)])[~fixed]
    last = np.concatenate([np.repeat(beacon, 3), np.ones(pairs + 1, bool)])[~fixed]
    return lambda pattern: pattern.least_fill(group, last)


def _densest_half(e: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Middle and half width of the shortest span that holds half of the errors: where most ranges went straight.

    Those that went round something are all too long, so that a median and what scatters about it are off.
    """
    e = np.sort(e)
    h = len(e) // 2 + 1
    width = e[h - 1 :] - e[: len(e) - h + 1]
    k = int(np.argmin(width))
    return float(0.5 * (e[k] + e[k + h - 1])), float(0.5 * width[k])
