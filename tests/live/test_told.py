"""What a team tells its robots back: places, map and goals, to who asks for them."""

import time

import live_explore
import msgspec
import numpy as np
import pytest

import mapweave
from mapweave.api.live_explore import Explorer, PartPlanner
from mapweave.core.errors import DataError, UsageError
from mapweave.exploration.laser.config import LaserExploreConfig
from mapweave.live.door import decode
from mapweave.live.messages import Closed, GoalMessage, MapState, RobotState, Scans, Tile, Topics, encode
from mapweave.live.store import Store
from mapweave.live.tiles import SIDE, pack
from mapweave.live.told import MOST_GOALS, MOST_MAPS, STALE, LiveTeam, hear_team
from mapweave.live.transport import Network, put, session, told_on
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

from .processes import free_endpoint

STAND = {"run": "a", "log_robot": "robot1", "sensor": "laser", "finished": False, "have": 1, "last": 0, "rate": 1.0}


def state(name="map", robots=("r1",), part=1, shift=0.0):
    every = [
        RobotState(robot=r, there=True, component=part, pose=(shift + k, 2.0, 0.5), cov=(0.1, 0.0, 0.0, 0.2, 0.0, 0.3),
                   frame=(shift, 0.0, 0.0), **STAND)
        for k, r in enumerate(robots)
    ]  # fmt: skip
    return MapState(map=name, clock=0.0, fused=1, robots=every, landmarks=[], decisions=[])


def tile(i, j, value, name="map", level=0, component=1):
    cells = pack(np.full((SIDE, SIDE), value, np.uint8)) if value else b""
    return Tile(map=name, component=component, level=level, i=i, j=j, cell=0.05 * 4**level, cells=cells)


def goal(robot="r1", teller="explore", of="map", number=1, pose=(1.0, 2.0, 0.5)):
    return GoalMessage(map=teller, of=of, robot=robot, component=1, number=number, pose=pose)


def test_a_robots_place_is_the_one_that_the_first_map_process_by_name_told():
    now = [0.0]
    team = LiveTeam(lambda: now[0])
    assert team.map == ""
    assert team.robots() == {}
    team.take(state("b", shift=5.0))
    team.take(state("a", ("r1", "r2")))
    one = team.robots()["r2"]
    np.testing.assert_array_equal(one.pose, [1.0, 2.0, 0.5])
    np.testing.assert_array_equal(np.diag(one.cov), [0.1, 0.2, 0.3])
    now[0] = STALE
    team.take(state("b", shift=5.0))
    now[0] += 0.1  # by now the first is silent
    assert team.map == "b"
    assert float(team.robots()["r1"].frame[0]) == 5.0


def test_a_robot_that_stands_in_no_part_has_no_place():
    team = LiveTeam()
    team.take(state(part=0))
    one = team.robots()["r1"]
    assert (one.part, one.pose, one.cov, one.frame) == (0, None, None, None)


def test_squares_make_one_grid_whose_origin_is_the_lowest_corner_of_all():
    team = LiveTeam()
    team.take(state())
    assert team.grid() is None
    for square in (tile(-1, 0, 255), tile(0, 1, 1), tile(0, 0, 9, level=1), tile(5, 5, 7, component=2)):
        team.take_tile(square)
    grid = team.grid()
    assert grid.shape == (2 * SIDE, 2 * SIDE)
    np.testing.assert_allclose(grid.origin, [-SIDE * 0.05, 0.0])
    assert (grid.cells[:SIDE, :SIDE] == 255).all()
    assert (grid.cells[SIDE:, SIDE:] == 1).all()
    assert not grid.cells[:SIDE, SIDE:].any()
    p = grid.occupancy()
    assert (p[0, 0], p[-1, -1], p[0, -1]) == (1.0, 0.0, 0.5)
    plan = grid.planned_on(0.35)
    assert (int(plan.state[0, 0]), int(plan.state[-1, -1]), int(plan.state[0, -1])) == (1, 0, -1)
    team.take_tile(tile(-1, 0, 0))  # it is gone
    assert team.grid().shape == (SIDE, SIDE)
    team.take_tile(tile(200, 200, 1))
    with pytest.raises(DataError, match="of a map of 201 x 200 squares"):
        team.grid()


def test_a_goal_holds_for_the_map_it_was_made_in_until_it_is_told_no_more():
    now = [0.0]
    team = LiveTeam(lambda: now[0])
    team.take(state())
    assert team.goal("r1") is None
    team.take_goal(goal(teller="b", pose=(9.0, 9.0, 0.0)))
    team.take_goal(goal(teller="a"))
    team.take_goal(goal("r2", pose=()))
    np.testing.assert_array_equal(team.goal("r1").pose, [1.0, 2.0, 0.5])
    assert team.goal("r2") is None
    team.take(state("above"))  # another map process counts now, in whose map the goal is not
    assert team.goal("r1") is None
    del team.states["above"], team._heard["above"]
    assert team.goal("r1").number == 1
    now[0] = STALE + 0.1
    team.take(state())
    assert team.goal("r1") is None


def test_of_a_mixed_team_robots_with_a_laser_alone_are_sent_to_see(monkeypatch):
    both = state(robots=("r1", "r2"))
    both.robots[1] = msgspec.structs.replace(both.robots[1], sensor="landmarks")
    team = LiveTeam()
    team.take(both)
    monkeypatch.setattr(PartPlanner, "goals", lambda _, team, robots, *more: {r.name: (1.0, 2.0, 0.0) for r in robots})
    explorer = Explorer(LaserExploreConfig())
    explorer.look(team, 1)
    assert set(explorer.goals) == {"r1"}


