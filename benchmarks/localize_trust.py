"""How often `localize` is right, wrong or not sure when the start is searched everywhere.

    python benchmarks/localize_trust.py [--starts 100] [--seed 0] [--scans 60] [--json FILE]

Worlds in turn: the ring corridor, an office, a tunnel. A log is a piece of a drive of its own, along the way the map
was made on or against it, with wheels and noise of its own. Of every ten logs one is of another building of the same
kind, and one of a twin: the same walls, painted and furnished otherwise, which geometry alone cannot tell apart. An
answer is wrong when half of its poses since the start was found are off by over 0.5 m; in another building, and with
intensity in a twin, every trusted answer is wrong. Each start is tried with intensity and without.
"""

import argparse
import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np

from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.laser.beam import IntensityCalibration, beams
from mapweave.laser.config import LaserConfig
from mapweave.laser.laser_map import GridMap
from mapweave.laser.localise import Localisation, localise
from mapweave.laser.mapping import choose_feature
from mapweave.laser.occupancy_mapper import render
from mapweave.sim.corridor import CorridorConfig, corridor_world
from mapweave.sim.laser import LaserSimulation, drive
from mapweave.sim.laser_world import LaserWorld
from mapweave.sim.office import OfficeConfig, office_route, office_world
from mapweave.sim.route import Route, ring
from mapweave.sim.tunnel import TunnelConfig, tunnel_route, tunnel_world

WORLDS = ("ring", "office", "tunnel")
WRONG = 0.5  # [m]
CFG = LaserConfig()


@dataclass
class Place:
    """A finished map in the world's frame, and what drives through it are made of."""

    grid: GridMap
    calibration: IntensityCalibration | None
    world: LaserWorld
    route: Route


def building(kind: str, seed: int, change: float = 0.0) -> tuple[LaserWorld, Route]:
    """A building and a way through it. change: [m] by which its rooms and corridors are wider and longer."""
    if kind == "ring":
        c = CorridorConfig()
        c = replace(
            c, width=c.width + 0.3 * change, long_leg=c.long_leg - 6 * change, short_leg=c.short_leg + 4 * change
        )
        return corridor_world(c, seed), ring(c.long_leg, c.short_leg, c.corner, c.distance, c.start)
    if kind == "office":
        o = OfficeConfig()
        o = replace(o, room_width=o.room_width + change, room_depth=o.room_depth - 0.6 * change)
        return office_world(o, seed), office_route(o, seed)
    t = TunnelConfig()
    t = replace(t, width=t.width + 0.5 * change)
    return tunnel_world(t, seed), tunnel_route(t)


def mapped(kind: str, seed: int) -> Place:
    """The map of one drive, every scan where it truly was."""
    world, route = building(kind, seed)
    sim = drive(world, route, CorridorConfig().drive, seed)
    log = sim.log
    feature = choose_feature(log, CFG)
    seen = [beams(scan, feature.name, feature.calibration, CFG.beam) for scan in log.scans]
    truth = sim.truth.pose[np.searchsorted(sim.truth.t, log.scan_t)]
    sensors = np.array([scan.T_robot_sensor for scan in log.scans])
    return Place(render(seen, truth, sensors, CFG.resolution, "map"), feature.calibration, world, route)


def backwards(route: Route) -> Route:
    """The same way the other way round."""
    end = route.poses(np.array([route.total - 1e-6]))[0]
    start = se2.compose(end, np.array([0.0, 0.0, np.pi]))
    return Route(start, route.length[::-1].copy(), -route.curvature[::-1])


def piece(sim: LaserSimulation, first: int, scans: int) -> tuple[LaserLog, Track]:
    """So many scans of the drive from `first` on, and the truth."""
    log, end = sim.log, min(first + scans, len(sim.log.scans))
    t0, t1 = log.scan_t[first], log.scan_t[end - 1]
    keep = (log.odometry.t >= t0) & (log.odometry.t <= t1)
    rows = Track(log.odometry.t[keep], log.odometry.pose[keep], frame="odom")
    return replace(log, scan_t=log.scan_t[first:end], scans=log.scans[first:end], odometry=rows), sim.truth


def off(found: Localisation, truth: Track) -> float:
    """[m] median error of the poses since the start was found."""
    since = found.track.t[0] if found.found_t is None else found.found_t
    inside = found.track.t >= since
    true = truth.pose[np.searchsorted(truth.t, found.track.t[inside])]
    return float(np.median(np.hypot(*(found.track.pose[inside] - true)[:, :2].T)))


def trial(k: int, seed: int, scans: int, places: dict[str, Place]) -> list[dict]:
    """What became of the k-th start, with intensity and without."""
    kind, rng = WORLDS[k % len(WORLDS)], np.random.default_rng([seed, k])
    place, where = places[kind], {4: "twin", 9: "other"}.get(k % 10, "here")
    world, route = place.world, place.route
    if where != "here":
        world, route = building(kind, 1000 + k, 0.0 if where == "twin" else float(rng.choice([-1.0, 1.0])))
    way = backwards(route) if rng.random() < 0.5 else route
    sim = drive(world, way, CorridorConfig().drive, 5000 + 31 * seed + k)
    log, truth = piece(sim, int(rng.integers(0, max(1, len(sim.log.scans) - scans))), scans)
    rows = []
    for feature in ("normalised", "none"):
        began = process_time()
        found = localise(
            log, place.grid, place.calibration, feature, CFG, None, np.random.default_rng(k), lambda *_: None
        )
        if where == "twin" and feature == "none":
            continue
        error = off(found, truth) if where == "here" else None
        answer = "not sure" if not found.trusted else "right" if error is not None and error < WRONG else "wrong"
        rows.append(
            {
                "start": k,
                "world": kind,
                "where": where,
                "feature": feature,
                "answer": answer,
                "error": error,
                "matched": found.matched,
                "found": found.found_t is not None,
                "doubt": found.doubt,
                "seconds": process_time() - began,
            }
        )
    return rows


def table(rows: list[dict]) -> str:
    lines = [f"{'world':<10}{'feature':<12}{'log of':<8}{'right':>7}{'wrong':>7}{'not sure':>10}"]
    for kind in WORLDS:
        for feature in ("normalised", "none"):
            for where in ("here", "twin", "other"):
                n = Counter(
                    r["answer"] for r in rows if (r["world"], r["feature"], r["where"]) == (kind, feature, where)
                )
                if n:
                    told = f"{n['right']:>7}{n['wrong']:>7}{n['not sure']:>10}"
                    lines.append(f"{kind:<10}{feature:<12}{where:<8}{told}")
    for feature in ("normalised", "none"):
        n = Counter(r["answer"] for r in rows if r["feature"] == feature)
        lines.append(f"{'all':<10}{feature:<12}{'':<8}{n['right']:>7}{n['wrong']:>7}{n['not sure']:>10}")
    return "\n".join(lines)


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--starts", type=int, default=100)
    ask.add_argument("--seed", type=int, default=0)
    ask.add_argument("--scans", type=int, default=60)
    ask.add_argument("--json", type=Path)
    asked = ask.parse_args()
    places = {kind: mapped(kind, 1) for kind in WORLDS}
    rows = [row for k in range(asked.starts) for row in trial(k, asked.seed, asked.scans, places)]
    print(table(rows))
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
