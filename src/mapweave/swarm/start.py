"""What is known before any refinement: a start without a guess, and what these sightings can tell at all.

Positions come from directions alone. With B the projection across a sighting b, `sum |B (p_j - p_i)|^2` is quadratic
in the positions (the bearing Laplacian of Zhao and Zelazo, Automatica 69, 2016). Noise turns b a little, which adds
`tau sum |p_j - p_i|^2` on average and so shrinks the answer; a pull of equal strength towards the usual distance r
along each ray, `mu sum |p_j - p_i - r b|^2`, undoes that, and decides what the sightings leave open: a robot sighted
once stands at the usual distance along its ray.

Robots that share no axis get headings first, in space attitudes, then positions as if there were one.

Of robots that share no axes and are seldom sighted in space, one that nobody sees stands where it sees three others as
they stand, which leaves up to four places and attitudes. From each the whole swarm is refined anew; those whose
chi-square is hardly larger are answers, too.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components, dijkstra

from ..core import se2
from ..core.attitude import Headings, angles, headings, matrices, nearest
from ..core.errors import DataError
from ..solve import Factor, Information, Pattern, Problem
from .alternatives import Dense
from .bearing import predict
from .config import SWARM_SELDOM
from .network import BearingNetwork, Components, components
from .observability import Gauge, Observability, gauge_of, normalise, observe, without_lines
from .result import OtherAnswer, SwarmEstimate

Refined = Callable[[Float[np.ndarray, "n 3"], Headings], OtherAnswer]
STARTS = 32  # places from which one robot is resected
SPREAD = 1.5  # standard deviation of those, of the deviation of what it sees
RESECTING = 80  # steps of Levenberg-Marquardt from each
ONE_PLACE = 1e-3  # of that deviation, or of a usual sighting, below which two places are one
UNLIKELY = 9.2  # chi-square above the best one's from which on an answer is none: a likelihood a hundred times less
LEAST_SEEN = 3  # others that a robot sees if it is to be resected where nobody sees it
LEAST_MADE = 2  # sightings of its own that turn it


def poses(
    net: BearingNetwork, k: int, position: Float[np.ndarray, "n 3"], heading: Headings, rows: Int[np.ndarray, " r"]
) -> tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"], Float[np.ndarray, " c"]]:
    """Places of robot k, how it is turned there, and chi-squares: where its sightings `rows` fit best, and as well.

    All others stand, turned, as given. The best comes first; with exactly three sightings there are up to four.
    """
    i, j = net.observer[rows], net.target[rows]
    robots, where = np.unique(np.concatenate([[k], i, j]), return_inverse=True)
    at = int(where[0])
    i, j = np.split(where[1:], 2)
    others = {int(a): position[b] for a, b in enumerate(robots.tolist()) if b != k}
    near = replace(
        net.select(rows), ids=tuple(map(str, robots.tolist())), observer=i, target=j, anchors=others, distances=()
    )
    q = np.array(list(others.values()))
    middle, spread = q.mean(axis=0), max(float(q.std(axis=0).max()), 1e-9)
    start = np.repeat(np.column_stack([position[robots], heading[robots]])[None], STARTS, axis=0)
    start[:, at, :3] = middle + SPREAD * spread * np.random.default_rng(0).normal(size=(STARTS, 3))
    own = i == at
    u = position[robots[j[own]]] - start[:, at, None, :3]
    u /= np.maximum(np.linalg.norm(u, axis=2, keepdims=True), 1e-12)
    start[:, at, 3:] = headings(nearest(np.einsum("srk,rl->skl", u, near.direction[own])))
    free = 6 * at + np.arange(6)
    dense = Dense(near, start[0].ravel(), free, 1e3 * spread)
    x, chi2, _ = dense.descended(start.reshape(STARTS, -1), np.ones((STARTS, len(rows))), RESECTING)
    x = x.reshape(STARTS, -1, 6)[:, at]
    kept: list[int] = []
    for s in np.argsort(chi2, kind="stable").tolist():
        apart = [np.linalg.norm(x[s, :3] - x[c, :3]) > ONE_PLACE * spread for c in kept]
        if chi2[s] <= chi2.min() + UNLIKELY and all(apart):
            kept.append(s)
    return x[kept, :3], x[kept, 3:], chi2[kept]


def resected(
    net: BearingNetwork,
    position: Float[np.ndarray, "n 3"],
    placed: Bool[np.ndarray, " n"],
    heading: Headings,
    known: Bool[np.ndarray, " n"],
) -> tuple[Headings, Bool[np.ndarray, " n"]]:
    """Headings also of robots that are not `placed` and see three of those that are, of the `poses` that fit best."""
    rows = np.flatnonzero(placed[net.target] & ~placed[net.observer] & ~known[net.observer])
    pairs = np.unique(net.observer[rows] * len(net) + net.target[rows])
    fresh = np.bincount(pairs // len(net), minlength=len(net)) >= LEAST_SEEN
    out = np.array(heading)
    for k in np.flatnonzero(fresh).tolist():
        out[k] = poses(net, k, position, heading, rows[net.observer[rows] == k])[1][0]
    return out, known | fresh


def other_answers(net: BearingNetwork, estimate: SwarmEstimate, refined: Refined) -> tuple[OtherAnswer, ...]:
    """The answers that fit about as well as `estimate`, the best first: one robot that is seldom sighted elsewhere.

    refined: positions, headings and chi-square of the minimum near others. None where an axis is common.
    """
    if net.axis or net.dim == 2 or estimate.heading is None or not np.any(net.sigma > 0):
        return ()
    p, inside = estimate.position, estimate.localisable
    told = inside[net.observer] & inside[net.target]
    degree = np.bincount(np.concatenate([net.observer[told], net.target[told]]), minlength=len(net))
    firm = estimate.anchor | (degree > SWARM_SELDOM)  # others may move with the robot that is asked
    span = float(np.median(np.linalg.norm(p[net.target] - p[net.observer], axis=1)))
    found: list[OtherAnswer] = []
    for k in np.flatnonzero(inside & ~estimate.anchor).tolist():
        rows = np.flatnonzero(
            told & (((net.observer == k) & firm[net.target]) | ((net.target == k) & firm[net.observer]))
        )
        own = np.count_nonzero(net.observer[rows] == k)
        if not LEAST_SEEN <= len(rows) <= SWARM_SELDOM or own < LEAST_MADE:
            continue
        for place, turn in zip(*poses(net, k, p, estimate.heading, rows)[:2], strict=True):
            if np.linalg.norm(place - p[k]) <= ONE_PLACE * span:
                continue
            there, turned = p.copy(), np.array(estimate.heading)
            there[k], turned[k] = place, turn
            other = refined(there, turned)
            known = [p, *(one.position for one in found)]
            apart = min(float(np.linalg.norm(other.position - q, axis=1).max()) for q in known)
            if other.chi2 <= estimate.chi2 + UNLIKELY and apart > ONE_PLACE * span:
                found.append(other)
    return tuple(sorted(found, key=lambda one: one.chi2))


TRACE = 1e-7  # least weight of the usual distance against a sighting's own
ROUNDS = 20  # of spreading headings from robots that see each other to those that only see


def bias(net: BearingNetwork) -> Float[np.ndarray, " m"]:
    """tau: how much of `|p_j - p_i|^2` the noise of each sighting adds to the linear cost, on average."""
    v = net.sigma**2
    return np.asarray(2 * v / (1 + 4 * v) if net.dim == 3 else 0.5 * (1 - np.exp(-2 * v)))


def linear_start(
    net: BearingNetwork,
    parts: Components,
    direction: Float[np.ndarray, "m d"],
    pattern: Pattern,
    held: Bool[np.ndarray, " n"],
    weights: Float[np.ndarray, " m"] | None = None,
) -> Float[np.ndarray, "n d"]:
    """Positions [m] (units of the usual distance in components whose scale is free).

    direction: sightings in the common axes; pattern: of the sightings' blocks over both ends, positions of `held`
    robots fixed: the anchors and one robot of every component without any, which stands at the origin. weights: (m,).
    """
    n, dim = len(net), net.dim
    w = np.ones(len(direction)) if weights is None else weights
    origin = np.zeros((n, dim))
    for k, p in net.anchors.items():
        origin[k] = p
    tau = bias(net)
    mu = np.maximum(tau, TRACE)
    W = w[:, None, None] * ((1.0 + mu)[:, None, None] * np.eye(dim) - direction[:, :, None] * direction[:, None, :])
    blocks = np.concatenate([np.concatenate([W, -W], axis=2), np.concatenate([-W, W], axis=2)], axis=1)
    base = np.concatenate([origin[net.observer], origin[net.target]], axis=1)
    along = (w * (mu + tau))[:, None] * direction
    H, g_known = pattern.assemble([blocks], [np.einsum("mab,mb->ma", blocks, base)])
    _, g_along = pattern.assemble([blocks], [np.concatenate([along, -along], axis=1)])
    solved = Information.of(H, pattern.elimination).solve(-np.stack([g_known, g_along], axis=1))
    moving = np.repeat(~held, dim)
    still, pulled = origin.ravel().copy(), np.zeros(n * dim)
    still[moving] += solved[:, 0]
    pulled[moving] = solved[:, 1]
    scaled = np.array([k >= 2 for k in parts.known])[parts.label]  # by robot: its component has a scale
    usual = np.where(scaled, _usual_distance(net, still.reshape(n, dim), pulled.reshape(n, dim), scaled), 1.0)
    x = still.reshape(n, dim) + usual[:, None] * pulled.reshape(n, dim)
    return _scaled(net, parts, x)


def linear_pattern(net: BearingNetwork, parts: Components) -> tuple[Pattern, Bool[np.ndarray, " n"]]:
    """The sparsity of the linear start, and the robots it holds: anchors, and one of each component without any."""
    n, dim = len(net), net.dim
    held = net.is_anchor
    label = parts.label
    if net.distances:  # one that only a distance joins to others is free as far as directions go
        label = components(replace(net, distances=())).label
    first = np.full(label.max(initial=-1) + 1, n)
    np.minimum.at(first, label, np.arange(n))
    has = np.zeros(len(first), dtype=bool)
    has[label[held]] = True
    held[first[~has]] = True
    k = np.arange(dim)
    at = np.concatenate([dim * net.observer[:, None] + k, dim * net.target[:, None] + k], axis=1)
    none = np.zeros((len(at), 1))
    shape = Factor(at, lambda _: none, lambda _: none[:, :, None], 1)
    problem = Problem(np.zeros(n * dim), [shape], np.repeat(held, dim))
    return Pattern.of(problem).dissected(problem.free // dim), held


def _usual_distance(net: BearingNetwork, still: np.ndarray, pulled: np.ndarray, chosen: np.ndarray) -> float:
    """The typical distance r: positions `still + r pulled` have r as their median sighting; found by iterating."""
    rows = chosen[net.observer]
    a = (still[net.target] - still[net.observer])[rows]
    b = (pulled[net.target] - pulled[net.observer])[rows]
    r = 0.0
    for _ in range(20 if len(a) else 0):
        length = np.linalg.norm(a + r * b, axis=1)
        r = float(np.median(length[length > 1e-3 * length.max()])) if length.any() else 1.0
    return r


def _scaled(net: BearingNetwork, parts: Components, x: np.ndarray) -> np.ndarray:
    """Pieces of free scale brought to their known distances, or to a median sighting of 1."""
    x = x.copy()
    r = np.linalg.norm(x[net.target] - x[net.observer], axis=1)
    for c in np.flatnonzero(parts.known < 2):
        mine = parts.label == c
        rows = mine[net.observer]
        typical = float(np.median(r[rows])) if rows.any() else 0.0
        ratios = [
            d.metres / span for d in net.distances if mine[d.i] and (span := float(np.linalg.norm(x[d.j] - x[d.i]))) > 0
        ]
        scale = float(np.median(ratios)) if ratios else 1.0 / typical if typical > 0 else 1.0
        centre = next((p for k, p in net.anchors.items() if mine[k]), np.zeros(net.dim))
        x[mine] = centre + scale * (x[mine] - centre)
    return x


def start_without_axis(
    net: BearingNetwork, parts: Components
) -> tuple[np.ndarray, np.ndarray, Observability, np.ndarray]:
    """Positions, headings, who can be located, and (m,) the sightings whose observer's heading was found.

    Robots that sighted each other share their headings directly; the others get theirs from the positions found so
    far, as long as that reaches anybody new. Anchors give the orientation when two of them are reached, one the place.
    In space a robot that nobody sees and that sees three is put where those are seen as it does. Where no two robots
    sighted each other, those that see three anchors begin. Raises DataError when there are none of
    them either.
    """
    heading, known = mutual_headings(net)
    turned = not known.any()
    if turned and net.dim == 2:
        heading, known = beacon_headings(net)
    if not known.any():
        what = "no two robots sighted each other and none sees three anchors"
        if net.dim == 3:
            what = "no two robots that sighted each other both see a third one off their line"
        raise DataError(f"no axis is common, {what}: no heading can be started")
    shared = replace(net, axis=True)
    free = shared if turned else replace(shared, anchors={}, distances=())
    position, placed = np.zeros((len(net), net.dim)), np.zeros(len(net), dtype=bool)
    for _ in range(ROUNDS):
        position, placed = _placed(free, heading, known)
        heading, more = resected_headings(net, position, placed, heading, known)
        if (more == known).all():
            break
        known = more
    if net.dim == 3:  # at up to four places: nobody else is found by them
        heading, known = resected(net, position, placed, heading, known)
        position, placed = _placed(free, heading, known)
    if not turned and (net.anchors or net.distances):
        if np.count_nonzero(placed & net.is_anchor) >= 2 and parts.known[parts.reference] >= 2:
            heading = headings(anchored_turn(net, position, placed) @ matrices(heading))
        position, _ = _placed(shared, heading, known)
    used = known[net.observer]
    heard = net.select(used)
    return position, heading, observe(heard, components(heard), position), used


def _placed(
    net: BearingNetwork, heading: Headings, known: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n d"], Bool[np.ndarray, " n"]]:
    """Positions by the sightings of the robots whose heading is `known`, and who can be located by them."""
    rows = known[net.observer]
    z = world_directions(net, heading)[rows]
    seen_by = net.select(rows)
    pieces = components(seen_by)
    position = linear_start(seen_by, pieces, z, *linear_pattern(seen_by, pieces))
    return position, observe(seen_by, pieces, position).localisable


@dataclass(frozen=True, slots=True)
class SwarmStart:
    """Everything found before the refinement: components, positions, headings, who can be located, sightings of use."""

    parts: Components
    position: Float[np.ndarray, "n d"]
    heading: Headings | None
    seen: Observability
    gauge: Gauge
    used: Bool[np.ndarray, " m"]
    pattern: Pattern | None = None  # of the sightings alone with the anchors held, where that is the whole problem


def prepare(net: BearingNetwork, initial: np.ndarray | None = None, heading: Headings | None = None) -> SwarmStart:
    """A start without a guess, and what can be told from these sightings at all.

    initial: positions that take its place; heading: [rad], without a common axis (else those that fit `initial`).
    """
    parts = components(net)
    used = np.ones(len(net.observer), dtype=bool)
    pattern = None
    if net.axis:
        pattern, held = linear_pattern(net, parts)
        position = linear_start(net, parts, net.direction, pattern, held) if initial is None else initial
        if net.distances or not (held == net.is_anchor).all():
            pattern = None  # what follows holds other entries
        seen = observe(net, parts, position, pattern)
    elif initial is not None:
        position, heading = initial, headings_at(net, initial) if heading is None else heading
        seen = observe(net, parts, position)
    else:
        position, heading, seen, used = start_without_axis(net, parts)
        net = net.select(used)
        parts = components(net)
    seen = without_lines(net, parts, seen, world_directions(net, heading))
    gauge = gauge_of(net, parts, seen.localisable)
    position, heading = normalise(gauge, position, heading)
    return SwarmStart(parts, position, heading, seen, gauge, used, pattern)


TURNS = 90  # headings tried around the circle


def relative_odometry_frame(
    pose_i: Float[np.ndarray, "m 3"],
    pose_j: Float[np.ndarray, "m 3"],
    bearing: Float[np.ndarray, " m"],
    by_i: np.ndarray,
    limit: float = 0.1,
) -> tuple[Float[np.ndarray, "3"], float]:
    """T_i_j, the pose of robot j's odometry frame in robot i's, and the mean squared bearing error it leaves [rad^2].

    pose_i, pose_j: both robots in their own frames at m instants; bearing: (m,) of the other in the observer's frame;
    by_i: (m,) whether robot i was the observer; a sighting more
    than `limit` [rad] off counts as that much off. For a given turn between the frames the offset follows from linear
    least squares, so only the turn is searched.
    """
    tried = np.linspace(-np.pi, np.pi, TURNS, endpoint=False)
    tried_offsets = [_offset(pose_i, pose_j, bearing, by_i, turn, limit) for turn in tried]
    for width in (np.pi / TURNS, np.pi / TURNS / 4, np.pi / TURNS / 16):
        best = min(tried_offsets, key=lambda f: f[1])
        tried_offsets += [
            _offset(pose_i, pose_j, bearing, by_i, float(best[0][2]) + d * width, limit) for d in (-1.0, -0.5, 0.5, 1.0)
        ]
    return min(tried_offsets, key=lambda f: f[1])


def _offset(
    pose_i: np.ndarray, pose_j: np.ndarray, bearing: np.ndarray, by_i: np.ndarray, turn: float, limit: float
) -> tuple[Float[np.ndarray, "3"], float]:
    c, s = np.cos(turn), np.sin(turn)
    q = np.column_stack([c * pose_j[:, 0] - s * pose_j[:, 1], s * pose_j[:, 0] + c * pose_j[:, 1]])
    ray = np.where(by_i, pose_i[:, 2], pose_j[:, 2] + turn) + bearing
    n = np.column_stack([-np.sin(ray), np.cos(ray)])
    gap = pose_i[:, :2] - q  # the offset that would put j upon i
    scale = np.ones(len(n))
    a = np.zeros(2)
    for _ in range(3):
        A = n / scale[:, None]
        a = np.linalg.lstsq(A, np.sum(A * gap, axis=1), rcond=None)[0]
        scale = np.maximum(np.linalg.norm(a - gap, axis=1), 0.2)
    d = np.where(by_i[:, None], a - gap, gap - a)
    e = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - ray)
    return np.array([a[0], a[1], turn]), float(np.mean(np.minimum(e * e, limit**2)))


THIRDS = 64  # robots seen by one of a pair that are asked for its turn
VOTING = 8  # rounds of averaging what third robots say
AGREEING = 3.0  # standard deviations from the mean at which a vote counts half
ON_LINE = 0.2  # [rad] standard deviation of a turn from which on the third robot may be on the line itself
ALONE = 0.3  # [rad] what the turn of a pair may be off by that one third robot tells
ROUNDED = 1e-9  # least standard deviation [rad] and sine of an angle
RESECTED = 1e-3  # second singular value of what a robot sees, below which all of it lies on one line
SWEEPS = 30  # of averaging each heading with those of the robots it is tied to
WILD = 0.3  # [rad]; a sighting of an anchor further off counts as this much off


def mutual_pairs(net: BearingNetwork) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Sightings a and b of each pair of robots that sighted each other (the first of repeated ones)."""
    n = len(net)
    key, back = net.observer * n + net.target, net.target * n + net.observer
    distinct, first = np.unique(key, return_index=True)
    where = np.searchsorted(distinct, back[first])
    mutual = (where < len(distinct)) & (distinct[np.minimum(where, len(distinct) - 1)] == back[first])
    a, b = first[mutual], first[where[mutual]]
    once = net.observer[a] < net.observer[b]
    return a[once], b[once]


