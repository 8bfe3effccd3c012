"""Other hypotheses about the same sightings: which of them are wrong, where robots then stand, how likely that is.

A small network has few sightings to spare, and a wrong one may be fitted by moving a robot. How much a sighting that is
wrong moves a place is its external reliability [Baarda68]; whether the others would show it is a question of evidence.
So each set of wrong sightings near the one found (one more, one less, one in place of another, and such steps again
from the most likely) is solved anew, from the places found and from the linear start. By Bayes' rule it counts by

    log evidence = -chi2 / 2 + log det P / 2 + sum over the wrong of log(density of a direction drawn at random * sigma)

with P the covariance without them, flat places within a wide extent, and every share of wrong sightings alike
(Jeffreys). The middle term is what speaks against robots that fell together: almost nowhere else would they fit. The
doubt of a robot is the probability, over all hypotheses, that it stands outside the gate of its own covariance.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import betaln, ndtr

from ..core.gaussian import chi2_quantile
from . import bearing, factors
from .config import (
    ALTERNATIVES_BEAM,
    ALTERNATIVES_EXTENT,
    ALTERNATIVES_GATE,
    ALTERNATIVES_MOST,
    ALTERNATIVES_MOST_TURNED,
    ALTERNATIVES_SWAPS,
    ALTERNATIVES_UNLIKELY,
)
from .network import BearingNetwork
from .result import SwarmEstimate

ALTERNATIVE_ROUNDS = 3  # of steps from the most likely sets to their neighbours

STEPS = 25  # of Levenberg-Marquardt for each hypothesis, at most
SAME = 1e-3  # of the extent: two minima of one set of sightings that are one
CHUNK = 256  # hypotheses solved together
NUMERIC = 1e-12  # added to a matrix whose diagonal is 1, so that rounding leaves it positive
GAINED = 1e-4  # of chi-square, below which a step is the last


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """h hypotheses of s entries. wrong: (h, m); evidence: (h,) log, up to a constant; cov: of the whole state."""

    wrong: Bool[np.ndarray, "h m"]
    x: Float[np.ndarray, "h s"]
    evidence: Float[np.ndarray, " h"]
    cov: Float[np.ndarray, "h s s"]

    def __len__(self) -> int:
        return len(self.evidence)

    def rows(self, keep: np.ndarray) -> "Hypotheses":
        return Hypotheses(self.wrong[keep], self.x[keep], self.evidence[keep], self.cov[keep])

    def joined(self, other: "Hypotheses") -> "Hypotheses":
        return Hypotheses(
            np.concatenate([self.wrong, other.wrong]),
            np.concatenate([self.x, other.x]),
            np.concatenate([self.evidence, other.evidence]),
            np.concatenate([self.cov, other.cov]),
        )


def doubts(net: BearingNetwork, inlier: Bool[np.ndarray, " m"], estimate: SwarmEstimate) -> Float[np.ndarray, " n"]:
    """(n,) probability that a robot stands outside the gate of its covariance; zero where that is not asked.

    It is asked of networks of up to `ALTERNATIVES_MOST` sightings, in space without axes `ALTERNATIVES_MOST_TURNED`,
    with a covariance and noise.
    """
    none = np.zeros(len(net))
    most = ALTERNATIVES_MOST if net.axis or net.dim == 2 else ALTERNATIVES_MOST_TURNED
    if estimate.cov is None or len(net.observer) > most or not np.any(net.sigma > 0):
        return none
    held = _held(net, estimate)
    free = estimate.localisable & ~held.is_anchor
    if len(held.anchors) < 1 or not free.any():
        return none
    try:
        none[free] = _asked(Dense.of(held, estimate), ~inlier, estimate, free)
    except np.linalg.LinAlgError:  # a covariance that is none: nothing may be believed of it
        none[free] = 1.0
    return none


def _asked(
    problem: "Dense",
    wrong: Bool[np.ndarray, " m"],
    estimate: SwarmEstimate,
    free: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " k"]:
    """(k,) the doubt of the robots `free`."""
    net = problem.net
    hypotheses = hypotheses_near(problem, wrong)
    w, d = factors.width(net), net.dim
    at = w * np.flatnonzero(free)[:, None] + np.arange(d)
    own = hypotheses.cov[0][at[:, :, None], at[:, None, :]] if estimate.gauge else np.asarray(estimate.cov)[free]
    weight = np.exp(hypotheses.evidence - hypotheses.evidence.max())
    outside = _outside(
        hypotheses.x[:, at] - problem.estimate[at],
        hypotheses.cov[:, at[:, :, None], at[:, None, :]],
        own,
        ALTERNATIVES_GATE,
    )
    return np.asarray((weight[:, None] * outside).sum(axis=0) / weight.sum())


def hypotheses_near(problem: "Dense", wrong: Bool[np.ndarray, " m"]) -> Hypotheses:
    """The hypotheses near the one that calls the sightings `wrong` so, which comes first."""
    tried = {wrong.tobytes()}
    hypotheses = problem.solved(wrong[None, :])
    expanded: set[bytes] = set()
    for _ in range(ALTERNATIVE_ROUNDS):
        order = np.argsort(-hypotheses.evidence, kind="stable")
        first = [k for k in [0, *order.tolist()] if hypotheses.wrong[k].tobytes() not in expanded]
        parents: list[np.ndarray] = []
        for k in first:
            key = hypotheses.wrong[k].tobytes()
            likely = hypotheses.evidence[k] > hypotheses.evidence.max() - ALTERNATIVES_UNLIKELY
            if key not in expanded and (likely or k == 0) and len(parents) < ALTERNATIVES_BEAM:
                expanded.add(key)
                parents.append(hypotheses.wrong[k])
        fresh = [c for p in parents for c in _neighbours(p, ALTERNATIVES_SWAPS)]
        unseen = []
        for c in fresh:
            key = c.tobytes()
            if key not in tried:
                tried.add(key)
                unseen.append(c)
        if not unseen:
            break
        for a in range(0, len(unseen), CHUNK):
            hypotheses = hypotheses.joined(problem.solved(np.array(unseen[a : a + CHUNK])))
        keep = hypotheses.evidence > hypotheses.evidence.max() - 2.0 * ALTERNATIVES_UNLIKELY
        keep[0] = True
        hypotheses = hypotheses.rows(keep)
    return hypotheses


def _neighbours(wrong: Bool[np.ndarray, " m"], swaps: int) -> list[np.ndarray]:
    """Sets of wrong sightings with one more, one less, and, of up to `swaps` wrong ones, one in place of another."""
    called, others = np.flatnonzero(wrong).tolist(), np.flatnonzero(~wrong).tolist()
    steps = [[k] for k in [*others, *called]]
    if len(called) <= swaps:
        steps += [[j, k] for j in called for k in others]
    return [_flipped(wrong, rows) for rows in steps]


def _flipped(wrong: Bool[np.ndarray, " m"], rows: list[int]) -> Bool[np.ndarray, " m"]:
    out = wrong.copy()
    out[rows] = ~out[rows]
    return out


def _held(net: BearingNetwork, estimate: SwarmEstimate) -> BearingNetwork:
    """The network with place and scale held: where they are free, by the two robots of the longest sighting."""
    if not estimate.gauge:
        return net
    both = np.flatnonzero(estimate.localisable[net.observer] & estimate.localisable[net.target])
    if not len(both):
        return replace(net, anchors={})
    p = estimate.position
    far = both[np.argmax(np.linalg.norm(p[net.target[both]] - p[net.observer[both]], axis=1))]
    pair = (int(net.observer[far]), int(net.target[far]))
    return replace(net, anchors={k: p[k] for k in {*pair, *net.anchors}})


@dataclass(frozen=True, slots=True)
class Dense:
    """A small network for dense algebra: many sets of sightings are solved side by side."""

    net: BearingNetwork
    estimate: Float[np.ndarray, " s"]
    free: Int[np.ndarray, " f"]
    extent: float  # [m] within which a robot is expected

    @classmethod
    def of(cls, net: BearingNetwork, estimate: SwarmEstimate) -> "Dense":
        w = factors.width(net)
        x = estimate.position if estimate.heading is None else np.column_stack([estimate.position, estimate.heading])
        fixed = np.zeros((len(net), w), dtype=bool)
        fixed[list(net.anchors), : net.dim] = True
        p = estimate.position
        span = float(np.median(np.linalg.norm(p[net.target] - p[net.observer], axis=1))) or 1.0
        return cls(net, x.ravel(), np.flatnonzero(~fixed.ravel()), ALTERNATIVES_EXTENT * span)

    def solved(self, wrong: Bool[np.ndarray, "h m"]) -> Hypotheses:
        """The minima without the sightings `wrong`, from the places found and from the linear start."""
        weight = (~wrong).astype(float)
        starts = [np.broadcast_to(self.estimate, (len(wrong), len(self.estimate)))]
        if self.net.axis:
            starts.append(self._linear(weight))
        out: Hypotheses | None = None
        for start in starts:
            x, chi2, H = self.descended(start, weight)
            minima = self._hypothesis(wrong, x, chi2, H)
            if out is None:
                out = minima
            else:
                other = np.abs(out.x - minima.x).max(axis=1) > SAME * self.extent
                out = out.joined(minima.rows(other))
        assert out is not None  # noqa: S101  (there is a start)
        return out

    def _hypothesis(self, wrong: np.ndarray, x: np.ndarray, chi2: np.ndarray, H: np.ndarray) -> Hypotheses:
        m, s = wrong.shape[1], x.shape[1]
        scale, flat = _scaled(H + np.diag(self._loose()), np.full(len(x), NUMERIC))
        logdet = np.linalg.slogdet(flat)[1] - 2.0 * np.log(scale).sum(axis=1)
        sigma = np.maximum(self.net.sigma, 1e-9)
        random = np.log(sigma / np.sqrt(2.0 * np.pi)) if self.net.dim == 2 else np.log(sigma**2 / 2.0)
        count = wrong.sum(axis=1)
        prior = betaln(count + 0.5, m - count + 0.5)
        cov = np.zeros((len(x), s, s))
        cov[:, self.free[:, None], self.free[None, :]] = scale[:, :, None] * np.linalg.inv(flat) * scale[:, None, :]
        return Hypotheses(wrong, x, -0.5 * chi2 - 0.5 * logdet + wrong @ random + prior, cov)

    def _loose(self) -> Float[np.ndarray, " f"]:
        """What is known of each free entry beforehand: a place within the extent, any heading."""
        w = factors.width(self.net)
        return np.where(self.free % w < self.net.dim, self.extent**-2, 3.0 / np.pi**2)

    def _linear(self, weight: Float[np.ndarray, "h m"]) -> Float[np.ndarray, "h s"]:
        """Places that lie best on the rays, squared distances across them; the places found where nothing tells."""
        d, net = self.net.dim, self.net
        u = net.direction
        across = np.stack([-u[:, 1], u[:, 0]], axis=1)[:, None] if d == 2 else bearing.tangent_basis(u).swapaxes(1, 2)
        both = np.concatenate([-across, across], axis=2) / float(net.sigma.min())
        rows = self._spread(both[None], factors.columns(net))[0]
        W = np.tile(weight, (1, d - 1))
        A = np.einsum("hr,rf,rg->hfg", W, rows[:, self.free], rows[:, self.free], optimize=True)
        b = -np.einsum("hr,rf,r->hf", W, rows[:, self.free], rows @ self.estimate, optimize=True)
        A += np.diag(np.full(len(self.free), 1e-6 * np.square(rows).max()))
        x = np.repeat(self.estimate[None, :], len(weight), axis=0)
        x[:, self.free] += np.linalg.solve(A, b[..., None])[..., 0]
        return x

    def _spread(self, J: Float[np.ndarray, "h m c k"], at: Int[np.ndarray, "m k"]) -> Float[np.ndarray, "h r s"]:
        """Rows over the whole state, those of one factor component after those of the other."""
        out = np.zeros((J.shape[0], J.shape[2], J.shape[1], len(self.estimate)))
        rows = np.arange(J.shape[1])
        for k in range(at.shape[1]):
            out[:, :, rows, at[:, k]] = J[..., k].swapaxes(1, 2)
        return out.reshape(len(out), -1, out.shape[-1])

    def _copies(self, h: int) -> BearingNetwork:
        """The network h times side by side."""
        net, n = self.net, len(self.net)
        shift = n * np.repeat(np.arange(h), len(net.observer))
        return replace(
            net,
            ids=tuple(map(str, range(n * h))),
            observer=np.tile(net.observer, h) + shift,
            target=np.tile(net.target, h) + shift,
            bearing=np.tile(net.bearing, (h, 1) if net.dim == 3 else h),
            sigma=np.tile(net.sigma, h),
            anchors={},
            distances=tuple(d._replace(i=d.i + n * k, j=d.j + n * k) for k in range(h) for d in net.distances),
        )

    def descended(
        self, start: Float[np.ndarray, "h s"], weight: Float[np.ndarray, "h m"], steps: int = STEPS
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where Levenberg-Marquardt ends: x (h, s), chi-square (h,), information (h, f, f)."""
        h = len(weight)
        copies = self._copies(h)
        terms = [(factors.bearing_factor(copies), factors.columns(self.net), weight)]
        if copies.distances:
            w, k = factors.width(self.net), np.arange(self.net.dim)
            ends = np.array([(d.i, d.j) for d in self.net.distances])
            at = np.concatenate([w * ends[:, :1] + k, w * ends[:, 1:] + k], axis=1)
            terms.append((factors.distance_factor(copies), at, np.ones((h, len(ends)))))

        def cost(x: np.ndarray) -> np.ndarray:
            parts = [np.sum(c * t.squares(x.ravel()).reshape(h, -1), axis=1) for t, _, c in terms]
            return np.asarray(np.sum(parts, axis=0))

        def normal(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            g, H = np.zeros((h, len(self.free))), np.zeros((h, len(self.free), len(self.free)))
            for t, at, c in terms:
                r = t.whitened(x.ravel()).reshape(h, len(at), t.rows)
                white = np.asarray(t.sqrt_info)[..., None] * t.jacobian(x.ravel())
                J = self._spread(white.reshape(h, len(at), t.rows, -1), at)[..., self.free]
                W = np.tile(c, (1, t.rows))[..., None] * J
                g += np.einsum("hrf,hr->hf", W, r.swapaxes(1, 2).reshape(h, -1))
                H += W.swapaxes(1, 2) @ J
            return g, H

        x, loose = start.copy(), self._loose()
        chi2, damping = cost(x), np.full(h, 1e-3)
        for _ in range(steps):
            g, H = normal(x)
            scale, damped = _scaled(H + np.diag(loose), damping)
            step = scale * np.linalg.solve(damped, (scale * g)[..., None])[..., 0]
            turn = np.zeros_like(x)
            turn[:, self.free] = -step
            there = factors.retract(copies, x.ravel(), turn.ravel()).reshape(x.shape)
            now = cost(there)
            better = now <= chi2
            gained = np.where(better, chi2 - now, 0.0)
            x[better], chi2 = there[better], np.minimum(now, chi2)
            damping = np.where(better, damping / 5.0, np.minimum(damping * 8.0, 1e9))
            if (better & (gained < GAINED)).all():
                break
        return x, chi2, normal(x)[1]


def _scaled(
    H: Float[np.ndarray, "h f f"], damping: Float[np.ndarray, " h"]
) -> tuple[Float[np.ndarray, "h f"], Float[np.ndarray, "h f f"]]:
    """Scales S of the variables and S H S, whose diagonal is 1, plus the damping."""
    scale = 1.0 / np.sqrt(np.einsum("hff->hf", H))
    out = scale[:, :, None] * H * scale[:, None, :]
    out[:, np.arange(out.shape[1]), np.arange(out.shape[1])] += np.maximum(damping, NUMERIC)[:, None]
    return scale, out


def _outside(
    away: Float[np.ndarray, "h n d"], cov: Float[np.ndarray, "h n d d"], own: Float[np.ndarray, "n d d"], gate: float
) -> Float[np.ndarray, "h n"]:
    """The probability that a place, of that mean offset and covariance, lies outside the gate of `own`.

    gate: probability to lie outside by chance. Counted along the one direction in which it lies furthest outside.
    """
    d = own.shape[-1]
    limit = np.sqrt(chi2_quantile(1.0 - gate, float(d)))
    L = np.linalg.cholesky(own + 1e-18 * np.eye(d))
    mean = np.linalg.solve(L, away[..., None])[..., 0]
    M = np.linalg.solve(L, np.linalg.solve(L, cov).swapaxes(-1, -2))
    spread = 0.5 * (M + M.swapaxes(-1, -2))
    _, axes = np.linalg.eigh(spread + mean[..., :, None] * mean[..., None, :])
    top = axes[..., -1]
    at = np.einsum("hnd,hnd->hn", top, mean)
    sd = np.sqrt(np.maximum(np.einsum("hnd,hnde,hne->hn", top, spread, top), 1e-300))
    return np.asarray(ndtr((np.abs(at) - limit) / sd) + ndtr((-limit - np.abs(at)) / sd))
