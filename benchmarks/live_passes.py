"""What a map process of N laser robots does while they drive, without a network: processor time of its passes.

    python benchmarks/live_passes.py [--robots 50] [--seconds 30] [--apart | --table | --scanners | --growth 50:10]

The weaver of a map process runs on a clock of its own, which stands still but for what it computes and what it waits
for, so that other work on the machine changes nothing: a message is there when this clock says so, and what takes place
beside (solving the graph of all, searching for ties) does so as on a processor of its own. Printed are the times of
each kind of pass, how late a message is in the map on that clock, how many robots hang together as time goes, how far
off the truth their ties are, and what memory came up.
"""

import argparse
import cProfile
import gc
import pstats
import tempfile
import time
from collections import defaultdict
from concurrent.futures import Future
from pathlib import Path

import numpy as np

from live import memory, one_round, prepared, renamed, warmed
from mapweave.api.laser_result import starts_among
from mapweave.core import se2
from mapweave.core.workers import keep_one_blas_thread
from mapweave.live import laser_weaver
from mapweave.live.inbox import Inbox
from mapweave.live.laser_weaver import LaserWeaver
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import Topics, encode
from mapweave.live.store import Store
from mapweave.live.transport import Network, session
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.merge_search import MergeConfig

WRONG = 0.5  # [m] that a closure of two robots is off the truth


class Clock:
    """Processor time of this thread, and what was waited for [s]. aside: what is reckoned to another processor."""

    def __init__(self) -> None:
        self.waited = self.aside = 0.0
        self.begin = time.thread_time()

    def monotonic(self) -> float:
        return time.thread_time() - self.begin + self.waited - self.aside


