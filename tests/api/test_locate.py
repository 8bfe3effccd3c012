"""`mapweave locate`: its files and keys, what it says of bad input, and that its covariance is honest."""

import csv
import json
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mapweave
from mapweave.api.locate import parse_anchors, parse_distances
from mapweave.cli import _run
from mapweave.core.bearings import parse_angle
from mapweave.core.errors import DataError, UsageError
from mapweave.sim.swarm import SwarmScene

pytestmark = pytest.mark.drawn

# The paper's five robots: every neighbour is 10 m away.
FIVE = {"1": (0.0, 0.0), "2": (10.0, 0.0), "3": (20.0, 0.0), "4": (5.0, 75**0.5), "5": (15.0, 75**0.5)}
KEYS = [
    "version", "seed", "rmse", "crlb_rmse", "rmse_over_crlb", "nees_per_dof", "iterations", "chi2", "dof", "gauge",
    "null_space", "not_localisable", "reliable", "distance_error", "angle_error_deg", "timing",
]  # fmt: skip


def rows_of(places, sigma_deg=0.1, seed=0, pairs=None):
    rng = np.random.default_rng(seed)
    rows = []
    for a, b in pairs or permutations(places, 2):
        d = np.subtract(places[b], places[a])
        rows.append(f"{a},{b},{np.arctan2(d[1], d[0]) + rng.normal() * np.deg2rad(sigma_deg)}")
    return rows


def table(tmp_path, rows, head="observer,target,bearing", name="s.csv"):
    path = tmp_path / name
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


def run(tmp_path, path, *words):
    """Exit code and metrics (None where there are none)."""
    out = tmp_path / "out"
    code = _run(["locate", str(path), "--out", str(out), "--sigma", "0.1deg", *words])
    metrics = out / "metrics.json"
    return code, json.loads(metrics.read_text()) if metrics.is_file() else None


TWO = ("--anchor", "1=0,0", "--anchor", "2=10,0")


def positions(tmp_path):
    with (tmp_path / "out" / "positions.csv").open() as file:
        return {row["id"]: row for row in csv.DictReader(file)}


