"""Mutated messages of every kind told in between those of honest robots: the map process's inbox never raises, and what
the honest robots told is what they told, to the byte.

    python benchmarks/live_mutations.py --messages 200000
"""

import argparse
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np

from mapweave.api.simulate import simulate_landmarks, simulate_laser, simulate_team
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.range_bags import read_range_bag
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.live.door import decode
from mapweave.live.driven import LaserRobot
from mapweave.live.inbox import AGAIN, Inbox
from mapweave.live.landmark_stream import LandmarkRobot
from mapweave.live.messages import (
    Correction,
    GoalMessage,
    Header,
    MapState,
    Message,
    Numbered,
    RefusedError,
    RobotState,
    Status,
    Tile,
    encode,
)
from mapweave.live.range_stream import RangeRobot, of_robot, ranged
from mapweave.live.robot import Driving
from mapweave.live.shared_map import SharedMap
from mapweave.live.sources import LiveLog
from mapweave.live.sources import messages as told_of
from mapweave.live.store import Store
from mapweave.live.tiles import SIDE, pack
from mapweave.live.told import LiveTeam
from mapweave.live.view import Board
from mapweave.mapping.config import LaserConfig
from mapweave.ranges.network import RangeLog
from mapweave.sim.laser_worlds import CorridorConfig

NUMBERS = (
    0, 1, -1, 2**31, 2**53, 2**63 - 1, -(2**63), 2**64 - 1, 0.0, -0.0, 5e-324, 1e15, 1e300, -1e300, 1.7e308,
    float("inf"), float("-inf"), float("nan"),
)  # fmt: skip
WORDS = ("", "a", "r1", "r2", "@map", "../r2", "r" * 70, "x" * 5000, "\x1b[2J", "\u202e", "robot1", "robot99")
DOUBLES = np.array([0.0, -0.0, 5e-324, 1e15, -1e300, 1e308, np.inf, np.nan])
FUSED_EVERY = 500  # messages
DECIDED_EVERY = 200  # messages


@dataclass(slots=True)
class Told:
    """What came of the messages. asked: how often honest robots were asked for their own history."""

    messages: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    asked: int = 0
    whole: bool = False
    seconds: float = 0.0


def team(sensor: str, robots: int = 2) -> dict[str, LiveLog]:
    """Logs of a small simulated team, by name."""
    if sensor == "laser":
        log = simulate_laser(world=CorridorConfig(distance=3.0), seed=1).log
        return {f"r{k}": replace(log, robot=f"robot{k}", source=f"sim-{k}") for k in range(1, robots + 1)}
    if sensor == "ranges":
        with tempfile.TemporaryDirectory() as folder:
            home = Path(folder, "team")
            simulate_team(home, ranges=True, lasers=robots, cameras=0, bearings=0, beacons=2, minutes=0.2)
            whole = read_range_bag(home)
        return {f"r{k}": of_robot(whole, name) for k, name in enumerate(whole.odometry, 1)}
    with tempfile.TemporaryDirectory() as folder:
        simulate_landmarks(Path(folder, "team"), robots=robots, minutes=0.3, seed=4)
        logs = read_landmark_logs(Path(folder, "team"))
    return {f"r{k}": log for k, log in enumerate(logs, 1)}


def histories(logs: dict[str, LiveLog]) -> dict[str, list[Numbered]]:
    return {name: [m for _, m in told_of(log, name, f"run{name}", 0.5)] for name, log in logs.items()}


def _driving(header: Header) -> Driving:
    if header.sensor == "ranges":
        return RangeRobot(header)
    if header.sensor == "laser":
        return LaserRobot(header, LaserConfig(method="graph", threads=1))
    return LandmarkRobot(header, EkfSlamConfig())


