"""Connected robots as one map: every robot's trajectory in one frame, one grid, one graph, all closures."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.findings import Finding
from ..core.fixes import place_of
from ..core.records import Track, freeze
from ..laser.beam import IntensityCalibration
from ..laser.laser_map import GridMap, LaserMap
from ..laser.occupancy_mapper import keyframe_returns, render_returns
from ..laser.pose_graph import PoseGraph
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import blended
from .laser_mapping import between_keyframes
from .map_overlap import VIEWS, KeyframeMap, drawn_twice
from .merge import Merge
from .weave import Woven

FRAME = "map"
DROPPED = "it contradicts the joint graph: "


@dataclass(frozen=True, slots=True)
class ClosureRow:
    """A closure tried between keyframes of robots a and b (of one and the same: a loop).

    stamps [s]; at: (2, 2) [m] where both keyframes stand in `map`; measured: (3,) pose of b in a; score, second: of
    the search, second over score; share: of returns that match; nis: squared innovation [sd^2].
    """

    robot_a: str
    stamp_a: float
    robot_b: str
    stamp_b: float
    at: Float[np.ndarray, "2 2"]
    measured: Float[np.ndarray, "3"]
    score: float | None
    second: float | None
    share: float
    nis: float | None
    accepted: bool
    reason: str


@dataclass(frozen=True, slots=True)
class Georeference:
    """Where a map lies in the world that position fixes are told in.

    datum: latitude [deg], longitude [deg], height [m] of the point from which the world's x is east and y north [m],
    None where `frame` is a room's and not the earth's; T_world_map: (3,), cov: (3, 3) of it. Of receiver i: the robot
    it is on, its topic, how many times its noise is what it says (`scale`). Of fix k: its receiver `owner`, stamp t
    [s], place z (k, 2) [m] in the world, how far the robot's antenna is estimated from there, residual (k, 2) [m], and
    whether it was used. tracks: each robot's trajectory in the world, as sure as it is there.
    """

    datum: Float[np.ndarray, "3"] | None
    frame: str
    T_world_map: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]
    robots: tuple[str, ...]
    topics: tuple[str, ...]
    scale: Float[np.ndarray, " r"]
    owner: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    z: Float[np.ndarray, "k 2"]
    residual: Float[np.ndarray, "k 2"]
    used: Bool[np.ndarray, " k"]
    tracks: Mapping[str, Track] = field(default_factory=dict)

    def places(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Longitude and latitude [deg] of points of the map, on the plane through the datum; needs a datum."""
        assert self.datum is not None  # noqa: S101  (asked of the earth's frame alone)
        enu = np.column_stack([se2.act(self.T_world_map, xy), np.zeros(len(xy))])
        return place_of(enu, self.datum)[:, [1, 0]]

    def row(self) -> dict[str, Any]:
        """As it stands in `metrics.json` and, but for the receivers, in `map.yaml`."""
        return {
            "datum": None if self.datum is None else self.datum.tolist(),
            "frame": self.frame,
            "pose": self.T_world_map.tolist(),
            "sd": np.sqrt(np.diag(self.cov)).tolist(),
            "fixes": {
                r: {
                    "topic": topic,
                    "fixes": int((self.owner == k).sum()),
                    "used": int(self.used[self.owner == k].sum()),
                    "noise_scale": float(self.scale[k]),
                }
                for k, (r, topic) in enumerate(zip(self.robots, self.topics, strict=True))
            },
        }


@dataclass(frozen=True, slots=True)
class WovenMap:
    """One component: the connected robots, in `map`, the first pose of the first of them.

    tracks: robot -> its trajectory with covariances; pose: (n, 3) all keyframes, robots in order, owner (n,) which
    robot's each is, t (n,) [s] their stamps; graph: the edges believed, over these poses; closures: every one tried
    within and between these robots, and those tried with robots of later components; georeference: where fixes put it.
    """

    robots: tuple[str, ...]
    tracks: Mapping[str, Track]
    grid: GridMap
    feature: str
    calibration: IntensityCalibration | None
    graph: PoseGraph
    owner: Int[np.ndarray, " n"]
    t: Float[np.ndarray, " n"]
    closures: tuple[ClosureRow, ...]
    georeference: Georeference | None = None

    @property
    def joint(self) -> bool:
        """Whether this is more than the map of one robot as that robot alone has it."""
        return len(self.robots) > 1 or self.georeference is not None

    def __post_init__(self) -> None:
        freeze(self, "owner", dtype=np.int64)
        freeze(self, "t")


