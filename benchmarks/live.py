"""Load of one map process: N robots tell it their logs at real time and faster; what it costs and how late it is.

    python benchmarks/live.py [--cases laser:1,5,20,50:1/laser:10:4] [--seconds 30] [--out DIR]

A case is a sensor, numbers of robots, and the rate: seconds of driving in one second. The map process is a process of
its own; all robots are sessions of this one, which tells what real robots would (rows or scans, statuses, snapshots,
computed beforehand, so that only the map process's work is measured). The map process is told all names, as a team of
more than 64 must. Robots of an office (`laser`) drive rounds from one dock, which the map process is told; then the
next round. Those with a `scanner` of 360 beams all round that looks ten times a second do as well, and nobody tells
where they begin. `--out` writes figures and curves too, `--drawn` draws them anew.

Heard: from putting a message on the network until it is in its place in the map process's store. In the map: until the
process has told a map that holds it. Processor and memory are those of the map process, all its threads. In one map:
the robots of its largest part at the end.
"""

import argparse
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from mapweave.api.laser_result import starts_among
from mapweave.core import se2
from mapweave.core.landmark_log import LandmarkLog
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.core.workers import keep_one_blas_thread
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.mrclam import write_mrclam
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.live import inbox as inboxes
from mapweave.live.door import MOST_BEAMS
from mapweave.live.landmark_stream import LandmarkRobot
from mapweave.live.laser_team import compile_kernels
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import LARGEST, Header, MapState, Message, ScanBeams, Scans, Status, Topics, encode, squeeze
from mapweave.live.robot import pause_after
from mapweave.live.sources import messages
from mapweave.live.store import Store
from mapweave.live.tiles import SIDE
from mapweave.live.transport import Network, put, session
from mapweave.mapping.merge_search import MergeConfig
from mapweave.sim.landmarks import TeamWorld, simulate_team
from mapweave.sim.laser import DriveConfig, Scanner, drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

CASES = "laser:1,5,20,50:1/laser:10:4/scanner:1,5,10,20,50:1/landmarks:1,20,50:1"
WAYS = {"landmarks": 50, "laser": 6, "scanner": 6}  # simulated logs; others tell them again under their own names
FINE = Scanner(beams=360, opening=2 * np.pi * 359 / 360, far=12.0)
DRIVES = {  # two scans a second as the office has them; ten a second of a scanner that looks all round
    "laser": OfficeConfig().drive,
    "scanner": DriveConfig(scan_every=0.05, odometry_every=0.05, scanner=FINE),
}
HIDDEN = {"scanner"}  # nobody tells where these begin
PERIOD = 1.0
EXPECTED = {"p99_s": 2.0, "kB_a_robot_minute": 1000.0}
STYLE = {"landmarks": "o--", "laser": "s-", "scanner": "^-"}
Row = dict[str, float | str | list]


@dataclass
class Told:
    """One message of a robot: when [s] after the start, under which key, what."""

    at: float
    topic: str
    message: Message


@cache
def one_round(k: int, world: int = 0, sensor: str = "laser") -> tuple[LaserLog, Track]:
    """Robot k's round through the office of seed `world`, and where it was."""
    made = drive(office_world(OfficeConfig(), world), office_route(OfficeConfig(), k), DRIVES[sensor], k)
    return replace(made.log, robot=f"robot{k}"), made.truth


def rounds(k: int, seconds: float, world: int = 0, sensor: str = "laser") -> LaserLog:
    """As many rounds as `seconds` take, one after the other; the odometry goes on from round to round."""
    log, truth = one_round(k, world, sensor)
    back = se2.between(truth.pose[-1], truth.pose[0])
    lasts = log.odometry.t[-1] - log.odometry.t[0] + 0.2
    scans, scan_t, odo_t, odo = [], [], [], []
    origin, shift = np.zeros(3), 0.0
    while shift < seconds:
        first = log.odometry.pose[0]
        moved = np.asarray(se2.compose(origin, se2.between(first, log.odometry.pose)))
        for t, scan in zip(log.scan_t, log.scans, strict=True):
            pose = np.asarray(se2.compose(origin, se2.between(first, scan.odometry)))
            scans.append(replace(scan, odometry=pose))
            scan_t.append(t + shift)
        odo_t.append(log.odometry.t + shift)
        odo.append(moved)
        origin, shift = np.asarray(se2.compose(moved[-1], back)), shift + lasts
    track = Track(np.concatenate(odo_t), np.concatenate(odo), frame="odom")
    return replace(log, scan_t=np.array(scan_t), scans=tuple(scans), odometry=track)


