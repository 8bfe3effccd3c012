"""Exploration with lasers from start to end: what is mapped, what is written, what is refused."""

import csv
import json

import numpy as np
import pytest

from mapweave.api.explore import explore
from mapweave.api.map import map as map_logs
from mapweave.core.errors import ConfigError, DataError, EstimateError, ReaderError, UsageError
from mapweave.exploration.laser.config import find_laser_scenario
from mapweave.exploration.laser.experiment import LaserMission, explore_laser_once, start
from mapweave.io.laser_logs import read_laser
from mapweave.mapping.keyframe_graph import START_SD

# Two rooms of 6 x 5 m and a door of 1 m; in the right one a cell whose entrance is too narrow.
ROOMS = """
sensor = "laser"
walls = [
  [0, 0, 12, 0], [12, 0, 12, 5], [12, 5, 0, 5], [0, 5, 0, 0],
  [6, 0, 6, 2], [6, 3, 6, 5],
  [9.5, 5, 9.5, 3], [9.5, 3, 10.5, 3], [10.8, 3, 12, 3],
]
starts = [[1.5, 2.5, 0.0], [1.5, 1.0, 0.0], [1.5, 4.0, 0.0]]
"""


WITHOUT_STARTS = ROOMS[: ROOMS.index("starts")]


@pytest.fixture
def rooms(tmp_path):
    path = tmp_path / "rooms.toml"
    path.write_text(ROOMS)
    return path


@pytest.mark.slow
def test_two_robots_map_an_office_without_touching_anything():
    told, _ = explore_laser_once(LaserMission(find_laser_scenario("office-500"), 2), 0)
    assert told.finished
    assert told.area_mapped >= 0.99
    assert told.collisions == 0
    assert told.misassociations == 0
    assert told.map_error <= 0.06
    assert told.trajectory_rmse <= 0.12
    assert told.wall_recall >= 0.93
    assert told.closures >= 5
    assert told.nees_per_dof < 1.5


@pytest.mark.slow
def test_lost_messages_and_a_death_are_survived(rooms):
    told, _ = explore_laser_once(LaserMission(find_laser_scenario(str(rooms)), 3, kills={1: 12}, drop=0.5), 3)
    assert told.finished
    assert told.area_mapped >= 0.99
    assert told.collisions == 0


def test_a_run_writes_its_scores_and_map_and_a_log_that_map_can_read(rooms, tmp_path):
    out = tmp_path / "out"
    result = explore(str(rooms), out, robots=2, seed=1)
    (told,) = result.runs
    assert told.finished
    assert told.area_mapped >= 0.99
    assert told.collisions == 0
    assert told.reachable_m2 == pytest.approx(46.5, abs=1.0)  # the cell is left out
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["summary"]["collisions"] == 0
    assert metrics["summary"]["area_mapped"] == told.area_mapped
    assert metrics["summary"]["missed"] is None
    (left_out,) = metrics["first_run"]["unreachable"]
    assert left_out["x"] == pytest.approx(10.75, abs=0.1)
    assert left_out["y"] == pytest.approx(4.0, abs=0.1)
    assert any("where no robot gets to" in line for line in result.lines())
    assert "where no robot gets to" in (out / "report.html").read_text()
    assert metrics["first_run"]["front_end"]["robot2"]["scans"] == told.steps + 1
    (row,) = csv.DictReader((out / "runs.csv").open())
    assert list(row)[:6] == ["run", "seed", "finished", "steps", "map_error", "c_per_n"]
    assert row["duplicates"] == ""
    assert float(row["area_mapped"]) == pytest.approx(told.area_mapped, rel=1e-5)
    for name in (
        "report.html",
        "map.pgm",
        "map.yaml",
        "grid.npz",
        "pose_graph.g2o",
        "closures.csv",
        "trajectories/robot2.tum",
    ):
        assert (out / name).stat().st_size > 0, name
    for name in ("map", "stages", "explored", "progress", "walls", "closures"):
        assert (out / "figures" / f"{name}.png").stat().st_size > 5000
    assert (out / "figures" / "first_run.gif").stat().st_size < 1_000_000
    again = map_logs(out / "log", seed=1)
    assert len(again.maps) == 2
    log = read_laser(out / "log" / "robot2.mcap")
    assert len(log.scans) == told.steps + 1
    first = result.first.logs[1]
    assert np.array_equal(log.scans[-1].ranges, first.scans[-1].ranges)
    assert np.array_equal(log.scans[-1].odometry, first.scans[-1].odometry)
    truth = np.loadtxt(out / "log" / "robot2.truth.tum")
    assert len(truth) == told.steps + 1
    replay = tmp_path / "replay.toml"  # the map that was written serves as the walls of the next world
    replay.write_text(f'sensor = "laser"\nwalls = "{out.name}/map.yaml"\nstarts = [[1.5, 2.5, 0.0]]\n')
    assert explore(str(replay), until=3).runs[0].steps == 3