def woven_maps(maps: Sequence[LaserMap], woven: Woven, resolution: float, unsure: float = 1.0) -> tuple[WovenMap, ...]:
    """The components of `woven`, that of most robots first; a robot alone keeps its own map as it is.

    maps: each robot's own, with its graph, in the order they were woven in; unsure: covariances of the joint graph are
    told so many times as great.
    """
    graphs = [_graph(m) for m in maps]
    offset = np.concatenate([[0], np.cumsum([len(g) for g in graphs])]).astype(np.int64)
    groups = [np.flatnonzero(woven.component == c).tolist() for c in dict.fromkeys(woven.component.tolist())]
    groups.sort(key=lambda g: (-len(g), g[0]))
    home = {k: n for n, group in enumerate(groups) for k in group}
    poses = [woven.pose[k] if len(groups[home[k]]) > 1 else g.pose for k, g in enumerate(graphs)]
    dropped = {(d.first, d.second): d.reason for d in woven.joint.dropped}
    rows = _rows(graphs, poses, offset, woven.merges, dropped, {m.robot: home[k] for k, m in enumerate(maps)})
    return tuple(
        _alone(maps[group[0]], rows.get(n, ()))
        if len(group) == 1
        else _component(group, maps, poses, woven, offset, rows.get(n, ()), resolution, unsure)
        for n, group in enumerate(groups)
    )


def contradictions(maps: Sequence[LaserMap], woven: WovenMap) -> Iterator[Finding]:
    """A finding for each two robots of a component that saw through each other's walls where these stand in it."""
    graphs = {m.robot: _graph(m) for m in maps if m.graph is not None}
    together = woven.robots if len(woven.robots) > 1 else ()
    placed = []
    for k, robot in enumerate(together):
        points = [graphs[robot].points[graphs[robot].rows(i)] for i in range(len(graphs[robot]))]
        placed += [KeyframeMap(robot, woven.graph.pose[woven.owner == k], points, asked=VIEWS)] if points else []
    return drawn_twice(placed)


def own_map(local_map: LaserMap) -> WovenMap:
    """The component of a robot of which there is no other: its map as it is."""
    graph = _graph(local_map)
    rows = _rows([graph], [graph.pose], np.array([0, len(graph)]), (), {}, {local_map.robot: 0})
    return _alone(local_map, rows.get(0, ()))


def _graph(local_map: LaserMap) -> RobotGraph:
    assert local_map.graph is not None  # noqa: S101  (only the graph method is woven)
    return local_map.graph


def _alone(local_map: LaserMap, closures: Sequence[ClosureRow]) -> WovenMap:
    graph = _graph(local_map)
    return WovenMap(
        robots=(local_map.robot,),
        tracks={local_map.robot: local_map.track},
        grid=local_map.grid,
        feature=local_map.feature,
        calibration=local_map.calibration,
        graph=graph.graph(),
        owner=np.zeros(len(graph), np.int64),
        t=graph.t,
        closures=tuple(closures),
    )


