"""The files of a laser map: what ROS, other solvers and `localize` find in them."""

import numpy as np
import pytest
from ruamel.yaml import YAML

from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.g2o import read_g2o
from mapweave.io.laser_map import read_grid, write_laser_map
from mapweave.io.table import read_table

from .made_laser_map import made_laser_map


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laser") / "robot1"
    made = made_laser_map()
    write_laser_map(folder, made)
    return made, folder


def test_the_ros_map_has_its_walls_where_the_grid_has_them(written):
    made, folder = written
    about = YAML(typ="safe").load((folder / "map.yaml").read_text())
    assert (about["image"], about["resolution"], about["negate"]) == ("map.pgm", 0.1, 0)
    head, size, top, pixels = (folder / "map.pgm").read_bytes().split(b"\n", 3)
    assert (head, size, top) == (b"P5", b"50 30", b"255")
    picture = np.frombuffer(pixels, np.uint8).reshape(30, 50)
    x, y = 4.7 - 1.0 - 0.05, -2.0 + 0.35  # the lower right corner of the wall
    col, row = int((x - about["origin"][0]) / 0.1), 29 - int((y - about["origin"][1]) / 0.1)
    assert picture[row, col] == 0
    assert picture[row - 5, col - 5] == 254
    assert picture[0, 0] == 205
    p = made.grid.occupancy()[::-1]
    assert ((picture == 0) == (p > about["occupied_thresh"])).all()
    assert ((picture == 254) == (p < about["free_thresh"])).all()


def test_the_grid_and_its_calibration_come_back(written):
    made, folder = written
    grid, calibration, feature = read_grid(folder / "grid.npz")
    assert feature == "normalised"
    for name in ("origin", "hits", "passes", "mean", "feature", "weight"):
        assert np.array_equal(getattr(grid, name), getattr(made.grid, name))
    assert calibration.exponent == made.calibration.exponent
    assert np.array_equal(calibration.log_gain, made.calibration.log_gain)


def test_every_scan_has_its_row_with_stamp_host_decision_and_n_eff(written):
    made, folder = written
    table = read_table(folder / "scans.csv")
    assert len(table) == len(made.scans)
    assert np.allclose(table.numbers("t"), made.scans.t)
    assert tuple(table.columns["host"]) == made.scans.host
    assert tuple(table.columns["decision"]) == made.scans.decision
    assert np.allclose(table.numbers("n_eff"), made.scans.n_eff, atol=1e-3, equal_nan=True)
    assert np.allclose(table.numbers("innovation_theta"), made.scans.innovation[:, 2], atol=1e-6)


def test_the_pose_graph_holds_the_scan_poses_and_their_steps(written):
    made, folder = written
    graph = read_g2o(folder / "pose_graph.g2o")
    assert np.allclose(graph.pose, made.scans.pose, atol=1e-6)
    assert np.allclose(se2.compose(graph.pose[graph.first], graph.measured), graph.pose[graph.second], atol=1e-6)
    assert (np.linalg.eigvalsh(graph.information) > 0).all()


def test_the_calibration_curve_is_a_table_with_residuals(written):
    made, folder = written
    table = read_table(folder / "calibration.csv")
    assert np.allclose(table.numbers("range"), made.calibration.knots)
    assert np.allclose(np.log(table.numbers("gain")), made.calibration.log_gain, atol=1e-5)
    assert np.allclose(table.numbers("residual"), made.calibration.residual_by_range, atol=1e-6)


def test_a_map_without_intensity_has_no_calibration_and_a_file_that_is_no_grid_is_told(tmp_path):
    write_laser_map(tmp_path, made_laser_map(light=False))
    assert not (tmp_path / "calibration.csv").exists()
    assert read_grid(tmp_path / "grid.npz")[1] is None
    (tmp_path / "grid.npz").write_bytes(b"no")
    with pytest.raises(ReaderError, match="expected a grid map"):
        read_grid(tmp_path / "grid.npz")
