"""Laser robots woven while they drive: one map of those that can be tied, where each stands in it, and its squares."""

import time
import zlib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mapweave.api.laser_result import starts_among
from mapweave.core import se2
from mapweave.laser.occupancy_mapper import Returns, render_returns
from mapweave.live import pair_search
from mapweave.live.door import decode
from mapweave.live.driven import DrivenSession, Seen
from mapweave.live.laser_stream import messages_of_laser
from mapweave.live.laser_team import LiveLaserTeam, WovenTeam, nobody
from mapweave.live.laser_weaver import LaserWeaver
from mapweave.live.messages import Tile, encode
from mapweave.live.pair_search import PairSearch, PairTrial
from mapweave.live.shared_map import SharedMap
from mapweave.live.store import Store
from mapweave.live.tile_mapper import Standing, TileMapper
from mapweave.live.tiles import COARSER, LEVELS, SIDE, is_tile, pack
from mapweave.live.weaving import Placed
from mapweave.mapping import known_places
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.merge import MapClosure, Merge, merge_maps
from mapweave.mapping.merge_search import MergeConfig
from mapweave.mapping.session import LaserSession
from mapweave.sim.laser import drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

CFG = LaserConfig(method="graph", threads=1)
WORLD = OfficeConfig(rooms=2, visited=2)


@cache
def drives():
    """Two robots that start at one place and go through the office by ways of their own."""
    world = office_world(WORLD, 3)
    return [drive(world, office_route(WORLD, k), WORLD.drive, k) for k in (1, 2)]


@cache
def payloads():
    out = {}
    for k, made in enumerate(drives(), 1):
        log = replace(made.log, robot=f"robot{k}", source=f"sim-{k}")
        out[f"r{k}"] = [encode(m) for _, m in messages_of_laser(log, f"r{k}", "a", 1.0)]
    return out


def filled(path, share=1.0):
    """A store of the first messages of both, and how many there are of each."""
    store = Store(path, "a map")
    heard = {name: max(2, round(share * len(messages))) for name, messages in payloads().items()}
    for name, n in heard.items():
        store.put([(name, seq, payload) for seq, payload in enumerate(payloads()[name][:n])])
    return store, heard


def docked(names):
    return starts_among(names, dict.fromkeys(names, (0.0, 0.0, 0.0)), MergeConfig())


def woven(team):
    """The map with every decision that is wanted now."""
    while (trial := team.trial()) is not None:
        team.search.decided(trial, trial.run())
    team.take(team.weaving().run())
    while True:
        drawn = team.draw({})
        if not team.unlaid:
            return drawn


def apart(team, woven):
    """The second robot seen from the first, less the truth; and the sum of both told covariances."""
    poses, true, told = [], [], np.zeros((3, 3))
    for (name, placed), made in zip(woven.placed.items(), drives(), strict=True):
        local = team.robots[name].session.now
        pose, cov = placed.carry(local.pose, local.cov)
        t = team.robots[name].record.t
        poses.append(pose)
        true.append(se2.interpolate(np.array([t]), made.truth.t, made.truth.pose)[0])
        assert (np.linalg.eigvalsh(cov) > -1e-12).all()
        told += cov
    return se2.between(se2.between(*true), se2.between(*poses)), told


def test_robots_are_one_map_while_they_drive_and_stand_where_they_are_in_it(tmp_path):
    store, heard = filled(tmp_path / "s.sqlite")
    with store:
        team = LiveLaserTeam(store, CFG, docked)
        for share, least in ((0.6, 0.4), (1.0, 0.1)):  # half way one of them is in a corridor, and says so
            while team.follow({name: round(share * n) for name, n in heard.items()}):
                pass
            drawn = woven(team)
            assert {name: p.component for name, p in drawn.placed.items()} == {"r1": 1, "r2": 1}
            assert len(drawn.decisions) == 1
            assert drawn.decisions[0].startswith("r1 and r2: merged on")
            assert drawn.worked == {name: round(share * n) for name, n in heard.items()}
            off, told = apart(team, drawn)
            assert np.hypot(*off[:2]) < least
            assert np.hypot(*off[:2]) < 3.5 * np.sqrt(told[0, 0] + told[1, 1])
            assert np.sqrt(told[0, 0] + told[1, 1]) < 0.3