def test_the_papers_five_robots_are_found_and_every_contracted_key_is_written(tmp_path, capsys):
    truth = table(tmp_path, [f"{k},{x},{y}" for k, (x, y) in FIVE.items()], "id,x,y", "truth.csv")
    code, metrics = run(tmp_path, table(tmp_path, rows_of(FIVE)), *TWO, "--truth", str(truth))
    assert code == 0
    assert set(KEYS) <= set(metrics)
    assert metrics["gauge"] == ""
    assert metrics["null_space"] == 0
    assert metrics["reliable"] is True
    assert metrics["rmse"] < 0.1
    assert metrics["distance_error"] < 0.1
    assert metrics["angle_error_deg"] < 0.2
    head = (tmp_path / "out" / "positions.csv").read_text().splitlines()[0]
    assert head == "id,x,y,var_x,cov_xy,var_y,localisable,sightings,outliers"
    found = positions(tmp_path)
    assert float(found["5"]["x"]) == pytest.approx(15.0, abs=0.2)
    assert found["1"]["sightings"] == "8"
    for name in ("report.html", "figures/network.png", "figures/spread.png", "figures/residuals.png"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    assert "sigma 0.1 deg (as given)" in capsys.readouterr().out


def test_without_anchors_the_shape_is_answered_and_said_to_be_one(tmp_path, capsys):
    truth = table(tmp_path, [f"{k},{x},{y}" for k, (x, y) in FIVE.items()], "id,x,y", "truth.csv")
    code, metrics = run(tmp_path, table(tmp_path, rows_of(FIVE)), "--truth", str(truth))
    assert code == 0
    assert "scale free" in metrics["gauge"]
    assert metrics["null_space"] == 3
    assert metrics["alignment"] == "place and scale"
    assert metrics["rmse"] < 0.05
    assert metrics["angle_error_deg"] < 0.2
    assert "the answer is the shape alone" in capsys.readouterr().out
    assert (tmp_path / "out" / "figures" / "shape.png").is_file()


def test_a_known_distance_takes_the_place_of_a_second_anchor(tmp_path):
    code, metrics = run(tmp_path, table(tmp_path, rows_of(FIVE)), "--anchor", "1=0,0", "--distance", "4,5=10")
    assert code == 0
    assert metrics["gauge"] == ""
    assert float(positions(tmp_path)["3"]["x"]) == pytest.approx(20.0, abs=0.2)


@pytest.mark.parametrize("head", ["observer,target,azimuth,elevation", "observer,target,bx,by,bz"])
def test_three_dimensions_have_columns_for_height(tmp_path, head):
    rng = np.random.default_rng(1)
    places = {f"r{k}": p for k, p in enumerate(rng.uniform(0.0, 20.0, (8, 3)))}
    rows = []
    for a, b in permutations(places, 2):
        u = (places[b] - places[a]) / np.linalg.norm(places[b] - places[a])
        values = u if "bx" in head else (np.arctan2(u[1], u[0]), np.arcsin(u[2]))
        rows.append(",".join([a, b, *map(str, values)]))
    known = [w for k in ("r0", "r1") for w in ("--anchor", f"{k}=" + ",".join(map(str, places[k])))]
    code, metrics = run(tmp_path, table(tmp_path, rows, head), "--dim", "3", *known)
    assert code == 0
    assert metrics["dim"] == 3
    found = positions(tmp_path)
    assert list(found["r2"])[:10] == ["id", "x", "y", "z", "var_x", "cov_xy", "var_y", "cov_xz", "cov_yz", "var_z"]
    assert float(found["r5"]["z"]) == pytest.approx(places["r5"][2], abs=1e-3)


def test_the_sigma_used_is_said_where_nobody_gave_one(tmp_path, capsys):
    out = tmp_path / "out"
    assert _run(["locate", str(table(tmp_path, rows_of(FIVE))), "--out", str(out), *TWO]) == 0
    assert "sigma 1 deg (assumed" in capsys.readouterr().out


def test_two_neighbouring_anchors_of_many_robots_are_called_weak():
    made = mapweave.simulate_swarm(scene=SwarmScene(robots=400, sigma=np.deg2rad(2.0)))
    known = {made.table.ids[k]: made.position[0][k] for k in (0, 1)}
    found = mapweave.locate(made.table, anchors=known)
    assert found.metrics["weak_anchors"] is True
    assert any("weak anchors" in text for text in found.warnings)


def test_robots_without_a_common_axis_are_noticed_and_located_with_their_headings(tmp_path):
    made = tmp_path / "g.csv"
    _run(["simulate", "swarm", "--out", str(made), "--robots", "30", "--sigma", "0.5deg", "--no-axis"])
    truth = list(csv.DictReader((tmp_path / "g.truth.csv").open()))
    known = {row["id"]: (float(row["x"]), float(row["y"])) for row in (truth[0], truth[-1])}
    found = mapweave.locate(made, anchors=known, truth=tmp_path / "g.truth.csv")
    assert found.metrics["axis"] is False
    assert any("no common axis" in text for text in found.warnings)
    assert found.score.rmse < 0.5
    error = found.estimate.heading - np.array([float(row["heading"]) for row in truth])
    assert np.abs(np.angle(np.exp(1j * error))).max() < np.deg2rad(3.0)


def test_robots_in_space_without_common_axes_are_located_and_turned(tmp_path):
    made = mapweave.simulate_swarm(scene=SwarmScene(robots=27, dim=3, axis=False))
    known = {made.table.ids[k]: made.position[0][k] for k in made.corners}
    found = mapweave.locate(replace(made.table, axis=True), tmp_path / "out", anchors=known)
    assert any("own axes are estimated" in w for w in found.warnings)
    assert found.estimate.reliable
    assert np.linalg.norm(found.estimate.position - made.position[0], axis=1).max() < 1.5
    rows = list(csv.DictReader((tmp_path / "out" / "positions.csv").open()))
    turns = np.array([[float(row[name]) for name in ("rx", "ry", "rz")] for row in rows])
    off = Rotation.from_rotvec(turns) * Rotation.from_rotvec(made.heading[0]).inv()
    assert np.degrees(off.magnitude()).max() < 5.0
    assert all(0.0 < float(row["var_rx"]) < np.radians(3.0) ** 2 for row in rows)


def test_a_network_in_which_nobody_is_held_says_so_and_still_draws_it(tmp_path):
    code, metrics = run(tmp_path, table(tmp_path, ["1,2,0.0", "2,3,1.5"]), "--anchor", "1=0,0", "--anchor", "3=5,5")
    assert code == 0
    assert (tmp_path / "out" / "report.html").is_file()
    assert metrics["rmse"] is None


# Bad input, each as the issue lists it.


def test_nan_and_self_sightings_are_dropped_counted_and_listed(tmp_path):
    path = table(tmp_path, [*rows_of(FIVE), "1,3,nan", "2,2,0.5"])
    code, metrics = run(tmp_path, path, *TWO)
    assert code == 0
    assert metrics["dropped"] == {"not a number": 1, "observer is target": 1}
    assert [row["line"] for row in metrics["dropped_rows"]] == [22, 23]
    assert (tmp_path / "out" / "dropped.csv").read_text().splitlines()[1] == "22,1,3,not a number"


def test_a_row_that_does_not_parse_ends_with_1_and_names_its_line(tmp_path, capsys):
    code, metrics = run(tmp_path, table(tmp_path, [*rows_of(FIVE), "1,3,north"]), *TWO)
    assert (code, metrics) == (1, None)
    assert "s.csv:22: expected a number for bearing, found 'north'" in capsys.readouterr().err


def test_an_unknown_anchor_is_an_error_that_names_it(tmp_path, capsys):
    code, metrics = run(tmp_path, table(tmp_path, rows_of(FIVE)), "--anchor", "1=0,0", "--anchor", "9=1,1")
    assert (code, metrics) == (1, None)
    assert "anchor '9' never appears" in capsys.readouterr().err


def test_two_rows_that_contradict_each_other_are_both_left_out(tmp_path):
    code, metrics = run(tmp_path, table(tmp_path, [*rows_of(FIVE), "1,3,1.5"]), *TWO)
    assert code == 0
    assert metrics["dropped"] == {"contradicts another row": 2}
    assert metrics["reliable"] is True
    assert any("contradict" in text for text in metrics["warnings"])


def test_of_three_sightings_of_a_pair_only_the_odd_one_is_left_out(tmp_path):
    path = table(tmp_path, [*rows_of(FIVE), "1,3,0.001", "1,3,1.5"])
    _, metrics = run(tmp_path, path, *TWO)
    assert metrics["dropped"] == {"contradicts another row": 1}
    assert metrics["dropped_rows"][0]["line"] == 23


def test_a_disconnected_network_lists_the_part_that_no_anchor_reaches(tmp_path):
    far = {"6": (50.0, 0.0), "7": (60.0, 0.0), "8": (55.0, 8.0)}
    code, metrics = run(tmp_path, table(tmp_path, [*rows_of(FIVE), *rows_of(far)]), *TWO)
    assert code == 0
    assert metrics["not_localisable"] == ["6", "7", "8"]
    found = positions(tmp_path)
    assert (found["5"]["localisable"], found["6"]["localisable"]) == ("1", "0")
    assert found["6"]["var_x"] == ""
    assert float(found["5"]["x"]) == pytest.approx(15.0, abs=0.2)


@pytest.mark.parametrize("method", ["batch", "robust", "distributed", "ekf", "iekf"])
def test_a_network_in_which_everybody_is_an_anchor_is_answered(tmp_path, method):
    (tmp_path / "s.csv").write_text("observer,target,bearing\na,b,0.0\nb,a,3.14159\na,c,0.785398\n")
    known = {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": (1.0, 1.0)}
    found = mapweave.locate(tmp_path / "s.csv", tmp_path / "out", anchors=known, method=method)
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["dof"] == 3
    assert metrics["rmse"] is None
    rows = list(csv.DictReader((tmp_path / "out" / "positions.csv").open()))
    assert {row["id"]: (float(row["x"]), float(row["y"])) for row in rows} == known
    assert found.metrics["not_localisable"] == []


def test_robots_all_on_one_line_cannot_be_located_along_it(tmp_path):
    line = {str(k): (10.0 * k, 0.0) for k in range(1, 6)}
    code, metrics = run(tmp_path, table(tmp_path, rows_of(line)), "--anchor", "1=10,0", "--anchor", "5=50,0")
    assert code == 0
    assert metrics["not_localisable"] == ["2", "3", "4"]


def test_robots_all_at_one_point_give_an_answer_that_is_called_unreliable(tmp_path):
    rng = np.random.default_rng(0)
    rows = [f"{a},{b},{rng.uniform(-np.pi, np.pi)}" for a, b in permutations("abcde", 2)]
    code, metrics = run(tmp_path, table(tmp_path, rows), "--anchor", "a=1,1", "--anchor", "b=1,1")
    assert code == 0
    assert metrics["reliable"] is False


def test_a_truth_of_other_robots_is_refused(tmp_path, capsys):
    truth = table(tmp_path, ["x,0,0", "y,1,1"], "id,x,y", "truth.csv")
    code, metrics = run(tmp_path, table(tmp_path, rows_of(FIVE)), *TWO, "--truth", str(truth))
    assert (code, metrics) == (1, None)
    assert "names none of the robots" in capsys.readouterr().err
    assert run(tmp_path, table(tmp_path, rows_of(FIVE)), *TWO)[0] == 0
    assert _run(["evaluate", str(tmp_path / "out"), "--truth", str(truth)]) == 1


def test_zero_sightings_are_refused(tmp_path, capsys):
    code, metrics = run(tmp_path, table(tmp_path, []), *TWO)
    assert (code, metrics) == (1, None)
    assert "no sightings" in capsys.readouterr().err


@pytest.mark.parametrize("method", ["batch", "robust"])
@pytest.mark.parametrize("rows", [["a,b,0.1", "a,c,1.2", "c,b,2.0"], ["a,b,0.1", "a,c,1.2", "c,b,-1.0"]])
def test_sightings_that_nothing_checks_are_never_called_reliable(tmp_path, capsys, rows, method):
    code, metrics = run(tmp_path, table(tmp_path, rows), "--method", method)
    assert code == 0
    assert metrics["dof"] <= 0
    assert metrics["reliable"] is False
    assert any("no sightings are left over" in text for text in metrics["warnings"])
    assert "NOT reliable" in capsys.readouterr().out


def test_degrees_in_place_of_radians_are_warned_about_and_not_trusted(tmp_path):
    rows = [",".join([*row.split(",")[:2], str(np.degrees(float(row.split(",")[2])))]) for row in rows_of(FIVE)]
    code, metrics = run(tmp_path, table(tmp_path, rows), *TWO)
    assert code == 0
    assert "are they degrees?" in metrics["warnings"][0]
    assert metrics["reliable"] is False


@pytest.mark.parametrize(
    "words",
    [
        ["--anchor", "1"], ["--anchor", "1=0"], ["--anchor", "1=0,0,0"], ["--anchor", "1=0,0", "--anchor", "1=1,1"],
        ["--distance", "1=10"], ["--distance", "1,2=-1"], ["--distance", "1,1=5"], ["--method", "magic"],
        ["--sigma", "1"], ["--dim", "4"], ["--odometry", "nowhere.csv"],
    ],
)  # fmt: skip
def test_bad_usage_ends_with_2_and_writes_nothing(tmp_path, words):
    out = tmp_path / "out"
    code = _run(["locate", str(table(tmp_path, rows_of(FIVE))), "--out", str(out), *words])
    assert code == 2
    assert not out.exists()


def test_another_folder_is_not_overwritten_without_force(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("keep")
    path = table(tmp_path, rows_of(FIVE))
    assert _run(["locate", str(path), "--out", str(out), *TWO]) == 2
    assert (out / "mine.txt").read_text() == "keep"
    assert _run(["locate", str(path), "--out", str(out), *TWO, "--force"]) == 0


def test_equal_runs_differ_in_timing_only(tmp_path):
    path = table(tmp_path, rows_of(FIVE))
    _, first = run(tmp_path, path, *TWO)
    bytes_first = (tmp_path / "out" / "positions.csv").read_bytes()
    _, again = run(tmp_path, path, *TWO)
    assert (tmp_path / "out" / "positions.csv").read_bytes() == bytes_first
    first.pop("timing"), again.pop("timing")
    assert first == again


def test_evaluate_scores_the_folder_that_locate_wrote(tmp_path, capsys):
    truth = table(tmp_path, [f"{k},{x},{y}" for k, (x, y) in FIVE.items()], "id,x,y", "truth.csv")
    _, metrics = run(tmp_path, table(tmp_path, rows_of(FIVE)), *TWO, "--truth", str(truth))
    capsys.readouterr()
    assert _run(["evaluate", str(tmp_path / "out"), "--truth", str(truth), "--json"]) == 0
    scored = json.loads(capsys.readouterr().out)
    assert scored["rmse"] == pytest.approx(metrics["rmse"], rel=1e-6)
    assert scored["distance_error"] == pytest.approx(metrics["distance_error"], rel=1e-6)


def test_the_covariance_is_honest_over_many_draws():
    ratios = []
    for seed in range(40):
        made = mapweave.simulate_swarm(seed=seed)  # 100 robots, 1 degree
        known = {made.table.ids[c]: made.position[0][c] for c in made.corners}
        found = mapweave.locate(made.table, anchors=known)
        value, dof = found.estimate.nees(made.position[0])
        ratios.append(value / dof)
    # 40 x 192 degrees of freedom: the standard deviation of the mean is 0.016.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_anchors_and_distances_parse_as_people_write_them():
    assert parse_anchors(["a=0,0", "b=10,0.5"]) == {"a": (0.0, 0.0), "b": (10.0, 0.5)}
    assert parse_anchors(["x=1=0,0,2"]) == {"x=1": (0.0, 0.0, 2.0)}
    assert parse_distances(["a, b=10"]) == [("a", "b", 10.0)]
    with pytest.raises(UsageError, match="given twice"):
        parse_anchors(["a=0,0", "a=0,1"])
    assert parse_angle("0.1deg") == pytest.approx(np.deg2rad(0.1))


def test_an_initial_guess_must_cover_every_robot(tmp_path):
    start = table(tmp_path, ["1,0,0", "2,10,0"], "id,x,y", "start.csv")
    with pytest.raises(DataError, match="no place for robot 3"):
        mapweave.locate(table(tmp_path, rows_of(FIVE)), initial=start, anchors={"1": (0, 0), "2": (10, 0)})


def test_a_swarm_of_anchors_alone_is_not_reliable_and_says_why(tmp_path):
    table = tmp_path / "sightings.csv"
    table.write_text("observer,target,bearing\na,b,0.1\nb,a,3.2416\n")
    result = mapweave.locate(table, anchors={"a": (0.0, 0.0), "b": (10.0, 0.0)})
    assert not result.estimate.reliable
    assert any("every robot is an anchor" in line for line in result.lines())
