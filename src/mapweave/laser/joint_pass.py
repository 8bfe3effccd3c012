"""The last pass over everything: keyframes that see the same walls are matched again, all together.

What the loops of the graph leave is a matter of centimetres: there every pair of keyframes is near enough for point to
line, in both directions, and one sparse system moves them all. Then every scan is laid on the keyframes around it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ..core import se2
from ..core.config import config
from ..core.records import frozen
from ..core.rows import spread
from ..kernels.laser.joint_scans import BeamIndex, LineGate, ScanLines, beams_by_direction, match_pairs, refine_poses
from ..solve import Factor, Information, Pattern, Problem, SingularError, wrapping
from .beam import Beams
from .pose_graph import PoseGraph, edge_factor
from .robot_graph import RobotGraph

JOINT_BEFORE = 4  # keyframes just before each that it is paired with, and
JOINT_AROUND = 8  # of others, the nearest, so many
JOINT_LEAST_MATCHES = 15  # returns of a pair within a width of their lines, and
JOINT_LEAST_SHARE = 0.3  # share of all, or the pair counts nothing
JOINT_SIGMA = 0.02  # [m] of a matched return
JOINT_TEMPER = 0.1  # share of the returns that count as independent
SCAN_WIDTHS = (0.06, 0.04)  # [m] of the robust cost, a round each, for laying each scan on the keyframes

JOINT_PASS_BEAMS = 90  # returns of a keyframe that are matched, spread over it
JOINT_PASS_SECTORS = 360  # parts of the circle a scan's returns are sorted into
JOINT_PASS_REACH = 8.0  # [m] from each other at most,
JOINT_PASS_VIEW = 2.0  # [rad] looking in directions no farther apart
JOINT_PASS_GATE = 3.0  # [widths] from its line up to which a return is matched
JOINT_PASS_AGREE = 0.5  # least cosine between the normals of two returns
JOINT_PASS_BLUR = 0.1  # share of the information across lines that noise in their normals feigns along them
JOINT_PASS_STEP_XY = 0.05  # [m] and
JOINT_PASS_STEP_TURN = 0.03  # [rad]: and sd of a step at most
SCAN_BEAMS = 60  # returns of a scan that are matched
SCAN_AROUND = 12  # keyframes each scan is matched against

HELD = 1e-4  # [m, rad] sd of the first keyframe, which the frame hangs on

UNSURE = 0.5  # [m] sd of a step from which on it is not held beside what it tells


@config
class JointPassConfig:
    """The last pass: how keyframes are paired, matched and moved, and how each scan is laid on them."""

    widths: tuple[float, ...] = (0.15, 0.1, 0.06, 0.04)  # [m] of the robust cost, a round each


@dataclass(frozen=True, slots=True)
class ScanCloud:
    """The returns of n scans in a row, thinned: those of scan i are start[i]:start[i + 1], in its robot frame.

    lined: (m,) where three or more beams made the normal; sensor: (n, 2) where the scanner stood on the robot [m].
    """

    start: Int[np.ndarray, " n1"]
    points: Float[np.ndarray, "m 2"]
    normals: Float[np.ndarray, "m 2"]
    lined: Bool[np.ndarray, " m"]
    sensor: Float[np.ndarray, "n 2"]

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def lines(self) -> ScanLines:
        return ScanLines(self.start, self.points, self.normals, self.lined)

    def index(self, sectors: int) -> BeamIndex:
        """Every scan's returns by their direction from the scanner."""
        return BeamIndex(beams_by_direction(self.start, self.points, self.lined, self.sensor, sectors), self.sensor)


def scan_cloud(scans: Sequence[Beams], sensor: Float[np.ndarray, "n 2"], most: int) -> ScanCloud:
    """At most `most` returns of each scan, spread evenly over it."""
    kept = [spread(len(b.q), most) for b in scans]
    start = np.concatenate([[0], np.cumsum([len(k) for k in kept])]).astype(np.int64)
    none = np.zeros((0, 2))
    return ScanCloud(
        frozen(start, np.int64),
        frozen(np.concatenate([none, *(b.s[k] for b, k in zip(scans, kept, strict=True))])),
        frozen(np.concatenate([none, *(b.normal[k] for b, k in zip(scans, kept, strict=True))])),
        frozen(
            np.concatenate([np.zeros(0, bool), *(b.support[k] >= 3 for b, k in zip(scans, kept, strict=True))]), bool
        ),
        frozen(sensor),
    )


