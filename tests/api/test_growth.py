"""How a map grew: what the first seconds of all logs give, whoever carries what."""

import json
from dataclasses import replace

import pytest

import mapweave
from mapweave.api.map_laser import grown
from mapweave.core.errors import DataError, UsageError
from mapweave.core.workers import no_progress

from ..laser.team_logs import office

pytestmark = pytest.mark.drawn


def looked(spans, every=10.0):
    asked = []
    rows = grown(
        spans, every, lambda until: asked.append(until) or {"robots": 1, "maps": 1}, {"robots": 2}, no_progress
    )
    return asked, rows


def test_every_log_is_asked_up_to_the_same_moment():
    asked, rows = looked([(100.0, 130.0), (105.0, 125.0)])
    assert asked == [[110.0, 110.0], [120.0, 120.0]]
    assert [row["t"] for row in rows] == [10.0, 20.0, 30.0]
    assert rows[-1] == {"t": 30.0, "robots": 2}


def test_logs_of_different_days_are_each_asked_after_their_own_beginning():
    asked, rows = looked([(0.0, 25.0), (9000.0, 9012.0)])
    assert asked == [[10.0, 9010.0], [20.0, 9020.0]]
    assert rows[-1]["t"] == 25.0


def test_what_cannot_be_mapped_yet_is_told():
    def look(until):
        raise DataError("nothing there")

    assert grown([(0.0, 15.0)], 10.0, look, {"robots": 1}, no_progress)[0] == {
        "t": 10.0,
        "robots": 0,
        "maps": 0,
        "refused": "nothing there",
    }


def test_one_name_of_the_option_is_enough(tmp_path):
    with pytest.raises(UsageError, match="one of both"):
        mapweave.map(tmp_path, every=5.0, fuse_every=6.0)


@pytest.mark.slow
def test_a_laser_team_tells_how_its_map_grew_and_ends_as_it_does_without(tmp_path):
    log, _ = office(3)
    a, b = log.cut(float(log.scan_t[len(log.scans) // 2]), "robot2")
    later = replace(b, log_hash="later")
    half = float(a.scan_t[-1] - a.scan_t[0]) / 2
    plain = mapweave.map([a, later], tmp_path / "plain")
    told = mapweave.map([a, later], tmp_path / "told", every=half)
    rows = told.metrics["online"]
    first, last = rows[0], rows[-1]
    assert first["t"] == half
    assert first["keyframes"] < last["keyframes"]
    assert last["robots"] == max(len(c.robots) for c in plain.components)
    assert last["verdict"] == plain.verdict
    assert json.loads((tmp_path / "told" / "metrics.json").read_text())["online"] == rows
    assert (tmp_path / "told" / "figures" / "growth.png").stat().st_size > 1000
    assert "How the map grew" in (tmp_path / "told" / "report.html").read_text()
    for name in ("map.pgm", "trajectories/robot1.tum", "local/robot2/pose_graph.g2o"):
        assert (tmp_path / "told" / name).read_bytes() == (tmp_path / "plain" / name).read_bytes()
    with pytest.raises(UsageError, match="not with --resume"):
        mapweave.map([later], every=5.0, laser=mapweave.LaserOptions(resume=tmp_path / "plain"))


@pytest.mark.slow
def test_a_mixed_team_tells_how_its_map_grew(tmp_path):
    mapweave.simulate_team(tmp_path / "team", minutes=1.0, seed=2)
    rows = mapweave.map(tmp_path / "team", every=25.0).metrics["online"]
    assert [round(row["t"]) for row in rows] == [25, 50, 60]
    assert 0 < rows[0]["robots"] <= rows[-1]["robots"]
    assert rows[0]["landmarks"] <= rows[-1]["landmarks"]
