"""Position fixes from recordings: what is read, what is not read by accident, what is left out and why."""

import numpy as np
import pytest

from mapweave.core.errors import ReaderError
from mapweave.core.fixes import EARTH
from mapweave.io.laser_logs import LaserSource, read_laser

from .ros_logs import Recording, driving, usual

TOKYO = np.array([35.7, 139.75, 40.0])


def with_fixes(path, n=30):
    out = usual(path, n)
    out.tf(9.9, "base_link", "gps", x=-0.3, y=0.1, topic="/tf_static")
    for k in range(0, n, 3):
        out.fix(10.02 + 0.1 * k, TOKYO + np.array([1e-6 * k, 0.0, 0.0]), 1.5)
    return out


@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
def test_fixes_of_satellites_are_read_with_their_noise_and_where_the_antenna_stands(tmp_path, suffix):
    log = read_laser(with_fixes(tmp_path / f"a{suffix}").write())
    assert len(log.fixes) == 10
    assert log.fixes.frame == EARTH
    assert log.fixes.topic == "/fix"
    assert log.fixes.antenna == pytest.approx([-0.3, 0.1])
    assert log.fixes.t == pytest.approx(10.02 + 0.3 * np.arange(10))
    assert log.fixes.place[:, 0] == pytest.approx(35.7 + 3e-6 * np.arange(10), abs=1e-12)
    assert log.fixes.cov == pytest.approx(np.tile(2.25 * np.eye(2), (10, 1, 1)))
    assert log.unused == ()


def test_fixes_that_tell_nothing_are_left_out_and_counted(tmp_path):
    out = with_fixes(tmp_path / "a.mcap")
    out.fix(10.1, TOKYO, status=-1)
    out.fix(10.2, [np.nan, 139.0, 0.0])
    out.fix(10.3, [35.0, 200.0, 0.0])
    out.fix(10.4, [0.0, 0.0, 0.0])
    out.fix(10.5, [*TOKYO[:2], np.nan])  # no height is no harm
    out.fix(10.5, TOKYO)
    log = read_laser(out.write())
    assert len(log.fixes) == 11
    assert log.fixes.dropped == {
        "fix without satellites": 1,
        "fix that is no number": 1,
        "fix whose latitude or longitude cannot be": 1,
        "fix at latitude 0, longitude 0": 1,
        "fix whose stamp comes again": 1,
    }


@pytest.mark.parametrize(
    "wrong", [np.zeros(9), np.full(9, np.nan), [-1.0, *[0.0] * 8], [1.0, 5.0, 0, 5.0, 1.0, 0, 0, 0, 1.0]]
)
def test_a_covariance_that_cannot_be_is_one_that_is_not_told(tmp_path, wrong):
    out = with_fixes(tmp_path / "a.mcap")
    out.fix(10.2, TOKYO, cov=wrong)
    out.fix(10.25, TOKYO, None)
    cov = read_laser(out.write()).fixes.cov
    assert np.isnan(cov).all(axis=(1, 2)).sum() == 2
    assert np.isfinite(cov).all(axis=(1, 2)).sum() == 10


def test_poses_by_others_are_input_where_they_are_asked_for_and_nowhere_else(tmp_path):
    out = usual(tmp_path / "a.mcap")
    for k in range(30):
        out.place(10.0 + 0.1 * k, [5.0 + 0.1 * k, 2.0, 0.5])
        out.place(
            10.0 + 0.1 * k, [1.0, 2.0, 0.0], topic="/amcl_pose", frame="map", cov=np.diag([0.04, 0.09, *[1.0] * 4])
        )
    path = out.write()
    plain = read_laser(path)
    assert plain.fixes is None
    assert {left.topic: left.reason for left in plain.unused} == {
        topic: f"poses by others may be the truth; --fixes {topic} reads their positions as input"
        for topic in ("/mocap/pose", "/amcl_pose")
    }
    mocap = read_laser(path, source=LaserSource(fixes="/mocap/pose"))
    assert mocap.fixes.frame == "mocap"
    assert mocap.fixes.place[3] == pytest.approx([5.3, 2.0, 0.5])
    assert np.isnan(mocap.fixes.cov).all()
    assert any("as input and not as truth" in f.text for f in mocap.findings)
    assert [left.topic for left in mocap.unused] == ["/amcl_pose"]
    other = read_laser(path, source=LaserSource(fixes="amcl_pose"))
    assert other.fixes.cov[0] == pytest.approx(np.diag([0.04, 0.09]))


def test_no_fixes_are_read_where_none_are_wanted_and_a_topic_that_is_not_there_is_an_error(tmp_path):
    path = with_fixes(tmp_path / "a.mcap").write()
    plain = read_laser(path, source=LaserSource(fixes="none"))
    assert plain.fixes is None
    assert [left.topic for left in plain.unused] == ["/fix"]
    with pytest.raises(ReaderError, match=r"--fixes: no topic 'gps' that tells positions; there are /fix"):
        read_laser(path, source=LaserSource(fixes="gps"))


def test_each_robot_has_the_receiver_of_its_namespace(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(20):
        for n, name in enumerate(("robot1", "robot2")):
            driving(out, name, k, base=f"{name}/base_link", laser=f"{name}/laser")
            out.fix(10.0 + 0.1 * k, TOKYO + np.array([n, 0.0, 0.0]), topic=f"/{name}/fix")
    path = out.write()
    for n, name in enumerate(("robot1", "robot2")):
        log = read_laser(path, source=LaserSource(name=name))
        assert log.fixes.topic == f"/{name}/fix"
        assert log.fixes.place[:, 0] == pytest.approx(35.7 + n)
