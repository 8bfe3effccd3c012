"""All robots' trajectories, all landmarks and every robot's calibration as one sparse least-squares problem.

Variables, in this order: the poses of each robot at its instants, landmarks, then five calibration parameters a robot.
The gauge is the first pose of the first robot, which is held; where nothing that was seen ties a robot to it, that
robot's first pose is held too.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..laser.robot_graph import RobotGraph
from ..solve import Cauchy, Factor, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from .config import LONGEST_STEP, MOTION_NOISE_HOLD, MOTION_NOISE_OUTLIER, CalibrationPrior, SmoothingConfig
from .factors import InterRobotEdge, inter_robot_factor, scan_factor, sighting_factors, step_factor
from .known import PlacePriors
from .robot_part import (
    LAG,
    PARAMETERS,
    RANGE,
    SPEED,
    TURN,
    CommandedMotion,
    Instants,
    RobotPart,
    count_instants,
    instants_of,
    keyframe_instants,
)

SMOOTHING_ITERATIONS = 40  # steps of the solver, at most

CROWD = 100  # robots of one field, up to which all poses that the settings allow are estimated
WIDER = 1.25  # times as long are steps made at a time where poses are too many
OF_ALL = frozenset({"prior", "scale", "size"})  # factors that say nothing of where anything is
HELD_TOGETHER = 0.001  # share of the size of a map that nothing but ranges tells: so firmly it is held


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
    origins: tuple["Origin | None", ...]
    used: Mapping[str, int]

    @property
    def landmark_columns(self) -> Int[np.ndarray, " n"]:
        return self.landmark_start + np.arange(2 * len(self.landmarks))

    @property
    def pattern(self) -> Pattern:
        """Where the factors' blocks go, trajectories eliminated first and all else last: found anew when asked."""
        return self.ordered(Pattern.of(self.problem))

    def ordered(self, pattern: Pattern) -> Pattern:
        """`pattern`, of this problem's variables, with trajectories eliminated first and all else last."""
        free = self.problem.free
        parameters = self.parts[0].parameters
        node = _nodes(len(self.problem.x0), self.landmark_start, parameters)[free]
        return pattern.least_fill(node, free >= self.landmark_start)

    def solve(
        self,
        start: Float[np.ndarray, " n"] | None = None,
        pattern: Pattern | None = None,
        on_step: Callable[[], None] | None = None,
    ) -> Solution:
        """The minimum near the start (or near `start`); `pattern`: where it is known already."""
        problem = self.problem if start is None else replace(self.problem, x0=start)
        limits = SolveConfig(
            max_iterations=SMOOTHING_ITERATIONS, damping=1e-4, step_tolerance=1e-4, cost_tolerance=5e-5
        )
        return minimise(problem, limits, pattern or self.pattern, on_step)

    def softened(self, width: float) -> "TeamProblem":
        """The same problem with every robust kernel `width` times as wide: far starts still feel what they saw."""
        terms = [
            replace(term, kernel=Cauchy(width * term.kernel.k)) if isinstance(term.kernel, Cauchy) else term
            for term in self.factors
        ]
        return replace(self, problem=replace(self.problem, terms=terms))

    def held_at(self, poses: Int[np.ndarray, " k"]) -> "TeamProblem":
        """The same problem with a frame that something else tells: at entries `poses` of x, and all that is tied to it.

        Of what is not tied to any of them, the first pose stays held.
        """
        fixed = np.zeros(len(self.problem.x0), bool) if self.problem.fixed is None else self.problem.fixed.copy()
        fixed[: self.landmark_start] = False
        tying = [term for term in self.factors if term.name not in OF_ALL]
        for part in _first_of_groups(self.parts, tying, len(fixed), poses):
            fixed[part.start : part.start + 3] = True
        return replace(self, problem=replace(self.problem, fixed=fixed))

    @property
    def size_is_held(self) -> bool:
        """Whether the map keeps the size it began with, which nothing but ranges tells."""
        return any(term.name == "size" for term in self.factors)

    @property
    def has_laser(self) -> bool:
        return any(part.scans is not None for part in self.parts)

    @property
    def factors(self) -> list[Factor]:
        return [term for term in self.problem.terms if isinstance(term, Factor)]


