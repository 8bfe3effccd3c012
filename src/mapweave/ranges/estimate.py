"""Everybody's trajectory from ranges and odometry: laid out from no guess, then one robust problem.

Every pair of radios has a bias and a noise of its own, estimated from its residuals. Ranges past a wall or a person are
too long by metres: they fade by a redescending kernel, and are counted. Errors of ranges last (they follow how antennas
face each other), so that a range counts by as much less as they last longer than a range.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..solve import (
    Cauchy,
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
from .factors import columns_of, common_factor, geometry, motion_factor, number_factor, prior_factor, range_factor
from .network import Bodies, Motions, Priors, RangeNetwork, Ranges, bodies_of
from .start import LEAD, BodyLayout, lay_out

FIRST_SD = 0.15  # [m] noise of a range before residuals tell it
LEAST_SD = 0.01  # [m] noise of a range, whatever its residuals say: radios count in centimetres
SHRUNK = 0.02  # [m] sd of biases over all pairs, at least: a smaller one would hold them where they began
BIAS_SD = 0.3  # [m] of what the biases of all pairs have in common: antennas whose delay nobody trimmed
SPREAD = 0.15  # [m] of the biases beside what they have in common, before they tell it
FEW = 3  # pairs that tell it, at least
ANY_HEADING = 2.0  # [rad] sd of a heading that nothing tells
TO_SD = 1.4826  # times half the width of its densest half is the sd of a Gaussian
PRUNED = 3  # times that noise is told from those that are not far
FAR = 3.0  # [sd] from which a range is taken for one that went another way
WITHIN_FAR = 1.0136  # times what scatters within it is the sd of a Gaussian
WIDE = Cauchy(2.0)  # while the noise is still a guess
TIGHT = GemanMcClure(3.0)
# Noise and biases are estimated and all is solved again, with these kernels; at the end without those that are far.
ROUNDS: tuple[Kernel | None, ...] = (WIDE, TIGHT, TIGHT, None, None)
LEFT_OUT = 1e6  # times its sd: a range that is left out
MOST_TIED = 4  # layouts that are worked out whole, to see which explains the ranges best
LONGEST = 50  # ranges of a pair over which an error may last
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
    do; pose: (m, 3); cov: (m, 3, 3), without priors of the frame that fits all places best; beacon_cov: (2b, 2b), of
    its b beacons together; mirrored: other ways in which it may lie that explain the ranges as well; still: robots
    whose heading nothing tells.
    """

    nodes: Int[np.ndarray, " m"]
    first: int | None
    pose: Float[np.ndarray, "m 3"]
    cov: Float[np.ndarray, "m 3 3"]
    beacon_cov: Float[np.ndarray, "c c"]
    converged: bool
    mirrored: tuple[Float[np.ndarray, "m 3"], ...]
    still: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RangeEstimate:
    """parts: the largest first; residual: (k,) [m] of each range, bias off, NaN where an end is not placed; far: (k,)
    which went another way; loose: robots and beacons that ranges do not place, and why.
    """

    parts: tuple[PlacedPart, ...]
    radios: tuple[Radio, ...]
    residual: Float[np.ndarray, " k"]
    far: Bool[np.ndarray, " k"]
    loose: dict[str, str]


