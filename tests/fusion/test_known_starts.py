"""Maps tied by where a robot is known to have started, or by single sightings."""

import numpy as np

from mapweave.core import se2
from mapweave.core.gaussian import is_positive_definite
from mapweave.fusion.config import START_TOLERANCE
from mapweave.fusion.result import APART, Component, Decision, Fusion, placed_by, tie_by_starts
from mapweave.landmarks.landmark_map import LandmarkMap

TOLERANCE = START_TOLERANCE


def component(robots, ids, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2 * len(ids), 2 * len(ids)))
    frames = {r: np.zeros(3) if k == 0 else rng.normal(size=3) for k, r in enumerate(robots)}
    landmarks = LandmarkMap(ids, rng.normal(size=(len(ids), 2)), A @ A.T + np.eye(2 * len(ids)))
    return Component(robots, landmarks, frames, {r: 0.01 * np.eye(3) for r in robots}, dict.fromkeys(ids, robots))


def a_fusion():
    parts = (component(("robot2", "robot3"), ("9", "10", "11"), 0), component(("robot1",), ("6", "9"), 1))
    decisions = tuple(Decision(f"robot{k}", 0, "refused", "shares too little") for k in (1, 2, 3))
    return Fusion(parts, decisions)


def test_a_known_start_places_a_whole_component_into_the_lowest_robots_map():
    start = (4.0, -1.0, 0.8)
    before = a_fusion()
    after = tie_by_starts(before, {"robot3": start}, TOLERANCE)
    (one,) = after.components
    assert one.robots == ("robot1", "robot2", "robot3")
    assert one.map.ids == ("6", "9", "10", "11")
    assert np.allclose(one.frames["robot3"], start)
    apart = before.components[0].frames
    assert np.allclose(
        se2.between(one.frames["robot2"], one.frames["robot3"]), se2.between(apart["robot2"], apart["robot3"])
    )
    assert np.array_equal(one.map.mean[:2], before.components[1].map.mean)
    T = se2.compose(np.array(start), se2.inverse(apart["robot3"]))
    assert np.allclose(one.map.mean[2:], se2.act(T, before.components[0].map.mean[1:]))
    assert is_positive_definite(one.map.cov)
    assert one.members["9"] == ("robot1", "robot2", "robot3")
    assert {d.robot: d.decision for d in after.decisions} == {
        "robot1": "reference",
        "robot2": "merged",
        "robot3": "merged",
    }


def test_without_a_start_nothing_changes():
    before = a_fusion()
    assert tie_by_starts(before, {}, TOLERANCE) is before
    assert len(tie_by_starts(before, {"robot1": (0.0, 0.0, 0.0)}, TOLERANCE).components) == 2


def test_a_start_that_contradicts_the_landmarks_is_told():
    before = tie_by_starts(a_fusion(), {"robot2": (0.0, 0.0, 0.0)}, TOLERANCE)
    after = tie_by_starts(before, {"robot2": (5.0, 0.0, 0.0)}, TOLERANCE)
    assert any("5.00 m from the one given" in w for w in after.warnings)
    assert after.components == before.components


def test_a_refused_robot_that_single_sightings_place_is_merged_and_one_that_stays_apart_is_not():
    decisions = (
        Decision("robot1", 9, "reference", "its first pose is the map's frame"),
        Decision("robot2", 0, "refused", f"shares fewer than 2 landmarks with the others{APART}"),
        Decision("robot3", 3, "refused", "contradicts robot1"),
        Decision("robot4", 5, "refused", "contradicts robot1"),
    )
    fusion = Fusion((), decisions)
    before = [["robot1"], ["robot2"], ["robot3", "robot4"]]
    told = placed_by(fusion, "single sightings", before, [["robot1", "robot2"], ["robot3", "robot4"]]).decisions
    assert [d.decision for d in told] == ["reference", "merged", "refused", "refused"]
    assert told[1].reason == "shares fewer than 2 landmarks with the others; placed by single sightings"
    assert placed_by(fusion, "single sightings", before, before) == fusion
    assert placed_by(fusion, "single sightings", before, []) == fusion