def relative_turns(
    net: BearingNetwork,
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, "p d d"], Float[np.ndarray, " p"]]:
    """Robots i and j of pairs that see each other, R_i_j that carries the axes of j into those of i, and its variance.

    Two that see each other look along one line: in the plane that is all. In space it leaves the turn about the line,
    which each third robot that both of them see tells; where they disagree, those that most are near to count.
    """
    a, b = mutual_pairs(net)
    own = net.sigma[a] ** 2 + net.sigma[b] ** 2
    u, v = net.direction, -net.direction
    if net.dim == 2:
        aside = np.array([[0.0, 1.0], [-1.0, 0.0]])
        F, E = (np.stack([x, x @ aside], axis=-1) for x in (u[a], v[b]))
        return net.observer[a], net.target[a], F @ E.swapaxes(1, 2), own
    pair, ik, jk = _thirds(net, a, b)
    F, near = triads(u[a][pair], u[ik])
    E, far = triads(v[b][pair], u[jk])
    sigma = np.maximum(net.sigma, ROUNDED)
    variance = (sigma[ik] / near) ** 2 + (sigma[jk] / far) ** 2
    aside = variance < ON_LINE**2
    votes, variance, pair = (F @ E.swapaxes(1, 2))[aside], variance[aside], pair[aside]
    told, pair = np.unique(pair, return_inverse=True)
    add = sp.csr_array((np.ones(len(pair)), (pair, np.arange(len(pair)))), shape=(len(told), len(pair)))
    weight = 1.0 / variance
    mean = np.zeros((len(told), 3, 3))
    for _ in range(VOTING):
        mean = nearest((add @ (weight[:, None] * votes.reshape(-1, 9))).reshape(-1, 3, 3))
        weight = 1.0 / (variance + (angles(votes, mean[pair]) / AGREEING) ** 2)
    lonely = (ALONE / (add @ (weight * variance))) ** 2  # the fewer agree, the likelier is a wrong one among the two
    return net.observer[a[told]], net.target[a[told]], mean, own[told] + 1.0 / (add @ weight) + lonely


