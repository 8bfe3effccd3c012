"""Bearing-only location of a swarm: accuracy against its bound, honesty, cost, and two rivals in the same run.

`python benchmarks/swarm.py [--json FILE] [--only accuracy,guess,large,huge,rivals,curve] [--draws 30]`
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from mapweave import __version__
from mapweave.sim.swarm import Swarm, SwarmScene, observe, simulate_swarm
from mapweave.swarm import bearing
from mapweave.swarm.batch import refine
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork
from mapweave.swarm.start import prepare


def network(swarm: Swarm, known: tuple[int, ...]) -> BearingNetwork:
    table = swarm.table
    z = table.bearing() if table.dim == 2 else table.direction
    anchors = {k: swarm.position[0][k] for k in known}
    return BearingNetwork(table.ids, table.dim, table.observer, table.target, z, table.sigma, anchors, axis=table.axis)


def scene(n: int, dim: int = 2, degrees: float = 0.5) -> SwarmScene:
    return SwarmScene(robots=n, dim=dim, sigma=float(np.radians(degrees)))


def drawn(swarm: Swarm, net: BearingNetwork, what: SwarmScene, rng: np.random.Generator) -> BearingNetwork:
    """The same robots and sightings with fresh noise."""
    pairs = np.column_stack([net.observer, net.target])
    u = observe(swarm.position[0], swarm.heading[0], pairs, what, rng)
    return replace(net, bearing=np.arctan2(u[:, 1], u[:, 0]) if net.dim == 2 else u)


def accuracy(draws: int) -> list[dict]:
    """N = 1,000: root mean squared error over the bound and NEES, anchors at the corners and two neighbours."""
    rows = []
    for degrees in (0.5, 2.0, 5.0):
        what = scene(1000, degrees=degrees)
        swarm = simulate_swarm(what, np.random.default_rng(1))
        truth = swarm.position[0]
        for name, known in (("four corners", swarm.corners), ("two neighbours", (0, 1))):
            net = network(swarm, known)
            bound = locate(net, SwarmConfig(max_iterations=0), truth)
            free = ~bound.anchor
            trace = float(np.trace(bound.cov[free], axis1=1, axis2=2).mean())
            squares, nees, iterations, failed, weak = [], [], [], 0, 0
            for k in range(draws):
                e = locate(drawn(swarm, net, what, np.random.default_rng([7, k])))
                failed += str(e.status) != "converged"
                weak += e.weak_anchors
                iterations.append(e.iterations)
                squares.append(np.mean(np.sum((e.position - truth)[free] ** 2, axis=1)))
                value, dof = e.nees(truth)
                nees.append(value / dof)
            rows.append(
                {
                    "anchors": name,
                    "sigma_deg": degrees,
                    "rmse_over_crlb": float(np.sqrt(np.mean(squares) / trace)),
                    "nees_per_dof": float(np.mean(nees)),
                    "iterations_most": max(iterations),
                    "failed": failed,
                    "called_weak": weak,
                    "draws": draws,
                }
            )
    return rows


def guess(runs: int = 100) -> dict:
    """The paper's worst guess (25 m^2 a coordinate) on its five robots and on 100: what it does to the answer."""
    out = {}
    five = np.array([[0, 0], [10, 0], [20, 0], [5, 75**0.5], [15, 75**0.5]])
    for name in ("five robots", "100 robots"):
        failed = 0
        for k in range(runs):
            rng = np.random.default_rng([3, k])
            what = scene(100, degrees=0.1)
            if name == "five robots":
                pairs = np.array([(i, j) for i in range(5) for j in range(5) if i != j])
                d = five[pairs[:, 1]] - five[pairs[:, 0]]
                z = np.arctan2(d[:, 1], d[:, 0]) + what.sigma * rng.standard_normal(len(pairs))
                sigma = np.full(len(pairs), what.sigma)
                anchors = {0: five[0], 1: five[1]}
                net = BearingNetwork(tuple("12345"), 2, pairs[:, 0], pairs[:, 1], z, sigma, anchors)
                truth = five
            else:
                swarm = simulate_swarm(what, rng)
                net, truth = network(swarm, swarm.corners), swarm.position[0]
            start = truth + 5.0 * rng.standard_normal(truth.shape)
            e = locate(net, SwarmConfig(), start)  # the guess is only used where it is asked for
            again = locate(net)
            off = max(np.abs(x.position - truth).max() for x in (again,))
            failed += off > 1.0 or not again.reliable
            out.setdefault(f"{name}, LM from the guess itself", 0)
            out[f"{name}, LM from the guess itself"] += np.abs(e.position - truth).max() > 1.0
        out[f"{name}, linear start"] = failed
    return {"runs": runs, "failures": {k: int(v) for k, v in out.items()}}


