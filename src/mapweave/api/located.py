"""What `locate` was given, made ready, and what it found: of robots that stand still, and of robots that move."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..core.bearings import BearingTable, parse_angle
from ..core.errors import DataError, UsageError
from ..core.version import __version__
from ..evaluation.swarm import StandingScore, StandingSwarm, SwarmScore
from ..io.directory import write_json
from ..io.positions import track_files, write_network, write_others, write_positions, write_track
from ..io.sightings import Dropped, SwarmTruth, read_sightings, read_swarm_truth, read_team_truth
from ..io.table import Table, write_table
from ..report.result import ResultBase
from ..report.style import Target
from ..report.swarm import (
    MovedStory,
    NetworkStory,
    moved_scene,
    network_scenes,
    write_moved_report,
    write_network_report,
)
from ..swarm.config import SwarmConfig
from ..swarm.moving.result import SwarmTrack
from ..swarm.network import DEFAULT_SIGMA, BearingNetwork, Distance, contradictions, copies, shares_an_axis
from ..swarm.posterior import chi2_warnings, share_warnings
from ..swarm.result import SwarmEstimate, SwarmStatus

Place = Sequence[float] | Float[np.ndarray, " d"]


@dataclass(frozen=True, slots=True)
class SwarmInput:
    """Sightings made ready. table: every sigma filled in; anchors, distances: by index; warnings: said so far."""

    source: str
    table: BearingTable
    anchors: Mapping[int, Float[np.ndarray, " d"]]
    distances: tuple[Distance, ...]
    sigma_source: str
    dropped: tuple[Dropped, ...] = ()
    warnings: tuple[str, ...] = field(default=())

    @property
    def sigma(self) -> float:
        """The usual standard deviation [rad]."""
        return float(np.median(self.table.sigma))

    def network(self) -> BearingNetwork:
        """All sightings at once, stamps forgotten."""
        table = self.table
        bearing = table.bearing() if table.dim == 2 else table.direction
        return BearingNetwork(
            table.ids,
            table.dim,
            table.observer.astype(np.intp),
            table.target.astype(np.intp),
            bearing,
            table.sigma,
            self.anchors,
            self.distances,
            table.axis,
        )


def prepare(
    source: Path | str | BearingTable | Table,
    *,
    anchors: Mapping[str, Place],
    dim: int | None,
    sigma: float | str | None,
    distances: Sequence[tuple[str, str, float]],
    axis: bool | None,
    until: float | None = None,
) -> SwarmInput:
    """The sightings of `source` with the noise, axes and known places filled in.

    Raises ReaderError for a file that does not parse, DataError for an unknown robot or when nothing is left,
    UsageError for options that make no sense together.
    """
    warnings: list[str] = []
    dropped: tuple[Dropped, ...] = ()
    lines: Sequence[int] | None = None
    if isinstance(source, BearingTable):
        table, name = source, "sightings"
        if dim is not None and table.dim != dim:
            raise UsageError(f"--dim {dim}: the sightings are of {table.dim} dimensions")
    else:
        log = read_sightings(source if isinstance(source, Table) else Path(source), dim=dim)
        table, name, dropped, lines = log.table, log.source, log.dropped, log.lines
        warnings += log.warnings
    if until is not None:
        if table.t is None:
            raise UsageError("--until: the sightings bear no time stamps")
        early = table.t < table.t.min() + until
        lines = None if lines is None else [lines[k] for k in np.flatnonzero(early).tolist()]
        table = table.rows(early)
    filled, sigma_source = _filled(table, sigma)
    table = BearingTable(table.ids, table.observer, table.target, table.direction, filled, table.t, axis is not False)
    if axis is None and not warnings and not shares_an_axis(table, filled):
        table = BearingTable(table.ids, table.observer, table.target, table.direction, filled, table.t, axis=False)
        what = "heading is" if table.dim == 2 else "own axes are"
        warnings.append(
            f"mutual sightings do not point at each other: no common axis, so every robot's {what} estimated"
        )
    at = np.arange(1, len(table.observer) + 1) if lines is None else np.asarray(lines)
    again = copies(table, table.sigma)
    if again.any():
        dropped += _left_out(table, at, again, "copy of another row")
        warnings.append(f"{int(again.sum())} rows are copies of other rows, to the last digit: each counts once")
        table, at = table.rows(~again), at[~again]
    bad = contradictions(table, table.sigma)
    if bad.any():
        dropped += _left_out(table, at, bad, "contradicts another row")
        warnings.append(f"{int(bad.sum())} rows contradict another row of the same robots and were left out")
        table = table.rows(~bad)
        if not len(table.observer):
            raise DataError(f"{name}: no sightings are left: all contradict each other")
    known, apart = _known(name, table, anchors, distances)
    return SwarmInput(name, table, known, apart, sigma_source, dropped, tuple(warnings))


def _left_out(table: BearingTable, line: np.ndarray, rows: np.ndarray, reason: str) -> tuple[Dropped, ...]:
    """The rows (mask), each with the line it stands at."""
    return tuple(
        Dropped(int(line[k]), table.ids[table.observer[k]], table.ids[table.target[k]], reason)
        for k in np.flatnonzero(rows).tolist()
    )


def read_truth(given: Path | Table) -> SwarmTruth:
    """The true places or poses of robots: a table `id,x,y[,z][,t]`, or the folder or zip of a landmark log."""
    return read_team_truth(given) if isinstance(given, Path) and is_team_log(given) else read_swarm_truth(given)


def is_team_log(path: Path) -> bool:
    """Whether `path` is what a landmark log comes in: a folder or a zip."""
    return path.is_dir() or path.suffix.lower() == ".zip"


def _filled(table: BearingTable, sigma: float | str | None) -> tuple[Float[np.ndarray, " m"], str]:
    """A standard deviation [rad] for every row, and where it comes from; an option wins over the file."""
    if sigma is not None:
        value = parse_angle(sigma) if isinstance(sigma, str) else float(sigma)
        return np.full(len(table.sigma), value), "option"
    missing = np.isnan(table.sigma)
    if not missing.any():
        return table.sigma.copy(), "file"
    return np.where(missing, DEFAULT_SIGMA, table.sigma), "default" if missing.all() else "file, default where empty"


def _known(
    name: str, table: BearingTable, anchors: Mapping[str, Place], distances: Sequence[tuple[str, str, float]]
) -> tuple[dict[int, Float[np.ndarray, " d"]], tuple[Distance, ...]]:
    place = {robot: k for k, robot in enumerate(table.ids)}

    def index(robot: str, what: str) -> int:
        if robot not in place:
            some = ", ".join(table.ids[:5]) + (", .." if len(table.ids) > 5 else "")
            raise DataError(f"{name}: {what} {robot!r} never appears; the robots are {some}")
        return place[robot]

    known = {}
    for robot, where in anchors.items():
        p = np.asarray(where, dtype=np.float64)
        if p.shape != (table.dim,) or not np.isfinite(p).all():
            raise UsageError(f"--anchor {robot}: expected {table.dim} finite coordinates, found {p.tolist()}")
        known[index(robot, "anchor")] = p
    for row in distances:
        if not isinstance(row, Sequence) or len(row) != 3 or not (isinstance(row[2], Real) and 0.0 < row[2] < math.inf):
            raise UsageError(f"distances: expected two robots and metres above 0 between them, found {row!r}")
    apart = tuple(Distance(index(a, "robot"), index(b, "robot"), float(d)) for a, b, d in distances)
    return known, apart


LISTED = 1000  # dropped rows named in metrics.json
NO_SCORE = {"rmse": None, "crlb_rmse": None, "rmse_over_crlb": None, "nees_per_dof": None}


@dataclass(frozen=True, slots=True)
class Settings:
    """How `locate` was asked; `timing` [s] by stage is filled in as it runs."""

    method: str
    seed: int
    timing: dict[str, float] = field(default_factory=dict)
    truth: SwarmTruth | None = None
    swarm: SwarmConfig = field(default_factory=SwarmConfig)


def head(given: SwarmInput, settings: Settings) -> dict[str, Any]:
    """What `metrics.json` says of the question and the data."""
    reasons: dict[str, int] = {}
    for row in given.dropped:
        reasons[row.reason] = reasons.get(row.reason, 0) + 1
    table = given.table
    return {
        "version": __version__,
        "seed": settings.seed,
        "method": settings.method,
        "dim": table.dim,
        "robots": len(table.ids),
        "sightings": len(table.observer),
        "anchors": [table.ids[k] for k in given.anchors],
        "axis": table.axis,
        "sigma_deg": float(np.degrees(given.sigma)),
        "sigma_source": given.sigma_source,
        "dropped": dict(sorted(reasons.items())),
        "dropped_rows": [
            {"line": row.line, "observer": row.observer, "target": row.target, "reason": row.reason}
            for row in given.dropped[:LISTED]
        ],
    }


def write_rest(out: Path, given: SwarmInput, metrics: dict[str, Any]) -> None:
    """metrics.json and, where rows were left out, dropped.csv."""
    if given.dropped:
        rows = [(r.line, r.observer, r.target, r.reason) for r in given.dropped]
        write_table(out / "dropped.csv", ["line", "observer", "target", "reason"], rows)
    write_json(out / "metrics.json", metrics)


def counts(
    n: int, observer: np.ndarray, target: np.ndarray, outlier: np.ndarray
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Sightings each of n robots has a part in, and how many of them are outliers."""
    both = np.concatenate([observer, target])
    wild = np.concatenate([outlier, outlier])
    return np.bincount(both, minlength=n), np.bincount(both[wild], minlength=n)