def _component(
    group: Sequence[int],
    maps: Sequence[LaserMap],
    poses: Sequence[Float[np.ndarray, "_ 3"]],
    woven: Woven,
    offset: Int[np.ndarray, " m"],
    closures: Sequence[ClosureRow],
    resolution: float,
    unsure: float,
) -> WovenMap:
    graphs = [_graph(maps[k]) for k in group]
    at = np.concatenate([np.arange(offset[k], offset[k + 1]) for k in group])
    number = np.full(int(offset[-1]), -1, np.int64)
    number[at] = np.arange(len(at))
    joint = woven.joint.graph
    inside = woven.joint.used & (number[joint.first] >= 0) & (number[joint.second] >= 0)
    pose = np.concatenate([poses[k] for k in group])
    graph = PoseGraph(
        pose,
        number[joint.first[inside]],
        number[joint.second[inside]],
        joint.measured[inside],
        joint.information[inside],
    )
    turned = float(poses[group[0]][0, 2] - joint.pose[at[0], 2])
    cov = unsure * se2.turned_covariance(turned, woven.joint.covariances()[at]) + graphs[0].cov[0]
    ends = np.concatenate([[0], np.cumsum([len(g) for g in graphs])]).astype(np.int64)
    tracks = {
        maps[k].robot: placed_track(maps[k], poses[k], np.asarray(cov[ends[i] : ends[i + 1]]))
        for i, k in enumerate(group)
    }
    features = {maps[k].feature for k in group}
    feature = "normalised" if features == {"normalised"} else "none"
    return WovenMap(
        robots=tuple(maps[k].robot for k in group),
        tracks=tracks,
        grid=joint_grid(graphs, [poses[k] for k in group], resolution, lit=feature != "none"),
        feature=feature,
        calibration=maps[group[0]].calibration if feature != "none" else None,
        graph=graph,
        owner=np.repeat(np.arange(len(group)), [len(g) for g in graphs]),
        t=np.concatenate([g.t for g in graphs]),
        closures=tuple(closures),
    )


def placed_track(local_map: LaserMap, pose: Float[np.ndarray, "n 3"], cov: Float[np.ndarray, "n 3 3"]) -> Track:
    """The robot's trajectory where its keyframes stand at `pose`: between them as in its own map."""
    graph, own = _graph(local_map), local_map.track
    placed = RobotGraph(
        **{name: getattr(graph, name) for name in RobotGraph.__slots__ if name not in {"pose", "cov"}},
        pose=pose,
        cov=cov,
    )
    t, before, _ = graph.way()
    rows = np.searchsorted(own.t, t)
    corrected = se2.compose(placed.way()[1], se2.between(before, own.pose[rows]))
    return Track(own.t, blended(own.pose, rows, corrected), between_keyframes(own.t, placed), FRAME)


def joint_grid(
    graphs: Sequence[RobotGraph], poses: Sequence[Float[np.ndarray, "_ 3"]], resolution: float, *, lit: bool
) -> GridMap:
    """All keyframes of all robots laid on one grid."""
    laid = [scan for g in graphs for scan in keyframe_returns(g, lit=lit)]
    glass = np.concatenate([g.panes(pose) for g, pose in zip(graphs, poses, strict=True)])
    return render_returns(laid, np.concatenate(poses), resolution, FRAME, glass)


def _rows(
    graphs: Sequence[RobotGraph],
    poses: Sequence[Float[np.ndarray, "_ 3"]],
    offset: Int[np.ndarray, " m"],
    merges: Sequence[Merge],
    dropped: Mapping[tuple[int, int], str],
    home: Mapping[str, int],
) -> dict[int, list[ClosureRow]]:
    """Component -> its closures: robot by robot those within, then those between, pair by pair.

    dropped: ties between robots that the joint graph does not hold, by their keyframes among all.
    """
    out: dict[int, list[ClosureRow]] = {}
    number = {g.robot: k for k, g in enumerate(graphs)}
    for k, g in enumerate(graphs):
        for c in g.closures:
            row = ClosureRow(
                g.robot,
                float(g.t[c.first]),
                g.robot,
                float(g.t[c.second]),
                poses[k][[c.first, c.second], :2],
                c.measured,
                c.score,
                c.runner_up,
                c.share,
                c.nis,
                c.accepted,
                c.reason,
            )
            out.setdefault(home[g.robot], []).append(row)
    for m in merges:
        i, j = number[m.a], number[m.b]
        for tie in m.closures:
            held = m.merged and tie.accepted
            why_dropped = dropped.get((int(offset[i]) + tie.first, int(offset[j]) + tie.second)) if held else None
            reason = tie.reason if why_dropped is None else DROPPED + why_dropped
            row = ClosureRow(
                m.a,
                float(graphs[i].t[tie.first]),
                m.b,
                float(graphs[j].t[tie.second]),
                np.stack([poses[i][tie.first, :2], poses[j][tie.second, :2]]),
                tie.measured,
                tie.score,
                tie.ratio,
                tie.share,
                tie.nis,
                held and why_dropped is None,
                reason if m.merged or not tie.accepted else f"the maps are not merged: {m.reason}",
            )
            out.setdefault(min(home[m.a], home[m.b]), []).append(row)
    return out
