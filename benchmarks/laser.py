"""How fast the laser methods are: a table, and JSON with `--json FILE`. Ratios are measured in one run.

python benchmarks/laser.py [--quick] [--json FILE]
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from mapweave.core import se2
from mapweave.core.records import Event
from mapweave.kernels._jit import parallel_kernel, prange, set_threads
from mapweave.kernels.laser.icp import IcpRules, intensity_icp
from mapweave.laser import particle_slam
from mapweave.laser.beam import beams
from mapweave.laser.config import PAPER_FILTER
from mapweave.laser.particle_grid import CellConfig, ParticleGrid
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature
from mapweave.sim.laser_worlds import simulate_corridor

SENSOR_HZ = 10.0
PARTICLES = 512


def clock(threads: int) -> Callable[[], float]:
    return time.process_time if threads == 1 else time.perf_counter


def best(what: Callable[[], object], repeat: int, threads: int = 1) -> float:
    """Least time of one call [s]: what the machine can do when nobody disturbs."""
    now = clock(threads)
    what()
    times = []
    for _ in range(repeat):
        begun = now()
        what()
        times.append(now() - begun)
    return min(times)


def drive(cfg: LaserConfig, feature, log, scans: int, threads: int) -> tuple[np.ndarray, ParticleGrid, int, int]:
    """Seconds of every scan, the maps at the end, and the greatest tiles ever in use and unshared [bytes]."""
    set_threads(threads)
    now = clock(threads)
    rng = np.random.default_rng(0)
    state = particle_slam.init("1", cfg, rng, feature=feature.name, calibration=feature.calibration)
    times, shared, unshared = [], 0, 0
    for t, scan in zip(log.scan_t[:scans], log.scans[:scans], strict=True):
        begun = now()
        state, _ = particle_slam.step(state, Event(float(t), "1", scan), cfg, rng)
        times.append(now() - begun)
        shared, unshared = max(shared, state.maps.bytes_of_tiles), max(unshared, state.maps.bytes_unshared)
    return np.array(times), state.maps, shared, unshared


def steps(*, quick: bool) -> dict:
    sim = simulate_corridor(seed=0)
    paper = LaserConfig(particles=PARTICLES, filter=PAPER_FILTER)
    usual = LaserConfig(particles=PARTICLES)
    feature = choose_feature(sim.log, paper)
    part = 120 if quick else 300
    drive(paper, feature, sim.log, 5, 1)
    drive(usual, feature, sim.log, 5, 1)
    one, _, _, _ = drive(paper, feature, sim.log, part, 1)
    wall, _, _, _ = drive(paper, feature, sim.log, part, 4)
    front, _, _, _ = drive(usual, feature, sim.log, part, 1)
    _, _, shared, unshared = drive(paper, feature, sim.log, part if quick else len(sim.log.scans), 1)
    rate = 1 / np.median(one[5:])
    return {
        "filter_step_ms_1_thread": 1e3 * float(np.median(one[5:])),
        "times_sensor_rate": float(rate / SENSOR_HZ),
        "filter_step_ms_4_threads": 1e3 * float(np.median(wall[5:])),
        "speedup_4_threads": float(np.median(one[5:]) / np.median(wall[5:])),
        "default_method_ms_a_scan_1_thread": 1e3 * float(front[5:].mean()),
        "default_method_times_sensor_rate": float(1 / front[5:].mean() / SENSOR_HZ),
        "loop_driven_m": 0.25 * (part if quick else len(sim.log.scans)),
        "tiles_peak_mb": shared / 1e6,
        "unshared_over_shared": unshared / shared,
    }


def two_scans() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reference points in the map, a scan in its robot frame, and where odometry puts it."""
    sim = simulate_corridor(seed=0)
    feature = choose_feature(sim.log, LaserConfig())
    a, b = (beams(sim.log.scans[k], feature.name, feature.calibration, LaserConfig().beam) for k in (40, 41))
    start = np.add(se2.between(sim.log.scans[40].odometry, sim.log.scans[41].odometry), [0.05, 0.03, 0.02])
    return np.column_stack([a.s, a.q]), np.column_stack([b.s, b.q]), start


