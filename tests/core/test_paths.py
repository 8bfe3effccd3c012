"""Arguments of verbs that are of another kind than they have to be."""

from pathlib import Path

import numpy as np
import pytest

import mapweave
from mapweave.cli import main
from mapweave.core.errors import UsageError
from mapweave.core.paths import at_home, kind_of
from mapweave.laser.laser_map import GridMap


@pytest.mark.parametrize(
    ("name", "given"), [("seed", "1"), ("seed", 1.5), ("share", [1]), ("start", 3), ("share", "1:0.5")]
)
def test_an_argument_of_another_kind_is_refused_by_its_name(name, given):
    with pytest.raises(UsageError, match=f"^{name}: expected"):
        mapweave.map("nowhere", **{name: given})


@pytest.mark.parametrize(
    ("verb", "name", "given"),
    [
        ("map", "robots", 3),
        ("map", "robots", "12"),
        ("map", "force", "no"),
        ("map", "resolution", "0.05"),
        ("map", "weights", 1),
        ("map", "laser", {"no_loops": True}),
        ("map", "on_progress", 3),
        ("explore", "runs", "x"),
        ("explore", "robots", "2"),
        ("explore", "planner", 3),
        ("explore", "until", None),
        ("explore", "drop", "0.1"),
        ("simulate_landmarks", "minutes", "5"),
        ("simulate_landmarks", "robots", True),
        ("simulate_team", "calibration", []),
        ("configuration", "job", {}),
        ("read", "laser", {"no_loops": True}),
        ("live_view", "port", "8642"),
    ],
)
def test_every_verb_refuses_arguments_of_another_kind_by_name(verb, name, given, tmp_path):
    first = [tmp_path / "team"] if verb.startswith("simulate") else ["yuan"] if verb == "explore" else ["nowhere"]
    with pytest.raises(UsageError, match=rf"^{name}: expected .+, found {kind_of(given)}$"):
        getattr(mapweave, verb)(*(first if verb in {"map", "explore", "read"} else []), **{name: given})


@pytest.mark.parametrize(
    ("verb", "name", "told"),
    [
        ("map", "resume", r"give laser=LaserOptions\(resume=\.\.\.\)"),
        ("map", "resolutoin", r"did you mean resolution\?"),
        ("locate", "xyz", "expected one of sightings, "),
    ],
)
def test_an_option_that_a_verb_does_not_have_is_refused_with_where_it_is(verb, name, told):
    with pytest.raises(UsageError, match=rf"^{name}: {verb} has no such option.*{told}"):
        getattr(mapweave, verb)("nowhere", **{name: 1})


def test_a_result_that_is_not_there_is_not_said_to_lack_its_metrics(tmp_path):
    for verb in (mapweave.load, mapweave.view, mapweave.doctor, lambda p: mapweave.evaluate(p, truth="b.tum")):
        with pytest.raises(mapweave.ReaderError, match="no such file or folder"):
            verb(tmp_path / "a.tum")


def test_a_seed_below_0_is_refused_by_every_verb(tmp_path):
    for verb, first in (("map", "nowhere"), ("explore", "yuan"), ("simulate_swarm", None), ("localize", "nowhere")):
        with pytest.raises(UsageError, match=r"^--seed: expected 0 or more, found -1$"):
            getattr(mapweave, verb)(first, seed=-1, **({"map": tmp_path} if verb == "localize" else {}))
    with pytest.raises(UsageError, match=r"--share of robot 1 must be in .*, found None"):
        mapweave.map("nowhere", share={1: None})


def test_numbers_and_truth_values_of_numpy_are_taken():
    with pytest.raises(mapweave.ReaderError, match="nowhere"):
        mapweave.map("nowhere", robots=np.array(["1"]), seed=np.int64(2), force=np.bool_(0), resolution=np.float32(0.1))


