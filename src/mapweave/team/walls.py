"""What lasers of different robots saw in common: their maps woven, and the layout of the team brought in line with it.

Sightings come first: they say where a map is looked for in another, and overrule walls that fit far from there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core import se2
from ..core.names import in_order
from ..core.records import Track
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import blended
from ..mapping.config import LaserConfig
from ..mapping.map_overlap import keyframe_map
from ..mapping.merge import Merge, merge_maps
from ..mapping.merge_search import Start
from ..mapping.weave import Woven, weave
from .config import PlacingConfig
from .factors import InterRobotEdge
from .relation import SURE_THETA
from .relative_frame import PLACING_LEVER, WALLS_OFF, Body, Layout, Tie, moved_track

NEAR = 0.01  # [s] by which a stamp may lie outside a track


@dataclass(frozen=True, slots=True)
class Scanned:
    """One laser robot's own map: its keyframes, and its poses at every stamp, in its own frame and by its clock."""

    graph: RobotGraph
    track: Track


@dataclass(frozen=True, slots=True)
class CommonWalls:
    """scanned: every laser robot's map, those connected by walls in one frame and bent to each other; parts:
    which do; crossings: their keyframes to each other; merges: every pair tried, with the decision and its reason.
    """

    scanned: Mapping[str, Scanned]
    parts: tuple[tuple[str, ...], ...] = ()
    crossings: tuple[InterRobotEdge, ...] = ()
    merges: tuple[Merge, ...] = ()

    def together(self, a: str, b: str) -> bool:
        """Whether walls that both saw tie these two robots."""
        return any(a in part and b in part for part in self.parts)


def common_walls(
    layout: Layout, scanned: Mapping[str, Scanned], cfg: LaserConfig, placing: PlacingConfig
) -> CommonWalls:
    """The maps of all laser robots woven; in a body, where sightings tie them, near the place that those say.

    Walls of robots that sightings tie are not believed where they fit beyond three standard deviations of the loosest
    tie that is taken for sure.
    """
    robots = sorted(scanned, key=in_order)
    if len(robots) < 2:
        return CommonWalls(scanned)
    graphs = [scanned[robot].graph for robot in robots]
    known = _near_the_layout(layout, scanned, robots, cfg, placing)
    woven = weave(graphs, cfg.merge, last=cfg.graph.joint, known=known)
    members = [tuple(robots[k] for k in np.flatnonzero(woven.component == c)) for c in np.unique(woven.component)]
    parts = tuple(part for part in members if len(part) > 1)
    bent = {
        robot: _bent(scanned[robot], pose) if any(robot in part for part in parts) else scanned[robot]
        for robot, pose in zip(robots, woven.pose, strict=True)
    }
    return CommonWalls(bent, parts, _crossings(robots, graphs, woven), woven.merges)


def in_line(layout: Layout, walls: CommonWalls) -> Layout:
    """The layout with robots where their woven maps lie, and bodies tied that nothing but walls ties."""
    bodies, ties = list(layout.bodies), list(layout.ties)
    for part in walls.parts:
        holding = [k for k, body in enumerate(bodies) if set(part) & set(body.robots)]
        first, *others = holding
        for k in others:
            there, here = (_place_of(part, bodies[n], walls, layout) for n in (first, k))
            T = se2.compose(there, se2.inverse(here))
            ties.append(Tie(bodies[first].robots, bodies[k].robots, 0, 0, by="walls"))
            bodies[first] = bodies[first].joined(bodies[k].moved(np.asarray(T)))
        T = _place_of(part, bodies[first], walls, layout)
        tracks = dict(bodies[first].tracks)
        for robot in part:
            bent = moved_track(walls.scanned[robot].track, T)
            if len(bent.t) == len(tracks[robot].t):  # else it is the trajectory from wheels and camera, which stays
                tracks[robot] = replace(bent, t=tracks[robot].t)
        bodies[first] = replace(bodies[first], tracks=tracks)
        bodies = [body for k, body in enumerate(bodies) if k not in others]
    return replace(layout, bodies=tuple(bodies), ties=tuple(ties))


def _place_of(part: Sequence[str], body: Body, walls: CommonWalls, layout: Layout) -> np.ndarray:
    """Where the frame of a part lies in a body: as its robots' trajectories there say, every pose counting the same."""
    return _frame({robot: walls.scanned[robot] for robot in part if robot in body.tracks}, body, layout)


