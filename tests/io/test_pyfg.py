"""Ranges as PyFactorGraph text: read, written, refused with the line."""

import gzip

import numpy as np
import pytest

from mapweave.api.solve import solve_pose_graph
from mapweave.core.errors import ReaderError
from mapweave.io.pyfg import is_pyfg, read_pyfg, write_pyfg

COV = "0.01 0 0 0.01 0 0.001"
ROWS = f"""# a comment
VERTEX_SE2 1.0 A0 0 0 0
VERTEX_SE2 2.0 A1 1 0 0.5
VERTEX_SE2 1.5 B0 4 0 0
VERTEX_XY L0 2 3
EDGE_SE2 2.0 A0 A1 1.1 0.1 0.4 {COV}
EDGE_RANGE 1.0 A0 B0 4.2 0.0025
EDGE_RANGE 2.0 A1 L0 3.3 0.0025
VERTEX_SE2:PRIOR 1.0 A0 0 0 0 {COV}
VERTEX_XY:PRIOR 0 L0 2 3 0.04 0.01 0.09
"""


@pytest.mark.parametrize("packed", [False, True])
def test_a_file_is_read_and_what_is_written_of_it_reads_the_same(tmp_path, packed):
    path = tmp_path / "graph.pyfg.gz"
    path.write_bytes(gzip.compress(ROWS.encode()) if packed else ROWS.encode())
    assert is_pyfg(path)
    file = read_pyfg(path)
    net = file.network
    assert (net.robots, net.beacons, net.names) == (("A", "B"), ("L0",), ("A0", "A1", "B0", "L0"))
    assert net.ranges.z.tolist() == [4.2, 3.3]
    assert net.ranges.sd == pytest.approx(0.05)
    assert net.priors.cov[1, :2, :2].tolist() == [[0.04, 0.01], [0.01, 0.09]]
    write_pyfg(tmp_path / "again.pyfg", net, file.places)
    again = read_pyfg(tmp_path / "again.pyfg")
    assert again.places == pytest.approx(file.places)
    for part in ("motions", "ranges", "priors"):
        for name in getattr(net, part).__slots__:
            assert np.allclose(getattr(getattr(again.network, part), name), getattr(getattr(net, part), name)), name


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("EDGE_RANGE 1.0 A0 A0 4.2 0.0025", "from A0 to itself"),
        ("EDGE_RANGE 1.0 A0 B0 -4.2 0.0025", "above 0"),
        ("EDGE_RANGE 1.0 A0 B0 4.2 0", "above 0"),
        ("EDGE_RANGE 1.0 A0 B0 nan 0.0025", "finite numbers"),
        ("EDGE_RANGE 1.0 A0 L9 4.2 0.0025", "no vertex L9"),
        ("EDGE_RANGE 1.0 A0 B0 4.2", "finite numbers"),
        ("VERTEX_XY L0 1 1", "told twice"),
        (f"EDGE_SE2 2.0 A0 L0 1 0 0 {COV}", "no heading"),
        ("EDGE_SE2 2.0 A0 A1 1 0 0 0 0 0 0 0 0", "positive definite"),
        ("VERTEX_SE3:QUAT 1.0 C0 0 0 0 0 0 0 1", "in space"),
    ],
)
def test_a_row_that_cannot_be_is_refused_with_its_line(tmp_path, row, why):
    path = tmp_path / "graph.pyfg"
    path.write_text(f"{ROWS}{row}\n")
    with pytest.raises(ReaderError, match=why) as refused:
        read_pyfg(path)
    assert refused.value.line == 11


def test_rows_of_other_kinds_are_passed_over_and_told(tmp_path):
    path = tmp_path / "graph.pyfg"
    path.write_text(f"{ROWS}EDGE_SE2_XY 1.0 A0 L0 1 1 0.1 0 0.1\n")
    assert "1 EDGE_SE2_XY" in read_pyfg(path).warnings[0]


def test_a_pose_graph_of_g2o_is_none(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert not is_pyfg(path)


@pytest.mark.parametrize("row", ["EDGE_SE2 1 2 nan 0 0", "EDGE_SE2 1 2 1 x 0", "EDGE_SE2 1 b2 1 0 0"])
def test_a_pose_graph_with_a_row_that_is_spoilt_is_no_graph_of_ranges(row, tmp_path):
    (path := tmp_path / "some.g2o").write_text(f"VERTEX_SE2 1 0 0 0\nVERTEX_SE2 2 1 0 0\n{row} 1 0 0 1 0 1\n")
    with pytest.raises(ReaderError, match=r"some.g2o:3: EDGE_SE2 needs"):
        solve_pose_graph(path)
