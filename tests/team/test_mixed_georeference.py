"""Mixed teams laid by position fixes: a laser robot and a camera robot that share nothing, and how sure they are."""

import json
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.map_mixed import map_mixed_logs
from mapweave.api.map_options import MapOptions
from mapweave.core.landmark_log import NOTHING_SEEN
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.mixed_logs import read_mixed_landmarks, sorted_logs
from mapweave.team.known import PlacePriors

from .fixed_teams import alone, anywhere, errors, nees, receivers
from .mixed_teams import mixed

NOISE = 1.0  # [m]
APART = {"lasers": 1, "cameras": 1, "bearings": 0, "landmarks": 10, "minutes": 1.5}


def with_fixes(seed, *, sd=NOISE, gone=()):
    """A team, its true ways on earth, and what its robots' receivers told; nobody saw another robot."""
    made = mixed(seed, **APART)
    truth = anywhere({r: t.track for r, t in made.truth.robots.items()}, seed)
    fixes = {r: f for r, f in receivers(truth, sd, seed).items() if r not in gone}
    logs = [
        replace(log, fixes=None if log.robot in made.scanned else fixes.get(log.robot)) for log in map(alone, made.logs)
    ]
    return made, truth, logs, {r: f for r, f in fixes.items() if r in made.scanned}


def test_walls_and_landmarks_that_share_no_view_are_in_one_map_by_fixes():
    made, truth, logs, of_lasers = with_fixes(1)
    assert [s.map.robots for s in made.map(logs=[replace(log, fixes=None) for log in logs]).components] == [
        ("robot1",),
        ("robot2",),
    ]
    found = made.map(logs=logs, fixes=of_lasers)
    assert [s.map.robots for s in found.components] == [("robot1", "robot2")]
    assert [(tie.a, tie.b, tie.by) for tie in found.layout.ties] == [(("robot1",), ("robot2",), "fixes")]
    assert ("placed-by-fixes", "2") in [(f.code, f.robot) for f in found.placed]
    assert np.hypot(*errors(found.components[0].georeference, truth)[0][:, :2].T).max() < 1.5


def test_a_robot_that_saw_nothing_is_placed_by_its_wheels_and_its_fixes():
    made, truth, logs, of_lasers = with_fixes(1)
    blind = [replace(log, sightings=NOTHING_SEEN, bearings=NOTHING_SEEN) for log in logs]
    found = made.map(logs=blind, mapped=[], fixes=of_lasers)
    assert [s.map.robots for s in found.components] == [("robot1", "robot2")]
    assert found.layout.lost == ()
    g = found.components[0].georeference
    e, _ = errors(replace(g, tracks={"robot2": g.tracks["robot2"]}), truth)
    assert np.sqrt(np.square(e[:, :2]).sum(axis=1).mean()) < 1.0
    without = made.map(logs=[replace(log, fixes=None) for log in blind], mapped=[], fixes=of_lasers)
    assert without.layout.lost == ("robot2",)


def test_without_the_fixes_of_one_robot_it_stays_apart():
    made, _, logs, of_lasers = with_fixes(1, gone=("robot2",))
    found = made.map(logs=logs, fixes=of_lasers)
    assert sorted(s.map.robots for s in found.components) == [("robot1",), ("robot2",)]
    assert [s.map.robots for s in found.components if s.georeference is not None] == [("robot1",)]


def test_where_the_frame_is_given_or_nothing_is_smoothed_fixes_are_not_used():
    made, _, logs, of_lasers = with_fixes(1)
    known = PlacePriors.of({"robot1": (1.0, 2.0, 0.0)}, {}, {}, ["robot1", "robot2"])
    for options in ({"known": known}, {"refine": False}):
        found = made.map(logs=logs, fixes=of_lasers, **options)
        assert [f.code for f in found.placed] == ["fixes-unused"] * 2
        assert all(s.georeference is None for s in found.components)


@pytest.mark.slow
def test_poses_of_mixed_teams_in_the_world_are_as_sure_as_they_say():
    told = []
    for seed in range(20, 25):
        made, truth, logs, of_lasers = with_fixes(seed)
        placed = [s.georeference for s in made.map(logs=logs, fixes=of_lasers).components]
        told += [nees(g, truth) for g in placed if g is not None]
    assert len(told) >= 5
    assert 0.5 < np.mean(told) < 2.0


def test_files_tell_where_the_walls_and_the_landmarks_lie(tmp_path):
    home = tmp_path / "team"
    mapweave.simulate_team(home, seed=1, **APART)
    _, truth, _, _ = with_fixes(1)
    fixes = receivers(truth, NOISE, 1)
    found = sorted_logs([home], LaserSource())
    logs = [
        replace(log, fixes=None if log.robot in found.lasers else fixes[log.robot])
        for log in read_mixed_landmarks(found)
    ]
    lasers = [replace(read_laser(of.path, r[5:]), fixes=fixes[r]) for r, of in found.lasers.items()]
    made = map_mixed_logs(logs, lasers, MapOptions())
    made.write(tmp_path / "out")
    told = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert told["georeference"][0]["fixes"]["robot1"]["used"] > 50
    text = (tmp_path / "out" / "map.yaml").read_text()
    assert json.loads(text.split("georeference: ")[1]) == told["georeference"][0]
    names = {"map.tif", "trajectories.geojson", "fixes.csv", "world"}
    assert names <= {path.name for path in (tmp_path / "out").iterdir()}
    again = mapweave.load(tmp_path / "out")
    assert again.maps[0].robots == ("robot1", "robot2")
