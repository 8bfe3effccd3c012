"""Logs of any format read once: robots, events, tables; and a small script as a strict type checker reads it."""

import importlib.util
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import mapweave

SCRIPT = """
import mapweave as mw
import numpy as np

log = mw.read(["robot1.bag", "robot2.mcap"])
robots: tuple[str, ...] = log.robots
last = max(event.t for event in log.events())
result = mw.map(log, "out", resolution=0.05, config={"laser": {"particles": 50}}, truth="truth.tum")
verdict: str = result.verdict
again = mw.load("out", mw.LaserResult)
grid = again.maps[0].grid
grid.save("floor.yaml")
cells: np.ndarray = grid.to_numpy()
mw.map(log, config=mw.LaserConfig(resolution=0.1))
score = mw.evaluate("a.tum", truth="b.tum").as_json()["ape"]["rmse"]
slam = mw.LandmarkSlam(mw.EkfSlamConfig())
figure = again.plot(again.plot().axes[0])
html: str = again._repr_html_()
"""


@pytest.mark.slow
def test_a_script_is_typed_strictly(tmp_path, monkeypatch):
    api = pytest.importorskip("mypy.api")
    home = importlib.util.find_spec("mapweave").submodule_search_locations[0]
    monkeypatch.setenv("MYPYPATH", home.removesuffix("mapweave"))
    monkeypatch.chdir(tmp_path)
    for wrong, told in (("", ""), ("mw.map(log, resolution=[0.05])", 'Argument "resolution"')):
        (tmp_path / "script.py").write_text(SCRIPT + wrong, encoding="utf-8")
        said, _, status = api.run(["--strict", "--disable-error-code=type-arg", "--follow-imports=silent", "script.py"])
        assert (status, told in said) == (1 if wrong else 0, True), said


def test_lasers_are_read_as_they_were_recorded_and_mapped_from_memory(tmp_path):
    made = mapweave.simulate_laser(tmp_path / "drive.mcap", mapweave.CorridorConfig(distance=4.0), seed=1)
    mapweave.simulate_laser(tmp_path / "other.mcap", mapweave.CorridorConfig(distance=3.0), seed=2)
    log = mapweave.read([tmp_path / "drive.mcap", tmp_path / "other.mcap"])
    assert log.robots == ("1", "2")
    stamps = [event.t for event in log.events()]
    assert stamps == sorted(stamps)
    tables = log.tables()
    first = tables["scans"]["robot"] == "1"
    assert tables["scans"]["t"][first] == pytest.approx(made.log.scan_t)
    assert np.nanmax(tables["scans"]["ranges"][0]) <= made.log.scans[0].range_max
    assert set(tables) == {"scans", "poses"}
    alone = mapweave.read(tmp_path / "drive.mcap")
    one, two = (mapweave.map(given, method="gated") for given in (alone, tmp_path / "drive.mcap"))
    assert np.array_equal(one.maps[0].track.pose, two.maps[0].track.pose)
    grid = mapweave.map(alone, method="gated", resolution=0.05).maps[0].grid
    assert grid.resolution == 0.05
    grid.save(tmp_path / "a floor.yaml")
    from mapweave.io.ros_map import read_ros_map

    saved = read_ros_map(tmp_path / "a floor.yaml")
    assert np.array_equal(np.where(saved.state > 0, 100, saved.state), grid.to_numpy())
    assert {-1, 0, 100} == set(np.unique(grid.to_numpy()).tolist())
    with pytest.raises(mapweave.UsageError, match=r"expected a name that ends in \.yaml"):
        grid.save(tmp_path / "map.png")


def test_landmarks_are_read_and_mapped_from_memory_as_from_their_files(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    log = mapweave.read(tmp_path / "team")
    assert log.robots == ("1", "2")
    assert set(log.tables()) == {"velocities", "sightings"}
    assert len(log.tables()["sightings"]["id"]) == sum(len(part.sightings) for part in log.parts)
    one, two = mapweave.map(log), mapweave.map(tmp_path / "team")
    assert np.array_equal(one.maps[0].landmarks.mean, two.maps[0].landmarks.mean)
    assert mapweave.map(log, robots=[2]).maps[0].robots == ("robot2",)
    with pytest.raises(mapweave.UsageError, match="--resolution: only for laser logs"):
        mapweave.map(log, resolution=0.1)
    with pytest.raises(mapweave.UsageError, match="found both"):
        mapweave.map([log, tmp_path / "team"])


def test_a_grid_for_xarray_has_the_coordinates_of_its_cells(monkeypatch):
    grid = mapweave.map(mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=3.0)).log).maps[0].grid
    monkeypatch.setitem(sys.modules, "xarray", SimpleNamespace(Dataset=lambda *given: given))
    cells, coords, told = grid.to_xarray()
    (_, x, _), (_, y, _) = coords["x"], coords["y"]
    rows, columns = np.nonzero(grid.hits > 0)
    centres = np.column_stack([x[columns], y[rows]])
    assert np.abs(centres - grid.mean[rows, columns]).max() <= 0.5 * grid.resolution + 1e-6
    assert np.array_equal(np.isnan(cells["occupancy"][1]), grid.hits + grid.passes == 0)
    assert told == {"resolution": grid.resolution, "frame": grid.frame}
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(mapweave.UsageError, match=r"install mapweave with the extra \[xarray\]"):
        grid.to_xarray()


def test_a_log_that_is_none_and_frames_without_pandas_are_one_clear_error(tmp_path, monkeypatch):
    with pytest.raises(mapweave.ReaderError, match="no such file"):
        mapweave.read(tmp_path / "gone.bag")
    (tmp_path / "notes.txt").write_text("buy milk\n")
    with pytest.raises(mapweave.ReaderError, match=r"notes\.txt"):
        mapweave.read(tmp_path / "notes.txt")
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    with pytest.raises(mapweave.ReaderError, match="expected every robot once, found robot1 twice"):
        mapweave.read([tmp_path / "team", tmp_path / "team"])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(mapweave.UsageError, match=r"install mapweave with the extra \[pandas\]"):
        mapweave.read(tmp_path / "team").to_pandas()
