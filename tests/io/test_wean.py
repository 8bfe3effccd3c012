"""Logs of `O` and `L` rows in centimetres."""

import numpy as np
import pytest

from mapweave.core.errors import ReaderError
from mapweave.io.laser_logs import LaserSource, is_laser_log, read_laser

WALL = [200 + k % 7 for k in range(180)]


def drive(t, x, y=0.0, theta=0.0):
    return f"O {x} {y} {theta} {t}"


def scan(t, ranges=WALL, pose=(100.0, 200.0, 0.5), ahead=25.0):
    x, y, theta = pose
    laser = (x + ahead * np.cos(theta), y + ahead * np.sin(theta), theta)
    return f"L {' '.join(map(str, (*pose, *laser, *ranges)))} {t}"


def written(tmp_path, *lines, end="\n"):
    path = tmp_path / "run.log"
    path.write_text("\n".join(lines) + end)
    return path


@pytest.mark.parametrize("first", [[], [drive(0.0, 90.0)]], ids=["scan first", "odometry first"])
def test_centimetres_become_metres_and_the_rows_tell_where_the_laser_stands(tmp_path, first):
    log = read_laser(written(tmp_path, *first, scan(1.0), drive(1.5, 110.0, 210.0, 0.6), scan(2.0)))
    assert np.allclose(log.scans[0].ranges[:3], [2.0, 2.01, 2.02])
    assert np.allclose(log.scans[0].odometry, [1.0, 2.0, 0.5])
    assert np.allclose(log.odometry.pose[-1], [1.1, 2.1, 0.6])
    assert np.allclose(log.scans[0].T_robot_sensor, [0.25, 0, 0])
    assert np.allclose(np.degrees(log.scans[0].angles()[[0, -1]]), [-89.5, 89.5])
    assert log.scan_t.tolist() == [1.0, 2.0]
    assert log.odometry_from == "poses"
    assert log.warnings == ()


def test_0_and_8191_and_what_is_not_a_number_are_no_returns(tmp_path):
    log = read_laser(written(tmp_path, scan(1.0, [0, 8191, 8183, "nan", -1, *WALL[5:]])))
    assert log.scans[0].hit[:6].tolist() == [False] * 5 + [True]
    assert np.isfinite(log.scans[0].ranges).all()


def test_laser_poses_that_wander_are_no_place_of_the_sensor(tmp_path):
    log = read_laser(written(tmp_path, *(scan(t, ahead=10.0 * t) for t in range(20))))
    assert np.allclose(log.scans[0].T_robot_sensor, 0)
    assert [f.code for f in log.findings] == ["sensor-unplaced"]


def test_a_sensor_pose_given_by_hand_counts(tmp_path):
    log = read_laser(written(tmp_path, scan(1.0)), "1", LaserSource(sensor_pose=(0.1, 0.2, 0.3)))
    assert np.allclose(log.scans[0].T_robot_sensor, [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (scan(2.0, WALL[1:]), "L needs 187 numbers, found 186"),
        ("O 1 2 3", "O needs 4 numbers, found 3"),
        ("O 1 2 x 4", "could not convert string to float: 'x'"),
        ("Q 1 2 3 4", "expected 'O x y theta t' or 'L .*, found 'Q'"),
    ],
)
def test_a_row_that_is_not_of_its_kind_is_named_by_file_and_line(tmp_path, bad, said):
    with pytest.raises(ReaderError, match=rf"run\.log:2: {said}"):
        read_laser(written(tmp_path, scan(1.0), bad, scan(3.0)))


def test_a_last_row_cut_short_is_dropped_and_counted(tmp_path):
    log = read_laser(written(tmp_path, scan(1.0), scan(2.0)[:-300], end=""))
    assert len(log.scans) == 1
    assert log.dropped == {"last line cut short": 1}


def test_few_rows_of_another_kind_do_not_hide_the_format(tmp_path):
    assert is_laser_log(written(tmp_path, "hello", *[drive(t, t) for t in range(3)]))
    assert not is_laser_log(written(tmp_path, "O come", "L is a letter", "O 1 2 3 4"))


@pytest.mark.data
@pytest.mark.parametrize(("run", "scans", "rows"), [(1, 713, 1505), (2, 2251, 3126), (4, 600, 823)])
def test_the_runs_in_wean_hall_are_read_whole(data, run, scans, rows):
    log = read_laser(data / "wean" / f"robotdata{run}.log.gz")
    assert (len(log.scans), len(log.odometry.t)) == (scans, rows)
    assert log.warnings == ()
    assert np.allclose(log.scans[0].T_robot_sensor, [0.25, 0, 0], atol=1e-4)


@pytest.mark.data
def test_beams_stand_in_the_middle_of_their_degree_as_straight_drives_tell(data):
    """A wheeled robot does not slip sideways, so what walls move by sideways is the error of the beams' angles."""
    from mapweave.io.scan_checks import scan_agreement

    off = []
    for run in (1, 4, 5):
        log = read_laser(data / "wean" / f"robotdata{run}.log.gz")
        off.append(np.degrees(scan_agreement(log.scans).direction))
    assert np.max(np.abs(off)) < 1.2
    assert abs(np.median(off)) < 0.3