def large() -> list[dict]:
    """N = 10,000 with all covariances."""
    rows = []
    for dim in (2, 3):
        swarm = simulate_swarm(scene(10_000, dim), np.random.default_rng(2))
        net = network(swarm, swarm.corners)
        begun = time.process_time()
        e = locate(net)
        took = time.process_time() - begun
        value, dof = e.nees(swarm.position[0])
        rows.append(
            {"dim": dim, "robots": 10_000, "seconds": took, "nees_per_dof": value / dof, "iterations": e.iterations}
        )
    return rows


def huge_child() -> None:
    swarm = simulate_swarm(scene(100_000), np.random.default_rng(2))
    net = network(swarm, swarm.corners)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = time.process_time()
    e = locate(net, SwarmConfig(covariance=False))
    took = time.process_time() - begun
    error = e.position - swarm.position[0]
    print(
        json.dumps(
            {
                "robots": 100_000,
                "seconds": took,
                "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
                "before_gib": before / 2**20,
                "rmse": float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
                "iterations": e.iterations,
            }
        )
    )


def huge() -> dict:
    """N = 100,000, positions only, in a process of its own so that its memory is its own."""
    run = subprocess.run([sys.executable, __file__, "--child"], capture_output=True, text=True, check=True)
    return json.loads(run.stdout.splitlines()[-1])


def rivals() -> dict:
    """N = 1,000: one dense EKF update and GTSAM's bearing factors, on the same sightings."""
    swarm = simulate_swarm(scene(1000), np.random.default_rng(4))
    net, truth = network(swarm, swarm.corners), swarm.position[0]
    locate(net)  # compiled before it is timed
    ours = min(_timed(lambda: locate(net)) for _ in range(3))
    positions = min(_timed(lambda: locate(net, SwarmConfig(covariance=False))) for _ in range(3))
    out = {"ours_s": ours, "ours_positions_s": positions}
    out["dense_ekf_s"] = _dense_update(net, truth + np.random.default_rng(0).standard_normal(truth.shape))
    out["times_faster_than_dense_ekf"] = out["dense_ekf_s"] / ours
    begun = prepare(net)
    pattern = refine(net, begun, SwarmConfig())[2]
    out["ours_refinement_s"] = min(_timed(lambda: refine(net, begun, SwarmConfig(), pattern=pattern)) for _ in range(3))
    runs = [_gtsam(net, begun.position, locate(net).position) for _ in range(3)]
    out.update(min(runs, key=lambda run: run["gtsam_positions_s"]))
    out["refinement_times_faster_than_gtsam"] = out["gtsam_positions_s"] / out["ours_refinement_s"]
    out["with_covariances_times_faster_than_gtsam"] = out["gtsam_with_covariances_s"] / ours
    return out


def _timed(run) -> float:
    begun = time.process_time()
    run()
    return time.process_time() - begun


def _dense_update(net: BearingNetwork, x: np.ndarray) -> float:
    """Seconds of one update of the paper's filter with dense matrices, known robots left out of the state."""
    free = np.flatnonzero(~net.is_anchor)
    column = np.full(len(net), -1)
    column[free] = np.arange(len(free))
    m = len(net.observer)
    G = bearing.angle_jacobian(x[net.observer], x[net.target])
    H = np.zeros((m, 2 * len(free)))
    for sign, robots in ((-1.0, net.observer), (1.0, net.target)):
        rows = np.flatnonzero(column[robots] >= 0)
        for c in range(2):
            H[rows, 2 * column[robots[rows]] + c] += sign * G[rows, c]
    P = 100.0 * np.eye(2 * len(free))
    e = bearing.angle_residual(net.bearing, x[net.observer], x[net.target])
    begun = time.process_time()
    PHt = P @ H.T
    S = H @ PHt + np.diag(net.sigma**2)
    K = np.linalg.solve(S, PHt.T).T
    x[free] += (K @ e).reshape(-1, 2)
    P = P - K @ H @ P
    return time.process_time() - begun


