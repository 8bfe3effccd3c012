"""Everybody's trajectory from ranges and odometry: laid out from no guess, then one robust problem.

Every pair of radios has a bias and a noise of its own, estimated from its residuals; a noise that the log states is the
least it has. Ranges past a wall or a person are too long by metres: they fade by a redescending kernel, and are
counted. Errors of ranges last (they follow how antennas face each other), so that a range counts by as much less as
they last longer than a range.

A robot that was carried, whose wheels slipped or whose odometry began anew is cut where ranges say so, when that
explains them better: what came before and after are two bodies.

Stamps of ranges may be of another clock than those of odometry, and rounded; biases may grow; odometry may slip or be
of another scale for a while: all that is found with the rest (`factors.RadioColumns`, `noise`).

Position fixes are one more factor of the same problem, which then lies in their world.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
    RadioColumns,
    closing,
    columns_of,
    common_factor,
    geometry,
    motion_factor,
    number_factor,
    prior_factor,
    range_factor,
)
from .fixes import FAR2, Laid, Sights, lay_among
from .network import Bodies, Motions, Priors, RangeNetwork, Ranges, StampShift, bodies_of, in_pieces
from .noise import SHRUNK, RadioNoise, loosened, spread_of, unlikely, windows_of
from .start import LEAD, LEAST, ROUGH, UNSURE, LaidBodies, laid_in_pieces, placements

FIRST_SD = 0.15  # [m] noise of a range before residuals tell it
BIAS_SD = 0.3  # [m] of what the biases of all pairs have in common: antennas whose delay nobody trimmed
SPREAD = 0.15  # [m] of the biases beside what they have in common, before they tell it
FEW = 3  # pairs that tell it, at least
GROWTH, GROWS_APART = 0.1, 0.02  # [m] sd by which biases grow over a log, all alike and beside, before ranges tell it
LAG = 0.05  # [s] sd, at least, by which stamps of ranges are later than robots' odometry, and of how that grows
SETTLED, MORE = 1.25, 8  # times its factor changes at which that goes on, so often at most
ANY_HEADING = 2.0  # [rad] sd of a heading that nothing tells
WIDE = Cauchy(2.0)  # while the noise is still a guess
TIGHT = GemanMcClure(3.0)
# Noise and biases are estimated and all is solved again, with these kernels; at the end without those that are far.
ROUNDS: tuple[Kernel | None, ...] = (WIDE, TIGHT, TIGHT, None, None)
AGAIN: tuple[Kernel | None, ...] = (WIDE, None)  # the same, where ranges alone have told the noise
LEFT_OUT = 1e6  # times its sd: a range that is left out
STRAIGHT = 0.3  # of how far a path spreads, by which it differs from its mirror image: odometry bends straight ones
MOST_CUTS = 6  # of tracks where ranges deny their odometry, a whole solve each
CUTS = 12  # times spread over a track at which it is tried to be cut,
LOOKED = 60  # by so many ranges before and after
SHORT, SHORT_SHARE = 0.3, 0.02  # [m] by which ranges are too short, which no wall makes them, and their share to look
CUT_GAIN = 0.02  # share of a track's ranges that must agree with its two parts beside those that agree with the whole
PIECES = (4, 16)  # in which ways are laid that drift too far to be laid as wholes
SOLVE = SolveConfig(max_iterations=30, damping=1e-4, step_tolerance=1e-5, cost_tolerance=1e-6)


@dataclass(frozen=True, slots=True)
class Radio:
    """What a pair of radios turned out to be. bias, sd: [m]; growth: [m] of its bias over the log; lasting: ranges for
    which an error lasts; far: how many of `n` went another way.
    """

    a: str
    b: str
    n: int
    bias: float
    bias_sd: float
    sd: float
    lasting: float
    far: int
    growth: float = 0.0
    growth_sd: float = np.nan


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
class Slip:
    """From one time [s] to another a robot's odometry errs by `times` what it is taken to."""

    robot: str
    first: float
    last: float
    times: float


