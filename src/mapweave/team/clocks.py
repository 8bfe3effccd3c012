"""Clocks that are off: a camera's from those of its robot's wheels, a robot's from those of the others.

`on_camera_clock` asks a robot's own log. Between two frames a landmark moves in the picture as the wheels say that the
robot did: mostly it turns the other way. Carried from one frame to the next by what the wheels told some seconds
earlier or later, bearings fit when the shift is that between both clocks; no map and no filter is needed.

`clock_of` moves a robot's stamps along smoothed paths as they are, by what robots saw of each other. `clocks_of` asks
how such sightings in a smoothed team's problem still pull. Were a robot's stamps moved by `a`, it would have been seen
where it was at another time: its place at the stamp moves along its velocity v, so that `J_a = J_p v` for the one that
was seen and `-J_p v` for the one that saw it. At the minimum over all else (x) the clocks' own minimum is one step
away: `a = -S^-1 g` with `S = H_aa - H_ax H_xx^-1 H_xa`, the trajectories being free to bend (a score test; Rao, 1948).
Its scatter is measured by groups of factors, as that of landmarks and calibration is.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry
from ..core.rows import spread
from ..landmarks.ekf_slam import is_landmark
from ..solve import Solution
from .config import MOTION_NOISE_HOLD, CalibrationPrior, PlacingConfig, sharpened
from .covariance import Groups, scores
from .problem import Origin, TeamProblem
from .relation import costs
from .relative_frame import CLOCK_FINE, CLOCK_FINE_STEP, CLOCK_SIGHTINGS, CLOCK_TOGETHER, Body, Labels, mutual_sightings
from .robot_part import CommandedMotion
from .team_map import TeamMap

CAMERA_CLOCK_REACH = 5.0  # [s] looked for either way,
CAMERA_CLOCK_STEP = 0.1  # and the steps
CAMERA_CLOCK_APART = 1.5  # [s] between two sightings of one landmark that are compared, at most
CAMERA_CLOCK_MOST = 800  # pairs compared
CAMERA_CLOCK_FEW = 100  # pairs below which nothing is told
CAMERA_CLOCK_BEARING = 0.05  # [rad] by which a bearing carried along errs
CAMERA_CLOCK_LEAST = 0.5  # [s] from which a clock is off: less is how late wheels obey and cameras tell
CAMERA_CLOCK_GAIN = 30.0  # cost that the shift must take away,
CAMERA_CLOCK_SHARE = 0.35  # and that share of it


def on_camera_clock(log: LandmarkLog) -> LandmarkLog:
    """The log with its wheels' stamps on the camera's clock, told, where that is clearly another one.

    The camera's stamps stay: other robots' clocks are compared with them.
    """
    ahead = camera_ahead(log)
    if not ahead or log.odometry is None:
        return log
    where = "ahead of" if ahead > 0 else "behind"
    told: dict[str, float | str] = {"value": abs(ahead), "way": where}
    found = Finding("camera-clock", log.robot, value=told, action="the wheels' stamps were moved to them")
    return replace(log, odometry=replace(log.odometry, t=log.odometry.t + ahead), findings=(*log.findings, found))


def camera_ahead(log: LandmarkLog) -> float:
    """By how much [s] the camera's stamps are ahead of the wheels'; 0 where they are not clearly, or nothing tells."""
    if log.odometry is None or not len(log.odometry.t):
        return 0.0
    a, b = _pairs(log).T
    if len(a) < CAMERA_CLOCK_FEW:
        return 0.0
    shift = CAMERA_CLOCK_STEP * np.arange(
        -round(CAMERA_CLOCK_REACH / CAMERA_CLOCK_STEP), round(CAMERA_CLOCK_REACH / CAMERA_CLOCK_STEP) + 1
    )
    cost = _costs(log.sightings, log.odometry, a, b, shift)
    k, usual = int(np.argmin(cost)), float(cost[np.abs(shift) < CAMERA_CLOCK_LEAST].min())
    if not np.isfinite(cost).all():
        return 0.0
    gain = usual - float(cost[k])
    return float(shift[k]) if gain > max(CAMERA_CLOCK_GAIN, CAMERA_CLOCK_SHARE * usual) else 0.0


def _pairs(log: LandmarkLog) -> Int[np.ndarray, "p 2"]:
    """Sightings of a landmark and the next of the same one, spread over the log."""
    seen, successive = log.sightings, [np.zeros((0, 2), np.int64)]
    for k, name in enumerate(seen.ids):
        rows = np.flatnonzero(seen.what == k) if is_landmark(name) else np.zeros(0, np.int64)
        gap = np.diff(seen.t[rows])
        near = (gap > 0.0) & (gap <= CAMERA_CLOCK_APART)
        successive.append(np.column_stack([rows[:-1][near], rows[1:][near]]) if len(rows) else successive[0])
    pairs = np.concatenate(successive)
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    return np.asarray(pairs[spread(len(pairs), CAMERA_CLOCK_MOST)])


def _costs(
    seen: SightingTable,
    wheels: Odometry,
    a: Int[np.ndarray, " p"],
    b: Int[np.ndarray, " p"],
    shift: Float[np.ndarray, " s"],
) -> Float[np.ndarray, " s"]:
    """The Cauchy cost of all pairs for each shift; a command that acts late is no shift."""
    usual = CalibrationPrior()
    motion = CommandedMotion.of(wheels, MOTION_NOISE_HOLD)

    def at(k: Int[np.ndarray, " p"]) -> Float[np.ndarray, "s p 3"]:
        t = (seen.t[k] - shift[:, None]).ravel()
        return motion.at(t, usual.speed_scale, usual.turn_scale, usual.lag)[0].reshape(len(shift), len(k), 3)

    point = seen.range[a, None] * np.stack([np.cos(seen.bearing[a]), np.sin(seen.bearing[a])], axis=-1)
    carried = se2.act(se2.between(at(b), at(a)), point)
    miss = se2.wrap_angle(np.arctan2(carried[..., 1], carried[..., 0]) - seen.bearing[b])
    return np.asarray(np.log1p(np.square(miss / CAMERA_CLOCK_BEARING)).sum(axis=-1))


@dataclass(frozen=True, slots=True)
class RobotClock:
    """ahead: [s] of the team's clock, with its standard deviation."""

    ahead: float
    sd: float


