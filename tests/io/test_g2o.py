"""g2o pose graphs: read, written, and read again."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.g2o import read_g2o, write_g2o
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
    assert (tmp_path / "a.g2o").read_text().splitlines()[6] == "FIX 0"


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
    with pytest.raises(ReaderError, match="found none"):
        read_g2o(path)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "poses", "edges"), [("intel", 1728, 2512), ("manhattan", 3500, 5453), ("CSAIL", 1045, 1172)]
)
def test_the_public_graphs_are_read_whole(data, name, poses, edges):
    graph = read_g2o(data / "g2o" / f"{name}.g2o.gz")
    assert (len(graph), len(graph.first)) == (poses, edges)
    assert np.isfinite(graph.pose).all()
    assert (np.linalg.eigvalsh(graph.information) > 0).all()