def test_a_start_a_distance_and_a_dimension_that_cannot_be_are_refused():
    sightings = {"observer": ["a", "b"], "target": ["b", "a"], "bearing": [0.0, 3.1]}
    with pytest.raises(UsageError, match=r"--start of robot 1: expected x, y, theta .*, found int"):
        mapweave.map("nowhere", start={"1": 3})
    with pytest.raises(UsageError, match=r"--start of robot 2: expected finite numbers, found \(nan, 0"):
        mapweave.map("nowhere", start={"2": [np.nan, 0, 0]})
    for distances in (["ab"], [("a", "b")], [("a", "b", -1.0)], [3]):
        with pytest.raises(UsageError, match="distances: expected two robots and metres above 0 between them, found"):
            mapweave.locate(sightings, distances=distances)
    with pytest.raises(UsageError, match="--dim: expected 2 or 3, found -1"):
        mapweave.locate(sightings, dim=-1)


def test_a_path_that_begins_with_a_tilde_lies_in_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    mapweave.simulate_landmarks("~/team", robots=1, landmarks=8, minutes=0.2)
    (tmp_path / "any.toml").write_text("")
    result = mapweave.map(["~/team"], Path("~/out"), truth=("~/team",), config="~/any.toml")
    result.write("~/again")
    for folder in ("out", "again"):
        assert (tmp_path / folder / "metrics.json").is_file()
    assert mapweave.evaluate("~/out", "~/team").as_json()
    assert at_home(mapweave.LaserOptions(resume="~/none"), "laser").resume == f"{tmp_path}/none"
    with pytest.raises(UsageError, match=f"^--tls {tmp_path}/keys: expected"):
        mapweave.live_robot("r1", "~/team", network=mapweave.Network(tls=Path("~/keys")))
    (tmp_path / "world.toml").write_text('walls = "~/none.yaml"\nresolution = 0.1')
    with pytest.raises(mapweave.MapweaveError, match=f"{tmp_path}/none.yaml"):
        mapweave.explore("~/world.toml")
    with pytest.raises(SystemExit) as done:
        main(["map", "~/team", "--out=~/typed", "--truth=~/team"])
    assert (done.value.code, (tmp_path / "typed").is_dir(), (tmp_path / "~").exists()) == (0, True, False)


def test_a_path_that_is_none_is_refused_by_its_name(tmp_path):
    for given in ("", "a\0b"):
        with pytest.raises(UsageError, match=r"^out: expected a path, found"):
            mapweave.simulate_landmarks(given, robots=1, landmarks=8, minutes=0.2)
        with pytest.raises(UsageError, match=r"^logs: expected a path, found"):
            mapweave.map([tmp_path, given])


def test_what_cannot_be_written_is_one_clear_error_that_names_what_was_asked_for(monkeypatch, tmp_path):
    cells = np.zeros((3, 3), dtype=np.int32)
    grid = GridMap(0.1, np.zeros(2), cells, cells, np.zeros((3, 3, 2)), cells.astype(float), cells.astype(float))
    (tmp_path / "file").write_text("in the way")
    result = mapweave.simulate_landmarks(robots=1, landmarks=8, minutes=0.2)
    drive = mapweave.simulate_swarm(None, mapweave.SwarmScene(robots=5))

    def full(*_, **__):
        raise OSError(28, "No space left on device", None)

    for write, name in ((result.write, "out"), (drive.write, "swarm.csv"), (grid.save, "map.yaml")):
        for at in (tmp_path / "file" / name, tmp_path / ("n" * 300) / name, Path("/proc/none", name)):
            with pytest.raises(mapweave.MapweaveError, match=f"^{at.parent.parent}/.*: .") as told:
                write(at)
            assert told.value.exit_code in {1, 2}
        with monkeypatch.context() as change:
            change.setattr("tempfile.mkdtemp", full)
            change.setattr("tempfile.mkstemp", full)
            change.setattr("mapweave.io.ros_map._write_picture", full)
            with pytest.raises(mapweave.MapweaveError, match=f"^{tmp_path}/{name}: cannot be written: No space left"):
                write(tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]


def test_a_kind_is_named_with_the_article_it_takes():
    with pytest.raises(UsageError, match=r"^world: expected a CorridorConfig or an OfficeConfig or a TunnelConfig,"):
        mapweave.simulate_laser(world=3)
