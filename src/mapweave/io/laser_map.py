"""One laser robot's own map as files: for ROS, for people, for other solvers, for `localize`."""

from pathlib import Path

import numpy as np

from ..core import se2
from ..laser.grid import IntensityCalibration
from ..laser.laser_map import LaserMap
from ..laser.pose_graph import PoseGraph
from .g2o import write_g2o
from .grid import NAME, write_grid
from .ros_map import write_ros_map
from .scans import write_scans
from .table import write_table

# Spread of one step between scans where the method does not tell: [m, m/m, rad, rad/rad].
STEP, STEP_A_METRE, TURN, TURN_A_RADIAN = 0.01, 0.02, 0.005, 0.02


def write_laser_map(folder: Path, made: LaserMap) -> None:
    """`folder` holds map.pgm, map.yaml, grid.npz, scans.csv, pose_graph.g2o and, if calibrated, calibration.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    write_ros_map(folder, made.grid)
    write_grid(folder / NAME, made.grid, made.calibration, made.feature)
    write_scans(folder / "scans.csv", made.scans)
    write_g2o(folder / "pose_graph.g2o", scan_graph(made))
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


def write_calibration(path: Path, calibration: IntensityCalibration) -> None:
    """`path` holds the gain at each knot [m] and the median absolute residual of log intensity near it."""
    gain, residual = calibration.log_gain, np.full(len(calibration.knots), np.nan)
    held = calibration.residual_by_range[: len(residual)]
    residual[: len(held)] = np.where(np.isfinite(held), held, np.nan)
    rows = np.column_stack([calibration.knots, gain, np.exp(gain), residual]).tolist()
    number = ["{:.4f}".format, *["{:.6f}".format] * 3]
    write_table(path, ("range", "log_gain", "gain", "residual"), rows, number)
