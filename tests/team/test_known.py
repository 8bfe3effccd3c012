"""Places known beforehand: starts and surveyed points give the frame, tie what nobody saw, and count as measured."""

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import ReaderError, UsageError
from mapweave.io.fixes import read_points
from mapweave.team.known import PlacePriors

from .mixed_teams import mixed

APART = {"lasers": 0, "cameras": 2, "bearings": 0, "rooms": 2, "landmarks": 12, "minutes": 2.0}


def team():
    return mixed(8, **APART)


def known_points(w, shift=(0.0, 0.0), only=None):
    names = [n for n in w.truth.survey.ids if only is None or n in only]
    at = dict(zip(w.truth.survey.ids, w.truth.survey.xy, strict=True))
    return PlacePriors(points={n: (at[n] + shift, 0.02) for n in names})


def start_of(w, robot):
    return w.truth.robots[robot].track.pose[0]


def test_robots_that_have_nothing_in_common_are_tied_by_their_starts():
    w = team()
    assert len(w.map().components) == 2
    starts = {robot: (start_of(w, robot), 0.05) for robot in ("robot1", "robot2")}
    made = w.map(known=PlacePriors(starts=starts))
    (whole,) = made.components
    assert whole.map.robots == ("robot1", "robot2")
    for robot, track in whole.map.tracks.items():
        assert np.hypot(*(track.pose[0] - start_of(w, robot))[:2]) < 0.1
    assert w.score(made).landmarks.rmse < 0.35


def test_starts_told_from_the_first_robot_leave_the_frame_its_first_pose():
    w = team()
    T = se2.between(start_of(w, "robot1"), start_of(w, "robot2"))
    known = PlacePriors.of({"robot2": tuple(T)}, {}, {}, ["robot1", "robot2"])
    assert known.own_frame
    (whole,) = w.map(known=known).components
    np.testing.assert_allclose(whole.map.tracks["robot1"].pose[0], 0.0, atol=0.05)
    np.testing.assert_allclose(whole.map.tracks["robot2"].pose[0], T, atol=0.1)


def test_a_survey_is_the_frame_and_makes_the_map_better():
    w = team()
    made = w.map(known=known_points(w))
    (whole,) = made.components
    at = dict(zip(w.truth.survey.ids, w.truth.survey.xy, strict=True))
    far = [np.linalg.norm(p - at[n]) for n, p in zip(whole.map.landmarks.ids, whole.map.landmarks.mean, strict=True)]
    assert max(far) < 0.05
    for robot, track in whole.map.tracks.items():
        true = w.truth.robots[robot].track
        e = track.pose - se2.interpolate(track.t, true.t, true.pose)
        assert np.median(np.hypot(e[:, 0], e[:, 1])) < 0.15


def test_a_wrong_start_and_exchanged_points_are_told_and_do_no_harm():
    w = team()
    names = list(w.truth.survey.ids)
    points, seen = dict(known_points(w).points), w.map().components[0].map.sightings
    a, b = sorted(seen, key=lambda name: -seen[name])[:2]
    points[a], points[b] = points[b], points[a]
    wrong = {"robot1": (start_of(w, "robot1") + np.array([20.0, 0.0, 0.0]), 0.05)}
    (whole,) = w.map(known=PlacePriors(starts=wrong, points=points)).components
    assert any(note.code == "start-contradicted" for note in whole.notes)
    assert sum(note.code == "survey-contradicted" for note in whole.notes) == 2
    at = dict(zip(names, w.truth.survey.xy, strict=True))
    far = [np.linalg.norm(p - at[n]) for n, p in zip(whole.map.landmarks.ids, whole.map.landmarks.mean, strict=True)]
    assert np.median(far) < 0.05
    assert max(far) < 0.3


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("id,x\n1,2\n", "expected the columns"),
        ("id,x,y\nL1,0,nan\n", "finite"),
        ("id,x,y,sd\nL1,0,0,0\n", "above 0"),
        ("id,x,y\nL1,0,0\nL1,1,1\n", "twice"),
        ("id,x,y\n", "found none"),
    ],
)
def test_tables_of_points_that_cannot_be_are_refused_with_the_line(tmp_path, text, why):
    file = tmp_path / "points.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ReaderError, match=why):
        read_points(file)


def test_map_takes_a_survey_of_landmark_logs_and_refuses_an_unknown_robot(tmp_path):
    made = mapweave.simulate_team(tmp_path / "team", lasers=0, cameras=1, bearings=0, landmarks=6, minutes=0.7, seed=3)
    file = tmp_path / "points.csv"
    file.write_text("id,x,y\n" + "".join(f"{n},{x},{y}\n" for n, (x, y) in made.landmarks.items()), encoding="utf-8")
    team = mapweave.map(tmp_path / "team", survey=file).maps[0]
    far = [np.linalg.norm(p - made.landmarks[n]) for n, p in zip(team.landmarks.ids, team.landmarks.mean, strict=True)]
    assert max(far) < 0.1
    with pytest.raises(UsageError, match="no robot 9"):
        mapweave.map(tmp_path / "team", start={"9": (0, 0, 0)})
