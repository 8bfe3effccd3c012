"""Laser logs of a team become one map where the scans tell how they lie; else they stand alone, with the reason."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import mapweave
from mapweave.api.map_options import LaserOptions, parse_starts
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.core.errors import DataError, UsageError
from mapweave.core.records import Track
from mapweave.io.g2o import read_g2o, read_g2o_file
from mapweave.io.laser_logs import read_laser
from mapweave.io.laser_map import read_grid
from mapweave.io.mcap import write_mcap
from mapweave.io.robot_graph import read_robot_graph
from mapweave.io.table import read_table
from mapweave.io.tum import read_tum

from ..laser.team_logs import cut, dark, office, part_of

pytestmark = pytest.mark.usefixtures("_remembered")

HOUR = 3600.0


@pytest.fixture(scope="module")
def team(office_logs):
    return office_logs


@pytest.fixture(scope="module")
def woven(office_map):
    return office_map


def test_robots_that_saw_the_same_walls_are_in_one_map_whatever_their_clocks(woven, office_truth):
    result, out = woven
    told = json.loads((out / "metrics.json").read_text())
    assert told["components"] == [["1", "2"]]
    (row,) = told["fusion"]
    assert {"a", "b", "overlap", "score", "second", "agreeing", "chi2", "decision", "reason"} <= set(row)
    assert (row["a"], row["b"], row["decision"]) == ("1", "2", "merged")
    assert row["agreeing"] >= 4
    assert f"merged on {row['agreeing']} closures" in row["reason"]
    assert {told["robots"][k]["method"] for k in "12"} == {"graph"}
    scores = mapweave.evaluate(result, office_truth).as_json()["robots"]
    assert max(scores[k]["ate"] for k in "12") < 0.25
    assert any("robot1 and robot2 in one map" in line for line in result.lines())


def test_a_log_that_ends_amid_a_loop_is_closed_by_the_robot_that_went_on(woven, team):
    result, _ = woven
    _, truth = team
    first, second = truth
    assert np.hypot(*(first.pose[-1] - first.pose[0])[:2]) > 2.0
    made = result.components[0]
    ends = [made.tracks["1"].pose[0], made.tracks["2"].pose[-1]]
    true = [first.pose[0], second.pose[-1]]
    assert np.hypot(*(se2.between(*ends) - se2.between(*true))[:2]) < 0.4


def test_the_frame_is_the_first_pose_of_the_lowest_robot(woven):
    _, out = woven
    assert np.allclose(read_tum(out / "trajectories" / "robot1.tum").pose[0], 0.0, atol=1e-9)
    assert np.hypot(*read_tum(out / "trajectories" / "robot2.tum").pose[0, :2]) > 1.0


def test_the_grid_holds_the_walls_of_both_robots_where_their_trajectories_put_them(woven):
    _, out = woven
    grid = read_grid(out / "grid.npz")[0]
    low, high = grid.origin, grid.origin + grid.resolution * np.array(grid.shape[::-1])
    taken = {tuple(c) for c in np.floor((grid.cells()[:, :2] - grid.origin) / grid.resolution).astype(int).tolist()}
    for k in (1, 2):
        graph = read_robot_graph(out / "local" / f"robot{k}" / "robot_graph.npz")
        track = read_tum(out / "trajectories" / f"robot{k}.tum")
        pose = track.pose[np.abs(track.t[:, None] - graph.t[None]).argmin(axis=0)]
        i = len(graph) // 2
        c, s = np.cos(pose[i, 2]), np.sin(pose[i, 2])
        points = pose[i, :2] + graph.points[graph.rows(i)] @ np.array([[c, s], [-s, c]])
        assert (points > low).all()
        assert (points < high).all()
        cells = np.floor((points - grid.origin) / grid.resolution).astype(int)
        assert np.mean([tuple(c) in taken for c in cells.tolist()]) > 0.97


def test_the_pose_graph_holds_all_keyframes_and_closures_tell_of_both_robots(woven):
    result, out = woven
    graphs = [read_robot_graph(out / "local" / f"robot{k}" / "robot_graph.npz") for k in (1, 2)]
    held = read_g2o_file(out / "pose_graph.g2o")
    assert len(held.graph) == sum(map(len, graphs))
    assert held.fixed == (0,)
    assert (out / "pose_graph.g2o").read_text().splitlines()[-1].startswith("FIX")
    n = len(graphs[0])
    between = (held.graph.first < n) & (held.graph.second >= n)
    table = read_table(out / "closures.csv")
    ties = [k for k in range(len(table)) if table.columns["robot_a"][k] != table.columns["robot_b"][k]]
    believed = [k for k in ties if table.columns["accepted"][k] == "1"]
    assert between.sum() >= len(believed) >= 4
    stamps = table.numbers("stamp_b")[ties]
    assert np.isin(np.round(stamps, 6), np.round(graphs[1].t, 6)).all()
    assert len(ties) == len(result.merges[0].closures)


def test_trajectories_carry_covariances_that_grow_from_the_first_pose(woven):
    result, out = woven
    (made,) = result.components
    for k in "12":
        P = made.tracks[k].cov
        assert (np.linalg.eigvalsh(P)[:, 0] > 0).all()
        rows = (out / "trajectories" / f"robot{k}.cov.csv").read_text().splitlines()
        assert len(rows) == len(made.tracks[k].t) + 1
    assert np.trace(made.tracks["2"].cov[0]) > 2.0 * np.trace(made.tracks["1"].cov[0])


def test_a_robot_is_followed_through_the_parts_of_the_map_that_two_robots_saw(woven, team, tmp_path):
    result, out = woven
    log, _ = office(3)
    n = len(log.scans)
    begin = int(0.3 * n)
    third = cut(log, begin, int(0.75 * n), "3")
    write_mcap(tmp_path / "third.mcap", third)
    track = result.components[0].tracks["1"]
    start = track.pose[np.searchsorted(track.t, log.scan_t[begin])]
    found = mapweave.localize(tmp_path / "third.mcap", out, start=start.tolist())
    second = result.components[0].tracks["2"]
    at = np.searchsorted(second.t, third.scan_t[-1] + HOUR - 1e-6)
    assert found.metrics["localisation"]["trusted"]
    assert np.hypot(*(found.localisation.track.pose[-1] - second.pose[at])[:2]) < 0.3


@pytest.mark.slow
def test_robots_that_are_not_to_be_merged_stand_each_in_a_component(team, office_truth, tmp_path):
    logs, _ = team
    out, apart = tmp_path / "out", LaserOptions(no_merge=True, no_loops=True)
    alone = mapweave.map(logs, out, truth=office_truth, laser=apart, share={"1": 0.3, "2": 0.3})
    scores = json.loads((out / "metrics.json").read_text())["evaluation"]["robots"]
    assert [scores[k]["component"] for k in "12"] == [1, 2]
    assert max(scores[k]["ate"] for k in "12") < 0.25
    assert alone.metrics["components"] == [["1"], ["2"]]
    assert alone.metrics["fusion"] == []
    for part, k in ((out, 1), (out / "components" / "2", 2)):
        own = out / "local" / f"robot{k}"
        assert (part / "grid.npz").read_bytes() == (own / "grid.npz").read_bytes()
        assert [p.name for p in sorted((part / "trajectories").glob("*.tum"))] == [f"robot{k}.tum"]
        assert (part / "map.pgm").is_file()
        assert len(read_g2o(part / "pose_graph.g2o")) > 3


@pytest.mark.slow
def test_two_places_that_fit_are_refused_and_a_start_decides(tmp_path):
    log, truth = office(2)
    n = len(log.scans)
    logs = [cut(log, 0, int(0.62 * n)), cut(log, int(0.38 * n), n, "2")]
    refused = mapweave.map(logs)
    assert refused.metrics["components"] == [["1"], ["2"]]
    row = refused.metrics["fusion"][0]
    assert row["decision"] == "refused"
    assert row["reason"]
    words = f"robot1 and robot2: not merged: {row['reason']}; wrong with a probability of"
    assert f"{words} {100 * row['probability_wrong']:.2g} %" in refused.lines()
    start = se2.between(part_of(truth, logs[0]).pose[0], part_of(truth, logs[1]).pose[0])
    told = mapweave.map(logs, start={"2": (*start.tolist(), 0.5)})
    assert told.metrics["components"] == [["1", "2"]]
    first = told.components[0].tracks["2"].pose[0]
    assert np.hypot(*(first - start)[:2]) < 0.3


@pytest.mark.slow
def test_a_wrong_start_is_overruled_by_the_scans_and_that_is_told(team, woven):
    logs, _ = team
    right = woven[0].merges[0].transform
    wrong = (float(right[0]) + 6.0, float(right[1]), float(right[2]) + 1.5, 0.3)
    told = mapweave.map(logs, start={"2": wrong})
    (row,) = told.metrics["fusion"]
    assert row["decision"] == "merged"
    assert "the scans overrule the start that was given, by 6.0" in row["reason"]
    assert np.allclose(row["transform"], right, atol=0.05)


def test_a_start_of_nobody_and_one_that_is_no_pose_are_refused(team):
    logs, _ = team
    with pytest.raises(UsageError, match="there is no robot7; there are robot1, robot2"):
        mapweave.map(logs, start={"7": (0.0, 0.0, 0.0)}, share={"1": 0.1, "2": 0.1})
    with pytest.raises(UsageError, match="expected x, y, theta or x, y, theta, sigma, found 2"):
        mapweave.map(logs, start={"2": (0.0, 0.0)})
    with pytest.raises(UsageError, match="expected a sigma above 0 m, found 0"):
        mapweave.map(logs, start={"2": (0.0, 0.0, 0.0, 0.0)})
    assert parse_starts(["robot2=1,2,0.5,0.3", "3=0,0,1"]) == {"2": (1.0, 2.0, 0.5, 0.3), "3": (0.0, 0.0, 1.0)}
    with pytest.raises(UsageError, match="robot2=x,y,theta,sigma"):
        parse_starts(["robot2=1,2"])


def test_a_sigma_is_refused_for_landmark_logs(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.3, seed=1)
    with pytest.raises(UsageError, match="found a sigma too"):
        mapweave.map(tmp_path / "team", start={"2": (0.0, 0.0, 0.0, 1.0)})


def test_the_same_log_twice_is_refused_by_name(team):
    logs, _ = team
    with pytest.raises(DataError, match=r"robot1 \(part1.mcap\) and robot2 \(copy.mcap\) hold the same scans"):
        mapweave.map([logs[0], replace(logs[0], source="copy.mcap", log_hash="other")], share={"1": 0.2, "2": 0.2})


def test_a_robot_that_never_moves_stays_alone_and_says_so(team):
    logs, _ = team
    still = logs[1].scans[0]
    t = logs[1].scan_t[:6]
    log = replace(
        logs[1], source="parked.mcap", scan_t=t, scans=(still,) * 6, odometry=Track(t, np.tile(still.odometry, (6, 1)))
    )
    result = mapweave.map([logs[0], log], share={"1": 0.4})
    assert result.metrics["components"] == [["1"], ["2"]]
    assert any("hardly moved: 0.0 m" in w for w in result.metrics["robots"]["2"]["warnings"])
    assert not any("hardly moved" in w for w in result.metrics["robots"]["1"]["warnings"])
    assert result.metrics["fusion"][0]["decision"] == "refused"
    assert result.metrics["fusion"][0]["reason"]


def test_a_robot_that_saw_nothing_does_not_keep_the_others_from_their_map(team):
    logs, _ = team
    blind = tuple(replace(scan, hit=np.zeros_like(scan.hit)) for scan in logs[1].scans[:20])
    log = replace(logs[1], source="blind.mcap", scan_t=logs[1].scan_t[:20], scans=blind)
    result = mapweave.map([logs[0], log], share={"1": 0.2})
    assert result.metrics["components"] == [["1"], ["2"]]
    assert result.metrics["fusion"][0]["decision"] == "refused"
    assert all(np.isfinite(c.tracks[r].pose).all() for c in result.components for r in c.robots)


@pytest.mark.slow
def test_the_same_team_is_mapped_the_same_from_files_at_the_command_line(tmp_path, capsys):
    drives = [tmp_path / f"{name}.mcap" for name in "ab"]
    for k, drive in enumerate(drives, 1):
        words = ["--rooms", "1", "--visited", "2", "--seed", str(k), "--beams", "120"]
        assert _run(["simulate", "office", "--out", str(drive), *words]) == 0
    outs = [tmp_path / "one", tmp_path / "two"]
    for out, jobs in zip(outs, "12", strict=True):
        words = ["--feature", "none", "--share", "1:0.5,2:0.5", "--jobs", jobs]
        assert _run(["map", *map(str, drives), "--out", str(out), *words]) == 0
    told = capsys.readouterr().out
    assert "robot1 and robot2: not merged: " in told
    for name in ("trajectories/robot1.tum", "components/2/grid.npz", "state/robot2.npz", "closures.csv"):
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes(), name


@pytest.mark.slow
@pytest.mark.data
def test_the_intel_log_cut_in_three_is_one_map_as_exact_as_that_of_one_robot(data, tmp_path):
    """One robot's graph: 0.038 m on all relations, 0.020 m on those of exact stamps."""
    log = dark(read_laser(data / "carmen" / "intel.clf.gz"))
    n = len(log.scans)
    parts = [cut(log, k * n // 3, (k + 1) * n // 3, str(k + 1)) for k in range(3)]
    result = mapweave.map(parts, tmp_path / "out")
    assert result.metrics["components"] == [["1", "2", "3"]]
    score = mapweave.evaluate(tmp_path / "out", data / "carmen" / "intel.relations.gz")
    assert (score.robot, score.relations.used) == ("robot1, robot2, robot3", 2984)
    assert score.relations.trans_mean <= 1.2 * 0.038
    assert score.relations_exact.trans_mean <= 1.2 * 0.020
    walls = [_walls(result, k) for k in "123"]
    for a, b in ((0, 1), (0, 2)):
        near, _ = cKDTree(walls[a]).query(walls[b])
        assert np.median(near[near < 0.3]) < 0.05


@pytest.mark.long
@pytest.mark.data
def test_logs_of_different_buildings_are_not_merged_and_the_reasons_are_told(data):
    logs = [read_laser(data / name) for name in ("carmen/loop5.log.gz", "urg04lx/exp1.dat.gz", "carmen/intel.clf.gz")]
    result = mapweave.map([dark(log) for log in logs], share={"3": 0.3})
    assert result.metrics["components"] == [["1"], ["2"], ["3"]]
    rows = result.metrics["fusion"]
    assert [(row["a"], row["b"], row["decision"]) for row in rows] == [
        ("1", "2", "refused"),
        ("1", "3", "refused"),
        ("2", "3", "refused"),
    ]
    assert all("overlap" in row["reason"] or "corridor" in row["reason"] for row in rows)


def _walls(result, robot):
    """The returns of all keyframes of a robot where the map of the team puts them."""
    made = next(m for m in result.maps if m.robot == robot)
    track = result.components[0].tracks[robot]
    pose = track.pose[np.searchsorted(track.t, made.graph.t)]
    return np.concatenate([se2.act(p, made.graph.points[made.graph.rows(k)]) for k, p in enumerate(pose)])
