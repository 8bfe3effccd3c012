"""A grid map from scans at known poses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..kernels.laser.render import render as lay
from .beam import Beams, insertion_weight
from .laser_map import GridMap
from .robot_graph import RobotGraph

EDGE = 2  # cells left free round the map


class Returns(NamedTuple):
    """One scan as a map takes it in, in the robot frame. s: (n, 2) [m]; q: (n,); w: (n,) insertion weight."""

    s: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"]
    w: Float[np.ndarray, " n"]


def render_keyframes(graph: RobotGraph, resolution: float, frame: str) -> GridMap:
    """The map of the keyframes of `graph` alone, in the frame of its poses."""
    sensors = np.column_stack([graph.sensor, np.zeros(len(graph))])
    scans = []
    for i in range(len(graph)):
        s = graph.points[graph.rows(i)]
        q = np.zeros(len(s)) if graph.q is None else graph.q[graph.rows(i)]
        scans.append(Returns(s, q, insertion_weight(np.hypot(*(s - graph.sensor[i]).T))))
    return render(scans, graph.pose, sensors, resolution, frame)


def render(
    scans: Sequence[Beams | Returns],
    poses: Float[np.ndarray, "m 3"],
    sensors: Float[np.ndarray, "m 3"],
    resolution: float,
    frame: str,
) -> GridMap:
    """The map of `scans` taken at `poses` (robot in `frame`) with the sensor at `sensors` on the robot."""
    world = [se2.act(pose, b.s) for pose, b in zip(poses, scans, strict=True)]
    eyes = se2.compose(poses, sensors)[:, :2]
    every = np.concatenate([*world, eyes])
    low = np.floor(every.min(axis=0) / resolution).astype(int) - EDGE
    cols, rows = np.floor(every.max(axis=0) / resolution).astype(int) + EDGE + 1 - low
    corner = low * resolution
    hits, passes = np.zeros((rows, cols), np.int32), np.zeros((rows, cols), np.int32)
    sums = np.zeros((rows, cols, 4))
    for b, points, eye in zip(scans, world, eyes, strict=True):
        lay(hits, passes, sums, corner, resolution, eye, np.column_stack([points, b.q]), b.w)
    weight = sums[..., 3]
    mean = np.divide(sums[..., :3], weight[..., None], out=np.zeros((rows, cols, 3)), where=weight[..., None] > 0)
    return GridMap(resolution, corner, hits, passes, mean[..., :2], mean[..., 2], weight, frame)
