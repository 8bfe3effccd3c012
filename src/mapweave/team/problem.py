"""All robots' trajectories, all landmarks and every robot's calibration as one sparse least-squares problem.

Variables, in this order: the poses of each robot at its instants, landmarks, then five calibration parameters a robot.
The gauge is the first pose of the first robot, which is held; where nothing that was seen ties a robot to it, that
robot's first pose is held too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ..core import se2
from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..solve import Cauchy, Factor, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from .commanded_motion import CommandedMotion, random_walk
from .config import CalibrationPrior, CameraNoise, SmoothingConfig
from .instants import Instants, instants_of

PARAMETERS = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")
SPEED, TURN, LAG, BIAS, RANGE = range(len(PARAMETERS))
NEAREST = 1e-6  # [m] a sighting of a point at the robot's own place has no direction
HELD_TOGETHER = 0.002  # sd of the mean range scale of robots without odometry: nothing else holds their size


@dataclass(frozen=True, slots=True)
class RobotPart:
    """What one robot brings: its log, when its pose is estimated, and where that stands among the variables.

    start: entry of its first pose; parameters: entry of its first calibration parameter; motion: None without odometry.
    """

    log: LandmarkLog
    instants: Instants
    start: int
    parameters: int
    motion: CommandedMotion | None

    @property
    def robot(self) -> str:
        return self.log.robot

    def pose_columns(self, k: Int[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
        """The entries of x that hold the poses at the instants `k`."""
        return np.asarray(self.start + 3 * k[:, None] + np.arange(3))


@dataclass(frozen=True, slots=True)
class Origin:
    """The robot (its place among the parts) whose factors a term holds, and their stamps t: (m,) [s]."""

    robot: int
    t: Float[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class TeamProblem:
    """The problem, and what its factors are of.

    origins: for each term, whose factors they are and when; None for priors.
    """

    parts: tuple[RobotPart, ...]
    landmarks: tuple[str, ...]
    landmark_start: int
    problem: Problem
    pattern: Pattern
    origins: tuple["Origin | None", ...]
    used: Mapping[str, int]

    @property
    def landmark_columns(self) -> Int[np.ndarray, " n"]:
        return self.landmark_start + np.arange(2 * len(self.landmarks))

    def solve(self, cfg: SmoothingConfig) -> Solution:
        """The minimum near the start."""
        limits = SolveConfig(max_iterations=cfg.max_iterations, damping=1e-4, step_tolerance=1e-4, cost_tolerance=5e-5)
        return minimise(self.problem, limits, self.pattern)


def team_problem(
    logs: Sequence[LandmarkLog],
    landmarks: LandmarkMap,
    tracks: Mapping[str, Track],
    labels: Mapping[str, Mapping[str, str]],
    calibration: Mapping[str, Mapping[str, tuple[float, float]]],
    cfg: SmoothingConfig,
) -> TeamProblem:
    """The problem of all `logs` (in order; the first robot's first pose is the gauge), started at a fused map.

    landmarks, tracks: where to start, in one frame; labels[robot]: own landmark name -> name in the map;
    calibration[robot]: parameter -> (mean, standard deviation) known beforehand, in place of the prior of `cfg`.
    """
    names = [log.robot for log in logs]
    seen_at = _seen_at(logs, names) if cfg.robot_sightings else {name: np.zeros(0) for name in names}
    at = [instants_of(log, seen_at[log.robot], tracks[log.robot], cfg) for log in logs]
    starts = np.concatenate([[0], np.cumsum([3 * len(i.t) for i in at])]).astype(int)
    landmark_start = int(starts[-1])
    first_parameter = landmark_start + 2 * len(landmarks)
    parts = tuple(
        RobotPart(
            log,
            at[k],
            int(starts[k]),
            first_parameter + len(PARAMETERS) * k,
            None if log.odometry is None else CommandedMotion.of(log.odometry, cfg.motion.hold),
        )
        for k, log in enumerate(logs)
    )
    prior = [_prior(part, calibration.get(part.robot, {}), cfg.calibration) for part in parts]
    x0 = np.concatenate([*(i.start.ravel() for i in at), landmarks.mean.ravel(), *(mean for mean, _ in prior)])
    fixed = np.zeros(len(x0), bool)
    for part, (_, sd) in zip(parts, prior, strict=True):
        fixed[part.parameters : part.parameters + len(PARAMETERS)] = sd == 0
    terms: list[Factor] = []
    origins: list[Origin | None] = []
    where = {name: landmark_start + 2 * k for k, name in enumerate(landmarks.ids)}
    used: dict[str, int] = {}
    for k, part in enumerate(parts):
        if len(part.instants.t) > 1:
            terms.append(_steps(part, cfg, float(prior[k][0][LAG])))
            origins.append(Origin(k, part.instants.t[:-1]))
        found = _sightings(part, {p.robot: p for p in parts}, labels.get(part.robot, {}), where, x0, cfg)
        for term, t in found:
            terms.append(term)
            origins.append(Origin(k, t))
            used[term.name] = used.get(term.name, 0) + len(term.columns)
    for part in _first_of_groups(parts, terms, len(x0)):
        fixed[part.start : part.start + 3] = True
    terms += _priors(parts, prior)
    origins += [None] * (len(terms) - len(origins))
    angles = np.concatenate([part.start + 3 * np.arange(len(part.instants.t)) + 2 for part in parts])
    problem = Problem(x0, terms, fixed, wrapping(angles))
    return TeamProblem(parts, landmarks.ids, landmark_start, problem, Pattern.of(problem), tuple(origins), used)


def _first_of_groups(parts: Sequence[RobotPart], terms: Sequence[Factor], n: int) -> list[RobotPart]:
    """The first robot of all, and the first of every group that no sighting ties to it: their starts are the frame."""
    row = np.concatenate([np.repeat(term.columns[:, 0], term.columns.shape[1]) for term in terms])
    column = np.concatenate([term.columns.ravel() for term in terms])
    group = connected_components(sp.csr_array((np.ones(len(row)), (row, column)), shape=(n, n)), directed=False)[1]
    first: dict[int, RobotPart] = {}
    for part in parts:
        first.setdefault(int(group[part.start]), part)
    return list(first.values())


def _seen_at(logs: Sequence[LandmarkLog], names: Sequence[str]) -> dict[str, Float[np.ndarray, " s"]]:
    """When each robot was sighted by another."""
    out: dict[str, list[np.ndarray]] = {name: [np.zeros(0)] for name in names}
    for log in logs:
        table = log.sightings
        for k, name in enumerate(table.ids):
            if name in out and name != log.robot:
                out[name].append(table.t[table.what == k])
    return {name: np.concatenate(parts) for name, parts in out.items()}


def _prior(
    part: RobotPart, known: Mapping[str, tuple[float, float]], cfg: CalibrationPrior
) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "5"]]:
    """Mean and standard deviation of each parameter; 0 holds it, as speed, turn and lag of a robot without odometry."""
    mean = np.array([known.get(p, (getattr(cfg, p), 0.0))[0] for p in PARAMETERS], float)
    sd = np.array([known[p][1] if p in known else getattr(cfg, f"{p}_sd") for p in PARAMETERS], float)
    if part.motion is None:
        sd[[SPEED, TURN, LAG]] = 0.0
    return mean, sd


def _steps(part: RobotPart, cfg: SmoothingConfig, lag: float) -> Factor:
    """The way between neighbouring instants, against commands where there are any."""
    t = part.instants.t
    k = np.arange(len(t) - 1)
    columns = np.concatenate([part.pose_columns(k), part.pose_columns(k + 1)], axis=1)
    kernel = Cauchy(cfg.motion.outlier)
    if part.motion is None:
        return _wandering(part, columns, cfg)
    motion = part.motion
    parameters = np.tile(part.parameters + np.array([SPEED, TURN, LAG]), (len(k), 1))
    columns9 = np.concatenate([columns, parameters], axis=1)
    whiten = np.linalg.inv(np.linalg.cholesky(motion.noise(t, lag, cfg.motion)))

    def residual(x: np.ndarray) -> np.ndarray:
        speed, turn, lag = x[parameters[0]]
        r = _moved(x[columns])[0] / [speed, speed, 1.0] - motion.between(t, 1.0, turn, lag).step
        r[:, 2] = se2.wrap_angle(r[:, 2])
        return np.asarray(r)

    def jacobian(x: np.ndarray) -> np.ndarray:
        speed, turn, lag = x[parameters[0]]
        z, J = _moved(x[columns])
        J[:, :2] /= speed
        by = -motion.between(t, 1.0, turn, lag).by_calibration
        by[:, :2, SPEED] = -z[:, :2] / speed**2
        by[:, 2, SPEED] = 0.0
        return np.concatenate([J, by], axis=2)

    return Factor(columns9, residual, jacobian, 3, whiten, kernel, "odometry")


def _wandering(part: RobotPart, columns: Int[np.ndarray, "m 6"], cfg: SmoothingConfig) -> Factor:
    """A robot whose commands nobody knows wanders, ahead more than aside.

    In its camera's own metres: else a smaller map would be a likelier one.
    """
    scale = part.parameters + RANGE
    whiten = np.linalg.inv(np.linalg.cholesky(random_walk(part.instants.t, cfg.motion)))

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(_halfway(*_moved(x[columns]))[0] * [x[scale], x[scale], 1.0])

    def jacobian(x: np.ndarray) -> np.ndarray:
        z, J = _halfway(*_moved(x[columns]))
        J[:, :2] *= x[scale]
        by = np.zeros((len(columns), 3, 1))
        by[:, :2, 0] = z[:, :2]
        return np.concatenate([J, by], axis=2)

    with_scale = np.concatenate([columns, np.full((len(columns), 1), scale)], axis=1)
    return Factor(with_scale, residual, jacobian, 3, whiten, None, "wandering")


def _moved(x: Float[np.ndarray, "m 6"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 6"]]:
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


def _sightings(
    part: RobotPart,
    team: Mapping[str, RobotPart],
    labels: Mapping[str, str],
    landmarks: Mapping[str, int],
    x0: Float[np.ndarray, " n"],
    cfg: SmoothingConfig,
) -> list[tuple[Factor, Float[np.ndarray, " m"]]]:
    """What this robot saw of landmarks and of other robots, with the stamps."""
    table, camera = part.log.sightings, cfg.camera
    point = np.full(len(table), -1)
    out = []
    for k, own in enumerate(table.ids):
        rows = np.flatnonzero(table.what == k)
        other = team.get(own)
        if other is None or own == part.robot:
            point[rows] = landmarks.get(labels.get(own, own), -1)
        elif cfg.robot_sightings:
            t = table.t[rows]
            rows = rows[(t >= other.instants.t[0]) & (t <= other.instants.t[-1])]
            if len(rows):
                seen = Seen.robot(other, table.t[rows])
                out.append(
                    (
                        _sighting_factor(part, rows, seen, x0, camera.robot_range_floor, camera.robot_bearing, camera),
                        table.t[rows],
                    )
                )
    rows = np.flatnonzero(point >= 0)
    if len(rows):
        seen = Seen(point[rows, None] + np.arange(2), np.zeros((len(rows), 2)))
        out.append((_sighting_factor(part, rows, seen, x0, camera.range_floor, camera.bearing, camera), table.t[rows]))
    return out


@dataclass(frozen=True, slots=True)
class Seen:
    """m points that were sighted: landmarks, or robots a little way from an instant of theirs.

    columns: (m, 2) a landmark's place, or (m, 3) a robot's pose; ahead: (m, 2) the point in that pose's frame.
    """

    columns: Int[np.ndarray, "m d"]
    ahead: Float[np.ndarray, "m 2"]

    @classmethod
    def robot(cls, part: RobotPart, t: Float[np.ndarray, " m"]) -> "Seen":
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
    seen: Seen,
    x0: Float[np.ndarray, " n"],
    floor: float,
    bearing: float,
    camera: CameraNoise,
) -> Factor:
    """Range and bearing of points, from where the robot was at the stamp: a little way from its nearest instant.

    The range's noise grows with the distance expected at the start, not with the range read: else short readings
    would weigh more, and the map would shrink.
    """
    table = part.log.sightings
    z = np.stack([table.range[rows], table.bearing[rows]], axis=-1)
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
    return Factor(columns, residual, jacobian, 2, 1.0 / sd, Cauchy(camera.outlier), "landmark" if end == 5 else "robot")


def _priors(parts: Sequence[RobotPart], prior: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[Factor]:
    """What is known of the calibration; the range scales of robots without odometry keep their mean."""
    columns = np.concatenate(
        [part.parameters + np.flatnonzero(sd > 0) for part, (_, sd) in zip(parts, prior, strict=True)]
    )
    mean = np.concatenate([m[sd > 0] for m, sd in prior])
    sd = np.concatenate([sd[sd > 0] for _, sd in prior])
    out = []
    if len(columns):
        out.append(
            Factor(
                columns[:, None],
                lambda x: (x[columns] - mean)[:, None],
                lambda _: np.ones((len(columns), 1, 1)),
                1,
                1.0 / sd[:, None],
                None,
                "prior",
            )
        )
    loose = [
        part.parameters + RANGE
        for part, (_, sd) in zip(parts, prior, strict=True)
        if part.motion is None and sd[RANGE] > 0
    ]
    if loose and all(part.motion is None for part in parts):
        held = np.array([loose])
        n = len(loose)
        centre = float(np.mean([m[RANGE] for m, _ in prior]))
        out.append(
            Factor(
                held,
                lambda x: x[held].mean(axis=1, keepdims=True) - centre,
                lambda _: np.full((1, 1, n), 1.0 / n),
                1,
                np.array([[1.0 / HELD_TOGETHER]]),
                None,
                "scale",
            )
        )
    return out
