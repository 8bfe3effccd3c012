"""The 200 m loop of Hara, Kawata, Ohya and Yuta, simulated, and every method of the paper on it.

Localisation with intensity against geometry: starts searched everywhere, in the paper's ring and beyond it. A log is a
piece of a drive of its own, along the way the map was made on or against it, with wheels and noise of its own. Of every
ten logs one is of another building of the same kind, and one of a twin: the same walls, painted and furnished
otherwise, which geometry alone cannot tell apart. An answer is wrong when half of its poses since the start was found
are off by over WRONG; in another building, and with intensity in a twin, every trusted answer is wrong.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ...core import se2
from ...core.laser_log import LaserLog
from ...core.records import Scan, Track, frozen
from ...core.workers import Progress, no_progress
from ...evaluation.trajectory import align_tracks, ate
from ...io.kept import part
from ...laser.beam import Beams, IntensityCalibration, beams
from ...laser.config import PAPER_FILTER
from ...laser.icp import ICP_LEAST_PAIRS, IcpConfig
from ...laser.laser_map import GridMap, LaserMap
from ...laser.localise import Localisation, localise
from ...laser.occupancy_mapper import render
from ...laser.scan_matching import FrontEndConfig, allowed_sd
from ...laser.scan_odometry import ScanOdometry, inside
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import choose_feature, map_laser
from ...report.result import Rows
from ...sim.laser import SCALE_LENGTH, DriveConfig, LaserSimulation, LaserWorld, Route, drive, ring, stream
from ...sim.laser_worlds import (
    CorridorConfig,
    OfficeConfig,
    TunnelConfig,
    corridor_world,
    office_route,
    office_world,
    simulate_corridor,
    tunnel_route,
    tunnel_world,
)
from .light_edges import at_truth, sharpened

GLASS_SHARE = 0.25  # of the wall pieces
GLASS_RETURNS = 0.1  # share of the beams on glass that come back
SPARSE_EVERY = 24.0  # [m] driven between stretches of
SPARSE_LENGTH = 6.0  # [m] in which
SPARSE_RETURNS = 0.12  # this share of the beams comes back
QUICK_TURN = 0.15  # [rad] between scans; in turns that are quicker no scan is kept

# What a gate allows wheels like the simulated ones, which err by a few per cent: the paper's "found by experience".
WHEELS = FrontEndConfig(sd_xy=0.01, sd_xy_per_m=0.06, sd_turn=0.01, sd_turn_per_m=0.02, sd_turn_per_rad=0.05)
ICP = LaserConfig(method="icp")
GATED = LaserConfig(method="gated", matcher="icp", front_end=WHEELS, gate_sd_xy=0.0, gate_sd_turn=0.0)
# The paper's filter to the letter: raw intensity, eqs. 7 to 9, every scan weighs and is followed by resampling.
PRINTED = LaserConfig(method="particle", feature="raw", filter=PAPER_FILTER, likelihood="paper", resample=1.0)
# Odometry proposes as in the paper, each particle is then refined across the walls of its own map: of all ways to map
# without light that were tried the one that errs least on wheels that are good over a step.
WHEELS_PROPOSE = replace(PAPER_FILTER, refine_iterations=3)

GRAPH = LaserConfig()
WHEELS_KNOWN = replace(GRAPH, feature="none", front_end=WHEELS)  # told how good the wheels are; no light


class Method(NamedTuple):
    """figure: of the paper, where it shows one; rims: whether the poses found are then moved until walls and rims of
    light are seen in one place each.
    """

    name: str
    figure: str
    cfg: LaserConfig | None  # None: odometry alone
    rims: bool = False


def methods(particles: int) -> tuple[Method, ...]:
    """In the order of the paper; matching and filtering with geometry alone and with intensity."""
    ours = LaserConfig(method="particle", particles=particles)
    printed = replace(PRINTED, particles=particles)
    return (
        Method("odometry", "Fig. 4", None),
        Method("ICP, geometry", "", replace(ICP, feature="none")),
        Method("Intensity-ICP", "Fig. 5", ICP),
        Method("gated ICP, geometry", "", replace(GATED, feature="none")),
        Method("gated Intensity-ICP", "Fig. 6", GATED),
        Method("gated, on lines, intensity", "", LaserConfig(method="gated")),
        Method(f"paper's RBPF-{particles}, geometry", "", replace(printed, feature="none")),
        Method(f"paper's RBPF-{particles}, raw intensity", "Fig. 7", printed),
        Method(f"our RBPF-{particles}, geometry", "", replace(ours, feature="none")),
        Method(
            f"our RBPF-{particles}, geometry, wheels propose", "", replace(ours, feature="none", filter=WHEELS_PROPOSE)
        ),
        Method(f"our RBPF-{particles}, intensity", "Fig. 7, ours", ours),
        Method("our graph, geometry", "", replace(GRAPH, feature="none")),
        Method("our graph, geometry, wheels known", "", WHEELS_KNOWN),
        Method("our graph, intensity", "", GRAPH),
        Method("our graph, intensity, rims", "", GRAPH, rims=True),
    )


def score(track: Track, truth: Track) -> float:
    """ATE [m] after one rigid alignment."""
    T = align_tracks([(track, truth, True)])
    error, _ = ate(track, truth, T if T is not None else np.zeros(3), dense=True)
    return float("nan") if error is None else error


GLASS = 0.001  # reflectance by which a pane is known


HARD = CorridorConfig(recess=0.0, corner=0.3, drive=DriveConfig(people=3))
"""The ring of the other experiments, made hard."""


@dataclass(frozen=True, slots=True)
class HardDrive:
    """sim: the drive as logged, scans of quick turns left out. kept: their numbers among those taken."""

    sim: LaserSimulation
    kept: Int[np.ndarray, " k"]


def simulate_hard(c: CorridorConfig = HARD, seed: int = 0) -> HardDrive:
    """One drive, the same for the same seed."""
    rng = stream(seed, "hard")
    world = corridor_world(c, seed)
    glass = rng.random(len(world.reflectance)) < GLASS_SHARE
    world = replace(world, reflectance=frozen(np.where(glass, GLASS, world.reflectance)))
    sim = drive(world, ring(c.long_leg, c.short_leg, c.corner, c.distance, c.start), c.drive, seed)
    log = sim.log
    truth = se2.interpolate(log.scan_t, sim.truth.t, sim.truth.pose)
    step = se2.between(truth[:-1], truth[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    sparse = (way % SPARSE_EVERY) > SPARSE_EVERY - SPARSE_LENGTH
    turn = np.abs(np.concatenate([[0.0], step[:, 2]]))
    inside = (turn > QUICK_TURN) & np.roll(turn > QUICK_TURN, -1)
    kept = np.flatnonzero(~inside)
    scans = []
    for k in kept.tolist():
        draw = rng.random((2, len(log.scans[k].ranges)))
        lost = (sim.reflectance[k] == GLASS) & (draw[0] > GLASS_RETURNS)
        lost |= sparse[k] & (draw[1] > SPARSE_RETURNS)
        scans.append(_without(log.scans[k], lost))
    log = replace(log, scan_t=frozen(log.scan_t[kept]), scans=tuple(scans))
    return HardDrive(replace(sim, log=log, reflectance=frozen(sim.reflectance[kept])), kept)


def _without(scan: Scan, lost: Bool[np.ndarray, " n"]) -> Scan:
    """The scan as if the `lost` beams had not come back."""
    light = np.zeros(len(scan.ranges)) if scan.intensities is None else scan.intensities
    return replace(
        scan,
        ranges=frozen(np.where(lost, scan.range_max, scan.ranges)),
        hit=frozen(scan.hit & ~lost, dtype=bool),
        intensities=frozen(np.where(lost, 0.0, light)),
    )


@dataclass(frozen=True, slots=True)
class Picture:
    """One map as a figure shows it. track and truth: (n, 2) [m] in the map."""

    name: str
    figure: str
    grid: GridMap
    track: Float[np.ndarray, "n 2"]
    truth: Float[np.ndarray, "m 2"]


def compare(
    chosen: tuple[Method, ...], seeds: range, shown: int, on_progress: Progress, loop: CorridorConfig | None = None
) -> tuple[Float[np.ndarray, "m s"], tuple[Picture, ...]]:
    """ATE [m] of every method at every seed, and the maps of the seed `shown`."""
    errors = np.zeros((len(chosen), len(seeds)))
    pictures: list[Picture] = []
    for s, seed in enumerate(seeds):
        sim = simulate_corridor(loop, seed)
        known: dict[LaserConfig, LaserMap] = {}
        for m, method in enumerate(chosen):
            on_progress("reproduce hara", s * len(chosen) + m, len(seeds) * len(chosen))
            cfg = method.cfg or LaserConfig(method="icp", feature="none")
            if cfg not in known:
                known[cfg] = part(map_laser, sim.log, cfg, seed)
            laser_map = known[cfg]
            track = laser_map.track if method.cfg else laser_map.dead_reckoning
            if method.rims:
                track = on_rims(sim.log, laser_map)
            errors[m, s] = score(track, sim.truth) if track is not None else np.nan
            if seed == shown and track is not None:
                pictures.append(_picture(method, laser_map, sim, track))
    on_progress("reproduce hara", 1, 1)
    return errors, tuple(pictures)


def on_rims(log: LaserLog, laser_map: LaserMap) -> Track:
    """The poses of `laser_map` at the scans of its `log`, moved until walls and rims are seen in one place each."""
    poses = laser_map.track.pose[np.searchsorted(laser_map.track.t, log.scan_t)]
    noise = 0.0 if laser_map.calibration is None else laser_map.calibration.residual
    return Track(log.scan_t, sharpened(seen_scans(log, laser_map), poses, noise), frame=laser_map.track.frame)


def seen_scans(log: LaserLog, laser_map: LaserMap) -> list[Beams]:
    """The returns of all scans, their light as `laser_map` reckons it."""
    feature = "none" if laser_map.calibration is None else "normalised"
    return [beams(scan, feature, laser_map.calibration, LaserConfig().beam) for scan in log.scans]


def _picture(method: Method, laser_map: LaserMap, sim: LaserSimulation, track: Track) -> Picture:
    """The map as it was made, or laid anew along a `track` that is not its own."""
    grid = laser_map.grid
    if track is not laser_map.track:
        at = np.searchsorted(track.t, sim.log.scan_t)
        grid = render(
            seen_scans(sim.log, laser_map), track.pose[at], np.zeros((len(at), 3)), grid.resolution, track.frame
        )
    truth = se2.between(sim.truth.pose[0], sim.truth.pose)
    return Picture(method.name, method.figure, grid, track.pose[:, :2], truth[:, :2])


STRETCH = 40  # scans: 10 m
STRAIGHT = 0.05  # [rad] turned in a stretch at most


@dataclass(frozen=True, slots=True)
class AlongRow:
    """error: (seeds,) root mean square error [m] of the distance driven in straight stretches of 10 m."""

    name: str
    error: Float[np.ndarray, " s"]


def try_along(seeds: range, loop: CorridorConfig | None = None) -> tuple[AlongRow, ...]:
    """Wheels, matching that trusts them little (the default), and matching that knows how good they are."""
    cases: tuple[tuple[str, FrontEndConfig | None, str], ...] = (
        ("odometry", None, "none"),
        ("matching, geometry, wheels trusted little", FrontEndConfig(), "none"),
        ("matching, geometry, wheels trusted as they deserve", WHEELS, "none"),
        ("matching, intensity, wheels trusted little", FrontEndConfig(), "normalised"),
    )
    error = np.empty((len(cases), len(seeds)))
    for s, seed in enumerate(seeds):
        sim = simulate_corridor(loop, seed)
        truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
        for row, (_, front_end, name) in enumerate(cases):
            cfg = LaserConfig(feature=name)
            feature = choose_feature(sim.log, cfg)
            way = ScanOdometry(front_end or FrontEndConfig(), feature=feature.name, matching=front_end is not None)
            for scan in sim.log.scans:
                way.advance(scan, beams(scan, feature.name, feature.calibration, cfg.beam))
            error[row, s] = along_error(np.array(way.poses), truth)
    return tuple(AlongRow(name, e) for (name, _, _), e in zip(cases, error, strict=True))


def along_error(poses: Float[np.ndarray, "m 3"], truth: Float[np.ndarray, "m 3"]) -> float:
    """Root mean square error [m] of the distance driven over stretches in which the robot does not turn."""
    driven, true = (se2.between(p[:-STRETCH], p[STRETCH:]) for p in (poses, truth))
    straight = np.abs(true[:, 2]) < STRAIGHT
    miss = np.hypot(driven[:, 0], driven[:, 1]) - np.hypot(true[:, 0], true[:, 1])
    return float(np.sqrt(np.mean(miss[straight] ** 2))) if straight.any() else float("nan")


ALPHAS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # [m^2 per q^2]
REACH = 0.15  # [m] nearest returns of two scans farther apart are not of one place


def estimate_alpha(scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], cell: float = 0.1) -> float:
    """`sigma_s^2 / sigma_q^2` [m^2 per q^2]: what eq. 1 must weigh with, for D to be a chi-square but for its scale.

    Both from nearest returns of scans that follow one another, laid together by odometry `poses`: sigma_q^2 from how
    their brightness differs, sigma_s^2 from how far they lie apart (an axis), and the places of a map kept in cells
    of `cell` [m] are uncertain by `cell^2 / 12` besides. Medians, so that the rims of posters do not count. nan where
    scans share nothing.
    """
    apart: list[np.ndarray] = []
    differ: list[np.ndarray] = []
    for k in range(len(scans) - 1):
        if not len(scans[k].q) or not len(scans[k + 1].q):
            continue
        points = se2.act(se2.between(poses[k], poses[k + 1]), scans[k + 1].s)
        distance, nearest = cKDTree(scans[k].s).query(points)
        near = np.asarray(distance) < REACH
        apart.append(np.asarray(distance)[near])
        differ.append((scans[k + 1].q - scans[k].q[nearest])[near])
    if not apart or not sum(len(a) for a in apart):
        return float("nan")
    place = float(np.median(np.concatenate(apart) ** 2)) / (2.0 * np.log(2.0)) + cell**2 / 12.0
    light = (1.4826 * float(np.median(np.abs(np.concatenate(differ))))) ** 2
    return place / light if light > 0 else float("nan")


@dataclass(frozen=True, slots=True)
class AlphaCurve:
    """ate: (alphas, seeds) [m] of Intensity-ICP; estimate: (seeds,) by log; at_estimate: (seeds,) [m] its error."""

    alphas: tuple[float, ...]
    ate: Float[np.ndarray, "a s"]
    estimate: Float[np.ndarray, " s"]
    at_estimate: Float[np.ndarray, " s"]


def alpha_curve(seeds: range, loop: CorridorConfig | None = None, on_progress: Progress = no_progress) -> AlphaCurve:
    """Intensity-ICP on the ring with every alpha, and with the one found from its own log."""
    ate = np.empty((len(ALPHAS), len(seeds)))
    estimate, at_estimate = np.empty(len(seeds)), np.empty(len(seeds))
    for s, seed in enumerate(seeds):
        sim = simulate_corridor(loop, seed)
        feature = choose_feature(sim.log, ICP)
        seen = [beams(scan, feature.name, feature.calibration, ICP.beam) for scan in sim.log.scans]
        estimate[s] = estimate_alpha(seen, np.array([scan.odometry for scan in sim.log.scans]))
        for a, alpha in enumerate((*ALPHAS, float(estimate[s]))):
            on_progress("alpha", s * (len(ALPHAS) + 1) + a, len(seeds) * (len(ALPHAS) + 1))
            error = score(map_laser(sim.log, with_alpha(ICP, alpha), seed).track, sim.truth)
            if a < len(ALPHAS):
                ate[a, s] = error
            else:
                at_estimate[s] = error
    return AlphaCurve(ALPHAS, ate, estimate, at_estimate)


def with_alpha(cfg: LaserConfig, alpha: float) -> LaserConfig:
    """`cfg` with `alpha` wherever a feature is weighed."""
    return replace(
        cfg,
        icp=replace(cfg.icp, alpha=alpha),
        cells=replace(cfg.cells, alpha=alpha),
        front_end=replace(cfg.front_end, alpha=alpha),
    )


PROBES = 24  # random vectors by which a trace is told to a few per cent


@dataclass(frozen=True, slots=True)
class Bounds:
    """geometry, light: (s,) least expected root mean square error [m] after one rigid alignment, a drive each."""

    geometry: Float[np.ndarray, " s"]
    light: Float[np.ndarray, " s"]


def try_bounds(seeds: range, loop: CorridorConfig | None = None, on_progress: Progress = no_progress) -> Bounds:
    """Both bounds on every drive."""
    cfg = loop or CorridorConfig()
    geometry, light = np.empty(len(seeds)), np.empty(len(seeds))
    for k, seed in enumerate(seeds):
        on_progress("bounds", k, len(seeds))
        sim = simulate_corridor(cfg, seed)
        geometry[k] = geometry_bound(sim, cfg)
        light[k] = light_bound(sim, seed)
    return Bounds(geometry, light)


def geometry_bound(sim: LaserSimulation, cfg: CorridorConfig) -> float:
    """Least expected root mean square error [m] on geometry and wheels."""
    pose = _truth(sim)
    step = se2.between(pose[:-1], pose[1:])
    ds = np.hypot(step[:, 0], step[:, 1])
    flush = along_flush_walls(pose, cfg)[1:]
    drift = cfg.drive.drift
    way = np.cumsum(ds)
    C = drift.scale**2 * np.exp(-np.abs(way[:, None] - way) / SCALE_LENGTH) * ds * ds[:, None]
    C += np.diag(drift.translation**2 * ds)
    left = C[np.ix_(flush, flush)]
    if not flush.all():
        cross = C[np.ix_(flush, ~flush)]
        left = left - cross @ np.linalg.solve(C[np.ix_(~flush, ~flush)], cross.T)
    move = np.diff(pose[:, :2], axis=0) / np.maximum(ds, 1e-12)[:, None]
    n = len(pose)
    after = np.tril(np.ones((n, n - 1)), -1)[:, flush]  # which steps lie before each scan
    J = (after[:, None, :] * move[flush].T[None]).reshape(2 * n, -1)
    J -= _aligned(pose) @ (_aligned(pose).T @ J)
    return float(np.sqrt(max(np.einsum("ij,jk,ik->", J, left, J), 0.0) / n))


def along_flush_walls(pose: Float[np.ndarray, "n 3"], cfg: CorridorConfig) -> Bool[np.ndarray, " n"]:
    """(n,) whether a scan shows nothing but flush walls: on a long leg, with no corner in sight."""
    half, far = 0.5 * cfg.width, cfg.drive.scanner.far
    left, right = -cfg.start - half, cfg.long_leg - cfg.start + half
    inside = (pose[:, 0] - left > far) & (right - pose[:, 0] > far)
    straight = np.abs(np.sin(pose[:, 2])) < 0.1
    return np.asarray(inside & straight)


def light_bound(sim: LaserSimulation, seed: int) -> float:
    """Least root mean square error [m] where rims and walls are known by their own noise."""
    cfg = LaserConfig()
    feature = choose_feature(sim.log, cfg)
    seen = [beams(scan, feature.name, feature.calibration, cfg.beam) for scan in sim.log.scans]
    pose = _truth(sim)
    noise = 0.0 if feature.calibration is None else feature.calibration.residual
    solution = at_truth(seen, pose, noise)
    if solution.information is None:
        return float("nan")
    Q = _aligned(pose)
    n, at = len(pose), np.full(len(solution.x), -1)
    at[solution.free] = np.arange(len(solution.free))
    where = at[3 * np.arange(n)[:, None] + np.arange(2)].ravel()
    z = np.random.default_rng(seed).choice([-1.0, 1.0], (2 * n, PROBES))  # the trace of a matrix is E z^T A z
    z -= Q @ (Q.T @ z)
    b = np.zeros((len(solution.free), PROBES))
    b[where[where >= 0]] = z[where >= 0]
    return float(np.sqrt(np.mean(np.sum(b * solution.information.solve(b), axis=0)) / n))


def _truth(sim: LaserSimulation) -> Float[np.ndarray, "n 3"]:
    return np.asarray(sim.truth.pose[np.searchsorted(sim.truth.t, sim.log.scan_t)])


def _aligned(pose: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """An orthonormal basis of what one rigid motion does to all positions, which alignment takes away."""
    n = len(pose)
    G = np.zeros((n, 2, 3))
    G[:, 0, 0] = G[:, 1, 1] = 1.0
    G[:, 0, 2], G[:, 1, 2] = -pose[:, 1], pose[:, 0]
    return np.asarray(np.linalg.qr(G.reshape(2 * n, 3))[0])


@dataclass(frozen=True, slots=True)
class GateRow:
    """One method on S drives. farthest, nearest: [m] pairs are taken at first and at last; ate: (S,) [m]; counts: (S,).

    few: matches of too few pairs, which any of them replaces by odometry; outside: matches that the gate does not
    allow (without a gate they are taken); rightly: those of them that err more about the step than odometry does;
    slipped: matches inside the gate that err about the step by more than the gate allows.
    """

    name: str
    figure: str
    farthest: float
    nearest: float
    ate: Float[np.ndarray, " s"]
    scans: Float[np.ndarray, " s"]
    few: Float[np.ndarray, " s"]
    outside: Float[np.ndarray, " s"]
    rightly: Float[np.ndarray, " s"]
    slipped: Float[np.ndarray, " s"]


OURS, WIDE, WIDEST = (
    IcpConfig(),
    IcpConfig(gate=1.0, least_gate=0.3),
    IcpConfig(gate=2.0, gate_decay=0.9, least_gate=0.5),
)
PAIRS = (OURS, WIDE, WIDEST)  # the paper does not print how wrong pairs are kept out


def try_gate(seeds: range, hard: CorridorConfig = HARD, on_progress: Progress = no_progress) -> tuple[GateRow, ...]:
    """Odometry, and Intensity-ICP without and with the gate for all widths of pairing, on the hard ring."""
    measured: list[list[tuple[float, ...]]] = [[] for _ in range(1 + 2 * len(PAIRS))]
    heads = [("odometry", "Fig. 4", np.nan, np.nan)]
    for pairs in PAIRS:
        heads += [("Intensity-ICP", "Fig. 5", pairs.gate, pairs.least_gate)]
        heads += [("gated Intensity-ICP", "Fig. 6", pairs.gate, pairs.least_gate)]
    cases = [replace(cfg, icp=pairs) for pairs in PAIRS for cfg in (ICP, GATED)]
    for at, seed in enumerate(seeds):
        sim = simulate_hard(hard, seed).sim
        for row, cfg in enumerate(cases):
            on_progress("the gate", at * len(cases) + row, len(seeds) * len(cases))
            laser_map = map_laser(sim.log, cfg, seed)
            if not row and laser_map.dead_reckoning is not None:
                measured[0].append((score(laser_map.dead_reckoning, sim.truth), len(sim.log.scans), 0, 0, 0, 0))
            measured[row + 1].append((score(laser_map.track, sim.truth), len(sim.log.scans), *judged(laser_map, sim)))
    return tuple(GateRow(*head, *np.array(rows, float).T) for head, rows in zip(heads, measured, strict=True))


def judged(laser_map: LaserMap, sim: LaserSimulation) -> tuple[int, int, int, int]:
    """few, outside, rightly, slipped of one drive; see `GateRow`."""
    truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
    step = se2.between(truth[:-1], truth[1:])
    odometry = np.array([scan.odometry for scan in sim.log.scans])
    u = se2.between(odometry[:-1], odometry[1:])
    few = outside = rightly = slipped = 0
    for k in range(1, len(sim.log.scans)):
        if laser_map.scans.decision[k] not in {"matched", "odometry"}:
            continue
        if laser_map.scans.matches[k] < ICP_LEAST_PAIRS:
            few += 1
            continue
        eps = GATED.eps(allowed_sd(u[k - 1], WHEELS))
        innovation = laser_map.scans.innovation[k]
        wrong = se2.between(step[k - 1], se2.compose(u[k - 1], innovation))
        if inside(innovation, eps):
            slipped += not inside(wrong, eps)
            continue
        outside += 1
        rightly += bool(np.abs(wrong / eps).max() > np.abs(se2.between(step[k - 1], u[k - 1]) / eps).max())
    return few, outside, rightly, slipped


Kind = Literal["ring", "office", "tunnel"]
Where = Literal["here", "twin", "other"]
Answer = Literal["right", "wrong", "not sure"]
KINDS: tuple[Kind, ...] = ("ring", "office", "tunnel")
FEATURES = {"normalised": "intensity", "none": "geometry"}
WRONG = 0.5  # [m]
SCANS = 60  # of a log
CFG = LaserConfig()


@dataclass(frozen=True, slots=True)
class LocalisedStart:
    """What became of one start. error: [m] of a log of the mapped building, else None; doubt: the reason given."""

    start: int
    world: Kind
    where: Where
    feature: str
    answer: Answer
    error: float | None
    matched: float
    found: bool
    doubt: str


@dataclass(frozen=True, slots=True)
class _Place:
    """A finished map in the world's frame, and what drives through it are made of."""

    grid: GridMap
    calibration: IntensityCalibration | None
    world: LaserWorld
    route: Route


