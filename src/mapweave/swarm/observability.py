"""Who can be located at all: robots without null space in the sightings; what is free is held and named."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from ..core.attitude import Headings, about, headings, matrices
from ..core.errors import EstimateError
from ..core.gaussian import chi2_quantile
from ..solve import Factor, Pattern, Problem
from ..solve.elimination import Cholesky, Elimination, NotPositiveError
from . import bearing
from .bearing import TINY
from .factors import columns, width
from .network import BearingNetwork, Components

SHIFT = 1e-13  # added to the normal matrix, whose own entries are about 1
PIVOT = 3e-8  # a pivot below this is zero
PROBES = 4  # random vectors: that all four miss a way to move has no probability
MOVES = 1e-6  # a filtered probe above this says that the robot can move
FLAT = 1e-9  # spread of anchors across a line, of that along it, up to which they stand on it
CANDIDATES = 4  # pairs tried as stand-ins for anchors


@dataclass(frozen=True, slots=True)
class Observability:
    """localisable, oriented: (n,) whether place and heading are told, up to the gauge; in_line: robots.

    nullity: free directions with anchors and distances held.
    """

    localisable: Bool[np.ndarray, " n"]
    oriented: Bool[np.ndarray, " n"]
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
    everyone = np.ones(len(net), dtype=bool)
    gauge = gauge_of(net, parts, everyone)
    if not gauge.name:
        return _judge(net, parts, position, np.zeros(0, dtype=np.intp), seed, pattern)
    inside = np.flatnonzero(gauge.members[net.observer])
    degree = np.bincount(np.concatenate([net.observer, net.target]), minlength=len(net))
    strength = np.minimum(degree[net.observer], degree[net.target])[inside]
    tried = inside[np.argsort(-strength, kind="stable")]
    picks = tried[np.unique(np.linspace(0, 0.5 * (len(tried) - 1), CANDIDATES).astype(int))]
    w, motions = width(net), gauge_basis(net, gauge, position)[0]
    best: Observability | None = None
    for row in picks:
        i, j = int(net.observer[row]), int(net.target[row])
        entries = np.concatenate([w * i + np.arange(w), w * j + np.arange(net.dim)])
        judged = _judge(net, parts, position, _pins(motions, entries), seed)
        if best is None or judged.localisable.sum() > best.localisable.sum():
            best = judged
        if best.localisable[gauge.members].all():
            break
    assert best is not None  # noqa: S101  (a component with a gauge is sighted)
    return best


def _pins(motions: Float[np.ndarray, "s g"], entries: Int[np.ndarray, " e"]) -> Int[np.ndarray, " g"]:
    """As many of `entries` as there are motions: those that hold all of them best."""
    order = scipy.linalg.qr(motions[entries].T, mode="r", pivoting=True)[1]
    return np.asarray(entries[order[: motions.shape[1]]])


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
    return Observability(localisable, seen.oriented, nullity, in_line)


def _judge(
    net: BearingNetwork,
    parts: Components,
    position: np.ndarray,
    pins: Int[np.ndarray, " g"],
    seed: int,
    pattern: Pattern | None = None,
) -> Observability:
    n, dim, w = len(net), net.dim, width(net)
    u, r = bearing.predict(position[net.observer], position[net.target])
    size = float(np.median(r)) if len(r) else 1.0
    J = bearing.tangent_basis(u).swapaxes(1, 2) if dim == 3 else np.stack([-u[:, 1], u[:, 0]], axis=1)[:, None, :]
    rows = [-J, J] if net.axis else [-J, J, (r / size)[:, None, None] * bearing.turn_jacobian(u)]
    terms = [_rows(columns(net), np.concatenate(rows, axis=2))]
    if net.distances:
        i, j = np.array([d.i for d in net.distances]), np.array([d.j for d in net.distances])
        v, _ = bearing.predict(position[i], position[j])
        at = np.concatenate([w * i[:, None] + np.arange(dim), w * j[:, None] + np.arange(dim)], axis=1)
        terms.append(_rows(at, np.concatenate([-v, v], axis=1)[:, None, :]))
    fixed = np.zeros((n, w), dtype=bool)
    fixed[list(net.anchors), :dim] = True
    deaf = np.ones(n, dtype=bool)  # sees nobody: has no heading to be found
    deaf[net.observer] = False
    fixed[deaf, dim:] = True
    fixed.ravel()[pins] = True
    problem = Problem(np.zeros(n * w), terms, fixed.ravel())
    if not len(problem.free):
        return Observability(np.ones(n, dtype=bool), np.ones(n, dtype=bool), 0)
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
    still = moves.reshape(n, w) <= MOVES
    localisable, turned = (np.asarray(part.all(axis=1)) for part in (still[:, :dim], still[:, dim:]))
    if len(pins):
        localisable &= parts.label == parts.reference
    return Observability(localisable, turned, nullity + len(pins))


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


@dataclass(frozen=True, slots=True)
class Gauge:
    """The freedom left by the sightings. name: for people, "" for none; members: (n,) the component it is of.

    place, scale: whether each is free; turn: the axes about which the whole may turn, t = 1 in the plane, else 3.
    """

    name: str
    place: bool
    scale: bool
    turn: Float[np.ndarray, "t q"]
    members: Bool[np.ndarray, " n"]
    centre: Float[np.ndarray, " d"]  # an anchor when place is known, else the origin

    @property
    def free(self) -> str:
        """What is free, in a few words."""
        named = (("place", self.place), ("scale", self.scale), ("orientation", self.turn.size))
        return " and ".join(name for name, is_free in named if is_free)


def gauge_of(net: BearingNetwork, parts: Components, localisable: Bool[np.ndarray, " n"]) -> Gauge:
    """The gauge of the reference component, over the robots located up to it."""
    c = parts.reference
    members = (parts.label == c) & localisable if len(net) else np.zeros(0, dtype=bool)
    held = [p for k, p in net.anchors.items() if parts.label[k] == c]
    centre = held[0] if held else np.zeros(net.dim)
    turns = 0 if net.axis else net.dim * (net.dim - 1) // 2
    if not (members & ~net.is_anchor).any():
        return Gauge("", False, False, np.zeros((turns, 0)), members, centre)
    place, scale = not held, parts.known[c] < 2 and not parts.measured[c]
    turn = np.eye(turns)
    if parts.known[c] >= 2:
        _, spread, lines = np.linalg.svd(np.array(held) - centre, full_matrices=False)
        on_line = turns == 3 and spread[1] < FLAT * spread[0]
        turn = lines[:1].T if on_line else np.zeros((turns, 0))
    mean = "heading is set to 0" if net.dim == 2 else "attitude is set to none"
    orientation = "turn about the line of the anchors" if turn.shape == (3, 1) else "orientation"
    said = [
        text
        for free, text in (
            (place, "place free (the located robots' centroid is set to the origin)"),
            (scale, f"scale free (root mean square distance from the {'centroid' if place else 'anchor'} is set to 1)"),
            (turn.size, f"{orientation} free (the located robots' mean {mean})"),
        )
        if free
    ]
    return Gauge("; ".join(said), place, bool(scale), turn, members, centre)


def normalise(gauge: Gauge, position: np.ndarray, heading: Headings | None) -> tuple[np.ndarray, Headings | None]:
    """The same shape brought to the gauge's place, size and orientation; all components move together."""
    m = gauge.members
    if not gauge.name or not m.any():
        return position, heading
    centre = position[m].mean(axis=0) if gauge.place else gauge.centre
    p = position - centre
    if gauge.turn.size and heading is not None:
        R = matrices(heading)
        mean = about(R[m].sum(axis=0), gauge.turn)
        p, heading = p @ mean, headings(mean.T @ R)
    size = float(np.sqrt(np.square(p[m]).sum(axis=1).mean()))
    if gauge.scale and size > 0:
        p = p / size
    return p + gauge.centre, heading


