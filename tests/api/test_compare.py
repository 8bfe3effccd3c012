"""`compare`: what was put there or taken away is found, what stayed is not told; of the same logs, what differs."""

import json
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.compare import _keyframes
from mapweave.core import se2
from mapweave.core.errors import DataError, UsageError
from mapweave.io.ros_map import read_ros_map
from mapweave.mapping import merge
from mapweave.mapping.merge import merge_maps
from mapweave.mapping.merge_search import MergeConfig, Start
from mapweave.sim.laser import DriveConfig, WallStyle, WorldBuilder, drive, through

from ..laser.team_logs import office

pytestmark = pytest.mark.usefixtures("_remembered")

PUT, TAKEN = (2.6, 6.0, 0.7, 0.5), (7.4, 1.0, 0.5, 0.6)  # x, y, wide, deep [m]
WAY = [(2.0, 2.0), (9.0, 2.0), (9.0, 7.0), (5.0, 7.0), (5.0, 2.0), (2.4, 2.0)]


def seen(boxes, noise):
    """A map of one hall with these boxes in it."""
    build = WorldBuilder("hall", WallStyle(), np.random.default_rng(0))
    build.box(0.0, 0.0, 11.0, 9.0, 0.6)
    for x, y, wide, deep in ((0.0, 3.6, 2.2, 0.3), (6.6, 4.2, 0.8, 1.2), (10.2, 0.0, 0.8, 1.4), (3.0, 8.2, 1.5, 0.8)):
        build.box(x, y, wide, deep, 0.4)
    for box in boxes:
        build.box(*box, 0.5)
    made = drive(build.world(), through(WAY, 0.4), DriveConfig(), noise)
    return replace(made.log, scans=tuple(replace(scan, intensities=None) for scan in made.log.scans))


@pytest.fixture(scope="module")
def hall():
    """Before, after, and as before once more."""
    return [mapweave.map(seen(boxes, k)) for k, boxes in enumerate(([TAKEN], [PUT], [TAKEN]))]


def middle(box):
    x, y, wide, deep = box
    start = through(WAY, 0.4).start
    return se2.act(se2.inverse(start), np.array([[x + 0.5 * wide, y + 0.5 * deep]]))[0]


def test_a_box_put_there_and_one_taken_away_are_found_where_they_are(hall, tmp_path):
    told = mapweave.compare(hall[0], hall[1], tmp_path / "changes")
    assert sorted(c.kind for c in told.changes) == ["gone", "new"]
    for change in told.changes:
        at = 0.5 * (change.lower + change.upper)
        assert np.hypot(*(at - middle(PUT if change.kind == "new" else TAKEN))) < 0.45
        assert 0.0 < change.sd < 0.3
    assert told.metrics["share_compared"] > 0.8
    metrics = json.loads((tmp_path / "changes" / "metrics.json").read_text())
    assert [c["kind"] for c in metrics["changes"]] == [c.kind for c in told.changes]
    for kind in ("new", "gone"):
        layer = read_ros_map(tmp_path / "changes" / f"{kind}.yaml")
        assert np.hypot(*(layer.occupied() - middle(PUT if kind == "new" else TAKEN)).T).max() < 0.8
    assert (tmp_path / "changes" / "report.html").stat().st_size > 10_000


def test_where_submaps_fit_elsewhere_too_it_is_told_how_sure_the_place_is(hall, monkeypatch):
    one, other = (_keyframes(result, result.components[0], "") for result in hall[:2])
    merged = merge_maps(one, other, MergeConfig(sure=0.5))
    assert merged.merged
    assert merged.grounds.others
    sure = 0.5 * (merged.grounds.probability() + merged.grounds.alone().probability())
    told = merge_maps(one, other, MergeConfig(sure=sure)).reason
    assert f"and {merged.grounds.others} on another" in told
    assert told.endswith(f"% sure, {100 * sure:.0f} % are asked")
    monkeypatch.setattr(merge, "KNOWN_VOTES", 99)  # near a start it is submaps that are asked for
    near = merge_maps(one, other, MergeConfig(sure=sure), Start(np.zeros(3), np.array([0.5, 0.5, 0.1]))).reason
    assert "points of walls there; everywhere:" in near


@pytest.mark.slow
def test_seen_the_other_way_round_what_is_new_is_gone(hall):
    there, back = mapweave.compare(hall[0], hall[1]), mapweave.compare(hall[1], hall[0])
    swapped = {"new": "gone", "gone": "new"}
    assert sorted(c.kind for c in there.changes) == sorted(swapped[c.kind] for c in back.changes)
    assert np.allclose(se2.compose(there.transform, back.transform), 0.0, atol=0.05)


def test_of_a_place_that_stayed_as_it_was_nothing_is_told(hall):
    told = mapweave.compare(hall[0], hall[2])
    assert told.changes == ()
    assert told.lines()[0].startswith("0 walls are new, 0 are gone")


@pytest.mark.slow
def test_maps_of_different_places_are_refused_with_the_reason(hall):
    with pytest.raises(DataError, match=r"not found to be of one place: .+"):
        mapweave.compare(hall[0], mapweave.map(office(3, rooms=2, visited=2)[0]))


@pytest.mark.slow
def test_of_two_runs_over_the_same_logs_the_decisions_that_differ_are_told(office_logs, office_map, tmp_path):
    free, folder = office_map
    told = mapweave.map(office_logs[0], decisions={"pairs": [{"a": "1", "b": "2", "decision": "apart"}]})
    made = mapweave.compare(folder, told, tmp_path / "out")
    first = made.decisions[0]
    assert first[:3] == ("robot1 and robot2", "one map", "apart")
    assert first[4].startswith("said to be apart")
    assert made.changes == ()
    assert mapweave.compare(free, folder).decisions == ()
    assert mapweave.load(tmp_path / "out", mapweave.Comparison).decisions == made.decisions


def test_what_cannot_be_compared_is_refused_in_a_sentence(hall, tmp_path):
    with pytest.raises(UsageError, match="start: expected x, y, theta"):
        mapweave.compare(hall[0], hall[1], start=(1.0, 2.0))
    with pytest.raises(UsageError, match="before: expected laser maps of the graph method"):
        mapweave.compare(mapweave.map(seen([], 5), method="gated"), hall[0])
    with pytest.raises(mapweave.ReaderError):
        mapweave.compare(tmp_path, hall[0])
