"""`mapweave solve`: files in, one folder out, and what is told."""

import csv
import json

import numpy as np
import pytest

import mapweave
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.g2o import read_g2o, read_g2o_file
from mapweave.io.tum import read_tum

pytestmark = pytest.mark.drawn

INFORMATION = "400 0 0 400 0 2500"


def ring(path, *, false=0, vertices=True, extra=""):
    """Two rounds of a square of side 4, 32 poses, with closures between the rounds and `false` ones."""
    truth = np.array([se2.pose(0, 0, 0)])
    for k in range(31):
        step = np.array([1.0, 0.0, np.pi / 2 if k % 4 == 3 else 0.0])
        truth = np.concatenate([truth, se2.compose(truth[-1], step)[None]])
    rng = np.random.default_rng(3)
    rows = [f"VERTEX_SE2 {10 + k} {x} {y} {a}" for k, (x, y, a) in enumerate(truth.tolist())] if vertices else []
    pairs = [(k, k + 1) for k in range(31)] + [(k, k + 16) for k in range(0, 16, 2)]
    for i, j in pairs:
        x, y, a = se2.compose(se2.between(truth[i], truth[j]), rng.normal(0, [0.05, 0.05, 0.02])).tolist()
        rows.append(f"EDGE_SE2 {10 + i} {10 + j} {x} {y} {a} {INFORMATION}")
    for _ in range(false):
        i, j = sorted(rng.choice(32, 2, replace=False).tolist())
        j = j if j > i + 1 else (i + 7) % 32
        rows.append(f"EDGE_SE2 {10 + i} {10 + j} {rng.uniform(6, 9)} {rng.uniform(6, 9)} 1 {INFORMATION}")
    path.write_text("\n".join([*rows, extra]) + "\n")
    return truth


