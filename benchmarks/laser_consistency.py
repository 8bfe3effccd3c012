"""Whether the graph method's poses are as sure as it says: squared error of every keyframe over its covariance.

    python benchmarks/laser_consistency.py [--runs N] [--seed S] [--worlds office,corridor,tunnel]

NEES per degree of freedom of all keyframes of a run, seen from the first: 1 when covariances are right; goal 0.5 to 2
in the mean over 20 offices. Beside it position errors at the end and on the whole way [m], and closures believed that
err by over 0.5 m.
"""

import argparse

import numpy as np

from mapweave.core import se2
from mapweave.laser.closures import Closure
from mapweave.laser.config import LaserConfig
from mapweave.laser.mapping import map_laser
from mapweave.sim.corridor import simulate_corridor
from mapweave.sim.office import simulate_office
from mapweave.sim.tunnel import simulate_tunnel

WORLDS = {"office": simulate_office, "corridor": simulate_corridor, "tunnel": simulate_tunnel}
FALSE = 0.5  # [m]


def at_stamps(t: np.ndarray, stamps: np.ndarray, pose: np.ndarray) -> np.ndarray:
    columns = (pose[:, 0], pose[:, 1], np.unwrap(pose[:, 2]))
    return np.column_stack([np.interp(t, stamps, column) for column in columns])


def false(closure: Closure, truth: np.ndarray) -> bool:
    e = se2.between(se2.between(truth[closure.first], truth[closure.second]), closure.measured)
    return bool(np.hypot(*e[:2]) > FALSE)


def run(world: str, seed: int) -> tuple[float, float, float, int, int]:
    """(NEES per degree of freedom, end error, RMS error, closures believed, of them false)."""
    sim = WORLDS[world](seed=seed)
    graph = map_laser(sim.log, LaserConfig(method="graph"), 0).graph
    assert graph is not None  # noqa: S101  (the graph method makes one)
    truth = at_stamps(graph.t, sim.truth.t, sim.truth.pose)
    ours, true = se2.between(graph.pose[0], graph.pose), se2.between(truth[0], truth)
    e = ours - true
    e[:, 2] = se2.wrap_angle(e[:, 2])
    cov = se2.turned_covariance(-graph.pose[0, 2], graph.cov)
    squares = np.einsum("ni,nij,nj->n", e, np.linalg.inv(cov), e)[1:]
    off = np.hypot(e[:, 0], e[:, 1])
    held = [c for c in graph.closures if c.accepted]
    wrong = sum(false(c, truth) for c in held)
    return float(squares.mean() / 3.0), float(off[-1]), float(np.sqrt(np.mean(off**2))), len(held), wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worlds", default="office")
    asked = parser.parse_args()
    for world in asked.worlds.split(","):
        rows = []
        for seed in range(asked.seed, asked.seed + asked.runs):
            rows.append(run(world, seed))
            nees, end, rms, held, wrong = rows[-1]
            print(
                f"{world:8s} {seed:4d} NEES {nees:5.2f} end {end:.3f} RMS {rms:.3f} closures {held} false {wrong}",
                flush=True,
            )
        nees = np.array([row[0] for row in rows])
        inside = int(((nees >= 0.5) & (nees <= 2.0)).sum())
        print(
            f"{world}: mean NEES {nees.mean():.2f}, median {np.median(nees):.2f}, in [0.5, 2]: {inside} of {len(rows)}"
        )


if __name__ == "__main__":
    main()
