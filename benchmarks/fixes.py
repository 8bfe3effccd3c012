"""Where simulated drives lie in the world by their position fixes: `python benchmarks/fixes.py` prints the table.

One office and one ring of corridor are mapped once each; fixes are drawn anew for every row, and the maps laid by them.
"""

from dataclasses import replace

import numpy as np

import mapweave
from mapweave.api.simulate import SimulatedDrive, World
from mapweave.core import se2
from mapweave.core.fixes import Fixes, enu_of, place_of
from mapweave.laser.laser_map import LaserMap
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.georeference import georeferenced
from mapweave.mapping.woven_map import own_map
from mapweave.sim.laser import DATUM, JUMP, simulated_fixes
from mapweave.sim.laser_worlds import CorridorConfig, OfficeConfig

WORLDS: tuple[tuple[str, World], ...] = (
    ("office", OfficeConfig(rooms=4, visited=2)),
    ("corridor", CorridorConfig(distance=100.0)),
)
UNSURE = LaserConfig().graph.unsure
NOISES, SHARES, DRAWS = (0.02, 0.5, 2.0), (0.0, 0.3), 20  # [m], of fixes that jump, of each row


def drawn(drive: SimulatedDrive, sd: float, share: float, seed: int) -> Fixes:
    """Fixes of the drive, so many of them somewhere else."""
    rng = np.random.default_rng(seed)
    fixes = simulated_fixes(drive.truth, sd, rng)
    gone = rng.random(len(fixes)) < share
    off = np.column_stack([JUMP * rng.standard_normal((len(fixes), 2)), np.zeros(len(fixes))]) * gone[:, None]
    return replace(fixes, place=place_of(enu_of(fixes.place, DATUM) + off, DATUM))


def row(name: str, drive: SimulatedDrive, own: LaserMap, sd: float, share: float) -> None:
    """How far the map's first pose and the trajectory are off in the world, and how far they say they are."""
    first, turn, along, nees, used = [], [], [], [], []
    for seed in range(DRAWS):
        m = replace(own, fixes=drawn(drive, sd, share, seed))
        woven = georeferenced([own_map(m)], [m], own.grid.resolution, UNSURE).components[0]
        g = woven.georeference
        if g is None:
            continue
        world = np.asarray(se2.compose(g.T_world_map, woven.tracks[own.robot].pose))
        flat = np.column_stack([world[:, :2], 0 * world[:, 2]])
        world[:, :2] = enu_of(place_of(flat, np.asarray(g.datum)), DATUM)[:, :2]
        e = world - drive.truth.pose
        e[:, 2] = se2.wrap_angle(e[:, 2])
        first.append(np.hypot(*e[0, :2]))
        turn.append(np.degrees(e[0, 2]))
        along.append(np.square(e[:, :2]).sum(axis=1).mean())
        nees.append(e[0] @ np.linalg.solve(g.cov, e[0]) / 3)
        used.append(g.used.mean())
    cells = [
        name,
        str(len(drawn(drive, sd, share, 0))),
        f"{sd:g}",
        f"{100 * share + 3:.0f}",
        f"{100 * (1 - np.mean(used)):.0f}",
        f"{np.sqrt(np.mean(np.square(first))):.3f}",
        f"{np.sqrt(np.mean(np.square(turn))):.2f}",
        f"{np.sqrt(np.mean(along)):.3f}",
        f"{np.mean(nees):.2f}",
        f"{len(used)} of {DRAWS}",
    ]
    print(f"| {' | '.join(cells)} |")


def main() -> None:
    places = "first pose [m], [deg] | trajectory [m] | NEES / dof"
    print(f"| world | fixes | noise [m] | jump [%] | left out [%] | {places} | laid |".replace(", [deg]", " | [deg]"))
    print("|" + "---|" * 10)
    for name, world in WORLDS:
        drive = mapweave.simulate_laser(world=world, seed=1, fixes=1.0)
        own = mapweave.map(replace(drive.log, fixes=None), method="graph").maps[0]
        for sd in NOISES:
            for share in SHARES:
                row(name, drive, own, sd, share)


if __name__ == "__main__":
    main()