def estimate(net: RangeNetwork) -> RangeEstimate:
    """All trajectories and beacons of `net`, in as many parts as ranges leave."""
    bodies = bodies_of(net)
    residual, far = np.full(len(net.ranges), np.nan), np.zeros(len(net.ranges), bool)
    parts: list[PlacedPart] = []
    radios: list[Radio] = []
    loose: dict[int, str] = {}
    waiting = list(range(len(bodies.turns)))
    robots = set(np.unique(bodies.of[~net.is_beacon]).tolist())
    while robots & set(waiting):
        start = lay_out(net, bodies, waiting)
        solved = sorted((_solved(net, bodies, layout) for layout in start.layouts[:MOST_TIED]), key=lambda s: s.cost)
        best = solved[0]
        others = [s.pose for s in solved[1:] if s.cost < best.cost + LEAD and s.differs(best)]
        parts.append(best.part(tuple(others)))
        radios += best.radios()
        residual[best.rows], far[best.rows] = best.noise.residual, best.noise.far
        loose |= start.loose
        waiting = [body for body in waiting if body not in start.layouts[0].frames]
    parts.sort(key=lambda part: (-len(np.unique(net.owner[part.nodes])), int(part.nodes[0])))
    apart = {net.everybody[net.owner[k]] for part in parts[1:] for k in part.nodes.tolist()}
    told = {net.everybody[net.owner[np.argmax(bodies.of == body)]]: why for body, why in loose.items()}
    lost = {net.everybody[net.owner[np.argmax(bodies.of == body)]] for body in waiting}
    return RangeEstimate(
        tuple(parts), tuple(radios), residual, far,
        {name: told.get(name, "no ranges to anybody") for name in net.everybody if name in apart | lost},
    )  # fmt: skip


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

    first: the node that holds the frame; unturned: (n,) nodes whose heading nothing tells.
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

    @property
    def cost(self) -> float:
        return self.solution.cost

    def differs(self, other: "_Solved") -> bool:
        """Whether anybody lies elsewhere."""
        return bool(np.hypot(*(self.pose - other.pose)[:, :2].T).max() > 10 * FIRST_SD)

    def part(self, mirrored: tuple[np.ndarray, ...]) -> PlacedPart:
        n, beacon = len(self.nodes), self.net.is_beacon[self.nodes]
        at = (3 * np.flatnonzero(beacon)[:, None] + np.arange(2)).ravel()
        cov, joint = np.full((n, 3, 3), np.nan), np.full((len(at), len(at)), np.nan)
        if self.solution.information is not None:
            cov, joint = self.solution.blocks(columns_of(np.arange(n))), self.solution.covariance(at)
            if self.first is not None:
                cov, joint = self._about_all(self.solution.information, cov, at, joint)
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
        )

    def _about_all(
        self, information: Information, cov: np.ndarray, at: Int[np.ndarray, " c"], joint: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The covariances `cov` of all nodes and `joint` of the entries `at`, in the frame that fits all places best.

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
        return out, joint - mixed - mixed.T + row @ C @ row.T

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


def _solved(net: RangeNetwork, bodies: Bodies, layout: BodyLayout) -> _Solved:
    """The team worked out from `layout`, noise and biases of the radios with it."""
    nodes = np.flatnonzero(np.isin(bodies.of, list(layout.frames)))
    place = np.full(len(net.owner), -1)
    place[nodes] = np.arange(len(nodes))
    rows = np.flatnonzero((place[net.ranges.a] >= 0) & (place[net.ranges.b] >= 0))
    r, m, p = net.ranges.select(rows), net.motions, net.priors
    r = replace(r, a=place[r.a], b=place[r.b])
    here, held = place[m.first] >= 0, place[p.node] >= 0
    motions = Motions(place[m.first[here]], place[m.second[here]], m.z[here], m.cov[here])
    priors = Priors(place[p.node[held]], p.z[held], p.cov[held])
    names, of_all = net.pairs()
    there, which = np.unique(of_all[rows], return_inverse=True)
    n, pairs, beacon = len(nodes), len(there), net.is_beacon[nodes]
    biases, of = 3 * n + np.arange(pairs), bodies.of[nodes]
    frames = np.zeros((len(bodies.turns), 3))
    frames[list(layout.frames)] = np.array(list(layout.frames.values()))
    common = 3 * n + pairs  # what the biases have in common
    x = np.append(se2.compose(frames[of], bodies.pose[nodes]).ravel(), np.zeros(pairs + 1))
    fixed = np.zeros(len(x), bool)
    fixed[3 * np.flatnonzero(beacon) + 2] = True
    first = None if held.any() else int(np.argmin(beacon))
    if first is not None:
        fixed[3 * first : 3 * first + 3] = True
    terms = [*([motion_factor(motions)] if here.any() else []), *([prior_factor(priors)] if held.any() else [])]
    begins = np.array([k for k in np.unique(of, return_index=True)[1] if k != first and not beacon[k]], np.int64)
    if len(begins):  # the heading of one that stands is anything, and the problem stays regular
        terms.append(number_factor(3 * begins + 2, x[3 * begins + 2], ANY_HEADING, "headings"))
    angles = wrapping(3 * np.arange(n) + 2)
    stated = np.isfinite(r.sd)
    fixed[common] = stated.all()
    terms.append(number_factor(np.array([common]), np.zeros(1), BIAS_SD, "common bias"))
    spread, pattern = SHRUNK if stated.all() else SPREAD, None
    noise = _Noise(np.zeros(len(r)), np.zeros(len(r), bool), np.full(pairs, FIRST_SD), np.ones(pairs))
    for kernel in ROUNDS:
        sd = np.where(stated, r.sd, noise.sd[which]) * np.sqrt(noise.lasting[which])
        if kernel is None:
            sd[noise.far] *= LEFT_OUT
        ranges = range_factor(r, biases[which], sd, kernel)
        problem = Problem(x, [*terms, ranges, common_factor(biases, common, spread)], fixed, angles)
        pattern = pattern or _pattern(problem, beacon, pairs)
        solution = minimise(problem, SOLVE, pattern)
        x = solution.x
        pose, bias = x[: 3 * n].reshape(-1, 3), x[biases]
        P = solution.covariance(np.append(biases, common)) if solution.information is not None else None
        if P is not None and not stated.all() and pairs >= FEW:
            apart = np.diag(P)[:-1] + P[-1, -1] - 2 * P[:-1, -1]
            spread = max(SHRUNK, float(np.sqrt(np.mean(np.square(bias - x[common]) + apart))))
        noise = _Noise.of(r, which, pairs, r.z - geometry(r, pose)[0] - bias[which])
    bias_sd = np.full(pairs, np.nan) if P is None else np.sqrt(np.diag(P)[:-1])
    unturned = ~bodies.turns[of] & (len(layout.frames) > 1)
    return _Solved(
        net, nodes, rows, names[there], which, first, unturned, pose, bias, bias_sd, noise, solution
    )  # fmt: skip


def _pattern(problem: Problem, beacon: Bool[np.ndarray, " n"], pairs: int) -> Pattern:
    """Trajectories eliminated first, beacons and biases last: they touch most of all."""
    n = len(beacon)
    group = np.concatenate([np.repeat(np.arange(n), 3), n + np.arange(pairs + 1)])
    last = np.concatenate([np.repeat(beacon, 3), np.ones(pairs + 1, bool)])
    return Pattern.of(problem).least_fill(group[problem.free], last[problem.free])


def _densest_half(e: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Middle and half width of the shortest span that holds half of the errors: where most ranges went straight.

    Those that went round something are all too long, so that a median and what scatters about it are off.
    """
    e = np.sort(e)
    h = len(e) // 2 + 1
    width = e[h - 1 :] - e[: len(e) - h + 1]
    k = int(np.argmin(width))
    return float(0.5 * (e[k] + e[k + h - 1])), float(0.5 * width[k])


def lasting(e: Float[np.ndarray, " n"]) -> float:
    """For how many of n errors in order of time one lasts: one more than twice the sum of correlations, 1 or more."""
    if len(e) < 2 * LONGEST:
        return 1.0
    e = e - e.mean()
    power = float(e @ e)
    total = 1.0
    for lag in range(1, LONGEST):
        rho = float(e[lag:] @ e[:-lag]) / power
        if rho < 0.05:
            break
        total += 2.0 * rho
    return total
