"""A fused map made as good as the logs allow: all trajectories, landmarks and calibrations together.

With every robot's clock put right that is clearly off the others': smoothing with a wrong clock bends the trajectories
a little and makes sightings of each other count less; what still pulls tells how far the clock is off (`clocks`). So
stamps are moved as it seems, and the team is smoothed again, until no clock moves any more.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.names import in_order
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import blended
from ..mapping.woven_map import Georeference
from ..solve import Pattern, SingularError, Solution, SolveStatus
from .clocks import RobotClock, clocks_of
from .config import (
    CLOCK_GAIN,
    CLOCK_LEAST,
    CLOCK_ROUNDS,
    CLOCK_STILL,
    CLOCK_SURE,
    CLOCK_SUSPECT,
    CLOCK_TRIED,
    CLUSTER,
    GAIN_SURE,
    MINIMA_APART,
    MINIMA_LEAD,
    MINIMA_SURE,
    SMOOTHING_OTHERWISE,
    CameraNoise,
    SmoothingConfig,
)
from .covariance import TeamCovariance, team_covariance
from .factors import InterRobotEdge
from .known import PlacePriors
from .problem import TeamProblem, most_poses, seen_when, team_problem, with_fewer_poses
from .robot_part import LAG, PARAMETERS, TURN, RobotPart
from .team_map import TeamMap, way_loose

# times the errors of ranges, in a team with a laser: they last, and would bend paths known better
RANGE_BESIDE_LASER = 2.0  # so uncertain are ranges in a team with a laser: errors last, and would bend better paths
BARE_RANGE_SCALE = 0.99  # range as maps made of ranges alone hold it over the true one: nobody has wheels
CLOCK_TOLD = 4.0  # standard deviations from which a clock is told

TORN_FAR = 4.0  # standard deviations, each twice what sightings scatter by, from which one is of another place
TORN_SHARE = 0.05  # of a landmark's sightings: where one in twenty is, it is told (of real landmarks one in 200)
TORN_OTHERS = 3.0  # times the share of all others, beside that
TORN_LEAST = 6  # sightings that are, at least

OBSERVED = 0.7  # share of the prior's standard deviation
Calibration = Mapping[str, tuple[float, float]]  # parameter -> (value, standard deviation)


@dataclass(frozen=True, slots=True)
class Smoothed:
    """One component after smoothing. calibration: a robot each; inflation: of its poses' model covariance.

    prior: what was known of each parameter before; used: factors of each kind; poses: how many were estimated;
    refused: why the map is still the filters', or ""; notes: what else there is to say of how it came about; cost: of
    the problem at its end; clocks: robots whose clocks look off in it; georeference: where fixes put it.
    """

    map: TeamMap
    calibration: Mapping[str, Calibration]
    inflation: Mapping[str, float]
    used: Mapping[str, int]
    poses: int
    iterations: int
    status: str
    prior: Calibration
    refused: str = ""
    notes: tuple[Finding, ...] = ()
    cost: float = 0.0
    clocks: Mapping[str, RobotClock] = field(default_factory=dict)
    georeference: Georeference | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The notes, that the map had to stay the filters' though there was something to smooth, and what is loose."""
        kept = (Finding("not-smoothed", value=self.refused),) if self.refused and self.used else ()
        return (*self.notes, *kept, *way_loose(self.map))


