"""The simulated team: seeded, readable by the reader of real logs, wrong in the ways real logs are."""

import numpy as np
import pytest

from mapweave.api.simulate import simulate_landmarks
from mapweave.core import se2
from mapweave.core.errors import UsageError
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.landmark_truth import read_robot_truth, read_survey
from mapweave.sim.landmarks import TeamWorld, simulate_team

SHORT = {"robots": 2, "landmarks": 8, "minutes": 0.5}


def files(folder):
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def test_one_seed_gives_the_same_bytes_and_another_gives_others(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        simulate_landmarks(tmp_path / name, seed=seed, **SHORT)
    assert files(tmp_path / "a") == files(tmp_path / "b")
    assert files(tmp_path / "a")["Robot1_Odometry.dat"] != files(tmp_path / "c")["Robot1_Odometry.dat"]


def test_the_reader_of_real_logs_reads_it(tmp_path):
    made = simulate_landmarks(tmp_path / "team", **SHORT)
    logs = read_landmark_logs(tmp_path / "team")
    assert [log.robot for log in logs] == ["robot1", "robot2"]
    assert all(log.odometry is not None for log in logs)
    survey = read_survey(tmp_path / "team")
    assert set(survey.ids) == {str(s) for s in made.landmarks}
    assert set(read_robot_truth(tmp_path / "team")) == {"robot1", "robot2"}


def test_robots_see_each_other():
    world = TeamWorld(robots=4, landmarks=6, minutes=2.0, misreads=0.0)
    team = simulate_team(world, 1)
    robots = {team.barcodes[k] for k in range(1, 5)}
    for robot in team.robots:
        assert team.barcodes[robot.number] not in robot.barcodes
    assert any(set(r.barcodes.tolist()) & robots for r in team.robots)


def test_without_noise_and_bias_the_truth_explains_every_sighting():
    team = simulate_team(TeamWorld(robots=2, minutes=1.0, noise=0.0, bias=0.0, outliers=0.0, misreads=0.0), 2)
    place = {team.barcodes[s]: np.array(xy) for s, xy in team.landmarks.items()}
    for robot in team.robots:
        pose = se2.interpolate(robot.stamps, robot.truth[:, 0], robot.truth[:, 1:])
        for p, code, (r, b) in zip(pose, robot.barcodes.tolist(), robot.sightings, strict=True):
            if code in place:
                d = se2.act(se2.inverse(p), place[code])
                assert abs(np.hypot(*d) - r) < 0.02
                assert abs(se2.wrap_angle(np.arctan2(d[1], d[0]) - b)) < 0.03


def test_without_noise_and_bias_the_commands_lead_along_the_truth():
    robot = simulate_team(TeamWorld(robots=1, minutes=1.0, noise=0.0, bias=0.0), 5).robots[0]
    pose = robot.truth[0, 1:]
    rows = robot.odometry
    for (t, v, w), later in zip(rows, rows[1:, 0], strict=False):
        pose = se2.compose(pose, se2.exp(np.array([v, 0, w]) * (later - t)))
    end = se2.interpolate(rows[-1:, 0], robot.truth[:, 0], robot.truth[:, 1:])[0]
    assert np.linalg.norm(pose[:2] - end[:2]) < 0.05


def test_misreads_carry_barcodes_nobody_listed():
    team = simulate_team(TeamWorld(robots=1, minutes=2.0, misreads=0.2), 6)
    listed = np.isin(team.robots[0].barcodes, list(team.barcodes.values()))
    assert 0.1 < 1 - listed.mean() < 0.3


def test_ranges_stay_wrong_the_same_way_for_seconds():
    team = simulate_team(TeamWorld(robots=1, minutes=5.0, bias=0.0, outliers=0.0, misreads=0.0), 7)
    robot = team.robots[0]
    pose = se2.interpolate(robot.stamps, robot.truth[:, 0], robot.truth[:, 1:])
    pairs = []
    for subject, xy in team.landmarks.items():
        rows = robot.barcodes == team.barcodes[subject]
        e = robot.sightings[rows, 0] - np.linalg.norm(np.array(xy) - pose[rows, :2], axis=1)
        close = np.diff(robot.stamps[rows]) < 0.3
        pairs.append(np.column_stack([e[:-1], e[1:]])[close])
    assert np.corrcoef(np.concatenate(pairs).T)[0, 1] > 0.8


@pytest.mark.parametrize(
    ("option", "value"), [("robots", 0), ("minutes", 0.0), ("noise", -1.0), ("outliers", 1.5), ("misreads", -0.1)]
)
def test_a_world_that_cannot_be_is_a_usage_error_and_writes_nothing(tmp_path, option, value):
    with pytest.raises(UsageError, match=option):
        simulate_landmarks(tmp_path / "team", **{option: value})
    assert not (tmp_path / "team").exists()


def test_a_real_data_set_is_not_overwritten(tmp_path):
    (tmp_path / "Barcodes.dat").write_text("1 5\n")
    with pytest.raises(UsageError, match="not empty"):
        simulate_landmarks(tmp_path, **SHORT)
    assert files(tmp_path) == {"Barcodes.dat": b"1 5\n"}
