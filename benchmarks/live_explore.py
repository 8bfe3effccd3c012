"""Simulated robots of a live team drive where `live explore` sends them: how far they get, and what they are told.

    python benchmarks/live_explore.py [--robots 1,2,4] [--area 150] [--rate 2] [--seconds 240] [--floor 0]

The map process is a process of its own. Robots stand in one office and are `LiveLaser`s of this one: each tells a scan
of 360 beams every half second of driving, asks for its place, its goal and the map (cells of 0.2 m), and takes the next
command on the way there; it knows nothing of the world but that. All starts are told the map process. `--rate`: seconds
of driving in one by the clock. Robots in maps apart drive on after `--seconds`, until they have been in one for 20 s.
Robots a step from each other move by turns, as if each heard that another is near: half a second is long to react in.

Seen: of the ground that robots reach, what the team's map shows as free in the end. Place off: the robots' places in
the team's map against the truth, every half second of driving. Processor: of the map process until the end.
"""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import mapweave
from mapweave.api.live_explore import LEVEL, WALL
from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.core.workers import keep_one_blas_thread
from mapweave.evaluation.building import known_at, survey_building
from mapweave.exploration.laser.config import LaserPlan
from mapweave.exploration.laser.frontiers import mapped_ground
from mapweave.exploration.laser.mission import points_of, route_to
from mapweave.exploration.laser.planners import FOLLOW_LOOKAHEAD, GUARD, candidate_commands, collision_free, steer
from mapweave.live.transport import LISTENING
from mapweave.sim.laser import START_NS
from mapweave.sim.laser_team import LaserRobotsConfig, LaserTeamSim
from mapweave.sim.laser_worlds import office_floor

CFG = LaserPlan()
WAY_AGAIN = 4  # steps until the way to a goal is looked for anew: the map has grown
STUCK = 8  # steps on one spot with a goal
ASIDE = 5  # steps away from what is near, then
TOGETHER = 20.0  # [s] that they drive on for once they are in one map,
LONGER = 4.0  # but no more than so many times as long as is asked: a slow machine ties them late, or chance does
NOBODY = np.zeros((0, 2))
START = START_NS / 1e9  # [s]


@dataclass
class Driver:
    """One robot: what it knows is what its team tells it and its own scan. errors: [m] of its place, at each step."""

    name: str
    robot: mapweave.LiveLaser
    way: object = None
    to: tuple[int, int] | None = None
    planned: int = -1000
    goals: int = 0
    still: int = 0
    aside: int = 0
    errors: list[float] = field(default_factory=list)

    def command(self, step: int, points: np.ndarray) -> np.ndarray:
        """What it does next, `points` (k, 2) being around it."""
        place, goal = self.robot.place, self.robot.team.goal(self.name)
        if place is None or place.pose is None or goal is None or goal.part != place.part:
            return np.zeros(2)
        others = [
            r.pose[:2]
            for r in self.robot.team.robots().values()
            if r.pose is not None and r.part == place.part and r.name != self.name
        ]
        if self.to != (goal.part, goal.number) or step >= self.planned + WAY_AGAIN:
            self.goals += self.to != (goal.part, goal.number)
            self.to, self.planned = (goal.part, goal.number), step
            grid = self.robot.team.grid(goal.part, LEVEL)
            if grid is None:
                return np.zeros(2)
            ground = mapped_ground(grid.planned_on(WALL), place.pose[None, :2], NOBODY, CFG)
            self.way = route_to(ground, goal.pose[:2], np.array(others).reshape(-1, 2), CFG)
        target = self.way.target(place.pose[:2], FOLLOW_LOOKAHEAD)
        if target is None or np.hypot(*(target - place.pose[:2])) < 0.5 * CFG.resolution:
            return np.zeros(2)
        u = steer(place.pose, target, points, np.array(others).reshape(-1, 2), CFG)
        self.still = 0 if u[0] else self.still + 1
        self.aside = ASIDE if self.still >= STUCK else self.aside - 1
        return away_from(points) if self.aside > 0 else u


def away_from(points: np.ndarray) -> np.ndarray:
    """The way out of a doorway that is too near on one side: the command that ends farthest from everything."""
    commands, ends = candidate_commands(CFG)
    free, _ = collision_free(commands, points, CFG.radius + GUARD, CFG)
    room = np.hypot(*(ends[:, None, :2] - points).transpose(2, 0, 1)).min(axis=1) if len(points) else ends[:, 0]
    return commands[np.argmax(np.where(free, room, -np.inf))]


def in_turns(commands: np.ndarray, places: np.ndarray, step: int) -> np.ndarray:
    """The commands, but robots so near to one another that both could drive into each other move one at a time."""
    near = np.hypot(*(places[:, None] - places).T) < 2 * (CFG.radius + CFG.speed * CFG.period + GUARD)
    turn = (step + np.arange(len(places))) % len(places) == 0
    return np.where(((near.sum(axis=0) == 1) | turn)[:, None], commands, 0.0)


