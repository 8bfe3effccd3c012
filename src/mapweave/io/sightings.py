"""Sightings of a swarm, its truth and its odometry, from CSV or Parquet.

`observer,target,bearing` [rad] in the plane; `observer,target,azimuth,elevation` or `observer,target,bx,by,bz` in
space; optional `sigma` [rad] and `t` [s]. `robot,id` are understood for `observer,target`.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ..core.bearings import BearingTable, unit, unit3
from ..core.errors import DataError, ReaderError, UsageError
from ..core.names import in_order
from ..core.records import Odometry, frozen
from .directory import result_file
from .landmark_logs import read_landmark_logs
from .landmark_truth import read_robot_truth
from .table import Table, read_table, write_table

HUGE = 1e100  # a number whose square may overflow
LAYOUTS = (("bearing",), ("azimuth", "elevation"), ("bx", "by", "bz"))


@dataclass(frozen=True, slots=True)
class Dropped:
    """One row that was left out: where it stands, whom it names, why."""

    line: int
    observer: str
    target: str
    reason: str


@dataclass(frozen=True, slots=True)
class SwarmLog:
    """Sightings as read, every row that was left out, and what looked wrong. `lines[k]`: line of the table's row k."""

    source: str
    table: BearingTable
    lines: Sequence[int]
    dropped: tuple[Dropped, ...]
    warnings: tuple[str, ...]

    def counts(self) -> dict[str, int]:
        return dict(sorted(Counter(row.reason for row in self.dropped).items()))


@dataclass(frozen=True, slots=True)
class SwarmTruth:
    """Where robots really were. position: (n, d) [m]; t: (n,) [s] or None; heading: (n,) [rad] or None."""

    ids: tuple[str, ...]
    position: Float[np.ndarray, "n d"]
    t: Float[np.ndarray, " n"] | None = None
    heading: Float[np.ndarray, " n"] | None = None


def read_sightings(path: Path | Table, *, dim: int | None = None, axis: bool = True) -> SwarmLog:
    """The sightings in a file or table; rows with NaN or observer = target are left out and listed.

    Raises ReaderError for a row that does not parse, and DataError when no sighting is left.
    """
    file = path if isinstance(path, Table) else read_table(path)
    layout = _layout(file, dim)
    _need_names(file)
    observer, target = file.names(_column(file, "observer", "robot")), file.names(_column(file, "target", "id"))
    values = np.column_stack([file.numbers(name) for name in layout]) if len(file) else np.zeros((0, len(layout)))
    t = file.numbers("t") if "t" in file.columns else None
    sigma = file.numbers("sigma") if "sigma" in file.columns else np.full(len(file), np.nan)
    _check_sigma(file, sigma)

    bad, reasons = _bad_rows(layout, values, t, observer, target)
    dropped = tuple(Dropped(file.lines[k], observer[k], target[k], reasons[k]) for k in np.flatnonzero(bad).tolist())
    keep = np.flatnonzero(~bad)
    if not len(keep):
        reason = f" ({len(dropped)} rows dropped: {dropped[0].reason})" if dropped else ""
        raise DataError(f"{file.path}: no sightings{reason}")
    ids = natural_order(set(observer) | set(target))
    place = {name: k for k, name in enumerate(ids)}
    index = [np.fromiter((place[w] for w in names), np.int64, len(file))[keep] for names in (observer, target)]
    values = values[keep]
    direction = (
        unit(values[:, 0])
        if len(layout) == 1
        else unit3(values[:, 0], values[:, 1])
        if len(layout) == 2
        else _tame(values) / np.linalg.norm(_tame(values), axis=1, keepdims=True)
    )
    table = BearingTable(ids, index[0], index[1], direction, sigma[keep], None if t is None else t[keep], axis)
    lines = [file.lines[k] for k in keep.tolist()]
    return SwarmLog(str(file.path), table, lines, dropped, tuple(_warnings(file.path, layout, values)))


def read_swarm_truth(path: Path | Table) -> SwarmTruth:
    """The truth in a file or table: `id,x,y[,z]`, optional `t` and `heading`; a repeated id without `t` is an error."""
    file = path if isinstance(path, Table) else read_table(path)
    _need(file, ("id", "x", "y"))
    ids = tuple(file.names("id"))
    names = [name for name in ("x", "y", "z") if name in file.columns]
    position = np.column_stack([file.numbers(name) for name in names]) if len(file) else np.zeros((0, len(names)))
    if not np.all(np.isfinite(position)):
        row = int(np.flatnonzero(~np.isfinite(position).all(axis=1))[0])
        raise ReaderError(file.path, f"expected finite {','.join(names)} for {ids[row]}", file.lines[row])
    t = file.numbers("t") if "t" in file.columns else None
    if t is not None and not np.isfinite(t).all():
        row = int(np.flatnonzero(~np.isfinite(t))[0])
        raise ReaderError(file.path, f"expected a finite t for {ids[row]}", file.lines[row])
    if t is None and len(set(ids)) < len(ids):
        twice = Counter(ids).most_common(1)[0][0]
        raise ReaderError(file.path, f"robot {twice} stands twice and there is no column t")
    heading = file.numbers("heading") if "heading" in file.columns else None
    return SwarmTruth(ids, position, t, heading)


