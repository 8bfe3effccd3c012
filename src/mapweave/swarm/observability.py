"""Who can be located at all: the robots on which the null space of the sightings is zero.

The rows of H, multiplied by range, are weighed alike; with anchors held (and, where nothing gives place and scale, a
sighted pair standing in for them) their normal matrix is factorised once. Its vanishing pivots count the free
directions; random vectors filtered through it stay non-zero exactly on the robots that can still move.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..core.errors import EstimateError
from ..core.gaussian import chi2_quantile
from ..solve import Factor, Pattern, Problem
from ..solve.elimination import Elimination
from ..solve.multifrontal import Cholesky, NotPositiveError
from . import bearing
from .factors import columns, width
from .network import BearingNetwork, Components

SHIFT = 1e-13  # added to the normal matrix, whose own entries are about 1
PIVOT = 3e-8  # a pivot below this is zero
PROBES = 4  # random vectors: that all four miss a way to move has no probability
MOVES = 1e-6  # a filtered probe above this says that the robot can move
CANDIDATES = 4  # pairs tried as stand-ins for anchors


@dataclass(frozen=True, slots=True)
class Observability:
    """localisable: (n,) up to the gauge; nullity: free directions with anchors and distances held; in_line: robots."""

    localisable: Bool[np.ndarray, " n"]
    nullity: int
    in_line: int = 0


def observe(
    net: BearingNetwork,
    parts: Components,
    position: Float[np.ndarray, "n d"],
    pattern: Pattern | None = None,
    seed: int = 0,
) -> Observability:
    """Judged at `position`; robots in components other than those with place and scale are not localisable.

    pattern: of the sightings with the anchors held, where it is known already.
    """
    if parts.anchored or not len(net.observer):
        return _judge(net, parts, position, (), seed, pattern)
    inside = np.flatnonzero(parts.label[net.observer] == parts.reference)
    degree = np.bincount(np.concatenate([net.observer, net.target]), minlength=len(net))
    strength = np.minimum(degree[net.observer], degree[net.target])[inside]
    tried = inside[np.argsort(-strength, kind="stable")]
    picks = tried[np.unique(np.linspace(0, 0.5 * (len(tried) - 1), CANDIDATES).astype(int))]
    best: Observability | None = None
    for row in picks:
        judged = _judge(net, parts, position, (int(net.observer[row]), int(net.target[row])), seed)
        if best is None or judged.localisable.sum() > best.localisable.sum():
            best = judged
        if best.localisable[parts.label == parts.reference].all():
            break
    assert best is not None  # noqa: S101  (a component without anchors that is sighted has a sighting)
    return best


def without_lines(
    net: BearingNetwork, parts: Components, seen: Observability, direction: Float[np.ndarray, "m d"]
) -> Observability:
    """`seen`, less the components whose sightings are all parallel but for noise: along such a line nothing is known.

    Noise alone would make the rows of H at an estimate look independent, so this is judged by a chi-square.
    """
    localisable, nullity, in_line = seen.localisable.copy(), seen.nullity, 0
    sigma = net.sigma if np.any(net.sigma > 0) else np.full(len(net.sigma), 1e-9)
    for c in np.unique(parts.label[net.observer]):
        rows = parts.label[net.observer] == c
        b = direction[rows]
        _, _, axes = np.linalg.svd(b.T @ b)
        sine = np.linalg.norm(b - np.outer(b @ axes[0], axes[0]), axis=1)
        dof = (net.dim - 1) * (len(b) - 1)
        chi2 = float(np.square(np.arcsin(np.minimum(sine, 1.0)) / sigma[rows]).sum())
        mine = (parts.label == c) & ~net.is_anchor
        if len(b) > 1 and mine.sum() > 1 and chi2 <= chi2_quantile(0.999, float(dof)):
            localisable[mine] = False
            nullity = max(nullity, int(mine.sum()))
            in_line += int((parts.label == c).sum())
    return Observability(localisable, nullity, in_line)


def gauge_size(net: BearingNetwork, parts: Components) -> int:
    """Free directions of the reference component beyond what sightings can tell: place, scale, orientation."""
    c = parts.reference
    if not parts.label.size or parts.known[c] >= 2:
        return 0
    scale = 0 if parts.measured[c] else 1
    turn = 0 if net.axis else 1
    return scale + turn + (net.dim if parts.known[c] == 0 else 0)


def _judge(
    net: BearingNetwork,
    parts: Components,
    position: np.ndarray,
    pair: tuple[int, ...],
    seed: int,
    pattern: Pattern | None = None,
) -> Observability:
    n, dim, w = len(net), net.dim, width(net)
    u, r = bearing.predict(position[net.observer], position[net.target])
    size = float(np.median(r)) if len(r) else 1.0
    J = bearing.tangent_basis(u).swapaxes(1, 2) if dim == 3 else np.stack([-u[:, 1], u[:, 0]], axis=1)[:, None, :]
    rows = [-J, J] if net.axis else [-J, J, np.broadcast_to(-(r / size)[:, None, None], (len(r), 1, 1))]
    terms = [_rows(columns(net), np.concatenate(rows, axis=2))]
    if net.distances:
        i, j = np.array([d.i for d in net.distances]), np.array([d.j for d in net.distances])
        v, _ = bearing.predict(position[i], position[j])
        at = np.concatenate([w * i[:, None] + np.arange(dim), w * j[:, None] + np.arange(dim)], axis=1)
        terms.append(_rows(at, np.concatenate([-v, v], axis=1)[:, None, :]))
    fixed = np.zeros((n, w), dtype=bool)
    fixed[list(net.anchors), :dim] = True
    if pair:
        fixed[list(net.anchors), :dim] = False
        fixed[list(pair), :dim] = True
    if net.distances and pair:  # a pair as stand-in already gives the scale: distances would only repeat it
        terms = terms[:1]
    deaf = np.ones(n, dtype=bool)  # sees nobody: has no heading to be found
    deaf[net.observer] = False
    if not net.axis:
        fixed[deaf, dim] = True
    problem = Problem(np.zeros(n * w), terms, fixed.ravel())
    if not len(problem.free):
        return Observability(np.ones(n, dtype=bool), 0)
    pattern = pattern or Pattern.of(problem).dissected(problem.free // w)
    normal = [term.normal(problem.x0) for term in terms]
    N, _ = pattern.assemble([a for a, _ in normal], [b for _, b in normal])
    factor, shift = _factored(pattern, N.data)
    nullity = int(np.count_nonzero(factor.pivots() < PIVOT * shift / SHIFT))
    x = np.random.default_rng(seed).normal(size=(len(problem.free), PROBES))
    for _ in range(3):
        x = shift * factor.solve(x)
    moves = np.zeros(n * w)
    moves[problem.free] = np.abs(x).max(axis=1)
    free_to_move = moves.reshape(n, w).max(axis=1) > MOVES
    localisable = ~free_to_move
    if pair:
        localisable &= parts.label == parts.reference
        nullity += gauge_size(net, parts)
    return Observability(localisable, nullity)


def _factored(pattern: Pattern, values: np.ndarray) -> tuple[Cholesky, float]:
    """The normal matrix factorised with the smallest shift that keeps it positive, and that shift."""
    held = pattern.elimination
    elimination = held if isinstance(held, Elimination) else Elimination.of(pattern.matrix(values))
    for shift in SHIFT * 100.0 ** np.arange(8):
        data = values.copy()
        data[pattern.diagonal] += shift
        try:
            return Cholesky.of(pattern.matrix(data), elimination), float(shift)
        except NotPositiveError:
            continue
    raise EstimateError("the start has positions that are not finite: nothing can be judged there")


def _rows(at: np.ndarray, J: np.ndarray) -> Factor:
    zero = np.zeros(J.shape[:2])
    return Factor(at, lambda _: zero, lambda _: J, J.shape[1])
