"""`reproduce hara` on a loop small enough for a test."""

import json

import numpy as np

from mapweave.papers.hara import experiments, reproduce
from mapweave.sim.corridor import CorridorConfig


def test_every_method_of_the_paper_is_compared_and_drawn(tmp_path, monkeypatch):
    loop = CorridorConfig(long_leg=9.0, short_leg=7.0, distance=20.0, start=3.0)
    compare = experiments.compare

    def small(chosen, seeds, shown, tick):
        return compare(chosen, range(seeds.start, seeds.start + 1), shown, tick, loop)

    monkeypatch.setattr(reproduce, "compare", small)
    result = reproduce.reproduce_hara(tmp_path / "out", quick=True, seed=3)
    head, rows = result.table()
    assert len(rows) == 8
    assert all(len(row) == len(head) for row in rows)
    error = dict(zip([m.name for m in result.methods], result.errors[:, 0], strict=True))
    assert error["RBPF-64, intensity"] < 0.25 * error["odometry"]
    assert error["RBPF-64, intensity"] < 0.15
    told = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert [m["figure"] for m in told["methods"] if m["figure"]] == ["Fig. 4", "Fig. 5", "Fig. 6", "Fig. 7"]
    assert np.isclose(told["methods"][-1]["ate_mean"], error["RBPF-64, intensity"])
    assert (tmp_path / "out" / "figures" / "maps.png").stat().st_size > 10_000
    assert "side by side" in (tmp_path / "out" / "report.html").read_text()
