"""EKF-SLAM of a robot without odometry: a piece of map for each stretch between long blinks, tied into one."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Track
from .config import EkfSlamConfig
from .ekf_replay import ReplayedLog, replay
from .ekf_slam import is_landmark
from .landmark_map import LandmarkMap, Submap
from .pieces import JoinedPieces, join_pieces

Known = dict[tuple[int, int], tuple[Bool[np.ndarray, " k"], ReplayedLog]]  # rows of a part -> what came of it


def replay_in_pieces(log: LandmarkLog, cfg: EkfSlamConfig, known: Known | None = None) -> ReplayedLog:
    """The largest map that pieces without a gap longer than `cfg.piece_gap` give; poses at every sighting stamp.

    Its frame is the first pose of the first piece tied, its covariance that relative to the largest piece. known:
    parts of this very log that were played before, whose rows are the same, and which are not played again; those
    played now are added.
    """
    played = _play_parts(log, cfg, {} if known is None else known)
    maps = [_piece(done, cfg.piece_sightings) for done in played]
    able = [k for k, m in enumerate(maps) if len(m) >= 2]
    if len(played) <= 1 or not able:
        return played[0] if played else replay(log, cfg)
    tied = join_pieces([maps[k] for k in able], cfg)
    where = {able[k]: k for k in tied.frames}  # part -> piece, for the parts tied
    first = min(where)
    T_local_root = se2.inverse(tied.frames[where[first]])
    frame = played[0].submap.frame
    landmarks = LandmarkMap(tied.ids, tied.mean, tied.landmark_cov).moved(T_local_root, frame)
    track = _track(played, tied, where, T_local_root, cfg.astray)
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
    waiting = parts(log.sightings, cfg.piece_gap)[::-1]
    while waiting:
        part = waiting.pop()
        key = (int(part[0]), int(part[-1]))
        if key in known:
            ended, done = known[key]
        else:
            track = replay(replace(log, sightings=log.sightings.select(part)), filtered).track
            lost = np.zeros(0) if track.cov is None else track.t[track.cov[:, 2, 2] > cfg.piece_heading**2]
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