@cache
def team(seed: int) -> dict[str, LandmarkLog]:
    """The landmark robots of one world, all on ways of their own."""
    with tempfile.TemporaryDirectory() as folder:
        write_mrclam(Path(folder), simulate_team(TeamWorld(robots=WAYS["landmarks"]), seed))
        return {log.robot: log for log in read_landmark_logs(Path(folder))}


def prepared(sensor: str, k: int, seconds: float, rate: float, world: int = 0) -> list[Told]:
    """What robot k of the simulated team tells in `seconds` by the clock, `rate` times as fast as it drove."""
    log = rounds(k, seconds * rate, world, sensor) if sensor in DRIVES else team(world)[f"robot{k}"]
    out, robot, begin = [], None, None
    snapshot_due = 0.0
    for t, message in messages(log, f"r{k}", "run", PERIOD):
        begin = t if begin is None else begin
        at = (t - begin) / rate
        if at > seconds:
            break
        out.append(Told(at, "log", message))
        if isinstance(message, Header):
            robot = LandmarkRobot(message, EkfSlamConfig()) if sensor == "landmarks" else None
        elif robot is not None:
            robot.add(message)
            if at >= snapshot_due:
                out.append(Told(at, "snapshot", robot.snapshot()))
                snapshot_due = at + pause_after(len(encode(out[-1].message)))
    kind = "landmarks" if sensor == "landmarks" else "laser"
    pose = {"pose": (0.0, 0.0, 0.0), "cov": (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)}
    for at in np.arange(0.0, seconds, 0.5).tolist():
        seq = max((m.message.seq for m in out if m.topic == "log" and m.at <= at), default=0)
        status = Status(robot=f"r{k}", run="run", sensor=kind, last=seq, clock=0.0, t=at, **pose)
        out.append(Told(at, "status", status))
    return sorted(out, key=lambda told: told.at)


def renamed(message: Message, name: str, number: int) -> bytes:
    """The same message of another robot, whose history is another too."""
    changed = msgspec.structs.replace(message, robot=name, run=f"run of {name}")
    return encode(
        msgspec.structs.replace(changed, log_robot=f"robot{number}") if isinstance(changed, Header) else changed
    )


def measured(sensor: str, robots: int, rate: float, seconds: float, *, flood: bool = False) -> Row:
    """One run of `robots` robots, which begin within a second of each other as real ones would.

    flood: a stranger, in a process of its own, tells whatever takes room, as fast as it can.
    """
    ways = min(robots, WAYS[sensor])
    base = [prepared(sensor, k, seconds, rate) for k in range(1, ways + 1)]
    every = [
        (
            told.at + (k % 10) / 10,
            f"r{k}",
            told.topic,
            renamed(told.message, f"r{k}", k),
            getattr(told.message, "seq", None),
        )
        for k in range(1, robots + 1)
        for told in base[(k - 1) % ways]
    ]
    every.sort(key=lambda one: one[0])
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--mapping", folder, *(["--hidden"] if sensor in HIDDEN else [])]
        command += ["--expected", ",".join(f"r{k}" for k in range(1, robots + 1))]
        mapping = subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
        while not Path(folder, "ready").exists():
            if mapping.poll() is not None:
                raise SystemExit("the map process did not begin")
            time.sleep(0.1)
        at = Path(folder, "ready").read_text()
        stranger = subprocess.Popen([sys.executable, __file__, "--flooding", at]) if flood else None
        sent = told_by_all(every, robots, at)
        time.sleep(3.0)
        if stranger is not None:
            stranger.kill()
            stranger.wait()
        waited_for(Path(folder, "count"), len(sent), 30.0)
        mapping.terminate()
        mapping.wait()
        found = json.loads(Path(folder, "placed.json").read_text())
    heard = {(r, s): t for r, s, t in found["placed"]}
    mapped = in_the_map(found["mapped"], sent)
    late = np.array([heard[key] - t for key, t in sent.items() if key in heard])
    shown = np.array([mapped[key] - t for key, t in sent.items() if key in mapped])
    minutes = robots * seconds * rate / 60
    size = sum(len(payload) for *_, payload, _ in every)
    return {
        "sensor": sensor,
        "robots": robots,
        "rate": rate,
        "seconds": seconds,
        "lost": len(sent) - len(late),
        "not_shown": len(sent) - len(shown),
        "heard_p50_s": float(np.median(late)),
        "heard_p99_s": float(np.quantile(late, 0.99)),
        "p50_s": float(np.median(shown)) if len(shown) else float("nan"),
        "p99_s": float(np.quantile(shown, 0.99)) if len(shown) else float("nan"),
        "kB_a_robot_minute": size / minutes / 1e3,
        "cpu_s_a_robot_minute": found["cpu"] / minutes,
        "cores": found["cpu"] / seconds,
        "memory_MB": found["memory_kB"] / 1024,
        "tied": found["tied"],
        "load_before": os.getloadavg()[2],
        "over_time": found["over_time"],
        "refused": found["refused"],
    }