def _frame(own: Mapping[str, Scanned], body: Body, layout: Layout) -> np.ndarray:
    """Where the frame that robots' own maps are in lies in a body, by their trajectories in both."""
    ways = []
    for robot, scanned in own.items():
        track, t = body.tracks[robot], scanned.track.t - layout.clocks.get(robot, 0.0)
        if not len(track.t):
            ways.append((scanned.track.pose[:1], scanned.track.pose[:1]))
            continue
        both = (t >= track.t[0] - NEAR) & (t <= track.t[-1] + NEAR)
        if both.any():
            ways.append((se2.interpolate(t[both], track.t, track.pose), scanned.track.pose[both]))
        else:
            ways.append((track.pose[:1], scanned.track.pose[:1]))
    there, here = (np.concatenate(side) for side in zip(*ways, strict=True))
    turn = there[:, 2] - here[:, 2]
    theta = float(np.arctan2(np.sin(turn).mean(), np.cos(turn).mean()))
    shift = there[:, :2].mean(axis=0) - se2.rotation(theta) @ here[:, :2].mean(axis=0)
    return np.array([*shift, theta])


def _near_the_layout(
    layout: Layout,
    scanned: Mapping[str, Scanned],
    robots: Sequence[str],
    cfg: LaserConfig,
    placing: PlacingConfig,
) -> dict[tuple[int, int], Merge]:
    """What is decided on laser robots of one body, by their places among `robots`, until walls tie them all."""
    sd = np.array([*2 * [PLACING_LEVER * placing.sure_xy], SURE_THETA])
    out: dict[tuple[int, int], Merge] = {}
    for body in layout.bodies:
        mine = [k for k, robot in enumerate(robots) if robot in body.tracks]
        group = {k: k for k in mine}
        maps = {k: keyframe_map(scanned[robots[k]].graph) for k in mine} if len(mine) > 1 else {}
        for j in mine:
            for i in mine[: mine.index(j)]:
                if group[i] == group[j]:
                    continue
                start = Start(
                    np.asarray(se2.between(*(_frame({robots[k]: scanned[robots[k]]}, body, layout) for k in (i, j)))),
                    sd,
                )
                merge = merge_maps(maps[i], maps[j], cfg.merge, start)
                if merge.transform is not None:
                    merge = unless_far(merge, start, scanned[robots[j]].track, placing.sure_xy)
                out[i, j] = merge
                if merge.merged:
                    group = {k: group[i] if g == group[j] else g for k, g in group.items()}
    return out


def unless_far(merge: Merge, start: Start, track: Track, sure: float) -> Merge:
    """The merge; refused where walls put the second robot's trajectory elsewhere than sightings of the team do.

    sure: [m] sd of the loosest tie by sightings that is believed.
    """
    assert merge.transform is not None  # noqa: S101  (merged)
    ways = [se2.act(T, track.pose[:, :2]) for T in (start.transform, merge.transform)]
    away = float(np.hypot(*(ways[1] - ways[0]).T).mean())
    if away <= WALLS_OFF * np.sqrt(2.0) * sure:
        return merge
    reason = f"their walls fit {away:.1f} m from where sightings of the team place them"
    return replace(merge, merged=False, transform=None, covariance=None, reason=reason)


def _bent(own: Scanned, pose: np.ndarray) -> Scanned:
    """The robot's map with its keyframes at `pose`, its trajectory between them as it was."""
    graph, track = own.graph, own.track
    rows = np.searchsorted(track.t, graph.t)
    keyframes = se2.compose(pose, se2.between(graph.pose, track.pose[rows]))
    return Scanned(replace(graph, pose=pose), Track(track.t, blended(track.pose, rows, keyframes), track.cov))


def _crossings(robots: Sequence[str], graphs: Sequence[RobotGraph], woven: Woven) -> tuple[InterRobotEdge, ...]:
    """The edges between robots that the joint graph holds, with the relative poses of the woven map."""
    offset = np.concatenate([[0], np.cumsum([len(g) for g in graphs])]).astype(int)
    within = sum(g.graph().edges for g in graphs)
    pose, joint = np.concatenate(woven.pose), woven.joint.graph
    rows = np.flatnonzero(woven.joint.used & (np.arange(joint.edges) >= within))
    owner = np.searchsorted(offset, [joint.first[rows], joint.second[rows]], side="right") - 1
    way = se2.between(pose[joint.first[rows]], pose[joint.second[rows]])
    return tuple(
        InterRobotEdge(
            robots[a],
            robots[b],
            int(joint.first[k] - offset[a]),
            int(joint.second[k] - offset[b]),
            np.asarray(z),
            joint.information[k],
        )
        for k, a, b, z in zip(rows.tolist(), *owner.tolist(), way, strict=True)
    )
