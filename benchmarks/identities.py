"""Two maps whose landmarks nobody names alike: how often they are matched rightly, wrongly, or refused.

    python benchmarks/identities.py [--trials 200] [--seed 0]

Maps of 20 landmarks, 1 cm sure, in about 3 x 3 m, with so many in common. Of the first kind nothing else is known, and
what a map lacks may stand anywhere. Of the second each robot has driven lanes with a camera and maps what it sighted:
each pair is matched knowing where the robots looked, and not knowing. Of the third are places that look alike in
several parts, of which each robot has mapped so much, from one side on, but for a fifth at most.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from functools import cache, partial

import numpy as np

from mapweave.core import se2
from mapweave.core.landmark_log import SightingTable
from mapweave.core.records import Track
from mapweave.fusion.identities import Mapped, match_maps
from mapweave.landmarks.landmark_map import LandmarkMap, View, view_of
from mapweave.papers.kojima.measured import POINTS, RIGHT, SIGMA, draw_pair

CAMERA = View(reach=1.0, right=-0.6, left=0.6, rate=0.7)  # of looks a second apart
LANES = np.array(
    [
        (x, y, 0.0 if k % 2 == 0 else np.pi)
        for k, y in enumerate(np.arange(0.25, 3.0, 0.5))
        for x in np.arange(0.75, 2.3, 0.25)[:: 1 if k % 2 == 0 else -1]
    ]
)
DRIVE = Track(np.arange(float(len(LANES))), LANES)
Known = tuple[Mapped | None, Mapped | None]
Pair = tuple[LandmarkMap, LandmarkMap, np.ndarray, Known]
NOTHING: Known = (None, None)


def drawn(common: int, rng: np.random.Generator) -> Pair:
    source, target, T, _ = draw_pair(common, rng)
    return source, target, T, NOTHING


def a_map(at: np.ndarray, rng: np.random.Generator) -> LandmarkMap:
    P = SIGMA**2 * np.eye(2 * len(at))
    return LandmarkMap(tuple(map(str, range(len(at)))), at + rng.normal(0, SIGMA, at.shape), P)


@cache
def distance(common: int) -> float:
    """How far apart two robots start [m] that are expected to have so many of their 20 landmarks in common."""
    x, y = (np.arange(-1.0, 4.0, 0.1),) * 2
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    held = CAMERA.mapped(DRIVE, points)
    far = np.arange(0.0, 6.0, 0.05)
    both = [held @ CAMERA.mapped(DRIVE, points - [d, 0.0]) / held.sum() for d in far]
    return float(far[np.argmax(np.array(both) <= both[0] * common / POINTS)]) if common else 10.0


def driven(common: int, rng: np.random.Generator) -> Pair:
    """What two robots map that drive the same lanes, one beside the other's: each in its own frame."""
    heading = rng.uniform(-np.pi, np.pi)
    apart = distance(common) * np.array([np.cos(heading), np.sin(heading)])
    points = rng.uniform(np.minimum(-1.0, apart - 1.0), np.maximum(4.0, apart + 4.0), (4000, 2))
    starts = np.zeros(2), apart
    looks = [CAMERA.looks(DRIVE, points - start) for start in starts]
    sighted = [(look > 0) & (rng.random(look.shape) < CAMERA.rate) for look in looks]
    one, other = (s.any(axis=0) for s in sighted)
    kinds = (one & other, common), (one & ~other, POINTS - common), (other & ~one, POINTS - common)
    chosen = np.concatenate([np.flatnonzero(kind)[:n] for kind, n in kinds])
    maps, known = [], []
    for start, seen in zip(starts, sighted, strict=True):
        mine = rng.permutation(chosen[seen[:, chosen].any(axis=0)])
        m = a_map(points[mine] - start, rng)
        t, what = np.nonzero(seen[:, mine])
        x, y = se2.act(se2.inverse(LANES[t]), m.mean[what]).T
        table = SightingTable(t.astype(float), what, np.hypot(x, y), np.arctan2(y, x), m.ids)
        view = view_of(DRIVE, table, m.ids, m.mean)
        maps.append(m)
        known.append(None if view is None else partial(view.mapped, DRIVE))
    return maps[0], maps[1], np.append(-apart, 0.0), (known[0], known[1])


