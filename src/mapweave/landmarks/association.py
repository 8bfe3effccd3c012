"""Which observation belongs to which landmark: nearest neighbour, joint compatibility (JCBB), and certainty.

How probable it is that two landmarks are one is summed over all joint hypotheses of which are and which are not.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from ..core.gaussian import chi2_quantile
from ..core.se2 import wrap_angle

WIDTH = 100  # hypotheses kept after each landmark
HOPELESS = 25.0  # log probability below the best at which a hypothesis is let go
JITTER = 1e-12  # [m^2]


class _Hypothesis(NamedTuple):
    weight: float
    taken: frozenset[int]
    chosen: tuple[int, ...]
    e: np.ndarray
    S: np.ndarray


def pairing_probabilities(
    pairs: Int[np.ndarray, "c 2"],
    e: Float[np.ndarray, "c 2"],
    S: Float[np.ndarray, "2*c 2*c"],
    density: float | Float[np.ndarray, " c"],
) -> Float[np.ndarray, " c"]:
    """The probability (c,) of each pair to be one landmark, when a landmark is in at most one pair.

    pairs: labels of the two, all from one numbering; e, S: differences within the pairs and their joint covariance;
    density: how many landmarks there are in a unit of the space of e, at each pair if it differs. A hypothesis weighs
    `N(e; 0, S)` of its pairs, over `density` for each: what it would take to find another landmark just there. Pairs
    that support each other weigh more together.
    """
    if not len(pairs):
        return np.zeros(0)
    alone = np.log(np.broadcast_to(density, len(pairs)))
    spread = [np.linalg.det(S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]) for k in range(len(pairs))]
    order: dict[int, list[int]] = {}
    for k in np.argsort(spread, kind="stable"):
        order.setdefault(int(pairs[k, 0]), []).append(int(k))
    hypotheses = [_Hypothesis(0.0, frozenset(), (), np.asarray(e, float).ravel(), np.asarray(S, float))]
    for item, options in order.items():
        grown = list(hypotheses)
        for h in hypotheses:
            if item in h.taken:
                continue
            grown += [_joined(h, k, pairs[k], alone[k]) for k in options if int(pairs[k, 1]) not in h.taken]
        best = max(h.weight for h in grown)
        grown = [h for h in grown if h.weight > best - HOPELESS]
        hypotheses = sorted(grown, key=lambda h: -h.weight)[:WIDTH]
    weights = np.exp([h.weight - hypotheses[0].weight for h in hypotheses])
    weights /= weights.sum()
    out = np.zeros(len(pairs))
    for h, w in zip(hypotheses, weights, strict=True):
        out[list(h.chosen)] += w
    return out


def _joined(h: _Hypothesis, k: int, pair: np.ndarray, alone: float) -> _Hypothesis:
    """`h` with pair k one landmark: the others' differences are what they are then."""
    rows = slice(2 * k, 2 * k + 2)
    C = h.S[rows, rows] + JITTER * np.eye(2)
    gain = np.linalg.solve(C, h.S[rows])
    d = h.e[rows]
    log = (
        -0.5 * float(d @ np.linalg.solve(C, d)) - 0.5 * float(np.log(max(np.linalg.det(C), 1e-300))) - np.log(2 * np.pi)
    )
    return _Hypothesis(
        h.weight + log - alone,
        h.taken | {int(pair[0]), int(pair[1])},
        (*h.chosen, k),
        h.e - gain.T @ d,
        h.S - h.S[:, rows] @ gain,
    )


class Assignment(NamedTuple):
    """For each observation: the landmark it matched or None, and whether it starts a new landmark.

    None and not new means dropped: too far to match, too near to be new.
    """

    landmark: tuple[int | None, ...]
    new: tuple[bool, ...]


def individual_costs(
    z: Float[np.ndarray, "m d"],
    zhat: Float[np.ndarray, "n d"],
    S: Float[np.ndarray, "k k"],
    R: Float[np.ndarray, "d d"],
    wrap_columns: tuple[int, ...] = (),
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, " n"], Float[np.ndarray, "m n d"]]:
    """Squared Mahalanobis distance of every pair, `ln|S_j|` of every landmark, and the innovations."""
    m, d = z.shape
    n = len(zhat)
    e = z[:, None, :] - zhat[None, :, :]
    for column in wrap_columns:
        e[..., column] = wrap_angle(e[..., column])
    if n == 0:
        return np.zeros((m, 0)), np.zeros(0), e
    blocks = S.reshape(n, d, n, d)[np.arange(n), :, np.arange(n), :] + R
    D2 = np.einsum("mnd,ndk,mnk->mn", e, np.linalg.inv(blocks), e)
    return D2, np.linalg.slogdet(blocks)[1], e


def nearest_neighbour(
    z: Float[np.ndarray, "m d"],
    zhat: Float[np.ndarray, "n d"],
    S: Float[np.ndarray, "k k"],
    R: Float[np.ndarray, "d d"],
    gate: float,
    new_gate: float,
    wrap_columns: tuple[int, ...] = (),
) -> Assignment:
    """One-to-one matches of least total `D^2 + ln|S|` among pairs inside `gate`.

    z: (m, d) observed; zhat: (n, d) predicted; S: (n d, n d) joint covariance of zhat without noise; R: (d, d).
    """
    D2, logdet, _ = individual_costs(z, zhat, S, R, wrap_columns)
    matches: list[int | None] = [None] * len(z)
    if D2.size:
        allowed = gate > D2
        cost = np.where(allowed, D2 + logdet - (gate + logdet.max() + 1.0), 0.0)
        for k, j in zip(*linear_sum_assignment(cost), strict=True):
            if allowed[k, j]:
                matches[int(k)] = int(j)
    return Assignment(tuple(matches), _new(D2, matches, new_gate))


