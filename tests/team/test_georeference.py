"""Landmark teams laid by position fixes: where they lie, as sure as they say, joined, and what is said of bad fixes."""

import json
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.map_landmarks import map_landmark_logs
from mapweave.api.map_options import MapOptions
from mapweave.core import se2
from mapweave.core.fixes import enu_of
from mapweave.core.landmark_log import NOTHING_SEEN
from mapweave.core.records import Track
from mapweave.mapping import georeference
from mapweave.sim.laser import DATUM, simulated_fixes
from mapweave.team.config import SmoothingConfig
from mapweave.team.georeference import laid_team, seen_from_first

from ..spoilt_fixes import SPOILT
from .fixed_teams import body_nees, carrying, errors, fixed, nees

NOISE = 1.0  # [m]


@pytest.fixture(scope="module")
def two():
    """Two pairs of robots that share nothing, and what was made of them without fixes."""
    here, there = fixed(1), fixed(2, first=3)
    made = map_landmark_logs((*here.logs, *there.logs), MapOptions(), "two pairs")
    return here, there, made


def laid(made, logs):
    return laid_team(made.smoothed, logs, made.fusion.labels, SmoothingConfig())


@pytest.fixture(scope="module")
def pair():
    one = fixed(1)
    return one, one.mapped(), one.fixes(NOISE, 1)


def alone(pair, spoil):
    """The pair laid by fixes that were all spoilt."""
    one, made, fixes = pair
    return laid(made, carrying(one.logs, {robot: spoil(f) for robot, f in fixes.items()}))


def codes(found):
    return [(f.code, f.robot) for f in found.findings]


def test_robots_that_share_nothing_are_in_one_map_by_their_fixes(two, tmp_path):
    here, there, before = two
    assert sorted(m.robots for m in before.maps) == [("robot1", "robot2"), ("robot3", "robot4")]
    logs = carrying((*here.logs, *there.logs), {**here.fixes(NOISE, 1), **there.fixes(NOISE, 2)})
    made = map_landmark_logs(logs, MapOptions(), "two pairs")
    assert [m.robots for m in made.maps] == [("robot1", "robot2", "robot3", "robot4")]
    assert {robot for code, robot in codes(made) if code == "placed-by-fixes"} == {"3", "4"}
    assert "robots-apart" not in [f.code for f in made.findings]
    g, truth = made.smoothed[0].georeference, {**here.truth, **there.truth}
    assert np.hypot(*errors(g, truth)[0][:, :2].T).max() < 1.5
    np.testing.assert_allclose(made.maps[0].tracks["robot1"].pose[0], 0.0, atol=1e-9)
    for robot, track in g.tracks.items():
        kept = np.isin(made.maps[0].tracks[robot].t, track.t)
        world = se2.compose(g.T_world_map, made.maps[0].tracks[robot].pose[kept])
        np.testing.assert_allclose(world[:, :2], track.pose[:, :2], atol=1e-6)
    made.write(tmp_path / "out")
    told = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert told["georeference"][0]["fixes"]["robot3"]["topic"] == "/fix"
    assert told["components"] == [["1", "2", "3", "4"]]
    shapes = json.loads((tmp_path / "out" / "trajectories.geojson").read_text(encoding="utf-8"))["features"]
    lines = {f["properties"]["robot"]: f for f in shapes if f["geometry"]["type"] == "LineString"}
    assert list(lines) == ["robot1", "robot2", "robot3", "robot4"]
    assert len(shapes) - len(lines) == len(made.maps[0].landmarks)
    lon, lat = np.array(lines["robot3"]["geometry"]["coordinates"]).T
    xy = enu_of(np.column_stack([lat, lon, np.full(len(lat), DATUM[2])]), DATUM)[:, :2]
    middle = np.median(there.truth["robot3"].pose[:, :2], axis=0)
    assert np.hypot(*(np.median(xy, axis=0) - middle)) < 2.0
    assert (tmp_path / "out" / "fixes.csv").is_file()
    assert (tmp_path / "out" / "world" / "robot4.cov.csv").is_file()
    again = mapweave.load(tmp_path / "out").smoothed[0].georeference
    assert again.row() == g.row()


@pytest.mark.slow
def test_poses_in_the_world_are_as_sure_as_they_say():
    told, of_maps = [], []
    for seed in range(3, 9):
        one = fixed(seed, minutes=1.5)
        found = laid(one.mapped(), carrying(one.logs, one.fixes(NOISE, seed)))
        told.append(nees(found.components[0].georeference, one.truth))
        of_maps.append(body_nees(found.components[0], one.landmarks))
    assert 0.5 < np.mean(told) < 2.0
    assert 0.5 < np.mean(of_maps) < 2.0


def test_a_map_seen_from_another_pose_lies_where_it_lay(pair):
    one, made, fixes = pair
    before = laid(made, carrying(one.logs, fixes)).components[0]
    track = before.map.tracks["robot1"]
    later = Track(track.t[500:], track.pose[500:], track.cov[500:])
    cut = seen_from_first(replace(before, map=replace(before.map, tracks={**before.map.tracks, "robot1": later})))
    np.testing.assert_allclose(cut.map.tracks["robot1"].pose[0], 0.0, atol=1e-9)
    where, now = (se2.act(s.georeference.T_world_map, s.map.landmarks.mean) for s in (before, cut))
    np.testing.assert_allclose(now, where, atol=1e-6)
    assert body_nees(cut, one.landmarks) == pytest.approx(body_nees(before, one.landmarks), rel=0.01)


