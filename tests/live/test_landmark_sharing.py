"""Landmark robots that drive: when each tells its map, and what the maps of a team fuse to."""

import time
from itertools import pairwise
from threading import Event

import pytest

from mapweave.landmarks.config import EkfSlamConfig
from mapweave.live import map_process
from mapweave.live import robot as robots
from mapweave.live.door import decode
from mapweave.live.inbox import Inbox
from mapweave.live.landmark_stream import LandmarkRobot, messages_of
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import Rows, Snapshot, Topics, encode
from mapweave.live.robot import Pace, RobotProcess, pause_after
from mapweave.live.shared_map import SharedMap
from mapweave.live.store import Store
from mapweave.live.transport import Network, session

from .teams import messages, team


class Clock(Event):
    """Stands still but for what is waited for. It is an event too, which is set when `end` has come."""

    def __init__(self, end):
        super().__init__()
        self.now, self.end = 0.0, end

    def monotonic(self):
        return self.now

    def wait(self, timeout=None):
        self.now += max(timeout, 1e-6)
        return self.is_set()

    def is_set(self):
        return self.now >= self.end


@pytest.fixture
def told(monkeypatch, tmp_path):
    """What a robot puts, and when, that drives through a log of messages of `period` seconds until `end`."""

    def drive(period, end, says=lambda _: None, **pace):
        clock, put = Clock(end), []
        monkeypatch.setattr(robots, "time", clock)
        monkeypatch.setattr(robots, "put", lambda _, key, payload: put.append((clock.now, decode(payload))))
        log = team()[0]
        timed = list(messages_of(log, "r1", "a", period))
        driving = LandmarkRobot(timed[0][1], EkfSlamConfig())
        listening = Network(listen=("tcp/127.0.0.1:0",))
        with session(listening) as alone, Store(tmp_path / f"{period}.sqlite", "robot r1") as store:
            store.set_about("run", "a")
            store.set_about("sensor", "landmarks")
            process = RobotProcess("r1", alone, Topics("team"), store, says, clock.monotonic)
            process.run(iter(timed), driving, Pace(1.0, 0.0, **pace), clock)
        return put

    return drive


def test_a_robot_tells_its_map_with_every_message_that_changes_it(told):
    put = told(1.0, 10.5)
    rows = {m.seq: t for t, m in put if isinstance(m, Rows)}
    mapped = {m.last: t for t, m in reversed(put) if isinstance(m, Snapshot)}
    assert len(rows) > 8
    assert {seq: mapped.get(seq) for seq in rows} == rows


def test_maps_are_told_no_oftener_than_their_size_allows_and_again_for_who_comes_late(told):
    assert [pause_after(n) for n in (0, 12_000, 10**6)] == [0.5, 1.0, 2.0]
    for period, least, most in ((0.1, 0.5, 0.7), (8.0, 0.5, 2.6)):
        *at, _ = [t for t, m in told(period, 30.0) if isinstance(m, Snapshot)]  # the last one as soon as it is over
        assert least - 1e-9 <= min(b - a for a, b in pairwise(at))
        assert max(b - a for a, b in pairwise(at)) <= most


def test_a_map_of_more_than_a_message_holds_is_told_of_and_what_is_left_sent(monkeypatch, tmp_path):
    said = []
    with Store(tmp_path / "m", "a map") as store, session(Network(listen=("tcp/127.0.0.1:0",))) as alone:
        process = MapProcess("map", alone, Topics("team"), store, Inbox(store), said.append)
        for k in range(2):
            process.finding(f"finding {k}")
        monkeypatch.setattr(map_process, "LARGEST", len(encode(process.state())) - 1)
        sent = []
        monkeypatch.setattr(map_process, "put", lambda _, key, payload: sent.append(decode(payload)))
        process.tell_state()
        process.tell_state()
    assert said.count("0 landmarks and what is decided are more than a message holds: not told") == 1
    assert [state.map for state in sent] == ["map", "map"]


def test_a_robot_that_nobody_hears_says_so_once(told):
    for expected, lines in ((True, 1), (False, 0)):
        said = []
        told(1.0 + expected, 12.0, said.append, expected=expected)
        assert said == ["r1: no map process is heard of yet: driving on, who comes later gets all of it"] * lines


def fused(store, runs):
    """The shared map of two robots whose runs are called so."""
    inbox = Inbox(store)
    for k, (log, run) in enumerate(zip(team(), runs, strict=True), 1):
        first, *rest = messages(log, f"r{k}", run)
        driving = LandmarkRobot(first, EkfSlamConfig())
        for message in [first, *rest]:
            driving.add(message)
            inbox.offer(f"r{k}", encode(message), 0.0)
        inbox.offer(f"r{k}", encode(driving.snapshot()), 0.0)
    inbox.save()
    shared = SharedMap()
    shared.take_fused(shared.fusing(inbox.ledgers.values()).run())
    assert shared.fusing(inbox.ledgers.values()) is None  # nothing is fresher
    return shared


def test_robots_that_call_their_runs_alike_are_two_robots_all_the_same(tmp_path):
    with Store(tmp_path / "a.sqlite", "a map") as one, Store(tmp_path / "b.sqlite", "a map") as other:
        alike, told_apart = fused(one, "aa"), fused(other, "ab")
    assert {p.component for p in alike.placed.values()} == {1}
    assert alike.decisions == told_apart.decisions
    assert alike.landmarks == told_apart.landmarks


def test_a_map_process_that_begins_again_holds_robots_that_left_before(tmp_path):
    with Store(tmp_path / "map.sqlite", "a map") as store:
        heard = fused(store, "ab")
    with (
        Store(tmp_path / "map.sqlite", "a map") as store,
        session(Network(listen=("tcp/127.0.0.1:0",))) as alone,
    ):
        process = MapProcess("map", alone, Topics("team"), store, Inbox(store), lambda _: None)
        end = time.monotonic() + 60
        process.run(Event(), 0.1, lambda _: len(process.shared.placed) == 2 or time.monotonic() > end)
        state = process.state()
    assert state.landmarks == heard.landmarks
    assert all(robot.component == 1 and robot.pose for robot in state.robots)
