"""Offices seen by narrow views, as depth cameras have: how far the map's poses are off, and the wheels'.

python benchmarks/narrow.py [--seeds 10] [--first 0]

Floors, rooms and drives are drawn by the seed, wheels drift by 1 to 4 m. Errors are the greatest of a drive, after one
rigid alignment; of a drive that is mapped in pieces, of its worst.
"""

import argparse
from collections.abc import Iterator

import numpy as np

import mapweave
from mapweave.core import se2
from mapweave.sim.laser import DriftConfig, DriveConfig, LaserSimulation, Scanner, drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

DEGREES = (58.0, 90.0, 120.0)  # of the view; of which the first is a depth camera's
EVERY = (0.25, 0.05)  # [m] from scan to scan, at 0.5 m/s


def driven(degrees: float, every: float, seed: int) -> LaserSimulation:
    rng = np.random.default_rng([seed, 77])
    scanner = Scanner(beams=320, opening=np.radians(degrees), near=0.45, far=5.0, noise=0.01)
    cfg = OfficeConfig(
        rooms=int(rng.integers(3, 7)),
        room_width=float(rng.uniform(4.0, 7.0)),
        room_depth=float(rng.uniform(3.5, 6.0)),
        corridor=float(rng.uniform(1.8, 3.0)),
        visited=int(rng.integers(3, 7)),
        drive=DriveConfig(scan_every=every, scanner=scanner, drift=DriftConfig(end_error=(1.0, 4.0))),
    )
    return drive(office_world(cfg, seed), office_route(cfg, seed), cfg.drive, seed)


def most(t: np.ndarray, pose: np.ndarray, sim: LaserSimulation) -> float:
    """[m] that a trajectory is off, where it is most."""
    true = se2.interpolate(t, sim.truth.t, sim.truth.pose)[:, :2]
    off = se2.act(se2.align(pose[:, :2], true), pose[:, :2]) - true
    return float(np.hypot(off[:, 0], off[:, 1]).max())


def rows(seeds: range) -> Iterator[tuple[str, ...]]:
    for degrees in DEGREES:
        for every in EVERY:
            ours, wheels, good, wrong = [], [], 0, 0
            for seed in seeds:
                sim = driven(degrees, every, seed)
                made = mapweave.map([sim.log])
                tracks = [track for woven in made.components for track in woven.tracks.values()]
                ours.append(max(most(track.t, track.pose, sim) for track in tracks))
                told = np.array([scan.odometry for scan in sim.log.scans])
                wheels.append(most(sim.log.scan_t, told, sim))
                good += made.verdict == "good"
                wrong += made.verdict == "good" and ours[-1] > 1.0
            numbers = (f"{np.median(off):.2f}, {max(off):.2f}" for off in (ours, wheels))
            counts = (f"{sum(off < 1.0 for off in ours)} of {len(seeds)}", str(good), str(wrong))
            yield (f"{degrees:.0f} degrees", f"{0.5 / every:g}", *numbers, *counts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    args = parser.parse_args()
    columns = ("map off by [m]: median, most", "wheels: median, most", "off by less than 1 m", "good", "good and more")
    print("| view | scans a second |", " | ".join(columns), "|")
    print("|", " | ".join(("---",) * 7), "|")
    for row in rows(range(args.first, args.first + args.seeds)):
        print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main()
