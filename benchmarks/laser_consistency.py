"""Whether the graph method's poses are as sure as it says: squared error of every keyframe over its covariance.

    python benchmarks/laser_consistency.py [--runs N] [--seed S] [--worlds office,corridor,tunnel,pairs]

NEES per degree of freedom of all keyframes of a run, seen from the first: 1 when covariances are right; goal 0.5 to 2
in the mean over 20 offices. Beside it position errors at the end and on the whole way [m], and closures believed that
err by over 0.5 m.

`pairs`: two robots in one office, each on its own way, woven from near starts: NEES of all keyframes seen from the
first of the first robot, of each robot alone, and of keyframes of the second robot seen from keyframes of the first.
"""

import argparse
from dataclasses import replace

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.laser.closures import Closure
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.mapping.merge_search import Start
from mapweave.mapping.weave import weave
from mapweave.mapping.woven_map import woven_maps
from mapweave.sim.laser import drive
from mapweave.sim.laser_worlds import (
    OfficeConfig,
    office_route,
    office_world,
    simulate_corridor,
    simulate_office,
    simulate_tunnel,
)

WORLDS = {"office": simulate_office, "corridor": simulate_corridor, "tunnel": simulate_tunnel}
FALSE = 0.5  # [m]
OFFICE = OfficeConfig(rooms=3, visited=4)  # of two robots


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


def nees(e: np.ndarray, cov: np.ndarray) -> float:
    """Per degree of freedom."""
    e = np.column_stack([e[:, :2], se2.wrap_angle(e[:, 2])])
    return float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(cov), e).mean() / 3.0)


def pair(seed: int) -> tuple[float, float, float, float, float]:
    """(NEES of the woven keyframes, of the robots alone, between robots, RMS error [m] woven, second alone)."""
    cfg = LaserConfig(method="graph")
    maps, truths = [], []
    world = office_world(OFFICE, seed)
    for k in range(2):
        sim = drive(world, office_route(OFFICE, seed + 1000 * k), OFFICE.drive, seed + 1000 * k)
        dark = tuple(replace(scan, intensities=None) for scan in sim.log.scans)
        made = map_laser(replace(sim.log, scans=dark, robot=str(k + 1)), cfg, 0)
        assert made.graph is not None  # noqa: S101  (the graph method makes one)
        maps.append(made)
        truths.append(at_stamps(made.graph.t, sim.truth.t, sim.truth.pose))
    graphs = [m.graph for m in maps if m.graph is not None]
    alone = []
    for g, truth in zip(graphs, truths, strict=True):
        e = se2.between(g.pose[0], g.pose) - se2.between(truth[0], truth)
        alone.append(nees(e[1:], se2.turned_covariance(-g.pose[0, 2], g.cov)[1:]))
    said = se2.compose(se2.between(truths[0][0], truths[1][0]), np.array([0.2, -0.2, 0.03]))
    woven = weave(graphs, cfg.merge, {1: Start(said, np.array([0.5, 0.5, 0.1]))}, last=cfg.graph.joint)
    made, *more = woven_maps(maps, woven, cfg.resolution, cfg.graph.unsure)
    if more:
        raise SystemExit(f"pairs {seed}: {woven.merges[0].reason}")
    t, pose, home = made.t, made.graph.pose, made.graph.pose[0]
    n = len(graphs[0])
    cov = np.concatenate([_at(made.tracks["1"], t[:n]), _at(made.tracks["2"], t[n:])])
    e = se2.between(home, pose) - se2.between(truths[0][0], np.concatenate(truths))
    joint = nees(e[1:], se2.turned_covariance(-home[2], cov)[1:])
    first = np.repeat(np.arange(0, n, 12), len(graphs[1]) // 12)
    second = n + np.resize(np.arange(0, len(graphs[1]) // 12 * 12, 12), len(first))
    true = np.concatenate(truths)
    between = se2.between(pose[first], pose[second]) - se2.between(true[first], true[second])
    jitter = graphs[0].cov[0] + graphs[1].cov[0]
    spread = cfg.graph.unsure * woven.joint.relative_covariances(first, second) + jitter
    off = np.sqrt(np.mean(np.square(e[:, :2]).sum(axis=1)))
    own = se2.between(graphs[1].pose[0], graphs[1].pose) - se2.between(truths[1][0], truths[1])
    return joint, float(np.mean(alone)), nees(between, spread), float(off), float(np.sqrt(np.mean(own[:, :2] ** 2) * 2))


def _at(track: Track, stamps: np.ndarray) -> np.ndarray:
    assert track.cov is not None  # noqa: S101  (the graph method tells them)
    return np.asarray(track.cov[np.searchsorted(track.t, stamps - 1e-9)])


def pairs(seeds: range) -> None:
    rows = []
    for seed in seeds:
        rows.append(pair(seed))
        woven, alone, between, off, own = rows[-1]
        print(
            f"pairs    {seed:4d} NEES woven {woven:5.2f} alone {alone:5.2f} between robots {between:5.2f} "
            f"RMS woven {off:.3f} second alone {own:.3f}",
            flush=True,
        )
    mean = np.mean(rows, axis=0)
    least, most = np.min(rows, axis=0), np.max(rows, axis=0)
    print("| NEES per degree of freedom | mean | least | largest |")
    print("|---|---|---|---|")
    for k, name in enumerate(("in the common frame", "a single log", "between robots")):
        print(f"| {name} | {mean[k]:.2f} | {least[k]:.2f} | {most[k]:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worlds", default="office")
    asked = parser.parse_args()
    for world in asked.worlds.split(","):
        if world == "pairs":
            pairs(range(asked.seed, asked.seed + asked.runs))
            continue
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
