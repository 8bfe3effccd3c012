"""A robot followed in a finished map: searched everywhere, then tracked by particles that share the one map.

The particles are many places it may be in, weighed by its scans until one is left.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.errors import DataError
from ..core.findings import Finding
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track
from ..core.workers import Progress
from ..kernels.laser.refine import systematic
from .beam import Beams, beams
from .config import FILTER_LEAST_BEAMS, Feature, LaserTrackingConfig, weighed
from .laser_map import GridMap, IntensityCalibration, ScanInfos, ScanRecords
from .localise_trust import (
    LEAST_OCCUPANCY,
    TRUST_SCANS,
    Evidence,
    LocalisedScan,
    NearestField,
    TrustConfig,
    evidence,
    nearest_field,
)
from .scan_odometry import ScanInfo, ScanOdometry, blended
from .sweep import swept_by_wheels

LOCALISE_SPACING = 0.2  # [m] between places tried and
LOCALISE_TURN = float(np.radians(5.0))  # [rad] between headings tried, when the start is searched everywhere
PER_BIN = 20  # particles for each bin that is held likely
LOCALISE_BIN = (0.5, float(np.radians(15.0)))  # [m], [rad] sides of such a bin
LOCALISE_BEAMS = 60  # of a scan are asked, spread over it
UPDATE_DISTANCE = 0.25  # [m] moved, or
UPDATE_TURN = 0.25  # [rad] moved before weights change
LOCALISE_NEFF = 10.0  # independent returns in a scan
SEARCH_SIGMA = 0.2  # [m] sd of a return while searching
SEARCH_CAP = 0.25  # [m^2] greatest squared distance a beam is charged while searching
LOCALISE_SIGMA = 0.07  # [m] sd of a return once the place is found
LOCALISE_CAP = 0.06  # [m^2] greatest squared distance a beam is charged once the place is found
LOCALISE_MATCHED = 0.04  # [m^2] squared distance below which a return of the estimate counts as matched
FREE_PASSES = 2  # beams that went through a cell in which the robot may start, at least
FOUND_XY = 0.3  # [m] within which the particles lie once the place is found, and
FOUND_TURN = float(np.radians(8.0))  # [rad]: spread under which the start counts as found
FOUND_SHARE = 0.95  # of the weight at one place, at least
ONE_XY = 1.0  # [m] and
ONE_TURN = float(np.radians(20.0))  # [rad] round the heaviest particle: one place
START_XY = 0.2  # [m] sd of a start that is told, and
START_TURN = float(np.radians(5.0))  # [rad] sd of the particles round a start that is given
LOCALISE_DOUBTS = 8  # updates in a row whose mean share is less: the place found was wrong, the search begins anew


@config
class LocaliseConfig:
    """How a robot is found and followed in a finished map, and when it is believed to be there."""

    most: int = 20_000  # particles while the start is not found, at most
    least: int = 2_000  # and at least
    sd_xy: float = 0.02  # [m] + sd_xy_per_m d: spread of the particles' moves
    sd_xy_per_m: float = 0.08  # and so much more a metre driven
    sd_turn: float = 0.01  # [rad] + sd_turn_per_m d
    sd_turn_per_m: float = 0.02  # [rad] and so much more a metre driven
    trusted: float = 0.6  # share of the returns the map must explain
    trust: TrustConfig = TrustConfig()


@dataclass(slots=True)
class Cloud:
    """poses: (P, 3) in `map`; log_weight: (P,)."""

    poses: Float[np.ndarray, "p 3"]
    log_weight: Float[np.ndarray, " p"]

    def shares(self) -> Float[np.ndarray, " p"]:
        w = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(w / w.sum())

    def middle(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], float]:
        """Mean pose round the heaviest particle, spread there [m, m, rad], and the share of the weight it holds."""
        w = self.shares()
        best = self.poses[int(np.argmax(w))]
        off = self.poses - best
        off[:, 2] = se2.wrap_angle(off[:, 2])
        close = (np.hypot(off[:, 0], off[:, 1]) < ONE_XY) & (np.abs(off[:, 2]) < ONE_TURN)
        share = float(w[close].sum())
        v = w[close] / share
        mean = v @ off[close]
        spread = np.sqrt(v @ (off[close] - mean) ** 2)
        pose = best + mean
        pose[2] = se2.wrap_angle(pose[2])
        return pose, spread, share

    def covariance(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """Of all particles about `pose`, over x, y, theta."""
        off = self.poses - pose
        off[:, 2] = se2.wrap_angle(off[:, 2])
        return np.asarray((off * self.shares()[:, None]).T @ off)


class PlaceFilter:
    """The particles; every method changes them."""

    def __init__(
        self,
        walls: NearestField,
        grid: GridMap,
        alpha: float,
        how: LocaliseConfig,
        particles: int,
        rng: np.random.Generator,
    ) -> None:
        self.walls, self.grid, self.alpha, self.how, self.particles, self.rng = walls, grid, alpha, how, particles, rng
        self.cloud = Cloud(np.zeros((1, 3)), np.zeros(1))
        self.found = False

    def begin(self, start: Float[np.ndarray, "3"] | None, points: Float[np.ndarray, "n 3"]) -> None:
        """Particles round a given start, or wherever the first scan may have been taken."""
        how = self.how
        self.found = start is not None
        if start is not None:
            spread = np.array([START_XY, START_XY, START_TURN])
            poses = start + spread * self.rng.standard_normal((max(how.least, self.particles), 3))
            self.cloud = Cloud(poses, np.zeros(len(poses)))
            self.weigh(points)
            return
        places = _spaced(self.grid.free_cells(FREE_PASSES), LOCALISE_SPACING)
        headings = np.arange(-np.pi, np.pi, LOCALISE_TURN)
        best: list[np.ndarray] = []
        scores: list[np.ndarray] = []
        for part in np.array_split(places, max(1, len(places) // 2000)):
            poses = np.column_stack([np.repeat(part, len(headings), axis=0), np.tile(headings, len(part))])
            mean, _ = self.walls.score(poses, points, alpha=self.alpha, cap=SEARCH_CAP)
            best.append(poses)
            scores.append(self._gain(mean))
        log_weight = np.concatenate(scores)
        cloud = Cloud(np.concatenate(best), log_weight)
        self._draw(cloud, how.most)

    def move(self, u: Float[np.ndarray, "3"]) -> None:
        how, P = self.how, len(self.cloud.poses)
        d = float(np.hypot(u[0], u[1]))
        xy, turn = how.sd_xy + how.sd_xy_per_m * d, how.sd_turn + how.sd_turn_per_m * d
        self.cloud.poses = se2.compose(self.cloud.poses, u + self.rng.standard_normal((P, 3)) * [xy, xy, turn])

    def weigh(self, points: Float[np.ndarray, "n 3"]) -> None:
        """Weights take the scan in; says whether the hypotheses have become one."""
        cap = LOCALISE_CAP if self.found else SEARCH_CAP
        mean, _ = self.walls.score(self.cloud.poses, points, alpha=self.alpha, cap=cap)
        self.cloud.log_weight = self.cloud.log_weight + self._gain(mean)
        if not self.found:
            _, spread, share = self.cloud.middle()
            narrow = max(spread[0], spread[1]) < FOUND_XY and spread[2] < FOUND_TURN
            self.found = narrow and share > FOUND_SHARE

    def posterior(self, b: Beams) -> tuple[Float[np.ndarray, "3"], int, float, bool]:
        """The estimate, its matched returns, the effective number before drawing anew, and whether that was done."""
        pose, _, _ = self.cloud.middle()
        every = np.column_stack([b.s, b.q])
        _, matched = self.walls.score(pose[None], every, alpha=self.alpha, cap=1.0, matched_under=LOCALISE_MATCHED)
        w = self.cloud.shares()
        n_eff = float(1.0 / (w @ w))
        wanted = max(self.particles, 50) if self.found else self._wanted(w)
        again = n_eff < 0.5 * len(w) or len(w) > 2 * wanted
        if again:
            self._draw(self.cloud, wanted)
        return pose, int(matched[0]), n_eff, again

    def _gain(self, mean: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        sigma = LOCALISE_SIGMA if self.found else SEARCH_SIGMA
        return np.asarray(-LOCALISE_NEFF / (2 * sigma**2) * mean)

    def _wanted(self, w: Float[np.ndarray, " p"]) -> int:
        """As many particles as the places that are still likely ask for."""
        likely = self.cloud.poses[w > 1e-3 / len(w)]
        size, turn = LOCALISE_BIN
        bins = len(np.unique(np.floor(likely / [size, size, turn]).astype(np.int64), axis=0))
        return int(np.clip(PER_BIN * bins, self.how.least, self.how.most))

    def _draw(self, cloud: Cloud, count: int) -> None:
        """`count` particles drawn from `cloud` by weight, evenly."""
        w = cloud.shares()
        if count == len(w):
            poses = cloud.poses[systematic(w, float(self.rng.random()))]
        else:
            at = (np.arange(count) + self.rng.random()) / count
            poses = cloud.poses[np.minimum(np.searchsorted(np.cumsum(w), at), len(w) - 1)]
        self.cloud = Cloud(poses.copy(), np.zeros(len(poses)))


def _spaced(places: Float[np.ndarray, "n 2"], spacing: float) -> Float[np.ndarray, "m 2"]:
    """One of the places for every square of side `spacing`."""
    _, first = np.unique(np.floor(places / spacing).astype(np.int64), axis=0, return_index=True)
    return places[np.sort(first)]


@dataclass(frozen=True, slots=True)
class Localisation:
    """One log tracked in a finished map.

    track: poses in `map` at every odometry and every scan stamp (before the start was found: carried back by
    odometry); scans: as for mapping, innovation against odometry. start: "given" or "global"; found_t: stamp [s] at
    which the hypotheses had become one, None where they never did (a given start: the first stamp); found_scans:
    scans used until then; matched: share of the returns after that which the map explains; evidence: what speaks for
    the place found, None where none was; doubt: why the answer is not to be trusted, empty where it is; feature: the
    one really used.
    """

    robot: str
    source: str
    track: Track
    scans: ScanRecords
    start: str
    found_t: float | None
    found_scans: int | None
    matched: float
    evidence: Evidence | None
    doubt: str
    feature: str
    particles: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' texts."""
        return tuple(f.text for f in self.findings)

    @property
    def trusted(self) -> bool:
        """Whether everything known speaks for the answer."""
        return not self.doubt