@dataclass(frozen=True, slots=True)
class RangeEstimate:
    """parts: the largest first; residual: (k,) [m] of each range, bias off, NaN where an end is not placed; far: (k,)
    which went another way; loose: robots and beacons that ranges do not place, and why; cost: as of a layout, of all
    parts; denied: motions of the network that ranges deny, which are not used; clocks: of robots, and their standard
    deviations; jitter: [s] by which stamps of ranges scatter, at most.
    """

    parts: tuple[PlacedPart, ...]
    radios: tuple[Radio, ...]
    residual: Float[np.ndarray, " k"]
    far: Bool[np.ndarray, " k"]
    loose: dict[str, str]
    cost: float = 0.0
    denied: tuple[int, ...] = ()
    clocks: Mapping[str, tuple[StampShift, StampShift]] = field(default_factory=dict)
    slips: tuple[Slip, ...] = ()
    jitter: float = 0.0


class LaidParts(NamedTuple):
    """estimate: with the parts as one, which is `part`; laid: by the fixes; cost: as of a layout."""

    estimate: RangeEstimate
    part: PlacedPart
    laid: Laid
    cost: float


def estimate(net: RangeNetwork) -> RangeEstimate:
    """All trajectories and beacons of `net`, in as many parts as ranges leave, without the motions that ranges deny."""
    found = _worked_out(net)
    if _too_short(found.far, found.residual):
        again = _worked_out(net, cut=True)
        if again.cost < found.cost - LEAD and not again.loose.keys() - found.loose.keys():
            found = again
    for _ in range(MOST_CUTS):
        k = _denied(net.without(found.denied), found)
        if k is None:
            break
        cut = (*found.denied, *np.flatnonzero((net.motions.first == k) & (net.motions.second == k + 1)).tolist())
        again = _worked_out(net.without(cut))
        if again.cost > found.cost - LEAD or len(again.parts) > len(found.parts) or again.loose.keys() - found.loose:
            break
        found = replace(again, denied=cut)
    return _reckoned(net.without(found.denied), found)


def _reckoned(net: RangeNetwork, found: RangeEstimate) -> RangeEstimate:
    """`found`, where odometry counts less while it errs more than it is taken to."""
    bodies, parts, radios = bodies_of(net), list[PlacedPart](), list[Radio]()
    residual, far = found.residual.copy(), found.far.copy()
    jitter, clocks, slips = 0.0, dict[str, tuple[StampShift, StampShift]](), list[Slip]()
    for part in found.parts:
        s = _start_at(net, bodies, part.nodes, part.pose, found)
        parts.append(s.part(part.mirrored))
        radios += s.radios()
        residual[s.rows], far[s.rows] = s.noise.residual, s.noise.far
        clocks |= s.clocks()
        slips += s.slips()
        jitter = max(jitter, s.noise.jitter)
    return replace(
        found,
        parts=tuple(parts),
        radios=tuple(radios),
        residual=residual,
        far=far,
        clocks=clocks,
        slips=tuple(slips),
        jitter=jitter,
    )


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


def _too_short(far: Bool[np.ndarray, " k"], residual: Float[np.ndarray, " k"]) -> bool:
    """Whether ranges were rejected that are too short, which no wall makes them: somebody lies elsewhere."""
    return bool((far & (residual < 0)).sum() > SHORT_SHARE * np.isfinite(residual).sum())