def _thirds(
    net: BearingNetwork, a: Int[np.ndarray, " p"], b: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " v"], Int[np.ndarray, " v"]]:
    """Which pair, and its two sightings of one third robot: by the observer of a and by that of b; at most THIRDS."""
    n = len(net)
    key = net.observer * n + net.target
    order = np.argsort(key, kind="stable")
    first = np.searchsorted(net.observer[order], np.arange(n + 1))
    i, j = net.observer[a], net.observer[b]
    many = first[i + 1] - first[i]
    tried = np.minimum(many, THIRDS)
    pair = np.repeat(np.arange(len(a)), tried)
    k = np.arange(len(pair)) - np.repeat(np.cumsum(tried) - tried, tried)
    ik = order[first[i][pair] + k * many[pair] // np.maximum(tried[pair], 1)]
    wanted = j[pair] * n + net.target[ik]
    where = np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)
    both = key[order][where] == wanted
    return pair[both], ik[both], order[where[both]]


def triads(
    u: Float[np.ndarray, "v 3"], w: Float[np.ndarray, "v 3"]
) -> tuple[Float[np.ndarray, "v 3 3"], Float[np.ndarray, " v"]]:
    """Axes along u, across it towards w, and across both, in columns; and the sine between u and w."""
    across = w - np.einsum("vk,vk->v", u, w)[:, None] * u
    sine = np.maximum(np.linalg.norm(across, axis=1), ROUNDED)
    across /= sine[:, None]
    return np.stack([u, across, np.cross(u, across)], axis=-1), sine