def smooth(
    team: TeamMap,
    logs: Sequence[LandmarkLog],
    labels: Mapping[str, Mapping[str, str]],
    cfg: SmoothingConfig,
    calibration: Mapping[str, Calibration] | None = None,
    scans: Mapping[str, RobotGraph] | None = None,
    crossings: Sequence[InterRobotEdge] = (),
    soften: Sequence[float] = (),
    known: PlacePriors | None = None,
    clocks: Collection[str] = (),
    on_step: Callable[[], None] | None = None,
) -> Smoothed:
    """`team` with all of `logs` (those of its robots) worked into one least-squares problem, started at the filters'.

    labels[robot]: own landmark name -> name in the map. calibration: what is known beforehand of some robots, in place
    of the prior; a standard deviation of 0 holds a value. scans[robot]: the keyframes of a robot with a laser;
    crossings: those of two robots that were matched. soften: before the end, every kernel is so many times as wide, one
    after the other, for starts that are far off: then other ways are gone too, the end that fits best is taken, and one
    elsewhere that fits about as well is told; known: places known beforehand, in the map's frame; clocks: robots whose
    clocks are told however little they are off; on_step: called before every step of the solver. Poses stand at every
    odometry and sighting stamp. Where the problem has no minimum near the start, the map stays as it was and `refused`
    says why. Where nobody has wheels or a laser the map is larger than the filters' by what maps made of ranges alone
    fall short (`bare_range_scale`).
    """
    own = {log.robot: log for log in logs}
    chosen = [own[robot] for robot in team.robots if robot in own]
    scans = scans or {}
    seen_at = seen_when(chosen, team.robots) if cfg.robot_sightings else {}
    tied = scans.keys() | {robot for robot, t in seen_at.items() if len(t) and own[robot].odometry is not None}
    chosen = [
        log
        for log in chosen
        if (len(log.sightings) or len(log.bearings) or log.robot in tied) and len(team.tracks[log.robot].t)
    ]
    if not chosen:
        return _kept(team, cfg, "nobody saw anything")
    wider = assumed(chosen, cfg, scans)
    notes = () if wider.shortest_step == cfg.shortest_step else (_told_of_steps(wider, most_poses(chosen, cfg)),)
    cfg, start = wider, team
    if of_ranges_alone(chosen, scans) and len(team.landmarks) > 2:
        cfg = replace(cfg, calibration=replace(cfg.calibration, range_scale=BARE_RANGE_SCALE))
        start = _enlarged(team, 1.0 / BARE_RANGE_SCALE)
    problem = team_problem(
        chosen, start.landmarks, start.tracks, labels, calibration or {}, cfg, scans, crossings, known=known
    )
    if not set(problem.used) - {"scan"}:
        return _kept(team, cfg, "nobody saw a landmark of the map or another robot", problem)
    pattern = problem.pattern
    solution, *others = _minima(problem, soften, pattern, on_step)
    if not _ended(solution):
        return _kept(team, cfg, f"the problem of the whole team is {solution.status}", problem, solution)
    try:
        cov = team_covariance(problem, solution, start.landmarks.cov, pattern)
    except SingularError as error:
        return _kept(team, cfg, str(error), problem, solution)
    tracks = dict(team.tracks)
    for part, P in zip(problem.parts, cov.poses, strict=True):
        tracks[part.robot] = dense_track(part, solution.x, P)
    m = 2 * len(problem.landmarks)
    mean = solution.x[problem.landmark_start : problem.landmark_start + m].reshape(-1, 2)
    landmarks = LandmarkMap(problem.landmarks, mean, cov.landmarks, team.landmarks.frame)
    return Smoothed(
        map=replace(team, landmarks=landmarks, tracks=tracks),
        calibration=calibration_of(problem, solution, cov),
        inflation={part.robot: f for part, f in zip(problem.parts, cov.inflation, strict=True)},
        used=problem.used,
        poses=sum(len(part.instants.t) for part in problem.parts),
        iterations=solution.iterations,
        status=str(solution.status),
        prior=_prior(cfg),
        notes=(*notes, *_ambiguous(problem, solution, others, cov), *_torn(problem, solution)),
        cost=solution.cost,
        clocks=clocks_of(problem, solution, CLOCK_SUSPECT, CLUSTER, clocks),
    )


def _ended(solution: Solution) -> bool:
    return solution.status not in {SolveStatus.SINGULAR, SolveStatus.DIVERGED} and bool(np.isfinite(solution.x).all())


