"""Where simulated drives lie in the world by their position fixes: `python benchmarks/fixes.py [--teams | --radios]`.

One office and one ring of corridor are mapped once each; fixes are drawn anew for every row, and the maps laid by them.
`--teams`: landmark teams of two pairs of robots that share nothing, and mixed teams of which nobody saw another, each
mapped without fixes and then laid by those of every row. `--radios`: teams that ranges place, with odometry as
simulated and with odometry that errs as it is believed to.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # teams are those of the tests

from tests.team.fixed_teams import alone, anywhere, carrying, errors, fixed, nees, with_radios
from tests.team.mixed_teams import mixed

import mapweave
from mapweave.api.map_landmarks import map_landmark_logs
from mapweave.api.map_options import MapOptions
from mapweave.api.simulate import SimulatedDrive, World
from mapweave.core import se2
from mapweave.core.fixes import Fixes, enu_of, place_of
from mapweave.core.records import Track
from mapweave.laser.laser_map import LaserMap
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.georeference import georeferenced
from mapweave.mapping.woven_map import Georeference, own_map
from mapweave.sim.laser import DATUM, JUMP, simulated_fixes
from mapweave.sim.laser_worlds import CorridorConfig, OfficeConfig
from mapweave.team.config import SmoothingConfig
from mapweave.team.georeference import laid_team
from mapweave.team.smooth import Smoothed

WORLDS: tuple[tuple[str, World], ...] = (
    ("office", OfficeConfig(rooms=4, visited=2)),
    ("corridor", CorridorConfig(distance=100.0)),
)
UNSURE = LaserConfig().graph.unsure
NOISES, SHARES, DRAWS = (0.02, 0.5, 2.0), (0.0, 0.3), 20  # [m], of fixes that jump, of each row
TEAMS = 10  # of each kind


def drawn(truth: Track, sd: float, share: float, seed: int) -> Fixes:
    """Fixes of a drive, so many of them somewhere else."""
    rng = np.random.default_rng(seed)
    fixes = simulated_fixes(truth, sd, rng)
    gone = rng.random(len(fixes)) < share
    off = np.column_stack([JUMP * rng.standard_normal((len(fixes), 2)), np.zeros(len(fixes))]) * gone[:, None]
    return replace(fixes, place=place_of(enu_of(fixes.place, DATUM) + off, DATUM))


def row(name: str, drive: SimulatedDrive, own: LaserMap, sd: float, share: float) -> None:
    """How far the map's first pose and the trajectory are off in the world, and how far they say they are."""
    first, turn, along, nees, used = [], [], [], [], []
    for seed in range(DRAWS):
        m = replace(own, fixes=drawn(drive.truth, sd, share, seed))
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
        str(len(drawn(drive.truth, sd, share, 0))),
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


# How many robots the first map holds, and where maps lie, of which that is known.
Told = tuple[int, list[Georeference]]
Made = Callable[[dict[str, Fixes]], Told]


def told(components: Sequence[Smoothed]) -> Told:
    return len(components[0].map.robots), [s.georeference for s in components if s.georeference is not None]


def pairs(seed: int) -> tuple[dict[str, Track], Made]:
    """Two robots among landmarks, and two others among others: where they went, and what fixes make of them."""
    here, there = fixed(seed), fixed(seed + 100, first=3)
    logs = (*here.logs, *there.logs)
    result = map_landmark_logs(logs, MapOptions(), "")

    def made(fixes: dict[str, Fixes]) -> Told:
        own = carrying(logs, fixes)
        return told(laid_team(result.smoothed, own, result.fusion.labels, SmoothingConfig()).components)

    return {**here.truth, **there.truth}, made


def laser_and_camera(seed: int) -> tuple[dict[str, Track], Made]:
    """A laser robot and a camera robot; nobody saw another."""
    team = mixed(seed, lasers=1, cameras=1, bearings=0, landmarks=10, minutes=2.0)

    def made(fixes: dict[str, Fixes]) -> Told:
        of_lasers = {robot: f for robot, f in fixes.items() if robot in team.scanned}
        cameras = {robot: f for robot, f in fixes.items() if robot not in of_lasers}
        return told(team.map(logs=carrying(map(alone, team.logs), cameras), fixes=of_lasers).components)

    return anywhere({robot: true.track for robot, true in team.truth.robots.items()}, seed), made


def radios(seed: int, *, believed: bool) -> tuple[dict[str, Track], Made]:
    """Three robots and two beacons, a tenth of the ranges round something."""
    team = with_radios(seed, believed=believed)

    def made(fixes: dict[str, Fixes]) -> Told:
        laid = team.laid(fixes)
        first = team.net.owner[laid.estimate.parts[0].nodes]
        held = [laid.georeference] if laid.georeference is not None else []
        return len(set(first[first < len(team.net.robots)].tolist())), held

    return team.truth, made


def team_row(name: str, drives: list[tuple[dict[str, Track], Made]], sd: float, share: float) -> None:
    """How far poses are off in the world, and how far they say they are, of one team a seed."""
    square, sure, used, whole = [], [], [], 0
    for seed, (truth, made) in enumerate(drives):
        ways = enumerate(truth.items())
        robots, placed = made({robot: drawn(way, sd, share, 10 * seed + k) for k, (robot, way) in ways})
        whole += robots == len(truth)
        for g in placed:
            used.append(g.used.mean())
            square.append(np.square(errors(g, truth)[0][:, :2]).sum(axis=1).mean())
            sure.append(nees(g, truth))
    cells = [
        name,
        str(len(drives[0][0])),
        f"{sd:g}",
        f"{100 * share + 3:.0f}",
        f"{100 * (1 - np.mean(used)):.0f}",
        f"{np.sqrt(np.mean(square)):.3f}",
        f"{np.mean(sure):.2f}",
        f"{whole} of {len(drives)}",
    ]
    print(f"| {' | '.join(cells)} |", flush=True)


def teams(kinds: Sequence[tuple[str, Callable[[int], tuple[dict[str, Track], Made]]]], noises: Sequence[float]) -> None:
    print("| team | robots | noise [m] | jump [%] | left out [%] | trajectory [m] | NEES / dof | in one map |")
    print("|" + "---|" * 8)
    for name, kind in kinds:
        drives = [kind(seed) for seed in range(1, TEAMS + 1)]
        for sd in noises:
            for share in SHARES:
                team_row(name, drives, sd, share)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--teams", action="store_true", help="landmark and mixed teams")
    parser.add_argument("--radios", action="store_true", help="teams that ranges place")
    asked = parser.parse_args()
    if asked.teams:
        teams((("landmarks", pairs), ("laser and camera", laser_and_camera)), NOISES[1:])
        return
    if asked.radios:
        kinds = (("odometry as believed", True), ("odometry as simulated", False))
        teams([(name, partial(radios, believed=believed)) for name, believed in kinds], NOISES)
        return
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