def try_starts(
    starts: int,
    seed: int,
    scans: int = SCANS,
    loop: CorridorConfig | None = None,
    on_progress: Progress = no_progress,
) -> tuple[LocalisedStart, ...]:
    """`starts` logs of `scans` scans located with intensity and without, the buildings in turn.

    loop: the ring instead of the paper's, the only building then. The same seed gives the same answers.
    """
    kinds = KINDS if loop is None else KINDS[:1]
    corridor = loop or CorridorConfig()
    places = {kind: _mapped(kind, corridor) for kind in kinds[: max(starts, 0)]}
    out: list[LocalisedStart] = []
    for k in range(starts):
        on_progress("starts", k, starts)
        out += _tried(k, seed, scans, places, corridor)
    return tuple(out)


def starts_table(starts: Sequence[LocalisedStart]) -> Rows:
    """Head and rows: answers by building and feature, and over all buildings."""
    head = ("world", "map and scans of", "log of", "right", "wrong", "not sure")
    rows: list[tuple[object, ...]] = []
    for kind in (*KINDS, None):
        for feature, name in FEATURES.items():
            for where in ("here", "twin", "other"):
                mine = [s for s in starts if s.world == (kind or s.world) and (s.feature, s.where) == (feature, where)]
                if mine:
                    n = counts(mine)
                    place = {"here": "the building", "twin": "its twin", "other": "another"}[where]
                    rows.append((kind or "all", name, place, n["right"], n["wrong"], n["not sure"]))
    return head, rows