def rows(columns: int, along: float, lines: int, across: float, _: np.random.Generator) -> np.ndarray:
    x, y = along * np.arange(columns), across * np.arange(lines)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def rooms(rng: np.random.Generator) -> np.ndarray:
    room = rng.uniform(0, 2, (7, 2))
    return np.concatenate([room + np.array([3.0 * k, 0.0]) for k in range(4)])


def turned(times: int, each: int, rng: np.random.Generator) -> np.ndarray:
    part = rng.uniform(-3, 3, (each, 2))
    return np.concatenate([se2.act(np.array([0, 0, 2 * np.pi * k / times]), part) for k in range(times)])


def alike(
    place: Callable[[np.random.Generator], np.ndarray], least: float, most: float, rng: np.random.Generator
) -> Pair:
    """Two maps of a place, each of a share of its landmarks from `least` to `most`."""
    points, share = place(rng), rng.uniform(least, most)
    T = np.append(rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi))
    maps = []
    for frame in (np.zeros(3), T):
        heading = rng.uniform(-np.pi, np.pi)
        nearest = np.argsort(points @ [np.cos(heading), np.sin(heading)])[: round(share * len(points))]
        mine = rng.permutation(nearest[rng.random(len(nearest)) >= 0.2 * rng.random()])
        maps.append(a_map(se2.act(frame, points[mine]), rng))
    return maps[0], maps[1], T, NOTHING


HALVES, QUARTERS, CIRCLE = partial(turned, 2, 14), partial(turned, 4, 7), partial(turned, 20, 1)
GRID, STREET = partial(rows, 6, 1.0, 5, 1.0), partial(rows, 14, 1.5, 2, 2.5)
KINDS = (
    *((f"nothing known, {n} in common", partial(drawn, n)) for n in (0, 2, 4, 6, 8)),
    *((f"driven, {n} in common", partial(driven, n)) for n in (0, 2, 4, 6, 8)),
    ("alike: a grid of 6 x 5, half to all of it mapped", partial(alike, GRID, 0.5, 1.0)),
    ("alike: a street of 14 x 2, half to all", partial(alike, STREET, 0.5, 1.0)),
    ("alike: a circle of 20, half to all", partial(alike, CIRCLE, 0.5, 1.0)),
    ("alike: four rooms in a row, half to all", partial(alike, rooms, 0.5, 1.0)),
    ("alike: four quarters about a point, half to all", partial(alike, QUARTERS, 0.5, 1.0)),
    ("alike: two halves about a point, 0.75 to all", partial(alike, HALVES, 0.75, 1.0)),
    ("alike: two halves about a point, 0.5 to 0.75", partial(alike, HALVES, 0.5, 0.75)),
)


def judged(pair: Pair, known: Known) -> str:
    source, target, T, _ = pair
    match = match_maps(source, target, mapped=known)
    if not match.accepted:
        return "refused"
    off = se2.act(match.T_target_source, source.mean) - se2.act(T, source.mean)
    return "right" if np.hypot(*off.T).max() < RIGHT else "wrong"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    words = ("right", "wrong", "refused")
    print("| two maps | trials | believed, right | wrong | refused |")
    print("|" + 5 * "---|")
    for at, (name, draw) in enumerate(KINDS):
        told: dict[str, Counter[str]] = {}
        for k in range(args.trials):
            pair = draw(np.random.default_rng([args.seed, at, k]))
            told.setdefault(name, Counter())[judged(pair, NOTHING)] += 1
            if pair[3] != NOTHING:
                told.setdefault(f"{name}, known where they looked", Counter())[judged(pair, pair[3])] += 1
        for label, counts in told.items():
            print(f"| {label} | {args.trials} | {' | '.join(str(counts[word]) for word in words)} |", flush=True)


if __name__ == "__main__":
    main()
