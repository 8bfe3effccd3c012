"""What the team's problem is made of: motions against commands or wandering, sightings of landmarks and robots, scans.

What laser scans say of poses is each robot's own pose graph, and keyframes of different robots that were matched.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..laser.pose_graph import PoseGraph, edge_factor
from ..laser.robot_graph import RobotGraph
from ..solve import Cauchy, Factor
from .config import MOTION_NOISE_OUTLIER, UNKNOWN_MEMORY, CameraNoise, SmoothingConfig
from .robot_part import BIAS, LAG, RANGE, SPEED, TURN, Motion, RobotPart, random_walk

CAMERA_NOISE_OUTLIER = 1.0  # standard deviations from which a sighting counts less: errors of ranges are skewed


def step_factor(part: RobotPart, cfg: SmoothingConfig, lag: float) -> Factor:
    """The motion between neighbouring instants, against commands where there are any."""
    t, k = part.instants.t, part.instants.steps
    columns = np.concatenate([part.pose_columns(k), part.pose_columns(k + 1)], axis=1)
    kernel = Cauchy(MOTION_NOISE_OUTLIER)
    if part.motion is None:
        return _wandering(part, columns)
    motion = part.motion
    parameters = np.tile(part.parameters + np.array([SPEED, TURN, LAG]), (len(k), 1))
    columns9 = np.concatenate([columns, parameters], axis=1)
    whiten = np.linalg.inv(np.linalg.cholesky(motion.noise(t, lag, cfg.motion)[k]))

    @lru_cache(maxsize=2)  # costs, residuals and Jacobians are asked for at the same calibration, one after the other
    def commanded(turn: float, lag: float) -> Motion:
        return motion.between(t, 1.0, turn, lag)

    def residual(x: np.ndarray) -> np.ndarray:
        speed, turn, lag = x[parameters[0]]
        r = _relative_pose(x[columns])[0] / [speed, speed, 1.0] - commanded(turn, lag).step[k]
        r[:, 2] = se2.wrap_angle(r[:, 2])
        return np.asarray(r)

    def jacobian(x: np.ndarray) -> np.ndarray:
        speed, turn, lag = x[parameters[0]]
        z, J = _relative_pose(x[columns])
        J[:, :2] /= speed
        by = -commanded(turn, lag).by_calibration[k]
        by[:, :2, SPEED] = -z[:, :2] / speed**2
        by[:, 2, SPEED] = 0.0
        return np.concatenate([J, by], axis=2)

    return Factor(columns9, residual, jacobian, 3, whiten, kernel, "odometry")


def _wandering(part: RobotPart, columns: Int[np.ndarray, "m 6"]) -> Factor:
    """A robot whose commands nobody knows wanders, ahead more than aside.

    In its camera's own metres: else a smaller map would be a likelier one.
    """
    scale = part.parameters + RANGE
    keeps = part.instants.gap
    if not len(part.log.sightings):
        keeps = np.maximum(keeps, UNKNOWN_MEMORY)
    whiten = np.linalg.inv(np.linalg.cholesky(random_walk(part.instants.t, keeps)[part.instants.steps]))

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(_halfway(*_relative_pose(x[columns]))[0] * [x[scale], x[scale], 1.0])

    def jacobian(x: np.ndarray) -> np.ndarray:
        z, J = _halfway(*_relative_pose(x[columns]))
        J[:, :2] *= x[scale]
        by = np.zeros((len(columns), 3, 1))
        by[:, :2, 0] = z[:, :2]
        return np.concatenate([J, by], axis=2)

    with_scale = np.concatenate([columns, np.full((len(columns), 1), scale)], axis=1)
    return Factor(with_scale, residual, jacobian, 3, whiten, None, "wandering")


def _relative_pose(x: Float[np.ndarray, "m 6"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 6"]]:
    """The second pose seen from the first, and its derivatives by both."""
    c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
    dx, dy = x[:, 3] - x[:, 0], x[:, 4] - x[:, 1]
    u, v = c * dx + s * dy, -s * dx + c * dy
    z = np.stack([u, v, se2.wrap_angle(x[:, 5] - x[:, 2])], axis=-1)
    J = np.zeros((len(x), 3, 6))
    J[:, 0, 0], J[:, 0, 1], J[:, 0, 2], J[:, 0, 3], J[:, 0, 4] = -c, -s, v, c, s
    J[:, 1, 0], J[:, 1, 1], J[:, 1, 2], J[:, 1, 3], J[:, 1, 4] = s, -c, -u, -s, c
    J[:, 2, 2], J[:, 2, 5] = -1.0, 1.0
    return z, J


def _halfway(
    z: Float[np.ndarray, "m 3"], J: Float[np.ndarray, "m 3 6"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 6"]]:
    """A step seen from the heading in its middle, where an arc goes straight ahead; and its derivatives."""
    c, s = np.cos(0.5 * z[:, 2]), np.sin(0.5 * z[:, 2])
    R = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=1)
    out, D = z.copy(), J.copy()
    out[:, :2] = (R @ z[:, :2, None])[..., 0]
    D[:, :2] = R @ J[:, :2]
    D[:, 0] += 0.5 * out[:, 1, None] * J[:, 2]
    D[:, 1] -= 0.5 * out[:, 0, None] * J[:, 2]
    return out, D


NEAREST = 1e-6  # [m] a sighting of a point at the robot's own place has no direction


def sighting_factors(
    part: RobotPart,
    team: Mapping[str, RobotPart],
    labels: Mapping[str, str],
    landmarks: Mapping[str, int],
    x0: Float[np.ndarray, " n"],
    cfg: SmoothingConfig,
) -> list[tuple[Factor, Float[np.ndarray, " m"]]]:
    """What this robot saw of other robots, all in one factor, and of landmarks, with the stamps."""
    table, camera = part.seen, cfg.camera
    point = np.full(len(table), -1)
    first, last = part.instants.t[0], part.instants.t[-1]
    there = (table.t >= first) & (table.t <= last)
    out, met, robots = [], [np.zeros(0, np.int64)], []
    for k, own in enumerate(table.ids):
        rows = np.flatnonzero((table.what == k) & there)
        other = team.get(own)
        if other is None or own == part.robot:
            point[rows] = landmarks.get(labels.get(own, own), -1)
        elif cfg.robot_sightings:
            t = table.t[rows]
            rows = rows[(t >= other.instants.t[0]) & (t <= other.instants.t[-1])]
            met.append(rows)
            robots.append(PointSightings.robot(other, table.t[rows]))
    rows = np.concatenate(met)
    if len(rows):
        seen = PointSightings(np.concatenate([s.columns for s in robots]), np.concatenate([s.ahead for s in robots]))
        term = _sighting_factor(part, rows, seen, x0, camera.robot_range_floor, camera.robot_bearing, camera)
        out.append((term, table.t[rows]))
    rows = np.flatnonzero(point >= 0)
    if len(rows):
        seen = PointSightings(point[rows, None] + np.arange(2), np.zeros((len(rows), 2)))
        out.append((_sighting_factor(part, rows, seen, x0, camera.range_floor, camera.bearing, camera), table.t[rows]))
    return out


@dataclass(frozen=True, slots=True)
class PointSightings:
    """m points that were sighted: landmarks, or robots a short motion from an instant of theirs.

    columns: (m, 2) a landmark's place, or (m, 3) a robot's pose; ahead: (m, 2) the point in that pose's frame.
    """

    columns: Int[np.ndarray, "m d"]
    ahead: Float[np.ndarray, "m 2"]

    @classmethod
    def robot(cls, part: RobotPart, t: Float[np.ndarray, " m"]) -> "PointSightings":
        """The robot of `part` at `t` [s]."""
        k, step = part.instants.from_nearest(t)
        return cls(part.pose_columns(k), step[:, :2])

    def at(self, x: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2 d"]]:
        """The points, and their derivatives by `columns`."""
        point = x[self.columns[:, :2]]
        J = np.zeros((*point.shape, self.columns.shape[1]))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        if self.columns.shape[1] == 3:
            turned = _turned(x[self.columns[:, 2]], self.ahead)
            point = point + turned
            J[:, 0, 2], J[:, 1, 2] = -turned[:, 1], turned[:, 0]
        return point, J


def _turned(theta: Float[np.ndarray, " m"], d: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 2"]:
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([c * d[:, 0] - s * d[:, 1], s * d[:, 0] + c * d[:, 1]], axis=-1)


def _sighting_factor(
    part: RobotPart,
    rows: Int[np.ndarray, " m"],
    seen: PointSightings,
    x0: Float[np.ndarray, " n"],
    floor: float,
    bearing: float,
    camera: CameraNoise,
) -> Factor:
    """Bearing, and range where it was told, from where the robot was at the stamp: a short motion from its instant.

    The range's noise grows with the distance expected at the start, not with the range read: else short readings
    would weigh more, and the map would shrink.
    """
    table = part.seen
    ranged = np.isfinite(table.range[rows])
    z = np.stack([np.where(ranged, table.range[rows], 0.0), table.bearing[rows]], axis=-1)
    k, step = part.instants.from_nearest(table.t[rows])
    pose = part.pose_columns(k)
    parameters = np.tile(part.parameters + np.array([BIAS, RANGE]), (len(z), 1))
    columns = np.concatenate([pose, seen.columns, parameters], axis=1)
    end = 3 + seen.columns.shape[1]

    def eye(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turned = _turned(x[pose[:, 2]], step[:, :2])
        return x[pose[:, :2]] + turned, turned

    def residual(x: np.ndarray) -> np.ndarray:
        d = seen.at(x)[0] - eye(x)[0]
        p = x[parameters]
        ahead = np.arctan2(d[:, 1], d[:, 0]) - x[pose[:, 2]] - step[:, 2] + p[:, 0]
        return np.stack([p[:, 1] * np.hypot(d[:, 0], d[:, 1]) - z[:, 0], se2.wrap_angle(ahead - z[:, 1])], axis=-1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        point, by_point = seen.at(x)
        place, turned = eye(x)
        d, scale = point - place, x[parameters[:, 1]]
        r = np.maximum(np.hypot(d[:, 0], d[:, 1]), NEAREST)
        along = d / r[:, None]
        H = np.stack([scale[:, None] * along, np.stack([-along[:, 1], along[:, 0]], axis=-1) / r[:, None]], axis=1)
        J = np.zeros((len(z), 2, columns.shape[1]))
        J[:, :, :2] = -H
        J[:, :, 2] = -(H[:, :, 1] * turned[:, None, 0] - H[:, :, 0] * turned[:, None, 1])
        J[:, 1, 2] -= 1.0
        J[:, :, 3:end] = H @ by_point
        J[:, 1, end] = 1.0
        J[:, 0, end + 1] = r
        return J

    expected = np.linalg.norm(seen.at(x0)[0] - eye(x0)[0], axis=1)
    sd = np.stack([np.hypot(floor, camera.range_share * expected), np.full(len(z), bearing)], axis=-1)
    sd[~ranged, 0] = np.inf
    return Factor(
        columns, residual, jacobian, 2, 1.0 / sd, Cauchy(CAMERA_NOISE_OUTLIER), "landmark" if end == 5 else "robot"
    )


@dataclass(frozen=True, slots=True)
class InterRobotEdge:
    """Keyframe `second` of robot `b` at `measured` (3,) as seen from keyframe `first` of robot `a`.

    information: (3, 3) in the later one's frame.
    """

    a: str
    b: str
    first: int
    second: int
    measured: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]


def scan_factor(part: RobotPart, graph: RobotGraph) -> Factor:
    """Steps and closures between a robot's keyframes, with the relative poses of its finished map.

    The last pass over all scans knows these relative poses better than the matches they began with; so its map is the
    minimum of this factor, and the information of the pose graph says how firmly.
    """
    edges = graph.graph()
    ways = se2.between(graph.pose[edges.first], graph.pose[edges.second])
    return _edges(PoseGraph(graph.pose, edges.first, edges.second, np.asarray(ways), edges.information), part, part)


def inter_robot_factor(a: RobotPart, b: RobotPart, crossings: list[InterRobotEdge], outlier: float) -> Factor:
    """Keyframes of two robots that were matched."""
    pairs = [(c.first, c.second) for c in crossings]
    n = 1 + max(max(pair) for pair in pairs)
    graph = PoseGraph.of(np.zeros((n, 3)), pairs, [c.measured for c in crossings], [c.information for c in crossings])
    return _edges(graph, a, b, Cauchy(outlier))


def _edges(graph: PoseGraph, a: RobotPart, b: RobotPart, kernel: Cauchy | None = None) -> Factor:
    """The edges of `graph` between the poses of `a` and those of `b`."""
    m = graph.edges
    pairs = PoseGraph(np.zeros((2 * m, 3)), 2 * np.arange(m), 2 * np.arange(m) + 1, graph.measured, graph.information)
    plain = edge_factor(pairs, "scan" if a is b else "crossing", kernel)
    columns = np.concatenate([a.pose_columns(graph.first), b.pose_columns(graph.second)], axis=1)

    def residual(x: Float[np.ndarray, " n"]) -> np.ndarray:
        return plain.residual(x[columns].ravel())

    def jacobian(x: Float[np.ndarray, " n"]) -> np.ndarray:
        return plain.jacobian(x[columns].ravel())

    return Factor(columns, residual, jacobian, 3, plain.sqrt_info, kernel, plain.name)
