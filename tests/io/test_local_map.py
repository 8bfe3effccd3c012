"""A local map is saved and read back to the bit, always as the same bytes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.errors import ReaderError
from mapweave.core.findings import Finding
from mapweave.core.records import Track
from mapweave.io.local_map import read_local_map, write_local_map
from mapweave.landmarks.landmark_map import LocalMap, RobotSightings, Submap, View


def some_map(robot="robot2", *, cov=True) -> LocalMap:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(7, 7))
    B = rng.normal(size=(5, 3, 3))
    return LocalMap(
        robot,
        Submap(robot, rng.normal(size=3), ("9", "barcode:72"), rng.normal(size=(2, 2)), A @ A.T, "local_2"),
        Track(np.arange(5.0), rng.normal(size=(5, 3)), B @ B.transpose(0, 2, 1) if cov else None, "local_2"),
        {"9": 4, "barcode:72": 21},
        RobotSightings(np.arange(3.0), ("robot4", "robot1", "robot4"), np.ones(3), np.zeros(3)),
        source="set",
        log_hash="abc",
        nis_median=1.25,
        down_weighted=3,
        dropped={"misread barcode": 2},
        calibration={"lag": (0.21, 0.01)},
        findings=(Finding("saw-nothing", robot, (1.0, 2.0), action="taken care of"),),
        first_seen={"9": 12.5},
        view=View(4.5, -0.5, 0.25, 0.75),
    )


@pytest.mark.parametrize("cov", [True, False])
def test_a_local_map_is_read_back_as_it_was_written(tmp_path, cov):
    before = some_map(cov=cov)
    write_local_map(tmp_path / "local" / "robot2", before)
    after = read_local_map(tmp_path / "local" / "robot2")
    assert np.array_equal(after.submap.cov, before.submap.cov)
    assert np.array_equal(after.submap.mean, before.submap.mean)
    assert np.array_equal(after.track.pose, before.track.pose)
    if cov:
        assert np.array_equal(after.track.cov, np.triu(before.track.cov) + np.triu(before.track.cov, 1).swapaxes(1, 2))
    else:
        assert after.track.cov is None
    assert after.robot_sightings.target == before.robot_sightings.target
    for name in ("robot", "sightings", "odometry", "source", "log_hash", "nis_median", "down_weighted", "dropped"):
        assert getattr(after, name) == getattr(before, name)
    assert (after.calibration, after.findings) == (before.calibration, before.findings)
    assert (after.first_seen, after.view) == (before.first_seen, before.view)
    write_local_map(tmp_path / "blind", replace(before, view=None))
    assert read_local_map(tmp_path / "blind").view is None


@pytest.mark.parametrize(
    "told",
    [
        *("7", '{"reach": 1}', '{"left": 1, "rate": 2, "reach": 1, "right": 0}'),
        '{"left": -3, "rate": 1, "reach": 1, "right": 3}',
    ],
)
def test_a_view_that_no_sensor_has_is_an_error(tmp_path, told):
    write_local_map(tmp_path, some_map())
    header = json.loads((tmp_path / "local_map.json").read_text())
    (tmp_path / "local_map.json").write_text(json.dumps(header | {"view": json.loads(told)}))
    with pytest.raises(ReaderError, match="view: expected"):
        read_local_map(tmp_path)


def test_the_same_map_is_the_same_bytes(tmp_path):
    write_local_map(tmp_path / "a", some_map())
    write_local_map(tmp_path / "b", some_map())
    for name in ("local_map.json", "local_map.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_what_is_missing_or_damaged_is_named(tmp_path):
    with pytest.raises(ReaderError, match=r"local_map\.json: cannot be read"):
        read_local_map(tmp_path)
    write_local_map(tmp_path, some_map())
    whole = (tmp_path / "local_map.npz").read_bytes()
    (tmp_path / "local_map.npz").write_bytes(whole[:100])
    with pytest.raises(ReaderError, match=r"local_map\.npz"):
        read_local_map(tmp_path)
    (tmp_path / "local_map.npz").write_bytes(whole)
    text = (tmp_path / "local_map.json").read_text()
    (tmp_path / "local_map.json").write_text(text.replace('"format": 1', '"format": 7'))
    with pytest.raises(ReaderError, match="expected format 1, found 7"):
        read_local_map(tmp_path)
    (tmp_path / "local_map.json").write_text(text.replace('"track', '"trick').replace('"9": 4,', ""))
    with pytest.raises(ReaderError, match=r"expected 2 landmarks as in local_map\.npz, found 1"):
        read_local_map(tmp_path)
    (tmp_path / "local_map.json").write_text("{")
    with pytest.raises(ReaderError, match="expected JSON"):
        read_local_map(tmp_path)
    (tmp_path / "local_map.json").write_text("[]")
    with pytest.raises(ReaderError, match="expected a JSON object"):
        read_local_map(tmp_path)
