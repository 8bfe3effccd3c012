"""`map --mcap` writes what ROS tools open beside the result, and changes nothing else."""

import json

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import mapweave


@pytest.mark.slow
def test_a_landmark_map_is_written_as_messages_too(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.map(tmp_path / "team", tmp_path / "plain")
    mapweave.map(tmp_path / "team", tmp_path / "with", mcap=True)
    plain, other = (sorted(p.relative_to(d) for p in d.rglob("*")) for d in (tmp_path / "plain", tmp_path / "with"))
    assert [str(p) for p in other if p not in plain] == ["result.mcap"]
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([tmp_path / "with" / "result.mcap"], default_typestore=store) as reader:
        topics = {c.topic for c in reader.connections}
    assert topics == {"/landmarks", "/tf", "/robot1/path", "/robot1/pose", "/robot2/path", "/robot2/pose"}
    assert json.loads((tmp_path / "with" / "metrics.json").read_text())["seed"] == 0


def test_messages_without_a_folder_are_refused():
    with pytest.raises(mapweave.UsageError, match="mcap: expected a folder"):
        mapweave.map("nowhere", mcap=True)
