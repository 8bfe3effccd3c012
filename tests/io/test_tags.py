"""Tags and objects in recordings, as landmark logs."""

import json

import numpy as np
import pytest

import mapweave
from mapweave.api.map_landmarks import map_landmark_logs
from mapweave.api.map_options import LaserOptions, MapOptions
from mapweave.core import se2
from mapweave.core.errors import ReaderError, UsageError
from mapweave.io.landmark_logs import is_landmark_log, read_landmark_logs
from mapweave.io.tags import velocities

from ..team.fixed_teams import carrying, fixed
from .made_tags import tag_bag
from .ros_logs import Recording, wall

PLACES = {"4": (2.0, 1.5), "7": (3.5, -1.0), "12": (5.0, 2.0), "20": (3.0, 4.0), "31": (1.0, -1.8)}
CAMERA = (0.1, 0.0, 0.0)  # on the robot


def seen_from(pose, places, camera=CAMERA):
    """(name, place in the camera's frame, 0.4 m above it) of what lies within 4 m and ahead."""
    at = se2.act(se2.inverse(se2.compose(np.array(pose), np.array(camera))), np.array(list(places.values())))
    return [(n, (*p, 0.4)) for n, p in zip(places, at.tolist(), strict=True) if p[0] > 0.2 and np.hypot(*p) < 4.0]


def drive(n=300):
    """Poses of a robot on a gentle curve, 10 a second."""
    pose, out = np.zeros(3), []
    for k in range(n):
        out.append(pose)
        pose = se2.compose(pose, np.array([0.02, 0.0, 0.02 * np.sin(k / 40)]))
    return np.array(out)


def recorded(path, tell, *, places=PLACES, tf="static"):
    """A robot that drives past `places`, each frame told by `tell(recording, t, seen)`."""
    out = Recording(path)
    if tf:
        out.tf(9.0, "base_link", "camera", x=CAMERA[0], topic="/tf_static")
    for k, pose in enumerate(drive()):
        t = 10.0 + 0.1 * k
        out.odom(t, pose[0], y=pose[1], yaw=pose[2])
        tell(out, t + 0.02, seen_from(pose, places))
    return out


def as_frames(out, t, seen):
    out.tags(t, [int(name) for name, _ in seen])
    for name, (x, y, z) in seen:
        out.tf(t, "camera", f"tag36h11:{name}", x=x, y=y, z=z)


TOLD = {"objects": Recording.objects, "markers": Recording.markers, "frames": as_frames}


@pytest.mark.parametrize("name", ["a.mcap", "a.db3"])
@pytest.mark.parametrize("how", TOLD)
def test_ranges_and_bearings_are_those_from_the_robot_whatever_tells_the_tag(tmp_path, how, name):
    path = recorded(tmp_path / name, TOLD[how]).write()
    assert is_landmark_log(path)
    (log,) = read_landmark_logs(path)
    assert set(log.sightings.ids) == set(PLACES)
    assert log.findings == ()
    k = int(np.argmax(log.sightings.t > 12.0))
    pose = drive()[round((float(log.sightings.t[k]) - 10.02) / 0.1)]
    here = se2.act(se2.inverse(pose), np.array([PLACES[log.sightings.ids[log.sightings.what[k]]]]))[0]
    assert log.sightings.range[k] == pytest.approx(np.hypot(*here), abs=1e-6)
    assert log.sightings.bearing[k] == pytest.approx(np.arctan2(here[1], here[0]), abs=1e-6)
    told = [(u.topic, u.reason) for u in log.unused]
    assert told == ([("/detections", "corners in an image; the frames of tags in tf are read")] * (how == "frames"))


def test_a_recording_of_tags_becomes_the_map_of_the_tags(tmp_path):
    recorded(tmp_path / "a.mcap", Recording.objects).write()
    result = mapweave.map(tmp_path / "a.mcap", tmp_path / "out")
    marks = result.maps[0].landmarks
    true = np.array([PLACES[name] for name in marks.ids])
    assert set(marks.ids) == set(PLACES)
    assert np.abs(marks.mean - true).max() < 0.05
    assert json.loads((tmp_path / "out/metrics.json").read_text())["unused"] == []


def test_a_robot_with_a_scanner_is_mapped_by_its_tags_where_asked(tmp_path):
    out = recorded(tmp_path / "a.mcap", Recording.objects)
    for k in range(300):
        out.scan(10 + 0.1 * k, wall(k))
    path = out.write()
    assert not is_landmark_log(path)
    result = mapweave.map(path, tmp_path / "out", method="ekf")
    assert set(result.maps[0].landmarks.ids) == set(PLACES)
    (left,) = json.loads((tmp_path / "out/metrics.json").read_text())["unused"]
    assert (left["topic"], left["messages"]) == ("/scan", 300)
    assert "--method ekf" in left["reason"]


def test_a_name_at_two_places_in_one_frame_is_told_and_neither_is_used(tmp_path):
    def tell(out, t, seen):
        out.objects(t, [*seen, *((n, (x + 1.0, y, z)) for n, (x, y, z) in seen if n == "7")])

    (log,) = read_landmark_logs(recorded(tmp_path / "a.mcap", tell).write())
    (found,) = log.findings
    assert (found.code, found.value["name"]) == ("tag-twice", "7")
    assert "7" not in log.sightings.ids


