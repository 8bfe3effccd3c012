"""Clocks that are off are found and put right, and those that cannot be right are named."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core.landmark_log import LandmarkLog
from mapweave.evaluation.team import score_team
from mapweave.team import smooth as smoothing
from mapweave.team.clocks import clocks_of, of_another_time
from mapweave.team.config import CLUSTER, SmoothingConfig
from mapweave.team.problem import team_problem
from mapweave.team.smooth import smooth, smooth_on_one_clock

from .teams import World, world

CFG = SmoothingConfig()


def later(log: LandmarkLog, by: float) -> LandmarkLog:
    assert log.odometry is not None
    return replace(
        log,
        odometry=replace(log.odometry, t=log.odometry.t + by),
        sightings=replace(log.sightings, t=log.sightings.t + by),
    )


def test_a_clock_an_hour_off_is_named_where_robots_saw_each_other():
    logs = list(world(4, minutes=1.0).logs)
    assert of_another_time(logs) == {}
    off = [logs[0], later(logs[1], 3600.0), *logs[2:]]
    assert 3530.0 < of_another_time(off)[logs[1].robot] < 3600.0
    assert len(of_another_time(off)) == 1


def test_the_gap_is_that_to_the_nearest_log_of_all_others():
    logs = list(world(4, minutes=1.0).logs)[:3]
    first, last = logs[0].span
    for shift in (500.0, -500.0):
        off = [logs[0], later(logs[1], 50.0), later(logs[2], shift)]
        ((robot, gap),) = of_another_time(off).items()
        ends = [off[0].span, off[1].span]
        begun, ended = off[2].span
        wanted = begun - max(b for _, b in ends) if shift > 0 else min(a for a, _ in ends) - ended
        assert robot == logs[2].robot
        assert gap == pytest.approx(wanted)
    touching = [logs[0], later(logs[1], last - logs[1].span[0])]
    assert first < last
    assert of_another_time(touching) == {}


def test_logs_of_two_days_whose_robots_never_met_are_no_wrong_clocks():
    logs = list(world(4, minutes=1.0).logs)[:2]
    alone = []
    for log in logs:
        met = np.isin(log.sightings.what, [i for i, name in enumerate(log.sightings.ids) if name.startswith("robot")])
        alone.append(replace(log, sightings=log.sightings.select(~met)))
    assert of_another_time([alone[0], later(alone[1], 3600.0)]) == {}


def test_the_map_says_so(tmp_path):
    home = tmp_path / "team"
    mapweave.simulate_landmarks(home, robots=2, minutes=1.0, seed=7013)
    for name in ("Odometry", "Measurement"):
        rows = [r.split() for r in (home / f"Robot2_{name}.dat").read_text().splitlines() if not r.startswith("#")]
        moved = [" ".join([repr(float(t) + 3600.0), *rest]) for t, *rest in rows]
        (home / f"Robot2_{name}.dat").write_text("\n".join(moved) + "\n")
    made = mapweave.map(home, refine=False)
    assert any("robot 2: its clock has nothing in common" in w for w in made.metrics["warnings"])


def off(w: World, ahead: dict[str, float]) -> World:
    """The world with robots' clocks ahead: their logs, and where their own maps have them when."""
    logs = tuple(later(log, ahead.get(log.robot, 0.0)) for log in w.logs)
    tracks = {r: replace(track, t=track.t + ahead.get(r, 0.0)) for r, track in w.map.tracks.items()}
    return replace(w, logs=logs, map=replace(w.map, tracks=tracks))


def on_one_clock_of(w: World):
    return smooth_on_one_clock(w.map, w.logs, w.fusion.labels, CFG)


@pytest.fixture
def count(monkeypatch):
    """How often a team is smoothed."""
    calls: list[int] = []

    def counted(*args, **options):
        calls.append(1)
        return smooth(*args, **options)

    monkeypatch.setattr(smoothing, "smooth", counted)
    return calls


def test_right_clocks_are_smoothed_once_and_as_ever(count):
    w = world(31, robots=4, minutes=3.0)
    made = on_one_clock_of(w)
    assert len(count) == 1
    assert not made.clocks
    assert not made.notes
    np.testing.assert_array_equal(
        made.map.landmarks.mean, smooth(w.map, w.logs, w.fusion.labels, CFG).map.landmarks.mean
    )


@pytest.mark.parametrize(
    "ahead",
    [
        {"robot1": -3.0},
        pytest.param({"robot2": 2.0, "robot4": -1.5}, marks=pytest.mark.slow),
        pytest.param({"robot3": 10.0}, marks=pytest.mark.slow),
    ],
)
def test_clocks_that_are_off_are_found_and_put_right(ahead):
    w = world(31, robots=4, minutes=3.0)
    made = on_one_clock_of(off(w, ahead))
    assert set(made.clocks) == set(ahead)
    scored = score_team([made.map], {}, w.truth.survey, w.truth.robots)
    as_ever = score_team([smooth(w.map, w.logs, w.fusion.labels, CFG).map], {}, w.truth.survey, w.truth.robots)
    for robot, by in ahead.items():
        found = made.clocks[robot]
        assert abs(found.ahead - by) < min(3.0 * found.sd, 0.5)
        where = "ahead of" if by > 0 else "behind"
        assert any(n.told.startswith(f"robot {robot[5:]}: its clock is") and where in n.text for n in made.notes)
        assert scored.robots[robot].ate < 1.2 * as_ever.robots[robot].ate


@pytest.mark.slow
def test_of_two_robots_the_first_has_the_clock():
    w = world(33, robots=2, minutes=4.0)
    made = on_one_clock_of(off(w, {"robot1": 2.0}))
    assert set(made.clocks) == {"robot2"}
    assert abs(made.clocks["robot2"].ahead + 2.0) < 3.0 * made.clocks["robot2"].sd


def test_what_a_clock_seems_off_is_what_minimising_over_it_gives():
    """The step of the score test against the minimum of the cost over one robot's clock, everything else free."""
    w = off(world(31, robots=4, minutes=3.0), {"robot2": 0.1})

    def minimum(moved: float) -> float:
        there = off(w, {"robot2": -moved})
        team = team_problem(there.logs, there.map.landmarks, there.map.tracks, w.fusion.labels, {}, CFG)
        return team.solve().cost

    team = team_problem(w.logs, w.map.landmarks, w.map.tracks, w.fusion.labels, {}, CFG)
    seems = clocks_of(team, team.solve(), 10.0, CLUSTER, ["robot2"])["robot2"].ahead
    tried = np.linspace(-0.6, 0.6, 5)
    bend, slope, _ = np.polyfit(tried, [minimum(t) for t in tried], 2)
    assert bend > 0
    assert seems == pytest.approx(-0.5 * slope / bend, abs=0.06)


@pytest.mark.slow
def test_the_map_tells_a_clock_that_was_put_right(tmp_path):
    home = tmp_path / "team"
    mapweave.simulate_landmarks(home, robots=3, minutes=3.0, seed=7022)
    for name in ("Odometry", "Measurement"):
        rows = [r.split() for r in (home / f"Robot3_{name}.dat").read_text().splitlines() if not r.startswith("#")]
        moved = [" ".join([repr(float(t) - 2.0), *rest]) for t, *rest in rows]
        (home / f"Robot3_{name}.dat").write_text("\n".join(moved) + "\n")
    made = mapweave.map(home)
    assert made.metrics["refined"]["components"][0]["clocks"]["3"]["ahead"] == pytest.approx(-2.0, abs=0.4)
    assert any("robot 3: its clock is" in w and "behind the others'" in w for w in made.metrics["warnings"])