@pytest.mark.slow
def test_the_same_seed_is_the_same_run_and_processes_change_nothing(rooms):
    def figures(result):
        told = result.metrics
        del told["timing"], told["summary"]["ms_per_decision"]
        for run in told["runs"]:
            del run["ms_per_decision"]
        return told

    options = {"robots": 2, "runs": 3, "seed": 5, "until": 12, "drop": 0.2}
    one = figures(explore(str(rooms), **options))
    two = figures(explore(str(rooms), jobs=2, **options))
    assert one == two
    assert one["runs"][0]["driven"] != one["runs"][1]["driven"]


def test_the_first_robots_start_is_known_and_the_others_err_as_told(rooms):
    made, _ = start(LaserMission(find_laser_scenario(str(rooms)), 3), 0)
    off = made.team.poses() - made.sim.true_poses
    assert np.array_equal(off[0], np.zeros(3))
    assert (np.abs(off[1:]) > 0).all()
    assert np.abs(off[1:, :2]).max() < 5 * START_SD[0]


def test_odometry_noise_can_be_scaled(rooms):
    quiet, noisy = (explore(str(rooms), robots=1, until=8, noise=f).first for f in (0.01, 4.0))
    drift = [r.logs[0].odometry.pose[-1] - (r.truths[0].pose[-1] - r.truths[0].pose[0]) for r in (quiet, noisy)]
    assert np.hypot(*drift[0][:2]) < np.hypot(*drift[1][:2])


def stand_still(maps, poses, cfg):
    return np.zeros((len(poses), 2))


def too_few(maps, poses, cfg):
    return np.zeros((len(poses) + 1, 2))


def no_number(maps, poses, cfg):
    return np.full((len(poses), 2), np.nan)


def too_fast(maps, poses, cfg):
    return np.array([[0.1, 0.0]] * (len(poses) - 1) + [[3.0, 0.0]])


def into_the_wall(maps, poses, cfg):
    return np.array([[0.6, 0.0]] * len(poses))


@pytest.mark.parametrize(
    ("planner", "told"),
    [
        ("too_few", r"step 0: the planner returned shape \(3, 2\), expected \(2, 2\)"),
        ("no_number", "command for robot1, robot2 is not a finite number"),
        ("too_fast", "command for robot2 is beyond 0.6 m/s or 1 rad/s"),
    ],
)
def test_a_planner_that_returns_nonsense_is_named(rooms, planner, told):
    with pytest.raises(EstimateError, match=told):
        explore(str(rooms), robots=2, planner=f"{__name__}:{planner}")


def test_a_users_own_planner_drives_and_its_collisions_are_counted(rooms):
    result = explore(str(rooms), robots=1, planner=f"{__name__}:into_the_wall", until=40)
    assert result.runs[0].collisions == 1
    assert result.runs[0].steps == 40
    still = explore(str(rooms), robots=1, planner=f"{__name__}:stand_still", until=3)
    assert still.runs[0].driven == pytest.approx(0.0)


