"""`map` and `solve` on ranges, from the files to the result's folder."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import UsageError
from mapweave.core.fixes import enu_of
from mapweave.io.fixes import read_points
from mapweave.io.pyfg import read_pyfg
from mapweave.io.range_bags import read_range_bag, write_range_bag
from mapweave.sim.laser import DATUM

from ..ranges.worlds import SQUARE, driven, ranged

pytestmark = pytest.mark.drawn

DATA = Path(os.environ.get("MAPWEAVE_DATA", "/nowhere")) / "uwb"


@pytest.fixture(scope="module")
def radios(tmp_path_factory):
    """A simulated recording of three robots and two beacons, and its map."""
    home = tmp_path_factory.mktemp("radios")
    mapweave.simulate_team(home / "log", ranges=True, lasers=3, cameras=0, bearings=0, beacons=2, nlos=0.2, minutes=1)
    return home, mapweave.map(home / "log", home / "out", truth=home / "log")


def test_a_recording_of_ranges_becomes_a_result_like_any_other(radios):
    home, result = radios
    assert result.verdict == "good"
    assert result.maps[0].robots == ("robot1", "robot2", "robot3")
    metrics = json.loads((home / "out" / "metrics.json").read_text())
    assert metrics["components"] == [["1", "2", "3"]]
    assert {(r["a"], r["b"]) for r in metrics["radios"]} >= {("1", "2"), ("1", "beacon1")}
    assert metrics["evaluation"]["landmark_rmse"] < 0.2
    assert all(robot["ate"] < 0.25 for robot in metrics["evaluation"]["robots"].values())
    rows = (home / "out" / "ranges.csv").read_text().splitlines()
    assert rows[0] == "t,a,b,range,residual,used"
    assert 0.1 < np.mean([row.endswith(",0") for row in rows[1:]]) < 0.3
    for name in ("report.html", "landmarks.csv", "figures/map.png", "figures/residuals.png", "trajectories/robot2.tum"):
        assert (home / "out" / name).is_file()
    assert mapweave.evaluate(home / "out", home / "log").metrics["landmark_n"] == 2


def test_how_a_map_of_ranges_grew_is_told_and_changes_nothing_else(radios, tmp_path):
    home, _ = radios
    rows = mapweave.map(home / "log", tmp_path / "out", every=25).metrics["online"]
    assert [row["t"] for row in rows[:-1]] == [25, 50]
    assert rows[-1].items() >= {"robots": 3, "maps": 1, "beacons": 2, "verdict": "good"}.items()
    assert rows[0]["robots"] <= 3
    assert mapweave.load(tmp_path / "out").metrics["online"] == rows
    assert (tmp_path / "out" / "figures" / "growth.png").is_file()
    for name in ("ranges.csv", "graph.pyfg", "landmarks.csv", "trajectories/robot2.tum"):
        assert (tmp_path / "out" / name).read_bytes() == (home / "out" / name).read_bytes()


def test_a_log_of_ranges_up_to_a_moment_knows_nothing_of_who_began_later():
    log = ranged(
        {"robot1": driven(SQUARE, (0.0, 0.0, 0.0)), "robot2": driven(SQUARE, (1.0, 1.0, 0.0))}, {"b": (2.0, 1.0)}
    )
    late = log.odometry["robot2"]
    log = replace(log, odometry={**log.odometry, "robot2": replace(late, t=late.t + 30.0)})
    early, later = log.until(20.0), log.until(40.0)
    assert list(early.odometry) == ["robot1"]
    assert {early.names[k] for k in {*early.a.tolist(), *early.b.tolist()}} == {"robot1", "b"}
    assert early.t.max() <= 20.0
    assert list(later.odometry) == ["robot1", "robot2"]
    assert later.odometry["robot2"].t[-1] <= 40.0


def test_the_solved_graph_that_is_written_solves_to_the_same_places(radios):
    home, result = radios
    written = read_pyfg(home / "out" / "graph.pyfg")
    assert len(written.network.ranges) == int((~result.estimate.far).sum())
    truth, _ = written.truth()
    again = mapweave.solve_ranges(home / "out" / "graph.pyfg", home / "again")
    assert mapweave.load(home / "again").metrics == again.metrics
    ate = mapweave.evaluate(again, home / "out" / "graph.pyfg").as_json()["robots"]
    assert len(truth) == 3
    assert all(robot["ate"] < 0.05 for robot in ate.values())


def test_a_team_with_receivers_lies_on_earth(tmp_path):
    kinds = {"ranges": True, "lasers": 2, "cameras": 0, "bearings": 0, "beacons": 1, "minutes": 1}
    mapweave.simulate_team(tmp_path / "log", **kinds, fixes=0.5, seed=3)
    result = mapweave.map(tmp_path / "log", tmp_path / "out", truth=tmp_path / "log")
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    (placed,) = metrics["georeference"]
    assert placed["fixes"]["robot2"]["topic"] == "/robot2/fix"
    assert 0.9 < placed["fixes"]["robot1"]["noise_scale"] < 1.6
    assert all(robot["ate"] < 0.25 for robot in metrics["evaluation"]["robots"].values())
    shapes = json.loads((tmp_path / "out" / "trajectories.geojson").read_text())["features"]
    assert [f["geometry"]["type"] for f in shapes] == ["LineString", "LineString", "Point"]
    for name in ("fixes.csv", "world/robot2.tum", "world/robot2.cov.csv"):
        assert (tmp_path / "out" / name).is_file()
    np.testing.assert_allclose(result.maps[0].tracks["robot1"].pose[0], 0.0, atol=1e-9)
    g = mapweave.load(tmp_path / "out").georeference
    assert g.row() == result.georeference.row()
    beacon = enu_of(np.append(g.places(result.maps[0].landmarks.mean)[0, ::-1], DATUM[2]), DATUM)
    truth = read_points(tmp_path / "log" / "truth" / "surveyed_landmarks.csv")["beacon1"]
    assert np.hypot(*(beacon[:2] - truth[:2])) < 0.6
    without = mapweave.map(tmp_path / "log", laser=mapweave.LaserOptions(fixes="none"))
    assert without.georeference is None
    assert "georeference" not in without.metrics


@pytest.mark.parametrize(
    ("options", "why"),
    [({"method": "graph"}, "--method"), ({"online": True}, "--online"), ({"radios": {"x1": "robot1"}}, "knows no x1")],
)
def test_options_of_other_logs_are_refused(radios, options, why):
    with pytest.raises(UsageError, match=why):
        mapweave.map(radios[0] / "log", **options)


@pytest.mark.parametrize("options", [{"beacons": 2}, {"nlos": 0.1}, {"ranges": True, "nlos": 1.0}])
def test_worlds_of_radios_that_cannot_be_are_refused(options):
    with pytest.raises(UsageError, match=r"--ranges|--nlos"):
        mapweave.simulate_team(**options)


def test_a_map_that_radios_must_be_metres_unlike_for_is_not_good(tmp_path):
    """Two robots among beacons, one of whose ranges to each other are metres longer than all others."""
    ways = {"robot1": driven(SQUARE, (0.0, 0.0, 0.0)), "robot2": driven(SQUARE[::-1] * 1.3, (2.0, 5.0, 2.0))}
    log = ranged(ways, {"beacon1": (-2.0, 4.0), "beacon2": (5.0, 1.0)})
    pairs = sorted(set(zip(log.a.tolist(), log.b.tolist(), strict=True)))
    for off in (0.0, 4.0):
        path = tmp_path / f"{off:.0f}.mcap"
        rows = [(pair, (log.a == pair[0]) & (log.b == pair[1])) for pair in pairs]
        far = [(log.names[a], log.names[b], log.t[of], log.z[of] + off * ((a, b) == pairs[0])) for (a, b), of in rows]
        write_range_bag(path, log.odometry, far)
        result = mapweave.map(path)
        told = [found for found in result.findings if found.code == "range-biases"]
        assert (result.verdict == "doubtful") == bool(told) == bool(off)
    assert told[0].value["pair"] == "1 and 2"
    assert told[0].value["value"] > 1.0


def test_odometry_that_is_lost_for_a_while_or_no_number_is_told_and_bends_nobody(tmp_path):
    ways = {"robot1": driven(SQUARE, (0.0, 0.0, 0.0)), "robot2": driven(SQUARE[::-1] * 1.3, (2.0, 5.0, 2.0))}
    log = ranged(ways, {"beacon1": (-2.0, 4.0), "beacon2": (5.0, 1.0)})
    track = log.odometry["robot1"]
    pose = track.pose.copy()
    pose[250] = np.nan
    heard = (track.t < 20.0) | (track.t > 40.0)
    odometry = {**log.odometry, "robot1": replace(track, t=track.t[heard], pose=pose[heard])}
    odometry = {name: replace(track, t=10.0 + 0.2 * track.t) for name, track in odometry.items()}
    ranges = [
        (log.names[a], log.names[b], 10.0 + 0.2 * log.t[of], log.z[of])
        for a, b in sorted(set(zip(log.a.tolist(), log.b.tolist(), strict=True)))
        for of in [(log.a == a) & (log.b == b)]
    ]
    write_range_bag(tmp_path / "log.mcap", odometry, ranges)
    result = mapweave.map(tmp_path / "log.mcap")
    told = {found.code: found for found in result.findings}
    assert set(told) >= {"odometry-gap", "rows-impossible", "range-dropped"}
    assert result.verdict == "good"
    assert told["odometry-gap"].span == pytest.approx((14.0, 18.0), abs=0.1)
    track, true = result.maps[0].tracks["robot2"], ways["robot2"]
    there = se2.interpolate(track.t, 10.0 + 0.2 * true.t, true.pose)
    off = se2.act(se2.align(track.pose[:, :2], there[:, :2]), track.pose[:, :2]) - there[:, :2]
    assert np.hypot(*off.T).max() < 0.2


def test_an_option_that_ranges_do_not_have_is_named_as_it_was_given(radios):
    with pytest.raises(UsageError, match=r"^--no-refine: not for recordings of ranges"):
        mapweave.map(radios[0] / "log", refine=False)


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs MAPWEAVE_DATA")
def test_the_public_graph_is_solved_from_no_guess_as_well_as_from_the_truth():
    """0.0406 m is what GTSAM's batch with the same factors ends at from the truth (benchmarks/ranges.py)."""
    file = DATA / "tiers.pyfg.gz"
    result = mapweave.solve_ranges(file)
    net, part = result.network, result.estimate.parts[0]
    true = read_pyfg(file).places
    T = se2.align(part.pose[:, :2], true[part.nodes, :2])
    off = np.hypot(*(se2.act(T, part.pose[:, :2]) - true[part.nodes, :2]).T)[~net.is_beacon]
    assert np.sqrt(np.square(off).mean()) < 1.05 * 0.0406


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs MAPWEAVE_DATA")
def test_the_two_turtlebots_lie_where_motion_capture_has_them_which_is_never_read():
    result = mapweave.map(DATA / "two-turtlebots.db3")
    codes = {f.code for f in result.findings}
    # the one that drives goes in circles, whose odometry errs by 5 cm in 10 s; stamps of ranges scatter
    assert codes - {"odometry-slips", "range-stamps"} == {"radios-assumed", "range-dropped", "heading-unobserved"}
    captured = [left for left in result.unused if left.type == "geometry_msgs/msg/PoseStamped"]
    assert len(captured) == 2
    assert all(f"--fixes {left.topic} reads" in left.reason for left in captured)
    team = result.maps[0]
    apart = np.hypot(*(team.tracks["turtle03"].pose[0] - team.tracks["turtle01"].pose[0])[:2])
    assert 2.0 < apart < 3.0


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs MAPWEAVE_DATA")
def test_motion_capture_of_two_turtlebots_places_the_other_two_where_it_has_them():
    radios = {"n_7": "turtle01", "n_3": "turtle03", "n_4": "turtle04", "n_5": "turtle05"}
    path, captured = DATA / "four-turtlebots.db3", {n: f"/vrpn_client_node/turtlebot{n}_cap/pose" for n in (1, 3, 4, 5)}
    given = mapweave.LaserOptions(fixes=f"{captured[3]},{captured[4]}")
    world = mapweave.map(path, radios=radios, laser=given).georeference.tracks
    for n in (1, 5):
        true = read_range_bag(path, radios, captured[n]).fixes[f"turtle0{n}"]
        track = world[f"turtle0{n}"]
        seen = true.within(track.t[0], track.t[-1])
        off = se2.interpolate(seen.t, track.t, track.pose)[:, :2] - seen.xy(None)
        sd = np.sqrt(np.trace(track.cov[:, :2, :2], axis1=1, axis2=2).mean())
        assert np.sqrt(np.square(off).sum(axis=1).mean()) < min(2.0 * sd, 0.25)
