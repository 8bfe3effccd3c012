"""Laser maps laid by position fixes: where they lie, as sure as they say, joined, and what is said of bad fixes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import mapweave
from mapweave.api.laser_result import LaserResult
from mapweave.api.map_options import LaserOptions
from mapweave.core import se2
from mapweave.core.fixes import enu_of, place_of
from mapweave.core.records import Track
from mapweave.io.fixes import TRANSFORM
from mapweave.io.laser_state import read_laser_states
from mapweave.io.ros_map import read_ros_map
from mapweave.mapping import georeference
from mapweave.mapping.georeference import georeferenced, starts_of
from mapweave.mapping.woven_map import own_map
from mapweave.sim.laser import DATUM, simulated_fixes
from mapweave.sim.laser_worlds import OfficeConfig

from ..spoilt_fixes import SPOILT

SMALL = OfficeConfig(rooms=2, visited=1)
NOISE = 0.5  # [m]


@pytest.fixture(scope="module")
def drives():
    """Two robots in two buildings, fixes with them."""
    return [mapweave.simulate_laser(world=SMALL, seed=seed, fixes=NOISE) for seed in (1, 2)]


@pytest.fixture(scope="module")
def result(drives) -> LaserResult:
    return mapweave.map([drive.log for drive in drives], method="graph")


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("fixed") / "out"
    result.write(path)
    return path


def laid(maps, fixes):
    """The maps of the robots, each alone so far, with these fixes."""
    with_fixes = [replace(m, fixes=f) for m, f in zip(maps, fixes, strict=True)]
    return georeferenced([own_map(m) for m in with_fixes], with_fixes, 0.1, 1.0)


def codes(found):
    return [f.code for f in found.findings]


def shaken(fixes):
    """Noise of a third of a metre, in degrees."""
    return 3e-6 * np.random.default_rng(1).standard_normal((len(fixes), 3))


def in_world(georeference, track: Track) -> np.ndarray:
    """Poses east and north of the simulators' datum."""
    world = np.asarray(se2.compose(georeference.T_world_map, track.pose))
    lifted = np.column_stack([world[:, :2], np.zeros(len(world))])
    world[:, :2] = enu_of(place_of(lifted, georeference.datum), DATUM)[:, :2]
    return world


def test_robots_that_share_no_view_are_in_one_map_by_their_fixes(drives, result):
    assert [c.robots for c in result.components] == [("1", "2")]
    assert [f.robot for f in result.findings if f.code == "placed-by-fixes"] == ["2"]
    for robot, drive in zip(("1", "2"), drives, strict=True):
        track = result.components[0].tracks[robot]
        off = np.hypot(*(in_world(result.components[0].georeference, track) - drive.truth.pose)[:, :2].T)
        assert off.max() < 1.0
        assert np.sqrt(np.square(off).mean()) < 0.5


def test_without_fixes_the_maps_stay_apart(result):
    found = laid(result.maps, [None, None])
    assert [c.robots for c in found.components] == [("1",), ("2",)]
    assert codes(found) == []


def test_where_a_map_lies_is_as_sure_as_it_says(drives, result):
    nees = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        fixes = simulated_fixes(drives[0].truth, NOISE, rng)
        g = laid(result.maps[:1], [fixes]).components[0].georeference
        e = in_world(g, Track(np.zeros(1), np.zeros((1, 3))))[0] - drives[0].truth.pose[0]
        e[2] = se2.wrap_angle(e[2])
        nees.append(e @ np.linalg.solve(g.cov, e) / 3)
    assert 0.5 < np.mean(nees) < 2.0