def mutual_headings(net: BearingNetwork) -> tuple[Headings, Bool[np.ndarray, " n"]]:
    """Headings up to one turn for all, and of whom: of the largest piece that pairs with `relative_turns` make.

    They go along the paths of least variance from one robot, then sweeps average all pairs, the less the more they
    disagree.
    """
    n = len(net)
    i, j, R, variance = relative_turns(net)
    at, to = np.r_[i, j], np.r_[j, i]
    R, variance = np.concatenate([R, R.swapaxes(1, 2)]), np.maximum(np.r_[variance, variance], ROUNDED**2)
    tied = sp.csr_array((variance, (at, to)), shape=(n, n))
    _, label = connected_components(tied, directed=False)
    known = label == np.argmax(np.bincount(label))
    T = np.repeat(np.eye(net.dim)[None], n, axis=0)
    if np.count_nonzero(known) < 2:
        return headings(T), np.zeros(n, dtype=bool)
    far, before = dijkstra(tied, indices=np.flatnonzero(known)[0], return_predecessors=True)
    row = sp.csr_array((np.arange(1, len(at) + 1), (at, to)), shape=(n, n))
    for k in np.argsort(far, kind="stable")[1 : np.count_nonzero(known)].tolist():
        T[k] = T[before[k]] @ R[row[before[k], k] - 1]
    for _ in range(SWEEPS):
        said = T[at] @ R
        off = angles(said, T[to]) ** 2
        weight = 1.0 / (variance + np.median(off) + off)
        add = sp.csr_array((weight, (to, np.arange(len(to)))), shape=(n, len(to)))
        T = nearest(weight.max() * T + (add @ said.reshape(len(to), -1)).reshape(T.shape))
    return headings(T), known


