"""Results, truths and graphs in memory do what their files do, with the same numbers; anything else is refused."""

import inspect
import json
import tempfile
from pathlib import Path
from types import NoneType
from typing import get_args

import numpy as np
import pytest

import mapweave
from mapweave.io.g2o import read_g2o_file
from mapweave.io.tum import read_tum, write_tum

from .frames import Frame


def told(result):
    """The metrics but for what a run took."""
    return {name: value for name, value in result.metrics.items() if name != "timing"}


def files(folder):
    """Every file's bytes, but for pages, pictures and what a run took."""
    kept = {p for p in folder.rglob("*") if p.is_file() and p.suffix not in {".html", ".png"}}
    out = {p.relative_to(folder).as_posix(): p.read_bytes() for p in kept if p.name != "metrics.json"}
    return out | {
        "metrics": {k: v for k, v in json.loads((folder / "metrics.json").read_text()).items() if k != "timing"}
    }


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    """A team's log, its robots mapped in two runs, and the folders `result1` and `result2` they wrote."""
    home = tmp_path_factory.mktemp("team")
    made = mapweave.simulate_landmarks(home / "team", robots=2, landmarks=12, minutes=1.0, seed=8)
    return home, made, [mapweave.map(home / "team", home / f"result{k}", robots=[k]) for k in (1, 2)]


def survey_of(made):
    x, y = zip(*made.landmarks.values(), strict=True)
    return {"id": list(made.landmarks), "x": x, "y": y}


def test_results_in_memory_are_fused_to_the_same_bytes_as_their_folders(team, tmp_path):
    home, _, results = team
    mapweave.fuse([home / "result1", home / "result2"], tmp_path / "folders")
    mapweave.fuse(results, tmp_path / "memory")
    assert len(files(tmp_path / "memory")) > 10
    assert files(tmp_path / "memory") == files(tmp_path / "folders")
    mapweave.fuse([results[0], home / "result2"], tmp_path / "both")
    assert files(tmp_path / "both") == files(tmp_path / "folders")


def test_a_result_given_twice_counts_once_and_one_named_as_a_folder_is_told_from_it(team, tmp_path):
    home, _, (one, two) = team
    twice = mapweave.fuse([one, one])
    assert twice.maps[0].robots == ("result1/robot1",)
    assert any("same log" in warning for warning in twice.warnings)
    (tmp_path / "x").mkdir()
    mixed = mapweave.fuse([two, home / "result1"])
    assert [m.robot for m in mixed.local] == ["in memory/result1/robot2", f"{home.name}/result1/robot1"]


def test_a_map_that_grew_sighting_by_sighting_is_fused_as_it_is(team):
    slam = mapweave.LandmarkSlam(robot="2")
    for k in range(40):
        slam.add_odometry(0.1 * k, 0.5, 0.0)
        for name, x, y in (("1", 3.0, 1.0), ("2", 2.0, -1.0), ("3", 5.0, 0.5)):
            slam.add_sighting(0.1 * k, name, float(np.hypot(x - 0.05 * k, y)), float(np.arctan2(y, x - 0.05 * k)))
    fused = mapweave.fuse([slam.result(), team[2][0]])
    assert [m.robot for m in fused.local] == ["result1/robot2", "result2/robot1"]
    with pytest.raises(mapweave.UsageError, match="found LandmarkSlam, whose result"):
        mapweave.fuse([slam])


def test_a_result_in_memory_is_scored_against_tables_as_its_folder_against_files(team):
    home, made, (one, _) = team
    there = mapweave.evaluate(home / "result1", home / "team")
    assert mapweave.evaluate(one, home / "team").as_json() == there.as_json()
    rows = [f"{name},{x!r},{y!r}" for name, (x, y) in made.landmarks.items()]
    (home / "survey.csv").write_text("\n".join(["id,x,y", *rows]), encoding="utf-8")
    score = mapweave.evaluate(home / "result1", home / "survey.csv").as_json()
    for survey in (survey_of(made), Frame(survey_of(made)), [survey_of(made)]):
        assert mapweave.evaluate(home / "result1", survey).as_json() == score
        assert mapweave.evaluate(one, survey).as_json() == score
    assert mapweave.map(home / "team", robots=[1], truth=survey_of(made)).metrics["evaluation"] == score
    assert mapweave.fuse(one, truth=survey_of(made)).metrics["evaluation"]["landmark_rmse"] is not None
    assert score["landmark_rmse"] < 1.0


