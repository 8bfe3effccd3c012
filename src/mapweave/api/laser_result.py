"""What `map` and `fuse` give for laser logs: every robot's own map, and the maps of connected robots."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.names import robot_name
from ..core.records import Track
from ..core.version import __version__
from ..io.directory import write_json
from ..io.laser_map import write_closure_rows, write_laser_map, write_woven_map, write_woven_tracks
from ..io.laser_state import write_laser_states
from ..io.tum import write_track_covariance, write_tum
from ..laser.laser_map import LaserMap
from ..laser.merge import Merge
from ..laser.woven_map import WovenMap
from ..report.laser import write_laser_report
from ..report.laser_figures import aligned, draw_map
from ..report.result import ResultBase, Rows
from ..report.score import headline_scores
from ..report.style import Target
from ..report.woven import told_component, told_merge
from ..report.woven_figures import draw_component
from .evaluate import Evaluation


@dataclass(frozen=True, slots=True, repr=False)
class LaserResult(ResultBase):
    """What `map` and `fuse` give for laser logs: every robot's map, and the maps in which robots were joined.

    metrics: as in `metrics.json`; evaluation: the score, where truth was given; maps: each robot's own, in the frame
    of its first pose; components: the graph method's maps of the robots that were joined, that of most robots first;
    merges: every pair of robots tried, with the decision and its reason; starts: robot -> x, y, theta[, sigma] that
    were told; notes: what `summary` says beside.
    """

    maps: tuple[LaserMap, ...]
    metrics: dict[str, Any]
    evaluation: Evaluation | None = None
    truth: Mapping[str, Track] = field(default_factory=dict)
    components: tuple[WovenMap, ...] = ()
    merges: tuple[Merge, ...] = ()
    starts: Mapping[str, Sequence[float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def draw(self, target: Target) -> None:
        """The map of most robots with their trajectories."""
        if self.components and len(self.components[0].robots) > 1:
            places = {made.robot: k for k, made in enumerate(self.maps)}
            draw_component(target, self.components[0], self.truth, places)
            return
        first = self.maps[0]
        truth = self.truth.get(first.robot)
        draw_map(target, first, None if truth is None else aligned(truth, first.track))

    def headline(self) -> Rows:
        head = ("robot", "scans", "method", "feature", "map [m]")
        rows = []
        for made in self.maps:
            x0, x1, y0, y1 = made.grid.extent
            rows.append((made.robot, len(made.scans), made.method, made.feature, f"{x1 - x0:.0f} x {y1 - y0:.0f}"))
        return head, rows

    def write_into(self, folder: Path) -> None:
        """All files of the contract; a robot alone in its component has its own map's files there too."""
        write_laser_data(folder, self)
        told = [] if self.evaluation is None else self.evaluation.lines()
        doubts = self.metrics.get("warnings", ())
        top = [] if self.evaluation is None else headline_scores(self.evaluation.as_json())
        write_laser_report(folder, self.maps, self.truth, told, self.components, self.merges, self.notes, doubts, top)
        if not self.components and len(self.maps) == 1:
            _copied(folder, folder, self.maps[0].robot)
        for part, made in _parts(folder, self.components):
            if len(made.robots) == 1:
                _copied(part, folder, made.robots[0])
                write_closure_rows(part / "closures.csv", made.closures)

    def lines(self) -> list[str]:
        lines = []
        for made in self.maps:
            refused = Counter(made.scans.decision)["odometry"]
            x0, x1, y0, y1 = made.grid.extent
            lines.append(
                f"{robot_name(made.robot)}: {len(made.scans)} scans, {made.method}, feature {made.feature}, "
                f"map {x1 - x0:.0f} x {y1 - y0:.0f} m, {refused} matches refused"
            )
            lines += [f"{robot_name(made.robot)}: {warning}" for warning in made.warnings]
        lines += [told_merge(merge) for merge in self.merges]
        if len(self.maps) > 1 and self.components:
            lines += [told_component(made) for made in self.components]
        lines += self.notes
        lines += [f"warning: {text}" for text in self.metrics.get("warnings", ())]
        return lines + ([] if self.evaluation is None else self.evaluation.lines())


def laser_metrics(
    maps: Sequence[LaserMap],
    seed: int,
    components: Sequence[WovenMap] = (),
    merges: Sequence[Merge] = (),
    timing: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """What stands in `metrics.json`, without a score."""
    spent = {f"{robot_name(m.robot)} {stage}": spent for m in maps for stage, spent in m.timing.items()}
    return {
        "version": __version__,
        "seed": seed,
        "robots": {made.robot: _robot_metrics(made) for made in maps},
        "components": [list(c.robots) for c in components] or [[made.robot] for made in maps],
        "fusion": [merge.row() for merge in merges],
        "timing": {**spent, **(timing or {})},
    }


def _robot_metrics(made: LaserMap) -> dict[str, Any]:
    decisions = Counter(made.scans.decision)
    c = made.calibration
    told: dict[str, Any] = {
        "source": made.source,
        "odometry": made.odometry,
        "sightings": len(made.scans),
        "dropped": dict(made.dropped),
        "down_weighted": decisions["odometry"],
        "nis_median": None,
        "warnings": list(made.warnings),
        "method": made.method,
        "feature": made.feature,
        "particles": made.particles,
        "log_hash": made.log_hash,
        "decisions": dict(sorted(decisions.items())),
        "calibration": None
        if c is None
        else {"exponent": c.exponent, "scale": c.scale, "residual": c.residual, "samples": c.samples},
    }
    return {**told, "name": made.called} if made.called else told


def write_laser_data(folder: Path, result: LaserResult) -> None:
    """Every file but the report and the copies of lone robots' maps: what scores and what goes on is read from."""
    maps, components = result.maps, result.components
    write_json(folder / "metrics.json", result.metrics)
    for made in maps:
        write_laser_map(folder / "local" / robot_name(made.robot), made)
        if not components:
            write_tum(folder / "trajectories" / f"{robot_name(made.robot)}.tum", made.track)
            write_track_covariance(folder / "trajectories" / f"{robot_name(made.robot)}.cov.csv", made.track)
    for part, woven in _parts(folder, components):
        if len(woven.robots) == 1:
            write_woven_tracks(part, woven)
        else:
            write_woven_map(part, woven)
    if components:
        write_laser_states(folder, maps, result.starts)


def _parts(folder: Path, components: Sequence[WovenMap]) -> list[tuple[Path, WovenMap]]:
    """Where each component stands: the first at the top."""
    return [(folder if k == 1 else folder / "components" / str(k), made) for k, made in enumerate(components, 1)]


def _copied(part: Path, folder: Path, robot: str) -> None:
    part.mkdir(parents=True, exist_ok=True)
    for path in sorted((folder / "local" / robot_name(robot)).iterdir()):
        if path.is_file():
            (part / path.name).write_bytes(path.read_bytes())