def counts(starts: Sequence[LocalisedStart], feature: str | None = None) -> Counter[str]:
    """How often each answer was given, with one feature or all."""
    return Counter(s.answer for s in starts if feature in {None, s.feature})


def building(kind: Kind, seed: int, change: float, corridor: CorridorConfig) -> tuple[LaserWorld, Route]:
    """A building and a way through it. change: [m] by which its rooms and corridors are wider and longer."""
    if kind == "ring":
        share = min(corridor.long_leg / 60.0, 1.0)
        c = replace(
            corridor,
            width=corridor.width + 0.3 * change,
            long_leg=corridor.long_leg - 6 * share * change,
            short_leg=corridor.short_leg + 4 * share * change,
        )
        return corridor_world(c, seed), ring(c.long_leg, c.short_leg, c.corner, c.distance, c.start)
    if kind == "office":
        o = OfficeConfig()
        o = replace(o, room_width=o.room_width + change, room_depth=o.room_depth - 0.6 * change)
        return office_world(o, seed), office_route(o, seed)
    t = TunnelConfig()
    t = replace(t, width=t.width + 0.5 * change)
    return tunnel_world(t, seed), tunnel_route(t)


def _mapped(kind: Kind, corridor: CorridorConfig) -> _Place:
    """The map of one drive, every scan where it truly was."""
    world, route = building(kind, 1, 0.0, corridor)
    sim = drive(world, route, corridor.drive, 1)
    log = sim.log
    feature = choose_feature(log, CFG)
    seen = [beams(scan, feature.name, feature.calibration, CFG.beam) for scan in log.scans]
    truth = sim.truth.pose[np.searchsorted(sim.truth.t, log.scan_t)]
    sensors = np.array([scan.T_robot_sensor for scan in log.scans])
    return _Place(render(seen, truth, sensors, CFG.resolution, "map"), feature.calibration, world, route)


