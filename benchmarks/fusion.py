"""Fusing maps of 5, 50 and 500 robots: a Gauss-Newton step's time and memory, beside GTSAM and one dense RLS pass.

    python benchmarks/fusion.py [--robots 5,50,500] [--no-gtsam] [--json FILE]

Every robot maps about 130 of 100 landmarks a robot that lie in a square world, with a full covariance. All solvers
get the same problem in the same process; GTSAM gets each map as one factor over its frame and landmarks. Times are
those of the processor: run it with OMP_NUM_THREADS=1.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mapweave.core import se2
from mapweave.fusion.cluster import Cluster
from mapweave.fusion.full_covariance import build, grouped
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.solve import Pattern, SolveConfig, minimise

STEPS = 5
RADIUS = 6.4  # [m] that a robot maps around it
CELL = 10.0  # [m] between robots, 100 landmarks in each cell


def world(robots, seed=0):
    """Maps of `robots` robots and a start that is off by half a metre and 3 degrees."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(robots)))
    centres = np.array([(CELL * (k % side), CELL * (k // side)) for k in range(robots)], float)
    cells = centres[rng.integers(robots, size=100 * robots)]
    points = cells + rng.uniform(-CELL / 2, CELL / 2, cells.shape)
    frames = np.column_stack([centres, rng.uniform(-np.pi, np.pi, robots)])
    T_first_world = se2.inverse(frames[0])
    frames, points = se2.compose(T_first_world, frames), se2.act(T_first_world, points)
    frames[0] = 0.0
    maps = []
    for T in frames:
        near = np.flatnonzero(np.hypot(*(points - T[:2]).T) < RADIUS)
        local = se2.act(se2.inverse(T), points[near])
        own = np.repeat(np.exp(rng.uniform(np.log(0.01), np.log(0.05), len(near))), 2)
        drift = 0.01 * np.stack([-local[:, 1], local[:, 0]], axis=1).ravel()
        z = local.ravel() + own * rng.normal(size=len(own)) + drift * rng.normal()
        cov = np.diag(own**2) + np.outer(drift, drift)
        maps.append(LandmarkMap(tuple(map(str, near)), z.reshape(-1, 2), cov))
    ids = tuple(dict.fromkeys(name for m in maps for name in m.ids))
    true = points[[int(i) for i in ids]]
    off = rng.normal(0, [0.3, 0.3, 0.05], frames.shape)
    off[0] = 0.0
    start = Cluster(
        tuple(range(robots)),
        se2.compose(frames, off),
        ids,
        true + rng.normal(0, 0.3, true.shape),
        np.zeros(robots, int),
    )
    return maps, start, true


def ours(maps, start, true):
    tic = time.process_time()
    problem, layout = build(maps, start, [m.cov for m in maps], None)
    pattern = grouped(Pattern.of(problem), problem, layout)
    prepared = time.process_time() - tic
    tic = time.process_time()
    cfg = SolveConfig(max_iterations=STEPS, damping=0.0, step_tolerance=0.0, cost_tolerance=0.0)
    solution = minimise(problem, cfg, pattern)
    seconds = time.process_time() - tic
    off = solution.x[layout.landmarks :].reshape(-1, 2) - true
    return {
        "prepare_s": prepared,
        "five_steps_s": seconds,
        "step_s": seconds / (STEPS + 1),  # the last factorisation, for covariances, is a step's work too
        "factor_mb": solution.information.factor_bytes / 1e6,
        "chi2_per_dof": solution.chi2 / solution.dof,
        "rmse_m": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        "variables": len(problem.free),
    }


def with_gtsam(maps, start, true, steps=STEPS):
    import gtsam

    place = {name: i for i, name in enumerate(start.ids)}
    robots = len(maps)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(start.frames):
        values.insert(k, gtsam.Pose2(*T))
    for i, p in enumerate(start.points):
        values.insert(robots + i, p)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    for k, m in enumerate(maps):
        keys = [k, *(robots + place[name] for name in m.ids)]
        z = m.mean.ravel()

        def error(_, values, H, keys=keys, z=z):
            T = values.atPose2(keys[0])
            c, s = np.cos(T.theta()), np.sin(T.theta())
            d = np.array([values.atPoint2(key) for key in keys[1:]]) - [T.x(), T.y()]
            local = d @ np.array([[c, -s], [s, c]])
            if H is not None:
                J = np.zeros((len(z), 3), order="F")
                J[0::2, 0] = J[1::2, 1] = -1.0
                J[0::2, 2], J[1::2, 2] = local[:, 1], -local[:, 0]
                H[0] = J
                for i in range(len(keys) - 1):
                    P = np.zeros((len(z), 2), order="F")
                    P[2 * i], P[2 * i + 1] = (c, s), (-s, c)
                    H[i + 1] = P
            return local.ravel() - z

        graph.add(gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(m.cov), keys, error))
    optimiser = gtsam.GaussNewtonOptimizer(graph, values, gtsam.GaussNewtonParams())
    tic = time.process_time()
    for _ in range(steps):
        optimiser.iterate()
    seconds = time.process_time() - tic
    found = optimiser.values()
    off = np.array([found.atPoint2(robots + i) for i in range(len(start.ids))]) - true
    return {"step_s": seconds / steps, "rmse_m": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), "steps": steps}


def dense_rls(maps, start, updates):
    """Seconds of one pass of the dense recursive filter over all maps, from the first `updates` of them."""
    place = {name: i for i, name in enumerate(start.ids)}
    robots, n = len(maps), 3 * len(maps) + 2 * len(start.ids)
    P = np.eye(n)
    seconds = 0.0
    for k, m in enumerate(maps[:updates]):
        rows = np.array([place[name] for name in m.ids])
        columns = np.concatenate([3 * k + np.arange(3), 3 * robots + (2 * rows[:, None] + np.arange(2)).ravel()])
        H = np.random.default_rng(k).normal(size=(2 * len(rows), len(columns)))
        tic = time.process_time()
        PHt = P[:, columns] @ H.T
        S = H @ PHt[columns] + m.cov
        K = np.linalg.solve(S, PHt.T).T
        P -= K @ PHt.T
        seconds += time.process_time() - tic
    return seconds / updates * robots


def one(robots, *, gtsam):
    """All figures for one size; runs in a process of its own, so that the peak of memory is its own."""
    maps, start, true = world(robots)
    before = peak_mb()
    row = {"robots": robots, "landmarks": len(start.ids), "seen_a_robot": float(np.mean([len(m) for m in maps]))}
    row["mapweave"] = ours(maps, start, true)
    row["mapweave"]["peak_mb_over_start"] = peak_mb() - before
    if 3 * robots + 2 * len(start.ids) < 15_000:
        row["dense_rls_pass_s"] = dense_rls(maps, start, min(robots, 3))
        row["rls_over_step"] = row["dense_rls_pass_s"] / row["mapweave"]["step_s"]
    if gtsam:
        row["gtsam"] = with_gtsam(maps, start, true, STEPS if robots <= 50 else 1)
        row["gtsam_over_step"] = row["gtsam"]["step_s"] / row["mapweave"]["step_s"]
    return row


def peak_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def machine():
    names = ("numpy", "scipy", "gtsam", "mapweave")
    versions = {}
    for name in names:
        try:
            versions[name] = version(name)
        except ImportError:
            versions[name] = None
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "python": platform.python_version(),
        **versions,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="5,50,500")
    parser.add_argument("--no-gtsam", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one is not None:
        print(json.dumps(one(args.one, gtsam=not args.no_gtsam)))
        return
    rows = []
    print(json.dumps(machine()))
    print("| robots | landmarks | a step | factor | GTSAM's step | dense RLS, one pass | RMSE | of GTSAM |")
    print("|---|---|---|---|---|---|---|---|")
    for robots in map(int, args.robots.split(",")):
        command = [sys.executable, __file__, "--one", str(robots), *(["--no-gtsam"] if args.no_gtsam else [])]
        row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        rows.append(row)
        m, g = row["mapweave"], row.get("gtsam", {})
        cells = [
            f"{robots}",
            f"{row['landmarks']:,}",
            f"{m['step_s']:.2f} s",
            f"{m['factor_mb']:.0f} MB",
            beside(g.get("step_s"), row.get("gtsam_over_step")),
            beside(row.get("dense_rls_pass_s"), row.get("rls_over_step")),
            f"{m['rmse_m']:.3f} m",
            f"{g['rmse_m']:.3f} m" if g else "",
        ]
        print(f"| {' | '.join(cells)} |", flush=True)
    if args.json:
        args.json.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n", encoding="utf-8")


def beside(seconds, times):
    """A rival's seconds, and how many times a step of ours that is."""
    return "" if seconds is None else f"{seconds:.1f} s ({times:.0f} times)"


if __name__ == "__main__":
    main()