def tree_icp(reference: np.ndarray, scan: np.ndarray, start: np.ndarray, iterations: int) -> np.ndarray:
    """The same iterations in NumPy with a k-d tree in (x, y, q)."""
    tree = cKDTree(reference)
    pose = start.copy()
    for r in range(iterations):
        gate = max(0.1, 0.4 * 0.8**r)
        z = np.column_stack([se2.act(pose, scan[:, :2]), scan[:, 2]])
        _, k = tree.query(z, distance_upper_bound=gate)
        ok = k < len(reference)
        pose = se2.align(scan[ok, :2], reference[k[ok], :2])
    return pose


def matching(*, quick: bool) -> dict:
    reference, scan, start = two_scans()
    repeat = 50 if quick else 300

    def ours() -> np.ndarray:
        return intensity_icp(reference, scan, start, IcpRules(1.0, 0.4, 0.1, 0.8, 10, 0.0, 20, 0.1))[0]

    def tree() -> np.ndarray:
        return tree_icp(reference, scan, start, 10)

    fast, slow = best(ours, repeat), best(tree, repeat // 5)
    out = {
        "points": [len(reference), len(scan)],
        "intensity_icp_us": 1e6 * fast,
        "numpy_ckdtree_us": 1e6 * slow,
        "times_faster": slow / fast,
        "same_pose_within_m": float(np.abs(ours() - tree()).max()),
    }
    try:
        import small_gicp
    except ImportError:
        return out
    lift = np.column_stack([reference[:, :2], np.zeros(len(reference))])
    moved = np.column_stack([scan[:, :2], np.zeros(len(scan))])
    guess = np.eye(4)
    guess[:2, :2], guess[:2, 3] = se2.rotation(start[2]), start[:2]
    out["small_gicp_geometry_us"] = 1e6 * best(
        lambda: small_gicp.align(
            lift,
            moved,
            guess,
            registration_type="ICP",
            max_correspondence_distance=0.4,
            num_threads=1,
            max_iterations=10,
            downsampling_resolution=0.001,
        ),
        repeat // 5,
    )
    return out


@parallel_kernel
def bare_lookup(pool: np.ndarray, at: np.ndarray, out: np.ndarray) -> None:
    """Nine cells read for every beam at addresses worked out before, and nothing done with them but added."""
    for p in prange(at.shape[0]):
        for i in range(at.shape[1]):
            total = np.float32(0)
            for k in range(9):
                total += pool[at[p, i] + 4 * k]
            out[p, i] = total


def scoring(*, quick: bool) -> dict:
    sim = simulate_corridor(seed=0)
    feature = choose_feature(sim.log, LaserConfig())
    grid = ParticleGrid(PARTICLES, CellConfig())
    rng = np.random.default_rng(0)
    rows = np.arange(PARTICLES)
    truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
    for k in range(10):
        b = beams(sim.log.scans[k], feature.name, feature.calibration, LaserConfig().beam)
        points = particle_slam.as_points(b)
        poses = se2.between(truth[0], truth[k]) + rng.normal(0, [0.02, 0.02, 0.01], (PARTICLES, 3))
        grid.insert(rows, poses, points, b.w.astype(np.float32))
    at = rng.integers(0, len(grid.pool) // 4 - 10, (PARTICLES, len(points))) * 4
    out = np.empty((PARTICLES, len(points)), np.float32)
    found = {}
    for threads in (1, 4):
        set_threads(threads)
        ours = best(lambda: grid.score(rows, poses, points), 10 if quick else 40, threads)
        bare = best(lambda: bare_lookup(grid.pool, at, out), 10 if quick else 40, threads)
        found[f"scoring_ms_{threads}_threads"] = 1e3 * ours
        found[f"beam_correspondences_a_second_{threads}_threads"] = PARTICLES * len(points) / ours
        found[f"share_of_bare_lookup_{threads}_threads"] = bare / ours
    return found


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--quick", action="store_true")
    ask.add_argument("--json", type=Path)
    said = ask.parse_args()
    result = {
        "step": steps(quick=said.quick),
        "matching": matching(quick=said.quick),
        "scoring": scoring(quick=said.quick),
    }
    for group, figures in result.items():
        print(group)
        for name, value in figures.items():
            print(f"  {name:44s} {value:.4g}" if isinstance(value, float) else f"  {name:44s} {value}")
    if said.json:
        said.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