def test_a_tag_that_moves_is_found_and_left_out(tmp_path):
    def tell(out, t, seen):
        out.objects(t, [*seen, ("99", (1.5 + 0.5 * np.sin(t / 5), 0.5 * np.cos(t / 5), 0.4))])  # carried along

    result = mapweave.map(recorded(tmp_path / "a.mcap", tell).write())
    assert "99" not in result.maps[0].landmarks.ids
    assert [f.value["name"] for f in result.findings if f.code == "landmark-moves"] == ["99"]


def test_a_camera_that_no_transform_places_is_told_and_taken_to_look_ahead(tmp_path):
    def tell(out, t, seen):
        out.markers(t, [(n, (-y, -z, x)) for n, (x, y, z) in seen], frame="camera_color_optical_frame")

    (log,) = read_landmark_logs(recorded(tmp_path / "a.mcap", tell, tf="").write())
    assert [f.code for f in log.findings] == ["sensor-unplaced"]
    assert np.abs(log.sightings.bearing).max() < np.pi / 2


def test_messages_that_hold_no_tag_are_counted_and_none_at_all_is_one_error(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(5):
        out.odom(10 + k, 0.1 * k)
        out.tags(10 + k, [3])
    with pytest.raises(ReaderError, match=r"no tag with a pose in it; there are /detections \(apriltag_msgs/msg/April"):
        read_landmark_logs(out.write())
    out = Recording(tmp_path / "b.mcap")
    for k in range(30):
        out.odom(10 + k, 0.1 * k)
        out.objects(10 + k, [("5", (2.0 - 0.1 * k, np.nan if k == 3 else 1.0, 0.0)), ("", (1.0, 1.0, 0.0))])
    (log,) = read_landmark_logs(out.write())
    assert len(log.sightings) == 29


def test_velocities_lead_from_pose_to_pose_to_the_last_digit():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.01, 0.3, 50))
    v, w = rng.uniform(-1, 1, (2, 50))
    pose = [np.zeros(3)]
    for a, b, dt in zip(v, w, np.diff(t), strict=False):
        pose.append(se2.compose(pose[-1], se2.exp(np.array([a * dt, 0.0, b * dt]))))
    told = velocities(np.column_stack([t, pose]))
    assert np.allclose(told[:-1], np.column_stack([t, v, w])[:-1], atol=1e-9)


@pytest.mark.slow
def test_mrclam_as_a_recording_gives_the_map_of_mrclam(tmp_path, data):
    whole = read_landmark_logs(data / "mrclam" / "MRCLAM_Dataset6.zip")
    logs = [log.until(whole[0].span[0] + 60.0) for log in whole]
    again = read_landmark_logs(tag_bag(tmp_path / "mrclam.mcap", logs))
    for a, b in zip(logs, again, strict=True):
        assert a.robot == b.robot
        assert len(a.sightings) == len(b.sightings)
    one, two = (map_landmark_logs(read, MapOptions(), "").maps[0] for read in (logs, again))
    assert one.robots == two.robots
    order = [two.landmarks.ids.index(name) for name in one.landmarks.ids]
    assert np.abs(two.landmarks.mean[order] - one.landmarks.mean).max() < 1e-3


def test_fixes_of_every_robot_are_read_beside_its_tags(tmp_path):
    one = fixed(1)
    logs = carrying(one.logs, one.fixes(1.0, 1))
    again = read_landmark_logs(tag_bag(tmp_path / "pair.mcap", logs))
    for before, after in zip(logs, again, strict=True):
        assert after.fixes.topic == f"/{after.robot}/fix"
        assert after.fixes.antenna == pytest.approx([-0.3, 0.1])
        assert after.fixes.t == pytest.approx(before.fixes.t, abs=1e-6)
        assert after.fixes.place == pytest.approx(before.fixes.place, abs=1e-12)
        assert after.fixes.cov == pytest.approx(before.fixes.cov)
        assert f"/{after.robot}/fix" not in [left.topic for left in after.unused]
    none = read_landmark_logs(tmp_path / "pair.mcap", fixes="none")
    assert [log.fixes for log in none] == [None, None]
    (left,) = (left for left in none[0].unused if left.topic == "/robot1/fix")
    assert left.reason == "another receiver is read, or none was asked for; --fixes /robot1/fix reads this one"
    with pytest.raises(ReaderError, match="--fixes: no topic '/gps'"):
        read_landmark_logs(tmp_path / "pair.mcap", fixes="/gps")


def test_a_recording_of_tags_with_fixes_is_laid_by_them_unless_they_are_left_out(tmp_path):
    one = fixed(1)
    bag = tag_bag(tmp_path / "pair.mcap", carrying(one.logs, one.fixes(1.0, 1)))
    laid = mapweave.map(bag, robots=[1])
    assert laid.smoothed[0].georeference.topics == ("/robot1/fix",)
    off = mapweave.map(bag, robots=[1], laser=LaserOptions(fixes="none"))
    assert off.smoothed[0].georeference is None
    mapweave.simulate_landmarks(tmp_path / "set", robots=1, landmarks=4, minutes=0.1)
    with pytest.raises(UsageError, match="--fixes: only for laser logs"):
        mapweave.map(tmp_path / "set", laser=LaserOptions(fixes="/fix"))
