"""Robots whose names contradict the others': how often they are joined under the right names, under wrong ones, or not.

python benchmarks/renaming.py [--draws 20] [--seed 0]

Places of 17 landmarks in 10 x 10 m, or in rows 2 m apart; every robot's map is drawn from the covariance it states. In
one place the names of the last robot are moved round, all or some; of two places the last robot has mapped the other.
"""

import argparse
from dataclasses import dataclass
from time import process_time

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.fusion.join import fuse
from mapweave.landmarks.landmark_map import LocalMap, Submap

LANDMARKS, SIZE = 17, 10.0


@dataclass(frozen=True, slots=True)
class Kind:
    """robots: the last is the one in question; seen: landmarks in each map; moved: names of the table moved round.

    rows: columns and rows of a grid, and the share of it that is there, in place of random places.
    """

    name: str
    robots: int = 2
    seen: int = LANDMARKS
    moved: int = LANDMARKS
    sigma: tuple[float, float] = (0.01, 0.05)
    rows: tuple[int, int, float] | None = None
    elsewhere: bool = False


GRIDS = ((4, 4, 1.0), (4, 5, 1.0), (5, 5, 0.6), (2, 8, 1.0), (1, 12, 1.0))
KINDS = (
    Kind("all names moved, two robots"),
    Kind("all names moved, four robots", robots=4),
    Kind("9 of 17 names moved, four robots", robots=4, moved=9),
    Kind("3 of 17 names moved, four robots", robots=4, moved=3),
    Kind("all moved, 13 of 17 seen by each of four", robots=4, seen=13),
    Kind("5 of 17 moved, 13 of 17 seen by each of four", robots=4, seen=13, moved=5),
    Kind("all moved, 10 of 17 seen by each of two", seen=10),
    Kind("all moved, maps unsure by 2 to 20 cm", sigma=(0.02, 0.2)),
    *(Kind(f"all moved, {int(s * a * b)} of {a} x {b} in rows", rows=(a, b, s)) for a, b, s in GRIDS),
    Kind("another place", elsewhere=True),
    Kind("another place, 10 of 17 seen", seen=10, elsewhere=True),
    Kind("another place, unsure maps", sigma=(0.02, 0.2), elsewhere=True),
    *(
        Kind(f"another place, {int(s * a * b)} of {a} x {b} in rows", rows=(a, b, s), elsewhere=True)
        for a, b, s in GRIDS
    ),
)


def place(kind: Kind, rng: np.random.Generator) -> np.ndarray:
    """Landmarks (n, 2) [m]."""
    if kind.rows is None:
        return rng.uniform(0, SIZE, (LANDMARKS, 2))
    columns, rows, share = kind.rows
    at = 2.0 * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return at[rng.permutation(len(at))[: int(share * len(at))]]


def mapped(robot: str, points: np.ndarray, kind: Kind, rng: np.random.Generator) -> LocalMap:
    """What a robot somewhere makes of the place, with a drift in heading that all landmarks share."""
    which = np.sort(rng.permutation(len(points))[: kind.seen])
    frame = np.append(rng.uniform(0, SIZE, 2), rng.uniform(-np.pi, np.pi))
    local, n = se2.act(se2.inverse(frame), points[which]), len(which)
    own = np.repeat(np.exp(rng.uniform(*np.log(kind.sigma), n)), 2)
    turn = 0.01 * np.stack([-local[:, 1], local[:, 0]], axis=1).ravel()
    P = np.diag(own**2) + np.outer(turn, turn)
    mean = local + (np.linalg.cholesky(P) @ rng.normal(size=2 * n)).reshape(-1, 2)
    cov = np.zeros((3 + 2 * n, 3 + 2 * n))
    cov[:3, :3], cov[3:, 3:] = 1e-6 * np.eye(3), P
    ids = tuple(str(100 + i) for i in which)
    track = Track(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3, 3)), f"local_{robot}")
    return LocalMap(robot, Submap(robot, np.zeros(3), ids, mean, cov, f"local_{robot}"), track, dict.fromkeys(ids, 1))


def trial(kind: Kind, rng: np.random.Generator) -> tuple[str, int, int, int]:
    """What came of it, and of the names that moved: right ones, wrong ones, those left open."""
    points = place(kind, rng)
    maps = [mapped(f"robot{k + 1}", points, kind, rng) for k in range(kind.robots - 1)]
    last = mapped(f"robot{kind.robots}", place(kind, rng) if kind.elsewhere else points, kind, rng)
    names = [str(100 + i) for i in range(len(points))]
    which = rng.permutation(len(names))[: min(kind.moved, len(names))]
    to = {} if kind.elsewhere else {names[a]: names[b] for a, b in zip(which, np.roll(which, 1), strict=True)}
    true, s = last.submap.ids, last.submap
    ids = tuple(to.get(name, name) for name in true)
    maps.append(LocalMap(last.robot, Submap(s.robot, s.pose, ids, s.mean, s.cov, s.frame), last.track, last.sightings))
    fused = fuse(maps)
    if not any(len(c.robots) == kind.robots for c in fused.components):
        return "refused", 0, 0, 0
    if kind.elsewhere:
        return "wrong", 0, 0, 0
    labels, held = fused.labels.get(last.robot, {}), {name for m in maps[:-1] for name in m.submap.ids}
    got = [(labels.get(own, own), own, name) for own, name in zip(ids, true, strict=True)]
    wrong = sum(g not in {own, name, f"{last.robot}:{own}"} for g, own, name in got)
    moved = [(g, name) for g, own, name in got if own != name and name in held]
    right = sum(g == name for g, name in moved)
    return "wrong" if wrong else "joined", right, wrong, len(moved) - right - wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("| case | joined | refused | wrong | names right | wrong | left open | s each |")
    print("|" + 8 * "---|")
    for at, kind in enumerate(KINDS):
        began = process_time()
        told = [trial(kind, np.random.default_rng([args.seed, at, k])) for k in range(args.draws)]
        words = [sum(t[0] == word for t in told) for word in ("joined", "refused", "wrong")]
        names = [sum(t[i] for t in told) for i in (1, 2, 3)]
        cells = [kind.name, *words, *names, f"{(process_time() - began) / args.draws:.2f}"]
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