def beside(told: dict[str, list[Numbered]]) -> list[Message]:
    """A message of every kind that has no number, as honest processes tell them."""
    out: list[Message] = []
    for name, messages in told.items():
        header, *rest = messages
        driving = _driving(header)
        for message in rest[: len(rest) // 2]:
            driving.add(message)
        pose, cov, n = driving.status()
        out.append(
            Status(robot=name, run=header.run, sensor=header.sensor, last=rest[-1].seq, clock=1.0, t=driving.t or 0.0,
                   pose=pose, cov=cov, landmarks=n)
        )  # fmt: skip
        snapshot = driving.snapshot()
        if snapshot is not None:
            out.append(snapshot)
        out.append(Correction(map="map", robot=name, pose=(0.0, 0.0, 0.0), cov=(0.0,) * 6, scale=1.0))
        goal = {"component": 1, "number": 1, "pose": (1.0, 2.0, 0.0)}
        out.append(GoalMessage(map="explore", of="map", robot=name, **goal))
    robots = [
        RobotState(robot=name, run=messages[0].run, log_robot="", sensor="", there=True, finished=False, have=3, last=9,
                   rate=1.0, pose=(0.0, 0.0, 0.0), cov=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0), frame=(0.0, 0.0, 0.0))
        for name, messages in told.items()
    ]  # fmt: skip
    out.append(MapState(map="map", clock=0.0, fused=1, robots=robots, landmarks=[], decisions=["none"]))
    cells = pack(np.full((SIDE, SIDE), 7, np.uint8))
    out.append(Tile(map="map", component=1, level=0, i=0, j=0, cell=0.05, cells=cells))
    return out


def mutated(payload: bytes, rng: np.random.Generator) -> bytes:
    """The message with a number, a word, a column or bytes of it changed, cut or put twice."""
    kind = rng.integers(8)
    if kind == 0:
        data = bytearray(payload)
        for at in rng.integers(0, len(data), rng.integers(1, 5)):
            data[at] = rng.integers(256)
        return bytes(data)
    if kind == 1:
        return payload[: rng.integers(len(payload))] + payload[rng.integers(len(payload)) :]
    fields = msgspec.msgpack.decode(payload)
    for _ in range(rng.integers(1, 3)):
        _change(fields, rng)
    try:
        return msgspec.msgpack.encode(fields)
    except (OverflowError, ValueError):
        return payload[:-1]


def _change(at: object, rng: np.random.Generator) -> None:
    """Something in the fields is another; deep in lists and maps too."""
    keys = list(at) if isinstance(at, dict) else list(range(len(at))) if isinstance(at, list) else []
    if not keys:
        return
    key = keys[rng.integers(len(keys))]
    value = at[key]
    if isinstance(value, dict | list) and value and rng.random() < 0.8:
        _change(value, rng)
    elif isinstance(value, bytes) and rng.random() < 0.8:
        at[key] = _column(value, rng)
    elif rng.random() < 0.1 and isinstance(at, dict):
        del at[key]
    elif isinstance(value, str):
        at[key] = WORDS[rng.integers(len(WORDS))]
    else:
        at[key] = NUMBERS[rng.integers(len(NUMBERS))]


