"""Robots with cameras that see all around: where they stand or drive, and whom each of them sees in which direction."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..core.attitude import Headings, matrices
from ..core.bearings import BearingTable
from ..core.config import config
from ..core.errors import UsageError, expect_at_most

SPACING = 10.0  # [m] between neighbours of the grid
JITTER = 3.0  # [m] either way, on every axis
BLOCKER_RADIUS = 1.5  # [m] of an object that moves about and blocks the view
MOST_ROBOTS, MOST_SIGHTINGS = 1_000_000, 20_000_000
Layout = Literal["grid", "random", "clusters"]


@config
class SwarmScene:
    """What the simulated swarm is like. Angles in radians, lengths in metres, times in seconds."""

    robots: int = 100  # about one in every cell of 10 m
    dim: Literal[2, 3] = 2  # 2: in the plane; 3: in space
    layout: Layout = "grid"  # grid: cells of 10 m, jittered by 3 m either way; random; clusters
    k: int = 8  # nearest robots that each one sees; not used with `range`
    range: float | None = None  # [m] within which each one sees all, instead
    sigma: float = float(np.deg2rad(1.0))
    missing: float = 0.0  # share of sightings lost
    outliers: float = 0.0  # share of sightings that point anywhere
    visibility: Literal["directed", "mutual", "single"] = "directed"
    axis: bool = True  # whether there is a common one; without it every robot has axes of its own
    blockers: int = 0  # objects that move about and block the view
    steps: int = 1  # more than one: robots move, and every sighting has its stamp; those at the corners stand still
    interval: float = 1.0  # [s] between steps
    speed: float = 0.5  # [m/s] of each axis at the start
    acceleration: float = 0.02  # [m^2/s^3] white-noise acceleration density of each axis
    drive: bool = False  # as wheeled robots do, their odometry beside, instead of drifting


@dataclass(frozen=True, slots=True)
class Swarm:
    """A simulated swarm. position: (T, n, d); t: (T,); odometry rows: (T, n, 2) v and w as measured.

    heading: (T, n), in space without an axis (T, n, 3) rotation vectors that carry own axes into the common ones.
    `corners`: the robots nearest the corners of the field, which stand still when the others move.
    """

    table: BearingTable
    position: Float[np.ndarray, "T n d"]
    heading: Float[np.ndarray, "T n *t"]
    t: Float[np.ndarray, " T"]
    corners: tuple[int, ...]
    odometry: Float[np.ndarray, "T n 2"] | None = None


def simulate_swarm(scene: SwarmScene, rng: np.random.Generator) -> Swarm:
    """One swarm and one set of sightings (one a step when it moves)."""
    _check(scene)
    start = place(scene, rng)
    corners = corner_robots(start)
    t = scene.interval * np.arange(scene.steps)
    heading = np.zeros((scene.steps, scene.robots))
    heading[:] = 0.0 if (scene.axis or scene.dim == 3) and not scene.drive else rng.uniform(-np.pi, np.pi, scene.robots)
    if scene.dim == 3 and not scene.axis:
        turn = Rotation.from_quat(rng.standard_normal((scene.robots, 4))).as_rotvec()
        heading = np.repeat(turn[None], scene.steps, axis=0)
    odometry = None
    if scene.drive:
        position, heading, odometry = _drive(start, heading[0], corners, scene, rng)
    else:
        position = _drift(start, corners, scene, rng)
    blockers = _wander(start, scene, rng)

    observed = []
    for k in range(scene.steps):
        pairs = pairs_seen(position[k], scene, rng)
        if scene.blockers:
            pairs = pairs[~_blocked(position[k], pairs, blockers, scene, rng, k)]
        pairs = pairs[rng.random(len(pairs)) >= scene.missing]
        observed.append((pairs, observe(position[k], heading[k], pairs, scene, rng), np.full(len(pairs), t[k])))
    pairs = np.concatenate([rows[0] for rows in observed])
    direction = np.concatenate([rows[1] for rows in observed])
    stamps = np.concatenate([rows[2] for rows in observed]) if scene.steps > 1 else None
    ids = tuple(str(k + 1) for k in range(scene.robots))
    sigma = np.full(len(pairs), scene.sigma)
    table = BearingTable(ids, pairs[:, 0], pairs[:, 1], direction, sigma, stamps, scene.axis)
    return Swarm(table, position, heading, t, corners, odometry)


def place(scene: SwarmScene, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
    """Where the robots stand at first: about one in every cell of SPACING."""
    n, d = scene.robots, scene.dim
    if scene.layout == "grid":
        side = int(np.ceil(n ** (1.0 / d) - 1e-9))
        axes = np.meshgrid(*[np.arange(side)] * d, indexing="ij")
        cells = np.column_stack([a.ravel() for a in axes])[:n]
        return SPACING * cells + rng.uniform(-JITTER, JITTER, (n, d))
    side = SPACING * n ** (1.0 / d)
    if scene.layout == "random":
        return rng.uniform(0.0, side, (n, d))
    groups = max(1, round(n / 20))
    across = int(np.ceil(groups ** (1.0 / d) - 1e-9))
    axes = np.meshgrid(*[np.arange(across)] * d, indexing="ij")
    gap = side / groups ** (1.0 / d)
    cells = np.column_stack([a.ravel() for a in axes])[:groups]
    centres = gap * (cells + rng.uniform(-0.1, 0.1, (groups, d)))
    return np.asarray(centres[rng.integers(groups, size=n)] + rng.normal(0.0, 0.28 * gap, (n, d)))


def corner_robots(position: Float[np.ndarray, "n d"]) -> tuple[int, ...]:
    """The robots nearest the corners of the field (four, in space eight; fewer when one is nearest to two)."""
    low, high = position.min(axis=0), position.max(axis=0)
    signs = np.stack(np.meshgrid(*[(0.0, 1.0)] * position.shape[1], indexing="ij"), axis=-1).reshape(
        -1, position.shape[1]
    )
    nearest = [int(np.argmin(np.linalg.norm(position - (low + s * (high - low)), axis=1))) for s in signs]
    return tuple(dict.fromkeys(nearest))


def pairs_seen(
    position: Float[np.ndarray, "n d"], scene: SwarmScene, rng: np.random.Generator
) -> Int[np.ndarray, "m 2"]:
    """Who sees whom: directed pairs (observer, target), without repeats, sorted by observer."""
    tree = cKDTree(position)
    n = len(position)
    if scene.range is not None:
        undirected = tree.query_pairs(scene.range, output_type="ndarray").astype(np.int64).reshape(-1, 2)
        pairs = np.concatenate([undirected, undirected[:, ::-1]])
    else:
        k = min(scene.k, n - 1)
        _, near = tree.query(position, k=k + 1)
        owner = np.repeat(np.arange(n), k + 1)
        pairs = np.column_stack([owner, near.reshape(-1)])
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    if scene.visibility != "directed":
        undirected = np.unique(np.sort(pairs, axis=1), axis=0)
        flip = rng.random(len(undirected)) < 0.5
        one_way = np.where(flip[:, None], undirected[:, ::-1], undirected)
        pairs = one_way if scene.visibility == "single" else np.concatenate([undirected, undirected[:, ::-1]])
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def observe(
    position: Float[np.ndarray, "n d"],
    heading: Headings,
    pairs: Int[np.ndarray, "m 2"],
    scene: SwarmScene,
    rng: np.random.Generator,
) -> Float[np.ndarray, "m d"]:
    """Noisy unit vectors along `pairs`, turned into the observer's frame when there is no common axis."""
    d = position[pairs[:, 1]] - position[pairs[:, 0]]
    u = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
    wild = rng.random(len(pairs)) < scene.outliers
    if scene.dim == 2:
        angle = np.arctan2(u[:, 1], u[:, 0]) + scene.sigma * rng.standard_normal(len(pairs))
        angle = np.where(wild, rng.uniform(-np.pi, np.pi, len(pairs)), angle)
        u = np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        # A turn by a Gaussian tangent vector: sigma in each of the two directions across the ray.
        e = rng.standard_normal((len(pairs), 3)) * scene.sigma
        e -= np.sum(e * u, axis=1, keepdims=True) * u
        a = np.linalg.norm(e, axis=1, keepdims=True)
        u = np.cos(a) * u + np.sinc(a / np.pi) * e
        anywhere = rng.standard_normal((len(pairs), 3))
        u = np.where(wild[:, None], anywhere / np.linalg.norm(anywhere, axis=1, keepdims=True), u)
    if scene.axis:
        return np.asarray(u)
    return np.asarray(np.einsum("mji,mj->mi", matrices(heading)[pairs[:, 0]], u))