def _worked_out(net: RangeNetwork, *, cut: bool = False) -> RangeEstimate:
    """All trajectories and beacons of `net`, in as many parts as ranges leave.

    Odometry that drifts by metres fits no beacon anywhere, as if it told too little. Ever shorter pieces of ways are
    laid as if they were bodies then, or where ways are to be `cut`: the beacons that one finds place the next.
    """
    bodies = bodies_of(net)
    residual, far = np.full(len(net.ranges), np.nan), np.zeros(len(net.ranges), bool)
    parts: list[PlacedPart] = []
    radios: list[Radio] = []
    loose: dict[int, str] = {}
    cost = 0.0
    waiting = list(range(len(bodies.turns)))
    robots = set(np.unique(bodies.of[~net.is_beacon]).tolist())
    while robots & set(waiting):
        start, solved = _laid_and_solved(net, bodies, waiting, cut=cut)
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
        waiting = [body for body in waiting if body not in start.placed]
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
        {**found.clocks, **solved.clocks()},
        found.slips,
        found.jitter,
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
class _Solved:
    """One layout, worked out. nodes, rows: of the network; names: (p, 2) the pairs, which: (k,) each range's;

    first: the node that holds the frame; unturned: (n,) nodes whose heading nothing tells; unknown: biases, their
    growth, clocks' lags and drifts, and their standard deviations; loose: (m,) times by which motions err more than
    they are taken to; cost: less twice the logarithm of the likelihood of all it rests on, but for what is the same of
    every layout.
    """

    net: RangeNetwork
    nodes: Int[np.ndarray, " n"]
    rows: Int[np.ndarray, " k"]
    names: Int[np.ndarray, "p 2"]
    which: Int[np.ndarray, " k"]
    first: int | None
    unturned: Bool[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    unknown: Float[np.ndarray, "2 u"]
    noise: RadioNoise
    loose: Float[np.ndarray, " m"]
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

    def clocks(self) -> dict[str, tuple[StampShift, StampShift]]:
        lag, drift = (self.unknown[:, -k * len(self.net.everybody) :] for k in (2, 1))
        return {
            self.net.robots[k]: (
                StampShift(*map(float, (lag[0, k], drift[0, k]))),
                StampShift(*map(float, (lag[1, k], drift[1, k]))),
            )
            for k in np.unique(self.net.owner[self.nodes[~self.net.is_beacon[self.nodes]]]).tolist()
        }

    def slips(self) -> list[Slip]:
        """Windows in which odometry errs by more than it is taken to, those that follow each other as one."""
        m, out = self.net.motions, list[Slip]()
        for k in np.flatnonzero((self.loose > 1.0) & np.isin(m.first, self.nodes)).tolist():
            i, j = int(m.first[k]), int(m.second[k])
            robot, t, times = self.net.robots[self.net.owner[i]], self.net.t[[i, j]], float(self.loose[k])
            if out and out[-1].robot == robot and t.min() <= out[-1].last + 1e-9:
                out[-1] = replace(out[-1], last=float(t.max()), times=max(out[-1].times, times))
            else:
                out.append(Slip(robot, float(t.min()), float(t.max()), times))
        return out

    def radios(self) -> list[Radio]:
        who, pairs = self.net.everybody, len(self.names)
        return [
            Radio(
                a=who[a],
                b=who[b],
                n=int((self.which == k).sum()),
                bias=float(self.unknown[0, k]),
                bias_sd=float(self.unknown[1, k]),
                sd=float(self.noise.sd[k]),
                lasting=float(self.noise.lasting[k]),
                far=int(self.noise.far[self.which == k].sum()),
                growth=float(self.unknown[0, pairs + k]),
                growth_sd=float(self.unknown[1, pairs + k]),
            )
            for k, (a, b) in enumerate(self.names.tolist())
        ]


def _laid_and_solved(
    net: RangeNetwork, bodies: Bodies, waiting: Sequence[int], *, cut: bool
) -> tuple[LaidBodies, list[_Solved]]:
    """How the bodies `waiting` lie that ranges place, worked out from each of the layouts, the likeliest first."""
    best: tuple[LaidBodies, list[_Solved]] | None = None
    whole, count = laid_in_pieces(net, bodies, waiting, 1), len(bodies.turns)  # how many are laid
    for pieces in PIECES if cut or UNSURE in whole.loose.values() else ():
        before, count = count, len(in_pieces(bodies, pieces)[1])
        if count == before:  # too short a way to cut it further
            break
        laid = laid_in_pieces(net, bodies, waiting, pieces)
        if len(laid.placed) < len(best[0].placed if best else whole.placed):
            continue
        solved = sorted((_start_at(net, bodies, laid.nodes, pose) for pose in laid.poses), key=lambda s: s.cost)
        if best is None or len(laid.placed) > len(best[0].placed) or solved[0].cost < best[1][0].cost:
            best = laid, solved
        if UNSURE not in laid.loose.values() and not _too_short(solved[0].noise.far, solved[0].noise.residual):
            break
    if best is not None and (cut or len(best[0].placed) > len(whole.placed)):
        return best
    return whole, sorted((_start_at(net, bodies, whole.nodes, pose) for pose in whole.poses), key=lambda s: s.cost)


def _start_at(
    net: RangeNetwork,
    bodies: Bodies,
    nodes: Int[np.ndarray, " n"],
    pose: Float[np.ndarray, "n 3"],
    known: RangeEstimate | None = None,
) -> _Solved:
    """`nodes` worked out from `pose`."""
    solved = _solved(net, bodies, nodes, pose, known)
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

    known: what was found before; odometry may count less then, and noise is told anew, lest errors of odometry are
    taken for it. With `sights` it lies in their world, or is None where they do not hold it.
    """
    place, rows, r, names, which = _among(net, nodes)
    m = net.motions
    here = np.flatnonzero(place[m.first] >= 0)
    moved, window = Motions(place[m.first[here]], place[m.second[here]], m.z[here], m.cov[here]), windows_of(net, here)
    owner, beacon, of = net.owner[nodes], net.is_beacon[nodes], bodies.of[nodes]
    n, entry = len(nodes), _Entries(len(nodes), len(names), len(net.everybody))
    radio = entry.of_ranges(which, owner[r.a], owner[r.b])
    x, held = np.append(start.ravel(), np.zeros(entry.more)), _priors(net, place)
    first = None if held else int(np.argmin(beacon))
    fixed = _fixed(entry, r, owner, beacon)
    if first is not None and sights is None:
        fixed[3 * first : 3 * first + 3] = True
    heads = np.unique(of, return_index=True)[1]
    begins = np.array([k for k in heads if not (beacon[k] or (k == first and sights is None))], np.int64)
    terms = [*held, *entry.beforehand()]
    if len(begins):  # the heading of one that stands is anything, and the problem stays regular
        terms.append(number_factor(3 * begins + 2, x[3 * begins + 2], ANY_HEADING, "headings"))
    spread, apart, pattern = (SHRUNK if np.isfinite(r.sd).all() else SPREAD), entry.apart(x, None), None
    noise, x[entry.biases] = _known(net, None if sights is None else known, names, rows)
    ordered, laid, P, loose = _order(fixed, beacon), None, None, _known_slips(net, known)[here]
    rounds = list(ROUNDS if sights is None else AGAIN)
    for k, kernel in enumerate(rounds):
        sd, was = np.fmax(r.sd, noise.each) * np.sqrt(noise.lasting[which]), loose
        if kernel is None:
            sd[noise.far] *= LEFT_OUT
        ranges = range_factor(r, radio, sd, kernel)
        steps = [motion_factor(replace(moved, cov=moved.cov * loose[:, None, None] ** 2))] if len(here) else []
        every = [*steps, *terms, entry.clocks(apart), ranges, common_factor(entry.biases, entry.common, spread)]
        if sights is None:
            problem = Problem(x, every, fixed, wrapping(3 * np.arange(n) + 2))
            pattern = pattern or ordered(Pattern.of(problem))
            solution = minimise(problem, SOLVE, pattern)
        else:
            laid = lay_among(x, n, every, replace(sights, node=place[sights.node]), fixed, ordered)
            if laid is None:
                return None
            solution = laid.solution
        x, pose = solution.x, solution.x[: 3 * n].reshape(-1, 3)
        P = None if solution.information is None else solution.covariance(np.arange(3 * n, len(x)))
        if P is not None and entry.pairs >= FEW:
            spread = spread_of(x[entry.biases] - x[entry.common], P[: entry.pairs + 1, : entry.pairs + 1])
        apart = entry.apart(x, P)
        then, off = radio.known(x, r)
        noise = RadioNoise.of(r, which, entry.pairs, r.z - geometry(then, pose)[0] - off, np.add(*closing(then, pose)))
        if steps and P is not None and known is not None and sights is None:
            loose = loosened(steps[0], solution, was, window, owner[moved.first])
            if k + 1 == len(rounds) < len(ROUNDS) + MORE and np.abs(np.log(loose / was)).max() > np.log(SETTLED):
                rounds.append(None)
    unknown = np.stack([x[3 * n :], np.full(entry.more, np.nan) if P is None else np.sqrt(np.diag(P))])
    slipping = np.ones(len(m.first))
    slipping[here] = was
    return _Solved(
        net, nodes, rows, names, which, first, ~bodies.turns[of] & (len(heads) > 1 or sights is not None),
        pose, np.delete(unknown, entry.pairs, axis=1), noise, slipping, solution, laid,
        cost=solution.cost - float(np.square(noise.residual / sd).sum()) + unlikely(noise, r, which)
        + 6.0 * float(np.log(was).sum()),
    )  # fmt: skip


def _among(
    net: RangeNetwork, nodes: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " k"], Ranges, Int[np.ndarray, "p 2"], Int[np.ndarray, " k"]]:
    """Of `nodes`: where each node of the network stands, or -1; rows of the ranges between them, and these; pairs, and
    which each range is of.
    """
    place = np.full(len(net.owner), -1)
    place[nodes] = np.arange(len(nodes))
    rows = np.flatnonzero((place[net.ranges.a] >= 0) & (place[net.ranges.b] >= 0))
    r, (names, of_all) = net.ranges.select(rows), net.pairs()
    there, which = np.unique(of_all[rows], return_inverse=True)
    return place, rows, replace(r, a=place[r.a], b=place[r.b]), names[there], which


@dataclass(frozen=True, slots=True)
class _Entries:
    """Where in x what is found beside n poses stands: biases of pairs and what they have in common, the same of how
    they grow, everybody's clock.
    """

    n: int
    pairs: int
    everybody: int

    @property
    def biases(self) -> Int[np.ndarray, " p"]:
        return 3 * self.n + np.arange(self.pairs)

    @property
    def common(self) -> int:
        return 3 * self.n + self.pairs

    @property
    def growths(self) -> Int[np.ndarray, " p"]:
        return self.common + 1 + np.arange(self.pairs)

    @property
    def lags(self) -> Int[np.ndarray, " e"]:
        return np.asarray(self.common + 2 + self.pairs + np.arange(self.everybody))

    @property
    def drifts(self) -> Int[np.ndarray, " e"]:
        return np.asarray(self.lags + self.everybody)

    @property
    def more(self) -> int:
        return 2 + 2 * self.pairs + 2 * self.everybody

    def of_ranges(
        self, which: Int[np.ndarray, " k"], a: Int[np.ndarray, " k"], b: Int[np.ndarray, " k"]
    ) -> RadioColumns:
        """which: the pair of each range; a, b: whose its ends are."""
        lags, drifts = self.lags, self.drifts
        return RadioColumns(self.biases[which], self.growths[which], lags[a], drifts[a], lags[b], drifts[b])

    def clocks(self, sd: Float[np.ndarray, " e"]) -> Factor:
        """That everybody's clock is apart by about `sd` [s], amid the log as from end to end."""
        at = np.append(self.lags, self.drifts)
        unit, white = np.ones((len(at), 1, 1)), np.tile(1.0 / sd, 2)[:, None]
        return Factor(at[:, None], lambda x: x[at][:, None], lambda _: unit, 1, white, None, "clocks")

    def apart(self, x: Float[np.ndarray, " m"], P: Float[np.ndarray, "q q"] | None) -> Float[np.ndarray, " e"]:
        """[s] by which everybody's clock is apart, about, as `x` has it, `LAG` at least; P: covariance but of poses.

        An empirical prior: one of `LAG` for all would hold clocks that ranges tell little of, and be sure of it.
        """
        if P is None:
            return np.full(self.everybody, LAG)
        square = np.square(x[3 * self.n :]) + np.diag(P)
        lags, drifts = square[self.lags - 3 * self.n], square[self.drifts - 3 * self.n]
        return np.asarray(np.sqrt(np.maximum(LAG**2, 0.5 * (lags + drifts))))

    def beforehand(self) -> list[Factor]:
        """What is known of all that before any range."""
        told = ((self.common, BIAS_SD, "common bias"), (self.common + 1 + self.pairs, GROWTH, "common growth"))
        alike = common_factor(self.growths, self.common + 1 + self.pairs, GROWS_APART)
        return [alike, *(number_factor(np.array([at]), np.zeros(1), sd, name) for at, sd, name in told)]


def _fixed(
    entry: _Entries, r: Ranges, owner: Int[np.ndarray, " n"], beacon: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " m"]:
    """Entries that are not found: headings of beacons, and clocks of all that never moved while they ranged."""
    fixed = np.zeros(3 * entry.n + entry.more, bool)
    fixed[3 * np.flatnonzero(beacon) + 2] = True
    moving = [owner[end[rate.any(axis=1)]] for end, rate in ((r.a, r.rate_a), (r.b, r.rate_b))]
    still = np.setdiff1d(np.arange(entry.everybody), np.concatenate(moving))
    fixed[entry.lags[still]] = fixed[entry.drifts[still]] = True
    return fixed


def _priors(net: RangeNetwork, place: Int[np.ndarray, " m"]) -> list[Factor]:
    """What is known beforehand of nodes that have a `place`."""
    p = net.priors
    held = place[p.node] >= 0
    return [prior_factor(Priors(place[p.node[held]], p.z[held], p.cov[held]))] if held.any() else []


def _known(
    net: RangeNetwork, found: RangeEstimate | None, names: Int[np.ndarray, "p 2"], rows: Int[np.ndarray, " k"]
) -> tuple[RadioNoise, Float[np.ndarray, " p"]]:
    """The noise of the ranges `rows`, of the pairs `names`, as they were found, if so, and the pairs' biases [m]."""
    pairs, k = len(names), len(rows)
    if found is None:
        first = np.full(k, FIRST_SD)
        noise = RadioNoise(np.zeros(k), np.zeros(k, bool), np.full(pairs, FIRST_SD), np.ones(pairs), first)
        return noise, np.zeros(pairs)
    radios = {(radio.a, radio.b): radio for radio in found.radios}
    told = [radios.get((net.everybody[a], net.everybody[b])) for a, b in names.tolist()]
    each = [(0.0, FIRST_SD, 1.0) if radio is None else (radio.bias, radio.sd, radio.lasting) for radio in told]
    bias, sd, long = np.array(each).reshape(-1, 3).T
    which = np.unique(net.pairs()[1][rows], return_inverse=True)[1]
    return RadioNoise(found.residual[rows], found.far[rows], sd, long, sd[which]), bias


def _known_slips(net: RangeNetwork, found: RangeEstimate | None) -> Float[np.ndarray, " m"]:
    """By how many times motions err as they are taken to, as was found."""
    out, m = np.ones(len(net.motions.first)), net.motions
    for slip in () if found is None else found.slips:
        t = net.t[m.first]
        mine = (net.owner[m.first] == net.robots.index(slip.robot)) & (t >= slip.first) & (t < slip.last)
        out[mine] = slip.times
    return out


def _order(fixed: Bool[np.ndarray, " m"], beacon: Bool[np.ndarray, " n"]) -> Callable[[Pattern], Pattern]:
    """Trajectories eliminated first, beacons, biases and clocks last: they touch most of all."""
    n = len(beacon)
    rest = len(fixed) - 3 * n
    group = np.concatenate([np.repeat(np.arange(n), 3), n + np.arange(rest)])[~fixed]
    last = np.concatenate([np.repeat(beacon, 3), np.ones(rest, bool)])[~fixed]
    return lambda pattern: pattern.least_fill(group, last)
