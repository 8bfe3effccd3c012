"""Walls known beforehand as a robot's map: what is seen of them, and another robot placed among them."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

import mapweave
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.io.mcap import write_mcap
from mapweave.io.ros_map import RosMap, read_ros_map
from mapweave.io.tum import read_tum
from mapweave.mapping.known_map import known_map
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

ORIGIN = np.array([-2.0, 1.0, 0.0])


def room():
    """A room of 8 x 5 m open to what nobody knows on the right, with a cell in doubt before its left wall."""
    state = np.full((120, 200), -1, dtype=np.int8)
    state[10:110, 20:180] = 0
    state[[9, 110], 20:180] = 1
    state[10:110, 19] = 1
    state[50, 20] = -1
    return RosMap(state, 0.05, ORIGIN)


def test_what_is_seen_of_known_walls_lies_on_them_and_where_they_end_nothing_is_seen():
    made = known_map(room().grid(), "room.yaml")
    graph = made.graph
    at = np.concatenate([se2.act(graph.pose[k], graph.points[graph.rows(k)]) for k in range(len(graph))])
    walls = room().occupied()
    assert cKDTree(walls).query(at)[0].max() < 0.06
    assert cKDTree(at).query(walls)[0].max() < 0.1
    assert room().free(graph.pose[:, :2]).all()
    np.testing.assert_allclose(se2.compose(graph.pose[:-1], graph.step), graph.pose[1:], atol=1e-12)
    assert np.hypot(*np.diff(graph.pose[:, :2], axis=0).T).max() < 4.0
    assert (made.track.pose == graph.pose).all()


def test_known_walls_without_a_free_place_or_without_walls_are_refused():
    bare = RosMap(np.zeros((50, 50), np.int8), 0.05, ORIGIN)
    with pytest.raises(mapweave.DataError, match=r"bare\.yaml: no wall is seen from a free place"):
        known_map(bare.grid(), "bare.yaml")
    full = RosMap(np.ones((50, 50), np.int8), 0.05, ORIGIN)
    with pytest.raises(mapweave.DataError, match="no free place"):
        known_map(full.grid(), "full.yaml")


@pytest.mark.slow
def test_a_map_begins_from_the_walls_that_another_left_and_stands_in_their_frame(tmp_path):
    drive = simulate_office(OfficeConfig(rooms=4), 3)
    mapweave.map(drive.log, tmp_path / "first")
    later = drive.log.cut(drive.log.scan_t[len(drive.log.scans) // 2], "2")[1]
    write_mcap(tmp_path / "later.mcap", later)
    shift = np.array([5.0, -3.0, 0.4])
    path = tmp_path / "first" / "map.yaml"
    at = se2.compose(shift, np.append(read_ros_map(path).origin[:2], 0.0))
    lines = [f"origin: {at.tolist()}" if line.startswith("origin") else line for line in path.read_text().splitlines()]
    (tmp_path / "first" / "turned.yaml").write_text("\n".join(lines))
    first = se2.compose(shift, se2.inverse(drive.truth.pose[0]))
    begun = se2.compose(first, se2.interpolate(later.scan_t[:1], drive.truth.t, drive.truth.pose)[0])
    start = ",".join(
        map(str, begun + np.array([0.2, -0.2, 0.03]))
    )  # the building looks much the same turned by half a turn
    words = ["map", str(tmp_path / "later.mcap"), "--resume", str(tmp_path / "first" / "turned.yaml")]
    words += ["--start", f"robot1={start},0.3"]
    assert _run([*words, "--out", str(tmp_path / "out")]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["components"] == [["0", "1"]]
    track = read_tum(tmp_path / "out" / "trajectories" / "robot1.tum")
    off = track.pose - se2.compose(first, se2.interpolate(track.t, drive.truth.t, drive.truth.pose))
    assert np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()) < 0.15