def test_invented_maps_and_goals_take_no_room_without_end():
    team = LiveTeam()
    for k in range(MOST_GOALS + 50):
        team.take(state(f"m{k}"))
        team.take_goal(goal(f"r{k}"))
    assert len(team.states) == len(team._heard) == MOST_MAPS
    assert len(team._goals) == MOST_GOALS


def test_who_waits_is_woken_by_news_and_once_for_each():
    team = LiveTeam()
    assert not team.wait(0.0)
    team.take(state())
    assert team.wait(0.0)
    assert not team.wait(0.0)


def test_goals_and_maps_of_all_processes_that_connect_to_one_are_heard_and_forged_ones_are_not():
    at = free_endpoint()
    topics, team = Topics("team"), LiveTeam()
    here = Network(connect=(at,))
    with session(Network(listen=(at,))), session(here) as robot, session(told_on(here)) as other:
        held = hear_team(robot, topics, team, "r1", 1)

        def tell_all():
            put(other, topics.map_state("map"), encode(state()))
            put(other, topics.tile("map", tile(0, 0, 3, level=1)), encode(tile(0, 0, 3, level=1)))
            put(other, topics.tile("map", tile(0, 0, 3)), encode(tile(0, 0, 3)))
            put(other, topics.goal("r1", "forged"), encode(goal(teller="a", pose=(7.0, 7.0, 0.0))))
            put(other, topics.goal("r1", "explore"), b"nonsense")
            put(other, topics.goal("r1", "explore"), encode(goal()))
            team.wait(0.5)

        end = time.monotonic() + 20.0
        while (team.goal("r1") is None or team.grid(level=1) is None) and time.monotonic() < end:
            tell_all()  # what is told before they are connected is lost, and each topic connects on its own
        tell_all()
        assert team.goal("r1") is not None
        assert set(team._goals) == {("explore", "r1")}
        assert team.grid(level=1) is not None
        assert team.grid() is None  # that level was not asked for
        assert len(held) == 3


@pytest.fixture(scope="module")
def drive():
    return simulate_corridor(CorridorConfig(distance=3.0), seed=2).log


def tell(robot, log, rows):
    for k in rows:
        scan = log.scans[k]
        given = {"odometry": scan.odometry, "intensities": scan.intensities, "range_max": scan.range_max}
        robot.add_scan(float(log.scan_t[k]), scan.ranges, scan.angles(), **given)


def alone(tmp_path, **more):
    """A robot that nobody hears."""
    network = Network(listen=("tcp/127.0.0.1:0",))
    given = {"network": network, "history": tmp_path / "r7", "say": lambda _: None, "linger": 0.0}
    return mapweave.LiveLaser("r7", **given | more)


def test_scans_that_a_program_hands_in_are_told_as_they_are_and_go_on_where_the_history_ends(tmp_path, drive):
    half = len(drive.scans) // 2
    with alone(tmp_path) as robot:
        assert robot.place is None
        tell(robot, drive, range(half))
        end = time.monotonic() + 60.0
        while robot.place is None and time.monotonic() < end:
            time.sleep(0.05)
        place = robot.place
        assert place.part == 0
        assert place.pose is None
        assert place.own_cov.shape == (3, 3)
    with Store(tmp_path / "r7", "robot r7 of team team") as store:
        kept = [decode(payload) for _, payload in store.get("r7", 0, 1 << 30)]
    assert isinstance(kept[-1], Closed)
    assert kept[0].log_robot == "robot7"
    beams = [b for m in kept if isinstance(m, Scans) for b in m.scans]
    assert [b.t for b in beams] == drive.scan_t[:half].tolist()
    with pytest.raises(UsageError, match="this drive has ended"), alone(tmp_path) as robot:
        tell(robot, drive, range(half, half + 1))


def test_scans_before_the_history_s_last_are_refused_and_one_that_was_cut_off_goes_on(tmp_path, drive):
    with alone(tmp_path, fresh=True) as robot:
        tell(robot, drive, range(10))
    with Store(tmp_path / "r7", "robot r7 of team team") as store:  # as if it had been killed before its end
        numbers = store.numbers("r7")
        store._db.execute("DELETE FROM messages WHERE seq = ?", (max(numbers),))
    with alone(tmp_path) as robot:
        with pytest.raises(DataError, match="goes on after"):
            tell(robot, drive, range(3, 4))
        with pytest.raises(DataError, match="as many ranges as angles"):
            robot.add_scan(1e9, [1.0], [0.0, 0.1])
    with pytest.raises(UsageError, match="within its with block"):
        tell(robot, drive, range(11, 12))


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: mapweave.LiveLaser("a/b"), "--name: expected letters"),
        (lambda: mapweave.LiveLaser("r1", period=0.0), "period: expected seconds above 0"),
        (lambda: mapweave.LiveLaser("r1", linger=float("nan")), "linger: expected seconds"),
        (lambda: mapweave.live_follow(level=3).__enter__(), "level: expected 0 to 2, found 3"),
        (lambda: mapweave.live_explore(radius=0.0), "--radius: expected metres above 0"),
        (lambda: mapweave.live_explore(name="a b"), "--name: expected letters"),
    ],
)
def test_what_cannot_be_is_told(call, told):
    with pytest.raises(UsageError, match=told):
        call()


@pytest.mark.slow
def test_simulated_robots_drive_where_the_team_sends_them_and_see_most_of_the_office():
    found = live_explore.explored(robots=2, area=150.0, rate=2.0, seconds=120.0)
    assert found["seen"] > 0.6
    assert found["goals"] >= 6
    assert found["collisions"] == 0
    assert found["off_p50"] < 0.1
    assert found["tied"] == 2