def test_a_map_that_drifts_is_bent_by_good_fixes(drives, result):
    drive, own = drives[0], result.maps[0]
    graph = own.graph
    step = np.asarray(se2.between(graph.pose[:-1], graph.pose[1:])) + np.array([0.0, 0.0, 0.2 / len(graph)])
    pose = [graph.pose[0]]
    for one in step:
        pose.append(np.asarray(se2.compose(pose[-1], one)))
    loose = replace(graph, pose=np.array(pose), step=step, closures=(), step_information=0.02 * graph.step_information)
    bent = replace(own, graph=loose)
    fixes = simulated_fixes(drive.truth, 0.05, np.random.default_rng(3))
    woven = laid([bent], [fixes]).components[0]
    truth = se2.interpolate(graph.t, drive.truth.t, drive.truth.pose)

    def error(p):
        return float(np.hypot(*(se2.act(se2.align(p[:, :2], truth[:, :2]), p[:, :2]) - truth[:, :2]).T).mean())

    assert error(woven.graph.pose) < 0.4 * error(loose.pose)


def jumping(fixes):
    """Three in ten of the fixes lie 100 m north; and which."""
    place, gone = np.array(fixes.place), np.random.default_rng(1).random(len(fixes)) < 0.3
    place[gone, 0] += 100 / 111_000
    return replace(fixes, place=place), gone


def test_fixes_that_jump_are_left_out_and_told(drives, result):
    fixes, gone = jumping(drives[0].log.fixes)
    found = laid(result.maps[:1], [fixes])
    g = found.components[0].georeference
    assert not g.used[gone].any()
    told = next(f for f in found.findings if f.code == "fixes-rejected")
    assert told.value["far"] >= gone.sum()
    assert told.value["value"] > 80.0
    off = in_world(g, found.components[0].tracks["1"]) - drives[0].truth.pose
    assert np.hypot(*off[:, :2].T).max() < 1.0


def test_a_map_is_not_laid_where_more_fixes_are_wrong_than_may_be(drives, result, monkeypatch):
    fixes, gone = jumping(drives[0].log.fixes)
    monkeypatch.setattr(georeference, "MOSTLY", 0.2)
    found = laid(result.maps[:1], [fixes])
    (told,) = (f for f in found.findings if f.code == "fixes-contradict")
    assert told.severity == "bad"
    assert 100 * gone.mean() <= told.value < 60.0
    assert found.components[0].georeference is None


@pytest.mark.parametrize("long", [False, True])
def test_a_drive_mostly_without_fixes_is_carried_over_and_a_long_silence_is_told(drives, result, monkeypatch, long):
    fixes = drives[0].log.fixes
    lost = (fixes.t > fixes.t[10]) & (fixes.t < fixes.t[-10])
    kept = replace(fixes, t=fixes.t[~lost], place=fixes.place[~lost], cov=fixes.cov[~lost])
    silence = float(np.diff(kept.t).max())
    assert silence > 20.0
    monkeypatch.setattr(georeference, "SILENT", 0.9 * silence if long else 1.1 * silence)
    found = laid(result.maps[:1], [kept])
    off = in_world(found.components[0].georeference, found.components[0].tracks["1"]) - drives[0].truth.pose
    assert np.hypot(*off[:, :2].T).max() < 1.5
    told = [(f.value, f.span) for f in found.findings if f.code == "fixes-silent"]
    assert told == ([(pytest.approx(silence), (kept.t[10], kept.t[11]))] if long else [])


STANDING = pytest.param(lambda f: replace(f, place=f.place[:1] + shaken(f)), "fixes-vague", id="standing")


@pytest.mark.parametrize(("spoil", "code"), [*SPOILT, STANDING])
def test_what_is_wrong_with_fixes_is_a_finding(drives, result, spoil, code):
    found = laid(result.maps[:1], [spoil(drives[0].log.fixes)])
    assert code in codes(found)
    used = code in {"fixes-untold", "fixes-worse", "fixes-dropped"}
    assert (found.components[0].georeference is not None) == used


def test_fixes_of_another_place_or_another_room_join_nothing(drives, result):
    here, there = (drive.log.fixes for drive in drives)
    for other in (replace(there, place=there.place + np.array([1.0, 0.0, 0.0])), replace(there, frame="mocap")):
        found = laid(result.maps, [here, other])
        assert [c.robots for c in found.components] == [("1",), ("2",)]
        assert ("fixes-unused", "2") in [(f.code, f.robot) for f in found.findings]