def _minima(
    problem: TeamProblem, soften: Sequence[float], pattern: Pattern, on_step: Callable[[], None] | None
) -> list[Solution]:
    """Where the problem ends by each way to an end, the best first; by one way where the start is near."""
    ends = []
    for widths in dict.fromkeys([tuple(soften), *(SMOOTHING_OTHERWISE if soften else ())]):
        x = None
        for width in widths:
            x = problem.softened(width).solve(x, pattern, on_step).x
        ends.append(problem.solve(x, pattern, on_step))
    return sorted(ends, key=lambda end: (not _ended(end), end.cost))


def _ambiguous(
    problem: TeamProblem, best: Solution, others: Sequence[Solution], cov: TeamCovariance
) -> tuple[Finding, ...]:
    """That another end fits about as well, by how much it lies apart where it does so most, if one does."""
    lead = MINIMA_LEAD * max(1.0, *cov.inflation)
    m = 2 * len(problem.landmarks)
    spots = np.concatenate(
        [
            problem.landmark_start + np.arange(0, m, 2),
            *(part.start + np.arange(0, 3 * len(part.instants.t), 3) for part in problem.parts),
        ]
    )
    variance = np.concatenate(
        [np.diag(cov.landmarks).reshape(-1, 2).sum(axis=1), *(P[:, 0, 0] + P[:, 1, 1] for P in cov.poses)]
    )
    apart = [np.hypot(*(end.x - best.x)[spots + np.array([[0], [1]])]) for end in others if _as_good(end, best, lead)]
    far = max((float(d[d > MINIMA_SURE * np.sqrt(variance)].max(initial=0.0)) for d in apart), default=0.0)
    return (Finding("fits-otherwise", value=far),) if far > MINIMA_APART else ()


def _torn(problem: TeamProblem, solution: Solution) -> tuple[Finding, ...]:
    """Landmarks of which many sightings lie elsewhere than the rest: two that bear one name bend all they tie."""
    n = len(problem.landmarks)
    count, far = np.zeros((2, n), np.int64)
    for term in problem.factors:
        if term.name == "landmark":
            which = (term.columns[:, 3] - problem.landmark_start) // 2
            off = np.linalg.norm(term.whitened(solution.x), axis=1)
            count += np.bincount(which, minlength=n)
            far += np.bincount(which[off > TORN_FAR], minlength=n)
    rest = (far.sum() - far) / np.maximum(count.sum() - count, 1)  # of the others: wrong sightings are of all alike
    torn = np.flatnonzero((far >= TORN_LEAST) & (far > (TORN_SHARE + TORN_OTHERS * rest) * count)).tolist()
    names = problem.landmarks
    return tuple(
        Finding("landmark-torn", value={"name": names[k], "value": int(far[k]), "all": int(count[k])}) for k in torn
    )


def _as_good(end: Solution, best: Solution, lead: float) -> bool:
    return _ended(end) and end.cost < best.cost + lead


def of_ranges_alone(logs: Sequence[LandmarkLog], scans: Collection[str]) -> bool:
    """Whether nobody has wheels or a laser."""
    return all(log.odometry is None and log.robot not in scans for log in logs)


def assumed(logs: Sequence[LandmarkLog], cfg: SmoothingConfig, scans: Collection[str]) -> SmoothingConfig:
    """`cfg` as it is for these logs: beside a laser ranges count less, and of too many poses some are not estimated."""
    if any(log.robot in scans for log in logs):
        cfg = replace(cfg, camera=_beside_laser(cfg.camera))
    return with_fewer_poses(logs, cfg, scans)


def _told_of_steps(cfg: SmoothingConfig, most: int) -> Finding:
    return Finding("steps-longer", value={"step": cfg.shortest_step, "poses": most})


def _beside_laser(camera: CameraNoise) -> CameraNoise:
    by = RANGE_BESIDE_LASER
    return replace(camera, range_floor=by * camera.range_floor, range_share=by * camera.range_share)


def _enlarged(team: TeamMap, by: float) -> TeamMap:
    """The team with all lengths multiplied by `by`."""
    lengths, m = np.array([by, by, 1.0]), team.landmarks
    tracks = {
        robot: replace(
            track, pose=track.pose * lengths, cov=None if track.cov is None else track.cov * np.outer(lengths, lengths)
        )
        for robot, track in team.tracks.items()
    }
    return replace(team, landmarks=LandmarkMap(m.ids, by * m.mean, by**2 * m.cov, m.frame), tracks=tracks)


