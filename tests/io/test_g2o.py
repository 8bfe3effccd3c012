"""g2o pose graphs: read, written, and read again."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.g2o import read_g2o, read_g2o_file, write_g2o
from mapweave.laser.pose_graph import PoseGraph


def test_a_written_graph_comes_back(tmp_path):
    rng = np.random.default_rng(0)
    pose = np.column_stack([rng.normal(0, 5, (6, 2)), rng.uniform(-3, 3, 6)])
    A = rng.normal(size=(6, 3, 3))
    graph = PoseGraph(
        pose,
        np.array([0, 1, 2, 3, 4, 0]),
        np.array([1, 2, 3, 4, 5, 5]),
        rng.normal(size=(6, 3)),
        A @ A.transpose(0, 2, 1),
    )
    write_g2o(tmp_path / "a.g2o", graph)
    back = read_g2o(tmp_path / "a.g2o")
    for name in PoseGraph.__slots__:
        assert np.allclose(getattr(back, name), getattr(graph, name), rtol=1e-7)
    assert (tmp_path / "a.g2o").read_text().splitlines()[-1] == "FIX 0"


def test_a_graph_of_toro_says_the_same_with_its_numbers_in_another_order(tmp_path):
    ours, theirs = tmp_path / "a.g2o", tmp_path / "a.graph"
    ours.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.5\nEDGE_SE2 0 1 1 0 0.5 11 12 13 22 23 33\n")
    theirs.write_text("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0.5\nEDGE2 0 1 1 0 0.5 11 12 22 33 13 23\n")
    assert np.linalg.eigvalsh(np.array([[11, 12, 13], [12, 22, 23], [13, 23, 33]]))[0] > 0
    for name in PoseGraph.__slots__:
        np.testing.assert_array_equal(getattr(read_g2o(theirs), name), getattr(read_g2o(ours), name))
    theirs.write_text("VERTEX2 0 0 0 0\nEDGE2 0 1 1 0 0.5 1 0 1 1 0\n")
    with pytest.raises(ReaderError, match="EDGE2 needs 11 finite numbers"):
        read_g2o(theirs)


def test_poses_without_a_vertex_are_reached_along_the_edges(tmp_path):
    path = tmp_path / "b.g2o"
    path.write_text("EDGE_SE2 10 20 1 0 1.5 1 0 0 1 0 1\nEDGE_SE2 30 20 0 2 0 1 0 0 1 0 1\n")
    graph = read_g2o(path)
    assert np.allclose(graph.pose[0], 0)
    assert np.allclose(graph.pose[1], [1, 0, 1.5])
    assert np.allclose(se2.compose(graph.pose[2], np.array([0.0, 2, 0])), graph.pose[1])


def test_a_bad_row_and_a_graph_in_two_parts_are_told(tmp_path):
    path = tmp_path / "c.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0\n")
    with pytest.raises(ReaderError, match=r"c\.g2o:2: EDGE_SE2 needs 11 finite numbers"):
        read_g2o(path)
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(ReaderError, match="2 poses have no vertex"):
        read_g2o(path)
    path.write_text("hello\n")
    with pytest.raises(ReaderError, match="expected VERTEX_SE2 and EDGE_SE2 rows, found 1 hello"):
        read_g2o(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EDGE_SE2 0 1 1 0 0 1 0 0 0 0 1", "g:2: expected a positive definite information of EDGE_SE2 0 1"),
        ("EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1", "g:2: expected a positive definite information of EDGE_SE2 0 1"),
        ("EDGE_SE2 0 1 1 0 0 1e308 1e308 0 1e307 0 1", "g:2: expected a positive definite information"),
        ("EDGE_SE2 0 1 nan 0 0 1 0 0 1 0 1", "g:2: EDGE_SE2 needs 11 finite numbers"),
        ("EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1", "g:2: EDGE_SE2 needs whole numbers for ids, found '0 1.5'"),
        ("EDGE_SE2 0 0 1 0 0 1 0 0 1 0 1", "g:2: expected an edge between two poses, found one from 0 to itself"),
        ("VERTEX_SE2 0 1 1 1", "g:2: vertex 0 is told twice"),
        ("VERTEX_SE2 1 inf 1 1", "g:2: VERTEX_SE2 needs 4 finite numbers"),
        ("VERTEX_SE2", "g:2: VERTEX_SE2 needs 4 finite numbers"),
        ("FIX 7", "g:2: FIX 7: there is no such vertex"),
        ("EDGE_PRIOR_SE2 3 0 0 0 9 0 0 9 0 9", "g:2: EDGE_PRIOR_SE2 3: there is no such vertex"),
        ("EDGE_PRIOR_SE2 0 0 0 0 9 0 0 -9 0 9", "g:2: expected a positive definite information of EDGE_PRIOR_SE2 0"),
        (
            "EDGE_PRIOR_SE2 0 0 0 0 9 0 0 9 0 9\nEDGE_PRIOR_SE2 0 5 0 0 9 0 0 9 0 9",
            "g:3: EDGE_PRIOR_SE2 0 contradicts that of line 2: they lie 5 m",
        ),
        ("FIX one", "g:2: FIX needs whole numbers"),
        ("EDGE_SE2 0 1 1e308 1e308 1 1 0 0 1 0 1\nEDGE_SE2 1 2 1e308 1e308 1 1 0 0 1 0 1", "1 poses have no vertex"),
    ],
)
def test_what_no_graph_can_be_is_told_with_its_line(tmp_path, text, said):
    (tmp_path / "g").write_text(f"VERTEX_SE2 0 0 0 0\n{text}\n")
    with pytest.raises(ReaderError, match=said):
        read_g2o(tmp_path / "g")


def test_ids_fixed_poses_and_rows_of_other_kinds_are_told(tmp_path):
    path = tmp_path / "d.g2o"
    path.write_text(
        "# made by hand\nVERTEX_SE2 7 1 2 0\nEDGE_SE2 7 9 1 0 0 1 0 0 1 0 1\nFIX 7\nVERTEX_XY 3 1 1\nVERTEX_XY 4 1 1\n"
    )
    held = read_g2o_file(path)
    assert (held.ids, held.fixed, held.unread) == ((7, 9), (0,), {"VERTEX_XY": 2})
    assert held.started.tolist() == [True, False]
    kinds = "VERTEX_SE2, EDGE_SE2, EDGE_PRIOR_SE2 and FIX"
    assert held.warnings == (f"rows of other kinds than {kinds} are passed over: 2 VERTEX_XY",)
    write_g2o(path, held.graph, held.ids, held.fixed)
    again = read_g2o_file(path)
    assert (again.ids, again.fixed, again.unread, again.warnings) == ((7, 9), (0,), {}, ())


def test_a_graph_to_solve_may_have_parts_and_priors_but_lack_no_vertex(tmp_path):
    path = tmp_path / "e.g2o"
    path.write_text(
        "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2 5 1 2 3 4 0 0 4 0 4\n"
    )
    held = read_g2o_file(path, parts=True)
    assert np.allclose(held.graph.pose[:, 0], [0, 1, 0, 1])
    assert [(p.vertex, p.pose.tolist(), p.information[0, 0]) for p in held.priors] == [(2, [1, 2, 3], 4.0)]
    path.write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert len(read_g2o_file(path).graph) == 2
    with pytest.raises(ReaderError, match=":2: EDGE_SE2 0 1: there is no vertex 1"):
        read_g2o_file(path, parts=True)


def test_gtsam_reads_every_vertex_and_every_edge_of_a_written_graph(tmp_path):
    gtsam = pytest.importorskip("gtsam")
    rng = np.random.default_rng(1)
    pose = np.column_stack([rng.normal(0, 5, (5, 2)), rng.uniform(-3, 3, 5)])
    A = rng.normal(size=(5, 3, 3))
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]])
    graph = PoseGraph(pose, *ends.T, se2.between(pose[ends[:, 0]], pose[ends[:, 1]]), A @ A.transpose(0, 2, 1))
    write_g2o(tmp_path / "a.g2o", graph)
    factors, values = gtsam.readG2o(str(tmp_path / "a.g2o"), False)
    assert (factors.size(), values.size()) == (5, 5)
    for k in range(5):
        factor = factors.at(k)
        assert list(factor.keys()) == ends[k].tolist()
        step = factor.measured()
        assert np.allclose([step.x(), step.y(), step.theta()], graph.measured[k], atol=1e-7)
        assert np.allclose(factor.noiseModel().information(), graph.information[k], rtol=1e-6, atol=1e-7)
        at = values.atPose2(k)
        assert np.allclose([at.x(), at.y(), at.theta()], pose[k], atol=1e-7)
    gtsam.writeG2o(factors, values, str(tmp_path / "b.g2o"))
    back = read_g2o(tmp_path / "b.g2o")
    assert np.allclose(back.pose, pose, atol=1e-5)
    assert np.allclose(back.information, graph.information, rtol=1e-4, atol=1e-4)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "poses", "edges"), [("intel", 1728, 2512), ("manhattan", 3500, 5453), ("CSAIL", 1045, 1172)]
)
def test_the_public_graphs_are_read_whole(data, name, poses, edges):
    graph = read_g2o(data / "g2o" / f"{name}.g2o.gz")
    assert (len(graph), len(graph.first)) == (poses, edges)
    assert np.isfinite(graph.pose).all()
    assert (np.linalg.eigvalsh(graph.information) > 0).all()


def test_a_line_that_would_be_millions_of_words_is_refused_before_it_is_cut_into_them(tmp_path):
    path = tmp_path / "a.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nFIX " + "0 " * 600_000 + "\n")
    with pytest.raises(ReaderError, match=r"a\.g2o:2: expected lines of at most 1048576 characters, found one"):
        read_g2o(path)


def test_a_table_that_is_no_graph_is_told_in_one_short_line(tmp_path):
    path = tmp_path / "sightings.csv"
    path.write_text(
        "observer,target,bearing\n" + "".join(f"1,{k},0.123456789012345678901234567890\n" for k in range(99))
    )
    with pytest.raises(ReaderError, match=r"rows, found 1 observer,target,bearing, .* 95 kinds more$") as error:
        read_g2o(path)
    assert len(str(error.value)) < len(str(path)) + 300