def test_a_graph_is_solved_written_and_read_again(tmp_path, capsys):
    truth = ring(tmp_path / "ring.g2o", false=3)
    assert _run(["solve", str(tmp_path / "ring.g2o"), "--out", str(tmp_path / "out"), "--robust"]) == 0
    said = capsys.readouterr().out
    assert "3 of 42 edges contradict the others and were dropped" in said
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["closures_dropped"] == 3
    assert sorted(d["edge"] for d in metrics["dropped"]) == [39, 40, 41]
    assert metrics["chi2"] < metrics["chi2_before"]
    assert metrics["iterations"] > 0
    assert metrics["fixed"] == [10]
    assert metrics["status"] == "converged"
    back = read_g2o_file(tmp_path / "out" / "pose_graph.g2o")
    assert back.ids == tuple(range(10, 42))
    assert back.fixed == (0,)
    assert np.abs(se2.between(back.graph.pose, truth)).max() < 0.3
    track = read_tum(tmp_path / "out" / "trajectories" / "robot1.tum")
    assert np.array_equal(track.t, np.arange(10, 42))
    assert np.allclose(track.pose, back.graph.pose, atol=1e-5)
    with (tmp_path / "out" / "closures.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["edge"]) for row in rows] == list(range(31, 42))
    assert [row["used"] for row in rows] == ["1"] * 8 + ["0"] * 3
    assert (rows[0]["from"], rows[0]["to"]) == ("10", "26")
    for name in ("report.html", "figures/graph.png", "figures/edges.png", "trajectories/robot1.cov.csv"):
        assert (tmp_path / "out" / name).stat().st_size > 100
    page = (tmp_path / "out" / "report.html").read_text()
    assert "standard deviations from what the rest says" in page


@pytest.mark.slow
def test_the_same_file_gives_the_same_bytes(tmp_path):
    ring(tmp_path / "ring.g2o", false=2)
    for name in ("a", "b"):
        mapweave.solve_pose_graph(tmp_path / "ring.g2o", tmp_path / name, robust=True)
    for file in ("pose_graph.g2o", "trajectories/robot1.tum", "closures.csv", "report.html"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_without_vertices_the_solve_finds_the_same_optimum(tmp_path):
    ring(tmp_path / "with.g2o")
    ring(tmp_path / "without.g2o", vertices=False)
    a, b = (mapweave.solve_pose_graph(tmp_path / f"{name}.g2o") for name in ("with", "without"))
    assert a.solved.chi2 == pytest.approx(b.solved.chi2, rel=1e-6)
    assert "no vertices" in b.warnings[0]


def test_parts_that_do_not_hang_together_are_told(tmp_path):
    ring(tmp_path / "two.g2o", vertices=False, extra=f"EDGE_SE2 90 91 1 0 0 {INFORMATION}")
    result = mapweave.solve_pose_graph(tmp_path / "two.g2o", tmp_path / "out")
    assert result.solved.converged
    assert any("falls into 2 parts" in w and "2 poses from vertex 90 on" in w for w in result.warnings)
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["component_sizes"] == [32, 2]
    assert metrics["components"][1] == [90, 91]
    assert metrics["fixed"] == [10, 90]


def test_priors_that_contradict_the_edges_are_told(tmp_path):
    prior = "EDGE_PRIOR_SE2 10 0 0 0 1e4 0 0 1e4 0 1e4\nEDGE_PRIOR_SE2 14 9 9 0 1e4 0 0 1e4 0 1e4"
    ring(tmp_path / "prior.g2o", extra=prior)
    result = mapweave.solve_pose_graph(tmp_path / "prior.g2o")
    assert any("the prior of vertex" in w and "contradicts the rest" in w for w in result.warnings)
    ring(tmp_path / "twice.g2o", extra=prior.replace("PRIOR_SE2 14", "PRIOR_SE2 10"))
    with pytest.raises(ReaderError, match="EDGE_PRIOR_SE2 10 contradicts that of line"):
        mapweave.solve_pose_graph(tmp_path / "twice.g2o")


def test_vertices_held_where_the_edges_do_not_put_them_are_told_and_the_result_is_not_trusted(tmp_path):
    ring(tmp_path / "sound.g2o")
    sound = mapweave.solve_pose_graph(tmp_path / "sound.g2o", tmp_path / "out")
    assert sound.metrics["trusted"] is True
    assert sound.doubts == ()
    solved, ids = sound.solved.graph.pose, sound.file.ids
    for off, told in ((0.0, False), (5.0, True)):
        rows = [
            f"VERTEX_SE2 {ids[k]} {x + off * (k == 4)} {y} {turn}" for k, (x, y, turn) in enumerate(solved.tolist())
        ]
        edges = [row for row in (tmp_path / "sound.g2o").read_text().splitlines() if row.startswith("EDGE")]
        (tmp_path / "held.g2o").write_text("\n".join([*rows, *edges, f"FIX {ids[0]}", f"FIX {ids[4]}"]) + "\n")
        result = mapweave.solve_pose_graph(tmp_path / "held.g2o")
        where = f"vertex {ids[4]} is held where the rest of the graph does not put it"
        assert any(where in why for why in result.doubts) is told
        assert result.metrics["trusted"] is not told
        assert any("not to be trusted" in line for line in result.lines()) is told


def test_edges_that_contradict_without_robust_are_not_trusted_and_with_it_are(tmp_path):
    ring(tmp_path / "ring.g2o")
    ids = mapweave.solve_pose_graph(tmp_path / "ring.g2o").file.ids
    false = [f"EDGE_SE2 {ids[a]} {ids[b]} 7 -5 2 400 0 0 400 0 400" for a, b in ((0, 2), (1, 3))]
    ring(tmp_path / "false.g2o", extra="\n".join(false))
    plain = mapweave.solve_pose_graph(tmp_path / "false.g2o")
    assert any("edges contradict each other" in why and "--robust" in why for why in plain.doubts)


def test_a_bad_file_is_one_line_and_leaves_nothing(tmp_path, capsys):
    (tmp_path / "bad.g2o").write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert _run(["solve", str(tmp_path / "bad.g2o"), "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "bad.g2o:2: EDGE_SE2 0 1: there is no vertex 1" in error
    assert not (tmp_path / "out").exists()
    assert _run(["solve", str(tmp_path / "none.g2o"), "--out", str(tmp_path / "out")]) == 1


def test_a_lonely_vertex_is_a_graph(tmp_path):
    (tmp_path / "one.g2o").write_text("VERTEX_SE2 5 1 2 0.5\n")
    result = mapweave.solve_pose_graph(tmp_path / "one.g2o", tmp_path / "out")
    assert np.allclose(result.solved.graph.pose, [[1, 2, 0.5]])
    assert len(read_g2o(tmp_path / "out" / "pose_graph.g2o")) == 1
