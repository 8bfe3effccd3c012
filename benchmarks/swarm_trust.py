"""Whether a swarm's verdict can be believed: wrong answers called reliable, and right ones called unsure.

`python benchmarks/swarm_trust.py [--small] [--draws 20] [--seed 1000] [--json FILE]`

Wrong is an answer whose NEES per degree of freedom exceeds twice its 99.9 % limit, or whose root mean square error
exceeds three times the bound (of the true inliers, at the truth). The cases that trust a wrong answer or doubt a right
one are told as they come (on stderr); the table counts all of them by kind.
"""

import argparse
import itertools
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from mapweave.core.errors import DataError
from mapweave.core.gaussian import chi2_quantile
from mapweave.papers.reproduction import markdown
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.config import Method, SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork

LAYOUTS, VISIBILITIES = ("grid", "random", "clusters"), ("directed", "mutual", "single")
SEEN = {"directed": "nearest neighbours", "mutual": "from both ends", "single": "from one end"}
SMALL = (5, 8, 12)  # robots
WILD = 5.0  # standard deviations from which a sighting is an outlier


@dataclass(frozen=True, slots=True)
class Tally:
    """One case over its draws; `seeds`: those trusted and wrong."""

    case: str
    trusted_right: int = 0
    trusted_wrong: int = 0
    unsure_right: int = 0
    unsure_wrong: int = 0
    refused: int = 0
    worst: float = 0.0  # NEES per degree of freedom of what was trusted
    seeds: tuple[int, ...] = ()


def cases() -> list[tuple[str, SwarmScene, Method]]:
    """All combinations that are tried, named."""
    out: list[tuple[str, SwarmScene, Method]] = []
    for dim, layout, seen, degrees in itertools.product((2, 3), LAYOUTS, VISIBILITIES, (0.5, 2.0, 5.0)):
        scene = SwarmScene(robots=64, dim=dim, layout=layout, visibility=seen, sigma=float(np.radians(degrees)))
        out.append((f"{dim}D {layout} {seen} {degrees:g} deg", scene, "batch"))
        if degrees != 0.5:
            out.append((f"{dim}D {layout} {seen} {degrees:g} deg robust", scene, "robust"))
        out.append((f"{dim}D {layout} {seen} {degrees:g} deg outliers", replace(scene, outliers=0.05), "robust"))
        if dim == 2:
            out.append((f"2D {layout} {seen} {degrees:g} deg no axis", replace(scene, axis=False), "batch"))
    return out


def small_cases() -> list[tuple[str, SwarmScene, Method]]:
    """Networks with hardly a sighting to spare, without wrong ones and with."""
    out: list[tuple[str, SwarmScene, Method]] = []
    for robots, seen in itertools.product(SMALL, VISIBILITIES):
        scene = SwarmScene(robots=robots, layout="random", k=4, visibility=seen, sigma=float(np.radians(1.0)))
        out.append((f"{robots} {seen} robust", scene, "robust"))
        out.append((f"{robots} {seen} outliers", replace(scene, outliers=0.05), "robust"))
    return out


def network(scene: SwarmScene, seed: int) -> tuple[BearingNetwork, np.ndarray, np.ndarray]:
    """The network with corners known, the truth (n, d), and which sightings are outliers."""
    swarm = simulate_swarm(scene, np.random.default_rng(seed))
    table, truth = swarm.table, swarm.position[0]
    z = table.bearing() if table.dim == 2 else table.direction
    anchors = {k: truth[k] for k in (swarm.corners if scene.robots > max(SMALL) else (0, 1))}
    net = BearingNetwork(table.ids, table.dim, table.observer, table.target, z, table.sigma, anchors, (), table.axis)
    d = truth[table.target] - truth[table.observer]
    if not table.axis:
        c, s = (f(swarm.heading[0][table.observer]) for f in (np.cos, np.sin))
        d = np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]])
    off = np.arccos(np.clip(np.sum(d * table.direction, axis=1) / np.linalg.norm(d, axis=1), -1, 1))
    return net, truth, off > WILD * scene.sigma


def tried(case: str, scene: SwarmScene, method: Method, seeds: range) -> Tally:
    """The verdicts over `seeds`."""
    tally = Tally(case)
    for seed in seeds:
        net, truth, wild = network(scene, seed)
        try:
            found = locate(net, SwarmConfig(method=method))
        except DataError:
            tally = replace(tally, refused=tally.refused + 1)
            continue
        free = found.localisable & ~found.anchor
        if not free.any() or found.gauge or found.information is None:  # a shape alone
            continue
        clean = net.select(~wild)
        at_truth = locate(clean, SwarmConfig(max_iterations=0), initial=truth) if net.axis else found
        both = free & at_truth.localisable
        rmse = np.sqrt(np.square(found.position - truth)[both].sum(axis=1).mean())
        bound = np.sqrt(np.trace(np.asarray(at_truth.cov)[both], axis1=1, axis2=2).mean())
        value, dof = found.nees(truth)
        wrong = bool(value > 2 * chi2_quantile(0.999, float(dof)) or rmse > 3 * bound)
        key = ("trusted_" if found.reliable else "unsure_") + ("wrong" if wrong else "right")
        tally = replace(tally, **{key: getattr(tally, key) + 1})
        if found.reliable:
            tally = replace(tally, worst=max(tally.worst, value / dof))
            if wrong:
                tally = replace(tally, seeds=(*tally.seeds, seed))
    return tally


FIELDS = ("trusted_right", "trusted_wrong", "unsure_right", "unsure_wrong", "refused")
KINDS = ("outliers", "no axis", "robust", "deg")  # what a case's name ends in


def table(rows: list[Tally]) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    """Head and rows: verdicts by method and by whether robots are seen from both ends, and all of them."""
    told = ("5 % outliers, robust", "no outliers, no axes, batch", "no outliers, robust", "no outliers, batch")
    head = ("sightings", "of a pair", *(f.replace("_", ", ") for f in FIELDS))
    out: list[tuple[object, ...]] = []
    for kind, name in zip(KINDS, told, strict=True):
        for seen in VISIBILITIES:
            mine = [r for r in rows if r.case.endswith(kind) and f" {seen} " in r.case]
            if mine:
                out.append((name, SEEN[seen], *(sum(getattr(r, f) for r in mine) for f in FIELDS)))
    return head, [*out, ("all", "", *(sum(getattr(r, f) for r in rows) for f in FIELDS))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--only", default="", help="part of a case's name")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = []
    for name, scene, method in small_cases() if args.small else cases():
        if args.only in name:
            row = tried(name, scene, method, range(args.seed, args.seed + args.draws))
            rows.append(row)
            if row.trusted_wrong or row.unsure_right:
                print(
                    f"{name:44s} trusted {row.trusted_right} right {row.trusted_wrong} wrong, "
                    f"unsure {row.unsure_right} right {row.unsure_wrong} wrong; worst {row.worst:.3g} {row.seeds}",
                    file=sys.stderr,
                    flush=True,
                )
    print(markdown(*table(rows)), end="")
    if args.json:
        args.json.write_text(json.dumps([asdict(r) for r in rows], indent=1))


if __name__ == "__main__":
    main()
