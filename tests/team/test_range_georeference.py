"""Teams that ranges place laid by position fixes: as sure as they say, joined, turned over, and bad fixes told."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.fixes import enu_of, place_of
from mapweave.core.records import Track
from mapweave.mapping import georeference
from mapweave.report.scene import Scene, fix_points
from mapweave.sim.laser import DATUM, simulated_fixes

from ..ranges.worlds import LINE, SQUARE, driven, ranged
from ..spoilt_fixes import SPOILT
from .fixed_teams import Ranged, errors, from_datum, nees, receivers, with_radios

NOISE = 0.5  # [m]


@pytest.fixture(scope="module")
def team():
    made = with_radios(1)
    return made, receivers(made.truth, NOISE, 1)


def codes(laid):
    return [(f.code, f.robot) for f in laid.findings]


def off(laid, truth):
    return np.hypot(*errors(laid.georeference, truth, 1)[0][:, :2].T)


def whole_nees(laid, truth):
    """Of where the map lies as one body, by its three degrees of freedom."""
    g = laid.georeference
    there = np.concatenate([from_datum(g, w.pose[:, :2]) for w in g.tracks.values()])
    true = np.concatenate([se2.interpolate(w.t, truth[r].t, truth[r].pose)[:, :2] for r, w in g.tracks.items()])
    origin = from_datum(g, g.T_world_map[None, :2])[0]
    e = se2.align(true - origin, there - origin)
    return float(e @ np.linalg.solve(g.cov, e) / 3)


@pytest.mark.slow
def test_poses_in_the_world_are_as_sure_as_they_say_with_a_third_of_all_fixes_wrong():
    told, of_maps, far = [], [], []
    for seed in range(1, 6):
        made = with_radios(seed)
        rng, fixes = np.random.default_rng(seed), receivers(made.truth, NOISE, seed)
        wrong = {r: rng.random(len(f)) < 0.33 for r, f in fixes.items()}
        for r, f in fixes.items():
            jump = np.column_stack([100.0 * rng.standard_normal((len(f), 2)), np.zeros(len(f))]) * wrong[r][:, None]
            fixes[r] = replace(f, place=place_of(enu_of(f.place, DATUM) + jump, DATUM))
        laid = made.laid(fixes)
        g = laid.georeference
        told.append(nees(g, made.truth))
        of_maps.append(whole_nees(laid, made.truth))
        far.append(off(laid, made.truth).max())
        for k, robot in enumerate(g.robots):
            way = made.truth[robot]
            true = se2.interpolate(g.t[g.owner == k], way.t, way.pose)[:, :2]
            gone = np.hypot(*(from_datum(g, g.z[g.owner == k]) - true).T) > 5.0
            assert gone.sum() > 5
            assert not g.used[g.owner == k][gone].any()
        assert [f.robot for f in laid.findings if f.code == "fixes-rejected"] == ["1", "2", "3"]
    assert 0.5 < np.mean(told) < 2.0
    assert 0.3 < np.mean(of_maps) < 2.0
    assert max(far) < 1.0


def test_the_map_lies_where_its_frame_is_said_to_and_its_parts_are_one(team):
    made, fixes = team
    laid = made.laid(fixes)
    part, g = laid.estimate.parts[0], laid.georeference
    assert len(laid.estimate.parts) == 1
    assert part.frame_cov is not None
    assert laid.estimate.loose == {}
    np.testing.assert_allclose(g.T_world_map, g.tracks["robot1"].pose[0])
    assert whole_nees(laid, made.truth) < 4.0
    before = replace(g, T_world_map=np.zeros(3), cov=part.frame_cov)
    assert np.linalg.det(before.cov) == pytest.approx(np.linalg.det(g.cov))


def test_robots_that_no_range_ties_are_in_one_map_by_their_fixes():
    made = with_radios(2)
    other = made.log.names.index("robot3")
    kept = (made.log.a != other) & (made.log.b != other)
    log = replace(made.log, a=made.log.a[kept], b=made.log.b[kept], t=made.log.t[kept], z=made.log.z[kept])
    apart = Ranged.of(log, made.truth)
    assert len(apart.found.parts) == 2
    assert list(apart.found.loose) == ["robot3"]
    laid = apart.laid(receivers(made.truth, 0.1, 2))
    assert len(laid.estimate.parts) == 1
    assert laid.estimate.loose == {}
    assert [robot for code, robot in codes(laid) if code == "placed-by-fixes"] == ["3"]
    assert sorted(laid.georeference.tracks) == ["robot1", "robot2", "robot3"]
    assert off(laid, made.truth).max() < 0.6


def test_a_few_ranges_that_place_nobody_are_used_where_fixes_do():
    made = with_radios(2)
    log, other = made.log, made.log.names.index("robot3")
    mine = np.flatnonzero((log.a == other) | (log.b == other))
    kept = np.setdiff1d(np.arange(len(log.z)), mine[4:])
    few = Ranged.of(replace(log, a=log.a[kept], b=log.b[kept], t=log.t[kept], z=log.z[kept]), made.truth)
    assert np.isnan(few.found.residual).sum() == 4
    laid = few.laid(receivers(made.truth, 0.1, 2))
    assert np.isfinite(laid.estimate.residual).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_fixes_tell_on_which_side_of_a_straight_way_the_other_robot_drove(side):
    truth = {"robot1": driven(LINE, (0.0, 0.0, 0.0)), "robot2": driven(LINE, (2.0, 3.0 * side, 1.2 * side))}
    made = Ranged.of(ranged(truth, {}), truth)
    assert made.found.parts[0].mirrored
    laid = made.laid({r: simulated_fixes(way, 0.3, np.random.default_rng(4)) for r, way in truth.items()})
    assert laid.estimate.parts[0].mirrored == ()
    assert off(laid, truth).max() < 0.5


def test_where_fixes_do_not_tell_the_side_both_stay(team):
    truth = {"robot1": driven(LINE, (0.0, 0.0, 0.0))}
    made = Ranged.of(ranged(truth, {"beacon1": (2.0, 3.0)}), truth)
    laid = made.laid({"robot1": simulated_fixes(truth["robot1"], 0.1, np.random.default_rng(4))})
    part = laid.estimate.parts[0]
    assert len(part.mirrored) == 1
    assert np.hypot(*(part.mirrored[0] - part.pose)[:, :2].T)[:-1].max() < 0.3
    assert np.hypot(*(part.mirrored[0] - part.pose)[-1, :2]) == pytest.approx(6.0, abs=0.5)


def test_minutes_without_fixes_are_carried_over_and_told(team, monkeypatch):
    made, fixes = team
    monkeypatch.setattr(georeference, "SILENT", 30.0)
    laid = made.laid({r: f.select((f.t < f.t[0] + 12.0) | (f.t > f.t[-1] - 12.0)) for r, f in fixes.items()})
    assert [robot for code, robot in codes(laid) if code == "fixes-silent"] == ["1", "2", "3"]
    assert off(laid, made.truth).max() < 1.0


def test_fixes_of_one_robot_place_all(team):
    made, fixes = team
    laid = made.laid({"robot2": fixes["robot2"]})
    assert sorted(laid.georeference.tracks) == ["robot1", "robot2", "robot3"]
    assert off(laid, made.truth).max() < 1.5


def test_fixes_of_another_time_tell_no_heading(team):
    made, fixes = team
    rng = np.random.default_rng(1)
    laid = made.laid({robot: replace(f, place=f.place[rng.permutation(len(f))]) for robot, f in fixes.items()})
    assert codes(laid) == [("fixes-vague", "1")]


@pytest.mark.parametrize(("spoil", "code"), [case for case in SPOILT if case.id != "shuffled"])
def test_what_is_wrong_with_fixes_is_a_finding(team, spoil, code):
    made, fixes = team
    laid = made.laid({robot: spoil(f) for robot, f in fixes.items()})
    assert code in [f.code for f in laid.findings]
    used = code in {"fixes-untold", "fixes-worse", "fixes-dropped"}
    assert (laid.georeference is not None) == used
    assert used or laid.estimate is made.found


def test_the_antenna_stands_where_it_is_said_to(team):
    made, _ = team
    arm, rng = np.array([1.0, -0.5]), np.random.default_rng(1)
    fixes = {}
    for robot, way in made.truth.items():
        carried = np.column_stack([se2.act(way.pose, np.tile(arm, (len(way.t), 1))), way.pose[:, 2]])
        fixes[robot] = replace(simulated_fixes(Track(way.t, carried), 0.1, rng), antenna=arm)
    right = made.laid(fixes)
    wrong = made.laid({robot: replace(f, antenna=np.zeros(2)) for robot, f in fixes.items()})
    assert off(right, made.truth).mean() < 0.1
    assert right.georeference.scale.max() < 1.5
    assert wrong.georeference.scale.max() > 3.0


def test_where_beacons_are_surveyed_fixes_are_not_used(team):
    truth = {"robot1": driven(SQUARE, (0.0, 0.0, 0.0)), "robot2": driven(SQUARE, (1.0, 4.0, 2.0))}
    beacons = {"beacon1": (-2.0, 4.0), "beacon2": (5.0, 1.0)}
    log = replace(ranged(truth, beacons), known={name: (*at, 0.01) for name, at in beacons.items()})
    laid = Ranged.of(log, truth).laid(receivers(truth, 0.1, 1))
    assert codes(laid) == [("fixes-unused", "1"), ("fixes-unused", "2")]
    assert laid.georeference is None


def test_fixes_stand_on_the_page_where_they_lie_in_the_map(team):
    made, fixes = team
    laid = made.laid(fixes)
    scene = Scene("map")
    fix_points(scene, laid.georeference)
    held = {one["layer"]: np.column_stack([one["x"], one["y"]]) for one in scene.data()["points"]}
    assert sum(map(len, held.values())) == len(laid.georeference.z)
    assert len(held["fixes"]) == laid.georeference.used.sum()
    g = laid.georeference
    ways = np.concatenate([se2.act(se2.inverse(g.T_world_map), w.pose[:, :2]) for w in g.tracks.values()])
    assert np.median([np.hypot(*(ways - at).T).min() for at in held["fixes"]]) < 2 * NOISE


def test_the_page_of_a_map_of_ranges_shows_fixes(tmp_path):
    mapweave.simulate_team(tmp_path / "team", ranges=True, fixes=NOISE, lasers=2, cameras=0, bearings=0, minutes=0.5)
    mapweave.map(tmp_path / "team" / "ranges.mcap", tmp_path / "out")
    assert '"layer":"fixes"' in (tmp_path / "out" / "report.html").read_text().replace(": ", ":")
