"""The score of a located swarm is the same whoever asks, and its NEES is the one that is a chi-square variable."""

import json

import numpy as np
import pytest

import mapweave
from mapweave.api.located import standing_swarm
from mapweave.cli import _run
from mapweave.core.errors import ReaderError
from mapweave.evaluation.swarm import marginal_nees, score_standing, squared_errors
from mapweave.io.positions import read_network, read_positions, track_files
from mapweave.io.sightings import SwarmTruth
from mapweave.sim.swarm import SwarmScene

SHARED = ("rmse", "nees_per_dof", "distance_error", "angle_error_deg", "alignment", "robots_scored",
          "robots_without_truth")  # fmt: skip


def named(tmp_path, made, names):
    """The sightings and the truth of `made` as files, robots called `names`; the corners as anchors."""
    table, t = made.table, made.table.t
    called = dict(zip(table.ids, names, strict=True))
    rows = [
        f"{called[table.ids[a]]},{called[table.ids[b]]},{z!r},{s!r}" + ("" if t is None else f",{float(t[k])!r}")
        for k, (a, b, z, s) in enumerate(
            zip(table.observer, table.target, table.bearing().tolist(), table.sigma.tolist(), strict=True)
        )
    ]
    head = "observer,target,bearing,sigma" + ("" if t is None else ",t")
    (tmp_path / "s.csv").write_text("\n".join([head, *rows]) + "\n")
    stamps = np.unique(t) if t is not None else [None]
    truth = [
        f"{called[name]},{x!r},{y!r}" + ("" if t is None else f",{float(stamp)!r}")
        for places, stamp in zip(made.position.tolist(), stamps, strict=True)
        for name, (x, y) in zip(table.ids, places, strict=True)
    ]
    (tmp_path / "truth.csv").write_text("\n".join(["id,x,y" + ("" if t is None else ",t"), *truth]) + "\n")
    return {names[c]: made.position[0][c] for c in made.corners}


def both(tmp_path, capsys, known, *words):
    """What `locate --truth` and then `evaluate` say."""
    out, truth = tmp_path / "out", tmp_path / "truth.csv"
    anchors = [word for name, (x, y) in known.items() for word in ("--anchor", f"{name}={x},{y}")]
    files = ["--out", str(out), "--truth", str(truth)]
    assert _run(["locate", str(tmp_path / "s.csv"), *files, *anchors, *words]) == 0
    capsys.readouterr()
    assert _run(["evaluate", str(out), "--truth", str(truth), "--json"]) == 0
    return json.loads((out / "metrics.json").read_text()), json.loads(capsys.readouterr().out)


def assert_same(a, b):
    for key in SHARED:
        assert b[key] == (pytest.approx(a[key], rel=1e-6) if isinstance(a[key], float) else a[key]), key


def test_moving_robots_with_any_name_are_scored_alike_by_locate_and_evaluate(tmp_path, capsys):
    made = mapweave.simulate_swarm(scene=SwarmScene(robots=9, steps=8), seed=3)
    names = [f"bot {k}" for k in range(6)] + ["bot_5", "Bot 5", "a/b"]  # three would share one file
    told, scored = both(tmp_path, capsys, named(tmp_path, made, names))
    assert told["moving"] is True
    assert told["robots_scored"] == scored["robots"] == 5
    assert 0.0 < told["rmse"] < 0.3
    assert_same(told, scored)


@pytest.mark.parametrize("anchored", [pytest.param(True, marks=pytest.mark.slow), False])
def test_standing_robots_are_scored_alike_by_locate_and_evaluate(tmp_path, capsys, anchored):
    made = mapweave.simulate_swarm(scene=SwarmScene(robots=60), seed=4)  # beyond 40: the paper's errors need the pairs
    known = named(tmp_path, made, [f"bot {k}" for k in range(60)])
    told, scored = both(tmp_path, capsys, known if anchored else {})
    assert (told["nees_per_dof"] is not None) == anchored
    assert told["distance_error"] is not None
    assert_same(told, scored)


