"""The map of one component: landmarks and the trajectories of the robots tied into it, all in one frame.

And how it is finished: told in the frame of its first robot, with a pose at each stamp of a log.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg as sla
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order, robot_key
from ..core.records import Track
from ..fusion.result import Fusion
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..mapping.segments import LOOSE_ALL, off_over_time
from .config import PlacingConfig
from .relation import MutualSightings, Relation, is_sure, relate
from .relative_frame import PLACING_GUESSED, ROOM_REACH, Body, moved_track, mutual_sightings


@dataclass(frozen=True, slots=True)
class TeamMap:
    """What `map` and `fuse` write and `evaluate` reads. `members[id]`: who saw it; `sightings[id]`: how often;
    `first_seen[id]`: when first [s], on the tracks' clock, as far as known.

    left_out[robot]: spans (begin, end) [s] between two poses of its track in which nothing says where it was.
    """

    robots: tuple[str, ...]
    landmarks: LandmarkMap
    tracks: Mapping[str, Track] = field(default_factory=dict)
    members: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sightings: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    first_seen: Mapping[str, float] = field(default_factory=dict)


SAME = 1e-6  # [m, rad] from the frame, within which a pose is written as the frame itself


def in_first_frame(team: TeamMap) -> TeamMap:
    """The map in the frame of the first pose of its lowest-numbered robot; as it is where that is its frame already.

    A robot without odometry, or one that was put down elsewhere, is mapped from its longest stretch: what it did before
    is tied to that frame later, and only then the first pose is known. The transform is taken as exact: covariances are
    turned, and say what they said before, how sure the map is as seen from that stretch.
    """
    robot = min((r for r in team.robots if r in team.tracks and len(team.tracks[r].t)), key=in_order, default=None)
    if robot is None or np.abs(team.tracks[robot].pose[0]).max() <= SAME:
        return team
    T = se2.inverse(team.tracks[robot].pose[0])
    tracks = {name: moved_track(track, T) for name, track in team.tracks.items()}
    return replace(team, landmarks=team.landmarks.moved(T, team.landmarks.frame), tracks=tracks)


def at_every_stamp(team: TeamMap, stamps: Mapping[str, Float[np.ndarray, " n"]], ahead: Mapping[str, float]) -> TeamMap:
    """The map with a pose of every robot at each of its `stamps` [s], all that it has already as it was.

    Poses in between are interpolated; none is put into a span in which nothing says where the robot was, nor before the
    first pose or after the last. ahead: by how much [s] the stamps of a robot are ahead of its track's clock.
    """
    tracks = {
        robot: _with_poses_at(track, stamps[robot] - ahead.get(robot, 0.0), team.left_out.get(robot, ()))
        if robot in stamps
        else track
        for robot, track in team.tracks.items()
    }
    return replace(team, tracks=tracks)


def _with_poses_at(track: Track, t: Float[np.ndarray, " n"], gaps: tuple[tuple[float, float], ...]) -> Track:
    if not len(track.t):
        return track
    new = np.setdiff1d(t, track.t)
    new = new[(new > track.t[0]) & (new < track.t[-1])]
    for begin, end in gaps:
        new = new[(new <= begin) | (new >= end)]
    if not len(new):
        return track
    after = np.searchsorted(track.t, new)
    cov = None
    if track.cov is not None:
        share = ((new - track.t[after - 1]) / (track.t[after] - track.t[after - 1]))[:, None, None]
        cov = np.insert(track.cov, after, (1.0 - share) * track.cov[after - 1] + share * track.cov[after], axis=0)
    pose = np.insert(track.pose, after, se2.interpolate(new, track.t, track.pose), axis=0)
    return Track(np.insert(track.t, after, new), pose, cov, track.frame)


def way_loose(team: TeamMap) -> tuple[Finding, ...]:
    """A finding for each robot whose covariances say that its trajectory may be off by more than a map is good for."""
    out = []
    for robot, track in team.tracks.items():
        if track.cov is not None and len(track.t) and (off := off_over_time(track.t, track.cov)) > LOOSE_ALL:
            loose = track.t[track.cov[:, 0, 0] + track.cov[:, 1, 1] > LOOSE_ALL**2]
            out.append(Finding("way-loose", robot, (float(loose[0]), float(loose[-1])), off))
    return tuple(out)


LEAST = 2  # landmarks of a room


def with_further_rooms(
    team: TeamMap,
    local: Sequence[LocalMap],
    logs: Sequence[LandmarkLog],
    placing: PlacingConfig,
    mapper: Callable[[LandmarkLog], LocalMap],
    join: Callable[[Sequence[LocalMap]], Fusion],
    carry: Callable[[Sequence[LocalMap], Fusion], tuple[TeamMap, ...]],
) -> tuple[TeamMap, tuple[Finding, ...]]:
    """`team` with the rooms that its robots without wheels mapped beside it, and a sentence for each.

    A room is tied where its place is sure by sightings between robots (`placing`). mapper, join, carry: how local maps,
    their fusion and the team's maps come about. A team in which everybody tells odometry comes back as it is.
    """
    own = {m.robot: _known(m.track) for m in local}
    wheelless = [log for log in logs if log.odometry is None and log.robot in team.tracks and not own[log.robot].all()]
    left = [_rest(log, team.tracks[log.robot].t[~own[log.robot]]) for log in wheelless]
    apart = [m for m in map(mapper, [log for log in left if len(log.sightings)]) if len(m.submap.ids) >= LEAST]
    if not apart or not len(team.landmarks):
        return team, ()
    here = {robot: track.t[_placed(track, own[robot])] for robot, track in team.tracks.items() if robot in own}
    there = {m.robot: m.track.t[_known(m.track)] for m in apart}
    by = {log.robot: log for log in logs}
    notes = []
    for room in carry(apart, join(apart)):
        names = [name for name in room.landmarks.ids if name not in team.landmarks.ids]
        if len(names) < LEAST:
            continue
        seen = _between(team, here, room, there, by, ROOM_REACH)
        relation = relate(seen, placing)
        if relation is None or not is_sure(relation, placing):
            continue
        robots = ", ".join(robot_key(robot) for robot in sorted(room.robots, key=in_order))
        told: dict[str, float | str] = {
            "value": len(names),
            "robots": robots,
            "agree": relation.agree,
            "all": relation.of,
        }
        notes.append(Finding("rooms-tied", value=told))
        team = _joined(team, here, room, there, names, relation)
        here = {r: np.union1d(t, there[r]) if r in room.tracks else t for r, t in here.items()}
    return team, tuple(notes)


def _known(track: Track) -> Bool[np.ndarray, " n"]:
    """Which poses of a robot's own map are of one of its pieces."""
    if track.cov is None:
        return np.ones(len(track.t), bool)
    return np.asarray(track.cov[:, 2, 2] < PLACING_GUESSED)