def _backwards(route: Route) -> Route:
    """The same way the other way round."""
    end = route.poses(np.array([route.total - 1e-6]))[0]
    start = se2.compose(end, np.array([0.0, 0.0, np.pi]))
    return Route(start, route.length[::-1].copy(), -route.curvature[::-1])


def _piece(sim: LaserSimulation, first: int, scans: int) -> tuple[LaserLog, Track]:
    """So many scans of the drive from `first` on, and the truth."""
    log, end = sim.log, min(first + scans, len(sim.log.scans))
    t0, t1 = log.scan_t[first], log.scan_t[end - 1]
    rows = None
    if log.odometry is not None:
        keep = (log.odometry.t >= t0) & (log.odometry.t <= t1)
        rows = Track(log.odometry.t[keep], log.odometry.pose[keep], frame="odom")
    return replace(log, scan_t=log.scan_t[first:end], scans=log.scans[first:end], odometry=rows), sim.truth


def _off(localisation: Localisation, truth: Track) -> float:
    """[m] median error of the poses since the start was found."""
    since = localisation.track.t[0] if localisation.found_t is None else localisation.found_t
    inside = localisation.track.t >= since
    true = truth.pose[np.searchsorted(truth.t, localisation.track.t[inside])]
    return float(np.median(np.hypot(*(localisation.track.pose[inside] - true)[:, :2].T)))


