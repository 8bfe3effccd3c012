"""One component of woven laser maps as files: the map for ROS and for `localize`, the graph, closures, trajectories."""

from pathlib import Path

from ..core.names import robot_name
from ..laser.woven_map import ClosureRow, WovenMap
from .g2o import write_g2o
from .laser_map import CLOSURES, NAME, write_calibration, write_grid
from .ros_map import write_ros_map
from .table import write_table
from .tum import write_track_covariance, write_tum


def write_woven_map(folder: Path, made: WovenMap) -> None:
    """`folder` holds map.pgm, map.yaml, grid.npz, pose_graph.g2o of all keyframes, closures.csv and trajectories."""
    folder.mkdir(parents=True, exist_ok=True)
    write_ros_map(folder, made.grid)
    write_grid(folder / NAME, made.grid, made.calibration, made.feature)
    write_g2o(folder / "pose_graph.g2o", made.graph)
    write_closure_rows(folder / "closures.csv", made.closures)
    if made.calibration is not None:
        write_calibration(folder / "calibration.csv", made.calibration)
    write_woven_tracks(folder, made)


def write_woven_tracks(folder: Path, made: WovenMap) -> None:
    """`folder/trajectories` holds every robot's way in the component's frame, and its covariances."""
    for robot, track in made.tracks.items():
        write_tum(folder / "trajectories" / f"{robot_name(robot)}.tum", track)
        write_track_covariance(folder / "trajectories" / f"{robot_name(robot)}.cov.csv", track)


def write_closure_rows(path: Path, closures: tuple[ClosureRow, ...]) -> None:
    """`path` holds every closure tried: x, y, theta is the pose of b in a, stamps are those of keyframes."""
    rows = []
    for c in closures:
        a, b = (f"{stamp:.6f}" for stamp in (c.stamp_a, c.stamp_b))
        fit = [c.score, c.second, c.share, c.nis]
        rows.append([c.robot_a, a, c.robot_b, b, *c.measured.tolist(), *fit, int(c.accepted), c.reason])
    write_table(path, CLOSURES, rows)