def clock_of(
    robot: str, team: TeamMap, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> RobotClock | None:
    """What the robot's stamps want to be moved by in `team`; None where too little was seen, or all stood still."""
    others = Body({name: track for name, track in team.tracks.items() if name != robot and len(track.t)}, {})
    own = Body({robot: team.tracks[robot]}, {})
    sharp, reach, step = sharpened(cfg), CLOCK_FINE, CLOCK_FINE_STEP
    here = np.zeros(3)

    def cost(ahead: float) -> float:
        z = mutual_sightings(others, replace(own, clock=ahead), logs, labels)
        return np.inf if len(z) < CLOCK_SIGHTINGS else float(costs(z, here, sharp)) / len(z)

    tried = np.arange(-reach, reach + 0.5 * step, step)
    value = np.array([cost(t) for t in tried])
    if not np.isfinite(value).all():
        return None
    middle = float(tried[int(np.argmin(value))])
    near = np.array([middle - step, middle, middle + step])
    bottom = np.array([cost(t) for t in near])
    bend = float(bottom[0] - 2 * bottom[1] + bottom[2]) / step**2
    if bend <= 0 or not np.isfinite(bend):
        return None
    ahead = middle + float(np.clip(0.5 * step * (bottom[0] - bottom[2]) / (bend * step**2), -step, step))
    n = len(mutual_sightings(others, own, logs, labels))
    return RobotClock(ahead, CLOCK_TOGETHER / np.sqrt(2.0 * bend * n))


def of_another_time(logs: Sequence[LandmarkLog]) -> dict[str, float]:
    """Robots that saw another of the team, or were seen, with a log of another time than all others' -> the gap [s].

    One of the two clocks is wrong then, by the gap at least: who stands before a camera drives at that moment.
    """
    spans = {log.robot: log.span for log in logs if len(log)}
    met = {frozenset((log.robot, name)) for log in logs for name in log.sightings.counts() if name in spans}
    out = {}
    for robot, (first, last) in spans.items():
        gaps = [max(a - last, first - b) for other, (a, b) in spans.items() if frozenset((robot, other)) in met]
        everybody = [max(a - last, first - b) for other, (a, b) in spans.items() if other != robot]
        if gaps and min(everybody) > 0.0:
            out[robot] = min(everybody)
    return out


@dataclass(frozen=True, slots=True)
class _Met:
    """m sightings of robots by the robot of `origin`. target: (m,) whom; columns: (m, d) entries of x they are of.

    pull: (m,) on the target's clock, and the other way on the observer's; information: (m,) on it; across: (m, d) on it
    and the entries of x.
    """

    origin: Origin
    target: Int[np.ndarray, " m"]
    columns: Int[np.ndarray, "m d"]
    pull: Float[np.ndarray, " m"]
    information: Float[np.ndarray, " m"]
    across: Float[np.ndarray, "m d"]


def clocks_of(
    team: TeamProblem, solution: Solution, suspect: float, length: float, also: Collection[str] = ()
) -> dict[str, RobotClock]:
    """The clocks of robots that look off, robot -> how far ahead of the usual one [s]; and of those of `also`.

    suspect: [s] from which one looks off while trajectories are held, which shows a part of what it is off; length: [s]
    over which errors are correlated. The usual clock of robots connected by sightings of each other is that of the one
    in their middle; of two, the first one's.
    """
    met = _met(team, solution.x)
    if not met or solution.information is None:
        return {}
    R = len(team.parts)
    C, g = np.zeros((R, R)), np.zeros(R)
    for z in met:
        k, a, b = z.origin.robot, np.bincount(z.target, z.information, R), np.bincount(z.target, z.pull, R)
        C += np.diag(a)
        C[k, k] += a.sum()
        C[k] -= a
        C[:, k] -= a
        g += b
        g[k] -= b.sum()
    named = {k for k, part in enumerate(team.parts) if part.robot in also}
    chosen = _suspects(C, g, suspect, named)
    if not len(chosen):
        return {}
    B, pulls = _coupling(solution, met, chosen, Groups.of(team, length))
    K = solution.information.solve(B)
    try:
        P = np.linalg.inv(C[np.ix_(chosen, chosen)] - B.T @ K)
    except np.linalg.LinAlgError:
        return {}
    of_all = scores(team, solution.x, Groups.of(team, length))[:, solution.free]
    ahead, sd = -P @ g[chosen], np.sqrt(np.square((pulls - of_all @ K) @ P).sum(axis=0))
    offsets = zip(chosen.tolist(), ahead.tolist(), sd.tolist(), strict=True)
    return {team.parts[k].robot: RobotClock(a, s) for k, a, s in offsets if np.isfinite(a) and np.isfinite(s)}


def _suspects(
    C: Float[np.ndarray, "r r"], g: Float[np.ndarray, " r"], suspect: float, named: Collection[int]
) -> Int[np.ndarray, " s"]:
    """Robots whose clocks pull away from their group's usual one, trajectories held, and those named.

    Of every group one stays the clock that the others are told against.
    """
    held = -np.linalg.pinv(C, rcond=1e-9, hermitian=True) @ g
    group = connected_components(sp.csr_array(C), directed=False)[1]
    out: list[int] = []
    for k in np.unique(group):
        robots = np.flatnonzero(group == k)
        middle = float(np.median(held[robots]))
        usual = min(robots.tolist(), key=lambda r: (r in named, round(abs(held[r] - middle), 9), r))
        off = [r for r in robots.tolist() if r in named or abs(held[r] - held[usual]) >= suspect]
        out += [r for r in off if r != usual]
    return np.array(sorted(out), np.int64)


def _coupling(
    solution: Solution, met: Sequence[_Met], chosen: Int[np.ndarray, " s"], groups: Groups
) -> tuple[Float[np.ndarray, "f s"], Float[np.ndarray, "groups s"]]:
    """The information on the chosen clocks and the free variables, and the pull of each group on the clocks."""
    n = len(solution.free)
    position = np.full(len(solution.x), n)
    position[solution.free] = np.arange(n)
    B, pulls = np.zeros((n + 1, len(chosen))), np.zeros((len(groups), len(chosen)))
    for z in met:
        row = groups.rows(z.origin)
        for column, k in enumerate(chosen.tolist()):
            seen = np.flatnonzero(z.target == k)
            sign, m = (-1.0, np.arange(len(row))) if k == z.origin.robot else (1.0, seen)
            if len(m):
                np.add.at(B[:, column], position[z.columns[m]], sign * z.across[m])
                pulls[:, column] += sign * np.bincount(row[m], z.pull[m], len(groups))
    return B[:n], pulls


def _met(team: TeamProblem, x: Float[np.ndarray, " n"]) -> list[_Met]:
    starts, velocities = np.array([p.start for p in team.parts]), {}
    out = []
    for term, origin in zip(team.factors, team.origins, strict=True):
        if origin is None or term.name != "robot":
            continue
        W, J = term.sqrt_info, term.jacobian(x)
        J = J if W is None else W[..., None] * J
        target = np.searchsorted(starts, term.columns[:, 3], side="right") - 1
        v = np.empty((len(target), 2))
        for k in np.unique(target).tolist():
            if k not in velocities:
                velocities[k] = _velocity(team, k, x)
            rows, at = np.flatnonzero(target == k), team.parts[k].instants.t
            v[rows] = np.stack([np.interp(origin.t[rows], at, velocities[k][:, c]) for c in (0, 1)], axis=-1)
        by_clock, weight = np.einsum("mkd,md->mk", J[:, :, 3:5], v), term.weights(x)
        out.append(
            _Met(
                origin,
                target,
                term.columns,
                weight * (by_clock * term.whitened(x)).sum(axis=1),
                weight * np.square(by_clock).sum(axis=1),
                weight[:, None] * np.einsum("mk,mkd->md", by_clock, J),
            )
        )
    return out


def _velocity(team: TeamProblem, k: int, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k 2"]:
    part = team.parts[k]
    place = x[part.start : part.start + 3 * len(part.instants.t)].reshape(-1, 3)[:, :2]
    return np.gradient(place, part.instants.t, axis=0) if len(place) > 1 else np.zeros_like(place)
