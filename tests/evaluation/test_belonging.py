"""A truth of another recording is told, whatever names it shares with the result."""

import json
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.core.truth import NO_SURVEY, Survey
from mapweave.evaluation.consistency import BEYOND, another_order_fits
from mapweave.evaluation.swarm import StandingSwarm, score_moving, score_standing
from mapweave.evaluation.team import RobotTruth, as_json, score_team
from mapweave.io.sightings import SwarmTruth
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.sim.swarm import SwarmScene
from mapweave.swarm.moving.result import RobotTrajectory
from mapweave.team.team_map import TeamMap

BY_CHANCE = "names may coincide by chance"
EVERY = range(8)


def places(n, seed):
    return np.random.default_rng(seed).uniform(-5, 5, (n, 2))


def swarm(n, seed, gauge="place free; scale free", **more):
    at = places(n, seed) + np.random.default_rng(seed).normal(0, 0.05, (n, 2))
    pairs = np.array([(a, b) for a in range(n) for b in range(n) if a != b])
    names = tuple(map(str, range(1, n + 1)))
    whole = np.ones(n, bool)
    return StandingSwarm(names, at, None, whole, ~whole, gauge, pairs, sigma=np.radians(1.0), **more)


def truth_of(n, seed):
    return SwarmTruth(tuple(map(str, range(1, n + 1))), places(n, seed))


@pytest.mark.parametrize("gauge", ["", "place free; scale free", "place free; scale free; orientation free"])
def test_a_swarms_own_truth_is_never_doubted_and_anothers_always(gauge):
    for seed in EVERY:
        here = swarm(8, seed, gauge)
        assert score_standing(here, truth_of(8, seed)).score.doubts == ()
        assert score_standing(here, truth_of(8, 100 + seed)).score.doubts


def test_robots_of_a_truth_that_are_few_or_move_are_told():
    here, own = swarm(8, 1), truth_of(8, 1)
    few = SwarmTruth(own.ids[:3], own.position[:3])
    assert score_standing(here, few).score.doubts == (
        "the truth knows only 3 of 8 robots: it may be of another recording",
    )
    way = np.concatenate([own.position, own.position + np.array([4.0, 0.0])])
    moving = SwarmTruth(own.ids * 2, way, np.repeat([0.0, 1.0], 8))
    (told,) = score_standing(here, moving).score.doubts
    assert "the truth's robots move by up to 4 m" in told


def test_angles_that_bearings_cannot_leave_are_told_where_places_agree_roughly():
    here = swarm(8, 1)
    moved = here.position + np.random.default_rng(0).normal(0, 1.7, (8, 2))
    doubts = score_standing(here, SwarmTruth(here.ids, moved)).score.doubts
    assert any("where bearings are good to 1 deg" in told for told in doubts)
    assert score_standing(replace(here, sigma=None), SwarmTruth(here.ids, moved)).score.doubts == ()


@pytest.mark.parametrize("gauge", ["", "place and orientation free"])
def test_moving_robots_are_held_to_their_own_ways(gauge):
    t = np.arange(30.0)
    for seed in EVERY:
        ways = np.cumsum(np.random.default_rng(seed).normal(0, 1, (5, 30, 2)), axis=1)
        rng = np.random.default_rng(1000 + seed)
        tracks = {str(k): RobotTrajectory(t, way + rng.normal(0, 0.1, way.shape)) for k, way in enumerate(ways)}
        ids = tuple(str(k) for k in range(5) for _ in t)
        own = SwarmTruth(ids, ways.reshape(-1, 2), np.tile(t, 5))
        assert score_moving(tracks, frozenset(), gauge, own)[0].doubts == ()
        handed_on = np.roll(ways, 2, axis=0).reshape(-1, 2)
        (told,) = score_moving(tracks, frozenset(), gauge, replace(own, position=handed_on))[0].doubts
        assert BY_CHANCE in told


def team(n, seed, sd=0.05):
    ids = tuple(map(str, range(6, 6 + n)))
    mean = places(n, seed) + np.random.default_rng(seed).normal(0, sd, (n, 2))
    return TeamMap((), LandmarkMap(ids, mean, sd**2 * np.eye(2 * n)))


