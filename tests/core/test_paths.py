"""Arguments of verbs that are of another kind than they have to be."""

import numpy as np
import pytest

import mapweave
from mapweave.core.errors import UsageError
from mapweave.core.paths import kind_of


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
    ],
)
def test_every_verb_refuses_arguments_of_another_kind_by_name(verb, name, given, tmp_path):
    first = tmp_path / "team" if verb.startswith("simulate") else "yuan" if verb == "explore" else "nowhere"
    with pytest.raises(UsageError, match=rf"^{name}: expected .+, found {kind_of(given)}$"):
        getattr(mapweave, verb)(first, **{name: given})


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