class Beside:
    """An executor whose work is done at once, and said to be done when another processor would have done it.

    took: processor seconds of each piece of work by its kind.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock, self.free = clock, 0.0
        self.took: dict[str, list[float]] = defaultdict(list)
        self.ends: list[tuple[float, Future, object]] = []

    def submit(self, work) -> Future:
        at, begin, future = self.clock.monotonic(), time.thread_time(), Future()
        try:
            found = work()
        except Exception as error:  # noqa: BLE001  (it is the future's)
            found = error
        took = time.thread_time() - begin
        self.clock.aside += took
        self.took[type(work.__self__).__name__].append(took)
        self.free = max(at, self.free) + took
        self.ends.append((self.free, future, found))
        return future

    def settle(self) -> None:
        while self.ends and self.ends[0][0] <= self.clock.monotonic():
            _, future, found = self.ends.pop(0)
            future.set_exception(found) if isinstance(found, Exception) else future.set_result(found)

    def shutdown(self, **_) -> None:
        """Nothing is under way."""


class Team(laser_weaver.LiveLaserTeam):
    """A team whose passes are timed: `took` is told of each its name and processor seconds."""

    def follow(self, heard):
        return self._timed("follow", super().follow, heard)

    def trial(self):
        return self._timed("trial", super().trial)

    def weaving(self):
        return self._timed("weaving", super().weaving)

    def draw(self, heard):
        out = self._timed("draw", super().draw, heard)
        self.drawn(out)
        return out

    def _timed(self, name, work, *args):
        begin = time.thread_time()
        out = work(*args)
        self.took[name].append(time.thread_time() - begin)
        return out


class Clocked(LaserWeaver):
    """A weaver that hears messages when `clock` says they come: (second, robot, number), in order."""

    def __init__(self, store, cfg, starts, clock, coming, payloads) -> None:
        super().__init__(store, cfg, 2.0, starts)
        self._team = Team(store, self._team.cfg, starts)
        self._team.took, self._team.drawn = defaultdict(list), self._drawn
        self._beside = Beside(clock)
        laser_weaver.beside = self._beside.submit
        self.clock, self.coming, self.payloads, self.put = clock, coming, payloads, 0
        self.before = memory("VmRSS")
        self.came: dict[str, int] = {}
        self.late: list[float] = []
        self.shown: dict[str, int] = {}
        self.when: dict[tuple[str, int], float] = {}
        self.grown: list[tuple[float, float]] = []
        self.tied: list[tuple[float, int]] = []

    @property
    def team(self) -> Team:
        return self._team

    def run(self) -> dict[str, list[float]]:
        """Until all is in the map; processor seconds of every pass by its kind."""
        self._run()
        return {**self._team.took, **self._beside.took}

    def _drawn(self, out) -> None:
        now = self.clock.monotonic()
        self.grown.append((now, memory("VmRSS")))
        self.tied.append((now, [p.component for p in out.placed.values()].count(1)))
        for robot, until in out.worked.items():
            for seq in range(self.shown.get(robot, 1), until):
                self.late.append(now - self.when[robot, seq])
            self.shown[robot] = until

    def _next(self, followed, due):
        self._arrived()
        if self.came == followed and not self._ready():
            if self.put == len(self.coming) and due == np.inf:
                return None
            coming = [self.coming[self.put][0]] if self.put < len(self.coming) else []
            ends = [self._beside.ends[0][0]] if self._beside.ends else []
            now = self.clock.monotonic()
            self.clock.waited += max(min([due, now + laser_weaver.PATIENCE, *coming, *ends]) - now, 0.001)
            self._arrived()
        self._beside.settle()
        return dict(self.came)

    def _ready(self) -> bool:
        return bool(self._beside.ends) and self._beside.ends[0][0] <= self.clock.monotonic()

    def _arrived(self) -> None:
        begin, batch = time.thread_time(), []
        while self.put < len(self.coming) and self.coming[self.put][0] <= self.clock.monotonic():
            at, robot, seq = self.coming[self.put]
            batch.append((robot, seq, self.payloads[robot, seq]))
            self.when[robot, seq] = at
            self.came[robot] = seq + 1
            self.put += 1
        if batch:
            self._team.store.put(batch)
        self.clock.aside += time.thread_time() - begin


def told(robots: int, seconds: float, rate: float, ways: int, world: int, sensor: str = "laser"):
    """When each message comes, in order, and what it says."""
    base = [prepared(sensor, k, seconds, rate, world) for k in range(1, min(robots, ways) + 1)]
    coming, payloads = [], {}
    for k in range(1, robots + 1):
        for one in base[(k - 1) % len(base)]:
            if one.topic != "log":
                continue
            name = f"r{k}"
            payloads[name, one.message.seq] = renamed(one.message, name, k)
            coming.append((one.at + (k % 10) / 10, name, one.message.seq))
    return sorted(coming), payloads


def off(weaver: Clocked, ways: int, world: int, sensor: str = "laser") -> list[float]:
    """How far the closures that hold two robots together are off the truth [m], of each tied pair the median."""
    out = []
    for (a, b), tried in weaver.team.search.tried.items():
        if not tried.merge.merged:
            continue
        sessions = [weaver.team.robots[name].session for name in (a, b)]
        rounds = [one_round((int(name[1:]) - 1) % ways + 1, world, sensor) for name in (a, b)]
        errors = []
        for c in tried.merge.closures:
            at = []
            for k, ids, driven_by, (log, truth) in zip((c.first, c.second), tried.ids, sessions, rounds, strict=True):
                seen = np.flatnonzero(driven_by.ids == ids[k])
                if len(seen):
                    lasts = log.odometry.t[-1] - log.odometry.t[0] + 0.2
                    first = log.odometry.t[0]
                    t = first + (driven_by.keyframes.nodes[int(seen[0])].t - first) % lasts
                    at.append(se2.interpolate(np.array([t]), truth.t, truth.pose)[0])
            if c.accepted and len(at) == 2:
                errors.append(float(np.hypot(*se2.between(se2.between(*at), c.measured)[:2])))
        out.append(float(np.median(errors)) if errors else np.nan)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--sensor", choices=("laser", "scanner"), default="laser", help="see benchmarks/live.py")
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--ways", type=int, default=6, help="simulated drives; further robots tell them again")
    parser.add_argument("--world", type=int, default=0, help="seed of the office")
    parser.add_argument("--apart", action="store_true", help="nobody says where the robots start from")
    parser.add_argument("--profile", action="store_true", help="where the time goes, by function")
    parser.add_argument("--table", action="store_true", help="ties in two offices, with starts told and without")
    parser.add_argument(
        "--growth",
        default="",
        help="robots and seconds of their drive as 50:10,1000:6: how each cost grows with the team",
    )
    parser.add_argument("--scanners", action="store_true", help="what robots with a `--sensor scanner` cost")
    given = parser.parse_args()
    keep_one_blas_thread()
    warmed()
    if given.table or given.scanners or given.growth:
        (table if given.table else scanners if given.scanners else growth)(given)
        return
    profile = cProfile.Profile() if given.profile else None
    weaver, passes = driven(given, profile)
    if profile is not None:
        pstats.Stats(profile).sort_stats("tottime").print_stats(40)
    tell(weaver, passes, given)
    t, kB = np.array(weaver.grown).T
    MB = (np.interp(given.seconds * np.arange(1, 6) / 5, t, kB) - weaver.before) / 1024
    each = ", ".join(f"{one:.0f}" for one in MB)
    print(f"memory after each fifth of the time {each} MB; {MB[-1] / given.robots:.1f} MB a robot in the end")


def driven(given: argparse.Namespace, profile: cProfile.Profile | None = None) -> tuple[Clocked, dict]:
    """A weaver after the whole drive, and the processor seconds of its passes."""
    coming, payloads = told(given.robots, given.seconds, given.rate, given.ways, given.world, given.sensor)
    gc.collect()
    clock = Clock()
    laser_weaver.time = clock

    def starts(names):
        return {} if given.apart else starts_among(names, dict.fromkeys(names, (0.0, 0.0, 0.0)), MergeConfig())

    with tempfile.TemporaryDirectory() as folder, Store(Path(folder, "s"), "a map") as store:
        weaver = Clocked(store, LaserConfig(), starts, clock, coming, payloads)
        return weaver, weaver.run() if profile is None else profile.runcall(weaver.run)


def table(given: argparse.Namespace) -> None:
    """Markdown: robots in one map over time, and what the search for ties took."""
    ends = [given.seconds * k / 4 for k in range(1, 5)]
    head = ["office", "starts", *(f"{end:g} s" for end in ends), "pairs tried", "tied", "wrongly", "processor"]
    print(f"| {' | '.join(head)} |", "|---" * len(head) + "|", sep="\n")
    for world in range(2):
        for apart in (False, True):
            case = argparse.Namespace(**{**vars(given), "world": world, "apart": apart})
            weaver, passes = driven(case)
            t, tied = np.array(weaver.tied).T
            each = [f"{int(tied[: np.searchsorted(t, end)].max(initial=0))}" for end in ends]
            wrong = np.array(off(weaver, given.ways, world))
            tries, cores = len(passes["PairTrial"]), sum(map(sum, passes.values())) / given.seconds
            row = [str(world), "unknown" if apart else "told", *each, str(tries), str(len(wrong))]
            print(f"| {' | '.join([*row, str(int(np.sum(wrong > WRONG))), f'{cores:.2f} cores'])} |", flush=True)


def scanners(given: argparse.Namespace) -> None:
    """Markdown: what robots of real scanners cost, whose starts nobody tells."""
    head = [
        "robots",
        "told by each",
        "processor a robot-minute",
        "cores",
        "in the map, p50",
        "p99",
        "memory",
        "in one map",
    ]
    print(f"| {' | '.join(head)} |", "|---" * len(head) + "|", sep="\n")
    for robots in (1, 5, 10, 20, 50):
        case = argparse.Namespace(**{**vars(given), "robots": robots, "sensor": "scanner", "apart": True})
        weaver, passes = driven(case)
        spent, late = sum(map(sum, passes.values())), np.array(weaver.late)
        told_kB = sum(map(len, weaver.payloads.values())) / 1e3 / robots / given.seconds
        parts = [p.component for p in weaver.newest.placed.values()]
        grown = (max(kB for _, kB in weaver.grown) - weaver.before) / 1024
        each, cores = spent / (robots * given.seconds / 60), spent / given.seconds
        print(
            f"| {robots} | {told_kB:.1f} kB/s | {each:.2f} s | {cores:.2f} |"
            f" {np.median(late):.2f} s | {np.quantile(late, 0.99):.2f} s | {grown:.0f} MB | {parts.count(1)} |",
            flush=True,
        )


def heard(robots: int, given: argparse.Namespace) -> tuple[float, float, int]:
    """Processor time a message in the inbox and of a state that is told [s], and the state's bytes."""
    coming, payloads = told(robots, given.seconds, given.rate, given.ways, given.world, given.sensor)
    names = [f"r{k}" for k in range(1, robots + 1)]
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder, "s"), "a map") as store:
        inbox = Inbox(store, names)
        begin = time.process_time()
        for k, (at, robot, seq) in enumerate(coming, 1):
            inbox.offer(robot, payloads[robot, seq], at)
            if k % robots == 0:
                inbox.save()
        offered = time.process_time() - begin
        with session(Network(listen=("tcp/127.0.0.1:0",))) as alone:
            process = MapProcess("map", alone, Topics("team"), store, inbox, lambda _: None)
            process.shared.meet(names)
            begin = time.process_time()
            state = encode(process.state())
            return offered / len(coming), time.process_time() - begin, len(state)