def gauge_pins(net: BearingNetwork, gauge: Gauge, position: np.ndarray) -> np.ndarray:
    """State entries (n, w) to fix so that the members have no freedom left."""
    fixed = np.zeros((len(net), width(net)), dtype=bool)
    m = np.flatnonzero(gauge.members)
    if not gauge.name or not len(m):
        return fixed
    middle = position[m].mean(axis=0) if gauge.place else gauge.centre
    first = m[np.argmin(np.square(position[m] - position[m].mean(axis=0)).sum(axis=1))]
    far = m[np.argmax(np.square(position[m] - middle).sum(axis=1))]
    line = (position[far] - position[first]) / max(float(np.linalg.norm(position[far] - position[first])), TINY)
    away = position[m] - position[first]
    aside = m[np.argmax(np.square(away - np.outer(away @ line, line)).sum(axis=1))]
    entries = (width(net) * np.unique([first, far, aside])[:, None] + np.arange(net.dim)).ravel()
    fixed.ravel()[_pins(gauge_basis(net, gauge, position)[0], entries)] = True
    return fixed


def gauge_basis(net: BearingNetwork, gauge: Gauge, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motions G (n w, g) that no sighting sees and the conditions C (n w, g) with `C^T dx = 0` that the gauge sets."""
    n, w, dim = len(net), width(net), net.dim
    m = gauge.members
    p = (position - (position[m].mean(axis=0) if gauge.place else gauge.centre)) * m[:, None]
    G, C = [], []
    if gauge.place:
        for k in range(dim):
            g = np.zeros((n, w))
            g[m, k] = 1.0
            G.append(g)
            C.append(g)
    if gauge.scale:
        g = np.zeros((n, w))
        g[:, :dim] = p
        G.append(g)
        C.append(g)
    for axis in gauge.turn.T:
        g, c = np.zeros((n, w)), np.zeros((n, w))
        g[:, :dim] = axis * np.stack([-p[:, 1], p[:, 0]], axis=1) if dim == 2 else np.cross(axis, p)
        g[m, dim:] = c[m, dim:] = axis
        G.append(g)
        C.append(c)
    if not G:
        return np.zeros((n * w, 0)), np.zeros((n * w, 0))
    return np.stack([g.ravel() for g in G], axis=1), np.stack([c.ravel() for c in C], axis=1)
