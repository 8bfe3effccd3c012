"""What may be wrong with stamped rows and is mended: counted, reported, never silent."""

from dataclasses import dataclass, field

import numpy as np

from ..core.errors import ReaderError
from ..core.records import Odometry

FAR = 3600.0  # [s] rows further than this from the rest belong to another recording
FEW = 0.01  # share of far rows that are taken for damaged stamps rather than a second data set


@dataclass(slots=True)
class Mending:
    """Rows dropped, by reason, and sentences for the user, collected while one robot's log is read."""

    dropped: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def drop(self, reason: str, count: int) -> None:
        if count:
            self.dropped[reason] = self.dropped.get(reason, 0) + int(count)


def odometry(table: np.ndarray, label: str, mending: Mending) -> Odometry | None:
    """(n, 3) rows t, v, w made fit: finite, ascending, one row a stamp (the last one said holds); None when empty."""
    table = _finite(table, "odometry", mending)
    table = _ascending(table, label, "odometry", mending)
    if not len(table):
        return None
    last = np.append(np.diff(table[:, 0]) > 0, True)
    mending.drop("odometry: stamp repeated", int((~last).sum()))
    table = table[last]
    return Odometry(*(np.ascontiguousarray(table[:, k]) for k in range(3)))


def sightings(table: np.ndarray, label: str, mending: Mending) -> np.ndarray:
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
    late = int((t < np.maximum.accumulate(t)).sum())
    if late:
        mending.warnings.append(f"{late} {what} rows were not in order of time: sorted")
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
