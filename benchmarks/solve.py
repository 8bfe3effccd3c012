"""Public pose graphs solved here and by GTSAM's batch, in one run: CPU seconds and the optimum's chi-square.

    MAPWEAVE_DATA=.. python benchmarks/solve.py

GTSAM measures an edge's residual by its logarithm, mapweave by x, y and theta; the tests compare both optima in one
convention. False closures: with --robust and 10, 30 and 60 % that chance adds (seed 20), what the true edges cost at
the solution over what they cost without false ones. The last row: the same of intel with other seeds, the dearest.
"""

import os
from dataclasses import replace
from pathlib import Path
from time import process_time

import gtsam
import numpy as np

from mapweave.core import se2
from mapweave.io.g2o import read_g2o
from mapweave.laser.pose_graph import PoseGraph
from mapweave.laser.robust_graph import RobustGraphConfig, solve_graph

SEED, OTHERS = 20, (7, 8, 9, 21, 22)
PLAIN = RobustGraphConfig(method="none")


def squares(graph: PoseGraph) -> float:
    r = se2.between(graph.measured, se2.between(graph.pose[graph.first], graph.pose[graph.second]))
    return float(np.einsum("mi,mij,mj->", r, graph.information, r))


def theirs(graph: PoseGraph) -> float:
    """CPU seconds of GTSAM's Gauss-Newton from the same start."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.pose.tolist()):
        values.insert(k, gtsam.Pose2(*pose))
    for i, j, z, I in zip(graph.first.tolist(), graph.second.tolist(), graph.measured, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(I)
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*z.tolist()), noise))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*graph.pose[0].tolist())))
    cpu = process_time()
    gtsam.GaussNewtonOptimizer(factors, values).optimize()
    return process_time() - cpu


def with_false(graph: PoseGraph, share: float, seed: int) -> PoseGraph:
    """False closures beside the true ones, `share` of their number."""
    rng, n = np.random.default_rng(seed), len(graph)
    count = round(share * int((np.abs(graph.second - graph.first) != 1).sum()))
    first = rng.integers(0, n, count)
    second = (first + rng.integers(2, n - 2, count)) % n
    z = np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.uniform(-3, 3, count)])
    information = np.repeat(np.median(graph.information, axis=0)[None], count, 0)
    return graph.joined(PoseGraph(graph.pose, first, second, z, information))


def robust(graph: PoseGraph, chi2: float, share: float, seed: int) -> tuple[float, str]:
    """What the true edges cost at the robust solution with false ones, over `chi2`; the same as a cell."""
    solved = solve_graph(with_false(graph, share, seed))
    kept, lost = int(solved.used[graph.edges :].sum()), int((~solved.used[: graph.edges]).sum())
    ratio = squares(replace(graph, pose=solved.graph.pose)) / chi2
    return ratio, f"{ratio:.4f} ({kept} kept, {lost} true ones dropped)"


def main() -> None:
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "g2o"
    shares = (0.1, 0.3, 0.6)
    tried = " | ".join(f"{share:.0%} false closures" for share in shares)
    print(f"| graph | poses | edges | chi-square | CPU [s] | GTSAM's CPU [s] | {tried} |")
    print(f"|---|---|---|---|---|---{'|---' * len(shares)}|")
    for name in ("intel", "CSAIL", "manhattan"):
        graph = read_g2o(folder / f"{name}.g2o.gz")
        solve_graph(graph, PLAIN)  # compiles
        cpu = process_time()
        clean = solve_graph(graph, PLAIN)
        cpu = process_time() - cpu
        cells = [name, len(graph), graph.edges, f"{clean.chi2:.6f}", f"{cpu:.3f}", f"{theirs(graph):.3f}"]
        cells += [robust(graph, clean.chi2, share, SEED)[1] for share in shares if name != "manhattan"]
        cells += ["not tried"] * (6 + len(shares) - len(cells))
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
    graph = read_g2o(folder / "intel.g2o.gz")
    chi2 = solve_graph(graph, PLAIN).chi2
    dearest = [max(robust(graph, chi2, share, seed) for seed in OTHERS)[1] for share in shares]
    print(f"| intel, seeds {', '.join(map(str, OTHERS))} | | | | | | {' | '.join(dearest)} |")


if __name__ == "__main__":
    main()
