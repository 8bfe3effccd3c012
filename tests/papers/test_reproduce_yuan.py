"""`reproduce yuan`: every case is run and told, with the paper's own figures beside."""

import json

import pytest

from mapweave.papers.yuan import reproduce as module
from mapweave.papers.yuan.reproduce import PRINTED, TITLES, missions, reproduce_yuan


def test_the_table_holds_the_papers_figures_and_every_case_ours(tmp_path, monkeypatch):
    few = [m for m in missions() if m[1] in ("two robots, calibrated noise", "whole objective", "loop, 296 steps")]
    short = [(g, n, k, module.replace(m, until=12)) for g, n, k, m in few]
    monkeypatch.setattr(module, "missions", lambda: short)
    result = reproduce_yuan(tmp_path / "out", quick=True)
    rows = result.table("table1")
    assert rows[0][:3] == ("two robots, paper", "30/30", "208 / 371 / 296")
    assert rows[1][:3] == ("two robots, calibrated noise", "4/4", "12 / 12 / 12")
    assert len(result.table("beyond")) == 1
    told = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert told["printed"]["1"]["map_error_m"] == PRINTED[1][3]
    assert len(told["cases"]) == 3
    assert (tmp_path / "out" / "report.html").exists()
    assert (tmp_path / "out" / "figures" / "ablation.png").exists()


@pytest.mark.parametrize("group", list(TITLES))
def test_every_group_has_cases_and_each_term_is_left_out_once(group):
    names = [n for g, n, _, _ in missions() if g == group]
    assert len(names) >= 4
    if group == "ablation":
        assert {"no accuracy", "no area", "no distance to others"} < set(names)
