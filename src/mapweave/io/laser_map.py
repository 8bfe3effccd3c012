"""One laser robot's own map as files, and that of a woven component: for ROS, for people, for solvers, for `localize`.

`grid.npz` holds all that cells do, `scans.csv` what every scan did to the estimate.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core import se2
from ..core.errors import ReaderError
from ..core.names import robot_name
from ..laser.laser_map import GridMap, IntensityCalibration, LaserMap, ScanRecords
from ..laser.pose_graph import PoseGraph
from ..laser.robot_graph import RobotGraph
from ..mapping.woven_map import ClosureRow, WovenMap
from .fixes import write_georeferenced
from .g2o import write_g2o
from .npz import Spec, read_npz, write_arrays
from .robot_graph import NAME as GRAPH
from .robot_graph import write_robot_graph
from .ros_map import write_ros_map
from .table import write_table
from .tum import write_track_covariance, write_tum

NAME = "grid.npz"
LARGEST_VALUE = 1e30  # cells are kept as 32-bit numbers
CELLS: dict[str, Spec] = {
    "resolution": ("number", ()),
    "origin": ("number", (2,)),
    "hits": ("whole", ("rows", "cols")),
    "passes": ("whole", ("rows", "cols")),
    "mean": ("number", ("rows", "cols", 2)),
    "feature": ("number", ("rows", "cols")),
    "weight": ("number", ("rows", "cols")),
    "kind": ("text", ()),
}
CALIBRATION: dict[str, Spec] = {
    "knots": ("number", ("knots",)),
    "log_gain": ("number", ("knots",)),
    "gain_figures": ("number", (4,)),
    "residual_by_range": ("maybe", ("bins",)),
}
LIGHT: dict[str, Spec] = {
    "light_figures": ("number", (2,)),
    "cosines": ("number", ("cosines",)),
    "log_incidence": ("number", ("cosines",)),
}


SURE: dict[str, Spec] = {"gain_sd": ("number", ("sure",)), "exponent_sd": ("number", ())}


def read_grid(path: Path) -> tuple[GridMap, IntensityCalibration | None, str]:
    """The map, how its intensity was normalised (None where it was not), and the feature it holds.

    Raises ReaderError for a file that is missing, damaged or something else.
    """
    held = read_npz(path, CELLS, {**CALIBRATION, **LIGHT, **SURE}, "a grid map that `map` wrote")
    resolution = float(held["resolution"])
    if resolution <= 0:
        raise ReaderError(path, f"expected a resolution of more than 0 m, found {resolution:g}")
    if max(float(np.abs(held[name]).max(initial=0.0)) for name in ("mean", "feature", "weight")) > LARGEST_VALUE:
        raise ReaderError(path, f"expected cells with numbers under {LARGEST_VALUE:g}")
    if min(held[name].min(initial=0) for name in ("hits", "passes")) < 0:
        raise ReaderError(path, "expected counts of 0 or more")
    arrays = (held[name] for name in ("origin", "hits", "passes", "mean", "feature", "weight"))
    grid = GridMap(resolution, *arrays)
    calibration = None
    if all(name in held for name in CALIBRATION):
        exponent, scale, residual, samples = held["gain_figures"].tolist()
        calibration = IntensityCalibration(
            held["knots"], held["log_gain"], exponent, scale, residual, int(samples), held["residual_by_range"]
        )
        if all(name in held for name in LIGHT):  # grids written before light was weighed have none of them
            information, middle = held["light_figures"].tolist()
            light = {name: held[name] for name in ("cosines", "log_incidence")}
            calibration = replace(calibration, information=information, middle=middle, **light)
        if all(name in held for name in SURE):  # nor, before 0.4, how sure the law is
            calibration = replace(calibration, gain_sd=held["gain_sd"], exponent_sd=float(held["exponent_sd"]))
    return grid, calibration, str(held["kind"])


def write_grid(path: Path, grid: GridMap, calibration: IntensityCalibration | None, feature: str) -> None:
    """`path` holds the cells and what is needed to work out the feature of a new scan as it was worked out here.

    Arrays as in `GridMap` and, with a calibration, `knots`, `log_gain`, `gain_figures` = (exponent, scale, residual,
    samples), `residual_by_range`, `light_figures` = (information, middle), `cosines`, `log_incidence`,
    `gain_sd` and `exponent_sd`.
    """
    arrays = {
        "resolution": np.array(grid.resolution),
        "origin": grid.origin,
        "hits": grid.hits,
        "passes": grid.passes,
        "mean": grid.mean,
        "feature": grid.feature,
        "weight": grid.weight,
        "kind": np.array(feature),
    }
    if calibration is not None:
        c = calibration
        arrays |= {
            "knots": c.knots,
            "log_gain": c.log_gain,
            "gain_figures": np.array([c.exponent, c.scale, c.residual, float(c.samples)]),
            "residual_by_range": c.residual_by_range,
            "light_figures": np.array([c.information, c.middle]),
            "cosines": c.cosines,
            "log_incidence": c.log_incidence,
            "gain_sd": c.gain_sd,
            "exponent_sd": np.array(c.exponent_sd),
        }
    write_arrays(path, arrays, gaps=("residual_by_range",))


HEAD = "t,host,x,y,theta,innovation_x,innovation_y,innovation_theta,beams,matches,decision,n_eff,resampled"


def write_scans(path: Path, scans: ScanRecords) -> None:
    """`path` holds a row a scan [s, m, rad]; `n_eff` is empty where no weights changed."""
    columns = [
        scans.t.tolist(),
        map(_plain, scans.host),
        *scans.pose.T.tolist(),
        *scans.innovation.T.tolist(),
        scans.beams.tolist(),
        scans.matches.tolist(),
        scans.decision,
        scans.n_eff.tolist(),
        scans.resampled.astype(int).tolist(),
    ]
    number = ["{:.6f}".format] * 11 + ["{:.3f}".format] * 2
    write_table(path, HEAD.split(","), zip(*columns, strict=True), number)


def _plain(host: str) -> str:
    return "".join(c for c in host if c not in ',"\r\n')


# Spread of one step between scans where the method does not tell: [m, m/m, rad, rad/rad].
STEP, STEP_A_METRE, TURN, TURN_A_RADIAN = 0.01, 0.02, 0.005, 0.02


CLOSURES = (
    *("robot_a", "stamp_a", "robot_b", "stamp_b", "x", "y", "theta"),
    *("score", "second", "share", "nis", "accepted", "reason"),
)


def write_laser_map(folder: Path, laser_map: LaserMap) -> None:
    """`folder` holds map.pgm, map.yaml, grid.npz, scans.csv, pose_graph.g2o and, if calibrated, calibration.csv.

    A map of the graph method has robot_graph.npz and closures.csv beside; its pose graph is that of its keyframes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_ros_map(folder, laser_map.grid)
    write_grid(folder / NAME, laser_map.grid, laser_map.calibration, laser_map.feature)
    write_scans(folder / "scans.csv", laser_map.scans)
    write_g2o(folder / "pose_graph.g2o", scan_graph(laser_map) if laser_map.graph is None else laser_map.graph.graph())
    if laser_map.graph is not None:
        write_robot_graph(folder / GRAPH, laser_map.graph)
        write_closures(folder / "closures.csv", laser_map.graph)
    if laser_map.calibration is not None:
        write_calibration(folder / "calibration.csv", laser_map.calibration)