class MapFollower:
    """A robot followed scan by scan in a finished map. `push` changes it.

    odometry: poses (m, 3) that drift, one a scan; infos: a record a scan; at: the rows that were placed in the map,
    corrected: their poses there; found_row: the row at which the hypotheses had become one, None before; restarts: how
    often the place found turned out wrong and the search began anew; searched: [s] spent until it was found; seen: the
    last scans placed since it was found.
    """

    def __init__(
        self,
        grid: GridMap,
        light: Feature,
        cfg: LaserTrackingConfig,
        start: Float[np.ndarray, "3"] | None,
        rng: np.random.Generator,
        how: LocaliseConfig | None = None,
    ) -> None:
        """start: the robot's pose at the first scan, or None to search everywhere. Raises DataError where the map has
        no free place or no walls.
        """
        self.how, self.light, self.start, self.grid = how or LocaliseConfig(), light, start, grid
        self.cfg = weighed(cfg, light)
        try:
            self.walls = nearest_field(grid, LEAST_OCCUPANCY)
        except ValueError as error:
            raise DataError(str(error)) from None
        if start is None and not len(grid.free_cells(FREE_PASSES)):
            raise DataError("the map has no free place a robot could be in")
        alpha = self.cfg.cells.alpha if light.name != "none" else 0.0
        self.particles = PlaceFilter(self.walls, grid, alpha, self.how, self.cfg.particles, rng)
        self.odometry = ScanOdometry(self.cfg.front_end, feature=light.name)
        self.infos = ScanInfos()
        self.at: list[int] = []
        self.corrected: list[np.ndarray] = []
        self.found_row: int | None = None
        self.restarts, self.searched = 0, 0.0
        self.seen: deque[LocalisedScan] = deque(maxlen=TRUST_SCANS)
        self._explained: list[float] = []  # share of the returns, since the place was found
        self._matches = self._returns = 0  # since then

    @property
    def pose(self) -> Float[np.ndarray, "3"]:
        """Where the robot most likely was at the latest scan; before the first that was placed, its odometry."""
        if not self.at:
            return np.asarray(self.odometry.pose)
        return np.asarray(se2.compose(self.corrected[-1], self._moved()))

    @property
    def covariance(self) -> Float[np.ndarray, "3 3"]:
        """Of `pose`, over x, y, theta in the map, all hypotheses taken; infinite before the first scan was placed."""
        return self.particles.cloud.covariance(self.corrected[-1]) if self.at else np.full((3, 3), np.inf)

    def _moved(self) -> Float[np.ndarray, "3"]:
        """By odometry, since the last scan that was placed."""
        return np.asarray(se2.between(self.odometry.poses[self.at[-1]], self.odometry.poses[-1]))

    def push(self, scan: Scan) -> ScanInfo:
        """What a scan did to the estimate."""
        b = beams(scan, self.light.name, self.light.calibration, self.cfg.beam)
        info = self.odometry.advance(scan, b)
        points = _some(b, LOCALISE_BEAMS)
        motion = self._moved() if self.at else np.zeros(3)
        far = np.hypot(motion[0], motion[1]) >= UPDATE_DISTANCE or abs(motion[2]) >= UPDATE_TURN
        if len(points) < FILTER_LEAST_BEAMS or (self.at and not far):
            told = ScanInfo(info.innovation, info.beams, 0, "skipped" if len(points) else "empty")
        else:
            told = self._placed(scan, b, info, motion, points)
        self.infos.append(told)
        return told

    def _placed(
        self, scan: Scan, b: Beams, info: ScanInfo, motion: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]
    ) -> ScanInfo:
        clock, row = perf_counter(), len(self.infos)
        if self.at:
            self.particles.move(motion)
            self.particles.weigh(points)
            last = self._explained[-LOCALISE_DOUBTS:]
            if self.start is None and len(last) == LOCALISE_DOUBTS and np.mean(last) < self.how.trusted:
                self.particles.begin(None, points)
                self.found_row, self._explained = None, []
                self._matches = self._returns = 0
                self.seen.clear()
                self.restarts += 1
        else:
            self.particles.begin(self.start, points)
        pose, matches, n_eff, resampled = self.particles.posterior(b)
        if self.particles.found:
            self._explained.append(matches / max(1, len(b.q)))
        if self.found_row is None:
            self.searched += perf_counter() - clock
            self.found_row = row if self.particles.found else None
        if self.found_row is not None:
            self._matches, self._returns = self._matches + matches, self._returns + info.beams
            self.seen.append(LocalisedScan(pose, b, np.array(scan.T_robot_sensor[:2])))
        self.at.append(row)
        self.corrected.append(pose)
        return ScanInfo(info.innovation, info.beams, matches, "matched", n_eff, resampled)

    def evidence(self, before: Sequence[LocalisedScan] = ()) -> Evidence | None:
        """What speaks for the place found, of the last scans there and those `before`; None where none is found."""
        if self.found_row is None:
            return None
        seen, lit = [*before, *self.seen], self.light.name != "none"
        searched = self.start is None
        return evidence(seen, self.grid, self.walls, light=lit, searched=searched, cfg=self.how.trust)

    @property
    def matched(self) -> float:
        """The share of the returns since the place was found that the map explains."""
        return self._matches / max(1, self._returns)

    def doubt(self, support: Evidence | None) -> str:
        """Why the place with this evidence is not to be trusted, empty where it is."""
        if support is None:
            return "the start was not found"
        few = f"the map explains {100 * self.matched:.0f} % of the returns"
        return support.doubt or ("" if self.matched >= self.how.trusted else few)


