"""One robot's laser log after reading, whatever the format was: scans, odometry poses, what was mended and why."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from .findings import Finding, Unused
from .fixes import Fixes
from .records import Event, OdometryPoses, Scan, Track, freeze

LEAST_RETURNS = 10  # of a scan; nobody matches one that has fewer


class ScanDigest:
    """A digest of stamps and ranges of scans as they come. `add` changes it; told: of those so far."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()

    def add(self, t: float, scan: Scan) -> None:
        self._sha.update(np.float64(t).tobytes())
        self._sha.update(np.ascontiguousarray(np.where(scan.hit, scan.ranges, 0.0), dtype=float).tobytes())

    @property
    def hexdigest(self) -> str:
        return self._sha.hexdigest()


@dataclass(frozen=True, slots=True)
class LaserLog:
    """Scans and odometry of one robot, both in time order.

    scan_t: (m,) [s], ascending, one for each of `scans` (equal stamps only where the sensors differ).
    odometry: `T_odom_robot` along time in frame `odom`, stamps strictly ascending (of several rows of one stamp the
    last in the file), None when there is no row. `odometry_from` says what it was made of: "poses", "tf", "ticks" or
    "none". Every scan of a log with odometry carries its own `Scan.odometry`; those need not be repeated in `odometry`.
    Either all scans have intensities or none: a constant intensity tells nothing, so the reader leaves it out and
    says so in `findings`. unused: what was recorded beside and no reader took; fixes:
    where the robot was, as something outside it tells.
    sweep: [s] from the first beam of a scan to its last as the scanner's driver states it, 0 where it does not;
    negative where it is known that beams are given in reverse.
    told_hash: `scan_hash` of all scans where some are here without their ranges, else empty.
    """

    robot: str
    source: str
    scan_t: Float[np.ndarray, " m"]
    scans: tuple[Scan, ...]
    odometry: Track | None
    odometry_from: str = "poses"
    dropped: dict[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    log_hash: str = ""
    told_hash: str = ""
    sweep: float = 0.0
    unused: tuple[Unused, ...] = ()
    fixes: Fixes | None = None

    def __post_init__(self) -> None:
        freeze(self, "scan_t")
        if self.odometry is not None and not len(self.odometry.t):
            object.__setattr__(self, "odometry", None)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' texts."""
        return tuple(f.text for f in self.findings)

    @property
    def has_intensity(self) -> bool:
        return bool(self.scans) and self.scans[0].intensities is not None

    def scan_hash(self, first: int | None = None) -> str:
        """A digest of the stamps and ranges of the first scans (all): equal for logs that hold the same scans."""
        if self.told_hash and (first is None or first == len(self.scans)):
            return self.told_hash
        digest = ScanDigest()
        for t, scan in zip(self.scan_t[:first].tolist(), self.scans[:first], strict=True):
            digest.add(t, scan)
        return digest.hexdigest

    def stamps(self) -> Float[np.ndarray, " n"]:
        """Every odometry and every scan stamp once, ascending: where a trajectory has to give a pose."""
        rows = np.zeros(0) if self.odometry is None else self.odometry.t
        return np.unique(np.concatenate([rows, self.scan_t]))

    def events(self) -> Iterator[Event]:
        """`OdometryPoses` packets and `Scan`s in time order; the odometry of a scan's stamp comes before the scan."""
        rows = self.odometry
        at = 0
        for t, scan in zip(self.scan_t.tolist(), self.scans, strict=True):
            if rows is not None:
                end = int(np.searchsorted(rows.t, t, side="right"))
                if end > at:
                    yield self._packet(rows, at, end)
                    at = end
            yield Event(t, self.robot, scan)
        if rows is not None and at < len(rows.t):
            yield self._packet(rows, at, len(rows.t))

    def cut(self, t: float, robot: str) -> tuple["LaserLog", "LaserLog"]:
        """What was recorded before `t` [s], and what from then on: the log of `robot`.

        What was left out in reading and what nobody used is told of the first. A side without odometry rows of its own
        has those that its scans hold.
        """
        at = int(np.searchsorted(self.scan_t, t))

        def side(scans: slice, first: float, last: float) -> LaserLog:
            rows, fixes = self.odometry, self.fixes
            if rows is not None:
                keep = (rows.t >= first) & (rows.t <= last)
                own = Track(rows.t[keep], rows.pose[keep], None, rows.frame)
                rows = own if keep.any() else self._of_scans(scans, rows.frame)
            return replace(
                self,
                scan_t=self.scan_t[scans],
                scans=self.scans[scans],
                odometry=rows,
                fixes=None if fixes is None else fixes.within(first, last),
                told_hash="",
            )

        before, after = side(slice(None, at), -np.inf, np.nextafter(t, -np.inf)), side(slice(at, None), t, np.inf)
        return before, replace(after, robot=robot, dropped={}, unused=())

    def _of_scans(self, scans: slice, frame: str) -> Track | None:
        """The odometry that scans hold, of equal stamps the last; None where they hold none."""
        t, of = self.scan_t[scans], self.scans[scans]
        if not of or of[0].odometry is None:
            return None
        last = np.append(np.diff(t) > 0, True)
        return Track(t[last], np.array([scan.odometry for scan in of], dtype=float)[last], None, frame)

    def _packet(self, rows: Track, start: int, end: int) -> Event:
        return Event(float(rows.t[end - 1]), self.robot, OdometryPoses(rows.t[start:end], rows.pose[start:end]))
