"""Exploration among walls: every planner finishes, walls hide, pockets are told, bad plans are refused."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mapweave.api.explore import explore
from mapweave.core.errors import ConfigError, DataError, ReaderError, UsageError
from mapweave.exploration.landmarks.config import (
    ExploreConfig,
    ScenarioConfig,
    bounds,
    find_scenario,
    find_walls,
    make_field,
)
from mapweave.exploration.landmarks.experiment import (
    CALIBRATED,
    LandmarkMission,
    explore_many,
    explore_once,
    with_noise,
)
from mapweave.exploration.landmarks.objective import PUT_OFF_AFTER, given_up, next_target, offered
from mapweave.exploration.landmarks.team import Team
from mapweave.exploration.planner_interface import find_planner
from mapweave.io.mrclam import read_mrclam
from mapweave.kernels.walls.segments import distance_of_moves
from mapweave.landmarks.submap_slam import SubmapConfig, move

BOX = ((50.0, 32.0, 56.0, 32.0), (56.0, 32.0, 56.0, 37.0), (56.0, 37.0, 50.0, 37.0), (50.0, 37.0, 50.0, 32.0))
INNER = (
    (20.0, 0.0, 20.0, 14.0),
    (20.0, 18.0, 20.0, 40.0),
    (40.0, 0.0, 40.0, 24.0),
    (40.0, 28.0, 40.0, 40.0),
    (20.0, 20.0, 27.0, 20.0),
    (31.0, 20.0, 40.0, 20.0),
)
STARTS = ((4.0, 4.0, 0.0), (4.0, 8.0, 0.0), (8.0, 4.0, 0.0), (8.0, 8.0, 0.0))
HALL = ScenarioConfig(lower=(0.0, 0.0), upper=(60.0, 40.0), landmarks=20, starts=STARTS, walls=INNER + BOX)
ROOM = ScenarioConfig(lower=(0.0, 0.0), upper=(24.0, 12.0), landmarks=6, starts=((3.0, 6.0, 0.0),))
KNOWN = with_noise(ExploreConfig(submap=SubmapConfig(association="known")), CALIBRATED)


def mean(runs, name):
    return float(np.mean([getattr(r, name) for r in runs]))


@pytest.mark.slow
def test_every_planner_explores_a_hall_with_walls_honestly():
    jcbb = replace(KNOWN, submap=replace(KNOWN.submap, association="jcbb"))
    four = LandmarkMission(HALL, 4, "coverage", "field", {1: 30}, 0.2, KNOWN)
    missions = [LandmarkMission(HALL, 2, name, "field", cfg=KNOWN) for name in ("paper", "area", "coverage", "loop")]
    every = [explore_many(m, 2, 0) for m in missions]
    others = [explore_many(m, 2, 0) for m in (four, replace(missions[2], cfg=jcbb))]
    for runs in every + others:
        assert all(r.finished for r in runs)
    assert sum(r.missed for runs in every + others for r in runs) <= 1  # of 350 landmarks: the field is the goal
    for runs in every:
        assert 0.7 <= mean(runs, "nees_per_dof") <= 1.4
        assert mean(runs, "map_error") <= 0.40
    assert sum(r.collisions for runs in every for r in runs) <= 4


@pytest.mark.parametrize("name", ["paper", "area", "coverage", "loop"])
def test_until_landmarks_leaves_out_those_nobody_can_see(name):
    room = replace(
        ROOM, landmarks=((5.0, 3.0), (20.0, 3.0), (20.0, 9.0), (18.0, 6.5)), walls=shut(17.0, 5.0, 19.0, 8.0)
    )
    score, record = explore_once(LandmarkMission(room, 1, name, "landmarks", cfg=KNOWN), 0)
    assert score.finished
    assert (score.hidden, score.missed) == (1, 0)
    assert record.floor.hidden == (3,)
    assert "m3" not in record.map.ids or len(record.map.ids) == 3


def shut(x0, y0, x1, y1):
    return ((x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0))


def test_walls_hide_cells_and_landmarks():
    wall = replace(ROOM, landmarks=((9.0, 6.0), (15.0, 6.0)), walls=((12.0, 2.0, 12.0, 10.0),))
    team = Team(make_field(wall, 1, 0), KNOWN, find_planner("coverage", "landmarks"), np.random.default_rng(0))
    first = team.observe_start()
    assert first.sightings[0].ids == ("0",)
    seen = team.explored.team()
    assert seen[6, 10]
    assert not seen[6, 12:].any()
    assert not seen[2, 16]


def test_an_unreachable_pocket_is_left_out_and_reported(tmp_path):
    scenario = tmp_path / "room.toml"
    scenario.write_text(
        "lower = [0.0, 0.0]\nupper = [24.0, 12.0]\nstarts = [[3.0, 6.0, 0.0]]\n"
        "landmarks = [[5.0, 3.0], [20.0, 3.0], [20.0, 9.0], [18.0, 6.5]]\n"
        "walls = [[17.0, 5.0, 19.0, 5.0], [19.0, 5.0, 19.0, 8.0], [19.0, 8.0, 17.0, 8.0], [17.0, 8.0, 17.0, 5.0]]\n"
    )
    out = tmp_path / "out"
    result = explore(str(scenario), out, runs=2, planner="coverage", association="known")
    told = result.metrics["left_out"]
    assert told["pockets"] == 1
    assert told["area_m2"] == pytest.approx(6.0, abs=1.0)
    assert told["landmarks"] == [{"landmark": 4, "x": 18.0, "y": 6.5}]
    assert result.averages()["finished"] == 2
    assert result.first.moments[-1].explored == 1.0
    lines = "\n".join(result.lines())
    assert "a pocket no robot can see into, 6 m²" in lines
    assert "4 at (18.0, 6.5)" in lines
    assert "a pocket no robot can see into" in (out / "report.html").read_text(encoding="utf-8").lower()
    assert (out / "runs.csv").read_text().splitlines()[1].endswith(",0,1,1,,0,1")
    assert len(read_mrclam(out / "log")) == 1


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"starts": ((12.1, 6.0, 0.0),)}, r"robot 1 at \(12.1, 6\) starts 0.1 m from a wall; its radius is 0.3 m"),
        ({"starts": ((3.0, 3.0, 0.0), (12.0, 6.0, 0.0))}, r"robot 2 at \(12, 6\) lies inside a wall"),
        ({"landmarks": ((5.0, 5.0), (12.0, 4.0))}, r"landmark 2 at \(12, 4\) lies inside a wall"),
        ({"starts": ((11.65, 6.0, 0.0),), "walls": shut(11.0, 5.0, 12.3, 7.0)}, r"robot 1 .* has nowhere to go"),
        ({"landmarks": 0}, "no landmarks"),
    ],
)
def test_what_cannot_stand_there_is_refused_by_name_and_place(change, told):
    base = replace(ROOM, walls=((12.0, 2.0, 12.0, 10.0),))
    with pytest.raises(DataError, match=told):
        explore_once(LandmarkMission(replace(base, **change), None, "coverage", cfg=KNOWN), 0)


def test_a_start_inside_a_solid_wall_is_refused_and_so_is_no_robot(tmp_path):
    path = draw(tmp_path, [(4.0, 4.0, 12.0, 8.0)])
    with pytest.raises(DataError, match=r"robot 2 at \(8, 6\) lies inside a wall"):
        make_field(find_scenario(str(path)), 2, 0)
    with pytest.raises(UsageError, match="at least 1"):
        make_field(find_scenario(str(path)), 0, 0)


def draw(folder, blocks, yaml=True):
    """A scenario 24 m x 12 m at 0.25 m a pixel with dark `blocks` (x0, y0, x1, y1), as a ROS map or a plain image."""
    pixels = np.full((48, 96), 254, dtype=np.uint8)
    for x0, y0, x1, y1 in blocks:
        pixels[48 - round(4 * y1) : 48 - round(4 * y0), round(4 * x0) : round(4 * x1)] = 0
    Image.fromarray(pixels).save(folder / "plan.png")
    (folder / "map.yaml").write_text("image: plan.png\nresolution: 0.25\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n")
    text = "landmarks = 6\nstarts = [[2.0, 2.0, 0.0], [8.0, 6.0, 0.0]]\n"
    text += 'walls = "map.yaml"\n' if yaml else 'walls = "plan.png"\nresolution = 0.25\n'
    (folder / "world.toml").write_text(text)
    return folder / "world.toml"


@pytest.mark.parametrize("yaml", [True, False])
def test_a_plan_from_a_ros_map_or_an_image_is_explored_to_its_end(tmp_path, yaml):
    found = find_scenario(str(draw(tmp_path, [(11.75, 0.0, 12.25, 7.5), (18.0, 4.0, 20.0, 7.0)], yaml)))
    np.testing.assert_allclose(np.concatenate(bounds(found)), [0, 0, 24, 12])
    score, record = explore_once(LandmarkMission(found, 1, "coverage", cfg=KNOWN), 3)
    assert score.finished
    assert score.missed == 0
    assert record.floor.area == pytest.approx(24 * 12 - 0.5 * 7.5 - 6.0, abs=8.0)
    assert record.floor.pockets == ()
    clear = find_walls(found).clearance(np.array([m.true_poses[0, :2] for m in record.moments]))
    assert clear.min() >= KNOWN.walls.robot_radius - 1e-6


def test_a_scenario_whose_plan_cannot_be_read_is_refused_in_one_line(tmp_path):
    path = draw(tmp_path, [])
    (tmp_path / "plan.png").write_bytes(b"not a picture")
    with pytest.raises(ReaderError, match=r"plan\.png: expected a PGM or PNG image"):
        find_scenario(str(path))
    path.write_text('walls = "plan.png"\n')
    with pytest.raises(ConfigError, match="needs `resolution`"):
        find_scenario(str(path))
    path.write_text("walls = [[0.0, 1.0, 2.0]]\n")
    with pytest.raises(ConfigError, match="walls"):
        find_scenario(str(path))
    path.write_text("walls = [[0.0, 1.0, nan, 2.0]]\n")
    with pytest.raises(ConfigError, match="not finite"):
        find_scenario(str(path))


def test_a_robot_driven_into_a_wall_stops_short_of_it_and_knows_how_far_it_came():
    wall = replace(ROOM, landmarks=((9.0, 3.0), (9.0, 9.0), (4.0, 9.0)), walls=((12.0, 0.0, 12.0, 12.0),))

    def straight_on(view, poses, cfg):
        return np.array([[2.0, 0.0]])

    team = Team(make_field(wall, 1, 0), KNOWN, straight_on, np.random.default_rng(0), until=14)
    team.observe_start()
    moments = list(team.play())
    true = np.array([m.true_poses[0] for m in moments])
    assert true[:, 0].max() == pytest.approx(11.7, abs=1e-3)
    assert team.bumper.collisions == 1
    assert moments[-1].commands[0, 0] < 0.1
    assert np.hypot(*(moments[-1].poses[0] - moments[-1].true_poses[0])[:2]) < 0.3
    assert len(team.belief().contacts) >= 1
    driven = 3.0 + sum(m.commands[0, 0] * 0.5 for m in moments)
    assert driven == pytest.approx(11.7, abs=0.2)


def test_offered_controls_keep_clear_and_facing_a_wall_the_robot_turns_on_the_spot():
    team = Team(make_field(HALL, 2, 0), KNOWN, find_planner("paper", "landmarks"), np.random.default_rng(0))
    view, walls = team.belief(), team.floor.walls
    rng = np.random.default_rng(1)
    room = KNOWN.walls.robot_radius + KNOWN.walls.margin / 3
    spots = rng.uniform([1, 1], [59, 39], (300, 2))
    spots = spots[walls.clearance(spots) > room]
    for x, y in spots:
        pose = np.array([x, y, rng.uniform(-np.pi, np.pi)])
        controls, poses = offered(view, pose, KNOWN)
        assert len(controls) > 0
        np.testing.assert_allclose(poses, move(pose, controls, 0.5))
        here = np.tile(pose[:2], (len(poses), 1))
        assert distance_of_moves(here, poses[:, :2].copy(), walls.segments).min() >= room - 1e-9
    facing = np.array([19.4, 5.0, 0.0])
    controls, _ = offered(view, facing, KNOWN)
    assert (controls[:, 0] == 0.0).all()
    for _ in range(8):
        controls, poses = offered(view, facing, KNOWN)
        if controls[0, 0] > 0:
            break
        facing = poses[0]
    assert controls[0, 0] > 0


def test_the_learning_environment_has_walls_too(tmp_path):
    from mapweave.exploration.gym import ExplorationEnv

    env = ExplorationEnv(str(draw(tmp_path, [(11.75, 0.0, 12.25, 7.5)])), robots=1, until=25, cfg=KNOWN)
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    while env.agents:
        seen, _, _, _, _ = env.step({a: int(rng.integers(env.action_space(a).n)) for a in env.agents})
        assert all(np.isfinite(o).all() for o in seen.values())
        assert env.team.floor.walls.clearance(env.team.truth.poses[:, :2]).min() >= KNOWN.walls.robot_radius - 1e-6


def test_rooms_with_doors_too_narrow_for_a_robot_are_told_and_the_rest_is_explored():
    def door(x, wide):
        return ((x, 0.0, x, 6.0 - wide / 2), (x, 6.0 + wide / 2, x, 12.0))

    rooms = replace(ROOM, upper=(36.0, 12.0), starts=((18.0, 6.0, 0.0),), walls=door(12.0, 0.5) + door(24.0, 2.2))
    for name in ("paper", "coverage", "loop"):
        score, record = explore_once(LandmarkMission(rooms, 1, name, cfg=KNOWN), 2)
        assert score.finished
        assert score.steps < 250
        assert len(record.floor.pockets) >= 2  # beside what is seen through the slit
        assert 40 < sum(record.floor.pockets) < 144
        assert min(m.true_poses[0, 0] for m in record.moments) > 12.0
        assert max(m.true_poses[0, 0] for m in record.moments) > 24.0


def test_a_target_that_is_not_seen_in_time_is_put_off_for_another():
    team = Team(make_field(HALL, 1, 0), KNOWN, find_planner("paper", "landmarks"), np.random.default_rng(0))
    team.observe_start()
    pose = team.poses()[0]
    first = next_target(team.belief(), 0, pose)
    assert not given_up(team.belief(), 0, first)
    team.step = PUT_OFF_AFTER
    assert given_up(team.belief(), 0, first)
    assert not np.array_equal(next_target(team.belief(), 0, pose), first)
    team.step += 5 * PUT_OFF_AFTER
    np.testing.assert_array_equal(next_target(team.belief(), 0, pose), first)


def test_two_robots_shut_off_from_each_other_each_explore_their_part():
    halves = replace(ROOM, starts=((4.0, 6.0, 0.0), (20.0, 6.0, 3.0)), walls=((12.0, 0.0, 12.0, 12.0),))
    for name in ("paper", "coverage", "loop"):
        score, record = explore_once(LandmarkMission(halves, None, name, cfg=KNOWN), 0)
        assert score.finished
        assert record.floor.pockets == ()
        assert score.steps < 150
