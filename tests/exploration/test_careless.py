"""What a careless user gives to `explore`: each mistake is told in one line, and small worlds are explored as well."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.explore import explore, parse_kills
from mapweave.cli import _run
from mapweave.core.errors import ConfigError, DataError, EstimateError, UsageError
from mapweave.exploration.landmarks.config import find_scenario, make_field
from mapweave.exploration.laser.config import find_laser_scenario, make_place
from mapweave.exploration.planner_interface import TeamBelief, query_planner

FIELD = "lower = [-5, -5]\nupper = [5, 5]\nlandmarks = [[-3.0, 3.0], [3.0, 3.0]]\n"
HALL = """
sensor = "laser"
walls = [[0, 0, 6, 0], [6, 0, 6, 5], [6, 5, 0, 5], [0, 5, 0, 0]]
starts = [[1.5, 2.5, 0.0]]
"""


def written(folder, text):
    path = folder / "world.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("world", [FIELD, HALL])
@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seed": -1}, "--seed: expected 0 or more, found -1"),
        ({"planner": ""}, "planner ''"),
        ({"planner": "os:sep"}, "is not a function"),
        ({"drop": float("nan")}, "--drop"),
    ],
)
def test_options_that_cannot_be_are_usage_errors_in_every_world(tmp_path, world, options, told):
    with pytest.raises(UsageError, match=told):
        explore(written(tmp_path, world), tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("world", [FIELD, HALL])
def test_a_planner_that_fails_is_told_with_step_and_line(tmp_path, world):
    with pytest.raises(EstimateError, match=r"step 0: the planner failed at \w+\.py:\d+: TypeError: .*argument"):
        explore(written(tmp_path, world), planner="json:loads", until=3)


BELIEF = TeamBelief(
    step=4,
    robots=("robot1", "robot2"),
    alive=np.array([True, False]),
    stalled=np.zeros(2, dtype=np.int64),
    memory={},
)


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (None, "shape"),
        ("left", "returned str"),
        ([[1.0, 0.0], [1.0]], "returned list"),
        ([[0.5, 0.0]], r"shape \(1, 2\), expected \(2, 2\)"),
        ([[np.inf, 0.0], [0.0, 0.0]], "robot1 is not a finite number"),
        ([[0.0, -2.0], [0.0, 0.0]], "robot1 is beyond 1 m/s or 1 rad/s"),
    ],
)
def test_an_answer_that_is_no_commands_is_told(answer, told):
    with pytest.raises(EstimateError, match=f"step 4: .*{told}"):
        query_planner(lambda *_: answer, BELIEF, np.zeros((2, 3)), None, (1.0, 1.0))


def test_a_dead_robots_command_is_nobodys_concern():
    told = query_planner(lambda *_: [[1.0, 0.0], [np.nan, 9.0]], BELIEF, np.zeros((2, 3)), None, (1.0, 1.0))
    np.testing.assert_array_equal(told[0], [1.0, 0.0])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("lower = [-5, -5]\nlandmarks = 3 4\n", r"world\.toml:2: "),
        ("low = 3\nlandmark = 4\n", "low: unknown key; landmark: unknown key"),
        ("lower = 'a'\nupper = [1]\n", r"lower: expected a list; upper\.1: missing"),
        (FIELD + "walls = [[1, 2, 3]]\n", r"walls\.0\.3: missing"),
        (FIELD + "walls = [[1, 2, 1, 2]]\n", r"walls\.0: .* without length at \(1, 2\)"),
        (HALL.replace("[0, 0, 6, 0]", "[0, 0, 0, 0]"), r"walls\.0: .* without length at \(0, 0\)"),
        (HALL.replace("[0, 0, 6, 0]", "[0, nan, 0, 0]"), r"walls\.0\.1: expected a number, found .* not finite"),
        ("office = 200\nfloor = -1\n", "floor: expected 0 or more, found -1"),
        ("lower = [nan, -5]\n", r"lower\.0: expected a number, found .* not finite"),
        ("upper = [5, inf]\n", r"upper\.1: expected a number, found .* not finite"),
    ],
)
def test_a_scenario_file_that_cannot_be_is_told_with_file_and_place(tmp_path, text, told):
    with pytest.raises(ConfigError, match=told):
        explore(written(tmp_path, text))


def test_the_names_of_all_scenarios_are_told():
    with pytest.raises(UsageError, match="yuan, yuan-large, office, office-AREA and not a TOML file"):
        explore("yaun")
    with pytest.raises(UsageError, match="a laser world, where there are no landmarks"):
        find_scenario("office")


@pytest.mark.slow
def test_ones_own_planner_may_stand_in_the_folder_one_is_in(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    (tmp_path / "mine_alone.py").write_text("def stand(maps, poses, cfg):\n    return 0 * poses[:, :2]\n")
    (tmp_path / "mine_broken.py").write_text("def stand(:\n")
    words = ["explore", str(written(tmp_path, HALL)), "--out", str(tmp_path / "out"), "--until", "1", "--planner"]
    assert _run([*words, "mine_alone:stand"]) == 0
    assert (tmp_path / "out" / "runs.csv").exists()
    assert _run([*words, "mine_broken:stand"]) == 2
    assert re.search(r"planner 'mine_broken:stand': .*SyntaxError", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("world", "text", "told"),
    [
        (
            FIELD,
            "[mission]\ncell = 0\n[commands]\nspeeds = []\n[submap]\nreach = -1.0\n",
            r"mission\.cell: .* above 0.*; commands\.speeds: .*; submap\.reach: ",
        ),
        (FIELD, "[commands]\nturns = []\n", "commands.turns: expected at least one"),
        (
            FIELD,
            "[objective]\nw_area = nan\n[submap]\nx = 3\n",
            r"submap\.x: unknown key; objective\.w_area: .* not finite",
        ),
        (HALL, "[robots]\nperiod = 0\n[plan]\nresolution = 0\n", r"robots\.period: .* above 0.*; plan\.resolution: "),
        (HALL, "cell = 3\n[plan]\nmargin = nan\n", r"plan\.margin: .* not finite; cell: unknown key"),
        (
            FIELD,
            "cell = 3\nfusion_gate = 9\nx = 1\n",
            r"cell: is now mission\.cell; fusion_gate: is now handover\.pairing\.gate; x: unk",
        ),
    ],
)
def test_settings_that_cannot_be_are_told_all_at_once(tmp_path, world, text, told):
    settings = tmp_path / "settings.toml"
    settings.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=told):
        explore(written(tmp_path, world), config=settings)


def test_in_a_small_field_the_robots_start_inside_it(tmp_path):
    scenario = find_scenario(written(tmp_path, "lower = [0, 0]\nupper = [3, 3]\nlandmarks = 3\n"))
    for robots in (1, 2, 4):
        assert len(make_field(scenario, robots, 0).starts) == robots
    wide = replace(scenario, lower=(-50.0, -40.0), upper=(50.0, 40.0))
    np.testing.assert_allclose(np.hypot(*make_field(wide, 3, 0).starts[:, :2].T), 5.0)


def test_landmarks_seen_from_the_start_need_no_step_and_the_report_is_written(tmp_path):
    world = written(tmp_path, FIELD + "starts = [[0, -4, 1.57]]\n")
    result = explore(world, tmp_path / "out", until="landmarks", association="known")
    assert result.averages()["finished"] == 1
    assert result.averages()["steps_max"] == 0
    assert (tmp_path / "out" / "figures" / "first_run.gif").stat().st_size > 0


def test_landmarks_that_walls_hide_from_everybody_are_refused(tmp_path):
    text = FIELD.replace("[-3.0, 3.0], ", "") + "walls = [[0, -6, 0, 6]]\nstarts = [[-2, 0, 0]]\n"
    with pytest.raises(DataError, match="walls hide every landmark"):
        explore(written(tmp_path, text))


def test_on_a_turned_plan_random_landmarks_lie_inside_the_building(tmp_path):
    from PIL import Image

    pixels = np.full((60, 120), 254, np.uint8)
    pixels[:2] = pixels[-2:] = pixels[:, :2] = pixels[:, -2:] = 0
    Image.fromarray(pixels).save(tmp_path / "plan.png")
    (tmp_path / "map.yaml").write_text("image: plan.png\nresolution: 0.1\norigin: [10, 5, 0.5]\n", encoding="utf-8")
    text = "walls = 'map.yaml'\nlandmarks = 40\nstarts = [[11.0, 8.5, 0]]\n"
    field = make_field(find_scenario(written(tmp_path, text)), None, 0)
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    within = (field.landmarks - [10, 5]) @ turn
    assert ((within > 0.2) & (within < [11.8, 5.8])).all()


def test_the_corner_of_an_image_may_be_told_without_a_turn(tmp_path):
    from PIL import Image

    Image.fromarray(np.full((30, 40), 255, np.uint8)).save(tmp_path / "plan.png")
    text = 'sensor = "laser"\nwalls = "plan.png"\nresolution = 0.1\norigin = [1.0, 2.0]\nstarts = [[2, 3, 0]]\n'
    place = make_place(find_laser_scenario(written(tmp_path, text)), None, 0)
    np.testing.assert_allclose([*place.lower, *place.upper], [1, 2, 5, 5])


def test_a_robot_is_told_once_when_it_dies():
    assert parse_kills(["robot1@5", "robot2@7"]) == {"robot1": 5, "robot2": 7}
    with pytest.raises(UsageError, match="robot2 can die but once, found robot2@7 and robot2@9"):
        parse_kills(["robot2@7", "robot2@9"])