def _drift(
    start: Float[np.ndarray, "n d"], corners: tuple[int, ...], scene: SwarmScene, rng: np.random.Generator
) -> Float[np.ndarray, "T n d"]:
    """Motion at nearly constant velocity, exactly as the white-noise acceleration model says."""
    dt, q = scene.interval, scene.acceleration
    L = np.linalg.cholesky(q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) + 1e-18 * np.eye(2))
    x, v = start.copy(), scene.speed * rng.standard_normal(start.shape)
    v[list(corners)] = 0.0
    out = [x.copy()]
    for _ in range(scene.steps - 1):
        noise = rng.standard_normal((2, *start.shape))
        noise[:, list(corners)] = 0.0
        x = x + dt * v + L[0, 0] * noise[0]
        v = v + L[1, 0] * noise[0] + L[1, 1] * noise[1]
        out.append(x.copy())
    return np.stack(out)


def _drive(
    start: Float[np.ndarray, "n 2"],
    heading: Float[np.ndarray, " n"],
    corners: tuple[int, ...],
    scene: SwarmScene,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "T n 2"], Float[np.ndarray, "T n"], Float[np.ndarray, "T n 2"]]:
    """Wheeled robots on arcs, and their odometry: 5 % of the speed + 0.02, and the same of the turn rate, as noise."""
    n, dt = len(start), scene.interval
    x, theta = start.copy(), heading.copy()
    v, w = np.full(n, scene.speed), 0.1 * rng.standard_normal(n)
    still = np.zeros(n, dtype=bool)
    still[list(corners)] = True
    positions, headings, measured = [x.copy()], [theta.copy()], []
    for _ in range(scene.steps):
        v = np.where(still, 0.0, np.clip(v + 0.1 * scene.speed * rng.standard_normal(n), 0.0, 2.0 * scene.speed))
        w = np.where(still, 0.0, 0.9 * w + 0.05 * rng.standard_normal(n))
        noise = rng.standard_normal((n, 2)) * np.column_stack([0.05 * v + 0.02, 0.05 * np.abs(w) + 0.02])
        measured.append(np.column_stack([v, w]) + np.where(still[:, None], 0.0, noise))
        middle = theta + 0.5 * w * dt
        chord = v * dt * np.sinc(0.5 * w * dt / np.pi)
        x = x + chord[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
        theta = theta + w * dt
        positions.append(x.copy())
        headings.append(theta.copy())
    return np.stack(positions[:-1]), np.stack(headings[:-1]), np.stack(measured)


def _wander(start: Float[np.ndarray, "n d"], scene: SwarmScene, rng: np.random.Generator) -> Float[np.ndarray, "M T d"]:
    """Blockers on straight paths through the field, one place for each of max(steps, 60) instants."""
    low, high = start.min(axis=0), start.max(axis=0)
    a, b = rng.uniform(low, high, (2, scene.blockers, scene.dim))
    along = np.linspace(0.0, 1.0, max(scene.steps, 60))
    return np.asarray(a[:, None] + along[None, :, None] * (b - a)[:, None])


def _blocked(
    position: Float[np.ndarray, "n d"],
    pairs: Int[np.ndarray, "m 2"],
    blockers: Float[np.ndarray, "M T d"],
    scene: SwarmScene,
    rng: np.random.Generator,
    step: int,
) -> Bool[np.ndarray, " m"]:
    """Which lines of sight pass through a blocker; without stamps each sighting was taken at an instant of its own."""
    when = np.full(len(pairs), step) if scene.steps > 1 else rng.integers(blockers.shape[1], size=len(pairs))
    a, b = position[pairs[:, 0]], position[pairs[:, 1]]
    d = b - a
    length2 = np.maximum(np.sum(d * d, axis=1), 1e-12)
    hidden = np.zeros(len(pairs), dtype=bool)
    for way in blockers:
        p = way[when]
        s = np.clip(np.sum((p - a) * d, axis=1) / length2, 0.0, 1.0)
        hidden |= np.linalg.norm(a + s[:, None] * d - p, axis=1) < BLOCKER_RADIUS
    return np.asarray(hidden)


def _check(scene: SwarmScene) -> None:
    for name in ("missing", "outliers"):
        if not 0.0 <= getattr(scene, name) <= 1.0:
            raise UsageError(f"--{name} {getattr(scene, name):g}: expected a share between 0 and 1")
    if scene.robots < 2:
        raise UsageError(f"--robots {scene.robots}: expected 2 or more")
    if scene.dim not in (2, 3):
        raise UsageError(f"--dim {scene.dim}: expected 2 or 3")
    if scene.k < 1 or (scene.range is not None and scene.range <= 0.0):
        raise UsageError("expected --k of 1 or more, --range above 0")
    if scene.steps < 1 or scene.interval <= 0.0:
        raise UsageError("expected --steps of 1 or more, --interval above 0")
    expect_at_most({"--robots": (scene.robots, MOST_ROBOTS), "--k": (scene.k, MOST_ROBOTS)})
    each = scene.k if scene.range is None else 1
    expect_at_most({"robots times steps times --k": (scene.robots * scene.steps * each, MOST_SIGHTINGS)})
    if scene.drive and scene.dim == 3:
        raise UsageError("--drive: robots on wheels stay in the plane; expected --dim 2")