def _gtsam(net: BearingNetwork, start: np.ndarray, answer: np.ndarray) -> dict:
    """GTSAM has bearings between poses: headings are held by a tight prior. It begins at our linear start."""
    import gtsam

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    level = gtsam.noiseModel.Isotropic.Sigma(1, 1e-6)
    for k in range(len(net)):
        values.insert(k, gtsam.Pose2(*start[k], 0.0))
        if k in net.anchors:
            held = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
            graph.add(gtsam.PriorFactorPose2(k, gtsam.Pose2(*net.anchors[k], 0.0), held))
        else:
            graph.add(gtsam.PoseRotationPrior2D(k, gtsam.Pose2(0.0, 0.0, 0.0), level))
    for i, j, z, sigma in zip(net.observer, net.target, net.bearing, net.sigma, strict=True):
        noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
        graph.add(gtsam.BearingFactorPose2(int(i), int(j), gtsam.Rot2(z), noise))
    begun = time.process_time()
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    solved = time.process_time()
    marginals = gtsam.Marginals(graph, found)
    for k in range(len(net)):
        marginals.marginalCovariance(k)
    done = time.process_time()
    p = np.array([[found.atPose2(k).x(), found.atPose2(k).y()] for k in range(len(net))])
    return {
        "gtsam": getattr(gtsam, "__version__", "4.3"),
        "gtsam_positions_s": solved - begun,
        "gtsam_with_covariances_s": done - begun,
        "gtsam_differs_by_m": float(np.abs(p - answer).max()),
    }


def curve() -> dict:
    """Seconds against N, with covariances, and the exponent of the last decade."""
    rows = []
    for n in (100, 300, 1000, 3000, 10_000, 30_000):
        swarm = simulate_swarm(scene(n), np.random.default_rng(5))
        net = network(swarm, swarm.corners)
        locate(net, SwarmConfig(covariance=False))
        full, bare = (
            _timed(lambda net=net: locate(net)),
            _timed(lambda net=net: locate(net, SwarmConfig(covariance=False))),
        )
        rows.append({"robots": n, "seconds": full, "positions_only": bare})
    big = [row for row in rows if row["robots"] >= 1000]
    slope = {
        key: float(np.polyfit(np.log([r["robots"] for r in big]), np.log([r[key] for r in big]), 1)[0])
        for key in ("seconds", "positions_only")
    }
    return {"rows": rows, "exponent": slope}


def machine() -> dict:
    return {
        "mapweave": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads": os.environ.get("OMP_NUM_THREADS", "library default"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", default="accuracy,guess,large,huge,rivals,curve")
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--child", action="store_true")
    asked = parser.parse_args()
    if asked.child:
        huge_child()
        return
    parts = {
        "accuracy": lambda: accuracy(asked.draws),
        "guess": guess,
        "large": large,
        "huge": huge,
        "rivals": rivals,
        "curve": curve,
    }
    out = {"machine": machine()}
    print("machine:", ", ".join(f"{k} {v}" for k, v in out["machine"].items()))
    for name in asked.only.split(","):
        begun = time.process_time()
        out[name] = parts[name]()
        print(f"\n{name} ({time.process_time() - begun:.0f} s)")
        found = out[name]["rows"] if name == "curve" else out[name]
        for row in found if isinstance(found, list) else [found]:
            print("  " + ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))
        if name == "curve":
            told = ", ".join(f"{k} {v:.2f}" for k, v in out[name]["exponent"].items())
            print(f"  exponent from N = 1,000 on: {told}")
        sys.stdout.flush()
    if asked.json:
        asked.json.write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