def jcbb(
    z: Float[np.ndarray, "m d"],
    zhat: Float[np.ndarray, "n d"],
    S: Float[np.ndarray, "k k"],
    R: Float[np.ndarray, "d d"],
    gate: float,
    new_gate: float,
    wrap_columns: tuple[int, ...] = (),
) -> Assignment:
    """The jointly compatible hypothesis with most pairings, then least joint distance (Neira and Tardos, 2001).

    Arguments as `nearest_neighbour`; the joint gate has the probability of `gate` at the hypothesis's own size.
    """
    D2, _, e = individual_costs(z, zhat, S, R, wrap_columns)
    m, d = z.shape
    probability = 1.0 - np.exp(-0.5 * gate) if d == 2 else 0.99
    limits = [chi2_quantile(float(probability), float(d * (k + 1))) for k in range(m)]
    candidates = [[int(j) for j in np.argsort(row, kind="stable") if row[j] < gate] for row in D2]
    search = _Search(S, R, e, candidates, limits)
    search.grow(0, [], 0.0)
    matches: list[int | None] = [None] * m
    for k, j in search.best:
        matches[k] = j
    return Assignment(tuple(matches), _new(D2, matches, new_gate))


@dataclass(slots=True)
class _Search:
    """Branch and bound over pairings (observation, landmark); `best` is the longest, then nearest, found."""

    S: np.ndarray
    R: np.ndarray
    e: np.ndarray
    candidates: list[list[int]]
    limits: list[float]
    best: list[tuple[int, int]] = field(default_factory=list)
    distance: float = np.inf
    budget: int = 20_000

    def joint(self, pairs: list[tuple[int, int]]) -> float:
        d = len(self.R)
        rows = np.concatenate([np.arange(d * j, d * j + d) for _, j in pairs])
        C = self.S[np.ix_(rows, rows)] + np.kron(np.eye(len(pairs)), self.R)
        v = np.concatenate([self.e[k, j] for k, j in pairs])
        return float(v @ np.linalg.solve(C, v))

    def grow(self, k: int, pairs: list[tuple[int, int]], distance: float) -> None:
        self.budget -= 1
        if k == len(self.candidates) or self.budget < 0:
            if (len(pairs), -distance) > (len(self.best), -self.distance):
                self.best, self.distance = pairs, distance
            return
        taken = {j for _, j in pairs}
        for j in self.candidates[k]:
            if j in taken:
                continue
            longer = [*pairs, (k, j)]
            D = self.joint(longer)
            if self.limits[len(pairs)] > D:
                self.grow(k + 1, longer, D)
        bound = len(pairs) + sum(1 for some in self.candidates[k + 1 :] if some)
        if (bound, -distance) > (len(self.best), -self.distance):
            self.grow(k + 1, pairs, distance)


def certain(
    assignment: Assignment,
    z: Float[np.ndarray, "m 2"],
    zhat: Float[np.ndarray, "n 2"],
    S: Float[np.ndarray, "k k"],
    R: Float[np.ndarray, "2 2"],
    gate: float,
    new_gate: float,
    wrap_columns: tuple[int, ...],
    density: Float[np.ndarray, " m"],
    sure: float,
) -> Assignment:
    """`found` without the matches of probability below `sure`: those observations are dropped.

    density (m,): landmarks in a unit of the space of z around each observation. A landmark gives one observation a
    time, so one whose own is sure keeps no other from being new.
    """
    if not len(zhat) or not len(z):
        return assignment
    D2, _, e = individual_costs(z, zhat, S, R, wrap_columns)
    k, j = np.nonzero(gate > D2)
    rows = (2 * j[:, None] + np.arange(2)).ravel()
    C = S[np.ix_(rows, rows)] + np.kron(k[:, None] == k[None], R)
    p = pairing_probabilities(np.stack([k, len(z) + j], axis=1), e[k, j], C, density[k])
    good = {(int(a), int(b)) for a, b, q in zip(k, j, p, strict=True) if q > sure}
    landmark = tuple(a if (i, a) in good else None for i, a in enumerate(assignment.landmark))
    D2[:, [a for a in landmark if a is not None]] = np.inf
    torn = [a is not None and b is None for a, b in zip(assignment.landmark, landmark, strict=True)]
    new = tuple(
        a is None and not t and bool(row.min() > new_gate) for a, t, row in zip(landmark, torn, D2, strict=True)
    )
    return Assignment(landmark, new)


def _new(D2: np.ndarray, matches: list[int | None], new_gate: float) -> tuple[bool, ...]:
    far = D2.min(axis=1) > new_gate if D2.shape[1] else np.ones(len(matches), dtype=bool)
    return tuple(a is None and bool(far[k]) for k, a in enumerate(matches))
