"""Whatever fails on the data of one robot costs that robot's part alone, and is told."""

import threading
import time

import numpy as np
import pytest

from mapweave.core.errors import EstimateError
from mapweave.live.driven import DrivenSession
from mapweave.live.inbox import Inbox
from mapweave.live.isolation import without_culprits
from mapweave.live.laser_team import LiveLaserTeam
from mapweave.live.laser_weaver import LaserWeaver
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import Header, Snapshot, encode
from mapweave.live.shared_map import SharedMap
from mapweave.live.store import Store
from mapweave.live.tile_mapper import TileMapper
from mapweave.live.topics import Topics
from mapweave.live.transport import Network, session

from .teams import messages, team
from .test_laser_weaving import CFG, docked, filled, woven


def fails_with(*culprits, together=()):
    def make(robots):
        if set(robots) & set(culprits) or (together and set(together) <= set(robots)):
            raise EstimateError(f"{len(robots)} robots")
        return tuple(robots)

    return make


def test_those_that_something_fails_for_are_left_out_and_named():
    assert without_culprits(["a", "b"], fails_with("x")) == (("a", "b"), ("a", "b"), {})
    made, kept, failed = without_culprits(["a", "b", "c"], fails_with("b"))
    assert made == kept == ("a", "c")
    assert failed == {"b": "1 robots"}
    made, kept, failed = without_culprits(["a", "b", "c"], fails_with("x", together=("a", "c")))
    assert made == kept == ("a", "b")
    assert failed == {"c": "3 robots"}
    assert without_culprits(["a"], fails_with("a")) == (None, (), {"a": "1 robots"})
    assert without_culprits([], fails_with("a")) == ((), (), {})


@pytest.fixture
def laser_pair(tmp_path):
    store, heard = filled(tmp_path / "s.sqlite", 0.3)
    with store:
        yield LiveLaserTeam(store, CFG, docked), heard


def test_a_robot_whose_estimate_fails_is_left_out_and_the_other_goes_on(laser_pair, monkeypatch):
    made, heard = laser_pair
    push = DrivenSession.push

    def fail(self, event):
        if event.robot == "robot2" and event.t > 5.0:
            raise ZeroDivisionError("division by zero")
        return push(self, event)

    monkeypatch.setattr(DrivenSession, "push", fail)
    while made.follow(heard):
        pass
    drawn = woven(made)
    assert made.lost == {"r2": "ZeroDivisionError: division by zero"}
    assert list(drawn.placed) == ["r1"]
    assert drawn.tiles
    assert "r2: left out, ZeroDivisionError: division by zero" in drawn.decisions


def test_a_robot_whose_graph_has_no_solution_is_left_out_and_the_other_goes_on(laser_pair, monkeypatch):
    made, heard = laser_pair
    while made.follow(heard):
        pass
    graph = DrivenSession.bare_graph

    def broken(self, name):
        told = graph(self, name)
        if name == "r2":
            told.step_information[:] = np.nan
        return told

    monkeypatch.setattr(DrivenSession, "bare_graph", broken)
    assert list(woven(made).placed) == ["r1"]
    assert list(made.lost) == ["r2"]


def test_a_robot_that_no_map_can_hold_is_left_out_and_the_other_drawn(laser_pair, monkeypatch):
    made, heard = laser_pair
    while made.follow(heard):
        pass
    lay = TileMapper._lay

    def far(self, robot, k, pose, seen):
        lay(self, robot, k, pose + ([1e300, 0.0, 0.0] if robot == "r2" else 0.0), seen)

    monkeypatch.setattr(TileMapper, "_lay", far)
    drawn = woven(made)
    drawn = drawn if drawn.tiles else woven(made)
    assert list(drawn.placed) == ["r1"]
    assert drawn.tiles
    assert "no map can hold" in made.lost["r2"]


def heard_snapshots(store, *snapshots):
    inbox = Inbox(store)
    for k, log in enumerate(team(), 1):
        for message in messages(log, f"r{k}"):
            inbox.offer(f"r{k}", encode(message), 0.0)
    for snapshot in snapshots:
        inbox.offer(snapshot.robot, encode(snapshot), 0.0)
    return inbox


