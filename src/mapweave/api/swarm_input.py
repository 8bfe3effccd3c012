"""From what a user gives `locate` to what the estimators take; every repair is counted and told."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.bearings import BearingTable, parse_angle
from ..core.errors import DataError, UsageError
from ..io.sightings import Dropped, SwarmTruth, read_sightings, read_swarm_truth
from ..io.table import Table
from ..io.team_bearings import read_team_truth
from ..swarm.network import DEFAULT_SIGMA, BearingNetwork, Distance, contradictions, copies, shares_an_axis

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
        if table.dim == 3:
            raise DataError(f"{name}: mutual sightings do not point at each other; in space robots need common axes")
        table = BearingTable(table.ids, table.observer, table.target, table.direction, filled, table.t, axis=False)
        warnings.append(
            "mutual sightings do not point at each other: no common axis, so every robot's heading is estimated"
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
    apart = tuple(Distance(index(a, "robot"), index(b, "robot"), float(d)) for a, b, d in distances)
    return known, apart
