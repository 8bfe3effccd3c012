"""What a laser result keeps for going on comes back to the last digit; folders that hold something else are told."""

import dataclasses
import json

import numpy as np
import pytest

from mapweave.core.errors import DataError, ReaderError
from mapweave.core.findings import Unused
from mapweave.core.records import Track
from mapweave.io.laser_map import write_laser_map
from mapweave.io.laser_state import holds_state, read_laser_states, write_laser_states

from .made_laser_map import made_laser_map
from .test_robot_graph import graph


def made_map(robot="2", *, light=True):
    """A map as the graph method leaves it, made by hand."""
    made, own = made_laser_map(light=light), graph(light=light)
    n = len(made.track.t)
    rng = np.random.default_rng(3)
    spread = rng.normal(size=(n, 3, 3))
    return dataclasses.replace(
        made,
        robot=robot,
        method="graph",
        track=Track(made.track.t, made.track.pose, spread @ spread.swapaxes(1, 2) + np.eye(3), f"local_{robot}"),
        grid=dataclasses.replace(made.grid, frame=f"local_{robot}"),
        calibration=own.calibration,
        graph=dataclasses.replace(own, robot=robot, t=made.track.t[: len(own)]).stored(),
        timing={},
        called="carter",
        scan_hash=f"{robot}d3",
        unused=(Unused("drive.bag", "/imu", "sensor_msgs/Imu", 12, "no reader for this type"),),
    )


def kept(folder, *maps, starts=None):
    for made in maps:
        write_laser_map(folder / "local" / f"robot{made.robot}", made)
    write_laser_states(folder, maps, starts or {})
    (folder / "metrics.json").write_text('{"version": "1"}')
    return folder


def same(a, b, name="map"):
    """Fields of records, one by one."""
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            same(getattr(a, field.name), getattr(b, field.name), f"{name}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, name
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
    elif isinstance(a, tuple):
        assert len(a) == len(b), name
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            same(x, y, f"{name}[{k}]")
    else:
        assert a == b, name


@pytest.mark.parametrize("light", [True, False])
def test_every_field_of_every_map_comes_back(tmp_path, light):
    maps = [made_map("2", light=light), made_map("10", light=light)]
    back = read_laser_states(kept(tmp_path, *maps, starts={"10": (1.0, 2.0, 0.1, 0.5)}))
    assert [m.robot for m in back.maps] == ["2", "10"]
    for one, other in zip(maps, back.maps, strict=True):
        same(one, other)
    assert back.starts == {"10": (1.0, 2.0, 0.1, 0.5)}
    assert holds_state(tmp_path)


def test_a_map_without_a_graph_keeps_no_state(tmp_path):
    with pytest.raises(DataError, match="robot 2: the particle method keeps no graph to go on from"):
        write_laser_states(tmp_path, [dataclasses.replace(made_map(), method="particle", graph=None)], {})


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"state": 1}, "expected state of version 3, found 1"),
        ({"robots": []}, "expected the names of its robots"),
        ({"robots": ["../../other"]}, "expected names of robots, found '../../other'"),
        ({"starts": {"2": [1, 2]}}, "expected starts of robots as lists of 3 or 4 numbers"),
        ({"starts": {"2": [1, 2, None]}}, "expected starts of robots as lists of 3 or 4 numbers"),
        ({"robots": ["../2"]}, "expected names of robots, found '../2'"),
        ({"robots": ["3"]}, "robot3.npz: no such file"),
        ({"files": None}, "expected the hashes of its files"),
        ({"files": {}}, "robot2.npz: it is not the file that state.json tells of"),
    ],
)
def test_an_index_that_is_wrong_is_told(tmp_path, told, why):
    index = kept(tmp_path, made_map()) / "state" / "state.json"
    index.write_text(json.dumps({**json.loads(index.read_text()), **told}))
    with pytest.raises(ReaderError, match=why):
        read_laser_states(tmp_path)


def test_stamps_that_are_not_those_of_the_graph_are_told(tmp_path):
    made = made_map()
    kept(tmp_path, made)
    write_laser_states(
        tmp_path, [dataclasses.replace(made, track=dataclasses.replace(made.track, t=made.track.t + 7))], {}
    )
    with pytest.raises(ReaderError, match="its stamps are not those of the graph"):
        read_laser_states(tmp_path)
