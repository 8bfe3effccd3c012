"""Landmark logs: velocities and sightings of one robot, mended where that is safe: counted, reported, never silent.

A `TeamRecording` is what a simulator makes of a whole team, with its truth, and a writer puts into files.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from .errors import DataError, ReaderError
from .findings import Finding, Unused, Value
from .fixes import Fixes
from .records import Event, LandmarkPacket, Odometry, expect_seconds, freeze


@dataclass(frozen=True, slots=True)
class SightingTable:
    """n sightings in order of time. t: (n,) [s]; what: (n,) index into `ids`; range: (n,) [m]; bearing: (n,) [rad].

    `ids` are landmark names, `barcode:NN` for a barcode nobody listed, `robotK` for another robot.
    """

    t: Float[np.ndarray, " n"]
    what: Int[np.ndarray, " n"]
    range: Float[np.ndarray, " n"]
    bearing: Float[np.ndarray, " n"]
    ids: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "t", "range", "bearing")
        freeze(self, "what", dtype=np.int64)

    def __len__(self) -> int:
        return len(self.t)

    def select(self, keep: np.ndarray) -> "SightingTable":
        """The rows of a mask or an index, `ids` unchanged."""
        return SightingTable(self.t[keep], self.what[keep], self.range[keep], self.bearing[keep], self.ids)

    def counts(self) -> dict[str, int]:
        """How often each id was sighted, ids never sighted left out."""
        n = np.bincount(self.what, minlength=len(self.ids))
        return {name: int(k) for name, k in zip(self.ids, n, strict=True) if k}

    def first(self) -> dict[str, float]:
        """When each id was sighted first [s], ids never sighted left out."""
        what, row = np.unique(self.what, return_index=True)
        return {self.ids[k]: float(t) for k, t in zip(what.tolist(), self.t[row].tolist(), strict=True)}


NOTHING_SEEN = SightingTable(np.zeros(0), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), ())


@dataclass(frozen=True, slots=True)
class LandmarkLog:
    """What one robot drove and saw. robot: `robotK`; odometry: commanded velocities, None when there is no row.

    bearings: sightings that told no range, which is NaN there; filters leave them aside, smoothing takes them.
    dropped: rows left out, by reason; log_hash: SHA-256 of the whole log's content, kept by `share`, so that a part
    of a log is known to be no independent witness beside the whole. cuts: stamps [s], ascending, at which the robot was
    put down elsewhere: nothing it drove leads across one. misread: stamps [s], ascending, of sightings left out as
    misreads, at which its trajectory has a pose all the same. unused: what was recorded beside and no reader took;
    fixes: where it was, as something outside it tells.
    """

    robot: str
    odometry: Odometry | None
    sightings: SightingTable
    dropped: Mapping[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    source: str = ""
    log_hash: str = ""
    bearings: SightingTable = NOTHING_SEEN
    cuts: tuple[float, ...] = ()
    misread: Float[np.ndarray, " m"] = field(default_factory=lambda: np.zeros(0))
    unused: tuple[Unused, ...] = ()
    fixes: Fixes | None = None

    def __post_init__(self) -> None:
        freeze(self, "misread")
        if self.odometry is not None and not len(self.odometry.t):
            object.__setattr__(self, "odometry", None)
        if not self.log_hash:
            tables = (self.sightings, self.bearings) if len(self.bearings) else (self.sightings,)
            object.__setattr__(self, "log_hash", _hash(self.odometry, *tables))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' texts."""
        return tuple(f.text for f in self.findings)

    @property
    def number(self) -> int:
        return int(self.robot.removeprefix("robot"))

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp [s] of all rows; raises DataError when there are none."""
        stamps = [self.sightings.t, self.bearings.t, *(() if self.odometry is None else (self.odometry.t,))]
        ends = [(t[0], t[-1]) for t in stamps if len(t)]
        if not ends:
            raise DataError(f"{self.source}: {self.robot} has neither odometry nor sightings")
        return float(min(a for a, _ in ends)), float(max(b for _, b in ends))

    @property
    def stamps(self) -> Float[np.ndarray, " n"]:
        """When [s] it drove or saw something, misreads too: ascending, each once."""
        driven = () if self.odometry is None else (self.odometry.t,)
        return np.unique(np.concatenate([self.sightings.t, self.bearings.t, self.misread, *driven]))

    def __len__(self) -> int:
        return len(self.sightings) + len(self.bearings) + (0 if self.odometry is None else len(self.odometry.t))

    def events(self, cuts: Sequence[float] = ()) -> Iterator[Event]:
        """All rows as one packet, or as one up to and including each of `cuts` [s], ascending, and one of the rest.

        Packets without a row are left out.
        """
        s, o = self.sightings, self.odometry
        seen = [0, *np.searchsorted(s.t, cuts, side="right").tolist(), len(s)]
        driven = [0] * len(seen) if o is None else [0, *np.searchsorted(o.t, cuts, side="right").tolist(), len(o.t)]
        for (a, b), (c, d) in zip(pairwise(seen), pairwise(driven), strict=True):
            rows = slice(a, b)
            odometry = Odometry(o.t[c:d], o.v[c:d], o.w[c:d]) if o is not None and d > c else None
            if b > a or odometry is not None:
                end = max([*s.t[b - 1 : b], *(() if odometry is None else odometry.t[-1:])])
                record = LandmarkPacket(odometry, s.t[rows], s.what[rows], s.range[rows], s.bearing[rows], s.ids)
                yield Event(float(end), self.robot, record)

    def share(self, fraction: float) -> "LandmarkLog":
        """The first `fraction` of the log's time span; the whole log when it is 1."""
        if not 0.0 < fraction <= 1.0:
            raise DataError(f"{self.robot}: expected a share in (0, 1], found {fraction}")
        if fraction == 1.0 or not len(self):
            return self
        first, last = self.span
        return self.until(first + fraction * (last - first))

    def until(self, t: float) -> "LandmarkLog":
        """The rows stamped `t` [s] or earlier."""
        return self.chosen(lambda stamps: stamps <= t)

    def within(self, begin: float, end: float) -> "LandmarkLog":
        """The rows stamped `begin` [s] or later, before `end` [s]."""
        return self.chosen(lambda stamps: (stamps >= begin) & (stamps < end))

    def stretches(self) -> tuple["LandmarkLog", ...]:
        """The log between its cuts; one without cuts is one stretch."""
        ends = (-np.inf, *self.cuts, np.inf)
        return tuple(replace(self.within(a, b), cuts=()) for a, b in pairwise(ends))

    def chosen(self, at: Callable[[np.ndarray], np.ndarray]) -> "LandmarkLog":
        """The rows at whose stamps `at` is true."""
        o = self.odometry
        if o is not None:
            keep = at(o.t)
            o = Odometry(o.t[keep], o.v[keep], o.w[keep])
        sightings, bearings = self.sightings.select(at(self.sightings.t)), self.bearings.select(at(self.bearings.t))
        fixes = None if self.fixes is None else self.fixes.select(at(self.fixes.t))
        misread = self.misread[at(self.misread)]
        return replace(self, odometry=o, sightings=sightings, bearings=bearings, misread=misread, fixes=fixes)


