"""Load of one map process: N robots tell it their logs at real time and faster; what it costs and how late it is.

    python benchmarks/live.py [--sensor landmarks|laser] [--robots 1,5,20] [--rates 1,10] [--seconds 20]

The map process is a process of its own; all robots are sessions of this one, which tells what real robots would (rows
or scans, statuses, snapshots, computed beforehand), so that only the map process's work is measured. Latency: from
putting a message on the network until the map process has put it in its place and given it to its disk.
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from mapweave.landmarks.config import EkfSlamConfig
from mapweave.live import inbox as inboxes
from mapweave.live.landmark_robot import LandmarkRobot
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import Header, Message, Status, encode
from mapweave.live.sources import messages, open_source
from mapweave.live.store import Store
from mapweave.live.topics import Topics
from mapweave.live.transport import Network, put, session

WAYS = {"landmarks": 5, "laser": 2}  # simulated logs; further robots tell them again under their own names
PERIOD = 1.0


@dataclass
class Told:
    """One message of a robot: when [s] after the start, under which key, what."""

    at: float
    topic: str
    message: Message


def prepared(sensor: str, k: int, seconds: float, rate: float) -> list[Told]:
    """What robot k of the simulated team tells in `seconds` by the clock, `rate` times as fast as it drove."""
    log = open_source(f"sim:{'office' if sensor == 'laser' else 'landmarks'}", f"r{k}", None)
    out, robot, begin = [], None, None
    told_snapshot = 0.0
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
            if at - told_snapshot >= 2.0:
                told_snapshot = at
                out.append(Told(at, "snapshot", robot.snapshot()))
    pose = {"pose": (0.0, 0.0, 0.0), "cov": (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)}
    for at in np.arange(0.0, seconds, 0.5).tolist():
        seq = max((m.message.seq for m in out if m.topic == "log" and m.at <= at), default=0)
        status = Status(robot=f"r{k}", run="run", sensor=sensor, last=seq, clock=0.0, t=at, **pose)
        out.append(Told(at, "status", status))
    return sorted(out, key=lambda told: told.at)


def renamed(message: Message, name: str, number: int) -> bytes:
    """The same message of another robot."""
    changed = msgspec.structs.replace(message, robot=name)
    return encode(
        msgspec.structs.replace(changed, log_robot=f"robot{number}") if isinstance(changed, Header) else changed
    )


def measured(sensor: str, robots: int, rate: float, seconds: float) -> dict[str, float]:
    """One run of `robots` robots."""
    base = [prepared(sensor, k, seconds, rate) for k in range(1, WAYS[sensor] + 1)]
    every = [
        (told.at, f"r{k}", told.topic, renamed(told.message, f"r{k}", k), getattr(told.message, "seq", None))
        for k in range(1, robots + 1)
        for told in base[(k - 1) % len(base)]
    ]
    every.sort(key=lambda one: one[0])
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        at = f"tcp/127.0.0.1:{s.getsockname()[1]}"
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--mapping", folder, "--at", at]
        mapping = subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"})
        while not Path(folder, "ready").exists():
            time.sleep(0.1)
        sent = told_by_all(every, robots, at)
        time.sleep(2.0)
        mapping.terminate()
        _, _, usage = os.wait4(mapping.pid, 0)
        before = json.loads(Path(folder, "ready").read_text())["cpu"]
        found = json.loads(Path(folder, "placed.json").read_text())
        placed = {(r, s): t for r, s, t in found["placed"]}
    late = np.array([placed[key] - t for key, t in sent.items() if key in placed])
    size = sum(len(payload) for *_, payload, _ in every)
    return {
        "robots": robots,
        "rate": rate,
        "messages": len(every),
        "lost": len(sent) - len(late),
        "p50_ms": 1e3 * float(np.median(late)),
        "p99_ms": 1e3 * float(np.quantile(late, 0.99)),
        "kB_a_robot_minute": size / robots / seconds * 60 / rate / 1e3,
        "cpu_share": (usage.ru_utime + usage.ru_stime - before) / seconds,
        "memory_MB": found["memory_kB"] / 1024,
    }


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

    def __init__(self, store: Store) -> None:
        self.placed: list[tuple[str, int, float]] = []
        self.fresh: list[tuple[str, int]] = []
        super().__init__(store)

    def _work_in(self, ledger, payload) -> None:
        super()._work_in(ledger, payload)
        self.fresh.append((ledger.robot, ledger.next - 1))

    def save(self) -> None:
        super().save()
        now = time.time()
        self.placed += [(robot, seq, now) for robot, seq in self.fresh]
        self.fresh = []


def mapping(folder: Path, at: str) -> None:
    """The map process under load, until it is terminated."""
    import signal

    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    with Store(folder / "map.sqlite", "a map of team") as store, session(Network(listen=(at,))) as opened:
        inbox = Timed(store)
        process = MapProcess("map", opened, Topics("team"), store, inbox, lambda _: None)
        process.join()
        (folder / "coming").write_text(json.dumps({"cpu": time.process_time()}))
        (folder / "coming").rename(folder / "ready")
        process.run(stop, 2.0, lambda _: False)
    status = Path("/proc/self/status").read_text()  # of this process alone, other than what getrusage tells
    peak = int(status.split("VmHWM:")[1].split()[0])
    (folder / "placed.json").write_text(json.dumps({"placed": inbox.placed, "memory_kB": peak}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensor", default="landmarks", choices=sorted(WAYS))
    parser.add_argument("--robots", default="1,5,20")
    parser.add_argument("--rates", default="1")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--mapping", type=Path)
    parser.add_argument("--at", default="")
    given = parser.parse_args()
    if given.mapping is not None:
        mapping(given.mapping, given.at)
        return
    head = True
    for rate in map(float, given.rates.split(",")):
        for robots in map(int, given.robots.split(",")):
            row = measured(given.sensor, robots, rate, given.seconds)
            if head:
                print("  ".join(f"{name:>17}" for name in row))
            head = False
            print("  ".join(f"{value:17.4g}" for value in row.values()), flush=True)


if __name__ == "__main__":
    main()
