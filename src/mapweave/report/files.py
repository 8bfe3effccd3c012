"""The end of a result's page: every file beside it, to open or save, and what it holds."""

from html import escape
from pathlib import Path
from urllib.parse import quote

from ..io.directory import result_file
from .html import Page

HOLDS = {
    "calibration.csv": "gain of intensity over range, found from the log",
    "calibration.json": "what was found of every robot: speed, turns, lag, bearing bias, range scale",
    "claims.md": "the paper's claims, each with what became of it here",
    "closures.csv": "every loop closure tried, with the reason why it was believed or refused",
    "components": "maps that nothing ties to this one",
    "dropped.csv": "rows that were left out, and why",
    "figures": "every figure as PNG",
    "grid.npz": "the occupancy grid as arrays",
    "intensity.png": "light that the walls send back",
    "landmarks.csv": "landmarks with their covariances, a row each",
    "landmarks.npz": "landmarks with their joint covariance",
    "local": "each robot's own map",
    "log": "the recordings, which map reads again",
    "map.pgm": "occupancy, as ROS navigation reads it",
    "map.yaml": "resolution and origin of map.pgm",
    "metrics.json": "all that the page says, for programs",
    "network.npz": "who sighted whom, and the joint information matrix",
    "pose_graph.g2o": "poses and edges, for GTSAM, g2o and others",
    "positions.csv": "where each robot is, with covariances",
    "recording": "the simulated recordings, which map reads again",
    "result.mcap": "map, paths and landmarks, for RViz and Foxglove",
    "robot_graph.npz": "keyframes with their returns, steps and closures",
    "runs.csv": "a row for each run, with its scores",
    "scans.csv": "a row for each scan: pose, innovation, decision",
    "state": "what --resume needs to go on",
    "tables": "the tables of this page in Markdown",
    "trajectories": "where each robot went: TUM or CSV, covariances beside",
}


def list_files(folder: Path) -> None:
    """`report.html` in `folder` ends in a table of the other files and folders there, in place of one put before."""
    report = folder / "report.html"
    if not report.is_file():
        return
    page = Page("")
    page.section("Files")
    rows = []
    for path in sorted(p for p in folder.iterdir() if p != report):
        name = f"{path.name}/" if path.is_dir() else path.name
        link = f'<a href="{quote(name)}">{escape(name)}</a>'
        rows.append(f'<tr><td>{link}</td><td class="text">{escape(HOLDS.get(path.name, ""))}</td></tr>')
    page.parts.append(f"<table><tbody>{''.join(rows)}</tbody></table>")
    text = page.put_into(report.read_text(encoding="utf-8", errors="replace"), "files")
    with result_file(report) as work:
        work.write_text(text, encoding="utf-8", errors="backslashreplace")
