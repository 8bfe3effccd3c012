"""How well any estimator can place the landmarks of a simulated mixed team: the Cramer-Rao bound of its recording.

Everything is linearised at the truth, with the very noise that the simulator drew: errors of a camera that fade over
seconds, slip of the wheels that does too, and what is known of calibrations beforehand. A robot with a laser is taken
to know its own ways without error, and those of all lasers in one frame; so the bound is lower than what lasers allow.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from mapweave.core.records import Odometry, Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.sim import landmarks as camera
from mapweave.sim import landmarks as driving
from mapweave.sim.mixed_team import MixedRecording, MixedRobot
from mapweave.solve import Factor
from mapweave.team.config import SmoothingConfig
from mapweave.team.problem import TeamProblem, team_problem
from mapweave.team.robot_part import PARAMETERS, RobotPart

FINE = 0.1  # [s] between values of slip
LEAST = 1e-3  # [m], [rad] sd of a step besides slip
TINY = 1e-9  # information on everything, so that what nothing tells can be left out
RANGES = (camera.RANGE_MEMORY, camera.RANGE_WHITE)
BEARINGS = (camera.BEARING_MEMORY, camera.BEARING_WHITE)


def landmark_bound(recording: MixedRecording) -> float:
    """Least expected RMS error [m] of all landmarks, the map laid on the truth as a body."""
    team = _at_truth(recording)
    x, n = team.problem.x0, len(team.problem.x0)
    robots = {robot.name: robot for robot in recording.robots}
    fixed = np.zeros(n, bool)
    for part in team.parts:
        fixed[part.start : part.start + 3 * len(part.instants.t)] = robots[part.robot].carries.laser
    if not fixed.any():
        fixed[:3] = True
    rows: list[sp.csr_array] = []
    for term, origin in zip(team.factors, team.origins, strict=True):
        J = term.jacobian(x)
        if origin is None or term.name == "wandering":
            W = term.sqrt_info
            J = J if W is None else W[..., None] * J if W.ndim == 2 else W @ J
            rows.append(_rows(J.reshape(-1, J.shape[2]), np.repeat(term.columns, J.shape[1], axis=0), n))
        elif term.name == "odometry":
            rows += _driven(team.parts[origin.robot], J, term.columns, n)
        else:
            rows += _seen(term, origin.t, J, x)
    A, free = sp.csc_array(sp.vstack(rows)), np.flatnonzero(~fixed)
    H = sp.csc_array((A.T @ A).tocsr()[free][:, free] + TINY * sp.eye_array(len(free)))
    place = np.searchsorted(free, team.landmark_columns)
    unit = np.zeros((len(free), len(place)))
    unit[place, np.arange(len(place))] = 1.0
    C = splu(H).solve(unit)[place]
    B = _without_motion(x[team.landmark_columns].reshape(-1, 2))
    return float(np.sqrt(np.trace(B @ C @ B.T) / (len(place) / 2)))


def _at_truth(recording: MixedRecording) -> TeamProblem:
    """The team's problem with every variable at its true value; its noise is the estimator's, which is not used."""
    ids, places = tuple(recording.landmarks), np.array(list(recording.landmarks.values()))
    landmarks = LandmarkMap(ids, places, np.zeros((places.size, places.size)))
    tracks = {r.name: Track(camera.START + r.drive.t, r.drive.pose) for r in recording.robots}
    team = team_problem([_log(r) for r in recording.robots], landmarks, tracks, {}, {}, SmoothingConfig())
    drives = {r.name: r.drive for r in recording.robots}
    for part in team.parts:
        at = part.parameters + np.arange(len(PARAMETERS))
        team.problem.x0[at] = [getattr(drives[part.robot], name) for name in PARAMETERS]
    return team


def _log(robot: MixedRobot) -> LandmarkLog:
    """What the robot drove and saw; one with a laser and nothing else is there from first to last."""
    far = np.isfinite(robot.seen.range)
    commands = robot.commands
    if commands is None and not len(robot.seen.t):
        commands = np.column_stack([camera.START + robot.drive.t[[0, -1]], np.zeros((2, 2))])
    odometry = None
    if commands is not None:
        t, first = np.unique(commands[:, 0], return_index=True)
        odometry = Odometry(t, commands[first, 1], commands[first, 2])
    return LandmarkLog(robot.name, odometry, _table(robot, far), bearings=_table(robot, ~far))


def _table(robot: MixedRobot, keep: np.ndarray) -> SightingTable:
    if not keep.any():
        return NOTHING_SEEN
    names, what = np.unique(np.array(robot.seen.ids)[keep], return_inverse=True)
    seen = robot.seen
    return SightingTable(seen.t[keep], what, seen.range[keep], seen.bearing[keep], tuple(names.tolist()))


def _seen(term: Factor, t: np.ndarray, J: np.ndarray, x: np.ndarray) -> list[sp.csr_array]:
    """Sightings of each target, whitened together."""
    to = x[term.columns[:, 3:5]] - x[term.columns[:, :2]]
    sd_range = np.hypot(camera.RANGE_FLOOR, camera.RANGE_SLOPE * np.hypot(to[:, 0], to[:, 1]))
    target = term.columns[:, 3] if term.name == "landmark" else np.zeros(len(t), int)
    assert term.sqrt_info is not None  # noqa: S101  ((m, 2): 0 where no range was told)
    out = []
    for which in np.unique(target):
        for k, (sd, faded) in enumerate(((sd_range, RANGES), (np.full(len(t), camera.BEARING_SIGMA), BEARINGS))):
            at = np.flatnonzero((target == which) & (term.sqrt_info[:, k] > 0))
            if len(at):
                C = sd[at, None] * _remembered(t[at], *faded) * sd[at]
                out.append(_whitened(J[at, k], term.columns[at], C, len(x)))
    return out


def _driven(part: RobotPart, J: np.ndarray, columns: np.ndarray, n: int) -> list[sp.csr_array]:
    """Steps of a robot with wheels: slip ahead and in turning, each whitened together; aside what turning gives."""
    log, t, k = part.motion, part.instants.t, part.instants.steps
    assert log is not None  # noqa: S101  (odometry)
    fine = np.arange(t[0], t[-1], FINE)
    row = np.clip(np.searchsorted(log.t, fine, side="right") - 1, 0, None)
    step = np.clip(np.searchsorted(t, fine, side="right") - 1, 0, len(t) - 2)
    v, w = np.abs(log.v[row]), np.abs(log.w[row])
    fade = _remembered(fine, driving.SLIP_MEMORY, 0.0)
    cov = []
    for sd in (driving.SLIP_V * v + driving.CREEP_V * (v > 0), driving.SLIP_W * w + driving.CREEP_W * (v > 0)):
        S = sp.csr_array((FINE * sd, (step, np.arange(len(fine)))), shape=(len(t) - 1, len(fine)))
        cov.append((np.asarray(S @ (S @ fade).T) + LEAST**2 * np.eye(len(t) - 1))[np.ix_(k, k)])
    way = np.bincount(step, FINE * log.v[row], minlength=len(t) - 1)[k]
    aside = J[:, 1] - 0.5 * way[:, None] * J[:, 2]
    return [
        _whitened(J[:, 0], columns, cov[0], n),
        _whitened(aside, columns, LEAST**2 * np.eye(len(k)), n),
        _whitened(J[:, 2], columns, cov[1], n),
    ]


def _remembered(t: np.ndarray, memory: float, white: float) -> np.ndarray:
    """Correlations of an error of which a share is new every time and the rest fades."""
    return np.asarray((1.0 - white) * np.exp(-np.abs(t[:, None] - t) / memory) + white * np.eye(len(t)))


def _whitened(J: np.ndarray, columns: np.ndarray, C: np.ndarray, n: int) -> sp.csr_array:
    return sp.csr_array(np.linalg.inv(np.linalg.cholesky(C))) @ _rows(J, columns, n)


def _rows(J: np.ndarray, columns: np.ndarray, n: int) -> sp.csr_array:
    row = np.repeat(np.arange(len(J)), J.shape[1])
    return sp.csr_array((J.ravel(), (row, columns.ravel())), shape=(len(J), n))


def _without_motion(points: np.ndarray) -> np.ndarray:
    """What takes shifts and turns of all points as a body out of their errors."""
    M = np.zeros((points.size, 3))
    M[0::2, 0] = M[1::2, 1] = 1.0
    M[0::2, 2], M[1::2, 2] = -points[:, 1], points[:, 0]
    return np.asarray(np.eye(points.size) - M @ np.linalg.pinv(M))