def _column(data: bytes, rng: np.random.Generator) -> bytes:
    """Numbers of a column changed, or its length."""
    if rng.random() < 0.2:
        return data[: rng.integers(len(data) + 1)] if rng.random() < 0.5 else data * 2
    values = np.frombuffer(data[: len(data) // 8 * 8], "<f8").copy()
    if len(values):
        some = rng.integers(len(values), size=rng.integers(1, 4))
        values[some] = DOUBLES[rng.integers(len(DOUBLES), size=len(some))]
    return values.tobytes() + data[len(data) // 8 * 8 :]


def in_sequence(told: dict[str, list[bytes]], others: Sequence[bytes], n: int, rng: np.random.Generator) -> Iterator:
    """(who is said to speak, payload, whether it is honest): n mutated ones, and all honest ones spread among them."""
    honest = [(name, payload) for name, messages in told.items() for payload in messages]
    at = np.sort(rng.integers(0, n, len(honest)))
    every = [*(payload for _, payload in honest), *others]
    names = [*told, "r3", "stranger"]
    k = 0
    for i in range(n):
        while k < len(honest) and at[k] <= i:
            yield (*honest[k], True)
            k += 1
        yield names[rng.integers(len(names))], mutated(every[rng.integers(len(every))], rng), False
    yield from ((*one, True) for one in honest[k:])


def told_among_mutations(sensor: str, n: int, seed: int = 0) -> Told:
    """`n` mutated messages among those of an honest team; raises whatever the inbox, the fusion or the page raises."""
    rng = np.random.default_rng(seed)
    logs = team(sensor)
    numbered = histories(logs)
    told = {name: [encode(m) for m in messages] for name, messages in numbered.items()}
    out, board, known, shared = Told(), Board(), LiveTeam(), SharedMap()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder, "s.sqlite"), "a map") as store:
        inbox = Inbox(store)
        for name in told:
            inbox.presence(name, there=True)
        now = 0.0
        for speaker, payload, honest in in_sequence(told, [encode(m) for m in beside(numbered)], n, rng):
            now += 0.01
            out.messages += 1
            inbox.offer(speaker, payload, now)
            if not honest:
                _seen_by_others(payload, board, known, inbox, now)
            if out.messages % DECIDED_EVERY == 0:
                inbox.save()
                out.asked += _decided(inbox, told, now)
            if out.messages % FUSED_EVERY == 0:
                _made_of_it(inbox, shared)
        for _ in range(50):  # what the honest robots are asked for, they tell again
            now += 2 * AGAIN
            out.asked += _decided(inbox, told, now)
            for name, messages in told.items():
                inbox.offer(name, messages[-1], now)  # that there are so many, their status tells
            for name, first, last in list(inbox.gaps(now)):
                for payload in told.get(name, [])[first : last + 1]:
                    inbox.offer(name, payload, now)
        inbox.save()
        board.all()
        kept = {name: [payload for _, payload in store.get(name, 0, len(told[name]))] for name in told}
        logs_kept = {name: inbox.log(name) for name in told}
        out.whole = kept == told and all(
            got is not None and got.log_hash == logs[name].log_hash for name, got in logs_kept.items()
        )
        out.refused = sum((ledger.refused for ledger in inbox.ledgers.values()), inbox.refused.copy())
    out.seconds = time.monotonic() - begin
    return out


def _made_of_it(inbox: Inbox, shared: SharedMap) -> None:
    """The shared map is made of what is here."""
    if (fusing := shared.fusing(inbox.ledgers.values())) is not None:
        shared.take_fused(fusing.run())
    logs = [log for log in map(inbox.log, inbox.ledgers) if isinstance(log, RangeLog)]
    if logs:
        shared.take_ranged(ranged(logs))


def _seen_by_others(payload: bytes, board: Board, team: LiveTeam, inbox: Inbox, now: float) -> None:
    """Robots, views and other map processes read it too."""
    try:
        message = decode(payload)
    except RefusedError:
        return
    if isinstance(message, MapState):
        board.take(message)
        team.take(message)
        inbox.hearsay(message.robots, now)
    elif isinstance(message, Tile):
        board.take_tile(message)
        team.take_tile(message)
    elif isinstance(message, GoalMessage):
        team.take_goal(message)
    for robot in team.robots().values():
        team.goal(robot.name)


def _decided(inbox: Inbox, told: dict[str, list[bytes]], now: float) -> int:
    """Honest robots answer for themselves; nobody answers for others. How often they were asked."""
    asked = [(name, first, last) for name, first, last in inbox.doubts(now) if name in told]
    for name, first, last in asked:
        inbox.decide(name, told[name][first : last + 1], now)
    return len(asked)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    for sensor in ("landmarks", "laser", "ranges"):
        told = told_among_mutations(sensor, asked.messages // 3, asked.seed)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        whole = "as told, to the byte" if told.whole else "NOT AS TOLD"
        print(
            f"{sensor}: {told.messages} messages in {told.seconds:.0f} s, {told.refused.total()} refused, "
            f"asked {told.asked} times, memory {memory:.0f} MB; what honest robots told: {whole}"
        )
        print("  " + ", ".join(f"{n} {reason}" for reason, n in told.refused.most_common(12)))


if __name__ == "__main__":
    main()