def _hash(odometry: Odometry | None, *tables: SightingTable) -> str:
    digest = hashlib.sha256()
    if odometry is not None:
        for column in (odometry.t, odometry.v, odometry.w):
            digest.update(np.ascontiguousarray(column).tobytes())
    for table in tables:
        digest.update("\n".join(table.ids).encode())
        for column in (table.t, table.what, table.range, table.bearing):
            digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, slots=True)
class RobotRecording:
    """One robot's rows.

    odometry: (n, 3) t [s], v [m/s], w [rad/s] as commanded; sightings: stamps (m,) [s], barcodes (m,), range and
    bearing (m, 2) [m, rad]; truth: (k, 4) t [s], x, y [m], theta [rad] in the survey's frame.
    """

    number: int
    odometry: Float[np.ndarray, "n 3"]
    stamps: Float[np.ndarray, " m"]
    barcodes: Int[np.ndarray, " m"]
    sightings: Float[np.ndarray, "m 2"]
    truth: Float[np.ndarray, "k 4"]

    def __post_init__(self) -> None:
        freeze(self, "odometry", "stamps", "sightings", "truth")
        freeze(self, "barcodes", dtype=np.int64)


@dataclass(frozen=True, slots=True)
class TeamRecording:
    """barcodes: of every subject, robots first; landmarks: subject -> surveyed (x, y) [m]."""

    barcodes: Mapping[int, int]
    landmarks: Mapping[int, tuple[float, float]]
    robots: tuple[RobotRecording, ...]