def test_true_trajectories_in_memory_are_those_of_tum_files(team):
    home, made, (one, _) = team
    true = next(robot.truth for robot in made.robots if robot.number == 1)
    track = mapweave.Track(true[:, 0], true[:, 1:])
    write_tum(home / "robot1.tum", track)
    track = read_tum(home / "robot1.tum")
    score = mapweave.evaluate(home / "result1", home / "robot1.tum").as_json()
    x, y, theta = track.pose.T
    table = {"t": track.t, "x": x, "y": y, "theta": theta}
    given = (track, table, {**table, "robot": ["1"] * len(x)}, {**table, "robot": ["robot1"] * len(x)})
    for truth in given:
        found = mapweave.evaluate(one, truth).as_json()
        own = found["robots"].pop("1")
        for name, value in score["robots"]["1"].items():  # headings become quaternions, and again angles
            assert own[name] == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value)
        assert own["ate"] == score["robots"]["1"]["ate"]
        assert found == {**score, "robots": {}}
    assert score["robots"]["1"]["ate"] < 1.0
    both = mapweave.evaluate(one, [survey_of(made), track]).as_json()
    assert both["landmark_n"] > 3
    assert both["robots"]["1"]["n"] == score["robots"]["1"]["n"]


def test_a_mistake_in_a_truth_in_memory_names_the_argument_and_the_row(team):
    _, made, (one, _) = team
    survey = survey_of(made)
    with pytest.raises(mapweave.ReaderError, match=r"^truth:2: expected a finite x, found nan"):
        mapweave.evaluate(one, {**survey, "x": [0.0, np.nan, *survey["x"][2:]]})
    with pytest.raises(mapweave.ReaderError, match=r"^truth: expected the columns id,x,y or t,x,y,theta.*found id"):
        mapweave.evaluate(one, {"id": ["1"]})
    with pytest.raises(mapweave.ReaderError, match="expected a robot's number, as 2 or robot2, found 'anna'"):
        mapweave.evaluate(one, {"t": [0.0], "x": [0.0], "y": [0.0], "theta": [0.0], "robot": ["anna"]})
    with pytest.raises(mapweave.DataError, match=r"^truth: nothing to score") as error:
        mapweave.evaluate(one, {"id": ["nobody"], "x": [0.0], "y": [0.0]})
    assert tempfile.gettempdir() not in str(error.value)
    with pytest.raises(mapweave.ReaderError, match=r"^map \(TeamResult\): expected a laser map with grid.npz"):
        mapweave.localize(mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=2.0)).log, one)


@pytest.fixture(scope="module")
def swarm(tmp_path_factory):
    home = tmp_path_factory.mktemp("swarm")
    made = mapweave.simulate_swarm(home / "swarm.csv", mapweave.SwarmScene(robots=9), seed=3)
    known = {made.table.ids[c]: made.position[0, c] for c in made.corners}
    x, y = np.array(read_places(home / "swarm.truth.csv"), dtype=float).T
    return home, known, {"id": list(made.table.ids), "x": x, "y": y}


def read_places(path):
    return [line.split(",")[1:3] for line in path.read_text(encoding="utf-8").splitlines()[1:]]