def test_a_robot_that_saw_nothing_is_placed_by_its_wheels_and_its_fixes(two):
    here, there, _ = two
    blind = replace(there.logs[0], sightings=NOTHING_SEEN, bearings=NOTHING_SEEN)
    logs = carrying((*here.logs, blind), {**here.fixes(NOISE, 1), **there.fixes(NOISE, 2)})
    made = map_landmark_logs(logs, MapOptions(), "one saw nothing")
    assert made.maps[0].robots == ("robot1", "robot2", "robot3")
    g = made.smoothed[0].georeference
    e, _ = errors(replace(g, tracks={"robot3": g.tracks["robot3"]}), there.truth)
    assert np.sqrt(np.square(e[:, :2]).sum(axis=1).mean()) < 1.0


def test_without_fixes_all_stays_as_it_was(two):
    here, there, before = two
    found = laid(before, (*here.logs, *there.logs))
    assert found.components == before.smoothed
    assert found.findings == ()


def test_fixes_that_jump_are_left_out_and_told(pair):
    one, made, fixes = pair
    gone = {robot: np.random.default_rng(1).random(len(f)) < 0.2 for robot, f in fixes.items()}
    far = {
        robot: replace(f, place=f.place + np.outer(gone[robot], [100 / 111_000, 0, 0])) for robot, f in fixes.items()
    }
    found = laid(made, carrying(one.logs, far))
    g = found.components[0].georeference
    for k, robot in enumerate(g.robots):
        assert not g.used[g.owner == k][gone[robot]].any()
    told = [f for f in found.findings if f.code == "fixes-rejected"]
    assert [f.robot for f in told] == ["1", "2"]
    assert all(f.value["value"] > 80.0 for f in told)
    assert np.hypot(*errors(g, one.truth)[0][:, :2].T).max() < 1.0


def test_minutes_without_fixes_are_carried_over_and_told(pair, monkeypatch):
    one = pair[0]
    monkeypatch.setattr(georeference, "SILENT", 30.0)
    found = alone(pair, lambda f: f.select((f.t < f.t[0] + 40.0) | (f.t > f.t[-1] - 40.0)))
    assert [robot for code, robot in codes(found) if code == "fixes-silent"] == ["1", "2"]
    assert np.hypot(*errors(found.components[0].georeference, one.truth)[0][:, :2].T).max() < 1.5


@pytest.mark.parametrize(("spoil", "code"), SPOILT)
def test_what_is_wrong_with_fixes_is_a_finding(pair, spoil, code):
    found = alone(pair, spoil)
    assert code in [f.code for f in found.findings]
    used = code in {"fixes-untold", "fixes-worse", "fixes-dropped"}
    assert (found.components[0].georeference is not None) == used
    assert used or found.components == pair[1].smoothed


def test_a_pair_in_another_hemisphere_is_not_joined(two):
    here, there, before = two
    south = {r: replace(f, place=f.place * [-1.0, 1.0, 1.0]) for r, f in there.fixes(NOISE, 2).items()}
    found = laid(before, carrying((*here.logs, *there.logs), {**here.fixes(NOISE, 1), **south}))
    assert sorted(s.map.robots for s in found.components) == [("robot1", "robot2"), ("robot3", "robot4")]
    assert {("fixes-unused", "3"), ("fixes-unused", "4")} <= set(codes(found))


def test_the_antenna_stands_where_it_is_said_to(pair):
    one, made, _ = pair
    arm, rng = np.array([1.0, -0.5]), np.random.default_rng(1)
    carried = {
        r: np.column_stack([se2.act(w.pose, np.tile(arm, (len(w.t), 1))), w.pose[:, 2]]) for r, w in one.truth.items()
    }
    fixes = {r: simulated_fixes(Track(one.truth[r].t, way), 0.1, rng) for r, way in carried.items()}
    right = laid(made, carrying(one.logs, {r: replace(f, antenna=arm) for r, f in fixes.items()})).components[0]
    wrong = laid(made, carrying(one.logs, fixes)).components[0]
    assert right.georeference.scale.max() < 1.5
    assert wrong.georeference.scale.min() > 3.0
    assert np.hypot(*errors(right.georeference, one.truth)[0][:, :2].T).mean() < 0.1


def test_a_landmark_that_both_know_is_one_where_fixes_join_them(two):
    here, there, _ = two
    one, other = here.logs[0].sightings.ids[0], there.logs[0].sightings.ids[0]
    logs = carrying((*here.logs, *there.logs), {**here.fixes(0.05, 1), **there.fixes(0.05, 2)})
    again = [
        replace(log, sightings=replace(log.sightings, ids=tuple(one if n == other else n for n in log.sightings.ids)))
        for log in logs
    ]
    made = map_landmark_logs(again, MapOptions(), "one name twice")
    assert [m.robots for m in made.maps] == [("robot1", "robot2", "robot3", "robot4")]
    # 100 m lie between the two: the name is wrong of one of them, and bends no way
    g, truth = made.smoothed[0].georeference, {**here.truth, **there.truth}
    assert np.hypot(*errors(g, truth)[0][:, :2].T).mean() < 0.15


def test_where_the_frame_is_given_fixes_are_not_used(pair):
    one, _, fixes = pair
    made = map_landmark_logs(carrying(one.logs, fixes), MapOptions(start={"1": (1.0, 2.0, 0.0)}), "")
    assert made.smoothed[0].georeference is None
    assert {("fixes-unused", "1"), ("fixes-unused", "2")} <= set(codes(made))