def growth(given: argparse.Namespace) -> None:
    """Markdown: what each thing costs a map process with so many robots, by replaying their messages alone."""
    head = ["robots", "a message in the inbox", "followed, a robot-minute", "drawn", "choosing a pair", "trying it"]
    head += ["solving", "a state told", "its size", "memory a robot", "in the map, p99", "cores"]
    print(f"| {' | '.join(head)} |", "|---" * len(head) + "|", sep="\n", flush=True)
    for row in given.growth.split(","):
        robots, seconds = int(row.split(":")[0]), float(row.split(":")[1])
        case = argparse.Namespace(**{**vars(given), "robots": robots, "seconds": seconds})
        message, state, size = heard(robots, case)
        weaver, passes = driven(case)
        minutes, late = robots * seconds / 60, np.quantile(weaver.late, 0.99)
        each = {name: float(np.median(passes[name])) for name in ("draw", "trial", "PairTrial", "Weaving")}
        grown = (max(kB for _, kB in weaver.grown) - weaver.before) / 1024 / robots
        cores = sum(map(sum, passes.values())) / weaver.clock.monotonic()
        print(
            f"| {robots} | {1e3 * message:.2f} ms | {sum(passes['follow']) / minutes:.2f} s | {each['draw']:.2f} s |"
            f" {each['trial']:.2f} s | {each['PairTrial']:.2f} s | {each['Weaving']:.2f} s | {1e3 * state:.0f} ms |"
            f" {size / 1e3:.0f} kB | {grown:.1f} MB | {late:.1f} s | {cores:.2f} |",
            flush=True,
        )