def test_a_swarm_is_scored_against_true_places_in_memory_as_against_their_file(swarm, tmp_path):
    home, known, truth = swarm
    there = mapweave.locate(home / "swarm.csv", tmp_path / "out", anchors=known, truth=home / "swarm.truth.csv")
    here = mapweave.locate(home / "swarm.csv", anchors=known, truth=truth)
    assert told(here) == told(there)
    assert told(here)["rmse"] > 0
    for method in ("batch", "iekf"):
        begun = [
            mapweave.locate(home / "swarm.csv", anchors=known, method=method, initial=start).estimate.position.tobytes()
            for start in (home / "swarm.truth.csv", truth)
        ]
        assert begun[0] == begun[1]
    score = mapweave.evaluate(tmp_path / "out", home / "swarm.truth.csv").as_json()
    assert mapweave.evaluate(tmp_path / "out", truth).as_json() == score
    assert mapweave.evaluate(there, truth).as_json() == score
    assert mapweave.evaluate(here, home / "swarm.truth.csv").as_json() == score
    with pytest.raises(mapweave.DataError, match=r"^truth: the truth names none of the robots"):
        mapweave.locate(home / "swarm.csv", truth={"id": ["x"], "x": [0.0], "y": [0.0]})
    with pytest.raises(
        mapweave.DataError, match=r"^truth: the truth names none of the robots of directory \(Located\)"
    ):
        mapweave.evaluate(there, {"id": ["x"], "x": [0.0], "y": [0.0]})


def test_a_moving_swarm_in_memory_is_scored_as_its_folder(tmp_path):
    made = mapweave.simulate_swarm(tmp_path / "swarm.csv", mapweave.SwarmScene(robots=9, steps=4), seed=2)
    known = {made.table.ids[c]: made.position[0, c] for c in made.corners}
    found = mapweave.locate(tmp_path / "swarm.csv", tmp_path / "out", anchors=known)
    rows = [line.split(",") for line in (tmp_path / "swarm.truth.csv").read_text().splitlines()]
    truth = dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True))
    score = mapweave.evaluate(tmp_path / "out", tmp_path / "swarm.truth.csv").as_json()
    assert isinstance(found, mapweave.Moved)
    assert mapweave.evaluate(found, truth).as_json() == score
    assert score["rmse"] is not None


def test_a_laser_result_in_memory_is_scored_and_followed_as_its_folder(tmp_path):
    drive = mapweave.simulate_laser(tmp_path / "drive.mcap", mapweave.CorridorConfig(distance=8.0), seed=1)
    made = mapweave.map(drive.log, tmp_path / "out", method="gated")
    tum = tmp_path / "drive.truth.tum"
    score = mapweave.evaluate(tmp_path / "out", tum).as_json()
    assert mapweave.evaluate(made, tum).as_json() == score
    assert mapweave.evaluate(made, read_tum(tum)).as_json() == score
    assert mapweave.map(drive.log, method="gated", truth=drive.truth).metrics["evaluation"]["robots"]["1"]["ate"] < 1.0
    t = made.maps[0].track.t[[0, -1]]
    there = ["0", "0", "0", "0", "0", "0", "0", "0"]
    (tmp_path / "t.relations").write_text(" ".join([repr(float(t[0])), repr(float(t[1])), *there[2:5], "0", "0", "0"]))
    relation = {"t1": t[:1], "t2": t[1:], "x": [0.0], "y": [0.0], "theta": [0.0]}
    score = mapweave.evaluate(tmp_path / "out", tmp_path / "t.relations").as_json()
    assert mapweave.evaluate(made, relation).as_json() == score
    assert score["relations"]["used"] == 1
    found = mapweave.localize(drive.log, made, start=(0.0, 0.0, 0.0), truth=read_tum(tum))
    assert (
        told(found)["evaluation"]
        == told(mapweave.localize(drive.log, made, start=(0.0, 0.0, 0.0), truth=tum))["evaluation"]
    )


@pytest.mark.slow
def test_laser_results_in_memory_are_fused_to_the_same_bytes_as_their_folders(tmp_path):
    drives = [mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=14.0), seed=k) for k in (1, 2)]
    results = [mapweave.map(drive.log, tmp_path / f"result{k}", method="graph") for k, drive in enumerate(drives, 1)]
    mapweave.fuse([tmp_path / "result1", tmp_path / "result2"], tmp_path / "folders")
    mapweave.fuse(results, tmp_path / "memory")
    assert files(tmp_path / "memory") == files(tmp_path / "folders")


