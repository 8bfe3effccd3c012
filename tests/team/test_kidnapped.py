"""A robot that somebody picks up and puts down elsewhere while its log runs: found, cut there, the map unharmed."""

import json
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.evaluate import read_team_truth
from mapweave.core import se2
from mapweave.core.landmark_log import LandmarkLog
from mapweave.evaluation.team import score_team
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.mapping import local_map
from mapweave.sim import landmarks as simulator
from mapweave.sim import mixed_team as mixed_simulator
from mapweave.team.config import PlacingConfig, SmoothingConfig
from mapweave.team.kidnapped import cut_kidnapped

WORLD = {"landmarks": 15, "minutes": 5}


@pytest.fixture
def carry(monkeypatch):
    """Makes the simulator put a robot elsewhere, by a motion of the room, while its commands go on."""
    drive = simulator.drive_team

    def until(robot: int, when: float, T: tuple[float, float, float]) -> None:
        def carried(*args, **options):
            drives = list(drive(*args, **options))
            own = drives[robot - 1]
            later = (own.t >= when)[:, None]
            moved = np.where(later, se2.compose(np.array(T), own.pose), own.pose)
            return [*drives[: robot - 1], replace(own, pose=moved), *drives[robot:]]

        monkeypatch.setattr(simulator, "drive_team", carried)

    return until


def cut_of(logs) -> tuple[LandmarkLog, ...]:
    local = [local_map(log) for log in logs]
    done = cut_kidnapped(logs, local, fuse(local), SmoothingConfig(), PlacingConfig(), local_map, fuse)
    return done.logs


@pytest.mark.slow
def test_a_robot_put_down_elsewhere_is_found_and_harms_no_map(carry, tmp_path):
    carry(2, 90.0, (1.5, 1.0, np.pi))
    mapweave.simulate_landmarks(tmp_path / "logs", robots=3, seed=101, **WORLD)
    truth = read_team_truth([tmp_path / "logs"], ["robot1", "robot2", "robot3"])
    for refine in (True, False):
        done = mapweave.map(tmp_path / "logs", refine=refine)
        score = score_team(done.maps, {}, truth.survey, truth.robots)
        assert len(done.maps[0].robots) == 3
        assert score.landmarks.rmse < 0.08
        assert score.robots["robot2"].ate < 0.6
        told = [w for w in done.metrics["warnings"] if w.startswith("robot 2: ") and "put down elsewhere at" in w]
        assert len(told) == 1
        assert 80.0 < float(told[0].split("after ")[1].split(" s")[0]) < 100.0
    done.write(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["warnings"] == done.metrics["warnings"]
    assert "put down elsewhere" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_where_a_robot_saw_nothing_when_it_was_carried_its_way_is_left_out(carry, tmp_path):
    carry(2, 90.0, (0.5, 0.8, 2.5))
    mapweave.simulate_landmarks(tmp_path / "logs", robots=3, minutes=3, seed=104)
    done = mapweave.map(tmp_path / "logs", truth=[tmp_path / "logs"])
    ((begin, end),) = done.maps[0].left_out["robot2"]
    first = done.maps[0].tracks["robot2"].t[0]
    assert begin - first < 91.0 < end - first < 130.0
    assert done.score.robots["robot2"].ate < 0.15
    (told,) = (w for w in done.warnings if "put down elsewhere" in w)
    assert "or within 35.9 s from there" in told


@pytest.mark.slow
def test_a_lone_robot_put_down_elsewhere_is_found_by_its_own_halves(carry, tmp_path):
    carry(1, 150.0, (0.0, 0.0, np.pi))
    mapweave.simulate_landmarks(tmp_path / "logs", robots=1, seed=7, **WORLD)
    log = cut_of(read_landmark_logs(tmp_path / "logs"))[0]
    assert len(log.cuts) == 1
    assert abs(log.cuts[0] - log.span[0] - 150.0) < 12.0


def test_nobody_is_cut_where_nobody_was_carried(tmp_path):
    for seed in (3, 4):
        mapweave.simulate_landmarks(tmp_path / str(seed), robots=3, seed=seed, **WORLD)
        logs = read_landmark_logs(tmp_path / str(seed))
        assert all(a is b for a, b in zip(cut_of(logs), logs, strict=True))


def test_a_log_is_cut_into_stretches_that_hold_every_row_once(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "logs", robots=1, minutes=1, seed=1)
    whole = read_landmark_logs(tmp_path / "logs")[0]
    a, b = whole.span
    parts = replace(whole, cuts=(a + 20.0, a + 45.0)).stretches()
    assert parts[0].span[1] < a + 20.0 <= parts[1].span[0]
    assert parts[1].span[1] < a + 45.0 <= parts[2].span[0]
    assert sum(map(len, parts)) == len(whole)
    assert parts[0].span[0] == a
    assert parts[-1].span[1] == b
    assert whole.stretches()[0].span == whole.span


@pytest.mark.data
def test_nobody_is_cut_in_a_real_room(data):
    logs = read_landmark_logs(data / "mrclam" / "MRCLAM_Dataset6.zip")
    assert all(a is b for a, b in zip(cut_of(logs), logs, strict=True))


@pytest.mark.slow
@pytest.mark.data
def test_landmarks_that_drive_about_carry_nobody(data):
    """Of robots whose own logs are missing, one in a half of the log seems to stand still."""
    log = read_landmark_logs(data / "mrclam" / "MRCLAM_Dataset6.zip", [3])[0]
    alone = replace(
        log, sightings=replace(log.sightings, ids=tuple(i.removeprefix("robot") for i in log.sightings.ids))
    )
    assert cut_of([alone])[0] is alone


@pytest.mark.slow
def test_a_camera_robot_of_a_mixed_team_put_down_elsewhere_is_cut_too(monkeypatch, tmp_path):
    drive = mixed_simulator.drive_team

    def carried(*args, **options):
        laser, own, *rest = drive(*args, **options)
        later = (own.t >= 120.0)[:, None]
        moved = np.where(later, se2.compose(np.array([0.5, 0.5, np.pi]), own.pose), own.pose)
        return [laser, replace(own, pose=moved), *rest]

    monkeypatch.setattr(mixed_simulator, "drive_team", carried)
    mapweave.simulate_team(tmp_path / "team", lasers=1, cameras=2, bearings=0, minutes=3.5, seed=9)
    truth = read_team_truth([tmp_path / "team"], ["robot1", "robot2", "robot3"])
    done = mapweave.map(tmp_path / "team")
    score = score_team(done.maps, {}, truth.survey, truth.robots)
    assert score.robots["robot2"].ate < 0.4
    told = [w for w in done.metrics["warnings"] if w.startswith("robot 2: ") and "put down elsewhere at" in w]
    assert len(told) == 1
    assert 115.0 < float(told[0].split("after ")[1].split(" s")[0]) < 125.0