def team_problem(
    logs: Sequence[LandmarkLog],
    landmarks: LandmarkMap,
    tracks: Mapping[str, Track],
    labels: Mapping[str, Mapping[str, str]],
    calibration: Mapping[str, Mapping[str, tuple[float, float]]],
    cfg: SmoothingConfig,
    scans: Mapping[str, RobotGraph] | None = None,
    crossings: Sequence[InterRobotEdge] = (),
    instants: Mapping[str, Instants] | None = None,
    known: PlacePriors | None = None,
) -> TeamProblem:
    """The problem of all `logs` (in order; the first robot's first pose is the gauge), started at a fused map.

    scans[robot]: the keyframes of a robot with a laser, whose scans tell how it moved, not its wheels; crossings:
    keyframes of two such robots that were matched.

    landmarks, tracks: where to start, in one frame; labels[robot]: own landmark name -> name in the map;
    calibration[robot]: parameter -> (mean, standard deviation) known beforehand, in place of the prior of `cfg`;
    instants: when poses are estimated, where that is not left to the sightings; known: places known beforehand, in the
    frame of `landmarks` and `tracks`, which holds that frame in place of a first pose where it can.
    """
    names = [log.robot for log in logs]
    scans = scans or {}
    seen_at = seen_when(logs, names) if cfg.robot_sightings else {name: np.zeros(0) for name in names}
    at = [
        instants[log.robot]
        if instants is not None
        else keyframe_instants(scans[log.robot].t, tracks[log.robot])
        if log.robot in scans
        else instants_of(log, seen_at[log.robot], tracks[log.robot], cfg)
        for log in logs
    ]
    starts = np.concatenate([[0], np.cumsum([3 * len(i.t) for i in at])]).astype(int)
    landmark_start = int(starts[-1])
    first_parameter = landmark_start + 2 * len(landmarks)
    parts = tuple(
        RobotPart(
            log,
            at[k],
            int(starts[k]),
            first_parameter + len(PARAMETERS) * k,
            None if log.odometry is None or log.robot in scans else CommandedMotion.of(log.odometry, MOTION_NOISE_HOLD),
            scans.get(log.robot),
        )
        for k, log in enumerate(logs)
    )
    prior = [
        prior_of(calibration.get(part.robot, {}), cfg.calibration, wheels=part.motion is not None) for part in parts
    ]
    x0 = np.concatenate([*(i.start.ravel() for i in at), landmarks.mean.ravel(), *(mean for mean, _ in prior)])
    fixed = np.zeros(len(x0), bool)
    for part, (_, sd) in zip(parts, prior, strict=True):
        fixed[part.parameters : part.parameters + len(PARAMETERS)] = sd == 0
    terms: list[Factor] = []
    origins: list[Origin | None] = []
    where = {name: landmark_start + 2 * k for k, name in enumerate(landmarks.ids)}
    used: dict[str, int] = {}
    for k, part in enumerate(parts):
        if part.scans is None and len(part.instants.steps):
            terms.append(step_factor(part, cfg, float(prior[k][0][LAG])))
            origins.append(Origin(k, part.instants.t[part.instants.steps]))
        sighting_terms = sighting_factors(part, {p.robot: p for p in parts}, labels.get(part.robot, {}), where, x0, cfg)
        for term, t in sighting_terms:
            terms.append(term)
            origins.append(Origin(k, t))
            used[term.name] = used.get(term.name, 0) + len(term.columns)
    for term in _scan_terms(parts, crossings):
        terms.append(term)
        origins.append(None)
        used[term.name] = used.get(term.name, 0) + len(term.columns)
    places = known.factors(parts, where) if known else []
    terms += places
    origins += [None] * len(places)
    framed = np.concatenate([np.zeros(0, int), *(term.columns[:, 0] for term in places)]).astype(int)
    if known is None or not known.holds(names, landmarks.ids):
        framed = framed[:0]
    for part in _first_of_groups(parts, terms, len(x0), framed):
        fixed[part.start : part.start + 3] = True
    terms += _priors(parts, prior, x0, landmark_start + np.arange(2 * len(landmarks)))
    origins += [None] * (len(terms) - len(origins))
    angles = np.concatenate([part.start + 3 * np.arange(len(part.instants.t)) + 2 for part in parts])
    problem = Problem(x0, terms, fixed, wrapping(angles))
    return TeamProblem(parts, landmarks.ids, landmark_start, problem, tuple(origins), used)


