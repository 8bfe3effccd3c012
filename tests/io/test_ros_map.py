"""ROS maps and plain images as floor plans, and what is said of damaged ones."""

import numpy as np
import pytest
from PIL import Image

from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.ros_map import read_plan, read_ros_map, write_ros_map
from mapweave.laser.laser_map import GridMap

RNG = np.random.default_rng(1)
YAML = (
    "image: plan.png\nresolution: 0.5\norigin: [1.0, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def put(folder, text=YAML, pixels=None):
    """plan.png with a grey level a cell, top row first, and the yaml beside it."""
    pixels = np.full((4, 6), 254, dtype=np.uint8) if pixels is None else pixels
    Image.fromarray(pixels).save(folder / "plan.png")
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def test_a_map_that_was_written_reads_back_the_same(tmp_path):
    hits = np.array([[9, 0, 0], [9, 9, 0]])
    passes = np.array([[0, 30, 0], [0, 0, 30]])
    zero = np.zeros((2, 3))
    write_ros_map(tmp_path, GridMap(0.05, np.array([-1.25, 3.5]), hits, passes, np.zeros((2, 3, 2)), zero, zero, "map"))
    found = read_ros_map(tmp_path / "map.yaml")
    assert found.state.tolist() == [[1, 0, -1], [1, 1, 0]]
    assert found.resolution == 0.05
    assert found.origin.tolist() == [-1.25, 3.5, 0.0]


def test_thresholds_negation_and_the_row_order_are_those_of_ros(tmp_path):
    pixels = np.array([[0, 100], [205, 255]], dtype=np.uint8)
    assert read_ros_map(put(tmp_path, pixels=pixels)).state.tolist() == [[-1, 0], [1, -1]]
    negated = YAML.replace("negate: 0", "negate: 1")
    assert read_ros_map(put(tmp_path, negated, pixels)).state.tolist() == [[1, 1], [0, -1]]


def test_lists_a_line_each_quotes_comments_and_plain_pgm_are_understood(tmp_path):
    (tmp_path / "a b.pgm").write_text("P2\n# drawn by hand\n2 2\n255\n0 254\n254 254\n")
    (tmp_path / "map.yaml").write_text(
        "---\n# a plan\nimage: 'a b.pgm'  # beside this file\nresolution: 5.0e-01\norigin:\n- 1\n- -2.5\n- 1.5707963\n"
        "negate: false\n"
    )
    found = read_ros_map(tmp_path / "map.yaml")
    assert found.state.tolist() == [[0, 0], [1, 0]]
    lower, upper = found.extent()
    np.testing.assert_allclose([*lower, *upper], [0.0, -2.5, 1.0, -1.5], atol=1e-6)


def test_a_turned_map_turns_its_walls(tmp_path):
    pixels = np.full((2, 4), 254, dtype=np.uint8)
    pixels[1, 3] = 0  # lowest row, last column: 1.5 to 2 m along x, 0 to 0.5 m along y
    turned = YAML.replace("[1.0, 2.0, 0.0]", f"[1.0, 2.0, {np.pi / 2}]")
    walls = read_ros_map(put(tmp_path, turned, pixels)).walls()
    assert walls.inside(np.array([[0.75, 3.75], [2.75, 2.25], [1.25, 3.75]])).tolist() == [True, False, False]


def test_in_a_plain_image_dark_is_wall_and_sixteen_bits_are_understood(tmp_path):
    Image.fromarray(np.array([[0, 60000], [30000, 40000]], dtype=np.uint16)).save(tmp_path / "plan.png")
    plan = read_plan(tmp_path / "plan.png", 1.0, np.zeros(3))
    assert plan.state.tolist() == [[1, 0], [1, 0]]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (YAML.replace("resolution: 0.5\n", ""), "resolution is missing"),
        (YAML.replace("0.5", "-1"), "expected metres a pixel above 0, found -1"),
        (YAML.replace("0.5", "fine"), "resolution: expected a number, found 'fine'"),
        (YAML.replace("[1.0, 2.0, 0.0]", "[1.0]"), "origin: expected .x, y, theta., found .1.0."),
        (YAML.replace("[1.0, 2.0, 0.0]", "[1.0, .nan, 0]"), "origin: expected"),
        (YAML.replace("0.196", "0.9"), "free_thresh <= occupied_thresh"),
        (YAML.replace("negate: 0", "negate: 7"), "negate: expected 0 or 1, found 7"),
        (YAML + "mode: sepia\n", "mode: expected trinary, scale or raw, found 'sepia'"),
        (YAML.replace("plan.png", "other.png"), "other.png: expected an image, found no such file"),
        (YAML + "just words\n", "map.yaml:8: expected a ROS map.yaml: could not find expected"),
    ],
)
def test_a_damaged_map_is_refused_in_one_line_that_names_the_file(tmp_path, text, told):
    with pytest.raises(ReaderError, match=told) as error:
        read_ros_map(put(tmp_path, text))
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("keep", [0, 20, 60])
def test_a_truncated_image_is_refused(tmp_path, keep):
    path = put(tmp_path, pixels=RNG.integers(0, 255, (40, 40), dtype=np.uint8))
    image = tmp_path / "plan.png"
    image.write_bytes(image.read_bytes()[:keep])
    with pytest.raises(ReaderError, match=r"plan\.png: expected a PGM or PNG image"):
        read_ros_map(path)


