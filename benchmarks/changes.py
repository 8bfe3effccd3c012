"""Changes planted in simulated halls, and how many `compare` finds: boxes put there or taken away.

    python benchmarks/changes.py [--floors N] [--seed S]

Each floor is driven twice, with other noise and drift, before and after the changes, and once more as it was: of that
pair nothing should be said. A change is found where one of its kind is told within 0.4 m of the box.
"""

import argparse
from dataclasses import replace

import numpy as np

from mapweave import compare
from mapweave import map as map_logs
from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.sim.laser import DriftConfig, DriveConfig, LaserWorld, Route, WallStyle, WorldBuilder, drive, through

DRIVE = DriveConfig(drift=DriftConfig(end_error=(1.0, 2.0)))
LANE = 2.4  # [m] from the outer walls to the robot's way, on either side of which things stand
NEAR = 0.4  # [m] from a box to what is told of it
CLEAR = 0.5  # [m] from a box to the robot's way, and
APART = 0.35  # [m] to walls
EACH = 4  # boxes put there, and as many taken away, a floor

Box = tuple[float, float, float, float]  # x, y, wide, deep [m]


def floor(seed: int) -> tuple[LaserWorld, Route]:
    """A hall of chance size round a core, with walls that jut out and furniture along them, and twice the way round."""
    rng = np.random.default_rng((seed, 0))
    wide, high = float(rng.uniform(15.0, 20.0)), float(rng.uniform(12.0, 15.0))
    build = WorldBuilder("hall", WallStyle(), rng)
    build.box(0.0, 0.0, wide, high, 0.6)
    inner = 2.0 * LANE
    build.box(inner, inner, wide - 2.0 * inner, high - 2.0 * inner, 0.5)
    for _ in range(5):
        out, x, y = (
            float(rng.uniform(0.6, 1.4)),
            float(rng.uniform(1.0, wide - 1.0)),
            float(rng.uniform(1.0, high - 1.0)),
        )
        build.plain((x, 0.0), (x, out), 0.5)
        build.plain((x, high), (x, high - out), 0.5)
        build.plain((0.0, y), (out, y), 0.5)
    for _ in range(6):
        build.box(float(rng.uniform(1.0, wide - 2.0)), float(rng.choice([0.05, high - 0.65])), 1.2, 0.6, 0.4)
    corners = [(LANE, LANE), (wide - LANE, LANE), (wide - LANE, high - LANE), (LANE, high - LANE)]
    points = [(LANE + 1.5, LANE), *corners[1:], *corners, *corners[:1], (LANE + 3.0, LANE)]
    return build.world(), through(points, 0.5)


def boxes(world: LaserWorld, route: Route, seed: int, many: int) -> list[Box]:
    """Boxes that stand free, off the robot's way."""
    rng = np.random.default_rng((seed, 1))
    way = route.poses(np.arange(0.0, route.total, 0.1))[:, :2]
    along = np.linspace(0.0, 1.0, 80)[:, None]
    solid = np.concatenate([a[:2] + along * (a[2:] - a[:2]) for a in world.segments])
    high = solid.max(axis=0)
    found: list[Box] = []
    for _ in range(20_000):
        x, y = rng.uniform(0.3, high - 1.2)
        box = (float(x), float(y), *map(float, rng.uniform(0.35, 0.9, 2)))
        others = np.array([[u + 0.5 * w, v + 0.5 * d] for u, v, w, d in found]).reshape(-1, 2)
        if CLEAR < _off(box, way) < LANE and _off(box, solid) > APART and _off(box, others) > 1.0:
            found.append(box)
            if len(found) == many:
                break
    return found


def _off(box: Box, points: np.ndarray) -> float:
    x, y, wide, deep = box
    d = np.maximum(np.abs(points - (x + 0.5 * wide, y + 0.5 * deep)) - (0.5 * wide, 0.5 * deep), 0.0)
    return float(np.hypot(*d.T).min(initial=np.inf))


def with_boxes(world: LaserWorld, more: list[Box]) -> LaserWorld:
    build = WorldBuilder(world.name, WallStyle(), np.random.default_rng(0))
    for box in more:
        build.box(*box, 0.5)
    if not more:
        return world
    there = build.world()
    segments, light = (np.concatenate([getattr(w, n) for w in (world, there)]) for n in ("segments", "reflectance"))
    return LaserWorld(segments, light, name=world.name)


def driven(world: LaserWorld, route: Route, noise: int, more: list[Box]) -> LaserLog:
    made = drive(with_boxes(world, more), route, DRIVE, noise)
    return replace(made.log, scans=tuple(replace(scan, intensities=None) for scan in made.log.scans))


def trial(seed: int) -> tuple[int, int, int, int]:
    """Changes planted, of these found, told without being there, and told of the pair that is unchanged."""
    world, route = floor(seed)
    planted = boxes(world, route, seed, 2 * EACH)
    put, taken = planted[::2], planted[1::2]
    logs = ((10 * seed + k, more) for k, more in enumerate((taken, put, taken)))
    first, second, same = (map_logs(driven(world, route, noise, more)) for noise, more in logs)
    told = compare(first, second)
    middles = [se2.act(route.start, 0.5 * (c.lower + c.upper)[None]) for c in told.changes]  # in the hall's frame
    found, right = 0, set()
    for kind, there in (("new", put), ("gone", taken)):
        for box in there:
            hits = [k for k, c in enumerate(told.changes) if c.kind == kind and _off(box, middles[k]) <= NEAR]
            found += bool(hits)
            right |= set(hits)
    return len(planted), found, len(told.changes) - len(right), len(compare(first, same).changes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--floors", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rows = [(seed, *trial(seed)) for seed in range(asked.seed, asked.seed + asked.floors)]
    print("| floor | planted | found | told and not there | told of an unchanged floor |")
    print("| --- | --- | --- | --- | --- |")
    for row in [*rows, ("all", *np.sum(np.array(rows)[:, 1:], axis=0).tolist())]:
        print(f"| {' | '.join(map(str, row))} |")


if __name__ == "__main__":
    main()
