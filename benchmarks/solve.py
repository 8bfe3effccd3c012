"""Public pose graphs solved here and by GTSAM's batch, in one run: CPU seconds, wall seconds, and the optimum.

    MAPWEAVE_DATA=.. python benchmarks/solve.py

GTSAM measures an edge's residual by its logarithm, mapweave by x, y and theta; each cost is in its own convention, and
the tests compare both optima in one. False closures: what --robust keeps of 10, 30 and 60 % that chance adds.
"""

import os
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import gtsam
import numpy as np

from mapweave.core import se2
from mapweave.io.g2o import read_g2o
from mapweave.laser.pose_graph import PoseGraph
from mapweave.laser.robust_graph import RobustGraphConfig, solve_graph

PLAIN = RobustGraphConfig(method="none")


def squares(graph: PoseGraph) -> float:
    r = se2.between(graph.measured, se2.between(graph.pose[graph.first], graph.pose[graph.second]))
    return float(np.einsum("mi,mij,mj->", r, graph.information, r))


def theirs(graph: PoseGraph) -> tuple[float, float, float]:
    """Cost, CPU and wall seconds of GTSAM's Gauss-Newton from the same start."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.pose.tolist()):
        values.insert(k, gtsam.Pose2(*pose))
    for i, j, z, I in zip(graph.first.tolist(), graph.second.tolist(), graph.measured, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(I)
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*z.tolist()), noise))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*graph.pose[0].tolist())))
    cpu, wall = process_time(), perf_counter()
    end = gtsam.GaussNewtonOptimizer(factors, values).optimize()
    return 2 * factors.error(end), process_time() - cpu, perf_counter() - wall


def with_false(graph: PoseGraph, share: float, seed: int) -> PoseGraph:
    """False closures beside the true ones, `share` of their number."""
    rng, n = np.random.default_rng(seed), len(graph)
    count = round(share * int((np.abs(graph.second - graph.first) != 1).sum()))
    first = rng.integers(0, n, count)
    second = (first + rng.integers(2, n - 2, count)) % n
    z = np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.uniform(-3, 3, count)])
    information = np.repeat(np.median(graph.information, axis=0)[None], count, 0)
    return graph.joined(PoseGraph(graph.pose, first, second, z, information))


def main() -> None:
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "g2o"
    for name in ("intel", "CSAIL", "manhattan"):
        graph = read_g2o(folder / f"{name}.g2o.gz")
        solve_graph(graph, PLAIN)  # compiles
        cpu, wall = process_time(), perf_counter()
        clean = solve_graph(graph, PLAIN)
        cpu, wall = process_time() - cpu, perf_counter() - wall
        cost, their_cpu, their_wall = theirs(graph)
        print(f"{name}: {len(graph)} poses, {graph.edges} edges")
        print(f"  mapweave chi2 {clean.chi2:.6f}  {cpu:.3f} s CPU {wall:.3f} s, {clean.iterations} iterations")
        print(f"  gtsam    chi2 {cost:.6f}  {their_cpu:.3f} s CPU {their_wall:.3f} s")
        for share in (0.1, 0.3, 0.6) if name != "manhattan" else ():
            bad = with_false(graph, share, 20)
            solved = solve_graph(bad)
            kept, lost = int(solved.used[graph.edges :].sum()), int((~solved.used[: graph.edges]).sum())
            ratio = squares(replace(graph, pose=solved.graph.pose)) / clean.chi2
            print(
                f"  {share:.0%} false: {kept} kept, {lost} true ones dropped, cost of true edges {ratio:.4f} of clean"
            )


if __name__ == "__main__":
    main()