def test_a_missing_yaml_is_refused(tmp_path):
    with pytest.raises(ReaderError, match=r"map\.yaml: expected a ROS map\.yaml: No such file"):
        read_ros_map(tmp_path / "map.yaml")


def test_a_map_that_is_turned_has_its_cells_where_it_says_they_are(tmp_path):
    pixels = np.full((4, 6), 254, dtype=np.uint8)
    pixels[3, 5] = 0  # row 0 lowest in the map, so that this one is the lower right corner
    turned = YAML.replace("[1.0, 2.0, 0.0]", "[1.0, 2.0, 0.3]")
    found = read_ros_map(put(tmp_path, turned, pixels))
    T = np.array([1.0, 2.0, 0.3])
    np.testing.assert_allclose(found.occupied(), [se2.act(T, np.array([2.75, 0.25]))])
    corners = se2.act(T, np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 2.0], [3.0, 2.0]]))
    lower, upper = found.extent()
    np.testing.assert_allclose((lower, upper), (corners.min(axis=0), corners.max(axis=0)))
    inside = np.array([[0.01, 0.01], [2.49, 0.01], [2.51, 0.01], [2.99, 1.99], [-0.01, 1.0], [3.01, 1.0], [1.0, 2.01]])
    assert found.free(se2.act(T, inside)).tolist() == [True, True, False, True, False, False, False]
    edge = read_ros_map(put(tmp_path, YAML, pixels))
    assert edge.free(np.array([[4.0, 3.0], [1.0, 4.0], [1.0, 2.0]])).tolist() == [False, False, True]


def test_the_cells_of_a_turned_map_stand_upright_where_it_says_they_are(tmp_path):
    pixels = np.full((40, 60), 254, dtype=np.uint8)
    pixels[:, [0, -1]] = pixels[[0, -1]] = 0
    pixels[5:9, 5:9] = 205
    found = read_ros_map(put(tmp_path, YAML.replace("[1.0, 2.0, 0.0]", "[1.0, 2.0, 0.3]"), pixels))
    grid = found.grid()
    walls = grid.cells()[:, :2]
    assert np.hypot(*(walls[:, None] - found.occupied()).transpose(2, 0, 1)).min(axis=1).max() < 0.5
    assert np.hypot(*(walls[:, None] - found.occupied()).transpose(2, 0, 1)).min(axis=0).max() < 0.5
    states = grid.to_numpy()
    row, col = np.nonzero(states == 0)
    assert found.free(grid.origin + 0.5 * (np.column_stack([col, row]) + 0.5)).all()
    assert (states == 0).sum() == pytest.approx((found.state == 0).sum(), rel=0.05)
    np.testing.assert_array_equal(
        read_ros_map(put(tmp_path, YAML, pixels)).grid().to_numpy(), np.where(found.state == 1, 100, found.state)
    )


def test_walls_of_a_map_that_lies_far_from_its_origin_stand_where_their_cells_are(tmp_path):
    pixels = np.full((4, 6), 254, dtype=np.uint8)
    pixels[2, 1] = pixels[0, 4] = 0
    far = YAML.replace("[1.0, 2.0, 0.0]", "[500000.3, 5400000.1, 0.0]")  # metres east and north, as of UTM
    found = read_ros_map(put(tmp_path, far, pixels))
    grid = found.grid()
    assert np.abs(grid.mean[grid.hits > 0] - found.occupied()).max() < 1e-6
