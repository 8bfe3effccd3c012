"""Maps that are mirror images of most others are named; few landmarks, those in a row and ties decide nothing."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Odometry
from mapweave.fusion.compared_logs import mirror_images, scales_apart, unmirrored

from .worlds import local_map

NAMES = tuple(f"{k}" for k in range(6, 18))


def seen_by(robot: str, points, seed: int, *, mirrored: bool = False, wrong: int = 0):
    """The map of `robot`: the points in a frame of its own, 5 cm off, `wrong` of them by metres."""
    rng = np.random.default_rng(seed)
    mean = se2.act(np.array([1.0, -2.0, 0.7 * seed]), points) + rng.normal(0, 0.05, points.shape)
    mean[:wrong] += rng.uniform(2, 4, (wrong, 2))
    mean *= np.array([1.0, -1.0 if mirrored else 1.0])
    return local_map(robot, NAMES[: len(points)], mean, 0.0025 * np.eye(2 * len(points)))


def hall(seed: int, n: int = 12):
    return np.random.default_rng(seed).uniform(-5, 5, (n, 2))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_mirror_images_are_named(seed):
    maps = [seen_by(f"robot{k}", hall(seed), k, mirrored=k in (2, 5), wrong=k // 3) for k in range(1, 6)]
    assert mirror_images(maps) == ("robot2", "robot5")
    assert mirror_images([m for m in maps if m.robot not in ("robot2", "robot5")]) == ()


def test_a_map_of_another_scale_is_told_of_those_that_are_joined_with_it():
    team = ("robot1", "robot2", "robot3")
    maps = [seen_by(team[0], hall(1), 1), seen_by(team[1], 1.3 * hall(1), 2), seen_by(team[2], hall(1), 3)]
    (told,) = scales_apart(maps, [team])
    assert (told.code, told.severity) == ("maps-scales", "doubtful")
    assert "robot2" in told.value["pair"]
    assert told.value["value"] == pytest.approx(30.0, abs=3.0)
    assert scales_apart(maps, [(team[0], team[2]), (team[1],)]) == ()


@pytest.mark.parametrize("seed", range(5))
def test_maps_a_little_apart_in_scale_and_maps_that_scatter_are_of_one_scale(seed):
    points = hall(seed)
    one = seen_by("robot1", points, 1)
    assert scales_apart([one, seen_by("robot2", 1.1 * points, 2)], [("robot1", "robot2")]) == ()
    assert scales_apart([one, seen_by("robot2", points, 2, wrong=4)], [("robot1", "robot2")]) == ()
    assert (
        scales_apart([seen_by("robot1", 0.2 * points, 1), seen_by("robot2", 0.25 * points, 2)], [("robot1", "robot2")])
        == ()
    )


def test_a_tie_decides_nothing():
    assert mirror_images([seen_by("robot1", hall(4), 1), seen_by("robot2", hall(4), 2, mirrored=True)]) == ()


def test_few_landmarks_and_landmarks_in_a_row_decide_nothing():
    row = np.column_stack([np.linspace(-5, 5, 12), np.zeros(12)])
    for points in (hall(5, 5), row):
        assert mirror_images([seen_by(f"robot{k}", points, k, mirrored=k == 3) for k in (1, 2, 3)]) == ()


def test_putting_right_turns_bearings_and_turns():
    seen = SightingTable(np.zeros(2), np.array([0, 1]), np.ones(2), np.array([0.3, -0.2]), ("6", "7"))
    log = unmirrored(LandmarkLog("robot1", Odometry(np.zeros(1), np.ones(1), np.array([0.4])), seen))
    assert log.sightings.bearing.tolist() == [-0.3, 0.2]
    assert log.odometry.w.tolist() == [-0.4]
    assert log.odometry.v.tolist() == [1.0]
    assert "mirror image" in log.warnings[0]