FAR = 3600.0  # [s] rows further than this from the rest belong to another recording
FEW = 0.01  # share of far rows that are taken for damaged stamps rather than a second data set


@dataclass(slots=True)
class Mending:
    """Rows dropped, by reason, and findings, collected while one robot's log is read."""

    dropped: dict[str, int] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def find(self, code: str, value: Value = None, action: str = "") -> None:
        self.findings.append(Finding(code, value=value, action=action))

    def drop(self, reason: str, count: int) -> None:
        if count:
            self.dropped[reason] = self.dropped.get(reason, 0) + int(count)


def mended_odometry(table: np.ndarray, label: str, mending: Mending) -> Odometry | None:
    """(n, 3) rows t, v, w made fit: finite, ascending, one row a stamp (the last one said holds); None when empty."""
    table = _finite(table, "odometry", mending)
    table = _ascending(table, label, "odometry", mending)
    if not len(table):
        return None
    last = np.append(np.diff(table[:, 0]) > 0, True)
    mending.drop("odometry: stamp repeated", int((~last).sum()))
    table = table[last]
    return Odometry(*(np.ascontiguousarray(table[:, k]) for k in range(3)))


def mended_sightings(table: np.ndarray, label: str, mending: Mending) -> np.ndarray:
    """(n, 4) rows t, id, range, bearing made fit: finite, positive range, ascending, nothing told twice."""
    table = _finite(table, "sighting", mending)
    positive = table[:, 2] > 0
    mending.drop("sighting: range not positive", int((~positive).sum()))
    table = _ascending(table[positive], label, "sighting", mending)
    if len(table):
        order = np.lexsort((table[:, 3], table[:, 2], table[:, 1], table[:, 0]))
        again = np.zeros(len(table), bool)
        again[order[1:]] = (table[order[1:]] == table[order[:-1]]).all(axis=1)
        mending.drop("sighting: told twice", int(again.sum()))
        table = table[~again]
    return table


def check_one_recording(spans: dict[str, tuple[float, float]], where: object) -> None:
    """Raises ReaderError when the files' time spans (label -> first and last stamp [s]) lie in groups far apart."""
    ordered = sorted(spans.items(), key=lambda item: item[1])
    reach = -np.inf
    for k, (label, (first, last)) in enumerate(ordered):
        if k and first > reach + FAR:
            gap = (first - reach) / 3600.0
            raise ReaderError(
                where, f"expected one data set, found two mixed: {label} starts {gap:.1f} h after the others end"
            )
        reach = max(reach, last)


def _finite(table: np.ndarray, what: str, mending: Mending) -> np.ndarray:
    good = np.isfinite(table).all(axis=1)
    mending.drop(f"{what}: not finite", int((~good).sum()))
    return table if good.all() else table[good]


def _ascending(table: np.ndarray, label: str, what: str, mending: Mending) -> np.ndarray:
    if not len(table):
        return table
    t = table[:, 0]
    expect_seconds(t, label)
    late = int((t < np.maximum.accumulate(t)).sum())
    if late:
        mending.find("stamps-back", {"what": what, "value": late}, "sorted by stamp")
        table = table[np.argsort(t, kind="stable")]
    return _one_recording(table, label, what, mending)


def _one_recording(table: np.ndarray, label: str, what: str, mending: Mending) -> np.ndarray:
    cuts = np.flatnonzero(np.diff(table[:, 0]) > FAR) + 1
    if not len(cuts):
        return table
    parts = np.split(np.arange(len(table)), cuts)
    main = max(parts, key=len)
    others = len(table) - len(main)
    if others > max(3, FEW * len(table)):
        gap = float(np.diff(table[:, 0]).max()) / 3600.0
        raise ReaderError(label, f"expected one data set, found two mixed: stamps {gap:.1f} h apart")
    mending.drop(f"{what}: stamp far from the rest", others)
    return table[main]
