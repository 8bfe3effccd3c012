"""The rims of posters and doors as landmarks: poses moved until every rim is seen in one place.

Where light changes from one return to the next on one wall, a rim stands between the two beams. Its bearing is known
to within their spacing, its distance from the line of the wall, so it holds a robot along a wall that is otherwise
alike all along. Poses that are right to a decimetre tell which rims are one; all scans and rims are then one sparse
least-squares problem.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...core import se2
from ...kernels.laser.joint_scans import BeamIndex, LineGate, match_pairs
from ...laser.beam import Beams
from ...laser.joint_pass import ScanCloud, scan_cloud, without_scatter
from ...solve import Cauchy, Factor, Problem, Solution, SolveConfig, minimise, wrapping

LIGHT_EDGE_JUMP = 5.0  # standard deviations of the difference of two returns' light from which on it is a rim
LIGHT_EDGE_NOISE = 0.03  # [log units] sd of one return's light, at least
LIGHT_EDGE_AROUND = 5  # returns to each side that the line of the wall is taken from
LIGHT_EDGE_STRAIGHT = 0.06  # [m] from that line at most
LIGHT_EDGE_SPACING = 0.12  # [m] between the two returns at most
LIGHT_EDGE_REACHES = (0.25, 0.15, 0.1)  # [m] within which rims are one, a round each
LIGHT_EDGE_WIDTHS = (0.1, 0.1, 0.1)  # [m] of the robust cost of walls, a round each
LIGHT_EDGE_LAGS = (2, 6, 12, 18)  # scans on that walls are matched with
LIGHT_EDGE_BEAMS = 90  # returns of a scan that are matched
LIGHT_EDGE_SIGMA = 0.02  # [m] of a matched return
LIGHT_EDGE_TEMPER = 0.4  # share of the returns that count as independent
LIGHT_EDGE_BLUR = 0.1  # share of the information across lines that noise in their normals feigns along them
LIGHT_EDGE_ITERATIONS = 10  # of the least squares in a round, at most
LIGHT_EDGE_ALIKE = 0.3  # [log units] by which the light on either side may differ
LIGHT_EDGE_ALONG = 0.004  # [m] sd of a rim along its wall, besides its place between the two beams
LIGHT_EDGE_ACROSS = 0.006  # [m] sd of a rim across its wall
LIGHT_EDGE_KERNEL = 2.0  # standard deviations of the robust cost of a rim
LIGHT_EDGE_STEP_XY = 0.05  # [m] sd of a step of the poses given and
LIGHT_EDGE_STEP_TURN = 0.02  # [rad] of its turn


@dataclass(frozen=True, slots=True)
class Rims:
    """Rims of all scans. scan: (m,) of which; point: (m, 2) [m] and normal: (m, 2) of the wall, in the robot frame;
    light: (m, 2) log q to the right and to the left; spacing: (m,) [m] between the two returns.
    """

    scan: Int[np.ndarray, " m"]
    point: Float[np.ndarray, "m 2"]
    normal: Float[np.ndarray, "m 2"]
    light: Float[np.ndarray, "m 2"]
    spacing: Float[np.ndarray, " m"]


def find_rims(scans: Sequence[Beams], noise: float) -> Rims:
    """Where light changes between neighbouring returns of one wall; `noise` [log units] of one return."""
    parts = [_of_scan(k, b, max(noise, LIGHT_EDGE_NOISE)) for k, b in enumerate(scans)]
    scan, point, normal, light, spacing = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Rims(scan.astype(np.int64), point, normal, light, spacing)


def _of_scan(number: int, b: Beams, noise: float) -> tuple[np.ndarray, ...]:
    n = len(b.q)
    if n < 2 * LIGHT_EDGE_AROUND:
        return np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    q = np.log(np.maximum(b.q, 1e-3))
    normal = b.normal[:-1] + b.normal[1:]
    normal /= np.maximum(np.hypot(*normal.T), 1e-9)[:, None]
    angle = np.arctan2(b.s[:, 1], b.s[:, 0])
    middle = angle[:-1] + 0.5 * np.asarray(se2.wrap_angle(np.diff(angle)))
    ray = np.column_stack([np.cos(middle), np.sin(middle)])
    facing = -np.einsum("nk,nk->n", ray, normal)
    near = np.clip(np.arange(n - 1)[:, None] + np.arange(1 - LIGHT_EDGE_AROUND, 1 + LIGHT_EDGE_AROUND), 0, n - 1)
    offset = np.einsum("nwk,nk->nw", b.s[near], normal)
    own = 0.5 * np.einsum("nk,nk->n", b.s[:-1] + b.s[1:], normal)
    fits = np.abs(offset - own[:, None]) < LIGHT_EDGE_STRAIGHT
    offset = np.where(fits, offset, 0.0).sum(axis=1) / np.maximum(fits.sum(axis=1), 1)
    footprint = np.hypot(*b.s[1:].T) * np.abs(np.diff(angle)) / np.maximum(facing, 0.05)
    good = (
        (np.diff(b.beam) == 1)
        & (np.minimum(b.support[:-1], b.support[1:]) >= LIGHT_EDGE_AROUND)
        & (np.einsum("nk,nk->n", b.normal[:-1], b.normal[1:]) > 0.9)
        & (fits.sum(axis=1) >= LIGHT_EDGE_AROUND)
        & (facing > 0.1)
        & (footprint < LIGHT_EDGE_SPACING)
        & (np.abs(np.diff(q)) > LIGHT_EDGE_JUMP * np.sqrt(2.0) * noise)
    )
    at = np.flatnonzero(good)
    point = ray[at] * (-offset[at] / facing[at])[:, None]
    return (
        np.full(len(at), number),
        point,
        normal[at],
        np.column_stack([q[at], q[at + 1]]),
        footprint[at],
    )


def same_rims(rims: Rims, poses: Float[np.ndarray, "n 3"], reach: float) -> Int[np.ndarray, " m"]:
    """(m,) number of the rim that each was seen of, at `poses`: the nearest with the same light within `reach` [m].

    Scan by scan; a rim is where it was seen last, and no scan sees one twice.
    """
    world = se2.act(poses[rims.scan], rims.point)
    number = np.full(len(world), -1, np.int64)
    place, light, count = np.zeros((len(world), 2)), np.zeros((len(world), 2)), 0
    starts = np.searchsorted(rims.scan, np.arange(len(poses) + 1))
    for first, end in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        if first == end:
            continue
        now = slice(first, end)
        d = np.hypot(*(world[now, None] - place[None, :count]).transpose(2, 0, 1))
        d[(np.abs(rims.light[now, None] - light[None, :count]) > LIGHT_EDGE_ALIKE).any(axis=2)] = np.inf
        for row, col in _nearest_pairs(d, reach):
            number[first + row] = col
        new = np.flatnonzero(number[now] < 0) + first
        number[new] = count + np.arange(len(new))
        place[number[now]], light[number[now]] = world[now], rims.light[now]
        count += len(new)
    return number


def _nearest_pairs(d: Float[np.ndarray, "a b"], reach: float) -> list[tuple[int, int]]:
    """Pairs nearer than `reach`, the nearest first, none of them twice."""
    rows, cols = np.nonzero(d < reach)
    pairs, left, right = [], set(rows.tolist()), set(cols.tolist())
    for k in np.argsort(d[rows, cols], kind="stable").tolist():
        row, col = int(rows[k]), int(cols[k])
        if row in left and col in right:
            pairs.append((row, col))
            left.remove(row)
            right.remove(col)
    return pairs


def sharpened(scans: Sequence[Beams], poses: Float[np.ndarray, "n 3"], noise: float) -> Float[np.ndarray, "n 3"]:
    """`poses` of the scans moved so that all see their rims, and their walls, in one place; the first stays.

    The scanner stands at the robot's origin; noise: [log units] of one return's light.
    """
    rims = find_rims(scans, noise)
    walls = WallReturns.of(scans)
    sd = np.array([[LIGHT_EDGE_STEP_XY, LIGHT_EDGE_STEP_XY, LIGHT_EDGE_STEP_TURN]])
    n = np.arange(len(poses))
    steps = RelativePoses(n[:-1], n[1:], np.asarray(se2.between(poses[:-1], poses[1:])), 1.0 / sd)
    pose = np.array(poses, float)
    for reach, width in zip(LIGHT_EDGE_REACHES, LIGHT_EDGE_WIDTHS, strict=True):
        one = same_rims(rims, pose, reach)
        asked = rim_problem(rims, one, pose, (steps, walls.relations(pose, width)))
        pose = minimise(asked, SolveConfig(max_iterations=LIGHT_EDGE_ITERATIONS)).x[: pose.size].reshape(-1, 3)
    return pose


def at_truth(scans: Sequence[Beams], poses: Float[np.ndarray, "n 3"], noise: float) -> Solution:
    """What rims and walls tell of the scans at their true `poses`, by the noise they are weighed with; no steps."""
    rims = find_rims(scans, noise)
    one = same_rims(rims, poses, LIGHT_EDGE_REACHES[-1])
    walls = WallReturns.of(scans).relations(poses, LIGHT_EDGE_WIDTHS[-1])
    return minimise(rim_problem(rims, one, poses, (walls,)), SolveConfig(max_iterations=0))


class RelativePoses(NamedTuple):
    """What is known of poses `second` in the frames of `first`. known: (e, 3); weight: (e or 1, 3[, 3]) whitening."""

    first: Int[np.ndarray, " e"]
    second: Int[np.ndarray, " e"]
    known: Float[np.ndarray, "e 3"]
    weight: np.ndarray

    def factor(self, name: str) -> Factor:
        a, b = (3 * k[:, None] + np.arange(3) for k in (self.first, self.second))

        def residual(x: np.ndarray) -> np.ndarray:
            r = se2.between(x[a], x[b]) - self.known
            r[:, 2] = se2.wrap_angle(r[:, 2])
            return np.asarray(r)

        def jacobian(x: np.ndarray) -> np.ndarray:
            return np.concatenate(se2.between_jacobians(x[a], x[b]), axis=2)

        return Factor(np.concatenate([a, b], axis=1), residual, jacobian, 3, self.weight, None, name)


@dataclass(frozen=True, slots=True)
class WallReturns:
    """The returns of all scans, thinned, to be matched point to line with those some scans on."""

    cloud: ScanCloud
    index: BeamIndex
    pairs: Int[np.ndarray, "p 2"]

    @classmethod
    def of(cls, scans: Sequence[Beams]) -> "WallReturns":
        cloud = scan_cloud(scans, np.zeros((len(scans), 2)), LIGHT_EDGE_BEAMS)
        n = np.arange(len(scans))
        pairs = [np.column_stack([n[:-k], n[k:]]) for k in LIGHT_EDGE_LAGS if k < len(n)]
        return cls(cloud, cloud.index(360), np.concatenate([np.zeros((0, 2), np.int64), *pairs]))

    def relations(self, pose: Float[np.ndarray, "n 3"], width: float) -> RelativePoses:
        """How the second of each pair stands to the first by their walls; along a bare one nothing is said."""
        a, b = np.ascontiguousarray(np.concatenate([self.pairs, self.pairs[:, ::-1]]).T)
        relative = np.asarray(se2.between(pose[a], pose[b]))
        H, g, _, near = match_pairs(a, b, relative, self.cloud.lines, self.index, LineGate(3.0 * width, 0.5), width)
        H, g = without_scatter(H, g, LIGHT_EDGE_BLUR)
        enough = near >= 15
        H, g, a, b, relative = (v[enough] for v in (H, g, a, b, relative))
        H = H + 1e-6 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        known = relative - np.linalg.solve(H, g[..., None])[..., 0]
        W = np.linalg.cholesky(LIGHT_EDGE_TEMPER / LIGHT_EDGE_SIGMA**2 * H).swapaxes(1, 2)
        return RelativePoses(a, b, known, W)


def rim_problem(
    rims: Rims,
    number: Int[np.ndarray, " m"],
    pose: Float[np.ndarray, "n 3"],
    relations: tuple[RelativePoses, ...],
) -> Problem:
    """Least squares over x = [pose, .., place of each rim, ..]: rims seen twice or more, and what poses are related."""
    n = len(pose)
    kept = np.bincount(number, minlength=1)[number] > 1  # what was seen once holds nothing
    _, which, count = np.unique(number[kept], return_inverse=True, return_counts=True)
    scan, point, normal = rims.scan[kept], rims.point[kept], rims.normal[kept]
    world = se2.act(pose[scan], point)
    place = np.column_stack([np.bincount(which, world[:, k]) / count for k in range(2)])
    at = np.arange(3 * n).reshape(n, 3)
    columns = np.column_stack([at[scan], 3 * n + 2 * which, 3 * n + 2 * which + 1])
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    along = np.hypot(LIGHT_EDGE_ALONG, rims.spacing[kept] / np.sqrt(12.0))
    W = np.stack([tangent / along[:, None], normal / LIGHT_EDGE_ACROSS], axis=1)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(se2.act(se2.inverse(x[at[scan]]), x[columns[:, 3:]]) - point)

    def jacobian(x: np.ndarray) -> np.ndarray:
        p = x[at[scan]]
        c, s = np.cos(p[:, 2]), np.sin(p[:, 2])
        d = x[columns[:, 3:]] - p[:, :2]
        J = np.zeros((len(p), 2, 5))
        J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1] = -c, -s, s, -c
        J[:, 0, 2], J[:, 1, 2] = -s * d[:, 0] + c * d[:, 1], -c * d[:, 0] - s * d[:, 1]
        J[:, :, 3:] = -J[:, :, :2]
        return J

    fixed = np.zeros(3 * n + 2 * len(count), dtype=bool)
    fixed[:3] = True
    x = np.concatenate([pose.ravel(), place.ravel()])
    seen = Factor(columns, residual, jacobian, 2, W, Cauchy(LIGHT_EDGE_KERNEL), "rims")
    terms = (seen, *(r.factor("relations") for r in relations))
    return Problem(x, terms, fixed, wrapping(at[:, 2]))
