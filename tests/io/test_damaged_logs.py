"""Whatever stands in a file, of any format: what is read of it is finite, or an error of one line names the file."""

import numpy as np
import pytest

from mapweave.core.errors import MapweaveError
from mapweave.io.g2o import read_g2o
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.rawlog import read_rawlog_ranges
from mapweave.io.robot_graph import read_robot_graph, write_robot_graph
from mapweave.io.scan_table import scan_table

from . import made_rawlog as made
from .test_carmen import flaser, odom
from .test_robot_graph import graph
from .test_scan_table import BEAMS, row
from .test_wean import drive, scan

TEXT = b"0\n ,-.eNaOL;\xff"  # what letters become, beside any byte
T0 = 1.7e9
TABLE = "".join(row(t, 0.1 * t) for t in range(20)).encode()
CARMEN = "\n".join(line for t in range(1, 20) for line in (odom(t, 0.1 * t), flaser(t, [1.5, 2.5, 3.5, 2.0]))).encode()
WEAN = "\n".join(line for t in range(20) for line in (scan(t), drive(t + 0.5, t))).encode()
RAWLOG = b"".join(
    made.actions(made.moved([0.1, 0.0, 0.1], T0 + k))
    + made.frame(made.scan(T0 + k, np.linspace(1.0, 9.0, 9)), made.ranges(T0, [(1, 2.0)]))
    for k in range(3)
)
G2O = "\n".join(
    [*(f"VERTEX_SE2 {k} {k} 0 0.1" for k in range(6))] + [f"EDGE_SE2 {k} {k + 1} 1 0 0 9 0 0 9 0 9" for k in range(5)]
).encode()


def table(path):
    return read_laser(path, "1", LaserSource(table=scan_table("t,x,y,theta,ranges", BEAMS)))


FORMATS = {  # file, what stands in it, who reads it, and how often it is spoilt
    "table": ("table.csv", TABLE, table, 60),
    "carmen": ("drive.log", CARMEN, read_laser, 60),
    "wean": ("run.log", WEAN, read_laser, 80),
    "rawlog": ("drive.rawlog", RAWLOG, read_laser, 300),
    "rawlog of ranges": ("drive.rawlog", RAWLOG, read_rawlog_ranges, 300),
    "g2o": ("graph.g2o", G2O, read_g2o, 200),
    "laser graph": ("graph.npz", None, read_robot_graph, 200),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_damaged_file_is_never_more_than_an_error_that_names_it(tmp_path, kind):
    name, whole, read, times = FORMATS[kind]
    path = tmp_path / name
    if whole is None:
        write_robot_graph(path, graph())
        whole = path.read_bytes()
    rng = np.random.default_rng(1)
    read(path if path.exists() else _laid(path, whole))
    refused = 0
    for k in range(times):
        data = bytearray(whole if k % 2 else whole[: int(rng.integers(1, len(whole)))])
        for at in rng.integers(0, len(data), 4).tolist():
            data[at] = rng.choice([*TEXT]) if k % 3 else rng.integers(0, 256)
        try:
            found = read(_laid(path, data))
        except MapweaveError as error:
            refused += 1
            assert name in str(error)  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
        else:
            assert all(np.isfinite(one.ranges).all() for one in getattr(found, "scans", ()))
    assert refused > 0


def _laid(path, data):
    path.write_bytes(data)
    return path