def test_robots_without_a_truth_are_left_out_of_a_nees_that_stays_joint():
    made = mapweave.simulate_swarm(scene=SwarmScene(robots=40), seed=5)
    known = {made.table.ids[c]: made.position[0][c] for c in made.corners}
    found = mapweave.locate(made.table, anchors=known)
    chosen = np.array([7, 11, 12, 25])
    truth = SwarmTruth(tuple(made.table.ids[k] for k in chosen), made.position[0][chosen])
    score = score_standing(standing_swarm(found.network, found.estimate), truth).score
    e = (found.estimate.position - made.position[0])[chosen].ravel()
    assert score.nees_per_dof == pytest.approx(e @ np.linalg.solve(found.estimate.joint(chosen), e) / 8, rel=1e-8)
    assert (score.scored, score.without_truth) == (4, 36)


def test_joint_nees_has_the_spread_of_its_degrees_of_freedom_and_the_mean_of_marginals_has_not():
    joint, marginal = [], []
    for seed in range(60):
        made = mapweave.simulate_swarm(scene=SwarmScene(robots=64), seed=seed)
        near = (made.corners[0], made.corners[0] + 1)  # neighbours: the scale is nearly all of every error
        known = {made.table.ids[c]: made.position[0][c] for c in near}
        found = mapweave.locate(made.table, anchors=known).estimate
        value, dof = found.nees(made.position[0])
        joint.append(value / dof)
        free = ~found.anchor
        marginal.append(marginal_nees((found.position - made.position[0])[free], found.cov[free]))
    expected = np.sqrt(2 / dof)  # of a chi-square variable over its degrees of freedom
    assert np.mean(joint) == pytest.approx(1.0, abs=4 * expected / np.sqrt(60))
    assert np.std(joint) == pytest.approx(expected, rel=0.35)
    assert np.std(marginal) > 4 * expected


def test_marginal_nees_says_nothing_of_no_rows_or_singular_covariances():
    assert marginal_nees(np.zeros((0, 2)), np.zeros((0, 2, 2))) is None
    assert marginal_nees(np.ones((1, 2)), np.zeros((1, 2, 2))) is None
    cov = np.array([[[4.0, 1.0], [1.0, 2.0]]])
    e = np.array([[1.0, -2.0]])
    np.testing.assert_allclose(squared_errors(e, cov), e[0] @ np.linalg.inv(cov[0]) @ e[0])


def test_file_names_of_tracks_are_distinct_whatever_the_robots_are_called():
    ids = ["a b", "a_b", "A b", "a_b-2", "c", "ä.1"]
    files = track_files(ids)
    assert files["c"] == "c.csv"
    assert files["ä.1"] == "ä.1.csv"
    assert len({name.casefold() for name in files.values()}) == len(ids)
    assert track_files(["CON", "nul.1", "console"]) == {
        "CON": "CON_.csv",
        "nul.1": "nul.1_.csv",
        "console": "console.csv",
    }
    assert not any("/" in name or " " in name for name in track_files(["../x", "y z"]).values())


def test_a_damaged_result_is_one_clear_error(tmp_path, capsys):
    made = mapweave.simulate_swarm(scene=SwarmScene(robots=9), seed=1)
    both(tmp_path, capsys, named(tmp_path, made, made.table.ids))
    network = tmp_path / "out" / "network.npz"
    with pytest.raises(ReaderError, match=r"network\.npz: expected pairs of 3 robots"):
        read_network(network, 3)
    with np.load(network) as saved:
        held = dict(saved)
    np.savez(network, **{**held, "column": np.full(len(held["column"]), np.inf, np.float16)})
    with pytest.raises(ReaderError, match=r"network\.npz: column: expected values whole, found float16"):
        read_network(network, 9)
    network.write_bytes(b"PK damaged")
    with pytest.raises(ReaderError, match=r"network\.npz"):
        read_network(network, 9)
    table = tmp_path / "out" / "positions.csv"
    table.write_text(table.read_text().replace("var_x", "something"))
    with pytest.raises(ReaderError, match="expected columns id,x,y,var_x"):
        read_positions(table)