def localise(
    log: LaserLog,
    grid: GridMap,
    calibration: IntensityCalibration | None,
    feature: str,
    cfg: LaserTrackingConfig,
    start: Float[np.ndarray, "3"] | None,
    rng: np.random.Generator,
    on_progress: Progress,
    how: LocaliseConfig | None = None,
) -> Localisation:
    """Where the robot of `log` was in `grid`; `start`: its pose at the first scan, or None to search everywhere.

    The log's returns are made comparable with the map's by the map's own calibration; a log without intensity, or a
    map without, is followed by geometry alone. Raises DataError where the map has no free place or no walls.
    """
    began = perf_counter()
    log = swept_by_wheels(log, cfg.beam, cfg.front_end)
    findings = list(log.findings)
    if feature != "none" and (not log.has_intensity or calibration is None):
        feature = "none"
        findings.append(Finding("light-unused", log.robot, value="the log or the map has none"))
    try:
        follower = MapFollower(grid, Feature(feature, calibration), cfg, start, rng, how)
        for row, scan in enumerate(log.scans):
            follower.push(scan)
            on_progress("scans", row + 1, len(log.scans))
    except DataError as error:
        raise DataError(f"{log.source}: {error}") from None
    at, corrected, found = follower.at, follower.corrected, follower.found_row
    if not at:
        raise DataError(f"{log.source}: no scan with enough returns to be placed in the map")
    since = found or 0
    first = at.index(since) if since in at else 0
    poses = blended(follower.odometry.poses.array, np.array(at[first:]), np.array(corrected[first:]))
    scans = follower.infos.records(log.scan_t, tuple(scan.host for scan in log.scans), poses)
    if found is None:
        findings.append(Finding("start-unfound", log.robot))
    if follower.restarts:
        findings.append(Finding("start-given-up", log.robot, value=follower.restarts))
    on_progress("other places", 0, 1)
    support = follower.evidence(_spread_before(log, follower) if found is not None else ())
    on_progress("other places", 1, 1)
    total = perf_counter() - began
    return Localisation(
        log.robot,
        log.source,
        _filled(log, poses),
        scans,
        "global" if start is None else "given",
        None if found is None else float(log.scan_t[found]),
        None if found is None else found + 1,
        follower.matched,
        support,
        follower.doubt(support),
        feature,
        follower.cfg.particles,
        dict(log.dropped),
        tuple(findings),
        {"localise": total, "global_start": follower.searched, "ms_per_scan": 1e3 * total / len(log.scans)},
    )