def _placed(track: Track, own: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " n"]:
    """Which poses of the team's track are known; a robot put down elsewhere has more of them than its own map."""
    return own if len(own) == len(track.t) else _known(track)


def _rest(log: LandmarkLog, stamps: Float[np.ndarray, " n"]) -> LandmarkLog:
    return log.chosen(lambda t: np.isin(t, stamps))


def _between(
    team: TeamMap,
    here: Mapping[str, Float[np.ndarray, " h"]],
    room: TeamMap,
    there: Mapping[str, Float[np.ndarray, " r"]],
    logs: Mapping[str, LandmarkLog],
    reach: float,
) -> MutualSightings:
    """What robots while in the one map saw of others while in the other.

    here, there: stamps at which they were, within `reach` [s] of which they are where their tracks say.
    """
    parts = [
        mutual_sightings(
            Body({a: team.tracks[a]}, {}, {a: here[a]}, {a: reach}),
            Body({b: room.tracks[b]}, {}, {b: there[b]}, {b: reach}),
            logs,
            {},
        )
        for a in here
        for b in room.tracks
        if a != b and len(here[a]) and len(there[b])
    ]
    return MutualSightings.joined([part for part in parts if len(part)])


def _joined(
    team: TeamMap,
    here: Mapping[str, Float[np.ndarray, " h"]],
    room: TeamMap,
    there: Mapping[str, Float[np.ndarray, " r"]],
    names: Sequence[str],
    relation: Relation,
) -> TeamMap:
    """`team` with the landmarks `names` of the room, and its robots' poses there."""
    T, more = relation.transform, room.landmarks.select(list(names))
    mean = se2.act(T, more.mean)
    R = np.kron(np.eye(len(more)), se2.rotation(float(T[2])))
    J = np.zeros((2 * len(more), 3))
    J[0::2, 0] = J[1::2, 1] = 1.0
    J[0::2, 2], J[1::2, 2] = -(mean[:, 1] - T[1]), mean[:, 0] - T[0]
    cov = R @ more.cov @ R.T + J @ relation.cov @ J.T
    landmarks = LandmarkMap(
        (*team.landmarks.ids, *more.ids),
        np.concatenate([team.landmarks.mean, mean]),
        sla.block_diag(team.landmarks.cov, cov),
        team.landmarks.frame,
    )
    tracks = {
        robot: _both(track, here[robot], moved_track(room.tracks[robot], T), there[robot])
        if robot in room.tracks and robot in here
        else track
        for robot, track in team.tracks.items()
    }
    return replace(
        team,
        landmarks=landmarks,
        tracks=tracks,
        members={**team.members, **{name: room.members[name] for name in names}},
        sightings={**team.sightings, **{name: room.sightings[name] for name in names}},
    )


def _both(track: Track, here: Float[np.ndarray, " h"], other: Track, there: Float[np.ndarray, " r"]) -> Track:
    """`track`, known at the stamps `here`, with the poses that `other` has at `there`; between them straight on."""
    if track.cov is None or other.cov is None:
        return track
    pose, cov = track.pose.copy(), track.cov.copy()
    known, fresh = np.isin(track.t, here), np.isin(track.t, there) & np.isin(track.t, other.t)
    rows = np.flatnonzero(fresh & ~known)
    take = np.searchsorted(other.t, track.t[rows])
    pose[rows], cov[rows] = other.pose[take], other.cov[take]
    known[rows] = True
    pose[~known] = se2.interpolate(track.t[~known], track.t[known], pose[known])
    return Track(track.t, pose, cov, track.frame)
