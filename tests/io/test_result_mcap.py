"""A finished result is read back, message by message, by a ROS library that knows nothing of mapweave."""

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from mapweave.core.records import Track
from mapweave.io.mcap import write_result_mcaps
from mapweave.io.team_map import write_landmark_arrays
from mapweave.io.tum import write_track_covariance, write_tum
from mapweave.landmarks.landmark_map import LandmarkMap


@pytest.fixture
def folder(tmp_path):
    t = 1.7e9 + np.arange(0.0, 3.0, 0.02)
    pose = np.column_stack([np.arange(len(t)) * 0.01, np.full(len(t), -2.0), np.linspace(0.0, 3.0, len(t))])
    cov = np.tile(np.array([[4e-4, 1e-4, 0.0], [1e-4, 9e-4, 2e-5], [0.0, 2e-5, 1e-4]]), (len(t), 1, 1))
    (tmp_path / "trajectories").mkdir()
    write_tum(tmp_path / "trajectories" / "robot2.tum", Track(t, pose, cov))
    write_track_covariance(tmp_path / "trajectories" / "robot2.cov.csv", Track(t, pose, cov))
    (tmp_path / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.5\norigin: [-1.0, 2.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    pixels = np.array([[254, 254, 0], [205, 0, 254]], np.uint8)  # top row first
    (tmp_path / "map.pgm").write_bytes(b"P5\n3 2\n255\n" + pixels.tobytes())
    mean = np.array([[1.0, 2.0], [3.0, 4.0]])
    write_landmark_arrays(tmp_path, LandmarkMap(("7", "red $door$"), mean, np.diag([0.04, 0.01, 0.01, 0.01])))
    return tmp_path


def messages(path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=store) as reader:
        out = {}
        for connection, ns, raw in reader.messages():
            out.setdefault(connection.topic, []).append((ns, reader.deserialize(raw, connection.msgtype)))
        return out


def test_a_ros_reader_finds_the_whole_result(folder):
    write_result_mcaps(folder)
    read = messages(folder / "result.mcap")
    assert set(read) == {"/map", "/walls", "/landmarks", "/tf", "/robot2/path", "/robot2/pose"}
    ((_, grid),) = read["/map"]
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (3, 2, 0.5)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == (-1.0, 2.0)
    assert grid.data.tolist() == [-1, 100, 0, 0, 0, 100]  # row by row from the lowest y
    ((_, cloud),) = read["/walls"]
    points = np.frombuffer(cloud.data.tobytes(), np.float32).reshape(-1, 3)
    assert points.tolist() == [[-0.25, 2.25, 0.0], [0.25, 2.75, 0.0]]
    ((_, markers),) = read["/landmarks"]
    assert [m.text for m in markers.markers if m.text] == ["7", "red $door$"]
    assert markers.markers[0].scale.x == pytest.approx(2 * 0.2 * np.sqrt(5.991), rel=1e-3)


def test_poses_carry_their_covariance_and_the_transform_goes_from_map_to_the_robot(folder):
    write_result_mcaps(folder)
    read = messages(folder / "result.mcap")
    ((_, path),) = read["/robot2/path"]
    assert len(path.poses) == 150
    assert 28 <= len(read["/robot2/pose"]) <= 32  # ten a second
    ns, last = read["/robot2/pose"][-1]
    assert ns == pytest.approx((1.7e9 + 2.98) * 1e9, abs=2000)
    assert np.reshape(last.pose.covariance, (6, 6))[1, 5] == pytest.approx(2e-5)
    assert np.reshape(last.pose.covariance, (6, 6))[5, 5] == pytest.approx(1e-4)
    _, tf = read["/tf"][-1]
    assert (tf.transforms[0].header.frame_id, tf.transforms[0].child_frame_id) == ("map", "robot2/base_link")
    assert tf.transforms[0].transform.translation.x == pytest.approx(1.49, abs=1e-6)


def test_every_component_has_its_own(folder):
    part = folder / "components" / "2"
    (part / "trajectories").mkdir(parents=True)
    write_tum(part / "trajectories" / "robot3.tum", Track(np.array([1.0, 2.0]), np.zeros((2, 3))))
    write_result_mcaps(folder)
    assert set(messages(part / "result.mcap")) == {"/tf", "/robot3/path", "/robot3/pose"}