def natural_order(names: set[str]) -> tuple[str, ...]:
    """`names` sorted, numbers as numbers: 2 before 10."""
    return tuple(sorted(names, key=in_order))


def _layout(file: Table, dim: int | None) -> tuple[str, ...]:
    if dim not in {None, 2, 3}:
        raise UsageError(f"--dim: expected 2 or 3, found {dim}")
    layouts = [names for names in LAYOUTS if all(name in file.columns for name in names)]
    if dim is not None:
        layouts = [names for names in layouts if (len(names) == 1) == (dim == 2)]
    if len(layouts) != 1:
        wanted = {2: "bearing", 3: "azimuth,elevation or bx,by,bz"}
        expected = wanted[dim] if dim else "one of bearing; azimuth,elevation; bx,by,bz"
        head = ",".join(file.columns)
        raise ReaderError(file.path, f"expected observer,target and {expected}; found {head}", 1)
    return layouts[0]


def _column(file: Table, *names: str) -> str:
    for name in names:
        if name in file.columns:
            return name
    raise ReaderError(file.path, f"expected a column {names[0]}, found {','.join(file.columns)}", 1)


def _need_names(file: Table) -> None:
    """Raises ReaderError where no row says who was seen."""
    told = next((file.columns[name] for name in ("target", "id") if name in file.columns), None)
    if len(file) and not any(word.strip() for word in told or ()):
        line = 1 if told is None else file.lines[0]
        said = "expected who was seen in a column target: sightings without names are not located"
        raise ReaderError(file.path, said, line)


def _need(file: Table, names: tuple[str, ...]) -> None:
    missing = [name for name in names if name not in file.columns]
    if missing:
        raise ReaderError(file.path, f"expected columns {','.join(names)}, found {','.join(file.columns)}", 1)


def _check_sigma(file: Table, sigma: Float[np.ndarray, " n"]) -> None:
    wrong = np.flatnonzero((sigma <= 0.0) | np.isinf(sigma))
    if len(wrong):
        row = int(wrong[0])
        raise ReaderError(file.path, f"expected a positive sigma [rad], found {sigma[row]:g}", file.lines[row])


def _bad_rows(
    layout: tuple[str, ...],
    values: Float[np.ndarray, "n c"],
    t: Float[np.ndarray, " n"] | None,
    observer: Sequence[str],
    target: Sequence[str],
) -> tuple[Bool[np.ndarray, " n"], dict[int, str]]:
    """Which rows cannot be used, and why each."""
    reasons: dict[int, str] = {}
    bad = ~np.isfinite(values).all(axis=1)
    reasons.update(dict.fromkeys(np.flatnonzero(bad).tolist(), "not a number"))
    if t is not None:
        unstamped = ~np.isfinite(t) & ~bad
        reasons.update(dict.fromkeys(np.flatnonzero(unstamped).tolist(), "no time stamp"))
        bad |= unstamped
    if len(layout) == 3:
        short = (np.linalg.norm(_tame(np.where(bad[:, None], 1.0, values)), axis=1) < 1e-9) & ~bad
        reasons.update(dict.fromkeys(np.flatnonzero(short).tolist(), "zero direction"))
        bad |= short
    own = [k for k, (a, b) in enumerate(zip(observer, target, strict=True)) if a == b]
    for k in own:
        reasons.setdefault(k, "observer is target")
    bad[own] = True
    return bad, reasons


