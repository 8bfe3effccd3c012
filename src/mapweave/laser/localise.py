"""A robot followed in a finished map: searched everywhere, then tracked by particles that share the one map."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import DataError
from ..core.findings import Finding
from ..core.laser_log import LaserLog
from ..core.records import Track
from ..core.rows import RowBuffer
from ..core.workers import Progress
from .beam import Beams, beams
from .config import Feature, LaserTrackingConfig, weighed
from .laser_map import GridMap, IntensityCalibration, ScanInfos, ScanRecords
from .likelihood_field import nearest_field
from .localise_filter import LOCALISE_BEAMS, LOCALISE_DOUBTS, UPDATE_DISTANCE, UPDATE_TURN, LocaliseConfig, PlaceFilter
from .localise_trust import LEAST_OCCUPANCY, TRUST_SCANS, Evidence, LocalisedScan, evidence
from .scan_odometry import ScanInfo, ScanOdometry, blended


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
    how = how or LocaliseConfig()
    began = perf_counter()
    findings = list(log.findings)
    if feature != "none" and (not log.has_intensity or calibration is None):
        feature = "none"
        findings.append(Finding("light-unused", log.robot, value="the log or the map has none"))
    cfg = weighed(cfg, Feature(feature, calibration))
    try:
        walls = nearest_field(grid, LEAST_OCCUPANCY)
    except ValueError as error:
        raise DataError(f"{log.source}: {error}") from None
    alpha = cfg.cells.alpha if feature != "none" else 0.0
    particles = PlaceFilter(walls, grid, alpha, how, cfg.particles, rng)
    way = _follow(log, particles, cfg, how, (feature, calibration), start, on_progress)
    if not way.at:
        raise DataError(f"{log.source}: no scan with enough returns to be placed in the map")
    since = way.converged_row or 0
    first = way.at.index(since) if since in way.at else 0
    poses = blended(way.carried.array, np.array(way.at[first:]), np.array(way.corrected[first:]))
    scans = way.infos.records(log.scan_t, tuple(scan.host for scan in log.scans), poses)
    counted = (np.array(scans.decision) == "matched") & (np.arange(len(scans)) >= since)
    matched = int(scans.matches[counted].sum()) / max(1, int(scans.beams[counted].sum()))
    if way.converged_row is None:
        findings.append(Finding("start-unfound", log.robot))
    if way.restarts:
        findings.append(Finding("start-given-up", log.robot, value=way.restarts))
    support, doubt = None, "the start was not found"
    if way.converged_row is not None:
        on_progress("other places", 0, 1)
        rows = [(row, pose) for row, pose in zip(way.at, way.corrected, strict=True) if row >= way.converged_row]
        seen = [
            LocalisedScan(
                pose, beams(log.scans[row], feature, calibration, cfg.beam), np.array(log.scans[row].T_robot_sensor[:2])
            )
            for row, pose in _kept(rows, TRUST_SCANS)
        ]
        support = evidence(seen, grid, walls, light=feature != "none", searched=start is None, cfg=how.trust)
        few = f"the map explains {100 * matched:.0f} % of the returns"
        doubt = support.doubt or ("" if matched >= how.trusted else few)
        on_progress("other places", 1, 1)
    total = perf_counter() - began
    return Localisation(
        log.robot,
        log.source,
        _filled(log, poses),
        scans,
        "global" if start is None else "given",
        None if way.converged_row is None else float(log.scan_t[way.converged_row]),
        None if way.converged_row is None else way.converged_row + 1,
        float(matched),
        support,
        doubt,
        feature,
        cfg.particles,
        dict(log.dropped),
        tuple(findings),
        {"localise": total, "global_start": way.searched, "ms_per_scan": 1e3 * total / len(log.scans)},
    )


@dataclass(slots=True)
class _Way:
    """What following the log gave: poses carried to every scan, corrected ones at the rows `at`, a record a scan.

    converged_row: the row at which the hypotheses had become one; searched: seconds spent until then; restarts: how
    often the place found turned out wrong and the search began anew.
    """

    carried: RowBuffer
    infos: ScanInfos = field(default_factory=ScanInfos)
    at: list[int] = field(default_factory=list)
    corrected: list[np.ndarray] = field(default_factory=list)
    converged_row: int | None = None
    searched: float = 0.0
    restarts: int = 0


def _follow(
    log: LaserLog,
    particles: PlaceFilter,
    cfg: LaserTrackingConfig,
    how: LocaliseConfig,
    light: tuple[str, IntensityCalibration | None],
    start: Float[np.ndarray, "3"] | None,
    on_progress: Progress,
) -> _Way:
    odometry = ScanOdometry(cfg.front_end, feature=light[0])
    way = _Way(odometry.poses)
    explained: list[float] = []  # share of the returns, since the place was found
    for row, scan in enumerate(log.scans):
        b = beams(scan, *light, cfg.beam)
        info = odometry.advance(scan, b)
        on_progress("scans", row + 1, len(log.scans))
        points = _some(b, LOCALISE_BEAMS)
        motion = se2.between(odometry.poses[way.at[-1]], odometry.poses[row]) if way.at else np.zeros(3)
        far = np.hypot(motion[0], motion[1]) >= UPDATE_DISTANCE or abs(motion[2]) >= UPDATE_TURN
        if len(points) < cfg.filter.least_beams or (way.at and not far):
            way.infos.append(ScanInfo(info.innovation, info.beams, 0, "skipped" if len(points) else "empty"))
            continue
        clock = perf_counter()
        if way.at:
            particles.move(motion)
            particles.weigh(points)
            if (
                start is None
                and len(explained) >= LOCALISE_DOUBTS
                and np.mean(explained[-LOCALISE_DOUBTS:]) < how.trusted
            ):
                particles.begin(None, points)
                way.converged_row, explained = None, []
                way.restarts += 1
        else:
            particles.begin(start, points)
        pose, matches, n_eff, resampled = particles.posterior(b)
        if particles.found:
            explained.append(matches / max(1, len(b.q)))
        if way.converged_row is None:
            way.searched += perf_counter() - clock
            way.converged_row = row if particles.found else None
        way.at.append(row)
        way.corrected.append(pose)
        way.infos.append(ScanInfo(info.innovation, info.beams, matches, "matched", n_eff, resampled))
    return way


def _kept(rows: list[tuple[int, np.ndarray]], most: int) -> list[tuple[int, np.ndarray]]:
    """The last `most` of the rows whole, and as many spread over those before."""
    before, last = rows[:-most], rows[-most:]
    return before[:: max(1, -(-len(before) // most))] + last


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
