"""Whole explorations: accuracy, consistency, deaths, lost messages, bad input."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import mapweave
from mapweave.api.explore import explore
from mapweave.core import se2
from mapweave.core.errors import ConfigError, DataError, EstimateError, UsageError
from mapweave.exploration.landmarks import belief
from mapweave.exploration.landmarks.belief import MapTruth
from mapweave.exploration.landmarks.config import (
    ExploreConfig,
    HandoverConfig,
    JointConfig,
    LapSearchConfig,
    LoopConfig,
    MissionConfig,
    ObjectiveConfig,
    ScenarioConfig,
    find_scenario,
    make_field,
)
from mapweave.exploration.landmarks.experiment import (
    CALIBRATED,
    LandmarkMission,
    explore_many,
    explore_once,
    with_noise,
)
from mapweave.exploration.landmarks.team import Team
from mapweave.exploration.planner_interface import find_planner
from mapweave.fusion.handover import Handover, hand_over
from mapweave.landmarks.landmark_map import Submap, known_starts
from mapweave.landmarks.submap_slam import SubmapConfig


def mission(planner="paper", association="known", until="landmarks", noise=CALIBRATED, **more):
    own = {k: more.pop(k) for k in ("robots", "kills", "drop") if k in more}
    limits = MissionConfig(max_steps=more.pop("max_steps", 1500))
    handover = HandoverConfig(by=more.pop("handover_by", 60))
    settings = {"mission": limits, "handover": handover, "joint": more.pop("joint", JointConfig())}
    settings["objective"] = ObjectiveConfig(**more)
    cfg = with_noise(ExploreConfig(submap=SubmapConfig(association=association), **settings), noise)
    return LandmarkMission(find_scenario("yuan"), planner=planner, until=until, cfg=cfg, **own)


def mean(runs, name):
    return float(np.mean([getattr(r, name) for r in runs]))


def runs_of(what, runs, seed=0):
    """Scores of many runs."""
    return [explore_many(m, runs, seed) for m in what]


@cache
def twelve(planner):
    """Runs from seed 0 with known landmarks, made once for the tests that compare with them."""
    return runs_of([mission(planner)], 12)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("specks", "least"), [(12, 1.15), (0, 1.5)])
def test_the_area_term_is_worth_its_steps_with_the_same_escape_on_both_sides(specks, least):
    one, other = (mission(w_area=w, negligible_gain=specks, max_steps=3000) for w in (1 / 3, 0.0))
    assert replace(one.cfg.objective, w_area=0.0) == other.cfg.objective
    whole, blind = runs_of([one, other], 3)
    assert all(r.finished for r in whole + blind)
    assert mean(blind, "steps") >= least * mean(whole, "steps")


@pytest.mark.slow
def test_without_the_escape_no_run_ends():
    (shut,) = runs_of([mission(escape_uncertainty=-1.0, stall_steps=10**9, max_steps=300)], 2)
    assert not any(r.finished for r in shut)


@pytest.mark.slow
def test_coverage_and_loops_beat_the_papers_planner():
    cover, loop, (alone,) = twelve("coverage"), twelve("loop"), runs_of([mission("loop", robots=1)], 6)
    assert all(r.finished for r in cover + loop)
    assert mean(cover, "steps") <= 205
    assert np.median([r.steps for r in cover]) <= 195
    assert max(r.steps for r in cover) <= 320  # a run in twenty looks long for a last landmark
    assert mean(cover, "map_error") <= 0.36
    assert mean(loop, "steps") <= 215
    assert mean(loop, "map_error") <= 0.32
    assert mean(loop, "c_per_n") <= 0.18
    assert mean(alone, "steps") < 503
    assert mean(alone, "map_error") <= 0.48


@pytest.mark.long
def test_laps_planned_together_are_shorter_than_each_robots_own_and_as_sure():
    (joint,) = runs_of([mission("joint")], 12)
    assert all(r.finished for r in joint)
    assert mean(joint, "steps") <= 185
    assert mean(joint, "map_error") <= 0.34


def handed_over_twice(G, L, **more):
    """A submap is handed over a second time, as if it were independent."""
    done = hand_over(G, L, **more)
    C = np.kron(np.eye(len(L.ids)), se2.rotation(-L.pose[2]))
    P = np.zeros((3 + 2 * len(L.ids),) * 2)
    P[3:, 3:] = C @ L.cov[3:, 3:] @ C.T
    again = Submap(L.robot, np.zeros(3), L.ids, se2.act(se2.inverse(L.pose), L.mean), P, L.frame)
    return replace(done, map=hand_over(done.map, again, **more).map)


@pytest.mark.slow
def test_the_map_is_consistent_and_counting_twice_is_noticed(monkeypatch):
    (honest,) = runs_of([mission(until=200)], 16)
    assert 0.90 <= mean(honest, "nees_per_dof") <= 1.15
    monkeypatch.setattr(belief, "hand_over", handed_over_twice)
    (doubled,) = runs_of([mission(until=200)], 6)
    assert mean(doubled, "nees_per_dof") > 1.3


@pytest.mark.slow
def test_with_the_printed_noise_robots_that_get_lost_find_back():
    (runs,) = runs_of([mission(noise=1.0, max_steps=1000)], 6)
    assert sum(r.finished for r in runs) >= 0.95 * len(runs)


@pytest.mark.slow
def test_a_robot_that_dies_leaves_no_landmark_missed_and_an_honest_map():
    (runs,) = runs_of([mission("coverage", kills={1: 100})], 6)
    assert sum(r.finished for r in runs) >= 0.95 * len(runs)
    assert all(r.missed == 0 for r in runs if r.finished)
    assert mean(runs, "nees_per_dof") <= 1.3


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["coverage", "loop"])
def test_a_map_of_unknown_landmarks_is_as_honest_as_one_of_known(planner):
    known, (unknown,) = twelve(planner)[:6], runs_of([mission(planner, "jcbb")], 6)
    assert all(r.finished for r in unknown)
    assert mean(unknown, "nees_per_dof") <= 1.2
    assert max(r.nees_per_dof for r in unknown) <= 3
    assert mean(unknown, "map_error") <= 1.2 * mean(known, "map_error")
    assert mean(unknown, "steps") <= 1.05 * mean(known, "steps")
    assert sum(r.duplicates for r in unknown) <= 0.02 * 29 * len(unknown)


def test_two_landmarks_exchanged_after_a_first_look_are_judged_as_the_ones_they_lie_on():
    truth, G = MapTruth(), known_starts(("r",), np.zeros((1, 3)))
    origin = {"a": Counter({7: 1, 8: 5}), "b": Counter({8: 1, 7: 4})}
    truth.hand_over(origin, ("a", "b"), Handover(G, ("m0", "m1"), (False, False)))
    assert truth.source == {"m0": 8, "m1": 7}
    assert truth.misassociations == 2
    truth.hand_over({"a": Counter({7: 3})}, ("a",), Handover(G, ("m0",), (True,)))
    assert truth.misassociations == 3
    truth.hand_over({}, (), Handover(G, (), (), (("m0", "m1"),)))
    assert truth.misassociations == 4
    assert set(truth.source) == {"m0"}


@pytest.mark.slow
@pytest.mark.parametrize(("planner", "seed"), [("loop", 102), ("coverage", 111)])
def test_close_landmarks_exchanged_and_a_lone_pair_far_off_leave_the_map_honest(planner, seed):
    known = mission(planner, "jcbb")
    known = replace(known, cfg=replace(known.cfg, loop=LoopConfig(rate=20.5)))
    (runs,) = runs_of([known], 1, seed=seed)
    assert runs[0].nees_per_dof < 1.6


@pytest.mark.slow
def test_one_of_four_dead_at_a_third_leaves_every_map_honest():
    (runs,) = runs_of([mission("loop", robots=4, kills={1: 33})], 6)
    assert all(r.finished for r in runs)
    assert all(r.missed == 0 for r in runs)
    assert mean(runs, "nees_per_dof") <= 1.3
    assert max(r.nees_per_dof for r in runs) <= 3


@pytest.mark.slow
def test_lost_messages_and_a_death_among_four_are_survived():
    (runs,) = runs_of([mission("loop", robots=4, kills={1: 40}, drop=0.2)], 6)
    assert all(r.finished for r in runs)
    assert mean(runs, "nees_per_dof") <= 1.3


@pytest.mark.slow
def test_laps_planned_together_survive_a_death_and_budgets_longer_than_they_are():
    few = {"joint": JointConfig(search=LapSearchConfig(tries=40))}
    dead, long = runs_of(
        [mission("joint", robots=4, kills={1: 30}, drop=0.2, **few), mission("joint", until=260, **few)], 3
    )
    assert all(r.finished for r in dead + long)
    assert mean(dead, "nees_per_dof") <= 1.4
    assert all(r.steps == 260 for r in long)
    assert mean(long, "missed") < 1


def test_the_same_seed_is_the_same_run_bit_for_bit():
    a, first = explore_once(mission(association="jcbb", until=60), 7)
    b, second = explore_once(mission(association="jcbb", until=60), 7)
    assert replace(a, ms_per_decision=0.0) == replace(b, ms_per_decision=0.0)
    assert first.map.cov.tobytes() == second.map.cov.tobytes()
    assert first.moments[-1].true_poses.tobytes() == second.moments[-1].true_poses.tobytes()


def test_one_robot_explores_a_field_to_its_end():
    small = ScenarioConfig(lower=(-20, -15), upper=(20, 15), landmarks=8)
    score, record = explore_once(LandmarkMission(small, robots=1, planner="coverage", until="field"), 0)
    assert score.finished
    assert record.moments[-1].explored == 1.0
    assert score.missed == 0


def test_the_printed_escape_rule_gets_stuck_where_the_guard_does_not():
    stuck = mission(noise=1.0, literal_escape=True, negligible_gain=0, handover_by=10**9, max_steps=300)
    (literal,) = runs_of([stuck], 4)
    assert sum(r.finished for r in literal) == 0


@pytest.mark.parametrize(
    ("returned", "told"),
    [
        (lambda n: np.zeros((n + 1, 2)), "shape"),
        (lambda n: np.full((n, 2), np.nan), "not a finite number"),
        (lambda n: np.full((n, 2), 99.0), "beyond"),
    ],
)
def test_a_planner_that_returns_nonsense_is_named(returned, told):
    world = make_field(find_scenario("yuan"), 2, 0)
    team = Team(world, ExploreConfig(), lambda v, p, c: returned(2), np.random.default_rng(0))
    with pytest.raises(EstimateError, match=told):
        list(team.play())


def test_a_users_own_planner_is_found_by_dotted_name():
    assert find_planner("mapweave.exploration.landmarks.coverage:choose", "landmarks") is find_planner(
        "coverage", "landmarks"
    )
    with pytest.raises(UsageError, match="not an importable"):
        find_planner("nowhere.at.all:choose", "landmarks")


def test_a_scenario_without_landmarks_or_with_a_robot_outside_is_refused(tmp_path):
    with pytest.raises(DataError, match="no landmarks"):
        make_field(ScenarioConfig(landmarks=0), 2, 0)
    with pytest.raises(DataError, match="outside the field"):
        make_field(ScenarioConfig(starts=((99.0, 0.0, 0.0),)), None, 0)
    with pytest.raises(UsageError, match="at least 1"):
        make_field(ScenarioConfig(), 0, 0)
    bad = tmp_path / "world.toml"
    bad.write_text("wals = 3\nlandmarks = -1\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="wals"):
        find_scenario(str(bad))


def test_explore_writes_what_the_contract_lists_and_its_log_can_be_read(tmp_path):
    from mapweave.io.mrclam import read_mrclam

    out = tmp_path / "out"
    result = explore("yuan", out, runs=2, planner="loop", until=30, association="known")
    rows = (out / "runs.csv").read_text().splitlines()
    assert rows[0] == (
        "run,seed,finished,steps,map_error,c_per_n,nees_per_dof,duplicates,misassociations,missed,ms_per_decision,"
        "collisions,hidden,maps,met,wrong_meetings,in_touch"
    )
    assert len(rows) == 3
    assert {"finished", "runs", "steps_min", "steps_mean", "steps_max", "map_error_m", "c_per_n_m2"} <= set(
        result.metrics["summary"]
    )
    assert (out / "report.html").stat().st_size > 10_000
    assert {f.name for f in (out / "figures").iterdir()} == {
        "map.png",
        "explored.png",
        "progress.png",
        "first_run.gif",
    }
    assert len(read_mrclam(out / "log")) == 2


@pytest.mark.parametrize(("sd", "told"), [("[0.1, 0.1, 0.01]", None), ("[0.15, 0.15, 0.025]", 0.5)])
def test_the_motion_noise_told_is_the_one_used(tmp_path, sd, told):
    (tmp_path / "own.toml").write_text(f"[submap]\nmotion_sd = {sd}\n")
    assert mapweave.explore(until=1, config=tmp_path / "own.toml").metrics["noise_factor"] == told
    assert mapweave.explore(until=1, config=tmp_path / "own.toml", noise=0.7).metrics["noise_factor"] == 0.7