def test_where_robots_start_is_told_the_search_for_common_places(drives, result):
    start = starts_of(result.maps)[1]
    truth = se2.between(drives[0].truth.pose[0], drives[1].truth.pose[0])
    assert (np.abs(se2.between(start.transform, truth))[:2] < 4 * start.sd[:2]).all()
    assert starts_of([replace(result.maps[0], fixes=None), result.maps[1]]) == {}


def test_a_robot_alone_is_georeferenced_too(drives, tmp_path):
    result = mapweave.map(drives[0].log, tmp_path / "out", method="graph")
    assert (tmp_path / "out" / "map.tif").is_file()
    assert (tmp_path / "out" / "scans.csv").is_file()
    assert result.metrics["georeference"][0]["fixes"]["1"]["topic"] == "/fix"
    particle = mapweave.map(drives[0].log, method="gated")
    assert "fixes-unused" in [f.code for f in particle.findings]


def test_files_tell_where_the_map_lies_and_map_servers_read_over_it(drives, result, folder):
    woven = result.components[0]
    g = woven.georeference
    assert read_ros_map(folder / "map.yaml").state.shape == woven.grid.shape
    text = (folder / "map.yaml").read_text()
    told = json.loads(text.split("georeference: ")[1])
    assert told["datum"] == pytest.approx(g.datum.tolist())
    lines = json.loads((folder / "trajectories.geojson").read_text())["features"]
    for feature, drive in zip(lines, drives, strict=True):
        lon, lat = np.array(feature["geometry"]["coordinates"]).T
        xy = enu_of(np.column_stack([lat, lon, np.full(len(lat), DATUM[2])]), DATUM)[:, :2]
        assert np.hypot(*(xy - drive.truth.pose[:, :2]).T).max() < 1.0
    with Image.open(folder / "map.tif") as picture:
        M = np.array(picture.tag_v2[TRANSFORM]).reshape(4, 4)
        rows, cols = woven.grid.shape
        assert picture.size == (cols, rows)
    corners = np.array([[0, 0], [cols, 0], [0, rows], [cols, rows]])  # columns and rows from the top
    xy = woven.grid.origin + woven.grid.resolution * np.column_stack([corners[:, 0], rows - corners[:, 1]])
    told = np.column_stack([corners, np.zeros(4), np.ones(4)]) @ M.T
    assert (told[:, :2] - g.places(xy)) * 111_000 == pytest.approx(np.zeros((4, 2)), abs=0.05)
    used = np.loadtxt(folder / "fixes.csv", delimiter=",", skiprows=1, usecols=6)
    assert used.sum() == g.used.sum()


def test_going_on_keeps_the_fixes(drives, result, folder):
    for one, kept in zip(result.maps, read_laser_states(folder).maps, strict=True):
        assert (kept.fixes.topic, kept.fixes.frame) == (one.fixes.topic, one.fixes.frame)
        for name in ("t", "place", "cov", "antenna"):
            assert np.array_equal(getattr(kept.fixes, name), getattr(one.fixes, name))


def test_the_antenna_stands_where_it_is_said_to(drives, result):
    arm = np.array([1.5, -0.5])
    truth = drives[0].truth
    carried = Track(truth.t, np.column_stack([se2.act(truth.pose, np.tile(arm, (len(truth.t), 1))), truth.pose[:, 2]]))
    fixes = simulated_fixes(carried, 0.1, np.random.default_rng(1))
    right, wrong = (
        laid(result.maps[:1], [replace(fixes, antenna=antenna)]).components[0] for antenna in (arm, np.zeros(2))
    )
    off = in_world(right.georeference, right.tracks["1"]) - truth.pose
    assert np.hypot(*off[:, :2].T).max() < 0.1
    assert right.georeference.scale[0] < 1.3
    assert wrong.georeference.scale[0] > 5.0


def test_options_reach_the_reader():
    assert LaserOptions(fixes="/mocap/pose").given() == ["--fixes"]
