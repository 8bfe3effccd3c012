"""A mixed team that drives: lasers, cameras and an eye for bearings alone in one map, at the end that of `map`."""

import time
from threading import Event

import numpy as np
import pytest

import mapweave
from mapweave.api.live import _final
from mapweave.api.map_mixed import MixedMapConfig, join_apart
from mapweave.api.map_options import MapOptions
from mapweave.core import se2
from mapweave.core.errors import UsageError
from mapweave.live import map_process
from mapweave.live.door import decode
from mapweave.live.inbox import Inbox
from mapweave.live.joined import Joined, SightedAt, Tied, into_one_frame
from mapweave.live.laser_team import WovenTeam
from mapweave.live.map_process import MapProcess
from mapweave.live.messages import Topics, encode
from mapweave.live.shared_map import SharedMap
from mapweave.live.sources import messages, open_source
from mapweave.live.store import Store
from mapweave.live.transport import Network, session
from mapweave.live.weaving import ALONE, Placed

from .processes import Fleet, same_result
from .teams import heard, heard_late_and_twice

NAMES = [f"r{k}" for k in range(1, 7)]  # two lasers, two cameras, a camera and an eye that tell bearings alone


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    """The folder of a simulated team, and what is true of it."""
    home = tmp_path_factory.mktemp("mixed") / "team"
    made = mapweave.simulate_team(
        home, lasers=2, cameras=2, bearing_cameras=1, bearings=1, landmarks=8, minutes=1.0, seed=4
    )
    return home, {f"r{robot.number}": robot.truth for robot in made.robots}


@pytest.fixture(scope="module")
def direct(team):
    """What `map` makes of the logs."""
    folder = team[0].parent / "direct"
    mapweave.map(team[0], folder)
    return folder


