"""The layout of the UTIAS MRCLAM data sets: one text file for each robot and kind of row, truth in files of its own."""

from pathlib import Path

from ..core.recording import RobotRecording, TeamRecording
from .rows import open_text


def write_mrclam(folder: Path, team: TeamRecording) -> None:
    """`folder` holds barcodes, survey and three files a robot; the bytes depend on `team` alone."""
    folder.mkdir(parents=True, exist_ok=True)
    _table(folder / "Barcodes.dat", "Subject #    Barcode #", [f"{s:3d}\t{c:4d}" for s, c in team.barcodes.items()])
    survey = [f"{s:3d}\t{x:.8f}\t{y:.8f}\t{1e-4:.8f}\t{1e-4:.8f}" for s, (x, y) in team.landmarks.items()]
    head = "Subject #    x [m]    y [m]    x std-dev [m]    y std-dev [m]"
    _table(folder / "Landmark_Groundtruth.dat", head, survey)
    for robot in team.robots:
        _write_robot(folder, robot)


def _write_robot(folder: Path, robot: RobotRecording) -> None:
    name = f"Robot{robot.number}"
    rows = [f"{t:.3f}\t{v:.3f}\t{w:.3f}" for t, v, w in robot.odometry.tolist()]
    _table(
        folder / f"{name}_Odometry.dat", "Time [s]    forward velocity [m/s]    angular velocity [rad/s]", _plain(rows)
    )
    seen = zip(robot.stamps.tolist(), robot.barcodes.tolist(), robot.sightings.tolist(), strict=True)
    rows = [f"{t:.3f}\t{code:4d}\t{r:.3f}\t{b:.3f}" for t, code, (r, b) in seen]
    _table(folder / f"{name}_Measurement.dat", "Time [s]    Barcode #    range [m]    bearing [rad]", _plain(rows))
    rows = [f"{t:.3f}\t{x:.8f}\t{y:.8f}\t{a:.8f}" for t, x, y, a in robot.truth.tolist()]
    _table(folder / f"{name}_Groundtruth.dat", "Time [s]    x [m]    y [m]    orientation [rad]", _plain(rows))


def _plain(rows: list[str]) -> list[str]:
    """No minus before a zero."""
    return [row.replace("\t-0.000\t", "\t0.000\t") for row in rows]


def _table(path: Path, head: str, rows: list[str]) -> None:
    with open_text(path) as file:
        file.write("\n".join([f"# {head}", *rows]) + "\n")
