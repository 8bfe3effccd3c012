"""Sightings that what the same robot saw moments before and after contradicts: wrong labels, ranges wrong by metres.

Over a few seconds wheels tell well where a robot went. So sightings of one name, carried into one frame by the wheels,
lie together where the name stands, and wrong ones lie alone: no map and no filter is needed to tell them apart.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.config import config
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry
from .config import EkfSlamConfig
from .ekf_slam import is_landmark


@config
class SiftConfig:
    """What nearby sightings may differ by, and from how many wrong ones on a log is sifted."""

    window: float = 4.0  # [s] either way, in which sightings of one name are compared
    turned: float = 1.2  # [rad] commanded between two sightings, from which they are not compared
    floor: float = 0.15  # [m] by which places may differ,
    share: float = 0.08  # and as a share of the distance,
    turn_error: float = 0.25  # of the angle commanded in between, times the distance,
    drift: float = 0.12  # of the distance commanded in between,
    moving: float = 0.35  # [m/s] and for another robot, which drives
    least: int = 3  # others in the window, from which a sighting is judged
    support: float = 0.5  # share of them that must agree with it
    enough: int = 2  # that must agree, in a log that is sifted
    blind_window: float = 0.8  # [s] in place of window where no wheels say how the robot went,
    blind_turn: float = 0.5  # [rad/s] and how fast it may have turned there,
    blind_enough: int = 1  # and that must agree there
    turn_scales: tuple[float, ...] = (0.65, 1.3, 1.6)  # of the expected one, one of which wheels may have instead
    few: int = 6  # sightings in a row left of a landmark, below which it may be another one that was misread
    dirty: float = 0.08  # share of the sightings judged that are contradicted, from which the log is sifted,
    gross: float = 2.5  # or contradicted by so many times the limits, as wrong labels are and noise is not,
    dirty_gross: float = 0.005  # and that share,
    blind_dirty: float = 0.0008  # or that one without wheels, where hardly a sighting can be contradicted


@dataclass(frozen=True, slots=True)
class Witnesses:
    """For each of n sightings, how many others there are to compare it with, and how many of them agree."""

    of: Int[np.ndarray, " n"]
    agree: Int[np.ndarray, " n"]
    blind: bool = False  # without wheels

    def contradicted(self, cfg: SiftConfig) -> Bool[np.ndarray, " n"]:
        """Those that enough others could have borne out, and did not."""
        return np.asarray((self.of >= cfg.least) & (self.agree < cfg.support * self.of))

    def borne_out(self, cfg: SiftConfig) -> Bool[np.ndarray, " n"]:
        """Those that enough others bear out, and no majority contradicts."""
        enough = cfg.blind_enough if self.blind else cfg.enough
        return np.asarray((self.agree >= enough) & ~self.contradicted(cfg))

    def contradicted_share(self, cfg: SiftConfig) -> float:
        """Of those judged, the share that is contradicted."""
        return float(self.contradicted(cfg).sum() / max(int((self.of >= cfg.least).sum()), 1))


def sifted(log: LandmarkLog, ekf: EkfSlamConfig, cfg: SiftConfig | None = None) -> LandmarkLog:
    """The log without the sightings that its others contradict, where those are many; they are counted and told.

    A log with few of them comes back as it is. In one with many, a sighting that hardly another bears out goes too:
    wrong labels scatter over all names, and most have nothing near that could contradict them. So do few in a row of a
    name mostly contradicted that lie where another, or a robot, was seen: misreadings of one that was looked at for
    long bear each other out. Where wheels of another turn scale are contradicted less, theirs is taken.
    """
    cfg = cfg or SiftConfig()
    if not len(log.sightings):
        return log
    if _clean(log, ekf, cfg):
        return log
    support = witnesses(log.sightings, log.odometry, ekf, cfg)
    scales = () if log.odometry is None else cfg.turn_scales
    for turning in (replace(ekf, turn_scale=scale * ekf.turn_scale) for scale in scales):
        other = witnesses(log.sightings, log.odometry, turning, cfg)
        if other.contradicted(cfg).sum() < support.contradicted(cfg).sum():
            support, ekf = other, turning
    if _clean(log, ekf, cfg):
        return log
    keep = support.borne_out(cfg)
    keep &= ~_misread(log.sightings, keep, log.odometry, ekf, cfg)
    gone = int((~keep).sum())
    found = Finding("sightings-sifted", log.robot, value={"value": gone, "all": len(keep)}, action="left out")
    return replace(
        log,
        sightings=log.sightings.select(keep),
        dropped={**log.dropped, "sighting: contradicted": gone},
        findings=(*log.findings, found),
    )


def _clean(log: LandmarkLog, ekf: EkfSlamConfig, cfg: SiftConfig) -> bool:
    """Whether so few sightings are contradicted that a filter's gates are enough; few grossly, as wrong labels are."""
    wide = replace(
        cfg, **{name: cfg.gross * getattr(cfg, name) for name in ("floor", "share", "turn_error", "drift", "moving")}
    )
    most = cfg.blind_dirty if log.odometry is None else cfg.dirty_gross
    return (
        witnesses(log.sightings, log.odometry, ekf, cfg).contradicted_share(cfg) <= cfg.dirty
        and witnesses(log.sightings, log.odometry, ekf, wide).contradicted_share(cfg) <= most
    )


