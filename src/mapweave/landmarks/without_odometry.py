"""EKF-SLAM of a robot without odometry: a piece of map for each stretch between long blinks, tied into one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Track
from ..solve import gauss_newton, wrapping
from .config import (
    EKF_SLAM_ASTRAY,
    PIECE_BASELINE,
    PIECE_CHI2,
    PIECE_FLOOR,
    PIECE_GAP,
    PIECE_MISFIT,
    PIECE_SIGHTINGS,
    EkfSlamConfig,
)
from .ekf_replay import ReplayedLog, replay
from .ekf_slam import is_landmark
from .landmark_map import LandmarkMap, Submap

PIECE_HEADING = 0.9  # [rad] standard deviation of the heading from which a new piece is begun too

STEPS = 50  # at most
STILL = 1e-9  # [m], [rad] in a step, from which nothing moves any more
SUSPECTS = 4  # largest pieces any of which may be the wrong one


@dataclass(frozen=True, slots=True)
class JoinedPieces:
    """One map of several pieces, in the frame of piece `root`.

    frames: `T_root_piece` of each piece tied, by its index; cov: over all frames (3 each, x y theta, in the order of
    `frames`; the root's rows are zero), then the landmarks of `ids` (2 each).
    """

    root: int
    frames: dict[int, Float[np.ndarray, "3"]]
    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]

    def frame_rows(self, piece: int) -> slice:
        k = 3 * list(self.frames).index(piece)
        return slice(k, k + 3)

    @property
    def landmark_cov(self) -> Float[np.ndarray, "k k"]:
        first = 3 * len(self.frames)
        return self.cov[first:, first:]


def join_pieces(pieces: Sequence[LandmarkMap]) -> JoinedPieces:
    """The largest map the pieces give; a piece that fits the others badly, or shares too little, is left out.

    A large piece that is wrong itself would push out all that are right: when pieces had to go, it is tried to do
    without one of the largest instead, and what ties most landmarks, then most pieces, is taken.
    """
    best = _tie(pieces, set())
    if any(len(set(piece.ids) & set(best.ids)) > 2 for k, piece in enumerate(pieces) if k not in best.frames):
        large = sorted(range(len(pieces)), key=lambda k: (-len(pieces[k]), k))[:SUSPECTS]
        best = max([best, *(_tie(pieces, {k}) for k in large)], key=lambda tied: (len(tied.ids), len(tied.frames)))
    return best


def _tie(pieces: Sequence[LandmarkMap], without: set[int]) -> JoinedPieces:
    """The map of all pieces but those in `without` and those that fit the others badly."""
    left_out = set(without)
    while True:
        frames, root, places = _start(pieces, left_out)
        tied, worst, misfit = _adjust(pieces, frames, root, places)
        if misfit <= PIECE_CHI2 or len(frames) == 1:
            return tied
        left_out.add(worst)


def _start(
    pieces: Sequence[LandmarkMap], left_out: set[int]
) -> tuple[dict[int, np.ndarray], int, dict[str, list[np.ndarray]]]:
    """Rigid fits, the piece with most landmarks first, then whichever shares most with those tied already."""
    free = [k for k in range(len(pieces)) if k not in left_out]
    root = max(free, key=lambda k: (len(pieces[k]), -k))
    frames = {root: np.zeros(3)}
    places = {name: [p] for name, p in zip(pieces[root].ids, pieces[root].mean, strict=True)}
    waiting = [k for k in free if k != root]
    while waiting:
        shared = {k: [name for name in pieces[k].ids if name in places] for k in waiting}
        k = max(waiting, key=lambda k: (len(shared[k]), -k))
        if len(shared[k]) < 2:
            break
        waiting.remove(k)
        here = pieces[k].select(shared[k]).mean
        there = np.array([np.mean(places[name], axis=0) for name in shared[k]])
        if len(here) == 2 and np.hypot(*(there[1] - there[0])) < PIECE_BASELINE:
            continue
        T = se2.align(here, there)
        if np.sqrt(((se2.act(T, here) - there) ** 2).sum(axis=1).mean()) > PIECE_MISFIT:
            continue
        frames[k] = T
        for name, p in zip(pieces[k].ids, se2.act(T, pieces[k].mean), strict=True):
            places.setdefault(name, []).append(p)
    return frames, root, places


def _adjust(
    pieces: Sequence[LandmarkMap],
    frames: dict[int, np.ndarray],
    root: int,
    places: dict[str, list[np.ndarray]],
) -> tuple[JoinedPieces, int, float]:
    """Gauss-Newton over frames and landmarks; the tied map, the piece that fits worst and its chi-square per dof.

    Pieces that contradict each other so much that no minimum is found misfit infinitely.
    """
    ids = tuple(sorted(places))
    where = {name: k for k, name in enumerate(ids)}
    order = list(frames)  # the root is first
    first = 3 * len(order)
    size = first + 2 * len(ids)
    points = [first + 2 * np.array([where[name] for name in pieces[k].ids]) for k in order]
    weights = [np.linalg.inv(pieces[k].cov + PIECE_FLOOR**2 * np.eye(2 * len(pieces[k]))) for k in order]
    misfits = np.zeros(len(order))

    def normal(x: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, float]:
        H, g, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for a, (k, at, W) in enumerate(zip(order, points, weights, strict=True)):
            L = x[at[:, None] + np.arange(2)]
            columns, J, e = _linearise(pieces[k], x[3 * a : 3 * a + 3], L, 3 * a, at)
            H[np.ix_(columns, columns)] += J.T @ W @ J
            g[columns] += J.T @ W @ e
            misfits[a] = float(e @ W @ e) / max(len(e) - 3, 1)
            cost += float(e @ W @ e)
        return H, g, cost

    x0 = np.concatenate([*(frames[k] for k in order), *(np.mean(places[name], axis=0) for name in ids)])
    held = np.arange(size) < 3
    angles = wrapping(np.arange(2, first, 3))
    solution = gauss_newton(normal, x0, max_iterations=STEPS, step_tolerance=STILL, held=held, retract=angles)
    adjusted = {k: solution.x[3 * a : 3 * a + 3] for a, k in enumerate(order)}
    worst = int(np.argmax(misfits[1:])) + 1 if len(order) > 1 else 0
    misfit = float(misfits[worst])
    try:
        cov = solution.covariance()
    except np.linalg.LinAlgError:
        cov, misfit = np.full((size, size), np.inf), np.inf
    return JoinedPieces(root, adjusted, ids, solution.x[first:].reshape(-1, 2), cov), order[worst], misfit


def _linearise(
    piece: LandmarkMap, T: np.ndarray, L: np.ndarray, frame: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of the unknowns, and the residual of the piece's landmarks, `T^-1 L` less where it has them."""
    n = len(L)
    R = se2.rotation(float(T[2]))
    q = (L - T[:2]) @ R
    J = np.zeros((2 * n, 3 + 2 * n))
    J[0::2, :2], J[1::2, :2] = -R[:, 0], -R[:, 1]
    J[0::2, 2], J[1::2, 2] = q[:, 1], -q[:, 0]
    for k in range(n):
        J[2 * k : 2 * k + 2, 3 + 2 * k : 5 + 2 * k] = R.T
    columns = np.concatenate([frame + np.arange(3), (points[:, None] + np.arange(2)).ravel()])
    return columns, J, (q - piece.mean).ravel()


Known = dict[tuple[int, int], tuple[Bool[np.ndarray, " k"], ReplayedLog]]  # rows of a part -> what came of it


def replay_in_pieces(log: LandmarkLog, cfg: EkfSlamConfig, known: Known | None = None) -> ReplayedLog:
    """The largest map that pieces without a gap longer than `cfg.piece_gap` give; poses at every sighting stamp.

    Its frame is the first pose of the first piece tied, its covariance that relative to the largest piece. known:
    parts of this very log that were played before, whose rows are the same, and which are not played again; those
    played now are added.
    """
    played = _play_parts(log, cfg, {} if known is None else known)
    maps = [_piece(done, PIECE_SIGHTINGS) for done in played]
    able = [k for k, m in enumerate(maps) if len(m) >= 2]
    if len(played) <= 1 or not able:
        return played[0] if played else replay(log, cfg)
    tied = join_pieces([maps[k] for k in able])
    where = {able[k]: k for k in tied.frames}  # part -> piece, for the parts tied
    first = min(where)
    T_local_root = se2.inverse(tied.frames[where[first]])
    frame = played[0].submap.frame
    landmarks = LandmarkMap(tied.ids, tied.mean, tied.landmark_cov).moved(T_local_root, frame)
    track = _track(played, tied, where, T_local_root, EKF_SLAM_ASTRAY)
    findings: tuple[Finding, ...] = ()
    if len(where) < len(played):
        apart = {"value": len(played) - len(where), "all": len(played)}
        findings = (Finding("pieces-apart", log.robot, value=apart, action="left out"),)
    nis, weight = (np.concatenate([getattr(done, name) for done in played]) for name in ("nis", "weight"))
    submap = _submap(log.robot, landmarks, track, played, tied, where, T_local_root)
    return ReplayedLog(log.sightings, played[first].x, played[first].P, submap, track, nis, weight, findings)


def _play_parts(log: LandmarkLog, cfg: EkfSlamConfig, known: Known) -> list[ReplayedLog]:
    """A filter's run for each part between long gaps; it ends early, and another begins, where the heading is lost."""
    played, filtered = [], replace(cfg, smooth=False)
    waiting = parts(log.sightings, PIECE_GAP)[::-1]
    while waiting:
        part = waiting.pop()
        key = (int(part[0]), int(part[-1]))
        if key in known:
            ended, done = known[key]
        else:
            track = replay(replace(log, sightings=log.sightings.select(part)), filtered).track
            lost = np.zeros(0) if track.cov is None else track.t[track.cov[:, 2, 2] > PIECE_HEADING**2]
            ended = np.ones(len(part), bool)
            if len(lost) and lost[0] > track.t[0]:
                ended = log.sightings.t[part] < lost[0]
            done = replay(replace(log, sightings=log.sightings.select(part[ended])), cfg)
            known[key] = ended, done
        if not ended.all():
            waiting.append(part[~ended])
        played.append(done)
    return played


def parts(seen: SightingTable, gap: float) -> list[np.ndarray]:
    """Rows of each part; a new one begins with the first landmark sighted after more than `gap` [s] without any."""
    landmark = np.array([is_landmark(name) for name in seen.ids], bool)
    rows = np.flatnonzero(landmark[seen.what]) if len(seen) else np.zeros(0, np.int64)
    cuts = rows[1:][np.diff(seen.t[rows]) > gap]
    cuts = np.searchsorted(seen.t, seen.t[cuts], side="left")  # a frame stays whole
    return [part for part in np.split(np.arange(len(seen)), np.unique(cuts)) if len(part)]


def _piece(done: ReplayedLog, enough: int) -> LandmarkMap:
    landmarks, counts = done.submap.landmarks, done.seen.counts()
    return landmarks.select([name for name in landmarks.ids if counts[name] >= enough])


def _track(
    played: list[ReplayedLog], tied: JoinedPieces, where: dict[int, int], T_local_root: np.ndarray, astray: float
) -> Track:
    """Poses of tied pieces in `local_K`; in the others, straight on from tied pose to tied pose and little trusted."""
    ts, poses, covs = [], [], []
    for part, k in where.items():
        own = played[part].track
        T = se2.compose(T_local_root, tied.frames[k])
        rows = tied.frame_rows(k)
        frame_cov = se2.turned_covariance(T_local_root[2], tied.cov[rows, rows])
        own_cov = np.zeros((3, 3)) if own.cov is None else own.cov
        ts.append(own.t)
        poses.append(se2.compose(T, own.pose))
        covs.append(se2.composed_covariance(T, frame_cov, own.pose, own_cov))
    order = np.argsort(np.concatenate(ts))
    t, pose, cov = (np.concatenate(a)[order] for a in (ts, poses, covs))
    lost = np.concatenate([played[k].track.t for k in range(len(played)) if k not in where] or [np.zeros(0)])
    if not len(lost):
        return Track(t, pose, cov, played[0].track.frame)
    nearest = np.abs(lost[:, None] - t[np.clip(np.searchsorted(t, lost)[:, None] + [-1, 0], 0, len(t) - 1)]).min(axis=1)
    guess = np.zeros((len(lost), 3, 3))
    guess[:, 0, 0] = guess[:, 1, 1] = cov[:, :2, :2].max() + (astray * nearest) ** 2
    guess[:, 2, 2] = np.pi**2 / 3.0  # any heading
    all_t = np.concatenate([t, lost])
    order = np.argsort(all_t)
    all_pose = np.concatenate([pose, se2.interpolate(lost, t, pose)])
    return Track(all_t[order], all_pose[order], np.concatenate([cov, guess])[order], played[0].track.frame)


def _submap(
    robot: str,
    landmarks: LandmarkMap,
    track: Track,
    played: list[ReplayedLog],
    tied: JoinedPieces,
    where: dict[int, int],
    T_local_root: np.ndarray,
) -> Submap:
    """Landmarks and the last tied pose, correlated through the frame of its piece."""
    last = max(where)
    own = played[last].track.pose[-1]
    at = int(np.searchsorted(track.t, played[last].track.t[-1]))
    rows = tied.frame_rows(where[last])
    n = 2 * len(landmarks)
    turn = np.eye(3 + n)
    R = se2.rotation(float(T_local_root[2]))
    turn[:2, :2], turn[3:, 3:] = R, np.kron(np.eye(len(landmarks)), R)
    A, _ = se2.compose_jacobians(tied.frames[where[last]], own)
    cross = A @ tied.cov[rows, 3 * len(tied.frames) :]
    cov = np.zeros((3 + n, 3 + n))
    cov[:3, 3:], cov[3:, :3] = cross, cross.T
    cov = turn @ cov @ turn.T
    cov[3:, 3:] = landmarks.cov
    if track.cov is not None:
        cov[:3, :3] = track.cov[at]
    return Submap(robot, track.pose[at], landmarks.ids, landmarks.mean, cov, landmarks.frame)