def _nodes(n: int, landmarks: int, parameters: int) -> Int[np.ndarray, " n"]:
    """Which entries of x belong together: a pose, a landmark, a calibration."""
    at = np.arange(n)
    place = landmarks + (at - landmarks) // 2
    return np.where(at < landmarks, at // 3, np.where(at < parameters, place, n + (at - parameters) // len(PARAMETERS)))


def _scan_terms(parts: Sequence[RobotPart], crossings: Sequence[InterRobotEdge]) -> list[Factor]:
    """Every robot's own pose graph, and for each pair of robots their keyframes that were matched."""
    terms = [scan_factor(part, part.scans) for part in parts if part.scans is not None and len(part.scans) > 1]
    by = {part.robot: part for part in parts}
    pairs: dict[tuple[str, str], list[InterRobotEdge]] = {}
    for crossing in crossings:
        if crossing.a in by and crossing.b in by:
            pairs.setdefault((crossing.a, crossing.b), []).append(crossing)
    return terms + [inter_robot_factor(by[a], by[b], edges, MOTION_NOISE_OUTLIER) for (a, b), edges in pairs.items()]


def _first_of_groups(
    parts: Sequence[RobotPart], terms: Sequence[Factor], n: int, framed: Int[np.ndarray, " f"]
) -> list[RobotPart]:
    """The first robot of all, and the first of every group that no sighting ties to it: their starts are the frame.

    framed: entries of x that are known in a frame of their own; their groups need none.
    """
    row = np.concatenate([np.repeat(term.columns[:, 0], term.columns.shape[1]) for term in terms])
    column = np.concatenate([term.columns.ravel() for term in terms])
    group = connected_components(sp.csr_array((np.ones(len(row)), (row, column)), shape=(n, n)), directed=False)[1]
    first: dict[int, RobotPart] = {}
    for part in parts:
        first.setdefault(int(group[part.start]), part)
    return [part for k, part in first.items() if k not in set(group[framed].tolist())]


def with_fewer_poses(logs: Sequence[LandmarkLog], cfg: SmoothingConfig, scanning: Collection[str]) -> SmoothingConfig:
    """`cfg` with steps so long that about `most_poses` of `logs` are estimated; as it is where fewer are.

    The time and the memory that a team takes grow faster than its poses: a hundred robots with a pose each half a
    second would take 13 GB. scanning: robots whose poses stand at their keyframes.
    """
    seen_at = seen_when(logs, [log.robot for log in logs]) if cfg.robot_sightings else {}
    driving, nobody = [log for log in logs if log.robot not in scanning], np.zeros(0)
    while cfg.shortest_step < LONGEST_STEP and sum(
        count_instants(log, seen_at.get(log.robot, nobody), cfg) for log in driving
    ) > most_poses(logs, cfg):
        shortest = min(WIDER * cfg.shortest_step, LONGEST_STEP)
        cfg = replace(cfg, shortest_step=shortest, longest_step=max(cfg.longest_step, 2.5 * cfg.shortest_step))
    return cfg


def most_poses(logs: Sequence[LandmarkLog], cfg: SmoothingConfig) -> int:
    """How many poses of `logs` are estimated, about: where robots see each other, fewer of a team of more than `CROWD`.

    All that are in sight of each other at one time are eliminated together: a pose costs the square of their number.
    """
    crowd = len(logs) if cfg.robot_sightings else 0
    return round(cfg.most_poses * min(1.0, CROWD / max(crowd, 1)) ** 2)


def seen_when(logs: Sequence[LandmarkLog], names: Sequence[str]) -> dict[str, Float[np.ndarray, " s"]]:
    """When each robot was sighted by another."""
    out: dict[str, list[np.ndarray]] = {name: [np.zeros(0)] for name in names}
    for log in logs:
        for table in (log.sightings, log.bearings):
            for k, name in enumerate(table.ids):
                if name in out and name != log.robot:
                    out[name].append(table.t[table.what == k])
    return {name: np.concatenate(parts) for name, parts in out.items()}


def prior_of(
    known: Mapping[str, tuple[float, float]], cfg: CalibrationPrior, *, wheels: bool
) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "5"]]:
    """Mean and standard deviation of each parameter; 0 holds it, as speed, turn and lag of a robot without odometry."""
    mean = np.array([known.get(p, (getattr(cfg, p), 0.0))[0] for p in PARAMETERS], float)
    sd = np.array([known[p][1] if p in known else getattr(cfg, f"{p}_sd") for p in PARAMETERS], float)
    if not wheels:
        sd[[SPEED, TURN, LAG]] = 0.0
    return mean, sd


def _priors(
    parts: Sequence[RobotPart],
    prior: Sequence[tuple[np.ndarray, np.ndarray]],
    x0: Float[np.ndarray, " n"],
    landmarks: Int[np.ndarray, " k"],
) -> list[Factor]:
    """What is known of the calibration; where nobody has wheels or a laser, the map keeps its size."""
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
    if loose and all(part.motion is None and part.scans is None for part in parts):
        out.append(_size(x0, landmarks) if len(landmarks) > 2 else _mean_range_scale(loose, prior))
    return out


def _mean_range_scale(loose: Sequence[int], prior: Sequence[tuple[np.ndarray, np.ndarray]]) -> Factor:
    held = np.array([loose])
    n = len(loose)
    centre = float(np.mean([m[RANGE] for m, _ in prior]))
    return Factor(
        held,
        lambda x: x[held].mean(axis=1, keepdims=True) - centre,
        lambda _: np.full((1, 1, n), 1.0 / n),
        1,
        np.array([[1.0 / HELD_TOGETHER]]),
        None,
        "scale",
    )


def _size(x0: Float[np.ndarray, " n"], landmarks: Int[np.ndarray, " k"]) -> Factor:
    """The landmarks are spread as widely as at the start: ranges alone tell the size, and the filters had them all.

    Their errors are one-sided, so that another weighting is another size, not a better one.
    """
    columns = landmarks[None]

    def spread(x: np.ndarray) -> tuple[np.ndarray, float]:
        away = x[landmarks].reshape(-1, 2) - x[landmarks].reshape(-1, 2).mean(axis=0)
        return away, float(np.square(away).sum())

    before = spread(x0)[1]

    def residual(x: np.ndarray) -> np.ndarray:
        return np.array([[0.5 * np.log(spread(x)[1] / before)]])

    def jacobian(x: np.ndarray) -> np.ndarray:
        away, square = spread(x)
        return np.asarray((away / square).reshape(1, 1, -1))

    return Factor(columns, residual, jacobian, 1, np.array([[1.0 / HELD_TOGETHER]]), None, "size")