def _tame(directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The same directions, those whose squares would overflow made shorter."""
    largest = np.abs(directions).max(axis=1, keepdims=True, initial=0.0)
    return directions / np.where(largest > HUGE, largest, 1.0)


# what each angle of a bearing is called, how far it may go [rad], and that in words
LIMITS = (("bearings", 2.0 * np.pi, "a full turn"), ("elevations", 0.5 * np.pi, "straight up or down"))


def _warnings(path: Path | str, layout: tuple[str, ...], values: Float[np.ndarray, "m c"]) -> list[str]:
    if len(layout) == 3:
        return []
    told = []
    for column, (name, most, words) in enumerate(LIMITS[: len(layout)]):
        size = np.abs(values[:, column])
        if beyond := int((size > most + 1e-6).sum()):
            what = f"{beyond} of {len(values)} {name} lie beyond {words} (largest {size.max():.4g} rad)"
            told.append(f"{path}: {what}: are they degrees? Bearings are read as radians")
    return told


def read_swarm_odometry(path: Path | Table) -> dict[str, Odometry]:
    """Velocities by robot from `t,robot,v,w` [s, m/s, rad/s]; of equal stamps the last row counts.

    Raises ReaderError for a row that does not parse or says nothing.
    """
    file = path if isinstance(path, Table) else read_table(path)
    _need(file, ("t", "robot", "v", "w"))
    rows = np.column_stack([file.numbers(name) for name in ("t", "v", "w")]) if len(file) else np.zeros((0, 3))
    if not np.isfinite(rows).all():
        k = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
        raise ReaderError(file.path, "expected finite t, v and w", file.lines[k])
    names = np.array(file.names("robot"))
    out = {}
    for name in natural_order(set(names.tolist())):
        mine = rows[names == name]
        mine = mine[np.argsort(mine[:, 0], kind="stable")]
        mine = mine[np.append(np.diff(mine[:, 0]) > 0.0, True)]
        out[name] = Odometry(frozen(mine[:, 0]), frozen(mine[:, 1]), frozen(mine[:, 2]))
    return out


def write_sightings(path: Path, table: BearingTable) -> None:
    """`[t,]observer,target,bearing|azimuth,elevation,sigma`: CSV, or Parquet by its suffix."""
    azimuth = table.bearing()
    columns: dict[str, list] = {
        "observer": [table.ids[k] for k in table.observer.tolist()],
        "target": [table.ids[k] for k in table.target.tolist()],
    }
    if table.dim == 2:
        columns["bearing"] = azimuth.tolist()
    else:
        columns["azimuth"] = azimuth.tolist()
        columns["elevation"] = np.arcsin(np.clip(table.direction[:, 2], -1.0, 1.0)).tolist()
    if not np.isnan(table.sigma).all():
        columns["sigma"] = table.sigma.tolist()
    if table.t is not None:
        columns["t"] = table.t.tolist()
    if path.suffix.lower() in (".parquet", ".pq"):
        _write_parquet(path, columns)
    else:
        write_table(path, list(columns), zip(*columns.values(), strict=True))


def _write_parquet(path: Path, columns: dict[str, list]) -> None:
    try:
        import pyarrow as pa  # noqa: PLC0415  (an extra: only Parquet files need it)
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise UsageError(f"{path}: Parquet needs pyarrow: install mapweave with the extra [parquet]") from None
    with result_file(path) as work:
        parquet.write_table(pa.table(columns), work)


def read_team_bearings(path: Path) -> tuple[BearingTable, dict[str, Odometry]]:
    """Stamped sightings of robots by robots, in each observer's own frame, and every robot's odometry, by number.

    Ranges and landmarks are left aside; sigma is not said. Raises DataError when no robot sighted another.
    """
    logs = read_landmark_logs(path)
    ids = tuple(str(log.number) for log in logs)
    place = {f"robot{name}": k for k, name in enumerate(ids)}
    observer, target, bearing, t = [], [], [], []
    for k, log in enumerate(logs):
        seen = log.sightings
        other = np.array([place.get(name, -1) for name in seen.ids], dtype=np.int64)
        rows = other[seen.what] >= 0 if len(seen) else np.zeros(0, dtype=bool)
        observer.append(np.full(int(rows.sum()), k))
        target.append(other[seen.what[rows]])
        bearing.append(seen.bearing[rows])
        t.append(seen.t[rows])
    stamps = np.concatenate(t)
    if not len(stamps):
        raise DataError(f"{path}: no robot sighted another")
    order = np.argsort(stamps, kind="stable")
    table = BearingTable(
        ids,
        np.concatenate(observer)[order],
        np.concatenate(target)[order],
        unit(np.concatenate(bearing)[order]),
        np.full(len(order), np.nan),
        stamps[order],
        axis=False,
    )
    return table, {name: log.odometry for name, log in zip(ids, logs, strict=True) if log.odometry is not None}


def read_team_truth(path: Path) -> SwarmTruth:
    """The true poses of all robots of an MRCLAM data set, by number. Raises DataError when it has none."""
    tracks = read_robot_truth(path)
    if not tracks:
        raise DataError(f"{path}: no true poses of robots here")
    names = [robot.removeprefix("robot") for robot in tracks]
    ids = tuple(name for name, (track, _) in zip(names, tracks.values(), strict=True) for _ in track.t)
    pose = np.concatenate([track.pose for track, _ in tracks.values()])
    return SwarmTruth(ids, pose[:, :2], np.concatenate([track.t for track, _ in tracks.values()]), pose[:, 2])