def snapshot(robot, points):
    from mapweave.live.columns import pack, pack_triangle

    n = len(points)
    return Snapshot(
        robot=robot, run="a", last=3, t=1.0, pose=(0.0, 0.0, 0.0), ids=[str(6 + k) for k in range(n)],
        mean=pack(*np.array(points).T), cov=pack_triangle(np.eye(3 + 2 * n)), counts=[20] * n,
    )  # fmt: skip


def test_three_landmarks_in_one_point_cost_nobody_else_the_map(tmp_path):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        good = snapshot("r1", [(1.0, 2.0), (4.0, 0.0), (0.0, 5.0)])
        inbox = heard_snapshots(store, good, snapshot("r2", [(1.0, 1.0)] * 3))
        shared = SharedMap()
        shared.take_fused(shared.fusing(inbox.ledgers.values()).run())
        assert "r1" in shared.placed
        assert [x.id for x in shared.landmarks if x.component == shared.placed["r1"].component] == ["6", "7", "8"]


def test_a_snapshot_that_fusion_breaks_on_is_named_and_the_others_are_fused(tmp_path, monkeypatch):
    from mapweave.fusion.online import OnlineFuser

    update = OnlineFuser.update

    def fragile(self, *maps):
        if any(m.robot == "robot2" for m in maps):
            raise np.linalg.LinAlgError("Singular matrix")
        return update(self, *maps)

    monkeypatch.setattr(OnlineFuser, "update", fragile)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        some = [(1.0, 2.0), (4.0, 0.0), (0.0, 5.0)]
        inbox = heard_snapshots(store, snapshot("r1", some), snapshot("r2", some))
        shared = SharedMap()
        shared.take_fused(shared.fusing(inbox.ledgers.values()).run())
        assert list(shared.placed) == ["r1"]
        assert "r2: refused, its snapshot: LinAlgError: Singular matrix" in shared.decisions


def test_a_thread_that_dies_is_told_at_once_and_started_anew(tmp_path, monkeypatch):
    monkeypatch.setattr("mapweave.live.map_process.REST", 0.0)
    died = []
    wait = LaserWeaver._next

    def once(self, followed, due):
        if not died:
            died.append(True)
            raise SystemError("out of the blue")
        return wait(self, followed, due)

    monkeypatch.setattr(LaserWeaver, "_next", once)
    store, heard = filled(tmp_path / "s.sqlite", 0.2)
    said = []
    with store, session(Network(listen=("tcp/127.0.0.1:0",))) as alone:
        store.set_about("robots, in the order of joining", "r1 r2")
        store.set_about("run of r1", "a")
        store.set_about("run of r2", "a")
        process = MapProcess("map", alone, Topics("t"), store, Inbox(store), said.append)
        stop = threading.Event()
        end = time.monotonic() + 60

        def until(inbox):
            return (process.shared.fused > 0 and set(process.shared.placed) == {"r1", "r2"}) or time.monotonic() > end

        process.run(stop, 0.5, until)
    told = "the thread that follows laser robots died and begins anew: SystemError: out of the blue"
    assert said.count(told) == 1
    assert told in process.state().decisions
    assert process.shared.tiles
    assert heard["r1"] == process._woven.worked["r1"]


def test_a_message_that_breaks_the_inbox_is_counted_and_the_next_one_taken(tmp_path, monkeypatch):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = Inbox(store)
        told = messages(team()[0])

        def broken(self, ledger, header):
            if header.log_robot == "robot2":
                raise KeyError("nowhere")

        monkeypatch.setattr(Inbox, "_expect_room_for", broken)
        inbox.offer("r2", encode(messages(team()[1], "r2")[0]), 0.0)
        for message in told:
            inbox.offer("r1", encode(message), 0.0)
        assert "KeyError" in inbox.ledgers["r2"].fault
        assert inbox.ledgers["r1"].complete
        assert isinstance(told[0], Header)