def is_observed(parameter: str, sd: float, prior: Calibration) -> bool:
    """Whether the data told clearly more of a parameter than was known beforehand."""
    return sd < OBSERVED * prior[parameter][1]


def _prior(cfg: SmoothingConfig) -> Calibration:
    known = cfg.calibration
    return {name: (getattr(known, name), getattr(known, f"{name}_sd")) for name in PARAMETERS}


def _kept(
    team: TeamMap,
    cfg: SmoothingConfig,
    why: str,
    problem: TeamProblem | None = None,
    solution: Solution | None = None,
) -> Smoothed:
    return Smoothed(
        map=team,
        calibration={},
        inflation={},
        used={} if problem is None else problem.used,
        poses=0 if problem is None else sum(len(part.instants.t) for part in problem.parts),
        iterations=0 if solution is None else solution.iterations,
        status="not tried" if solution is None else str(solution.status),
        prior=_prior(cfg),
        refused=why,
    )


def calibration_of(problem: TeamProblem, solution: Solution, cov: TeamCovariance) -> dict[str, Calibration]:
    """What was found of every robot; parameters that were held are left out."""
    free = np.zeros(len(solution.x), bool)
    free[solution.free] = True
    out: dict[str, Calibration] = {}
    for part, sd in zip(problem.parts, cov.calibration, strict=True):
        at = part.parameters + np.arange(len(PARAMETERS))
        out[part.robot] = {
            name: (float(solution.x[i]), float(d)) for name, i, d in zip(PARAMETERS, at, sd, strict=True) if free[i]
        }
    return out


def dense_track(part: RobotPart, x: Float[np.ndarray, " n"], cov: Float[np.ndarray, "k 3 3"]) -> Track:
    """Poses at every stamp of the log: between instants as commanded, bent so that both ends are met."""
    log, at = part.log, part.instants.t
    poses = x[part.start : part.start + 3 * len(at)].reshape(-1, 3)
    if part.scans is not None:
        t = part.instants.track.t
    else:
        t = np.unique(
            np.concatenate([log.sightings.t, log.bearings.t, *(() if log.odometry is None else (log.odometry.t,))])
        )
    k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, max(len(at) - 2, 0))
    span = np.maximum(at[k + 1] - at[k], 1e-9) if len(at) > 1 else np.ones(len(t))
    share = np.clip((t - at[k]) / span, 0.0, 1.0)
    after = np.minimum(k + 1, len(at) - 1)
    P = (1 - share)[:, None, None] * cov[k] + share[:, None, None] * cov[after]
    if part.scans is not None:
        rows = np.searchsorted(t, at)
        return Track(t, blended(part.instants.track.pose, rows, poses), P)
    if part.motion is None:
        return Track(t, se2.interpolate(t, at, poses), P)
    speed, turn, lag = (float(x[part.parameters + j]) for j in (0, TURN, LAG))
    said_at, said = (part.motion.at(stamp, speed, turn, lag)[0] for stamp in (at, t))
    there = se2.compose(poses[k], se2.between(said_at[k], said))
    end = se2.compose(poses[k], se2.between(said_at[k], said_at[after]))
    miss = se2.log(se2.between(end, poses[after]))
    return Track(t, se2.compose(there, se2.exp(share[:, None] * miss)), P)