@contextlib.contextmanager
def mapping(folder: Path, starts: np.ndarray):
    """A map process, and where it listens."""
    words = [sys.executable, "-m", "mapweave", "live", "map", "--out", str(folder / "out")]
    for k, start in enumerate(starts, 1):
        x, y, theta = se2.between(starts[0], start)
        words.append(f"--start=r{k}={x:.3f},{y:.3f},{theta:.4f},0.05")
    words += ["--listen", "tcp/127.0.0.1:0"]
    env = {**os.environ, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
    log = (folder / "map.log").open("w")
    with subprocess.Popen(words, stdout=log, stderr=subprocess.STDOUT, env=env) as process:
        try:
            while LISTENING not in (folder / "map.log").read_text():
                if process.poll() is not None:
                    raise SystemExit((folder / "map.log").read_text())
                time.sleep(0.05)
            yield process, (folder / "map.log").read_text().split(LISTENING)[1].split()[0]
        finally:
            process.send_signal(signal.SIGINT)
            process.wait()
            log.close()


def explored(robots: int, area: float, rate: float, seconds: float, floor: int = 0, say=lambda _: None) -> dict:
    """One team, until nothing is left to see or `seconds` of driving are over; longer while they are in maps apart."""
    office = office_floor(area, floor)
    starts = office.starts[:robots]
    sim = LaserTeamSim(office.world, starts, LaserRobotsConfig(), floor)
    walls = Walls(office.world.segments, office.world.reflectance, office.world.solid)
    building = survey_building(walls, office.lower, office.upper, starts, CFG.radius, sim.cfg.scanner.far)
    done, said = threading.Event(), []
    with tempfile.TemporaryDirectory() as home, contextlib.ExitStack() as stack:
        folder = Path(home)
        process, at = stack.enter_context(mapping(folder, starts))
        network = mapweave.Network(connect=(at,))
        drivers = [Driver(f"r{k}", stack.enter_context(live(f"r{k}", folder, network))) for k in range(1, robots + 1)]

        def send() -> None:
            mapweave.live_explore(network=network, stop=done, say=said.append)

        sending = threading.Thread(target=send)
        sending.start()
        begin = time.monotonic()
        try:
            apart = START  # when they were last
            while sending.is_alive() and sim.t - START < min(max(seconds, apart - START + TOGETHER), LONGER * seconds):
                scans = [sim.scan(j) for j in range(robots)]
                for driver, scan in zip(drivers, scans, strict=True):
                    tell(driver.robot, sim.t, scan)
                places = [driver.robot.place for driver in drivers]
                apart = apart if {place and place.part for place in places} == {1} else sim.t
                for j, (driver, place) in enumerate(zip(drivers, places, strict=True)):
                    there = place is not None and places[0] is not None
                    if there and places[0].part == place.part == 1:  # in the first one's frame
                        off = se2.between(se2.between(starts[0], sim.true_poses[j]), place.pose)
                        driver.errors.append(float(np.hypot(*off[:2])))
                time.sleep(max(0.0, begin + sim.steps * CFG.period / rate - time.monotonic()))
                asked = np.array([d.command(sim.steps, points_of(s)) for d, s in zip(drivers, scans, strict=True)])
                sim.step(in_turns(asked, sim.true_poses[:, :2], sim.steps))
        finally:
            done.set()
            sending.join()
        team = drivers[0].robot.team
        grid, parts = team.grid(1, LEVEL), [robot.part for robot in team.robots().values()]
        cpu = sum(map(int, Path(f"/proc/{process.pid}/stat").read_text().split()[13:15])) / os.sysconf("SC_CLK_TCK")
        seen = 0.0
        if grid is not None:
            free = grid.planned_on(WALL).free
            places = se2.act(se2.inverse(starts[0]), building.places()[::7])
            seen = float(known_at(np.asarray(places), free, grid.origin, grid.resolution).mean())
        for line in said:
            say(line)
    errors = np.concatenate([d.errors for d in drivers])
    return {
        "robots": robots,
        "area": building.area,
        "seconds": sim.t - START,
        "ended": any("nothing is left" in line for line in said),
        "seen": seen,
        "goals": sum(d.goals for d in drivers),
        "collisions": int(sim.collisions.sum()),
        "off_p50": float(np.median(errors)) if len(errors) else np.nan,
        "off_p99": float(np.quantile(errors, 0.99)) if len(errors) else np.nan,
        "tied": parts.count(1),
        "cpu": cpu,
    }


def live(name: str, folder: Path, network: mapweave.Network) -> mapweave.LiveLaser:
    quiet = {"linger": 5.0, "say": lambda _: None}
    return mapweave.LiveLaser(name, period=0.5, history=folder / name, level=LEVEL, network=network, **quiet)


def tell(robot: mapweave.LiveLaser, t: float, scan) -> None:
    given = {"odometry": scan.odometry, "range_max": scan.range_max}
    robot.add_scan(t, np.where(scan.hit, scan.ranges, np.inf), scan.angles(), **given)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="1,2,4")
    parser.add_argument("--area", type=float, default=150.0, help="of the office [m^2]")
    parser.add_argument("--rate", type=float, default=2.0, help="seconds of driving in one by the clock")
    parser.add_argument("--seconds", type=float, default=240.0, help="of driving, for robots in one map")
    parser.add_argument("--floor", type=int, default=0, help="seed of the office")
    parser.add_argument("--say", action="store_true", help="print the goals too")
    given = parser.parse_args()
    keep_one_blas_thread()
    head = [
        "robots",
        "reached",
        "until",
        "seen",
        "goals",
        "collisions",
        "place off, p50",
        "p99",
        "in one map",
        "processor",
    ]
    print(f"| {' | '.join(head)} |", "|---" * len(head) + "|", sep="\n")
    say = print if given.say else lambda _: None
    for robots in map(int, given.robots.split(",")):
        r = explored(robots, given.area, given.rate, given.seconds, given.floor, say)
        until = f"{r['seconds']:.0f} s" + ("" if r["ended"] else ", not at an end")
        print(
            f"| {robots} | {r['area']:.0f} m2 | {until} | {100 * r['seen']:.0f} % | {r['goals']} | {r['collisions']} |"
            f" {r['off_p50']:.2f} m | {r['off_p99']:.2f} m | {r['tied']} | {r['cpu']:.0f} s |",
            flush=True,
        )


if __name__ == "__main__":
    main()
