"""A tree of ROS frames: where the sensor stands on the robot, and which edge is the odometry."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ..core import se2
from ..core.se2 import heading_of_quaternion, is_upside_down

FARTHEST = 1e9  # [m] that frames are apart: farther is a damaged message
LARGEST_TURN = 2.0  # a number of a unit quaternion, with room for careless rounding
TRAVELS = 0.5  # [m] seen from above that a frame moves on another: no mounting does
Edge = tuple[str, str]  # parent, child
Rigid = tuple[np.ndarray, np.ndarray]  # translation (3,), quaternion x y z w (4,)
NOWHERE: Rigid = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))  # on the robot, turned as it is


@dataclass(slots=True)
class Transforms:
    """Every transform seen, by edge, as (time [s], translation and rotation); refused: those whose numbers are none."""

    seen: dict[Edge, list[tuple[float, Rigid]]] = field(default_factory=dict)
    refused: int = 0

    def add(self, t: float, message: Any) -> None:
        """One TransformStamped; one that holds NaN, infinity or absurd numbers is refused."""
        edge = frame(message.header.frame_id), frame(message.child_frame_id)
        transform = rigid(message.transform.translation, message.transform.rotation)
        if in_range(transform):
            self.seen.setdefault(edge, []).append((t, transform))
        else:
            self.refused += 1

    def parent(self, child: str) -> str | None:
        """The frame that `child` hangs on; None for the root."""
        return next((p for p, c in self.seen if c == child), None)

    def chain(self, child: str) -> list[str]:
        """`child`, its parent, and so on to the root."""
        out = [child]
        while (up := self.parent(out[-1])) is not None and up not in out:
            out.append(up)
        return out

    def moves(self, edge: Edge) -> bool:
        """Whether the transform of an edge changes over the recording."""
        first = self.seen[edge][0][1]
        return any(np.abs(r[0] - first[0]).max() > 1e-6 or not _same_turn(r[1], first[1]) for _, r in self.seen[edge])

    def odometry_edge(self, sensor: str) -> Edge | None:
        """Above the sensor: the edge under a frame called like odometry, else the lowest that moves but not in map."""
        line = self.chain(sensor)
        edges = list(zip(line[1:], line, strict=False))
        for edge in edges:
            if "odom" in edge[0].lower():
                return edge
        return next((e for e in edges if "map" not in e[0].lower() and self.moves(e)), None)

    def only_odometry_edge(self) -> Edge | None:
        """The edge under a frame called like odometry where there is but one, whatever hangs below; else None."""
        edges = [e for e in self.seen if "odom" in e[0].lower() and "odom" not in e[1].lower()]
        return edges[0] if len(edges) == 1 else None

    def travelled(self, edge: Edge, sensor: str) -> list[Edge]:
        """`edge`, and those below it on the way to the sensor down to the last whose frame travels on its parent."""
        line = self.chain(sensor)
        if edge[1] not in line:
            return [edge]
        below = [(p, c) for c, p in pairwise(line[: line.index(edge[1]) + 1])][::-1]
        last = max((k for k, e in enumerate(below, 1) if self._travels(e)), default=0)
        return [edge, *below[:last]]

    def poses_along(self, edges: Sequence[Edge]) -> list[tuple[float, float, float, float]]:
        """Stamp and pose, seen from above, of the last child in the first parent, at the stamps of the last edge."""
        rows = [np.array([(t, *planar(transform)) for t, transform in self.seen[edge]]) for edge in edges]
        poses = rows[-1][:, 1:]
        for above in reversed(rows[:-1]):
            t, first = np.unique(above[:, 0], return_index=True)
            poses = se2.compose(se2.interpolate(rows[-1][:, 0], t, above[first, 1:]), poses)
        return [(t, x, y, a) for t, (x, y, a) in zip(rows[-1][:, 0].tolist(), poses.tolist(), strict=True)]

    def _travels(self, edge: Edge) -> bool:
        places = np.array([shift[:2] for _, (shift, _) in self.seen[edge]])
        return bool(np.ptp(places, axis=0).max() > TRAVELS)

    def sensor_pose(self, robot: str, sensor: str) -> tuple[np.ndarray, bool] | None:
        """`T_robot_sensor` seen from above and whether the sensor hangs upside down; None where frames do not meet."""
        place = self.rigid_pose(robot, sensor)
        if place is None:
            return None
        q = place[1].tolist()
        return np.array([*place[0][:2], heading_of_quaternion(*q)]), is_upside_down(*q)

    def rigid_pose(self, robot: str, sensor: str) -> Rigid | None:
        """`T_robot_sensor` in space; None where frames do not meet."""
        if robot == sensor:
            return NOWHERE
        up_sensor, up_robot = self.chain(sensor), self.chain(robot)
        meet = next((name for name in up_sensor if name in up_robot), None)
        if meet is None:
            return None
        path = [_inverse(self._first(p, c)) for c, p in _steps(up_robot, meet)]
        path += reversed([self._first(p, c) for c, p in _steps(up_sensor, meet)])
        shift, turn = path[0]
        for step in path[1:]:
            shift, turn = shift + _rotated(turn, step[0]), _times(turn, step[1])
        return shift, turn

    def _first(self, parent: str, child: str) -> Rigid:
        return self.seen[parent, child][0][1]


def frame(name: str) -> str:
    """The name of a frame as ROS 2 has it, without the slash before it."""
    return name.lstrip("/")


def rigid(translation: Any, rotation: Any) -> Rigid:
    """A message's translation and rotation as arrays."""
    return (
        np.array([translation.x, translation.y, translation.z]),
        np.array([rotation.x, rotation.y, rotation.z, rotation.w]),
    )


def in_range(transform: Rigid) -> bool:
    """Whether its numbers are finite and none is absurd."""
    shift, turn = transform
    return bool((np.abs(shift) < FARTHEST).all() and (np.abs(turn) < LARGEST_TURN).all())


def planar(transform: Rigid) -> tuple[float, float, float]:
    """x, y [m] and heading [rad] of a transform seen from above."""
    shift, turn = transform
    return float(shift[0]), float(shift[1]), heading_of_quaternion(*turn.tolist())


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """(3, 3) of a quaternion x y z w, of any length but zero; the identity for zero."""
    return (
        np.stack([_rotated(q / size, axis) for axis in np.eye(3)], axis=1) if (size := np.linalg.norm(q)) else np.eye(3)
    )


def _steps(line: list[str], end: str) -> list[Edge]:
    """(child, parent) pairs from the start of `line` up to `end`."""
    upto = line[: line.index(end) + 1]
    return list(pairwise(upto))


def _same_turn(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(min(np.abs(a - b).max(), np.abs(a + b).max()) < 1e-6)


def _times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    v = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(v, a[3] * b[3] - a[:3] @ b[:3])


def _rotated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    w = np.cross(q[:3], v)
    return np.asarray(v + 2 * (q[3] * w + np.cross(q[:3], w)))


def _inverse(a: Rigid) -> Rigid:
    turn = a[1] * np.array([-1.0, -1.0, -1.0, 1.0])
    return -_rotated(turn, a[0]), turn
