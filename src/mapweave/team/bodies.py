"""Pieces of a team that hold together by themselves, and what they saw of each other."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Track
from .relative_frame import Glances
from .robot_part import all_seen

Labels = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class Body:
    """Robots and landmarks whose places to each other are known, in one frame.

    anchors: robot -> stamps [s] within `reach` [s] of which its track is believed; one that is not named is believed
    everywhere. clock: [s] by which the stamps of the tracks are ahead of the team's.
    """

    tracks: Mapping[str, Track]
    landmarks: Mapping[str, Float[np.ndarray, "2"]]
    anchors: Mapping[str, Float[np.ndarray, " k"]] = field(default_factory=dict)
    reach: Mapping[str, float] = field(default_factory=dict)
    clock: float = 0.0
    own_clock: bool = False

    @property
    def robots(self) -> tuple[str, ...]:
        return tuple(self.tracks)

    def believed(self, robot: str, t: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
        """Whether the robot's track says where it was at the team's `t` [s]."""
        own = t + self.clock
        track = self.tracks[robot]
        if not len(track.t):
            return np.zeros(len(t), bool)
        inside = (own >= track.t[0]) & (own <= track.t[-1])
        if robot in self.anchors:
            at = self.anchors[robot]
            k = np.clip(np.searchsorted(at, t), 1, max(len(at) - 1, 1))
            near = np.minimum(np.abs(t - at[k - 1]), np.abs(t - at[np.minimum(k, len(at) - 1)]))
            inside &= near <= self.reach[robot]
        return np.asarray(inside)

    def pose(self, robot: str, t: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
        """Where the robot was at the team's `t` [s]."""
        track = self.tracks[robot]
        return se2.interpolate(t + self.clock, track.t, track.pose)

    def on_team_time(self) -> "Body":
        """The same with the stamps of the team's clock."""
        if not self.clock:
            return self
        tracks = {robot: replace(track, t=track.t - self.clock) for robot, track in self.tracks.items()}
        return replace(self, tracks=tracks, clock=0.0)

    def moved(self, T: Float[np.ndarray, "3"]) -> "Body":
        """The same seen from a frame in which its own frame is at `T`."""
        return replace(
            self,
            tracks={robot: moved_track(track, T) for robot, track in self.tracks.items()},
            landmarks={name: se2.act(T, p) for name, p in self.landmarks.items()},
        )

    def joined(self, other: "Body") -> "Body":
        """Both, which are in one frame; of a landmark in both, this one's place."""
        a, b = self.on_team_time(), other.on_team_time()
        return Body(
            {**b.tracks, **a.tracks},
            {**b.landmarks, **a.landmarks},
            {**b.anchors, **a.anchors},
            {**b.reach, **a.reach},
        )


def moved_track(track: Track, T: Float[np.ndarray, "3"]) -> Track:
    """The track seen from a frame in which its own frame is at `T`; its covariance turned."""
    cov = None if track.cov is None else se2.turned_covariance(T[2], track.cov)
    return Track(track.t, se2.compose(T, track.pose), cov)


def glances(a: Body, b: Body, logs: Mapping[str, LandmarkLog], labels: Labels) -> Glances:
    """What robots of `a` saw of `b`, then what robots of `b` saw of `a`."""
    parts = [
        *(_of_robot(robot, a, b, logs[robot], labels, forward=True) for robot in a.robots if robot in logs),
        *(_of_robot(robot, b, a, logs[robot], labels, forward=False) for robot in b.robots if robot in logs),
    ]
    return Glances.joined([p for part in parts for p in part])


def _of_robot(robot: str, own: Body, other: Body, log: LandmarkLog, labels: Labels, *, forward: bool) -> list[Glances]:
    table = all_seen(log)
    if not len(table):
        return []
    here, names = own.believed(robot, table.t), labels.get(robot, {})
    if not here.any():
        return []
    pose = np.zeros((len(table), 3))
    pose[here] = own.pose(robot, table.t[here])
    out = []
    for k, name in enumerate(table.ids):
        rows = np.flatnonzero((table.what == k) & here)
        if name == robot or not len(rows):
            continue
        if name in other.tracks:
            if name in own.tracks:
                continue
            rows = rows[other.believed(name, table.t[rows])]
            point = other.pose(name, table.t[rows])[:, :2]
        elif names.get(name, name) in other.landmarks:
            point = np.tile(other.landmarks[names.get(name, name)], (len(rows), 1))
        else:
            continue
        out.append(_glances(table, rows, pose[rows], point, forward=forward))
    return out


def _glances(table: SightingTable, rows: np.ndarray, pose: np.ndarray, point: np.ndarray, *, forward: bool) -> Glances:
    order = np.argsort(table.t[rows], kind="stable")
    rows = rows[order]
    return Glances(
        np.full(len(rows), forward),
        pose[order].reshape(-1, 3),
        point[order].reshape(-1, 2),
        table.range[rows],
        table.bearing[rows],
        table.t[rows],
    )
