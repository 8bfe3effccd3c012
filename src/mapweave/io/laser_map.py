"""One laser robot's own map as files: for ROS, for people, for other solvers, for `localize`."""

from pathlib import Path

import numpy as np

from ..core import se2
from ..laser.grid import IntensityCalibration
from ..laser.laser_map import LaserMap
from ..laser.pose_graph import PoseGraph
from ..laser.robot_graph import RobotGraph
from .g2o import write_g2o
from .grid import NAME, write_grid
from .robot_graph import NAME as GRAPH
from .robot_graph import write_robot_graph
from .ros_map import write_ros_map
from .scans import write_scans
from .table import write_table

# Spread of one step between scans where the method does not tell: [m, m/m, rad, rad/rad].
STEP, STEP_A_METRE, TURN, TURN_A_RADIAN = 0.01, 0.02, 0.005, 0.02


CLOSURES = (
    *("robot_a", "stamp_a", "robot_b", "stamp_b", "x", "y", "theta"),
    *("score", "second", "share", "nis", "accepted", "reason"),
)


def write_laser_map(folder: Path, made: LaserMap) -> None:
    """`folder` holds map.pgm, map.yaml, grid.npz, scans.csv, pose_graph.g2o and, if calibrated, calibration.csv.

    A map of the graph method has robot_graph.npz and closures.csv beside; its pose graph is that of its keyframes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_ros_map(folder, made.grid)
    write_grid(folder / NAME, made.grid, made.calibration, made.feature)
    write_scans(folder / "scans.csv", made.scans)
    write_g2o(folder / "pose_graph.g2o", scan_graph(made) if made.graph is None else made.graph.graph())
    if made.graph is not None:
        write_robot_graph(folder / GRAPH, made.graph)
        write_closures(folder / "closures.csv", made.graph)
    if made.calibration is not None:
        write_calibration(folder / "calibration.csv", made.calibration)


def scan_graph(made: LaserMap) -> PoseGraph:
    """Scan poses with an edge between neighbours, each with its own information."""
    pose = made.scans.pose
    step = se2.between(pose[:-1], pose[1:])
    n = len(step)
    given = made.scans.information
    if given is None:
        travel, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
        information = np.zeros((n, 3, 3))
        information[:, 0, 0] = information[:, 1, 1] = (STEP + STEP_A_METRE * travel) ** -2
        information[:, 2, 2] = (TURN + TURN_A_RADIAN * turn) ** -2
    else:
        information = given[1:]
    return PoseGraph(pose, np.arange(n), np.arange(1, n + 1), step, information)


def write_closures(path: Path, graph: RobotGraph) -> None:
    """`path` holds every closure tried, in order: x, y, theta is the pose of b in a, stamps are those of keyframes."""
    rows = []
    for c in graph.closures:
        a, b = (f"{graph.t[k]:.6f}" for k in (c.first, c.second))
        fit = [c.score, c.runner_up, c.share, c.nis]
        rows.append([graph.robot, a, graph.robot, b, *c.measured.tolist(), *fit, int(c.accepted), c.reason])
    write_table(path, CLOSURES, rows)


def write_calibration(path: Path, calibration: IntensityCalibration) -> None:
    """`path` holds the gain at each knot [m] and the median absolute residual of log intensity near it."""
    gain, residual = calibration.log_gain, np.full(len(calibration.knots), np.nan)
    held = calibration.residual_by_range[: len(residual)]
    residual[: len(held)] = np.where(np.isfinite(held), held, np.nan)
    rows = np.column_stack([calibration.knots, gain, np.exp(gain), residual]).tolist()
    number = ["{:.4f}".format, *["{:.6f}".format] * 3]
    write_table(path, ("range", "log_gain", "gain", "residual"), rows, number)