def test_landmarks_of_another_room_are_told_and_their_own_are_not_even_where_symmetric():
    for seed in EVERY:
        own, other = (Survey(tuple(map(str, range(6, 16))), places(10, s)) for s in (seed, 100 + seed))
        assert score_team([team(10, seed)], {}, own, {}).doubts == ()
        score = score_team([team(10, seed)], {}, other, {})
        assert BY_CHANCE in score.doubts[0]
        assert as_json(score)["warnings"] == [*score.doubts]
    square = np.array([[0.0, 0.0], [4, 0], [4, 4], [0, 4]])
    ids = ("6", "7", "8", "9")
    even = TeamMap((), LandmarkMap(ids, square + 0.01, 1e-4 * np.eye(8)))
    assert score_team([even], {}, Survey(ids, square), {}).doubts == ()


def test_errors_far_beyond_what_a_map_says_of_itself_are_told():
    own = Survey(tuple(map(str, range(6, 16))), places(10, 3) + places(10, 4) / 10)
    (told,) = score_team([team(10, 3, sd=0.01)], {}, own, {}).doubts
    assert "times what the result says of itself" in told


def test_labels_that_only_look_exchanged_are_told_as_that_and_nothing_else():
    ids = ["7", "6", *map(str, range(8, 21))]
    score = score_team([team(15, 3, sd=0.01)], {}, Survey(tuple(ids), places(15, 3)), {})
    assert [(e.a, e.b) for e in score.exchanges] == [("6", "7")]
    assert score.landmarks.nees_per_dof > BEYOND
    assert score.doubts == ()


def test_a_way_no_nearer_to_the_truth_than_its_middle_is_told():
    t = np.arange(100.0)
    circle = np.column_stack([5 * np.cos(t / 15), 5 * np.sin(t / 15), np.zeros(100)])
    one = TeamMap(("robot1",), LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0))), {"robot1": Track(t, circle)})
    own, other = Track(t, se2.compose(np.array([1.0, 2.0, 0.3]), circle)), Track(t, circle * [1, -1, 1])
    assert score_team([one], {}, NO_SURVEY, {"robot1": RobotTruth("TUM", own)}).doubts == ()
    (told,) = score_team([one], {}, NO_SURVEY, {"robot1": RobotTruth("TUM", other)}).doubts
    assert "robot 1: a robot that stands in the middle" in told
    for unit in (1000.0, 0.01 / 0.3048):
        truths = {"robot1": RobotTruth("TUM", Track(t, own.pose * [unit * 100, unit * 100, 1])), "file a.tum": other}
        told = score_team([one], {}, NO_SURVEY, truths).doubts
        assert "times as far: the truth may be in another unit" in told[1]
        assert told[0] == "file a.tum: it is of no robot of the result"


def test_fewer_than_three_names_prove_nothing_either_way():
    assert not another_order_fits(2, lambda _: 9.0, 1.0)
    assert another_order_fits(3, lambda _: 9.0, 1.0)


def test_evaluate_tells_it_on_the_terminal_in_json_and_in_the_page(tmp_path, capsys):
    for seed in (1, 2):
        mapweave.simulate_swarm(tmp_path / f"s{seed}.csv", scene=SwarmScene(robots=8, layout="random"), seed=seed)
    out = tmp_path / "out"
    mapweave.locate(tmp_path / "s1.csv").write(out)
    assert "warning" not in mapweave.evaluate(out, tmp_path / "s1.truth.csv").summary()
    assert _run(["evaluate", str(out), "--truth", str(tmp_path / "s2.truth.csv")]) == 0
    assert BY_CHANCE in capsys.readouterr().out
    assert BY_CHANCE in (out / "report.html").read_text(encoding="utf-8")
    assert BY_CHANCE in json.loads((out / "metrics.json").read_text())["evaluation"]["warnings"][0]


@pytest.mark.parametrize(("n", "as_good", "found"), [(4, 0, False), (4, 1, True), (6, 3, False), (6, 8, True)])
def test_names_prove_nothing_where_more_than_one_order_in_a_hundred_fits_as_well(n, as_good, found):
    """Of 23 other orders one is more; of five hundred that are drawn of six names, three are not."""
    left = [as_good]

    def error(order):
        if np.array_equal(order, np.arange(n)):
            return 1.0
        left[0] -= 1
        return 0.9 if left[0] >= 0 else 2.0

    assert another_order_fits(n, error, 1.0) == found
