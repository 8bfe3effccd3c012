"""Whatever fails on the data of one robot costs that robot's part alone, and is told."""

import threading
import time
from concurrent.futures import Future
from contextlib import contextmanager
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from mapweave.core.errors import EstimateError
from mapweave.live import isolation, laser_weaver, map_process, shared_map
from mapweave.live.driven import DrivenSession
from mapweave.live.inbox import Inbox
from mapweave.live.isolation import without_culprits
from mapweave.live.laser_team import LiveLaserTeam
from mapweave.live.laser_weaver import LaserWeaver
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import Header, Snapshot, Topics, encode
from mapweave.live.pair_search import PairTrial
from mapweave.live.shared_map import Fusing, SharedMap
from mapweave.live.store import Store
from mapweave.live.tile_mapper import TileMapper
from mapweave.live.transport import Network, session
from mapweave.live.weaving import Weaving

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
    assert failed == {"b": "2 robots"}
    made, kept, failed = without_culprits(["a", "b", "c"], fails_with("x", together=("a", "c")))
    assert made == kept == ("a", "b")
    assert failed == {"c": "3 robots"}
    made, kept, failed = without_culprits(["a", "b", "c"], fails_with("a", together=("b", "c")))
    assert made == kept == ("b",)
    assert without_culprits(["a"], fails_with("a")) == (None, (), {"a": "1 robots"})
    assert without_culprits([], fails_with("a")) == ((), (), {})


def counted(make):
    def once(robots):
        once.calls += 1
        return make(robots)

    once.calls = 0
    return once


def test_one_culprit_among_many_is_found_by_halves():
    names = [f"r{k}" for k in range(64)]
    make = counted(fails_with("r41"))
    made, _, failed = without_culprits(names, make)
    assert made == tuple(name for name in names if name != "r41")
    assert list(failed) == ["r41"]
    assert make.calls <= 2 * 6 + 1


def test_one_that_fails_for_itself_alone_is_kept_where_others_hold_it():
    def make(robots):
        if "c" in robots or "b" not in robots:
            raise EstimateError("c spoils all, b alone says where they are")
        return tuple(robots)

    assert without_culprits(["b", "a", "d", "c"], make)[:2] == (("b", "a", "d"), ("b", "a", "d"))


def test_one_beside_whom_all_others_fail_is_the_one_that_is_left_out():
    def make(robots):
        if "a" in robots and len(robots) > 1:
            raise EstimateError("nobody stands beside a")
        return tuple(robots)

    made, _, failed = without_culprits(["a", "b", "c", "d"], make)
    assert made == ("b", "c", "d")
    assert list(failed) == ["a"]


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
    from mapweave.live.messages import pack, pack_triangle

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

    grown = OnlineFuser.grown

    def fragile(self, *maps):
        if any(m.robot == "robot2" for m in maps):
            raise np.linalg.LinAlgError("Singular matrix")
        return grown(self, *maps)

    monkeypatch.setattr(OnlineFuser, "grown", fragile)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        some = [(1.0, 2.0), (4.0, 0.0), (0.0, 5.0)]
        inbox = heard_snapshots(store, snapshot("r1", some), snapshot("r2", some))
        shared = SharedMap()
        shared.take_fused(shared.fusing(inbox.ledgers.values()).run())
        assert list(shared.placed) == ["r1"]
        assert "r2: refused, its snapshot: LinAlgError: Singular matrix" in shared.decisions


def test_more_landmarks_than_are_fused_while_robots_drive_cost_those_who_have_most_to_themselves(tmp_path, monkeypatch):
    monkeypatch.setattr(shared_map, "MOST", 4)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        some = [(1.0, 2.0), (4.0, 0.0), (0.0, 5.0)]
        many = msgspec.structs.replace(
            snapshot("r1", [*some, (9.0, 9.0), (7.0, 8.0)]), ids=["6", "7", "8", "invented", "too"]
        )
        inbox = heard_snapshots(store, many, snapshot("r2", some))
        shared = SharedMap()
        shared.take_fused(shared.fusing(inbox.ledgers.values()).run())
        assert list(shared.placed) == ["r2"]
        assert "r1: refused, its snapshot: over 4 landmarks are fused at the end alone" in shared.decisions


