"""Parts of a world that no robot without wheels ties by itself, tied by sightings between robots.

A robot without odometry that sees nothing for some seconds begins a new piece of map, and pieces that share no
landmark with the largest stay apart. All robots' left pieces together are a map of their own. Where a robot that stood
in one map saw, or was seen by, a robot that stood in the other at that moment, the two maps lie to each other as the
two robots do.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

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
from .relative_frame import (
    Body,
    MutualSightings,
    PlacingConfig,
    Relation,
    is_sure,
    moved_track,
    mutual_sightings,
    relate,
)
from .team_map import TeamMap

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
    own = {m.robot: _known(m.track, placing) for m in local}
    wheelless = [log for log in logs if log.odometry is None and log.robot in team.tracks and not own[log.robot].all()]
    left = [_rest(log, team.tracks[log.robot].t[~own[log.robot]]) for log in wheelless]
    apart = [m for m in map(mapper, [log for log in left if len(log.sightings)]) if len(m.submap.ids) >= LEAST]
    if not apart or not len(team.landmarks):
        return team, ()
    here = {robot: track.t[_placed(track, own[robot], placing)] for robot, track in team.tracks.items() if robot in own}
    there = {m.robot: m.track.t[_known(m.track, placing)] for m in apart}
    by = {log.robot: log for log in logs}
    notes = []
    for room in carry(apart, join(apart)):
        names = [name for name in room.landmarks.ids if name not in team.landmarks.ids]
        if len(names) < LEAST:
            continue
        seen = _between(team, here, room, there, by, placing.room_reach)
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


def _known(track: Track, cfg: PlacingConfig) -> Bool[np.ndarray, " n"]:
    """Which poses of a robot's own map are of one of its pieces."""
    if track.cov is None:
        return np.ones(len(track.t), bool)
    return np.asarray(track.cov[:, 2, 2] < cfg.guessed)


def _placed(track: Track, own: Bool[np.ndarray, " m"], cfg: PlacingConfig) -> Bool[np.ndarray, " n"]:
    """Which poses of the team's track are known; a robot put down elsewhere has more of them than its own map."""
    return own if len(own) == len(track.t) else _known(track, cfg)


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