@pytest.mark.slow
def test_what_was_decided_on_a_pair_stands_until_the_maps_have_grown(tmp_path, monkeypatch):
    searched = []
    monkeypatch.setattr(pair_search, "merge_maps", lambda *a: searched.append(1) or merge_maps(*a))
    store, heard = filled(tmp_path / "s.sqlite")
    with store:
        team = LiveLaserTeam(store, CFG, docked)
        for share, expected in ((0.5, 1), (0.52, 1), (1.0, 2)):
            now = {name: round(share * n) for name, n in heard.items()}
            while team.follow(now):
                pass
            drawn = woven(team)
            assert len(searched) == expected
            assert drawn.placed["r2"].component == 1
    assert drawn.number == 3


def test_a_gap_in_the_store_is_waited_for(tmp_path):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        messages = payloads()["r1"]
        store.put([("r1", seq, messages[seq]) for seq in (0, 1, 2, 4)])
        team = LiveLaserTeam(store, CFG, nobody)
        assert team.follow({"r1": 5, "r9": 3}) == 2
        assert team.robots["r1"].next == 3
        store.put([("r1", 3, messages[3])])
        assert team.follow({"r1": 5}) == 0
        assert set(team.robots) == {"r1"}


def test_the_thread_weaves_what_it_hears_and_ends_when_told(tmp_path):
    store, heard = filled(tmp_path / "s.sqlite", 0.2)
    with store:
        weaver = LaserWeaver(store, CFG, every=0.1, starts=docked)
        weaver.start()
        weaver.hear(heard)
        end = time.monotonic() + 120
        while (weaver.newest is None or len(weaver.newest.placed) < 2) and time.monotonic() < end:
            time.sleep(0.05)
        weaver.stop()
    assert not weaver.failed
    assert set(weaver.newest.placed) == {"r1", "r2"}
    assert weaver.newest.tiles


def test_what_the_store_does_not_hold_is_waited_for_at_rest(tmp_path):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        store.put([("r1", 0, payloads()["r1"][0])])
        weaver = LaserWeaver(store, CFG, every=0.1)
        weaver.start()
        weaver.hear({"r1": 50})
        begin = time.process_time()
        time.sleep(1.0)
        assert time.process_time() - begin < 0.5
        weaver.stop()
    assert weaver.newest is None


def scans(n=12, beams=40):
    """What was seen around a loop, and where from."""
    rng = np.random.default_rng(4)
    angle = 2 * np.pi * np.arange(n) / n
    poses = np.column_stack([9 * np.cos(angle) - 3, 5 * np.sin(angle) + 1, angle])
    return poses, [Seen(rng.uniform(-8, 8, (beams, 2)), np.array([0.1, 0.05])) for _ in range(n)]


def standing(poses, ids=None):
    return {"r1": Standing(np.arange(len(poses)) if ids is None else np.asarray(ids), np.asarray(poses))}


def unpacked(data):
    return np.frombuffer(zlib.decompress(data), np.uint8).reshape(SIDE, SIDE)


