"""The paper's tables come out, and the cells that do not are named."""

import json

import numpy as np
import pytest

from mapweave.cli import _run
from mapweave.papers.hamatani.experiments import LAYOUT, angle_error, guess, side_error, sightings


def test_errors_are_of_the_sides_and_angles_whatever_the_place():
    moved = LAYOUT + np.array([3.0, -7.0])
    assert side_error(moved) == pytest.approx(0)
    assert angle_error(moved) == pytest.approx(0)
    grown = 1.5 * LAYOUT
    assert side_error(grown) == pytest.approx(5.0)
    assert angle_error(grown) == pytest.approx(0, abs=1e-9)
    leaning = LAYOUT @ np.array([[1.0, 0.0], [0.2, 1.0]])
    assert angle_error(leaning) > 3.0


def test_each_pair_is_sighted_once_with_the_noise_asked_for():
    rng = np.random.default_rng(0)
    net = sightings(25.0, known=True, rng=rng)
    assert len(net.observer) == 10
    assert np.degrees(net.sigma) == pytest.approx(5.0)
    assert sorted(net.anchors) == [0, 1]
    exact = sightings(0.0, known=False, rng=rng)
    assert exact.bearing[0] == 0
    assert np.std([guess(25.0, rng) - LAYOUT for _ in range(400)]) == pytest.approx(5.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.eq("Hamatani:2", "Hamatani:4", "Hamatani:5", "Hamatani:6", "Hamatani:7", "Hamatani:8")
def test_the_tables_of_the_paper_come_out_and_the_row_that_does_not_is_named(tmp_path, capsys):
    out = tmp_path / "hamatani"
    assert _run(["reproduce", "hamatani", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    for words in ("Table 1", "Table 2", "Table 3", "6.6921", "0.0531", "deg²", "P0 = 100 I", "not reproduced"):
        assert words in said
    metrics = json.loads((out / "metrics.json").read_text())
    for table, factor in (("table1", 2.0), ("table2", 1.3), ("table3", 2.0)):
        assert len(metrics[table]) == 9
        for cell in metrics[table]:
            if cell["printed"] is None:
                assert cell["bearing_deg2"] == 0
                assert table == "table1" or cell["ours"] < 1e-10
            elif cell["guess_m2"] < 25:
                assert 1 / factor <= cell["ours"] / cell["printed"] <= factor
                assert cell["verdict"] == "reproduced"
    assert any(c["verdict"] == "not reproduced" for c in metrics["table2"] if c["guess_m2"] == 25)
    ekf, fej = metrics["drift"][:2]
    assert ekf["side_m"] > 1.0
    assert fej["side_m"] < 0.005
    page = (out / "report.html").read_text()
    assert page.count("<figure>") == 3
    assert sorted(p.name for p in (out / "figures").iterdir()) == ["drift.png", "final.png", "initial.png"]
