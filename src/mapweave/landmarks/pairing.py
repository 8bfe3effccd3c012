"""How probable it is that two landmarks are one, over all joint hypotheses of which are and which are not."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

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
