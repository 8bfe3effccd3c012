"""What is known of places beforehand: where robots began, and points that somebody surveyed.

Sightings come first: robots that they tie stay tied as they say. What is known puts that map into its own frame, ties
maps that nobody saw anything in common of, and then counts in the smoothing as measurements with a standard deviation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..core.records import Track
from ..solve import Cauchy, Factor
from .config import SmoothingConfig
from .relative_frame import Body, Layout, Tie, carried_by_wheels, moved_track
from .robot_part import RobotPart
from .team_map import TeamMap

KNOWN_TOLD = 3.0  # standard deviations from which a known place that the map contradicts is told

KNOWN_START = 0.05  # [m] standard deviation of where a robot began
KNOWN_HEADING = 0.05  # [rad] of its heading there
KNOWN_SURVEYED = 0.02  # [m] of a surveyed point
KNOWN_OUTLIER = 2.5  # standard deviations from which a known place counts less: surveys exchange labels
KNOWN_NEAR = 0.5  # [m] within which a known place agrees with where the others put it, when the frame is sought


@dataclass(frozen=True, slots=True)
class PlacePriors:
    """starts: robot -> its first pose (3,) and the sd [m] of its place; points: landmark -> place (2,) and sd [m].

    All in one frame, which becomes the map's. own_frame: the map's frame stays the first pose of its first robot (of
    which no start is known), and starts are told in it. near: [m] within which one agrees with where others put it.
    """

    starts: Mapping[str, tuple[Float[np.ndarray, "3"], float]] = field(default_factory=dict)
    points: Mapping[str, tuple[Float[np.ndarray, "2"], float]] = field(default_factory=dict)
    own_frame: bool = False
    near: float = KNOWN_NEAR

    @classmethod
    def of(
        cls,
        starts: Mapping[str, tuple[float, float, float]],
        start_sd: Mapping[str, float],
        points: Mapping[str, tuple[float, float, float | None]],
        robots: Sequence[str],
    ) -> "PlacePriors":
        """From options; robots: all there are. A start without a sd, a point without one, is as `cfg` says."""
        first = min(robots, key=in_order, default="")
        return cls(
            {robot: (np.array(pose, float), start_sd.get(robot, KNOWN_START)) for robot, pose in starts.items()},
            {n: (np.array([x, y], float), KNOWN_SURVEYED if sd is None else sd) for n, (x, y, sd) in points.items()},
            own_frame=not points and first not in starts,
            near=KNOWN_NEAR,
        )

    def __bool__(self) -> bool:
        return bool(self.starts or self.points)

    def frame_of(
        self, tracks: Mapping[str, Track], landmarks: Mapping[str, Float[np.ndarray, "2"]]
    ) -> Float[np.ndarray, "3"] | None:
        """Where the frame of robots and landmarks lies in the known one; None where that is not known.

        Each start and each pair of surveyed points far from each other is a guess; the one that most agrees with is it.
        """
        starts = {r: s for r, s in self.starts.items() if r in tracks and len(tracks[r].t)}
        shared = [name for name in landmarks if name in self.points]
        here = np.array([*(tracks[r].pose[0, :2] for r in starts), *(landmarks[n] for n in shared)]).reshape(-1, 2)
        there = np.array([*(s[0][:2] for s in starts.values()), *(self.points[n][0] for n in shared)]).reshape(-1, 2)
        tried = [se2.compose(pose, se2.inverse(tracks[r].pose[0])) for r, (pose, _) in starts.items()]
        for i in range(len(here)):
            away = np.linalg.norm(there - there[i], axis=1)
            j = int(np.argmax(away))
            if away[j] > 0:
                tried.append(se2.align(here[[i, j]], there[[i, j]]))
        if not tried:
            return None
        cost = [np.log1p(np.square(se2.act(T, here) - there).sum(axis=1) / self.near**2).sum() for T in tried]
        T = tried[int(np.argmin(cost))]
        near = np.linalg.norm(se2.act(T, here) - there, axis=1) < self.near
        return se2.align(here[near], there[near]) if near.sum() > 2 else np.asarray(T)

    def holds(self, robots: Sequence[str], landmarks: Sequence[str]) -> bool:
        """Whether what is known of these is a frame of its own."""
        some = any(robot in self.starts for robot in robots)
        return not self.own_frame and (some or sum(name in self.points for name in landmarks) > 1)

    def contradicted(self, team: TeamMap) -> tuple[Finding, ...]:
        """A finding for each known place that the finished map has elsewhere."""
        out = []
        for robot, (pose, sd) in self.starts.items():
            track = team.tracks.get(robot)
            off = 0.0 if track is None or not len(track.t) else float(np.hypot(*(track.pose[0] - pose)[:2]))
            if off > KNOWN_TOLD * sd:
                out.append(Finding("start-contradicted", robot, value=off))
        for name, at in zip(team.landmarks.ids, team.landmarks.mean, strict=True):
            if name in self.points and (off := float(np.hypot(*(at - self.points[name][0])))) > max(
                KNOWN_TOLD * self.points[name][1], 10 * KNOWN_SURVEYED
            ):
                out.append(Finding("survey-contradicted", value={"name": name, "value": off}))
        return tuple(out)

    def factors(self, parts: Sequence[RobotPart], landmarks: Mapping[str, int]) -> list[Factor]:
        """The known places as measurements of first poses and of landmarks; landmarks: name -> entry of its x."""
        kernel = Cauchy(KNOWN_OUTLIER)
        own = [(part, *self.starts[part.robot]) for part in parts if part.robot in self.starts]
        out = []
        if own:
            columns = np.array([part.start + np.arange(3) for part, _, _ in own])
            pose = np.array([p for _, p, _ in own])
            w = np.array([[1 / sd, 1 / sd, 1 / KNOWN_HEADING] for _, _, sd in own])
            out.append(_measured(columns, pose, w, kernel, "start", turns=True))
        seen = [(landmarks[n], *self.points[n]) for n in landmarks if n in self.points]
        if seen:
            columns = np.array([at + np.arange(2) for at, _, _ in seen])
            w = np.array([[1 / sd, 1 / sd] for _, _, sd in seen])
            out.append(_measured(columns, np.array([p for _, p, _ in seen]), w, kernel, "surveyed", turns=False))
        return out


def _measured(
    columns: np.ndarray, value: np.ndarray, sqrt_info: np.ndarray, kernel: Cauchy, name: str, *, turns: bool
) -> Factor:
    def residual(x: np.ndarray) -> np.ndarray:
        r = x[columns] - value
        if turns:
            r[:, 2] = se2.wrap_angle(r[:, 2])
        return np.asarray(r)

    J = np.tile(np.eye(columns.shape[1]), (len(columns), 1, 1))
    return Factor(columns, residual, lambda _: J, columns.shape[1], sqrt_info, kernel, name)


def framed(team: TeamMap, known: PlacePriors) -> TeamMap:
    """The map in the known frame; as it is where nothing says where that lies."""
    T = known.frame_of(team.tracks, dict(zip(team.landmarks.ids, team.landmarks.mean, strict=True)))
    if T is None:
        return team
    tracks = {robot: moved_track(track, T) for robot, track in team.tracks.items()}
    return replace(team, landmarks=team.landmarks.moved(T, team.landmarks.frame), tracks=tracks)


def tied_by_known(
    layout: Layout, logs: Mapping[str, LandmarkLog], known: PlacePriors, smoothing: SmoothingConfig
) -> Layout:
    """The layout in the known frame: bodies whose place in it is known are one, robots with wheels and a start in it.

    With starts told in the frame of the first robot (`own_frame`), the body that holds it has its first pose there.
    """
    if not known:
        return layout
    inside: list[Body] = []
    outside: list[Body] = []
    ties, lost = list(layout.ties), []
    first = min(logs, key=in_order, default="")
    for body in layout.bodies:
        whole = body.on_team_time()
        T = known.frame_of(whole.tracks, whole.landmarks)
        if known.own_frame and first in whole.tracks and len(whole.tracks[first].t):
            T = se2.inverse(whole.tracks[first].pose[0])
        if T is None:
            outside.append(body)
        else:
            inside.append(whole.moved(T))
    for robot in layout.lost:
        if robot not in known.starts or logs[robot].odometry is None:
            lost.append(robot)
            continue
        track = carried_by_wheels(logs[robot], logs, smoothing)
        T = se2.compose(known.starts[robot][0], se2.inverse(track.pose[0]))
        inside.append(Body({robot: moved_track(track, T)}, {}))
    if inside:
        inside.sort(key=lambda body: (-len(body.robots), in_order(min(body.robots, key=in_order, default=""))))
        one = inside[0]
        for body in inside[1:]:
            ties.append(Tie(one.robots, body.robots, 0, 0, by="known"))
            one = one.joined(body)
        outside.append(one)
    outside.sort(key=lambda body: -len(body.robots))
    return replace(layout, bodies=tuple(outside), ties=tuple(ties), lost=tuple(lost))