def test_squares_hold_the_map_of_all_keyframes_wherever_they_were_before():
    poses, seen = scans()
    mapper = TileMapper(0.05)
    shaken = poses + np.random.default_rng(1).normal(0, 0.3, poses.shape)
    assert mapper.update(standing(shaken[:7]), lambda _, k: seen[k], 100) == 0
    mapper.draw()
    assert mapper.update(standing(poses), lambda _, k: seen[k], 4) == 8
    for left in (4, 0, 0):
        assert mapper.update(standing(poses), lambda _, k: seen[k], 4) == left
    drawn = mapper.draw()
    mapped = render_returns(
        [Returns(s.points, np.zeros((0, 2)), s.sensor, np.zeros((len(s.points), 2))) for s in seen], poses, 0.05, "map"
    )
    grid = np.where(mapped.hits + mapped.passes > 0, 1 + np.rint(254 * mapped.occupancy()), 0).astype(np.uint8)
    column, row = np.rint(mapped.origin / 0.05).astype(int)
    below = 2000  # cells, a multiple of the squares' sides on all levels
    for level in range(LEVELS):
        side = SIDE * COARSER**level
        origin = -side * (below // side + 1)
        whole = np.zeros((2 * -origin, 2 * -origin), np.uint8)
        whole[row - origin :, column - origin :][: grid.shape[0], : grid.shape[1]] = grid
        n = COARSER**level
        whole = whole.reshape(len(whole) // n, n, -1, n).max(axis=(1, 3))
        squares = {}
        for j in range(len(whole) // SIDE):
            for i in range(len(whole) // SIDE):
                cells = whole[SIDE * j : SIDE * (j + 1), SIDE * i : SIDE * (i + 1)]
                if cells.any():
                    squares[level, i + origin // side, j + origin // side] = cells
        assert {key for key in drawn if key[0] == level} == squares.keys()
        for key, cells in squares.items():
            np.testing.assert_array_equal(unpacked(drawn[key]), cells)


def test_only_what_moved_by_half_a_cell_is_laid_anew():
    poses, seen = scans()
    asked = []

    def saw(_, k):
        asked.append(k)
        return seen[k]

    mapper = TileMapper(0.05)
    mapper.update(standing(poses), saw, 100)
    moved = poses.copy()
    moved[:, 0] += 0.024
    moved[3, 1] += 0.03
    moved[5, 2] += 0.01 + 2 * np.pi
    del asked[:]
    mapper.update(standing(moved), saw, 100)
    assert sorted(asked) == [3, 5]
    del asked[:]
    grown = np.concatenate([moved + 1.0, poses[:1]])
    assert mapper.update(standing(grown), lambda r, k: saw(r, k % 12), 2) == 11
    assert asked == [0, 11]  # the new one, then the latest of those that moved


def test_a_square_that_nothing_is_in_any_more_goes():
    mapper = TileMapper(0.05)
    seen = Seen(np.array([[0.5, 0.0]]), np.zeros(2))
    mapper.update(standing(np.array([[1.0, 1.0, 0.0]])), lambda *_: seen, 10)
    assert {key[1:] for key in mapper.draw()} == {(0, 0)}
    mapper.update(standing(np.array([[-1.0, 1.0, np.pi]])), lambda *_: seen, 10)
    assert {key[1:] for key in mapper.draw()} == {(-1, 0)}


@pytest.mark.parametrize(
    "data", [b"", b"nothing", pack(np.zeros((4, 4), np.uint8)), pack(np.zeros((SIDE, SIDE), np.uint8))[:-3]]
)
def test_what_is_no_tile_is_not_taken_for_one(data):
    assert not is_tile(data)


def test_only_squares_that_changed_are_told_and_those_that_went():
    one, two, three = (pack(np.full((SIDE, SIDE), k, np.uint8)) for k in (1, 7, 9))
    team = WovenTeam({}, ["r1: the only one so far"], {(1, 0, 0, 0): one, (1, 0, 1, 0): three}, 0, 1)
    shared = SharedMap(name="m")
    assert len(shared.take(team)) == 2
    assert shared.take(team) == []
    told = {(t.i, t.j): t for t in shared.take(replace(team, tiles={(1, 0, 0, 0): two}))}
    assert told[1, 0].cells == b""
    assert told[0, 0].cells == two
    again = decode(encode(told[0, 0]))
    assert isinstance(again, Tile)
    assert (again.map, again.cell) == ("m", 0.05)


def test_a_woven_robots_covariance_is_that_of_its_keyframe_alone():
    cov = np.diag([0.04, 0.01, 0.001])
    placed = Placed(1, np.array([1.0, 2.0, 0.5]), cov, 1.0, own=False)
    pose, P = placed.carry(np.zeros(3), 100 * np.eye(3))
    np.testing.assert_allclose(pose, [1.0, 2.0, 0.5])
    np.testing.assert_allclose(P, cov)


def decided(a, b, size, *, merged):
    half = (size // 2, size - size // 2)
    trial = PairTrial(
        a, b, tuple(np.zeros((n, 3)) for n in half), ([], []), tuple(map(np.arange, half)), CFG.merge, None
    )
    return trial, Merge(a, b, merged=merged, reason="")


def test_every_robot_of_two_buildings_is_tried_on_a_part_once_before_any_a_second_time():
    sizes = {f"r{k:02}": 20 for k in range(40)}
    search, trials = PairSearch(), 0
    while len(set(search._roots(sizes).values())) > 2:
        a, b = search.next(sizes)
        search.decided(*decided(a, b, 40, merged=int(a[1:]) % 2 == int(b[1:]) % 2))
        sizes = {name: n + 1 for name, n in sizes.items()}  # what was refused soon has grown enough for another try
        trials += 1
    assert trials <= 38 + 40 // 2  # a tie each, and those of the smaller building refused once by the larger


def test_maps_too_small_to_be_tied_are_tried_after_all_others():
    search = PairSearch(ripe=13)
    sizes = {"r1": 40, "r2": 12, "r3": 13, "r4": 13}
    order = []
    while (pair := search.next(sizes)) is not None:
        order.append(pair)
        search.decided(*decided(*pair, sizes[pair[0]] + sizes[pair[1]], merged=False))
    assert order == [("r1", "r3"), ("r1", "r4"), ("r3", "r4"), ("r1", "r2"), ("r2", "r3"), ("r2", "r4")]


def test_pairs_are_searched_for_where_a_tie_is_missing_and_where_maps_have_grown():
    search = PairSearch()
    assert search.next({"r1": 9}) is None
    sizes = {"r1": 10, "r2": 30, "r3": 20, "r4": 40}
    order = []
    while (pair := search.next(sizes)) is not None:
        order.append(pair)
        search.decided(*decided(*pair, sizes[pair[0]] + sizes[pair[1]], merged=pair in {("r2", "r4"), ("r3", "r4")}))
    # r2 and r3 hang together by r4; r1, which nothing ties, was tried on all
    assert order == [("r2", "r4"), ("r3", "r4"), ("r1", "r4"), ("r1", "r2"), ("r1", "r3")]
    assert search.next({**sizes, "r1": 20}) == ("r1", "r2")  # a quarter more; and so has r1 with r3
    assert search.next({**sizes, "r4": 60}) == ("r2", "r4")  # a tie is looked at again with more of both
    assert search.next({**sizes, "r3": 35}) == ("r3", "r4")
    known = search.known({name: np.arange(n) for name, n in sizes.items()})
    assert len(known) == 6
    assert [pair for pair, merge in known.items() if merge.merged] == [(1, 3), (2, 3)]
    assert known[1, 2].reason == "not tried on each other yet"


def test_a_driven_estimate_is_that_of_the_whole_log_and_keeps_returns_of_keyframes_alone():
    log = drives()[0].log
    whole, driven = LaserSession(log.robot, CFG), DrivenSession(log.robot, CFG)
    for event in list(log.events())[:900]:
        whole.push(event)
        driven.push(event)
    assert driven.now.pose.tobytes() == whole.now.pose.tobytes()
    assert driven.now.cov.tobytes() == whole.now.cov.tobytes()
    a, b = driven.graph(covariances=False), whole.graph(covariances=False)
    assert a.points.tobytes() == b.points.tobytes()
    bare = driven.bare_graph("r1")
    assert len(bare) == len(a) > 10
    assert bare.step.tobytes() == a.step.tobytes()
    held = [b.s.size for b in driven._state().scans]
    assert sum(size > 0 for size in held) <= 1  # of the newest scan
    assert not driven.scans
    assert sum(b.s.size for b in whole._state().scans) > 0


def test_while_messages_wait_scans_are_passed_over_that_show_less_new_and_the_way_stays_what_it_is(tmp_path):
    store, heard = filled(tmp_path / "s.sqlite")
    with store:
        at_ease, hurried = (LiveLaserTeam(store, CFG, docked) for _ in range(2))
        for end in range(2, max(heard.values()) + 1):
            at_ease.follow({name: min(n, end) for name, n in heard.items()})
        while hurried.follow(heard):
            pass
    sessions = [team.robots["r1"].session for team in (at_ease, hurried)]
    assert at_ease.robots["r1"].next == hurried.robots["r1"].next
    scans = [len(session._state().scans) for session in sessions]
    assert 0.3 * scans[0] < scans[1] < 0.8 * scans[0]
    off = se2.between(*(session.now.pose for session in sessions))
    assert np.hypot(*off[:2]) < 0.3


@pytest.fixture
def leaving(monkeypatch):
    """Settings with which keyframes leave as soon as a place was found again."""
    for name, value in (("KNOWN_NEAR", 50.0), ("KNOWN_TURN", 4.0), ("KNOWN_FAR", 0.0)):
        monkeypatch.setattr(known_places, name, value)
    eager = replace(CFG.graph.known_places, enough=1)
    return replace(CFG, graph=replace(CFG.graph, known_places=eager))


def test_keyframes_of_a_driven_estimate_leave_as_those_of_a_log_and_are_known_by_their_scans(leaving):
    log = drives()[0].log
    whole, driven = LaserSession(log.robot, leaving), DrivenSession(log.robot, leaving)
    went, known = {}, {}
    for event in log.events():
        whole.push(event)
        driven.push(event)
        if driven.keyframes is None:
            continue
        went |= driven.left
        for k, node in zip(driven.ids.tolist(), driven.keyframes.nodes, strict=True):
            assert known.setdefault(k, node.t) == node.t
        driven.left.clear()
    a, b = driven.graph(covariances=False), whole.graph(covariances=False)
    assert a.pose.tobytes() == b.pose.tobytes()
    assert a.points.tobytes() == b.points.tobytes()
    assert a.revisits.step.tobytes() == b.revisits.step.tobytes()
    assert len(a.revisits) == len(went) > 5
    assert known.keys() == {*went, *driven.ids.tolist()}
    for k, seen in went.items():
        scan = int(np.flatnonzero(log.scan_t == known[k])[0])
        assert 0 < len(seen.points) <= log.scans[scan].hit.sum()
        with pytest.raises(KeyError):
            driven.seen(k)
    assert driven.seen(int(driven.ids[-1])).points.tobytes() == driven.keyframes.nodes[-1].beams.s.tobytes()


@pytest.mark.slow
def test_a_team_whose_keyframes_leave_stays_one_map_of_those_that_stay(tmp_path, leaving):
    store, heard = filled(tmp_path / "s.sqlite")
    with store:
        team = LiveLaserTeam(store, leaving, docked)
        for share in (0.6, 1.0):
            while team.follow({name: round(share * n) for name, n in heard.items()}):
                pass
            drawn = woven(team)
            assert {name: p.component for name, p in drawn.placed.items()} == {"r1": 1, "r2": 1}
        afresh = TileMapper(CFG.resolution)
        for name, robot in team.robots.items():
            assert not robot.session.left
            afresh.update({name: team._mappers[0].laid[name]}, lambda _, k, at=robot: at.session.seen(k), 10_000)
            np.testing.assert_array_equal(team._mappers[0].laid[name].ids, robot.session.ids)
        assert {(1, *key): cells for key, cells in afresh.draw().items()} == drawn.tiles
        assert sum(len(robot.session.graph(covariances=False).revisits) for robot in team.robots.values()) > 5


def test_what_a_keyframe_laid_goes_with_it():
    poses, seen = scans()
    mapper, left = TileMapper(0.05), TileMapper(0.05)
    mapper.update(standing(poses), lambda _, k: seen[k], 100)
    stay = [0, 1, 2, 6, 7, 11]
    assert mapper.update(standing(poses[stay], stay), lambda _, k: seen[k], 0) == 0
    left.update(standing(poses[stay], stay), lambda _, k: seen[k], 100)
    assert mapper.draw() == left.draw()


def test_a_tie_counts_the_keyframes_that_are_there_and_goes_with_the_last_of_them():
    search = PairSearch()
    trial, merge = decided("r1", "r2", 20, merged=True)
    ends = ((2, 3), (5, 3), (9, 8))
    closures = tuple(
        MapClosure(i, j, np.zeros(3), np.eye(3), 1.0, 0.0, 1.0, 0.0, accepted=k < 2, reason="")
        for k, (i, j) in enumerate(ends)
    )
    search.decided(trial, replace(merge, closures=closures))
    now = np.delete(np.arange(12), [3, 4, 5]), np.delete(np.arange(14), [0])
    known = search.known({"r1": now[0], "r2": now[1]})[0, 1]
    assert [(c.first, c.second, c.accepted) for c in known.closures] == [(2, 2, True), (6, 7, False)]
    gone = search.known({"r1": np.arange(6, 12), "r2": now[1]})[0, 1]
    assert not gone.merged
    assert search.next({"r1": 6, "r2": 13}) == ("r1", "r2")