@pytest.fixture(scope="module")
def told(team):
    """What each robot tells, message by message."""
    return {
        name: [encode(m) for _, m in messages(open_source(str(team[0]), name, None), name, "a", 1.0)] for name in NAMES
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_robots_log_is_told_whole(team, told, tmp_path, name):
    log = open_source(str(team[0]), name, None)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        again = heard(store, {name: told[name]}).log(name)
    assert again.log_hash == log.log_hash
    for what in ("source", "findings", "dropped", "unused", "robot"):
        assert getattr(again, what) == getattr(log, what)
    for table in ("sightings", "bearings") if hasattr(log, "bearings") else ():
        here, there = getattr(again, table), getattr(log, table)
        assert here.ids == there.ids
        for column in ("t", "what", "range", "bearing"):
            np.testing.assert_array_equal(getattr(here, column), getattr(there, column))


@pytest.mark.drawn
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_messages_late_and_doubled_give_the_map_of_the_logs(told, direct, tmp_path, seed):
    rng = np.random.default_rng(seed)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard_late_and_twice(store, told, rng)
        assert all(ledger.complete for ledger in inbox.ledgers.values())
        _final(inbox, MapOptions(), print).write(tmp_path / "out")
    same_result(direct, tmp_path / "out")


def test_a_robot_that_dies_is_in_the_map_as_far_as_it_told(told, tmp_path):
    cut = {name: each[: len(each) // 2] if name in {"r2", "r4"} else each for name, each in told.items()}
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, cut)
        result = _final(inbox, MapOptions(), print)
    assert sorted(robot for part in result.maps for robot in part.robots) == [f"robot{k}" for k in range(1, 7)]
    scans = sum(len(message.scans) for message in map(decode, cut["r2"][1:]))
    sightings = sum(len(message.what) for message in map(decode, cut["r4"][1:]))
    assert [result.metrics["robots"][k][what] for k, what in (("2", "scans"), ("4", "sightings"))] == [scans, sightings]


def test_a_robot_that_is_not_of_the_team_is_no_landmark(team, told, tmp_path):
    kept = [name for name in NAMES if name != "r2"]
    with Store(tmp_path / "s.sqlite", "a map") as store:
        live = _final(heard(store, {name: told[name] for name in kept}), MapOptions(), print)
    named = mapweave.map(team[0], robots=[name[1:] for name in kept])
    assert live.metrics["robots"]["3"]["dropped"]["sighting of a robot left out"] > 10
    assert [part.landmarks.ids for part in live.maps] == [part.landmarks.ids for part in named.maps]
    for part, other in zip(live.maps, named.maps, strict=True):
        np.testing.assert_array_equal(part.landmarks.mean, other.landmarks.mean)


def test_a_robot_with_two_sensors_is_refused_in_one_line(tmp_path):
    mapweave.simulate_team(tmp_path / "all", lasers=1, cameras=1, bearings=0, minutes=0.3, everything=True, seed=1)
    with pytest.raises(
        UsageError, match=r"robot 1 has a laser log and rows of wheels or sightings.*give robot1\.mcap alone"
    ):
        open_source(str(tmp_path / "all"), "r1", None)


def mapped(path, told, joins, until):
    """What a map process knows that began anew from what it heard, once `until` holds of it; and what it said."""
    said = []
    with Store(path, "a map") as store, session(Network(listen=("tcp/127.0.0.1:0",))) as alone:
        heard(store, told)
        process = MapProcess("map", alone, Topics("t"), store, Inbox(store), said.append)
        process.joins = joins
        end = time.monotonic() + 240
        process.run(Event(), 0.2, lambda _: until(process) or time.monotonic() > end)
        return process, said


def settled(holds, seconds=10.0):
    """Whether `holds` does and nobody was placed anew for so long: a first tie may rest on little that was heard."""
    last, since = None, 0.0

    def until(process):
        nonlocal last, since
        frames = {name: tuple(placed.frame) for name, placed in process.shared.placed.items()}
        if frames != last:
            last, since = frames, time.monotonic()
        return holds(process) and time.monotonic() - since > seconds

    return until


def joined(apart, landmarks):
    return join_apart(apart, landmarks, MixedMapConfig())


@pytest.mark.slow
def test_while_they_drive_all_stand_in_one_frame_with_walls_and_landmarks(team, told, tmp_path):
    everybody = lambda p: {x.component for x in p.shared.placed.values()} == {1} and len(p.shared.placed) == 6
    process, _ = mapped(tmp_path / "s.sqlite", told, joined, settled(everybody))
    shared, truth = process.shared, team[1]
    state = {robot.robot: robot for robot in process.state().robots}
    assert all(state[name].component == 1 for name in NAMES)
    assert {key[0] for key in shared.tiles} == {1}
    assert len(shared.landmarks) >= 6
    assert {x.component for x in shared.landmarks} == {1}
    here = {name: np.array(state[name].pose) for name in ("r3", "r4")}
    ends = {name: truth[name].pose[-1] for name in here}
    world = se2.compose(ends["r3"], se2.inverse(here["r3"]))
    lasers = {name: np.asarray(se2.compose(world, shared.placed[name].frame)) for name in ("r1", "r2")}
    begins = {name: truth[name].pose[0] for name in lasers}
    for name, pose in lasers.items():
        assert np.hypot(*(pose - begins[name])[:2]) < 0.6, name
    assert np.hypot(*(se2.compose(world, here["r4"]) - ends["r4"])[:2]) < 0.6


@pytest.mark.slow
def test_what_fails_with_one_robots_rows_leaves_the_others_joined(told, tmp_path):
    def fails(apart, landmarks):
        if any(log.robot == "robot4" for log in landmarks):
            raise ZeroDivisionError("division by zero")
        return joined(apart, landmarks)

    process, _ = mapped(tmp_path / "s.sqlite", told, fails, lambda p: p.shared.joined.tied)
    assert "r3" in process.shared.joined.tied
    assert "r4: not laid beside laser robots: ZeroDivisionError: division by zero" in process.state().decisions


@pytest.mark.slow
def test_a_join_that_dies_is_told_and_made_again(told, tmp_path, monkeypatch):
    work, calls = map_process._joined, []

    def once(*args):
        calls.append(args)
        if len(calls) == 1:
            raise SystemExit("out of the blue")
        return work(*args)

    monkeypatch.setattr(map_process, "_joined", once)
    process, said = mapped(tmp_path / "s.sqlite", told, joined, lambda p: p.shared.joined.tied)
    assert process.shared.joined.tied
    assert said.count("joining lasers and landmarks failed: RuntimeError: SystemExit: out of the blue") == 1


@pytest.mark.drawn
@pytest.mark.long
def test_processes_that_are_killed_meanwhile_make_the_map_of_the_logs(team, direct, tmp_path):
    fleet = Fleet(tmp_path, team[0])
    try:
        fleet.map(robots=",".join(NAMES))
        for name in NAMES:
            fleet.robot(name, rate="4")
        for name in NAMES:
            fleet.hears("map", f"{name}: joined")
        for name in ("r2", "r3", "r5"):
            fleet.kill(name)
            fleet.robot(name, rate="4")
            fleet.hears(name, "goes on after")
        fleet.kill("map")
        fleet.map(robots=",".join(NAMES))
        for name in ("map", *NAMES):
            assert fleet.wait(name) == 0, fleet.said(name)
    finally:
        fleet.end()
    same_result(direct, tmp_path / "out-map")


def tie(to, *at, sd=0.1):
    return Tied(to, np.array(at, float), sd**2 * np.eye(3))


def test_parts_lie_in_one_frame_wherever_their_own_have_gone():
    rng = np.random.default_rng(2)
    a, b, c = rng.uniform(-3, 3, (3, 3))  # where a, b and c are, in truth
    tied = {"b": tie("a", *se2.between(a, b)), "c": tie("b", *se2.between(b, c))}
    for _ in range(5):
        one, two, three = rng.uniform(-3, 3, (3, 3))  # frames of parts, made anew each time
        anchors = {k: {n: se2.between(f, x)} for k, n, f, x in ((1, "a", one, a), (2, "b", two, b), (3, "c", three, c))}
        lies = into_one_frame(anchors, tied)
        assert {part: root for part, (root, _, _) in lies.items()} == {2: 1, 3: 1}
        for part, frame in ((2, two), (3, three)):
            np.testing.assert_allclose(lies[part][1][:2], se2.between(one, frame)[:2], atol=1e-9)
        assert (np.linalg.eigvalsh(lies[3][2]) > 0).all()
        assert lies[3][2][2, 2] == pytest.approx(2 * 0.1**2)


def test_a_tie_stays_as_it_was_unless_it_moved_or_is_surer_by_now():
    before = Joined({"b": tie("a", 1.0, 0.0, 0.0)})
    for now, held in ((tie("a", 1.05, 0.0, 0.0), True), (tie("a", 1.3, 0.0, 0.0), False), (tie("c", 1.0, 0, 0), False)):
        assert (Joined({"b": now}).after(before).tied["b"] is before.tied["b"]) == held
    assert Joined({"b": tie("a", 1.01, 0.0, 0.0, sd=0.05)}).after(before).tied["b"].at[0] == 1.01


def test_ties_that_go_round_in_a_circle_or_to_nobody_leave_one_frame():
    anchors = {k: {name: np.zeros(3)} for k, name in enumerate("abc")}
    round_again = {"a": tie("c", 1, 0, 0), "b": tie("a", 1, 0, 0), "c": tie("b", 1, 0, 0)}
    lies = into_one_frame(anchors, round_again)
    assert len(lies) == 2
    assert len({root for root, _, _ in lies.values()} - lies.keys()) == 1
    assert into_one_frame(anchors, {"a": tie("x", 1, 0, 0)}) == {}
    assert into_one_frame({1: {"a": np.zeros(3), "b": np.ones(3)}}, {"b": tie("a", 9, 9, 0)}) == {}


def test_a_robot_without_a_map_stands_where_it_was_sighted():
    anchor, at, told = np.array([1.0, 2.0, 0.5]), np.array([3.0, 0.0, 1.0]), np.array([0.4, -0.2, 2.0])
    shared = SharedMap()
    placed = {"r1": Placed(1, *ALONE), "r2": Placed(2, *ALONE)}
    shared.take(WovenTeam(placed, [], {(2, 0, 0, 0): b"x"}, 0, 3, anchors={"r1": np.zeros(3), "r2": anchor}))
    cov = np.diag([0.04, 0.01, 0.09])
    shared.take_joined(
        Joined({}, {"r3": SightedAt("r2", at, cov, told), "r4": SightedAt("gone", at, cov, told)}, ["tied"])
    )
    assert shared.placed.keys() == {"r1", "r2", "r3"}
    pose, spread = shared.placed["r3"].carry(told, np.eye(3))
    np.testing.assert_allclose(pose, se2.compose(anchor, at), atol=1e-12)
    np.testing.assert_allclose(spread, se2.turned_covariance(anchor[2], cov), atol=1e-12)
    assert shared.placed["r3"].component == shared.placed["r2"].component == 2
    assert list(shared.tiles) == [(2, 0, 0, 0)]
    assert shared.decisions == ["tied"]


@pytest.mark.drawn
@pytest.mark.long
def test_a_map_process_interrupted_twice_at_work_is_gone_and_its_store_holds_all(team, direct, tmp_path):
    fleet = Fleet(tmp_path, team[0])
    try:
        fleet.map(robots=",".join([*NAMES, "r9"]))  # waits on for one that never comes
        for name in NAMES:
            fleet.robot(name, rate="inf")
        for name in NAMES:
            assert fleet.wait(name) == 0, fleet.said(name)
        fleet.interrupt("map")  # what was heard is still being followed and solved
        fleet.hears("map", " messages")
        fleet.interrupt("map")  # and now the final map is made
        assert fleet.wait("map") == 130, fleet.said("map")
        assert "Traceback" not in fleet.said("map")
        assert not (tmp_path / "out-map").exists()
        fleet.map(robots=",".join(NAMES))
        assert fleet.wait("map") == 0, fleet.said("map")
    finally:
        fleet.end()
    same_result(direct, tmp_path / "out-map")
