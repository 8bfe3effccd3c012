"""Buildings, and robots that are driven through them along given ways: what the team's estimator is tested on."""

from dataclasses import dataclass, replace

import numpy as np

from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.exploration.ground import Ground
from mapweave.mapping.config import LaserTeamConfig
from mapweave.mapping.laser_team import LaserTeam
from mapweave.sim.laser import WallStyle, WorldBuilder
from mapweave.sim.laser_team import LaserRobotsConfig, LaserTeamSim, OdometryNoise
from mapweave.sim.laser_worlds import office_floor

CELL = 0.2  # [m] of the grid that ways are found on


@dataclass
class Drive:
    """What M robots saw. scans[k][j] at t[k] from truth[k, j]; starts: (M, 3) as the team is told them."""

    t: list
    truth: np.ndarray
    scans: list
    starts: np.ndarray
    walls: Walls


def ring(wide=36.0, high=20.0, across=2.2, seed=0):
    """A corridor all round a block, with doors that stand back and nothing else to tell one wall from another."""
    build = WorldBuilder("ring", WallStyle(), np.random.default_rng(seed))
    for a, b in (((0, 0), (wide, 0)), ((wide, 0), (wide, high)), ((wide, high), (0, high)), ((0, high), (0, 0))):
        build.wall(a, b, recess=0.12)
    lo, hx, hy = across, wide - across, high - across
    for a, b in (((lo, lo), (lo, hy)), ((lo, hy), (hx, hy)), ((hx, hy), (hx, lo)), ((hx, lo), (lo, lo))):
        build.wall(a, b, recess=0.12)
    return build.world()


def lap(wide=36.0, high=20.0, across=2.2, backwards=False):
    """Once round the ring's middle and a little further; and where to begin."""
    m = 0.5 * across
    way = [(m + 6, m), (wide - m, m), (wide - m, high - m), (m, high - m), (m, m), (m + 9, m)]
    if backwards:
        way = [(m + 4, m), (m, m), (m, high - m), (wide - m, high - m), (wide - m, m), (m + 2, m)]
    return [np.array(p) for p in way]


def rooms(area, robots, seed, stops):
    """An office floor, and for each robot a way through `stops` places drawn by chance."""
    floor = office_floor(area, seed)
    walls = Walls.of(floor.world.segments)
    ground = Ground.of(~walls.blocked(floor.lower, floor.upper, CELL, 0.3), floor.lower, CELL, 6)
    inside = np.argwhere(ground.cost_to_go(ground.cells(floor.starts[:1, :2])).cost >= 0)
    rng = np.random.default_rng(seed)
    ways = []
    for j in range(robots):
        way, at = [], floor.starts[j, :2]
        for _ in range(stops):
            goal = floor.lower + CELL * (inside[rng.integers(len(inside))][::-1] + 0.5)
            way += list(ground.cost_to_go(ground.cells(at[None])).path(goal)[::-1])
            at = goal
        ways.append([np.asarray(p) for p in way])
    return floor.world, floor.starts[:robots], ways


def drive(world, starts, ways, seed, steps=2_000, noise=1.0):
    """Every robot follows its way until all have arrived. Each is simulated alone: they pass through each other."""
    cfg = LaserRobotsConfig(odometry=OdometryNoise(factor=noise))
    sims = [LaserTeamSim(world, np.array(s, float)[None], cfg, 100 * seed + j) for j, s in enumerate(starts)]
    todo = [list(way) for way in ways]
    t, truth, scans = [], [], []
    while len(t) < steps:
        t.append(sims[0].t)
        truth.append([sim.true_poses[0].copy() for sim in sims])
        scans.append([sim.scan(0) for sim in sims])
        if not any(todo):
            break
        for sim, way in zip(sims, todo, strict=True):
            sim.step(np.array([follow(sim.true_poses[0], way)]))
    told = np.array(starts, float)
    told[1:] += np.random.default_rng([seed, 1]).standard_normal((len(told) - 1, 3)) * [0.01, 0.01, 0.0087]
    return Drive(t, np.array(truth), scans, told, Walls.of(world.segments))


def follow(pose, way):
    """Towards the next point of the way; points reached are taken off it."""
    while way and np.hypot(*(way[0] - pose[:2])) < 0.25:
        way.pop(0)
    if not way:
        return 0.0, 0.0
    d = way[0] - pose[:2]
    turn = float(se2.wrap_angle(np.arctan2(d[1], d[0]) - pose[2]))
    return (0.6 * np.cos(turn) if abs(turn) < 0.8 else 0.0), float(np.clip(turn / 0.5, -1, 1))


def estimate(run, cfg=None, *, teammates=False, deliver=lambda k, j: True, after=None):
    """The team after the whole drive; `deliver(k, j)` says whether robot j's message of step k gets through."""
    cfg = cfg or LaserTeamConfig()
    team = LaserTeam(cfg if teammates else replace(cfg, teammate=0.0), run.starts)
    for k, t in enumerate(run.t):
        for j in range(len(run.starts)):
            team.add_scan(j, t, run.scans[k][j])
            if deliver(k, j):
                team.deliver(j)
        team.optimise()
        if after is not None:
            after(k, team)
    team.optimise(force=True)
    return team


def errors(team, run):
    """(n, 3) of the keyframes' poses, and their NEES a degree of freedom without the first, which `map` hangs on."""
    at = np.searchsorted(run.t, team.stamp)
    e = team.graph().pose - run.truth[at, team.owner]
    e[:, 2] = se2.wrap_angle(e[:, 2])
    P = team.covariances()
    return e, float(np.mean([a @ np.linalg.solve(p, a) for a, p in zip(e[1:], P[1:], strict=True)]) / 3)


def wall_distance(team, run, resolution=0.1):
    """(n,) distance [m] of every occupied cell of the merged map to the nearest true wall."""
    grid = team.grid(resolution)
    row, col = np.nonzero((grid.hits > 1) & (grid.occupancy() > 0.5))
    return run.walls.clearance(grid.origin + resolution * (np.column_stack([col, row]) + 0.5))
