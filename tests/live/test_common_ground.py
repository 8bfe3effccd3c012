"""What two live laser robots are expected to have seen in common, and the order in which pairs are tried by it."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.live.driven import DrivenSession
from mapweave.live.laser_stream import messages_of_laser
from mapweave.live.laser_team import COARSE, FINE, LiveLaserTeam, WallCells, in_common
from mapweave.live.messages import encode
from mapweave.live.pair_search import LIKELY, PairSearch, PairTrial
from mapweave.live.store import Store
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.merge import Merge
from mapweave.mapping.merge_search import Start
from mapweave.sim.laser import drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

CFG = LaserConfig(method="graph", threads=1)
WORLD = OfficeConfig(rooms=2, visited=1)
HERE = Start(np.zeros(3), np.full(3, 0.1))


@pytest.fixture(scope="module")
def session():
    """A robot that drove for a while, and what it made of it half way."""
    made = drive(office_world(WORLD, 3), office_route(WORLD, 1), WORLD.drive, 1)
    driven, walls = DrivenSession(made.log.robot, CFG), WallCells()
    events = list(made.log.events())[:700]
    for k, event in enumerate(events):
        driven.push(event)
        if k == len(events) // 2:
            walls.take(driven)
    return driven, walls


def test_walls_are_those_of_all_keyframes_each_cell_once(session):
    driven, walls = session
    half = len(walls.cells)
    walls.take(driven)
    assert len(walls.cells) > half > 0
    assert walls.until == driven.ids[-1]
    graph = driven.keyframes
    seen = np.concatenate([se2.act(graph.pose[k], graph.nodes[k].beams.s) for k in range(len(graph))])
    near = np.abs(seen[:, None] - walls.centres).max(axis=2).min(axis=1)
    assert near.max() < 0.5 * FINE + 0.1  # keyframes may have moved since they came
    assert len(np.unique(walls.centres, axis=0)) == len(walls.cells)
    before = walls.cells
    walls.take(driven)
    assert walls.cells is before


def walls(*at):
    """Walls at these places [m]."""
    column, row = np.floor(np.array(at, dtype=float) / FINE).astype(np.int64).T
    return WallCells(np.unique((1 << 20) * column + row), 0)


def test_walls_are_in_common_where_starts_lay_them_on_each_other():
    row = [(k + 0.2, -3.3) for k in range(-6, 6)]
    turned = [(-y - 0.1, x) for x, y in row]  # a quarter turn, thirty metres off
    far = Start(np.array([30.0, 0.0, -np.pi / 2]), np.full(3, 0.1))
    team = {"r1": walls(*row), "r2": walls(*row[:5]), "r3": walls(*turned), "r4": walls(*row)}
    found = in_common(team, {1: HERE, 2: far})
    assert found == {("r1", "r2"): 5, ("r1", "r3"): 0, ("r2", "r3"): 0}  # nobody says where r4 starts
    back = Start(np.array([0.0, 0.0, -np.pi / 2]), np.full(3, 0.1))
    assert in_common(team, {1: HERE, 2: back})["r1", "r3"] >= len(row) - 1
    assert in_common(team, {}) == {}
    assert COARSE > FINE


def trial(a, b, size, common):
    ids = (np.arange(size // 2), np.arange(size - size // 2))
    poses = tuple(np.zeros((len(one), 3)) for one in ids)
    return PairTrial(a, b, poses, ([], []), ids, CFG.merge, HERE, common)


def test_pairs_that_saw_much_in_common_are_tried_first_and_again_when_it_is_more():
    search = PairSearch()
    sizes = {"r1": 10, "r2": 10, "r3": 10, "r4": 40}
    common = {("r1", "r2"): LIKELY, ("r1", "r3"): 3 * LIKELY, ("r2", "r3"): LIKELY - 1}
    assert search.next(sizes, common) == ("r1", "r3")
    search.decided(trial("r1", "r3", 20, 3 * LIKELY), Merge("r1", "r3", merged=False, reason=""))
    assert search.next(sizes, common) == ("r1", "r2")
    search.decided(trial("r1", "r2", 20, LIKELY), Merge("r1", "r2", merged=True, reason=""))
    assert search.apart(sizes)
    assert search.next(sizes, common) == ("r1", "r4")  # never tried, and the largest
    grown = {**common, ("r1", "r3"): 4 * LIKELY}
    assert search.next(sizes, grown) == ("r1", "r3")
    assert search.next(sizes, {**grown, ("r1", "r2"): 9 * LIKELY}) == ("r1", "r3")  # r1 and r2 hang together
    for name in ("r3", "r4"):
        search.decided(trial("r1", name, 50, 0), Merge("r1", name, merged=True, reason=""))
    assert not search.apart(sizes)


def test_a_team_tries_those_first_that_saw_the_same(tmp_path):
    log = drive(office_world(WORLD, 3), office_route(WORLD, 1), WORLD.drive, 1).log
    far = Start(np.array([500.0, 0.0, 0.0]), np.full(3, 0.1))
    names = ("r1", "r2", "r3")
    with Store(tmp_path / "s.sqlite", "a map") as store:
        for name in names:
            told = [encode(m) for _, m in messages_of_laser(replace(log, source="sim"), name, "a", 1.0)][:12]
            store.put([(name, seq, payload) for seq, payload in enumerate(told)])
        team = LiveLaserTeam(store, CFG, lambda names: {names.index("r2"): far, names.index("r3"): HERE})
        while team.follow(dict.fromkeys(names, 12)):
            pass
        first = team.trial()
        assert (first.a, first.b) == ("r1", "r3")
        assert first.common >= LIKELY
        np.testing.assert_array_equal(first.start.transform, np.zeros(3))
        team.search.decided(first, Merge("r1", "r3", merged=True, reason=""))
        second = team.trial()
        assert "r2" in {second.a, second.b}
        assert second.common == 0