def witnesses(seen: SightingTable, wheels: Odometry | None, ekf: EkfSlamConfig, cfg: SiftConfig) -> Witnesses:
    """Which sightings bear each other out along the path that `wheels` tell, or in moments where there are none."""
    driven = _Driven.of(seen, wheels, ekf, cfg)
    of, agree = np.zeros(len(seen), np.int64), np.zeros(len(seen), np.int64)
    for k, name in enumerate(seen.ids):
        rows = np.flatnonzero(seen.what == k)
        moving = 0.0 if is_landmark(name) else cfg.moving
        for apart in range(1, len(rows)):
            a, b = rows[:-apart], rows[apart:]
            if (seen.t[b] - seen.t[a]).min() > driven.window:
                break
            compared, fits = driven.compared(a, b, moving, cfg)
            for end in (a, b):
                np.add.at(of, end[compared], 1)
                np.add.at(agree, end[compared & fits], 1)
    return Witnesses(of, agree, wheels is None)


def _misread(
    seen: SightingTable, keep: Bool[np.ndarray, " n"], wheels: Odometry | None, ekf: EkfSlamConfig, cfg: SiftConfig
) -> Bool[np.ndarray, " n"]:
    """Of names that lose most, the kept sightings that are few in a row and mostly lie where another was seen."""
    driven = _Driven.of(seen, wheels, ekf, cfg)
    n, kept = (np.bincount(seen.what[rows], minlength=len(seen.ids)) for rows in (np.ones(len(keep), bool), keep))
    stands = np.array([is_landmark(name) for name in seen.ids])
    out = np.zeros(len(seen), bool)
    for k in np.flatnonzero(stands & (kept > 0) & (2 * kept < n)).tolist():
        mine = np.flatnonzero(keep & (seen.what == k))
        others = np.flatnonzero(keep & (seen.what != k))
        for row in np.split(mine, np.flatnonzero(np.diff(seen.t[mine]) > driven.window) + 1):
            if len(row) >= cfg.few:
                continue
            a, b = np.repeat(row, len(others)), np.tile(others, len(row))
            moving = np.where(stands[seen.what[b]], 0.0, cfg.moving)
            compared, fits = driven.compared(a, b, moving, cfg)
            elsewhere = np.bincount(a[compared & fits], minlength=len(seen))[row] >= cfg.enough
            out[row] = 2 * elsewhere.sum() > len(row)
    return out


@dataclass(frozen=True, slots=True)
class _Driven:
    """Sightings carried into one frame by the wheels: place [m]; distance [m] and angle [rad] driven until then.

    window: [s] in which they are compared; turning, going: [rad/s] and [m/s] at which the robot may have moved besides.
    """

    t: Float[np.ndarray, " n"]
    range: Float[np.ndarray, " n"]
    place: Float[np.ndarray, "n 2"]
    way: Float[np.ndarray, " n"]
    angle: Float[np.ndarray, " n"]
    window: float
    turning: float = 0.0
    going: float = 0.0

    @classmethod
    def of(cls, seen: SightingTable, wheels: Odometry | None, ekf: EkfSlamConfig, cfg: SiftConfig) -> "_Driven":
        if wheels is None:
            still = np.zeros(len(seen))
            ahead = seen.range[:, None] * np.stack([np.cos(seen.bearing), np.sin(seen.bearing)], axis=-1)
            return cls(seen.t, seen.range, ahead, still, still, cfg.blind_window, cfg.blind_turn, cfg.moving)
        pose, way, angle = _driven(seen.t, wheels, ekf)
        bearing = pose[:, 2] + seen.bearing
        place = pose[:, :2] + seen.range[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        return cls(seen.t, seen.range, place, way, angle, cfg.window)

    def compared(
        self,
        a: Int[np.ndarray, " p"],
        b: Int[np.ndarray, " p"],
        moving: float | Float[np.ndarray, " p"],
        cfg: SiftConfig,
    ) -> tuple[Bool[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
        """Which pairs of rows are near enough in time to be compared, and which of all lie at one place."""
        dt, angle = np.abs(self.t[b] - self.t[a]), np.abs(self.angle[b] - self.angle[a])
        r = np.minimum(self.range[a], self.range[b])
        most = cfg.floor + (cfg.share + cfg.turn_error * angle) * r
        most += cfg.drift * np.abs(self.way[b] - self.way[a]) + (moving + self.going + self.turning * r) * dt
        fits = np.hypot(*(self.place[a] - self.place[b]).T) <= most
        return (dt <= self.window) & (angle <= cfg.turned), fits


def _driven(
    t: Float[np.ndarray, " n"], wheels: Odometry, ekf: EkfSlamConfig
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Poses at `t` as commands with the expected calibration say; distance [m] and angle [rad] driven until then."""
    dt = np.append(np.minimum(np.diff(wheels.t), ekf.hold), 0.0)
    angle, way = ekf.turn_scale * wheels.w * dt, ekf.speed_scale * wheels.v * dt
    heading = np.cumsum(angle) - 0.5 * angle
    steps = [way * np.cos(heading), way * np.sin(heading), angle, np.abs(way), np.abs(angle)]
    then = wheels.t + ekf.lag
    path = np.stack([np.interp(t, then, np.append(0.0, np.cumsum(s)[:-1])) for s in steps], axis=-1)
    return np.column_stack([path[:, :2], path[:, 2]]), path[:, 3], path[:, 4]
