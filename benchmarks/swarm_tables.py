"""The documentation's tables of simulated swarms, one at a time and in Markdown.

    OMP_NUM_THREADS=1 python benchmarks/swarm_tables.py accuracy|attitudes|cost|grid|messages [--draws N]

accuracy: 1,000 robots, anchors at the corners and next to each other. cost: seconds of large swarms and of other
solvers. grid: RMSE over the bound in the plane and in space, a new layout each draw. messages: what robots send each
other in belief propagation. attitudes: robots in space without common axes, with 10 % of sightings wrong too.
Seconds are those of the processor.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapweave.core.gaussian import chi2_quantile
from mapweave.papers.hamatani.experiments import right
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from swarm import accuracy, curve, guess, huge, large, network, rivals

GRID = (  # name, scene, anchors next to each other
    *((f"1,000, {name}", SwarmScene(robots=1000, dim=dim), False) for name, dim in (("plane", 2), ("space", 3))),
    ("1,000, space, uniform", SwarmScene(robots=1000, dim=3, layout="random"), False),
    ("1,000, plane, 40 % lost", SwarmScene(robots=1000, missing=0.4), False),
    ("1,000, space, 40 % lost", SwarmScene(robots=1000, dim=3, missing=0.4), False),
    ("1,000, plane, weak anchors", SwarmScene(robots=1000), True),
)
DEGREES = {"1,000, plane": (0.5, 2.0, 5.0), "1,000, space": (0.5, 2.0, 5.0), "1,000, space, uniform": (2.0,)}
DEGREES["1,000, plane, weak anchors"] = (0.5, 5.0)
TALKING = ((25, 2), (100, 2), (64, 3), (400, 2))  # robots, dimensions


@dataclass(frozen=True, slots=True)
class Draw:
    """One located swarm against the bound at the truth: sums over the robots that both have."""

    square: float
    bound: float
    nees: float
    iterations: int
    failed: bool


def drawn(scene: SwarmScene, seed: int, *, weak: bool) -> Draw:
    swarm = simulate_swarm(scene, np.random.default_rng([11, seed]))
    truth = swarm.position[0]
    near = np.argsort(np.linalg.norm(truth - truth[0], axis=1))[:2]
    net = network(swarm, tuple(near.tolist()) if weak else swarm.corners)
    found, best = locate(net), locate(net, SwarmConfig(max_iterations=0), truth)
    both = found.localisable & ~found.anchor & best.localisable
    value, dof = found.nees(truth)
    return Draw(
        float(np.square(found.position - truth)[both].sum(axis=1).mean()),
        float(np.trace(np.asarray(best.cov)[both], axis1=1, axis2=2).mean()),
        value / dof,
        found.iterations,
        str(found.status) != "converged",
    )


def print_grid(draws: int) -> None:
    print("| robots | σ [deg] | RMSE / bound | NEES per dof | most iterations | failed |\n|---|---|---|---|---|---|")
    for name, scene, weak in GRID:
        for degrees in DEGREES.get(name, (0.5,)):
            what = replace(scene, sigma=float(np.radians(degrees)))
            runs = [drawn(what, k, weak=weak) for k in range(draws)]
            ratio = np.sqrt(sum(r.square for r in runs) / sum(r.bound for r in runs))
            nees, most = np.mean([r.nees for r in runs]), max(r.iterations for r in runs)
            failed = sum(r.failed for r in runs)
            print(f"| {name} | {degrees:g} | {ratio:.3f} | {nees:.3f} | {most} | {failed} |", flush=True)


def print_accuracy(draws: int) -> None:
    print("| anchors | sigma | RMSE / bound | NEES / dof | iterations, at most | failed | called weak |")
    print("|---|---|---|---|---|---|---|")
    for row in sorted(accuracy(draws), key=lambda r: r["anchors"]):
        cells = (
            row["anchors"],
            f"{row['sigma_deg']:g}°",
            f"{row['rmse_over_crlb']:.3f}",
            f"{row['nees_per_dof']:.3f}",
            row["iterations_most"],
            row["failed"],
            row["called_weak"],
        )
        print(f"| {' | '.join(map(str, cells))} |")


@dataclass(frozen=True, slots=True)
class AttitudeDraw:
    """One located swarm: sums of squared error and of the bound [m^2] over the robots that both have.

    nees: per degree of freedom; wrong: as `swarm_trust.py` counts it; trusted: what the result says of itself.
    """

    square: float
    bound: float
    nees: float
    wrong: bool
    trusted: bool


def attitude_draw(scene: SwarmScene, seed: int) -> AttitudeDraw | None:
    """Against the bound of the sightings that are right, at the true places. None where nobody is located."""
    swarm = simulate_swarm(scene, np.random.default_rng([13, seed]))
    truth = swarm.position[0]
    net = network(swarm, swarm.corners if scene.robots > 8 else (0, 1, 2))
    found = locate(net, SwarmConfig(method="robust" if scene.outliers else "batch"))
    if found.information is None or found.gauge or not (found.localisable & ~found.anchor).any():
        return None
    best = locate(net.select(right(net, swarm)), SwarmConfig(max_iterations=0), truth)
    both = found.localisable & ~found.anchor & best.localisable
    value, dof = found.nees(truth)
    square = float(np.square(found.position - truth)[both].sum())
    bound = float(np.trace(np.asarray(best.cov)[both], axis1=1, axis2=2).sum())
    wrong = value > 2 * chi2_quantile(0.999, float(dof)) or square > 9 * bound
    return AttitudeDraw(square, bound, value / dof, bool(wrong), found.reliable)


def over_bound(runs: Sequence[AttitudeDraw]) -> str:
    """Root mean square error over the bound, and the mean NEES with its standard error."""
    nees = np.array([r.nees for r in runs])
    ratio = np.sqrt(sum(r.square for r in runs) / sum(r.bound for r in runs))
    return f"{ratio:.3f} | {nees.mean():.3f} ± {nees.std() / np.sqrt(len(nees)):.3f}"


def print_attitudes(draws: int) -> None:
    print("| robots | sightings | wrong | located | RMSE / bound | NEES per dof | trusted | RMSE / bound ", end="")
    print("| NEES per dof | trusted, wrong | not trusted, right |\n|---|---|---|---|---|---|---|---|---|---|---|")
    for robots in (5, 27, 125, 1000):
        many = draws if robots >= 1000 else draws * (10 if robots < 100 else 3)
        for seen in ("directed", "mutual"):
            for wrong in (0.0, 0.1):
                sigma = float(np.radians(0.5))
                scene = SwarmScene(robots=robots, dim=3, axis=False, sigma=sigma, visibility=seen, outliers=wrong)
                runs = [one for one in (attitude_draw(scene, k) for k in range(many)) if one is not None]
                trusted = [one for one in runs if one.trusted]
                verdicts = f"{sum(r.wrong for r in trusted)} | {sum(not (r.trusted or r.wrong) for r in runs)}"
                cells = (
                    f"{len(runs)} of {many} | {over_bound(runs)} | {len(trusted)} | {over_bound(trusted)} | {verdicts}"
                )
                print(f"| {robots:,} | {seen} | {100 * wrong:.0f} % | {cells} |", flush=True)


def print_cost(_: int) -> None:
    flat, space = large()
    many, rival, wrong, exponent = huge(), rivals(), guess(), curve()["exponent"]
    lost = wrong["failures"]
    start, bare = rival["ours_positions_s"] - rival["ours_refinement_s"], "without the linear start"
    rows = {
        "N = 10,000, with covariances, 0.5°": f"2D {flat['seconds']:.1f} s, NEES / dof {flat['nees_per_dof']:.3f}; "
        f"3D {space['seconds']:.1f} s, {space['nees_per_dof']:.3f}",
        "N = 100,000 in 2D, positions": f"{many['seconds']:.0f} s, {many['peak_gib']:.1f} GiB",
        "N = 1,000 against one dense EKF update": f"{rival['ours_s']:.2f} s against {rival['dense_ekf_s']:.0f} s: "
        f"{rival['times_faster_than_dense_ekf']:.0f} times faster",
        "N = 1,000 against GTSAM's bearing factors, from the same start": "refinement "
        f"{rival['refinement_times_faster_than_gtsam']:.1f} times faster, with all covariances "
        f"{rival['with_covariances_times_faster_than_gtsam']:.1f} times; the start, which GTSAM is given, takes "
        f"{start:.2f} s",
        f"five robots, two known, from the paper's worst guess, {wrong['runs']} runs": "failures: "
        f"{lost['five robots, linear start']}; {bare} {lost['five robots, LM from the guess itself']}",
        f"100 robots from as bad a guess, {wrong['runs']} runs": f"failures: {lost['100 robots, linear start']}; "
        f"{bare} {lost['100 robots, LM from the guess itself']}",
        "cost against N, from 1,000 to 30,000": f"exponent {exponent['seconds']:.1f} with covariances, "
        f"{exponent['positions_only']:.1f} without",
    }
    print("| | |\n|---|---|")
    for name, value in rows.items():
        print(f"| {name} | {value} |")


def print_messages(_: int) -> None:
    print("| robots | rounds | messages | MB | largest difference from `batch` |\n|---|---|---|---|---|")
    for robots, dim in TALKING:
        swarm = simulate_swarm(SwarmScene(robots=robots, dim=dim), np.random.default_rng(robots))
        net = network(swarm, swarm.corners)
        batch, told = locate(net), locate(net, SwarmConfig(method="distributed"))
        free = ~batch.anchor & batch.localisable
        sd = np.sqrt(np.trace(np.asarray(batch.cov)[free], axis1=1, axis2=2))
        off = float((np.linalg.norm(told.position - batch.position, axis=1)[free] / sd).max())
        sent = told.traffic
        cells = (f"{robots:,}, {'space' if dim == 3 else 'plane'}", f"{sent.rounds:,}", f"{sent.messages:,}")
        print(f"| {' | '.join(cells)} | {sent.bytes / 1e6:,.1f} | {off:.4f} standard deviations |", flush=True)


TABLES: dict[str, Callable[[int], None]] = {
    "accuracy": print_accuracy,
    "attitudes": print_attitudes,
    "cost": print_cost,
    "grid": print_grid,
    "messages": print_messages,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("--draws", type=int, default=30)
    args = parser.parse_args()
    TABLES[args.table](args.draws)


if __name__ == "__main__":
    main()