def sigma_text(given: SwarmInput) -> str:
    """The standard deviation of a bearing, and where it is from."""
    sources = {"default": "assumed; give --sigma", "option": "as given", "file": "from the file"}
    return f"sigma {np.degrees(given.sigma):.3g} deg ({sources.get(given.sigma_source, given.sigma_source)})"


def dropped_lines(given: SwarmInput) -> list[str]:
    """One line about rows left out, or none."""
    if not given.dropped:
        return []
    some = ", ".join(f"line {r.line} ({r.observer} sees {r.target}: {r.reason})" for r in given.dropped[:5])
    return [f"{len(given.dropped)} rows left out: {some}{', ..' if len(given.dropped) > 5 else ''}"]


@dataclass(frozen=True, slots=True, repr=False)
class Located(ResultBase):
    """What `locate` gives for robots that stand still: a position each, with its covariance."""

    given: SwarmInput
    settings: Settings
    network: BearingNetwork
    estimate: SwarmEstimate
    scored: StandingScore | None

    @property
    def score(self) -> SwarmScore | None:
        return None if self.scored is None else self.scored.score

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self.given.warnings, *self.estimate.warnings)

    @property
    def metrics(self) -> dict[str, Any]:
        """`metrics.json`; keys as the contract names them."""
        e = self.estimate
        return {
            **head(self.given, self.settings),
            **(NO_SCORE if self.score is None else self.score.as_json()),
            "iterations": e.iterations,
            "status": str(e.status),
            "chi2": e.chi2,
            "dof": e.dof,
            "gauge": e.gauge,
            "null_space": e.null_space,
            "not_localisable": list(e.not_localisable),
            "reliable": e.reliable,
            "others": len(e.others),
            "weak_anchors": e.weak_anchors,
            "mode_share": e.mode_share,
            "outliers": int(e.outlier.sum()),
            "traffic": None
            if e.traffic is None
            else {"rounds": e.traffic.rounds, "messages": e.traffic.messages, "bytes": e.traffic.bytes},
            "moving": False,
            "warnings": list(self.warnings),
            "timing": self.settings.timing,
        }

    def lines(self) -> list[str]:
        """A summary for people."""
        e = self.estimate
        lines = [
            (
                f"{len(e.ids)} robots in {e.dim}D, {len(self.network.observer)} sightings, {sigma_text(self.given)}, "
                f"{len(self.given.anchors)} anchors, method {e.method}: {e.status} after {e.iterations} iterations"
            )
        ]
        lines += dropped_lines(self.given)
        if e.gauge:
            lines.append(f"without enough anchors the answer is the shape alone: {e.gauge}")
        if e.cov is not None:
            free = e.localisable & ~e.anchor
            if free.any():
                std = float(np.sqrt(np.trace(e.cov[free], axis1=1, axis2=2).mean()))
                unit = "" if "scale free" in e.gauge else " m"
                lines.append(f"estimated standard deviation of a position: {std:.4g}{unit} (rms)")
        lost = e.not_localisable
        if lost:
            lines.append(
                f"{len(lost)} robots cannot be located: {', '.join(lost[:20])}{', ..' if len(lost) > 20 else ''}"
            )
        lines.append(
            f"chi-square {e.chi2:.4g} with {e.dof} degrees of freedom, {int(e.outlier.sum())} outliers: "
            f"{'reliable' if e.reliable else 'NOT reliable'}"
        )
        if e.traffic:
            lines.append(
                f"{e.traffic.rounds} rounds, {e.traffic.messages} messages, {e.traffic.bytes} bytes between robots"
            )
        if self.score is not None:
            lines += self.score.lines()
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def draw(self, target: Target) -> None:
        """The robots in the plane."""
        front, *sides = network_scenes(self.network, self.estimate, self.story().truth)
        front.draw(target, *sides)

    def write_into(self, out: Path) -> None:
        """positions.csv, others.csv where others fit as well, network.npz, metrics.json, report.html, figures/ and, for
        stamped sightings, trajectories/.
        """
        self.write_data(out)
        write_network_report(out, self.story(), self.lines(), self.metrics)

    def write_data(self, out: Path) -> None:
        e = self.estimate
        seen, wild = self.counts()
        write_positions(
            out / "positions.csv", e.ids, e.position, e.cov, e.localisable, seen, wild, e.heading, e.heading_var
        )
        if e.others:
            write_others(out / "others.csv", e.ids, e.others)
        scored = standing_swarm(self.network, e)
        write_network(out / "network.npz", scored.pairs, scored.information)
        t = self.given.table.t
        if t is not None:
            files = track_files(e.ids)
            for k, name in enumerate(e.ids):
                rows = (self.given.table.observer == k) | (self.given.table.target == k)
                at = np.unique(t[rows])
                place = np.tile(e.position[k], (len(at), 1))
                cov = None if e.cov is None else np.tile(e.cov[k], (len(at), 1, 1))
                write_track(out / "trajectories" / files[name], at, place, cov)
        write_rest(out, self.given, self.metrics)

    def counts(self) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Sightings each robot has a part in, and how many of them are outliers."""
        return counts(len(self.estimate.ids), self.network.observer, self.network.target, self.estimate.outlier)

    def story(self) -> NetworkStory:
        scored = self.scored
        return NetworkStory(
            self.network,
            self.estimate,
            None if scored is None else scored.truth,
            None if scored is None else scored.aligned,
        )


def standing_swarm(net: BearingNetwork, estimate: SwarmEstimate) -> StandingSwarm:
    """What is scored of `estimate`; the joint information stands where it says what the covariances say."""
    pairs = np.column_stack([net.observer, net.target])
    honest = estimate.cov is not None and not estimate.gauge and np.any(net.sigma > 0)
    joint = estimate.information if honest else None
    return StandingSwarm(
        estimate.ids,
        estimate.position,
        estimate.cov,
        estimate.localisable,
        estimate.anchor,
        estimate.gauge,
        pairs,
        joint,
        float(np.median(net.sigma)),
    )


@dataclass(frozen=True, slots=True, repr=False)
class Moved(ResultBase):
    """What `locate` gives for robots that move: a trajectory each, with its covariances.

    truth: by robot index, the true positions at the trajectory's stamps.
    """

    given: SwarmInput
    settings: Settings
    track: SwarmTrack
    score: SwarmScore | None
    truth: Mapping[int, Float[np.ndarray, "k d"]]

    @property
    def reliable(self) -> bool:
        """Whether the smoothing converged, and enough sightings agree with it."""
        return self.track.converged and not self._doubts()

    def _doubts(self) -> list[str]:
        t = self.track
        doubts = share_warnings(t.outlier)
        misfit = chi2_warnings(t.chi2, t.dof)
        if misfit and t.dof > 0:
            ratio = t.chi2 / t.dof
            misfit = [f"residuals are {ratio:.3g} times what sigma and the motion model say: covariances are too small"]
        return doubts + misfit

    @property
    def not_localisable(self) -> tuple[str, ...]:
        """Robots without a track, and those whose positions are less sure than the swarm is wide."""
        return tuple(name for k, name in enumerate(self.given.table.ids) if not self.track.localisable(k))

    @property
    def warnings(self) -> tuple[str, ...]:
        warnings = [*self.given.warnings, *self.track.warnings]
        if not self.track.converged:
            warnings.append("the smoothing did not converge")
        else:
            warnings += self._doubts()
        return tuple(warnings)

    @property
    def metrics(self) -> dict[str, Any]:
        """`metrics.json`; keys as the contract names them."""
        t = self.track
        names = self.given.table.ids
        return {
            **head(self.given, self.settings),
            **(NO_SCORE if self.score is None else self.score.as_json()),
            "iterations": t.iterations,
            "status": str(SwarmStatus.CONVERGED if t.converged else SwarmStatus.ITERATION_LIMIT),
            "chi2": t.chi2,
            "dof": t.dof,
            "gauge": t.gauge,
            "null_space": None,
            "not_localisable": list(self.not_localisable),
            "reliable": self.reliable,
            "outliers": int(t.outlier.sum()),
            "moving": True,
            "odometry_scale": None
            if t.scale is None
            else {names[k]: [v, w] for k, (v, w) in sorted(t.scale.items()) if (v, w) != (1.0, 1.0)},
            "warnings": list(self.warnings),
            "timing": self.settings.timing,
        }

    def lines(self) -> list[str]:
        """A summary for people."""
        t = self.track
        knots = sum(len(one.t) for one in t.tracks.values())
        lines = [
            (
                f"{len(self.given.table.ids)} moving robots in {self.given.table.dim}D, "
                f"{len(self.given.table.observer)} sightings, {sigma_text(self.given)}, "
                f"{len(self.given.anchors)} anchors: {knots} positions, {t.method}, {t.iterations} iterations"
            )
        ]
        lines += dropped_lines(self.given)
        if t.gauge:
            lines.append(t.gauge)
        if self.not_localisable:
            lost = self.not_localisable
            lines.append(f"{len(lost)} robots cannot be located: {', '.join(lost[:20])}")
        lines.append(
            f"chi-square {t.chi2:.4g} with {t.dof} degrees of freedom, {int(t.outlier.sum())} outliers: "
            f"{'reliable' if self.reliable else 'NOT reliable'}"
        )
        if self.score is not None:
            lines += self.score.lines()
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def draw(self, target: Target) -> None:
        """The robots in the plane."""
        moved_scene(self.given.table.ids, self.track, self.given.anchors, dict(self.truth)).draw(target)

    def write_into(self, out: Path) -> None:
        """trajectories/ID.csv, positions.csv (each robot's last), metrics.json, report.html and figures/."""
        self.write_data(out)
        story = MovedStory(
            self.given.table.ids, self.track, self.given.anchors, self.truth if self.score is not None else {}
        )
        write_moved_report(out, story, self.lines(), self.metrics)

    def write_data(self, out: Path) -> None:
        table, tracks = self.given.table, self.track.tracks
        n, d = len(table.ids), table.dim
        last, cov, located = np.full((n, d), np.nan), np.full((n, d, d), np.nan), np.zeros(n, dtype=bool)
        lost, files = set(self.not_localisable), track_files(table.ids)
        for k, one in tracks.items():
            write_track(out / "trajectories" / files[table.ids[k]], one.t, one.position, one.cov, one.heading)
            last[k], located[k] = one.position[-1], table.ids[k] not in lost
            if one.cov is not None:
                cov[k] = one.cov[-1]
        seen, wild = counts(n, table.observer, table.target, self.track.outlier)
        write_positions(out / "positions.csv", table.ids, last, cov, located, seen, wild)
        write_rest(out, self.given, self.metrics)