def beacon_headings(net: BearingNetwork) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Headings [rad] of robots that see three anchors or more, and who they are: each alone, without a guess."""
    heading, known = unturned(net), np.zeros(len(net), dtype=bool)
    rows = np.flatnonzero(net.is_anchor[net.target] & ~net.is_anchor[net.observer])
    rows = rows[np.argsort(net.observer[rows], kind="stable")]
    if not len(rows):
        return heading, known
    robots, first = np.unique(net.observer[rows], return_index=True)
    for k, mine in zip(robots.tolist(), np.split(rows, first[1:]), strict=True):
        seen = net.target[mine]
        if len(np.unique(seen)) < 3:
            continue
        there = np.array([[*net.anchors[int(j)], 0.0] for j in seen])
        pose, _ = relative_odometry_frame(
            there, np.zeros_like(there), net.bearing[mine], np.zeros(len(mine), dtype=bool), WILD
        )
        heading[k], known[k] = pose[2], True
    return heading, known


def unturned(net: BearingNetwork) -> Headings:
    """Headings of robots whose own axes are the common ones."""
    return np.zeros(len(net)) if net.dim == 2 else np.zeros((len(net), 3))


def resected_headings(
    net: BearingNetwork, position: np.ndarray, placed: np.ndarray, heading: Headings, known: np.ndarray
) -> tuple[Headings, np.ndarray]:
    """Headings also of placed robots that see placed ones, in space not on one line: the turn that fits those best."""
    n, dim = len(net), net.dim
    rows = placed[net.observer] & placed[net.target] & ~known[net.observer]
    i, j = net.observer[rows], net.target[rows]
    u, _ = predict(position[i], position[j])
    M = np.zeros((n, dim, dim))
    np.add.at(M, i, u[:, :, None] * net.direction[rows][:, None, :])
    size = np.linalg.svd(M, compute_uv=False)[:, dim - 2]  # what tells the turn: in space, the second direction
    fresh = size > (0.0 if dim == 2 else RESECTED)
    out = heading.copy()
    out[fresh] = headings(nearest(M[fresh]))
    return out, known | fresh


def headings_at(net: BearingNetwork, position: Float[np.ndarray, "n d"]) -> Headings:
    """Headings that fit what each robot sees with all robots at `position`; none of those that see nobody."""
    everybody, nobody = np.ones(len(net), dtype=bool), np.zeros(len(net), dtype=bool)
    return resected_headings(net, position, everybody, unturned(net), nobody)[0]


def anchored_turn(
    net: BearingNetwork, position: Float[np.ndarray, "n d"], chosen: np.ndarray
) -> Float[np.ndarray, "d d"]:
    """The turn that carries a shape onto its anchors best (place and scale free)."""
    at = np.array([k for k in net.anchors if chosen[k]], dtype=np.intp)
    here, there = position[at], np.array([net.anchors[int(k)] for k in at])
    M = (there - there.mean(axis=0)).T @ (here - here.mean(axis=0))
    return np.asarray(nearest(M[None])[0])


def world_directions(net: BearingNetwork, heading: Headings | None) -> Float[np.ndarray, "m d"]:
    """Sightings as unit vectors in the common axes."""
    if heading is None:
        return net.direction
    return np.asarray(np.einsum("mij,mj->mi", matrices(heading)[net.observer], net.direction))
