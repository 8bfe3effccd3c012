"""What an update of many particles costs on the Intel log: processor time, cells compared, bytes moved.

    MAPWEAVE_DATA=.. python benchmarks/laser_filter.py [--particles 512] [--scans 700]

One thread. The last rows are of the last update: the nine cells around its beams are read once more, at addresses
worked out before, and nothing is done with them but added; then they are laid out in windows and searched as an update
does it once for every beam; then as many tiles are copied as it writes to, as after every resampling.
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mapweave.io.laser_logs import read_laser
from mapweave.kernels._jit import parallel_kernel, prange, set_threads
from mapweave.kernels.laser import tiles
from mapweave.laser import particle_slam
from mapweave.laser.beam import beams
from mapweave.mapping.config import LaserConfig


@parallel_kernel
def read_cells(pool: np.ndarray, at: np.ndarray, out: np.ndarray) -> None:
    """What x and y of the nine cells add up to, of every beam, one particle after the other."""
    for p in prange(at.shape[0]):
        total = np.float32(0)
        for i in range(at.shape[1]):
            k = np.uint64(at[p, i])
            total += pool[k] + pool[k + np.uint64(1)]
        out[p] = total


def addresses(state: particle_slam.ParticleState, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where in the pool the 3x3 cells of every beam are (P, 9 n), and the tiles (P, n) of its own cell."""
    m, size = state.maps, state.maps.cfg.size
    c, s = np.cos(state.poses[:, 2, None]), np.sin(state.poses[:, 2, None])
    x = (state.poses[:, 0, None] + c * points[:, 0] - s * points[:, 1] - m.origin[0]) / size
    y = (state.poses[:, 1, None] + s * points[:, 0] + c * points[:, 1] - m.origin[1]) / size
    out, rows = [], np.arange(len(m))[:, None]
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            ix, iy = x.astype(int) + dx, y.astype(int) + dy
            tile = m.table[rows, iy // tiles.CELLS * int(m.shape[1]) + ix // tiles.CELLS].astype(np.int64)
            out.append(tile * tiles.FLOATS + 4 * (iy % tiles.CELLS * tiles.CELLS + ix % tiles.CELLS))
    own = m.table[rows, y.astype(int) // tiles.CELLS * int(m.shape[1]) + x.astype(int) // tiles.CELLS]
    return np.ascontiguousarray(np.stack(out, axis=2).reshape(len(m), -1)), own


def least_of(work: Callable[[], object], times: int = 15) -> float:
    """Processor seconds of the fastest of some runs."""
    spent = []
    for _ in range(times):
        began = time.process_time()
        work()
        spent.append(time.process_time() - began)
    return min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, default=512)
    parser.add_argument("--scans", type=int, default=700)
    args = parser.parse_args()
    set_threads(1)
    log = read_laser(Path(os.environ["MAPWEAVE_DATA"]) / "carmen" / "intel.clf.gz")
    cfg = LaserConfig(method="particle", particles=args.particles, threads=1)
    for particles, scans in ((2, 60), (args.particles, args.scans)):
        rng = np.random.default_rng(0)
        state = particle_slam.init("1", LaserConfig(method="particle", particles=particles, threads=1), rng)
        spent, most, seen = [], 0, 0
        for event in log.events():
            done, began = len(state.history), time.process_time()
            state, info = particle_slam.step(state, event, cfg, rng)
            if len(state.history) and info is not None and info.decision != "skipped":
                spent.append(time.process_time() - began)
            if len(state.history) > done or done == 0:
                last = event.record
            most, seen = max(most, state.maps.bytes_of_tiles), seen + (info is not None)
            if seen == scans:
                break
    points = particle_slam.as_points(beams(last, "none", None, cfg.beam))
    passes = cfg.filter.refine_iterations + 1
    at, own = addresses(state, points)
    out = np.empty(len(at), np.float32)
    read_cells(state.maps.pool, at, out)
    reading = least_of(lambda: read_cells(state.maps.pool, at, out))
    rows, maps = np.arange(len(state.poses)), state.maps
    looking = least_of(lambda: maps.score(rows, state.poses, points))
    touched = sum(len(np.unique(row)) for row in own)
    beams_looked_up = len(own) * len(points)
    lines = sum(len(np.unique(row // 16)) for row in at)
    tile_bytes = tiles.FLOATS * 4
    jobs = np.column_stack([np.random.default_rng(0).permutation(touched), touched + np.arange(touched)])
    pool, jobs = np.ones(2 * touched * tiles.FLOATS, np.float32), jobs.astype(np.int32)
    copying = least_of(lambda: tiles.copy_tiles(pool, jobs, touched))
    print("| of an update | |")
    print("|---|---|")
    print(f"| particles, scans, updates | {args.particles}, {args.scans}, {len(spent)} |")
    print(f"| processor time, mean | {1e3 * np.mean(spent):.1f} ms |")
    print(f"| of the tenth of updates that took least | {1e3 * np.mean(np.sort(spent)[: len(spent) // 10]):.1f} ms |")
    print(f"| most tiles in use | {most / 1e6:.0f} MB |")
    print(f"| table of the tiles of every map | {state.maps.table.nbytes / 1e6:.0f} MB |")
    print(f"| beams times particles, the last update | {beams_looked_up:,} |")
    print(f"| times they are compared | {passes} |")
    print(f"| cache lines of the nine cells around them | {lines:,}, {lines * 64 / 1e6:.1f} MB |")
    print(f"| tiles they lie in | {touched:,}, {touched * tile_bytes / 1e6:.1f} MB |")
    print(f"| reading the nine cells of every beam once, nothing else | {1e3 * reading:.1f} ms |")
    each = 1e9 * looking / beams_looked_up
    print(f"| the least D of every beam once, its window read anew | {1e3 * looking:.1f} ms, {each:.0f} ns each |")
    print(f"| copying as many tiles | {1e3 * copying:.1f} ms |")


if __name__ == "__main__":
    main()