THREADS = {  # of a map process: what each does again and again
    "follows": (LaserWeaver, "_next", "the thread that follows laser robots died and begins anew: {}"),
    "solves": (Weaving, "run", "not woven: {}"),
    "searches": (PairTrial, "run", "not woven: r1 and r2, tried on each other: {}"),
    "fuses": (Fusing, "run", "fusing failed: {}"),
    "judges": (map_process, "judged", "judging landmark maps failed: {}"),
    "maps robots that are gone": (map_process, "mapped_again", "mapping a robot that is gone failed: {}"),
}
HUNG = 4.0  # [s]; longer than any piece of work of so small a team takes, with everything compiled
WORDS = {
    ("follows", "dies"): "SystemExit: out of the blue",
    ("follows", "hangs"): f"it has stood still for {HUNG:g} s",
    "dies": "RuntimeError: SystemExit: out of the blue",
    "hangs": f"TimeoutError: given up after {HUNG:g} s",
}


@pytest.mark.parametrize("how", ["dies", "hangs"])
@pytest.mark.parametrize("which", THREADS)
def test_every_thread_that_dies_or_hangs_is_told_and_another_takes_its_place(tmp_path, monkeypatch, which, how):
    monkeypatch.setattr(map_process, "REST", 0.0)
    if how == "hangs":
        monkeypatch.setattr(isolation, "HUNG", HUNG)
        monkeypatch.setattr(laser_weaver, "HUNG", HUNG)
    where, name, told = THREADS[which]
    told = told.format(WORDS.get((which, how)) or WORDS[how])
    work, calls, never = getattr(where, name), [], threading.Event()

    def once(*args):
        calls.append(threading.current_thread())
        if len(calls) == 1 and how == "dies":
            raise SystemExit("out of the blue")
        if len(calls) == 1:
            never.wait()
        return work(*args)

    monkeypatch.setattr(where, name, once)
    lasers = which in {"follows", "solves", "searches"}
    said = []
    with robots_of_both(tmp_path, lasers=lasers) as store, session(Network(listen=("tcp/127.0.0.1:0",))) as alone:
        process = MapProcess("map", alone, Topics("t"), store, Inbox(store), said.append)
        process.starts = docked
        if which == "fuses":
            for one in "r1", "r2":
                snapshots = snapshot(one, [(1.0, 2.0), (4.0, 0.0), (0.0, 5.0)])
                process.inbox.offer(one, encode(snapshots), 0.0)
        end = time.monotonic() + 120
        needed = {"searches": 1, "maps robots that are gone": 2}.get(which, 2)

        def until(_):
            mapped = set(process.shared.placed) == {"r1", "r2"} and bool(process.shared.tiles) == lasers
            there = (mapped or which == "maps robots that are gone") and len(calls) >= needed
            return (told in said and there) or time.monotonic() > end

        process.run(threading.Event(), 0.5, until)
    never.set()
    for thread in threading.enumerate():  # the next test is not theirs
        if thread.name in {"weaver", "beside"}:
            thread.join(60)
    assert said.count(told) == 1, said
    assert told in process.state().decisions
    assert len(calls) >= needed
    assert calls[0] is not threading.main_thread()
    if lasers:
        assert process.shared.tiles


@contextmanager
def robots_of_both(folder, *, lasers):
    """A store of what two robots told, with their names."""
    store = filled(folder / "s.sqlite", 0.3)[0] if lasers else Store(folder / "s.sqlite", "a map")
    with store:
        for k, log in enumerate(() if lasers else team(), 1):
            store.put([(f"r{k}", m.seq, encode(m)) for m in messages(log, f"r{k}")])
        yield store


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


def test_what_failed_is_told_even_if_the_graph_is_solved_before_anybody_asks(tmp_path, monkeypatch):
    """A solution that came between the failure and the look at it made it forgotten."""
    with Store(tmp_path / "s.sqlite", "a map") as store:
        weaver = LaserWeaver(store, CFG, 1.0)
    monkeypatch.setattr(LiveLaserTeam, "take", lambda *_: None)
    failed, solved = Future(), Future()
    failed.set_exception(TimeoutError("given up after 4 s"))
    solved.set_result(None)
    weaver._work = laser_weaver._Searched(SimpleNamespace(a="r1", b="r2"), 0.0, failed)
    assert weaver._done() is laser_weaver._Searched
    weaver._work = laser_weaver._Solving(0.0, solved)
    assert weaver._done() is laser_weaver._Solving
    assert weaver.failed == ["r1 and r2, tried on each other: TimeoutError: given up after 4 s"]
