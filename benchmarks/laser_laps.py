"""Laps of one hall: processor seconds and memory a lap, keyframes and closures in the graph, errors and NEES.

    python benchmarks/laser_laps.py [--laps 100] [--beams 60] [--seed 0] [--grow] [--kept]

A robot drives round a hall of 14 x 10 m with boxes in it, scan by scan through `LaserSlam`. A row a lap that is told:
seconds of processor over the lap, memory of the process at its end, what the graph holds; at the end the error of the
ways at every scan, seen from the first, and their NEES a degree of freedom (1 when covariances are right).
--grow: no keyframe ever leaves the graph (`laser.graph.known_places.enough` = 0). --kept: instead of times, which line
of the code holds how much more memory at the end than halfway, a lap, counted at the allocator of Python and NumPy.
"""

import argparse
import gc
import linecache
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np

from mapweave.api.slam import LaserSlam
from mapweave.core import se2
from mapweave.mapping.config import LaserConfig
from mapweave.sim.laser import (
    DriftConfig,
    DriveConfig,
    LaserSimulation,
    LaserWorld,
    Scanner,
    WallStyle,
    WorldBuilder,
    drive,
    ring,
    stream,
)

WIDE, HIGH, CORNER, START, ASIDE = 10.0, 6.0, 1.2, 3.0, 2.0  # [m] of the way round, and of the walls from it
LAP = 2 * (WIDE + HIGH) - (8 - 2 * np.pi) * CORNER  # [m]
BOXES = 10


def hall(seed: int) -> LaserWorld:
    """Four walls and boxes along them and in the middle, in the frame of the robot's first pose."""
    rng = stream(seed, "walls")
    build = WorldBuilder("hall", WallStyle(), rng)
    x0, y0, x1, y1 = -START - ASIDE, -ASIDE, WIDE - START + ASIDE, HIGH + ASIDE
    for a, b in (((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x1, y1), (x0, y1)), ((x0, y1), (x0, y0))):
        build.plain(a, b)
    for k in range(BOXES):
        wide, deep = rng.uniform(0.3, 1.0, 2)
        if k % 2:
            x, y = rng.uniform(x0 + 3.2, x1 - 4.2), rng.uniform(y0 + 3.2, y1 - 4.2)
        else:
            x, y = rng.uniform(x0, x1 - wide), (y0 if k % 4 else y1 - 0.6 * deep)
            deep *= 0.6
        build.box(x, y, wide, deep, 0.5)
    return build.world()


def laps(count: int, beams: int, seed: int) -> LaserSimulation:
    cfg = DriveConfig(
        scanner=Scanner(beams=beams, far=8.0), drift=DriftConfig(end_error=None), odometry_every=0.25, scan_every=0.25
    )
    return drive(hall(seed), ring(WIDE, HIGH, CORNER, count * LAP, START), cfg, seed)


def memory() -> float:
    """[MB] of the process now."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def held() -> tracemalloc.Snapshot:
    gc.collect()
    return tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(False, tracemalloc.__file__)])


def kept(before: tracemalloc.Snapshot, after: tracemalloc.Snapshot, laps: int) -> str:
    """Lines of mapweave that hold more than before, most first; other packages and lesser lines in one row."""
    more = [d for d in after.compare_to(before, "lineno") if d.size_diff]
    total, told = sum(d.size_diff for d in more), 0
    rows = ["| held by | kB a lap more |", "|---|---|"]
    for d in sorted(more, key=lambda d: -d.size_diff):
        frame = d.traceback[0]
        if told >= 0.95 * total or "mapweave" not in Path(frame.filename).parts:
            continue
        told += d.size_diff
        name = "/".join(Path(frame.filename).parts[-2:])
        line = linecache.getline(frame.filename, frame.lineno).strip()
        rows.append(f"| `{name}`: `{line}` | {d.size_diff / laps / 1e3:.1f} |")
    rows.append(f"| lesser lines and other packages | {(total - told) / laps / 1e3:.1f} |")
    return "\n".join([*rows, f"| all of it | {total / laps / 1e3:.1f} |"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--laps", type=int, default=100)
    parser.add_argument("--beams", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--grow", action="store_true", help="no keyframe ever leaves the graph")
    parser.add_argument("--kept", action="store_true", help="what holds more memory at the end than halfway")
    asked = parser.parse_args()
    sim = laps(asked.laps, asked.beams, asked.seed)
    cfg = LaserConfig(method="graph", feature="none")
    if asked.grow:
        known = replace(cfg.graph.known_places, enough=0)
        cfg = replace(cfg, graph=replace(cfg.graph, known_places=known))
    slam = LaserSlam(cfg)
    ends = np.searchsorted(sim.log.scan_t, sim.log.scan_t[0] + np.arange(1, asked.laps + 1) * LAP / DriveConfig().speed)
    told = {1, 2, 5, *range(10, asked.laps + 1, max(10, asked.laps // 10)), asked.laps}
    base = memory()
    if asked.kept:
        tracemalloc.start()
    else:
        print("| lap | CPU s a lap | MB since the start | keyframes | closures tried |\n|---|---|---|---|---|")
    at = 0
    for lap, end in enumerate(np.minimum(ends, len(sim.log.scans)).tolist(), 1):
        began = time.process_time()
        for t, scan in zip(sim.log.scan_t[at:end].tolist(), sim.log.scans[at:end], strict=True):
            slam.add_scan(t, scan.ranges, scan.angles(), odometry=scan.odometry, range_max=scan.range_max)
        spent, at = time.process_time() - began, end
        if asked.kept and lap == asked.laps // 2:
            before = held()
        if lap in told and not asked.kept:
            graph = slam.graph()
            print(f"| {lap} | {spent:.2f} | {memory() - base:.1f} | {len(graph)} | {len(graph.closures)} |", flush=True)
    if asked.kept:
        print(kept(before, held(), asked.laps - asked.laps // 2))
        return
    began = time.process_time()
    made = slam.result().maps[0]
    spent = time.process_time() - began
    true = np.array([sim.truth.pose[k] for k in np.searchsorted(sim.truth.t, made.track.t)])
    e = se2.between(made.track.pose[0], made.track.pose) - se2.between(true[0], true)
    e[:, 2] = se2.wrap_angle(e[:, 2])
    assert made.track.cov is not None  # noqa: S101  (the graph method tells them)
    squares = np.einsum("ni,nij,nj->n", e, np.linalg.inv(made.track.cov), e)[1:]
    off = np.hypot(e[:, 0], e[:, 1])
    print(
        f"{asked.laps} laps, {len(sim.log.scans)} scans, {made.dropped}: RMS {np.sqrt(np.mean(off**2)):.3f} m, "
        f"greatest {off.max():.3f} m, NEES {squares.mean() / 3:.2f}, result in {spent:.1f} s"
    )


if __name__ == "__main__":
    main()