def test_a_run_ends_when_nothing_is_left_to_see_even_if_the_planner_never_says_so(tmp_path):
    path = tmp_path / "closet.toml"
    path.write_text(
        'sensor = "laser"\nwalls = [[0, 0, 3, 0], [3, 0, 3, 3], [3, 3, 0, 3], [0, 3, 0, 0]]\nstarts = [[1.5, 1.5, 0]]\n'
    )
    (told,) = explore(str(path), planner=f"{__name__}:stand_still").runs
    assert told.finished
    assert told.steps == 0
    assert told.area_mapped > 0.99


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"robots": 0}, "--robots: expected at least 1"),
        ({"robots": 4}, "--robots: 4 asked for, the scenario has 3 starts"),
        ({"until": "landmarks"}, "--until landmarks: a laser world has none"),
        ({"until": "0"}, "--until: expected at least 1 step"),
        ({"until": "noon"}, "--until: expected field or a number of steps"),
        ({"association": "jcbb"}, "--association: a laser world has no landmarks"),
        ({"noise": "printed"}, "--noise printed: the paper prints noise of landmark worlds alone"),
        ({"noise": "-1"}, "--noise: expected a positive factor"),
        ({"drop": 1.0}, "--drop"),
        ({"runs": 0}, "--runs and --jobs"),
        ({"kill": {"robot9": 3}}, "no robot is called 'robot9'"),
        ({"planner": "fastest"}, "planner 'fastest'"),
    ],
)
def test_options_a_laser_world_cannot_take_are_refused(rooms, tmp_path, options, told):
    with pytest.raises(UsageError, match=told):
        explore(str(rooms), tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "error", "told"),
    [
        (ROOMS.replace("[1.5, 2.5, 0.0]", "[6.05, 1.0, 0.0]"), DataError, "robot1 would start in a wall"),
        (ROOMS.replace("[1.5, 2.5, 0.0]", "[1.5, 2.5, 0.0], [1.6, 2.5, 0.0]"), DataError, "start in each other"),
        (ROOMS.replace("[1.5, 2.5, 0.0]", "[-3.0, 2.5, 0.0]"), DataError, "robot1 would start outside the walls"),
        (ROOMS.replace("[12, 5, 0, 5], ", ""), DataError, "the walls do not close"),
        (WITHOUT_STARTS, ConfigError, "expected starts"),
        (WITHOUT_STARTS.replace("sensor", "office = 500\nsensor"), ConfigError, "one of them"),
        ('sensor = "laser"\n', ConfigError, "expected office = AREA or walls"),
        ('sensor = "sonar"\nwalls = [[0, 0, 1, 0]]\n', ConfigError, "sensor"),
        ('sensor = "laser"\nwalls = "none.yaml"\nstarts = [[0, 0, 0]]\n', ReaderError, "none.yaml"),
        ('sensor = "laser"\nwalls = "plan.png"\nstarts = [[0, 0, 0]]\n', ConfigError, "resolution"),
        ('sensor = "laser"\nwalls = []\nstarts = [[0, 0, 0]]\n', ConfigError, "expected segments"),
        ("office = 20\n", ConfigError, "expected 150 to 20000 m.2, found 20"),
    ],
)
def test_a_laser_world_that_cannot_be_is_refused(tmp_path, text, error, told):
    path = tmp_path / "world.toml"
    path.write_text(text)
    with pytest.raises(error, match=told):
        explore(str(path), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["office-ten", "office-5", "office-1e9"])
def test_an_office_of_no_possible_size_is_refused(name):
    with pytest.raises(UsageError, match="expected office-AREA with 150 to 20000"):
        explore(name)


def test_a_start_inside_a_solid_wall_is_refused(tmp_path):
    from PIL import Image

    plan = np.full((60, 80), 255, np.uint8)
    plan[:3] = plan[-3:] = plan[:, :3] = plan[:, -3:] = 0
    plan[20:40, 30:60] = 0
    Image.fromarray(plan).save(tmp_path / "plan.png")
    told = 'sensor = "laser"\nwalls = "plan.png"\nresolution = 0.1\nstarts = [[4.5, 3.0, 0.0]]\n'
    path = tmp_path / "solid.toml"
    path.write_text(told)
    with pytest.raises(DataError, match="robot1 would start inside a wall"):
        explore(str(path))
    path.write_text(told.replace("4.5, 3.0", "1.5, 3.0"))
    assert explore(str(path), until=2).runs[0].steps == 2
