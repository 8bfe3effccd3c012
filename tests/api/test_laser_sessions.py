"""Laser results go on with further logs, and finished ones are fused: the same bytes as one run, or one clear error."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api import map_laser as map_laser_module
from mapweave.api.laser_result import write_laser_data
from mapweave.api.map_options import LaserOptions
from mapweave.cli import _run
from mapweave.core.errors import ConfigError, DataError, MapweaveError, ReaderError, UsageError
from mapweave.io.npz import read_arrays, write_arrays

from ..laser.team_logs import cut, office
from .test_laser_slam import fed, tables

pytestmark = pytest.mark.usefixtures("_remembered")


@pytest.fixture(scope="module")
def sessions(logs, office_map, tmp_path_factory):
    """One run of both logs; a run of the first and another that goes on with the second."""
    folder = tmp_path_factory.mktemp("sessions")
    (folder / "one").symlink_to(office_map[1])
    mapweave.map([logs[0]], folder / "first", method="graph")
    mapweave.map([logs[1]], folder / "both", laser=LaserOptions(resume=str(folder / "first")))
    return folder


def written(folder):
    """Every file; metrics without their times."""
    out = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    metrics = json.loads(out.pop("metrics.json"))
    return out, {**metrics, "timing": None}


def test_a_second_session_gives_the_bytes_of_one_run_of_both_logs(sessions):
    one, both = written(sessions / "one"), written(sessions / "both")
    assert one[1] == both[1]
    assert one[0].keys() == both[0].keys()
    assert [name for name in one[0] if one[0][name] != both[0][name]] == []
    assert one[1]["components"] == [["1", "2"]]


@pytest.mark.parametrize("by_hand", [True, False])
def test_what_was_decided_on_a_result_holds_where_it_goes_on(sessions, logs, tmp_path, by_hand):
    """Of what `edit` saved whole, and of a file beside which the map is as it was."""
    first = tmp_path / "first"
    shutil.copytree(sessions / "first", first)
    text = (first / "decisions.toml").read_text().replace('decision = "together"', 'decision = "apart"', 1)
    (first / "decisions.toml").write_text(text + MASK)
    if not by_hand:
        mapweave.map(logs[0], tmp_path / "edited", decisions=first / "decisions.toml")
        first = tmp_path / "edited"
    mapweave.map(logs[1], tmp_path / "both", laser=LaserOptions(resume=first))
    (tmp_path / "said.toml").write_text(text + MASK)
    one = mapweave.map(logs, tmp_path / "one", decisions=tmp_path / "said.toml")
    assert one.said is not None
    assert one.said.masks
    assert written(tmp_path / "one") == written(tmp_path / "both")


def test_what_was_decided_on_a_result_holds_where_it_is_fused(sessions, tmp_path):
    shutil.copytree(sessions / "first", tmp_path / "first")
    file = tmp_path / "first" / "decisions.toml"
    file.write_text(file.read_text().replace('decision = "together"', 'decision = "apart"', 1) + MASK)
    fused = mapweave.fuse([tmp_path / "first", sessions / "both"])  # the first robot of which is the same log
    assert fused.said is not None
    assert [mask.robot for mask in fused.said.masks] == ["first/robot1"]
    assert sum(row.edited for row in fused.said.places) == 1
    there = fused.maps[0].grid.to_numpy()
    assert (there == -1).sum() > (mapweave.load(sessions / "first").maps[0].grid.to_numpy() == -1).sum()


MASK = """
[[masks]]
robot = "1"
box = [-1.0, -1.0, 1.5, 1.5]
cells = "unknown"
"""


def test_a_robot_whose_log_has_become_longer_keeps_what_was_decided_on_it(logs, tmp_path):
    begun = cut(logs[0], 0, len(logs[0].scans) * 2 // 3)
    mapweave.map(begun, tmp_path / "begun")
    file = tmp_path / "begun" / "decisions.toml"
    file.write_text(file.read_text() + MASK)
    whole = mapweave.map(logs[0], tmp_path / "whole", laser=LaserOptions(resume=tmp_path / "begun"))
    assert whole.said is not None
    assert [mask.cells for mask in whole.said.masks] == ["unknown"]
    (tmp_path / "begun" / "result.npz").rename(tmp_path / "aside")  # a copy that is not whole loses nothing in silence
    assert "result.npz: no such file: the result is not whole" in refused(tmp_path / "begun", logs)
    file.unlink()
    assert "decisions.toml: no such file: the result is not whole" in refused(tmp_path / "begun", logs)
    with pytest.raises(ReaderError, match=r"decisions\.toml: no such file"):
        mapweave.LaserSlam(resume=tmp_path / "begun")
    shutil.rmtree(tmp_path / "begun" / "state")
    with pytest.raises(DataError, match="the result is not whole, copy all of it"):
        mapweave.map(logs[1], laser=LaserOptions(resume=tmp_path / "begun"))


def test_scans_that_come_one_by_one_go_on_from_a_saved_map_as_their_log_does(sessions, logs, tmp_path):
    slam = mapweave.LaserSlam(resume=sessions / "first")
    assert slam.robot == "2"
    fed(slam, logs[1]).save(tmp_path / "slam")
    scans, odometry = tables(logs[1])
    mapweave.map(scans=scans, odometry=odometry, out=tmp_path / "map", laser=LaserOptions(resume=sessions / "first"))
    for name in ("map.pgm", "closures.csv", "trajectories/robot1.tum", "trajectories/robot2.tum", "pose_graph.g2o"):
        assert (tmp_path / "slam" / name).read_bytes() == (tmp_path / "map" / name).read_bytes(), name
    assert mapweave.load(tmp_path / "slam").metrics["components"] == [["1", "2"]]
    with pytest.raises(DataError, match=r"are in .*first already, as robot1"):
        fed(mapweave.LaserSlam(resume=sessions / "first"), logs[0]).result()
    with pytest.raises(DataError, match=r"these scans go on as '2' there: expected robot='2'"):
        fed(mapweave.LaserSlam(robot="1", resume=sessions / "first"), cut(logs[1], 0, 5)).result()
    assert mapweave.LaserSlam(resume=sessions / "first" / "map.yaml").robot == "1"
    with pytest.raises(UsageError, match="resume: expected a path, found int"):
        mapweave.LaserSlam(resume=3)
    with pytest.raises(UsageError, match="resume: expected a path, found int"):
        mapweave.map([logs[1]], laser=LaserOptions(resume=3))
    with pytest.raises(ReaderError, match="nowhere"):
        mapweave.LaserSlam(resume=tmp_path / "nowhere")


def stopped_after(log, n):
    """The same recording while it was running: its first `n` scans."""
    early = cut(log, 0, n)
    pose = log.odometry.pose[: len(early.odometry.t)]
    return replace(early, scans=log.scans[:n], source=log.source, odometry=replace(early.odometry, pose=pose))


@pytest.mark.slow
def test_a_log_that_was_cut_goes_on_as_the_same_robot_with_the_bytes_of_one_run(logs, sessions, tmp_path):
    n = int(np.random.default_rng(7).integers(20, len(logs[0].scans) - 5))
    mapweave.map([stopped_after(logs[0], n), logs[1]], tmp_path / "stopped")
    result = mapweave.map([logs[0]], tmp_path / "on", laser=LaserOptions(resume=tmp_path / "stopped"))
    assert f"robot1: its log goes on, from scan {n + 1} to {len(logs[0].scans)}" in result.lines()
    one, on = written(sessions / "one"), written(tmp_path / "on")
    assert one[1] == on[1]
    differing = [name for name in one[0] if one[0][name] != on[0].get(name)]
    assert differing == ["report.html", "result.npz"], "which say that a log goes on"


@pytest.mark.slow
def test_ten_random_stops_give_the_bytes_of_one_run(tmp_path):
    """Stopped anywhere, the second recording not begun, under way, or with a scan or two."""
    log, _ = office(5, rooms=1, visited=1)
    n = len(log.scans)
    logs = cut(log, 0, int(0.7 * n)), cut(log, int(0.3 * n), n, "2")
    whole = data_of(mapweave.map(list(logs), seed=2), tmp_path / "whole")
    assert {"state/state.json", "trajectories/robot1.tum"} <= whole.keys()
    rng = np.random.default_rng(11)
    for k in range(10):
        stop = int(rng.integers(2, len(logs[0].scans) + len(logs[1].scans) - 2))
        early = [stopped_after(logs[0], min(stop, len(logs[0].scans)))]
        if (later := stop - len(logs[0].scans)) > 1:
            early.append(stopped_after(logs[1], later))
        before, after = tmp_path / f"before{k}", tmp_path / f"after{k}"
        data_of(mapweave.map(early, seed=2, method="graph"), before)
        rest = [log for log, held in zip(logs, [*early, None], strict=False) if held is None or held.scans != log.scans]
        on = data_of(mapweave.map(rest, laser=LaserOptions(resume=before), seed=2), after)
        assert [name for name in whole if whole[name] != on.get(name)] == [], stop
        assert whole.keys() == on.keys()


def data_of(result, folder):
    """The files that hold what was found, less the metrics, which tell times; pictures and page follow from them."""
    folder.mkdir()
    write_laser_data(folder, result)
    files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert files.pop("metrics.json")
    return files


def test_the_log_that_is_there_already_is_refused(logs, sessions):
    with pytest.raises(DataError, match=r"these scans are in .*first already, as robot1"):
        mapweave.map([replace(logs[0], source="again.mcap")], laser=LaserOptions(resume=sessions / "first"))


@pytest.mark.slow
def test_a_start_told_in_the_first_session_holds_in_the_second(logs, sessions, tmp_path):
    start = {"1": (1.0, 2.0, 0.5)}
    mapweave.map([logs[0]], tmp_path / "first", method="graph", start=start)
    made = mapweave.map([logs[1]], laser=LaserOptions(resume=tmp_path / "first", no_merge=True))
    assert made.starts == start


def spoiled(sessions, tmp_path):
    return shutil.copytree(sessions / "both", tmp_path / "spoiled")


def refused(folder, logs):
    with pytest.raises(MapweaveError) as told:
        mapweave.map([logs[1]], laser=LaserOptions(resume=folder))
    return str(told.value)


def test_a_result_of_another_version_is_refused(sessions, logs, tmp_path):
    folder = spoiled(sessions, tmp_path)
    index = folder / "state" / "state.json"
    index.write_text(json.dumps({**json.loads(index.read_text()), "state": 99, "version": "7.0"}))
    assert "expected state of version 3, found 99, which mapweave 7.0 wrote" in refused(folder, logs)


@pytest.mark.slow
def test_a_result_of_landmarks_one_without_graphs_and_no_result_are_refused(logs, tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.3, seed=1)
    mapweave.map(tmp_path / "team", tmp_path / "landmarks")
    assert "expected a result of laser logs, found one of landmarks" in refused(tmp_path / "landmarks", logs)
    mapweave.map([logs[0]], tmp_path / "gated", method="gated", share={"1": 0.2})
    assert "keeps no graph of keyframes: map its logs again with --method graph" in refused(tmp_path / "gated", logs)
    assert "no such folder" in refused(tmp_path / "nowhere", logs)
    (tmp_path / "empty").mkdir()
    assert "found no metrics.json" in refused(tmp_path / "empty", logs)


@pytest.mark.parametrize("name", ["state/state.json", "state/robot1.npz", "local/robot2/robot_graph.npz"])
@pytest.mark.parametrize("how", ["cut", "gone", "other"])
def test_a_damaged_result_is_refused_by_the_file_that_is_damaged(sessions, logs, tmp_path, name, how):
    folder = spoiled(sessions, tmp_path)
    path = folder / name
    if how == "cut":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif how == "gone":
        path.unlink()
    else:
        path.write_bytes(
            (folder / "grid.npz").read_bytes() if path.suffix == ".npz" else b'{"state": 3, "robots": [3]}'
        )
    told = refused(folder, logs)
    assert path.name in told or (how == "gone" and name == "state/state.json")
    assert "\n" not in told


def test_the_states_of_two_robots_exchanged_are_found_out(sessions, logs, tmp_path):
    folder = spoiled(sessions, tmp_path)
    a, b = (folder / "state" / f"robot{k}.npz" for k in (1, 2))
    held = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(held)
    assert "robot1.npz: it is not the file that state.json tells of" in refused(folder, logs)
    index = folder / "state" / "state.json"
    told = json.loads(index.read_text())
    files = told["files"]
    one, other = (f"state/robot{k}.npz" for k in (1, 2))
    files[one], files[other] = files[other], files[one]
    index.write_text(json.dumps(told))
    assert "expected the state of robot 1, found that of 2" in refused(folder, logs)


@pytest.mark.parametrize("name", ["local/robot1/grid.npz", "local/robot2/robot_graph.npz", "state/robot2.npz"])
def test_a_whole_file_that_is_of_another_result_is_found_out_by_its_hash(sessions, logs, tmp_path, name):
    folder = spoiled(sessions, tmp_path)
    arrays = read_arrays(folder / name, "a file of the result")
    mapped = {k: v + 1.0 if k in {"t", "origin", "pose"} else v for k, v in arrays.items()}
    write_arrays(folder / name, mapped, gaps=arrays)
    assert f"{name.split('/')[-1]}: it is not the file that state.json tells of" in refused(folder, logs)


def test_robots_that_are_there_are_not_mapped_again(sessions, logs, tmp_path, monkeypatch):
    mapped = []
    real = map_laser_module.map_laser

    def counted(log, *rest):
        mapped.append(log.robot)
        return real(log, *rest)

    monkeypatch.setattr(map_laser_module, "map_laser", counted)
    mapweave.map([logs[1]], laser=LaserOptions(resume=sessions / "first", no_merge=True), share={"2": 0.2})
    assert mapped == ["2"]


def test_only_the_graph_method_goes_on(sessions, logs):
    with pytest.raises(UsageError, match="--resume: goes on with --method graph, found particle"):
        mapweave.map([logs[1]], method="particle", laser=LaserOptions(resume=sessions / "first"))


@pytest.mark.slow
def test_finished_results_are_fused_by_the_same_decision_as_one_run(sessions, logs, tmp_path):
    mapweave.map([logs[1]], tmp_path / "second", method="graph")
    fused = mapweave.fuse([sessions / "first", tmp_path / "second"], tmp_path / "fused")
    assert fused.metrics["components"] == [["first/robot1", "second/robot1"]]
    one = json.loads((sessions / "one" / "metrics.json").read_text())["fusion"][0]
    row = fused.metrics["fusion"][0]
    assert (row["agreeing"], row["decision"]) == (one["agreeing"], one["decision"])
    assert np.allclose(row["transform"], one["transform"], atol=1e-9)
    assert (tmp_path / "fused" / "trajectories" / "second" / "robot1.tum").is_file()
    assert (tmp_path / "fused" / "grid.npz").read_bytes() == (sessions / "one" / "grid.npz").read_bytes()
    again = mapweave.fuse([tmp_path / "fused", sessions / "first"])
    same, shared = (f for f in again.metrics["findings"] if f["code"] in {"log-twice", "logs-alike"})
    assert (same["robot"], same["value"]) == ("first/robot1", "fused/first/robot1")
    assert (shared["robot"], shared["value"]["other"]) == ("fused/second/robot1", "fused/first/robot1")  # logs overlap
    assert again.metrics["components"] == [["fused/first/robot1", "fused/second/robot1"]]


@pytest.mark.slow
def test_what_it_takes_to_merge_is_a_setting(sessions, tmp_path):
    (tmp_path / "hard.toml").write_text("[laser.merge]\nsure = 0.9999\n")
    fused = mapweave.fuse(sessions / "both", config=tmp_path / "hard.toml")
    assert fused.metrics["components"] == [["both/robot1"], ["both/robot2"]]
    row = fused.metrics["fusion"][0]
    assert row["reason"].startswith("too little overlap")
    assert row["probability_wrong"] > 0.9  # it is refused although it is hardly in doubt
    (tmp_path / "wrong.toml").write_text("[laser.merge]\nvotings = 3\n")
    with pytest.raises(ConfigError, match=r"laser.merge.votings: unknown key"):
        mapweave.fuse(sessions / "both", config=tmp_path / "wrong.toml")


def test_laser_results_are_not_fused_with_landmarks_nor_with_options_of_theirs(sessions, tmp_path, capsys):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.3, seed=1)
    mapweave.map(tmp_path / "team", tmp_path / "landmarks")
    words = ["fuse", str(sessions / "first"), str(tmp_path / "landmarks"), "--out", str(tmp_path / "out")]
    assert _run(words) == 1
    err = capsys.readouterr().err
    assert "only results of one kind are fused" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    with pytest.raises(UsageError, match="--weights: only for landmark results"):
        mapweave.fuse([sessions / "first", sessions / "both"], weights="full")
    with pytest.raises(ReaderError, match="no such file or folder"):
        mapweave.fuse([sessions / "first", tmp_path / "nowhere"])