def test_the_report_of_a_result_in_memory_is_written_where_a_browser_finds_it(team, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (line,) = mapweave.view(team[2][0], browser=False)
    page = Path(line.removeprefix("report: "))
    assert page.is_relative_to(tmp_path)
    assert "<html" in page.read_text(encoding="utf-8")[:200].lower()
    with pytest.raises(mapweave.UsageError, match="expected a folder or a result in memory, found int"):
        mapweave.view(3)


def loop(n=6):
    """A ring of poses with a closure, as columns."""
    ends = np.arange(n)
    x, y = np.full(n, 1.0), np.linspace(0.0, 0.05, n)
    columns = {"from": ends, "to": (ends + 1) % n, "x": x, "y": y, "theta": np.full(n, 2 * np.pi / n)}
    spread = np.eye(3) + 0.1
    return {**columns, "information": np.array([spread * (k + 1) for k in range(n)]) * 100.0}


def written(path, edges, poses=()):
    upper = np.triu_indices(3)
    rows = [f"VERTEX_SE2 {k} {x!r} {y!r} {a!r}" for k, (x, y, a) in enumerate(poses)]
    for k in range(len(edges["x"])):
        numbers = [float(edges[name][k]) for name in ("x", "y", "theta")] + edges["information"][k][upper].tolist()
        rows.append(f"EDGE_SE2 {edges['from'][k]} {edges['to'][k]} {' '.join(map(repr, numbers))}")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_a_pose_graph_in_memory_is_solved_to_the_same_bytes_as_its_file(tmp_path):
    edges = loop()
    poses = np.cumsum(np.column_stack([edges["x"], edges["y"], edges["theta"]]), axis=0).tolist()
    columns = dict(zip(("x", "y", "theta"), zip(*poses, strict=True), strict=True))
    for start in ((), poses):
        path = written(tmp_path / "loop.g2o", edges, start)
        there = mapweave.solve_pose_graph(path)
        given = [{"edges": edges, **({"poses": start} if start else {})}]
        if start:
            given += [read_g2o_file(path).graph, {"edges": Frame(edges), "poses": {"id": range(len(poses)), **columns}}]
        for graph in given:
            here = mapweave.solve_pose_graph(graph, tmp_path / "out")
            assert here.solved.graph.pose.tobytes() == there.solved.graph.pose.tobytes()
            assert here.covariance.tobytes() == there.covariance.tobytes()
            assert told(here) == {**told(there), "source": "in memory"}
    assert (tmp_path / "out" / "report.html").is_file()
    held = mapweave.solve_pose_graph({"edges": edges, "poses": poses, "fixed": [2]})
    assert held.metrics["fixed"] == [2]
    np.testing.assert_array_equal(held.solved.graph.pose[2], poses[2])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"to": None}, "file, edges: expected a column to"),
        ({"information": None}, "file, edges: expected information"),
        (
            {"information": np.zeros((6, 3, 3))},
            r"file, edges:1: expected a positive definite information of EDGE_SE2 0 1",
        ),
        ({"information": np.zeros((5, 3, 3))}, "expected finite information of 6 by 3 by 3, found"),
        ({"to": [1, 2, 3, 3, 5, 0]}, "file, edges:4: expected an edge between two poses, found one from 3 to itself"),
        ({"from": [0, 1, 2, 3, 4, -5]}, "file, edges:6: expected an id from 0 on for from, found -5"),
        ({"x": [0, 1, 2, np.inf, 4, 5]}, "file, edges:4: expected a finite x, found inf"),
    ],
)
def test_a_mistake_in_a_pose_graph_in_memory_is_named(change, said):
    edges = {name: column for name, column in {**loop(), **change}.items() if column is not None}
    with pytest.raises(mapweave.MapweaveError, match=said):
        mapweave.solve_pose_graph({"edges": edges})