def tell(weaver: Clocked, passes: dict[str, list[float]], given: argparse.Namespace) -> None:
    """What it took."""
    minutes = given.robots * given.seconds * given.rate / 60
    print(f"{given.robots} robots, {given.seconds:g} s at {given.rate:g} times: {len(weaver.coming)} messages")
    for name, times in passes.items():
        took = np.array(times)
        print(
            f"{name:9} {len(took):5} times, {took.sum():6.2f} s, {took.sum() / minutes:.3f} s a robot-minute,"
            f" p50 {np.median(took):.3f} p99 {np.quantile(took, 0.99):.3f} longest {took.max():.3f}"
        )
    late = np.array(weaver.late)
    print(f"in the map: p50 {np.median(late):.2f} s, p99 {np.quantile(late, 0.99):.2f} s, most {late.max():.2f} s")
    parts = [p.component for p in weaver.newest.placed.values()]
    squares = sum(key[1] == 0 for key in weaver.newest.tiles)
    keyframes = sum(robot.size for robot in weaver.team.robots.values())
    print(f"tied: {parts.count(1)} of {len(parts)}; keyframes {keyframes}; squares {squares}")
    t, tied = np.array(weaver.tied).T
    ends = given.seconds * np.arange(1, 7) / 6
    each = ", ".join(f"{int(tied[: np.searchsorted(t, end)].max(initial=0))} by {end:.0f} s" for end in ends)
    wrong = np.array(off(weaver, given.ways, given.world, given.sensor))
    most = f", their closures up to {np.nanmax(wrong):.2f} m off" if len(wrong) else ""
    print(f"tied over time: {each}; {len(wrong)} pairs{most}, {np.sum(wrong > WRONG)} of them wrong")


if __name__ == "__main__":
    main()
