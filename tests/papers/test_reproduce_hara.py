"""`reproduce hara` on a loop small enough for a test."""

import json

import numpy as np
import pytest

from mapweave.laser.beam import beams
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature
from mapweave.papers.hara.experiments import (
    ALPHAS,
    GLASS,
    PRINTED,
    SPARSE_EVERY,
    SPARSE_LENGTH,
    STRETCH,
    along_error,
    counts,
    estimate_alpha,
    simulate_hard,
    starts_table,
    try_gate,
)
from mapweave.papers.hara.reproduce import reproduce_hara
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

LOOP = CorridorConfig(long_leg=9.0, short_leg=7.0, distance=20.0, start=3.0)


@pytest.fixture(scope="module")
def reproduction(tmp_path_factory):
    out = tmp_path_factory.mktemp("hara") / "out"
    return reproduce_hara(out, quick=True, seed=3, loop=LOOP), out


@pytest.mark.slow
def test_every_method_of_the_paper_is_compared_and_drawn(reproduction):
    result, out = reproduction
    head, rows = result.table()
    assert len(rows) == 15
    assert all(len(row) == len(head) for row in rows)
    error = dict(zip([m.name for m in result.methods], result.errors[:, 0], strict=True))
    assert error["our RBPF-64, intensity"] < 0.25 * error["odometry"]
    assert error["our RBPF-64, intensity"] < 0.15
    assert error["paper's RBPF-64, raw intensity"] < error["odometry"]
    told = json.loads((out / "metrics.json").read_text())
    drawn = [m["figure"] for m in told["methods"] if m["figure"]]
    assert drawn == ["Fig. 4", "Fig. 5", "Fig. 6", "Fig. 7", "Fig. 7, ours"]
    assert np.isclose(told["methods"][-1]["ate_mean"], result.error("our graph, intensity, rims"))
    assert {p.name for p in (out / "figures").iterdir()} == {"maps.png", "geometry.png", "gate.png", "alpha.png"}
    assert (out / "figures" / "maps.png").stat().st_size > 10_000
    assert "Claim by claim" in (out / "report.html").read_text()
    assert len((out / "claims.md").read_text().splitlines()) == 2 + len(result.claims)
    assert {p.stem for p in (out / "tables").iterdir()} == {"methods", "gate", "walls", "bounds", "alpha", "starts"}


@pytest.mark.slow
def test_no_trusted_start_is_wrong_and_light_tells_what_walls_cannot(reproduction):
    result, _ = reproduction
    light, walls = (counts(result.starts, feature) for feature in ("normalised", "none"))
    assert light["wrong"] == walls["wrong"] == 0
    assert light["right"] >= 4
    assert light["right"] > walls["right"]
    twin = [s for s in result.starts if s.where == "twin"]
    assert [(s.feature, s.answer) for s in twin] == [("normalised", "not sure")]
    head, rows = starts_table(result.starts)
    assert all(len(row) == len(head) for row in rows)
    assert sum(int(row[3]) + int(row[4]) + int(row[5]) for row in rows if row[0] == "all") == len(result.starts)


@pytest.mark.slow
def test_the_best_geometry_is_the_least_of_all_rows_without_intensity(reproduction):
    result, _ = reproduction
    name, error = result.best("geometry")
    assert "geometry" in name
    assert error == min(e.mean() for m, e in zip(result.methods, result.errors, strict=True) if "geometry" in m.name)
    assert result.best("intensity", squared=True)[1] >= result.best("intensity")[1]


def test_the_printed_filter_is_the_papers_to_the_letter():
    assert (PRINTED.feature, PRINTED.likelihood, PRINTED.resample) == ("raw", "paper", 1.0)
    assert PRINTED.filter.proposal == "odometry"
    assert PRINTED.filter.refine_iterations == 0
    assert PRINTED.filter.update_distance == 0


@pytest.mark.long
@pytest.mark.eq("Hara07:5")
def test_where_matching_fails_the_gate_carries_the_map_and_refuses_rightly():
    rows = try_gate(range(2))
    for row in rows[1:]:
        assert (row.rightly >= 0.95 * row.outside).all()
    alone, gated = rows[-2:]
    assert alone.outside.min() > 20
    assert gated.ate.mean() < 0.75 * alone.ate.mean()
    assert gated.ate.mean() < 0.5 * rows[0].ate.mean()


def test_the_hard_ring_has_glass_sparse_stretches_and_turns_without_scans():
    cfg = CorridorConfig(long_leg=12.0, short_leg=8.0, distance=45.0, recess=0.0, corner=0.3)
    hard, again = (simulate_hard(cfg, 5) for _ in range(2))
    scans = hard.sim.log.scans
    assert np.array_equal(scans[7].ranges, again.sim.log.scans[7].ranges)
    assert len(scans) == len(hard.kept) == len(hard.sim.log.scan_t)
    glass = np.concatenate([s.hit[r == GLASS] for s, r in zip(scans, hard.sim.reflectance, strict=True)])
    assert 0.02 < glass.mean() < 0.12
    returns = np.array([s.hit.sum() for s in scans])
    sparse = 0.25 * hard.kept % SPARSE_EVERY > SPARSE_EVERY - SPARSE_LENGTH + 0.5
    assert returns[sparse].mean() < 0.3 * returns[~sparse].mean()
    turn = np.abs(np.diff(np.unwrap([s.odometry[2] for s in scans])))
    assert turn.max() > 0.6


def test_the_weight_of_intensity_is_found_from_the_log():
    sim = simulate_corridor(CorridorConfig(long_leg=20.0, short_leg=10.0, distance=25.0), seed=40)
    feature = choose_feature(sim.log, LaserConfig())
    seen = [beams(s, feature.name, feature.calibration, LaserConfig().beam) for s in sim.log.scans]
    odometry = np.array([s.odometry for s in sim.log.scans])
    alpha = estimate_alpha(seen, odometry)
    assert ALPHAS[1] < alpha < ALPHAS[-2]
    louder = [b._replace(q=2.0 * b.q) for b in seen]
    assert estimate_alpha(louder, odometry) == pytest.approx(alpha / 4)
    assert np.isnan(estimate_alpha(seen[:1], odometry[:1]))


def test_the_error_along_walls_is_that_of_the_way_in_straight_stretches():
    truth = np.zeros((100, 3))
    truth[:, 0] = 0.25 * np.arange(100)
    longer = truth * [1.03, 1.0, 1.0]
    assert along_error(truth, truth) == 0
    assert along_error(longer, truth) == pytest.approx(0.03 * 0.25 * STRETCH)
    turning = truth.copy()
    turning[:, 2] = 0.1 * np.arange(100)
    assert np.isnan(along_error(turning, turning))
