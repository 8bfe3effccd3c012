"""Laser robots woven while they drive: one map of those that can be tied, where each stands in it, and its squares."""

import time
import zlib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mapweave.api.weave_laser import starts_among
from mapweave.core import se2
from mapweave.laser import weave
from mapweave.laser.config import LaserConfig
from mapweave.laser.laser_map import GridMap
from mapweave.laser.merge import merge_maps
from mapweave.live.laser_stream import messages_of_laser
from mapweave.live.laser_team import LaserTeam, LaserWeaver, WovenTeam, nobody
from mapweave.live.messages import Tile, decode, encode
from mapweave.live.placed import Placed
from mapweave.live.shared_map import SharedMap
from mapweave.live.store import Store
from mapweave.live.tile_bytes import SIDE, is_tile, pack
from mapweave.live.tiles import COARSER, LEVELS, tiles_of
from mapweave.sim.laser import drive
from mapweave.sim.office import OfficeConfig, office_route, office_world

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
    return starts_among(names, dict.fromkeys(names, (0.0, 0.0, 0.0)))


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
        team = LaserTeam(store, CFG, docked)
        for share, least in ((0.6, 0.4), (1.0, 0.1)):  # half way one of them is in a corridor, and says so
            while team.follow({name: round(share * n) for name, n in heard.items()}):
                pass
            woven = team.weave(0)
            assert {name: p.component for name, p in woven.placed.items()} == {"r1": 1, "r2": 1}
            assert len(woven.decisions) == 1
            assert woven.decisions[0].startswith("r1 and r2: merged on")
            off, told = apart(team, woven)
            assert np.hypot(*off[:2]) < least
            assert np.hypot(*off[:2]) < 3.5 * np.sqrt(told[0, 0] + told[1, 1])
            assert np.sqrt(told[0, 0] + told[1, 1]) < 0.3


def test_what_was_decided_on_a_pair_stands_until_the_maps_have_grown(tmp_path, monkeypatch):
    searched = []
    monkeypatch.setattr(weave, "merge_maps", lambda *a: searched.append(1) or merge_maps(*a))
    store, heard = filled(tmp_path / "s.sqlite")
    with store:
        team = LaserTeam(store, CFG, docked)
        for share, expected in ((0.5, 1), (0.52, 1), (1.0, 2)):
            now = {name: round(share * n) for name, n in heard.items()}
            while team.follow(now):
                pass
            woven = team.weave(0)
            assert len(searched) == expected
            assert woven.placed["r2"].component == 1
    assert woven.number == 3


def test_a_gap_in_the_store_is_waited_for(tmp_path):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        messages = payloads()["r1"]
        store.put([("r1", seq, messages[seq]) for seq in (0, 1, 2, 4)])
        team = LaserTeam(store, CFG, nobody)
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


def grid(rows=150, cols=300, origin=(-1.0, -3.2)):
    hits = np.zeros((rows, cols), np.int32)
    passes = np.ones((rows, cols), np.int32)
    passes[:, :5] = 0
    hits[40, 50] = 30
    none = np.zeros((rows, cols))
    return GridMap(0.05, np.array(origin), hits, passes, np.zeros((rows, cols, 2)), none, none)


def test_a_wall_is_seen_on_every_level_at_its_place():
    tiles = tiles_of(grid(), 2)
    wall = np.array([-1.0, -3.2]) + 0.05 * (np.array([50, 40]) + 0.5)
    for level in range(LEVELS):
        side = 0.05 * COARSER**level
        column, row = np.floor(wall / side).astype(int)
        data = tiles[2, level, column // SIDE, row // SIDE]
        assert is_tile(data)
        cells = np.frombuffer(zlib.decompress(data), np.uint8).reshape(SIDE, SIDE)
        assert cells[row % SIDE, column % SIDE] > 240
        assert (cells > 240).sum() == 1
    assert {key[0] for key in tiles} == {2}
    finest = sum((np.frombuffer(zlib.decompress(d), np.uint8) > 0).sum() for k, d in tiles.items() if not k[1])
    assert finest == 150 * 295


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