def _tried(k: int, seed: int, scans: int, places: dict[Kind, _Place], corridor: CorridorConfig) -> list[LocalisedStart]:
    """What became of the k-th start, with intensity and without."""
    kind = list(places)[k % len(places)]
    rng = np.random.default_rng([seed, k])
    where: Where = "twin" if k % 10 == 4 else "other" if k % 10 == 9 else "here"
    place = places[kind]
    world, route = place.world, place.route
    if where != "here":
        change = 0.0 if where == "twin" else float(rng.choice([-1.0, 1.0]))
        world, route = building(kind, 1000 + k, change, corridor)
    way = _backwards(route) if rng.random() < 0.5 else route
    sim = drive(world, way, corridor.drive, 5000 + 31 * seed + k)
    log, truth = _piece(sim, int(rng.integers(0, max(1, len(sim.log.scans) - scans))), scans)
    out = []
    for feature in FEATURES:
        if where == "twin" and feature == "none":
            continue
        chance = np.random.default_rng(k)
        localisation = localise(log, place.grid, place.calibration, feature, CFG, None, chance, no_progress)
        error = _off(localisation, truth) if where == "here" else None
        right = error is not None and error < WRONG
        answer: Answer = "not sure" if not localisation.trusted else "right" if right else "wrong"
        out.append(
            LocalisedStart(
                k,
                kind,
                where,
                feature,
                answer,
                error,
                localisation.matched,
                localisation.found_t is not None,
                localisation.doubt,
            )
        )
    return out