def waited_for(count: Path, messages: int, seconds: float) -> None:
    """Until so many messages are in their places, but not for longer: a loaded machine hears late what it hears."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        told = count.read_text().split() if count.exists() else []
        if len(told) == 2 and int(told[0]) >= messages:
            return
        time.sleep(0.1)


def flooding(at: str) -> None:
    """Without end: nonsense of a megabyte, invented robots and maps, numbers far ahead, scans of 20,000 beams."""
    beams = squeeze(np.full(MOST_BEAMS, 5.0))
    scan = ScanBeams(
        t=1.0, n=MOST_BEAMS, ranges=beams, hit=b"\xff" * (MOST_BEAMS // 8), light=None, angle_min=0.0,
        angle_increment=3e-4, range_max=10.0, mount=(0.0, 0.0, 0.0), host="", odometry=(0.0, 0.0, 0.0),
        heading=None,
    )  # fmt: skip
    first = {"run": "a", "sensor": "laser", "source": "", "odometry": True}
    junk, topics = np.random.default_rng(1).bytes(LARGEST), Topics("team")
    where = {"pose": (0.0, 0.0, 0.0), "cov": (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)}
    with session(Network(connect=(at,), extra={"mode": "router"})) as opened:
        for k in itertools.count():
            name = f"s{k % 5000}"
            put(opened, topics.log(name), junk)
            put(opened, topics.log(name), encode(Header(robot=name, log_robot=f"robot{1000 + k % 5000}", **first)))
            scans = [msgspec.structs.replace(scan, t=float(k + j)) for j in range(20)]
            for seq in (1, 1 + k // 5000, 2 + k):
                put(opened, topics.log(name), encode(Scans(robot=name, run="a", seq=seq, scans=scans)))
            status = Status(robot=name, run="a", sensor="laser", last=1 << 40, clock=0.0, t=0.0, **where)
            put(opened, topics.status(name), encode(status))
            state = MapState(map=name, clock=0.0, fused=1, robots=[], landmarks=[], decisions=["x" * 4000] * 200)
            put(opened, topics.map_state(name), encode(state))


def in_the_map(mapped: list, sent: dict[tuple[str, int], float]) -> dict[tuple[str, int], float]:
    """When each message was first in a map that was told."""
    out: dict[tuple[str, int], float] = {}
    begun: dict[str, int] = {}
    for robot, until, t in mapped:
        for seq in range(begun.get(robot, 0), until):
            if (robot, seq) in sent:
                out[robot, seq] = t
        begun[robot] = max(until, begun.get(robot, 0))
    return out


def told_by_all(every: list, robots: int, at: str) -> dict[tuple[str, int], float]:
    """All messages put at their time, each robot through a session of its own; when each numbered one was put."""
    topics, sent = Topics("team"), {}
    opened = [session(Network(connect=(at,))) for _ in range(robots)]
    own = {f"r{k}": s.__enter__() for k, s in enumerate(opened, 1)}
    try:
        time.sleep(1.0)
        begin = time.monotonic()
        for due, robot, topic, payload, seq in every:
            time.sleep(max(0.0, begin + due - time.monotonic()))
            if topic == "log":
                sent[robot, seq] = time.time()
            put(own[robot], getattr(topics, topic)(robot), payload)
    finally:
        for s in opened:
            s.__exit__(None, None, None)
    return sent


class Timed(inboxes.Inbox):
    """An inbox that notes when each message was in its place and on disk."""

    def __init__(self, store: Store, expected: list[str] | None, count: Path) -> None:
        self.count = count
        self.placed: list[tuple[str, int, float]] = []
        self.fresh: list[tuple[str, int]] = []
        super().__init__(store, expected)

    def _work_in(self, ledger, fresh, seq) -> None:
        super()._work_in(ledger, fresh, seq)
        self.fresh.append((ledger.robot, ledger.next - 1))

    def save(self) -> None:
        super().save()
        now = time.time()
        self.placed += [(robot, seq, now) for robot, seq in self.fresh]
        self.fresh = []
        self.count.write_text(f"{len(self.placed)} messages")


class TimedMap(MapProcess):
    """A map process that notes what was in each map it told, and how it grew."""

    def __init__(self, *args) -> None:
        super().__init__(*args)
        self.mapped: list[tuple[str, int, float]] = []
        self.over_time: list[tuple[float, float, float, float]] = []
        self.begin = time.monotonic()

    def tell_state(self) -> None:
        super().tell_state()
        self._note({name: seq + 1 for name, seq in self.shared.used.items()})
        squares = sum(key[1] == 0 for key in self.shared.tiles)
        area = squares * (SIDE * self.shared.resolution) ** 2
        self.over_time.append((time.monotonic() - self.begin, time.process_time(), memory("VmRSS"), area))

    def _tell_corrections(self) -> None:
        super()._tell_corrections()
        if self._woven is not None:
            self._note(self._woven.worked)

    def _note(self, worked: Mapping[str, int]) -> None:
        now = time.time()
        self.mapped += [(robot, until, now) for robot, until in worked.items()]


def memory(which: str) -> float:
    """[kB] of this process alone, other than what getrusage tells."""
    return int(Path("/proc/self/status").read_text().split(f"{which}:")[1].split()[0])


def mapping(folder: Path, *, hidden: bool, expected: list[str] | None = None) -> None:
    """The map process under load, until it is terminated; expected: robots that it hears, all when None."""
    keep_one_blas_thread()
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    warmed()
    network, at = Network(listen=("tcp/127.0.0.1:0",)), list[str]()
    with Store(folder / "map.sqlite", "a map of team") as store, session(network, at.append) as opened:
        inbox = Timed(store, expected, folder / "count")
        process = TimedMap("map", opened, Topics("team"), store, inbox, lambda _: None)
        if not hidden:
            process.starts = lambda names: starts_among(names, dict.fromkeys(names, (0.0, 0.0, 0.0)), MergeConfig())
        process.join()
        before = time.process_time()
        (folder / "coming").write_text(at[0])
        (folder / "coming").rename(folder / "ready")
        process.run(stop, 2.0, lambda _: False)
        cpu = time.process_time() - before
    largest = [p.component for p in process.shared.placed.values()]
    told = {
        "placed": inbox.placed,
        "mapped": process.mapped,
        "cpu": cpu,
        "memory_kB": memory("VmHWM"),
        "tied": largest.count(1),
        "over_time": process.over_time,
        "refused": process.state().refused,
    }
    (folder / "placed.json").write_text(json.dumps(told))


def warmed() -> None:
    """Kernels are there: what a first run compiles is no part of the load."""
    with tempfile.TemporaryDirectory() as folder:
        compile_kernels(Path(folder, "s"))


def table(rows: list[Row]) -> str:
    """Markdown."""
    head = ["robots", "sensor", "rate", "heard, p99", "in the map, p50", "p99", "a robot-minute"]
    head += ["processor a robot-minute", "cores", "memory", "in one map"]
    lines = [
        f"| {r['robots']} | {r['sensor']} | {r['rate']:g} | {1e3 * r['heard_p99_s']:.0f} ms | {r['p50_s']:.2f} s |"
        f" {r['p99_s']:.2f} s | {r['kB_a_robot_minute']:.0f} kB | {r['cpu_s_a_robot_minute']:.2f} s |"
        f" {r['cores']:.2f} | {r['memory_MB']:.0f} MB | {r['tied']} |"
        for r in rows
    ]
    return "\n".join([f"| {' | '.join(head)} |", "|---" * len(head) + "|", *lines])


def drawn(rows: list[Row], path: Path) -> None:
    """Curves over the number of robots at real time, and memory beside the area over time."""
    import matplotlib.pyplot as plt

    plt.switch_backend("Agg")
    figure, axes = plt.subplots(2, 3, figsize=(11, 6), layout="constrained")
    wanted = (
        ("p99_s", "from robot to map, 99 % [s]"),
        ("kB_a_robot_minute", "sent by a robot in a minute [kB]"),
        ("cores", "processor [cores]"),
        ("memory_MB", "memory [MB]"),
    )
    for axis, (name, label) in zip(axes.flat, wanted, strict=False):
        for sensor in WAYS:
            at = [r for r in rows if r["sensor"] == sensor and r["rate"] == 1.0]
            axis.plot([r["robots"] for r in at], [r[name] for r in at], STYLE[sensor], label=sensor)
        if name in EXPECTED:
            axis.axhline(EXPECTED[name], color="0.6", lw=1, label="allowed")
        axis.set(xlabel="robots", ylabel=label, ylim=(0, None))
    axes[0, 0].legend(frameon=False, loc="lower right")
    for r in (r for r in rows if r["sensor"] == "laser" and r["over_time"]):
        t, _, kB, area = np.array(r["over_time"]).T
        label = f"{r['robots']} robot{'s' * (r['robots'] > 1)}" + (
            f", {r['rate']:g} times as fast" * (r["rate"] != 1.0)
        )
        for axis, curve, name in ((axes[1, 1], kB / 1024, "memory [MB]"), (axes[1, 2], area, "area drawn [m²]")):
            axis.plot(t * r["rate"] / 60, curve, label=label)
            axis.set(xlabel="minutes driven", ylabel=name, ylim=(0, None))
    axes[1, 1].legend(frameon=False, fontsize=7)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", default=CASES)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--flood", action="store_true", help="a stranger tells whatever takes room meanwhile")
    parser.add_argument("--flooding", help="be that stranger, of the team at this endpoint")
    parser.add_argument("--expected", help="of --mapping: the robots that are heard")
    parser.add_argument("--hidden", action="store_true", help="of --mapping: nobody tells where robots begin")
    for folder in ("--out", "--mapping", "--drawn"):
        parser.add_argument(folder, type=Path)
    given = parser.parse_args()
    if given.drawn is not None:
        drawn(json.loads((given.drawn / "live-load.json").read_text()), given.drawn / "live-load.png")
    elif given.mapping is not None:
        mapping(given.mapping, hidden=given.hidden, expected=given.expected and given.expected.split(","))
    elif given.flooding is not None:
        flooding(given.flooding)
    rows: list[Row] = []
    for case in given.cases.split("/") if given.drawn is given.mapping is None else ():
        sensor, numbers, rate = case.split(":")
        for robots in map(int, numbers.split(",")):
            rows.append(measured(sensor, robots, float(rate), given.seconds, flood=given.flood))
            told = {name: value for name, value in rows[-1].items() if name != "over_time"}
            print(json.dumps(told), file=sys.stderr, flush=True)
    print(table(rows) if rows else "")
    if rows and given.out is not None:
        (given.out / "live-load.json").write_text(json.dumps(rows, indent=1) + "\n")
        drawn(rows, given.out / "live-load.png")


if __name__ == "__main__":
    main()
