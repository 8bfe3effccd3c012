"""Relations between the poses of robots that drove one after the other count where one map holds them."""

import json

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.io.tum import write_tum

WAY = np.column_stack([0.5 * np.arange(40), np.sin(0.3 * np.arange(40)), 0.1 * np.arange(40)])


def result(folder, components, clock=0.0):
    """Two robots that drove the halves of one way, `clock` [s] apart."""
    shown = [(folder, components[0]), *((folder / "components" / str(k + 2), c) for k, c in enumerate(components[1:]))]
    for part, robots in shown:
        for k in robots:
            half = slice(0, 20) if k == "1" else slice(20, 40)
            t = 100.0 + np.arange(40.0)[half] + (clock if k == "2" else 0.0)
            write_tum(part / "trajectories" / f"robot{k}.tum", Track(t, WAY[half]))
    (folder / "metrics.json").write_text(json.dumps({"version": "1", "components": components}))
    return folder


def relations(path, pairs):
    rows = []
    for i, j in pairs:
        x, y, theta = se2.between(WAY[i], WAY[j])
        rows.append(f"{100.0 + i:.6f} {100.0 + j:.6f} {x:.9f} {y:.9f} 0 0 0 {theta:.9f}")
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_relation_from_one_robot_to_the_next_counts_in_one_map(tmp_path):
    truth = relations(tmp_path / "a.relations", [(1, 5), (3, 30), (22, 35)])
    score = mapweave.evaluate(result(tmp_path / "one", [["1", "2"]]), truth)
    assert (score.relations.used, score.robot) == (3, "robot1, robot2")
    assert score.relations.trans_mean == pytest.approx(0.0, abs=1e-5)


def test_robots_in_two_maps_and_robots_that_drove_at_once_are_scored_each_alone(tmp_path):
    truth = relations(tmp_path / "a.relations", [(1, 5), (2, 9), (3, 30), (22, 35)])
    apart = mapweave.evaluate(result(tmp_path / "two", [["1"], ["2"]]), truth)
    assert (apart.relations.used, apart.robot) == (2, "robot1")
    at_once = mapweave.evaluate(result(tmp_path / "once", [["1", "2"]], clock=-10.5), truth)
    assert (at_once.relations.used, at_once.robot) == (2, "robot1")


def test_the_robot_of_a_further_component_is_found_too(tmp_path):
    truth = relations(tmp_path / "a.relations", [(22, 35), (25, 30), (1, 3)])
    score = mapweave.evaluate(result(tmp_path / "two", [["1"], ["2"]]), truth)
    assert (score.relations.used, score.robot) == (2, "robot2")