def scan_graph(laser_map: LaserMap) -> PoseGraph:
    """Scan poses with an edge between neighbours, each with its own information."""
    pose = laser_map.scans.pose
    step = se2.between(pose[:-1], pose[1:])
    n = len(step)
    given = laser_map.scans.information
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
    """`path` holds the gain at each knot [m], its standard deviation and the median absolute residual near it."""
    gain, residual, sd = calibration.log_gain, *np.full((2, len(calibration.knots)), np.nan)
    for column, values in ((residual, calibration.residual_by_range), (sd, calibration.gain_sd)):
        held = values[: len(column)]
        column[: len(held)] = np.where(np.isfinite(held), held, np.nan)
    rows = np.column_stack([calibration.knots, gain, np.exp(gain), residual, sd]).tolist()
    number = ["{:.4f}".format, *["{:.6f}".format] * 4]
    write_table(path, ("range", "log_gain", "gain", "residual", "log_gain_sd"), rows, number)


def write_woven_map(folder: Path, woven: WovenMap) -> None:
    """`folder` holds map.pgm, map.yaml, grid.npz, pose_graph.g2o of all keyframes, closures.csv and trajectories.

    Where fixes place it, fixes.csv, world, trajectories.geojson and map.tif too.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_ros_map(folder, woven.grid, None if woven.georeference is None else woven.georeference.row())
    if woven.georeference is not None:
        write_georeferenced(folder, woven.georeference, woven.tracks, woven.grid)
    write_grid(folder / NAME, woven.grid, woven.calibration, woven.feature)
    write_g2o(folder / "pose_graph.g2o", woven.graph)
    write_closure_rows(folder / "closures.csv", woven.closures)
    if woven.calibration is not None:
        write_calibration(folder / "calibration.csv", woven.calibration)
    write_woven_tracks(folder, woven)


def write_woven_tracks(folder: Path, woven: WovenMap) -> None:
    """`folder/trajectories` holds every robot's trajectory in the component's frame, and its covariances."""
    for robot, track in woven.tracks.items():
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
