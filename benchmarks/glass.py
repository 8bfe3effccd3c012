"""Glazed offices: how much of the panes that beams met squarely is wall in the map, and without knowing of glass.

python benchmarks/glass.py [--seeds 5] [--first 0]

A pane counts square by square of 0.1 m in which it returned light three times or more; it is in the map where a cell
within 0.15 m is occupied.
"""

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree
from sweep import error

from mapweave.core import se2
from mapweave.core.findings import verdict
from mapweave.core.records import frozen
from mapweave.exploration.laser.config import OCCUPIED_SHARE
from mapweave.kernels.walls.segments import cast
from mapweave.laser.laser_map import LaserMap
from mapweave.laser.occupancy_mapper import of_grid
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser import DriftConfig, DriveConfig, LaserSimulation, Scanner, drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

SQUARE, OFTEN, NEAR = 0.1, 3, 0.15  # [m] of a place on a pane, returns there, [m] from it to a wall of the map
REACHES = (5.6, 12.0)  # [m] of the scanner
SHOWN = (0.97, 0.9, 0.8)  # cosine of incidence from which on panes return light


def driven(reach: float, shown: float, seed: int) -> LaserSimulation:
    cfg = OfficeConfig(
        visited=4, glazed=0.6, drive=DriveConfig(scanner=Scanner(far=reach), drift=DriftConfig(end_error=(1.0, 2.0)))
    )
    world = office_world(cfg, seed)
    if world.shown is not None:
        world = replace(world, shown=np.where(world.shown > 0.0, shown, 0.0))
    return drive(world, office_route(cfg, seed), cfg.drive, seed)


def met(sim: LaserSimulation, reach: float) -> np.ndarray:
    """Places (k, 2) [m] where panes returned light, in the frame of the first pose."""
    if sim.world.shown is None:
        return np.zeros((0, 2))
    walls = frozen(np.column_stack([sim.world.segments, sim.world.shown]))
    pose = sim.truth.pose[np.searchsorted(sim.truth.t, sim.log.scan_t)]
    angles = sim.log.scans[0].angles()
    r, what, _ = cast(pose, angles, walls, np.zeros((len(pose), 0, 3)), reach)
    k, b = np.nonzero(np.append(sim.world.shown > 0.0, False)[what])
    turn = pose[k, 2] + angles[b]
    points = pose[k, :2] + r[k, b][:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    places, count = np.unique(np.floor(points / SQUARE), axis=0, return_counts=True)
    return np.asarray(se2.act(se2.inverse(pose[0]), SQUARE * (places[count >= OFTEN] + 0.5)))


def kept(places: np.ndarray, made: LaserMap) -> np.ndarray:
    occupied = of_grid(made.grid, OCCUPIED_SHARE)
    walls = occupied.centres(np.argwhere(occupied.occupied))
    return np.asarray(cKDTree(walls).query(se2.act(made.scans.pose[0], places))[0]) < NEAR


def knowing_nothing() -> ExitStack:
    """As if all walls were opaque."""
    stack = ExitStack()
    no_face = patch("mapweave.laser.moving.flat_faces", side_effect=lambda ranges, *_: np.zeros((len(ranges), 4)))
    no_glass = patch("mapweave.mapping.map_overlap._as_glass", side_effect=lambda seen, _: np.zeros(len(seen), bool))
    stack.enter_context(no_face)
    stack.enter_context(no_glass)
    return stack


def rows(seeds: range) -> Iterator[tuple[str, ...]]:
    for reach in REACHES:
        for shown in SHOWN:
            told = []
            for how in (ExitStack, knowing_nothing):
                off, there, good = [], [], 0
                for seed in seeds:
                    sim = driven(reach, shown, seed)
                    with how():
                        made = map_laser(sim.log, LaserConfig(), seed)
                    off.append(error(sim, made)[0])
                    there.append(kept(met(sim, reach), made))
                    good += verdict(made.findings) == "good"
                share = np.concatenate(there).mean()
                told += [f"{100 * share:.0f} %", f"{np.median(off):.2f}, {max(off):.2f}", f"{good} of {len(seeds)}"]
            yield (f"{reach:g} m", f"{np.degrees(np.arccos(shown)):.0f} degrees", *told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    args = parser.parse_args()
    columns = ("panes kept", "error of poses [m]: median, most", "good")
    print("| scanner | panes seen within |", " | ".join([*columns, *(f"{c}, all opaque" for c in columns)]), "|")
    print("|", " | ".join(("---",) * 8), "|")
    for row in rows(range(args.first, args.first + args.seeds)):
        print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main()