def smooth_on_one_clock(
    team: TeamMap,
    logs: Sequence[LandmarkLog],
    labels: Mapping[str, Mapping[str, str]],
    cfg: SmoothingConfig,
    calibration: Mapping[str, Calibration] | None = None,
    soften: Sequence[float] = (),
    known: PlacePriors | None = None,
    on_step: Callable[[], None] | None = None,
) -> Smoothed:
    """`smooth`, stamps of robots whose clocks are off by `cfg.clocks.least` [s] or more moved to the others' clock.

    Of each such robot a sentence stands in its notes, and its clock in `clocks`; where little tells of it, it is told
    and nothing is moved. A team whose clocks are right comes out as `smooth` has it, smoothed once.
    """

    def on(clocks: Mapping[str, float]) -> Smoothed:
        shifted = [with_earlier_stamps(log, clocks.get(log.robot, 0.0)) for log in logs]
        tracks = {r: replace(track, t=track.t - clocks.get(r, 0.0)) for r, track in team.tracks.items()}
        first = replace(team, tracks=tracks) if clocks else team
        return smooth(
            first, shifted, labels, cfg, calibration, soften=soften, known=known, clocks=clocks, on_step=on_step
        )

    as_is = done = on({})
    ahead: dict[str, float] = {}
    for _ in range(CLOCK_ROUNDS):
        wrong = _wrong(done, ahead)
        if not wrong or done.refused:
            break
        ahead.update({robot: ahead.get(robot, 0.0) + by for robot, by in wrong.items()})
        done = on(ahead)
    offsets = {
        r: RobotClock(by, float(np.hypot(done.clocks[r].sd, CLOCK_STILL)))
        for r, by in ahead.items()
        if r in done.clocks and not done.refused
    }
    gain = _gain(as_is, done)
    sure = {r: c for r, c in offsets.items() if _off(c, CLOCK_SURE) and gain >= GAIN_SURE}
    doubtful = {r: c for r, c in offsets.items() if r not in sure and _off(c, CLOCK_TOLD) and gain >= CLOCK_GAIN}
    if set(sure) != set(ahead):
        done = on({r: c.ahead for r, c in sure.items()}) if sure else as_is
    notes = [*done.notes, *(_clock_off(r, c, right=True) for r, c in _in_order(sure))]
    notes += [_clock_off(r, c, right=False) for r, c in _in_order(doubtful)]
    return replace(done, notes=tuple(notes), clocks=sure)


def _wrong(done: Smoothed, corrected: Mapping[str, float]) -> dict[str, float]:
    """By how much [s] the stamps are to be moved yet; those of robots moved before, until they are still."""
    return {
        robot: clock.ahead
        for robot, clock in done.clocks.items()
        if abs(clock.ahead) >= (CLOCK_STILL if robot in corrected else max(CLOCK_LEAST, CLOCK_TRIED * clock.sd))
    }


def _off(clock: RobotClock, deviations: float) -> bool:
    return abs(clock.ahead) >= max(CLOCK_LEAST, deviations * clock.sd)


def _gain(before: Smoothed, after: Smoothed) -> float:
    """The cost that moving clocks took away, beyond that of sightings for which no pose is known any more."""
    n, left = (sum(done.used.values()) for done in (before, after))
    return before.cost * min(1.0, left / max(n, 1)) - after.cost


def with_earlier_stamps(log: LandmarkLog, ahead: float) -> LandmarkLog:
    """The log with its stamps `ahead` [s] earlier."""
    if not ahead:
        return log
    odometry = log.odometry
    return replace(
        log,
        odometry=None if odometry is None else replace(odometry, t=odometry.t - ahead),
        sightings=_earlier(log.sightings, ahead),
        bearings=_earlier(log.bearings, ahead),
        cuts=tuple(t - ahead for t in log.cuts),
        fixes=None if log.fixes is None else replace(log.fixes, t=log.fixes.t - ahead),
    )


def _earlier(table: SightingTable, by: float) -> SightingTable:
    return replace(table, t=table.t - by)


def _in_order(clocks: Mapping[str, RobotClock]) -> list[tuple[str, RobotClock]]:
    return sorted(clocks.items(), key=lambda item: in_order(item[0]))


def _clock_off(robot: str, clock: RobotClock, *, right: bool) -> Finding:
    far: dict[str, float | str] = {
        "value": abs(clock.ahead),
        "way": "ahead of" if clock.ahead > 0 else "behind",
        "sd": clock.sd,
    }
    if right:
        return Finding("robot-clock", robot, value=far, action="its stamps were moved")
    return Finding("robot-clock-maybe", robot, value=far, action="too little tells to move it")