def keyframe_cloud(robots: Sequence[RobotGraph], most: int) -> ScanCloud:
    """At most `most` returns of each keyframe of all robots, in their order, spread evenly over it."""
    rows, counts, offset = [], [], 0
    for r in robots:
        for i in range(len(r)):
            at = r.rows(i)
            kept = spread(at.stop - at.start, most)
            rows.append(offset + at.start + kept)
            counts.append(len(kept))
        offset += len(r.points)
    every = np.concatenate([np.zeros(0, np.int64), *rows]).astype(np.int64)
    return ScanCloud(
        frozen(np.concatenate([[0], np.cumsum(counts)]), np.int64),
        frozen(np.concatenate([r.points for r in robots])[every]),
        frozen(np.concatenate([r.normals for r in robots])[every]),
        frozen(np.concatenate([r.lined for r in robots])[every], np.bool_),
        frozen(np.concatenate([r.sensor for r in robots])),
    )


def joint_pass(
    steps: PoseGraph,
    cloud: ScanCloud,
    cfg: JointPassConfig,
    ties: PoseGraph | None = None,
    robot: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """The poses of `steps` moved so that keyframes that see the same walls agree on them; the first stays.

    steps: the keyframes with the edges between neighbours, which carry what cannot be matched; cloud: the keyframes'
    returns. ties: edges over the same poses that count beside the matches: closures, which light may tell, and what
    ties robots. robot: (n,) whose each keyframe is, those of one in a row and in order: the last of one and the first
    of the next are no neighbours.
    """
    pose = np.array(steps.pose)
    if len(pose) < 2:
        return pose
    index = cloud.index(JOINT_PASS_SECTORS)
    lined = np.add.reduceat(np.append(cloud.lined, False).astype(np.int64), cloud.start[:-1]) * (
        np.diff(cloud.start) > 0
    )
    weak = np.diag([JOINT_PASS_STEP_XY**-2, JOINT_PASS_STEP_XY**-2, JOINT_PASS_STEP_TURN**-2])
    sure = np.linalg.eigvalsh(steps.information[:, :2, :2])[:, 0] > UNSURE**-2  # over a border there is no such step
    held = replace(steps, information=steps.information + sure[:, None, None] * weak)
    columns = np.arange(3)[None]
    unit, still = np.eye(3)[None], np.zeros((1, 3))
    anchor = Factor(columns, lambda _: still, lambda _: unit, 3, np.full((1, 3), 1.0 / HELD), None, "anchor")
    terms = [anchor, edge_factor(held, "steps")]
    if ties is not None and ties.edges:
        terms.append(edge_factor(ties, "ties"))
    width, pairs, pattern = 0.0, np.zeros((0, 2), np.int64), None
    for now in cfg.widths:
        if now != width or pattern is None:
            width, pairs = now, paired(pose, robot)
            a, b = np.ascontiguousarray(np.concatenate([pairs, pairs[:, ::-1]]).T)
            ends = np.concatenate([3 * a[:, None] + np.arange(3), 3 * b[:, None] + np.arange(3)], axis=1)
            shape = [
                *terms,
                Factor(ends, lambda _: np.zeros((0, 1)), lambda _: np.zeros((0, 1, 6)), 1, None, None, "pairs"),
            ]
            pattern = Pattern.of(Problem(pose.ravel(), shape, None, wrapping(np.arange(2, pose.size, 3))))
        H, g, _, near = match_pairs(
            a,
            b,
            np.asarray(se2.between(pose[a], pose[b])),
            cloud.lines,
            index,
            LineGate(JOINT_PASS_GATE * width, JOINT_PASS_AGREE),
            width,
        )
        H, g = without_scatter(H, g, JOINT_PASS_BLUR)
        counts = (near >= JOINT_LEAST_MATCHES) & (near >= JOINT_LEAST_SHARE * lined[b])
        scale = counts * JOINT_TEMPER / JOINT_SIGMA**2
        A, B = se2.between_jacobians(pose[a], pose[b])
        J = np.concatenate([A, B], axis=2)
        blocks = (J.swapaxes(1, 2) @ H @ J) * scale[:, None, None]
        gradients = (J.swapaxes(1, 2) @ g[..., None])[..., 0] * scale[:, None]
        parts = [term.normal(pose.ravel()) for term in terms]
        whole, gradient = pattern.assemble([*(p[0] for p in parts), blocks], [*(p[1] for p in parts), gradients])
        try:
            step = Information.of(whole, pattern.elimination).solve(-gradient).reshape(-1, 3)
        except SingularError:
            break
        pose = pose + step
        pose[:, 2] = se2.wrap_angle(pose[:, 2])
    return pose


def without_scatter(
    H: Float[np.ndarray, "p 3 3"], g: Float[np.ndarray, "p 3"], blur: float
) -> tuple[Float[np.ndarray, "p 3 3"], Float[np.ndarray, "p 3"]]:
    """Information and gradient of matches less what noise in the normals of lines alone gives along them.

    Lines whose normals scatter by chance seem to tell something along themselves: `blur` times what they tell across.
    """
    scatter = 0.5 * blur * (H[:, 0, 0] + H[:, 1, 1])
    values, vectors = np.linalg.eigh(H[:, :2, :2])
    kept = np.sqrt(np.maximum(values - scatter[:, None], 0.0) / np.maximum(values, 1e-12))
    T = np.tile(np.eye(3), (len(H), 1, 1))
    T[:, :2, :2] = (vectors * kept[:, None, :]) @ vectors.swapaxes(1, 2)
    return T @ H @ T, (T @ g[..., None])[..., 0]


def paired(pose: Float[np.ndarray, "n 3"], robot: Int[np.ndarray, " n"] | None = None) -> Int[np.ndarray, "p 2"]:
    """Keyframes to be matched with each other, i < j, ascending: neighbours in the drive of one robot and in space."""
    n = len(pose)
    i = np.arange(n)
    near = neighbours(pose, pose, JOINT_AROUND, own=i, apart=JOINT_BEFORE)
    row, col = np.nonzero(near >= 0)
    space = np.column_stack([row, near[row, col]])
    drive = [np.column_stack([i[k:] - k, i[k:]]) for k in range(1, JOINT_BEFORE + 1)]
    along = np.concatenate(drive) if drive else np.zeros((0, 2), np.int64)
    if robot is not None:
        along = along[robot[along[:, 0]] == robot[along[:, 1]]]
    both = np.concatenate([np.sort(space, axis=1), along])
    return np.unique(both, axis=0).astype(np.int64)


def neighbours(
    pose: Float[np.ndarray, "s 3"],
    keyframes: Float[np.ndarray, "n 3"],
    most: int,
    own: Int[np.ndarray, " s"] | None = None,
    apart: int = 0,
) -> Int[np.ndarray, "s most"]:
    """The keyframes nearest to each pose that look the same way, -1 where there are fewer.

    own: which keyframe each pose is (-1: none): itself and those up to `apart` numbers from it are left out.
    """
    k = min(len(keyframes), 3 * most + 2 * apart + 1)
    tree = cKDTree(keyframes[:, :2])
    d, at = (np.asarray(a) for a in tree.query(pose[:, :2], k=np.arange(1, k + 1)))
    good = (d <= JOINT_PASS_REACH) & (np.abs(se2.wrap_angle(pose[:, None, 2] - keyframes[at, 2])) <= JOINT_PASS_VIEW)
    if own is not None:
        good &= (np.abs(at - own[:, None]) > apart) | (own[:, None] < 0)
    rank = np.cumsum(good, axis=1)
    row, col = np.nonzero(good & (rank <= most))
    out = np.full((len(pose), most), -1, np.int64)
    out[row, rank[row, col] - 1] = at[row, col]
    return out


def lay_scans(
    pose: Float[np.ndarray, "s 3"],
    scans: ScanCloud,
    keyframes: Float[np.ndarray, "n 3"],
    cloud: ScanCloud,
    own: Int[np.ndarray, " s"],
) -> Float[np.ndarray, "s 3"]:
    """Every scan's pose matched once more against the keyframes around it, which stay.

    own: (s,) which keyframe each scan is, or -1: it is not matched against itself.
    """
    if not len(keyframes):
        return pose
    out = refine_poses(
        np.ascontiguousarray(pose),
        scans.lines,
        neighbours(pose, keyframes, SCAN_AROUND, own),
        np.ascontiguousarray(keyframes),
        cloud.lines,
        cloud.index(JOINT_PASS_SECTORS),
        LineGate(JOINT_PASS_GATE, JOINT_PASS_AGREE),
        np.asarray(SCAN_WIDTHS, dtype=float),
        JOINT_TEMPER / JOINT_SIGMA**2,
        np.array([JOINT_PASS_STEP_XY, JOINT_PASS_STEP_XY, JOINT_PASS_STEP_TURN]),
    )
    out[:, 2] = se2.wrap_angle(out[:, 2])
    return np.asarray(out)