def _spread_before(log: LaserLog, follower: MapFollower) -> list[LocalisedScan]:
    """As many scans as the follower kept, at most, spread over those since the place was found that it did not keep."""
    light, since = follower.light, follower.found_row or 0
    rows = [(row, pose) for row, pose in zip(follower.at, follower.corrected, strict=True) if row >= since]
    before = rows[: -len(follower.seen)]
    out = []
    for row, pose in before[:: max(1, -(-len(before) // TRUST_SCANS))]:
        b = beams(log.scans[row], light.name, light.calibration, follower.cfg.beam)
        out.append(LocalisedScan(pose, b, np.array(log.scans[row].T_robot_sensor[:2])))
    return out


def _some(b: Beams, count: int) -> Float[np.ndarray, "n 3"]:
    """About `count` of the returns, spread evenly over the scan, as x, y, q."""
    points = np.column_stack([b.s, b.q])
    return points[np.linspace(0, len(points) - 1, count).astype(int)] if len(points) > count else points


def _filled(log: LaserLog, poses: Float[np.ndarray, "m 3"]) -> Track:
    """Poses in `map` at every odometry and scan stamp, from those at the scans."""
    rows = log.odometry
    if rows is None or log.scans[0].odometry is None:
        last = np.append(np.diff(log.scan_t) > 0, True)
        return Track(log.scan_t[last], poses[last])
    between = ~np.isin(rows.t, log.scan_t)
    t = np.concatenate([rows.t[between], log.scan_t])
    order = np.argsort(t, kind="stable")
    odometry = np.concatenate([rows.pose[between], [scan.odometry for scan in log.scans]])[order]
    filled = blended(odometry, np.flatnonzero(order >= int(between.sum())), poses)
    t = t[order]
    last = np.append(np.diff(t) > 0, True)
    return Track(t[last], filled[last])