def test_an_entry_of_a_pose_graph_that_nobody_knows_is_refused():
    with pytest.raises(
        mapweave.UsageError, match="expected a pose graph of edges, and poses and fixed where known, found edge"
    ):
        mapweave.solve_pose_graph({"edge": loop()})
    with pytest.raises(mapweave.UsageError, match="file, poses: expected id, x, y, theta by name or finite rows"):
        mapweave.solve_pose_graph({"edges": loop(), "poses": 3})
    with pytest.raises(mapweave.ReaderError, match="there is no vertex 5"):
        mapweave.solve_pose_graph({"edges": loop(), "poses": np.zeros((5, 3))})


TABLE = {"observer": ["a", "b"], "target": ["b", "a"], "bearing": [0.0, 3.14159], "t": [0.0, 1.0]}
BASE = {
    # what each verb cannot do without; never used, since what is wrong is refused first
    "compare": {"before": "nowhere", "after": "nowhere"},
    "edit": {"directory": "nowhere"},
    "evaluate": {"directory": "nowhere", "truth": "nothing"},
    "fuse": {"directories": "nowhere"},
    "live_keys": {"out": "keys", "robots": ["r1"]},
    "live_map": {"out": "out"},
    "live_robot": {"name": "r1", "source": "nowhere"},
    "live_robots": {"names": ["r1"]},
    "localize": {"log": "nowhere", "map": "nowhere"},
    "locate": {"sightings": TABLE},
    "map": {"logs": "nowhere"},
    "read": {"logs": "nowhere"},
    "solve_pose_graph": {"file": "nowhere"},
    "view": {"directory": "nowhere"},
}
TABLES = {"scans", "odometry", "sightings"}  # of `map`, whose `logs` are left out beside them
BAD = (None, 3, object(), {"a": [1]}, Frame({"a": [1]}), "generator", b"bytes", [3], [None])
VERBS = {n: v for n in mapweave.__all__ if inspect.isfunction(v := getattr(mapweave, n))}


def kinds(annotation):
    return [annotation, *(inner for arg in get_args(annotation) for inner in kinds(arg))]


def takes_paths_or_tables():
    for name, verb in VERBS.items():
        for parameter in inspect.signature(verb).parameters.values():
            inside = kinds(parameter.annotation)
            if Path in inside or "Framed" in str(parameter.annotation):
                yield name, parameter.name


@pytest.mark.parametrize(("name", "argument"), sorted(takes_paths_or_tables()))
def test_what_an_argument_cannot_be_is_refused_by_its_name_and_never_by_a_type_error(
    name, argument, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    verb = VERBS[name]
    parameter = inspect.signature(verb).parameters[argument]
    for bad in BAD:
        if bad is None and (NoneType in kinds(parameter.annotation) or parameter.default == ()):
            continue
        if argument == "config" and isinstance(bad, dict):
            continue  # tables: what is in them is looked at when it is known which settings the log takes
        given = {**BASE.get(name, {}), argument: (x for x in [3]) if isinstance(bad, str) else bad}
        if argument == "initial":  # only of robots that stand still
            given["sightings"] = {column: TABLE[column] for column in ("observer", "target", "bearing")}
        if name == "map" and argument in TABLES:
            given = {
                "sightings": {"t": [0.0], "robot": [1], "id": [1], "range": [1.0], "bearing": [0.0]},
                argument: given[argument],
            }
            if argument == "scans":
                del given["sightings"]
        with pytest.raises(mapweave.MapweaveError) as error:
            verb(**given)
        said = str(error.value)
        columns = isinstance(bad, dict | Frame)
        if columns and name == "localize" and argument != "truth":
            assert said == "nowhere: no such file or folder" or argument in said
            continue  # a table of scans or of odometry may be: what is in it is looked at when the map is there
        assert argument in said, (bad, said)
        assert "expected" in said, (bad, said)
        assert columns or isinstance(error.value, mapweave.UsageError), (bad, said)
    assert list(tmp_path.iterdir()) == []
