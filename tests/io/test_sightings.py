"""Sightings tables: what is read, what is left out and listed, what is refused with file and line."""

import numpy as np
import pytest

from mapweave.core.bearings import parse_angle
from mapweave.core.errors import DataError, ReaderError, UsageError
from mapweave.core.records import Track
from mapweave.io.sightings import read_sightings, read_swarm_truth
from mapweave.io.tum import read_track_covariance


def written(tmp_path, text, name="s.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_names_sort_as_numbers_and_blanks_and_comments_do_not_count(tmp_path):
    log = read_sightings(written(tmp_path, "# made by hand\n observer , target,bearing\n10,2,0.5\n\n2, 10 ,-2.64\n"))
    assert log.table.ids == ("2", "10")
    assert log.table.bearing() == pytest.approx([0.5, -2.64])
    assert list(log.lines) == [3, 5]


def test_a_byte_order_mark_and_windows_line_ends_are_understood(tmp_path):
    path = tmp_path / "s.csv"
    path.write_bytes(b"\xef\xbb\xbfobserver,target,bearing\r\na,b,0.5\r\nb,a,3.6\r\n")
    assert len(read_sightings(path).table.observer) == 2


def test_both_layouts_of_space_give_the_same_directions(tmp_path):
    az, el = 0.7, -0.3
    b = [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)]
    one = read_sightings(written(tmp_path, f"observer,target,azimuth,elevation\na,b,{az},{el}\n"))
    two = read_sightings(written(tmp_path, f"observer,target,bx,by,bz\na,b,{3 * b[0]},{3 * b[1]},{3 * b[2]}\n"))
    assert one.table.dim == two.table.dim == 3
    assert np.allclose(one.table.direction, two.table.direction)


def test_nan_and_self_sightings_are_left_out_counted_and_listed(tmp_path):
    text = "observer,target,bearing\na,b,0.1\na,c,nan\nb,b,0.2\nc,a,\nc,b,inf\nb,a,3.2\n"
    log = read_sightings(written(tmp_path, text))
    assert log.counts() == {"not a number": 3, "observer is target": 1}
    assert [(row.line, row.observer, row.target) for row in log.dropped] == [
        (3, "a", "c"),
        (4, "b", "b"),
        (5, "c", "a"),
        (6, "c", "b"),
    ]
    assert len(log.table.observer) == 2
    assert log.table.ids == ("a", "b", "c")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("observer,target,bearing\na,b,0.1\na,c,north\n", 3),
        ("observer,target,bearing\na,b,0.1\na,c\n", 3),
        ("observer,target,bearing\na,b,0.1,9\n", 2),
        ("observer,target,bearing\na,,0.1\n", 2),
        ("observer,target,bearing,sigma\na,b,0.1,-1\n", 2),
        ("observer,target,bearing,sigma\na,b,0.1,0.1\na,b,0.1,0\n", 3),
        ("observer,target,angle\na,b,0.1\n", 1),
        ("who,whom,bearing\na,b,0.1\n", 1),
        ("observer,target,bearing,bearing\na,b,0.1,0.1\n", 1),
        ("", 1),
    ],
)
def test_a_row_that_does_not_parse_is_an_error_naming_file_and_line(tmp_path, text, line):
    with pytest.raises(ReaderError, match=rf"s\.csv:{line}: expected|s\.csv:{line}: a column") as error:
        read_sightings(written(tmp_path, text))
    assert error.value.line == line


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ReaderError, match=r"nowhere\.csv: no such file"):
        read_sightings(tmp_path / "nowhere.csv")


@pytest.mark.parametrize("text", ["observer,target,bearing\n", "observer,target,bearing\na,a,0.1\n"])
def test_zero_sightings_are_refused(tmp_path, text):
    with pytest.raises(DataError, match="no sightings"):
        read_sightings(written(tmp_path, text))


@pytest.mark.parametrize("text", ["observer,target,bearing\na,,0.1\nb, ,0.2\n", "observer,bearing\na,0.1\nb,0.2\n"])
def test_sightings_that_do_not_say_who_was_seen_are_refused_in_plain_words(tmp_path, text):
    path = tmp_path / "s.csv"
    path.write_text(text)
    with pytest.raises(ReaderError, match="sightings without names are not located"):
        read_sightings(path)


def test_the_wrong_dimension_is_told(tmp_path):
    with pytest.raises(ReaderError, match="expected observer,target and azimuth,elevation or bx,by,bz"):
        read_sightings(written(tmp_path, "observer,target,bearing\na,b,0.1\n"), dim=3)


def test_degrees_in_place_of_radians_are_warned_about(tmp_path):
    log = read_sightings(written(tmp_path, "observer,target,bearing\na,b,90\nb,a,-90\na,c,1\n"))
    assert "degrees" in log.warnings[0]
    assert "2 of 3" in log.warnings[0]
    assert not read_sightings(written(tmp_path, "observer,target,bearing\na,b,6.2\nb,a,-3\n")).warnings
    space = "observer,target,azimuth,elevation\na,b,6.2,1.589\nb,a,-3,0.2\n"
    (told,) = read_sightings(written(tmp_path, space)).warnings
    assert "1 of 2 elevations lie beyond straight up or down (largest 1.589 rad)" in told


def test_covariances_without_rows_are_refused_in_one_line(tmp_path, recwarn):
    path = tmp_path / "robot1.cov.csv"
    path.write_text("t,xx,xy,yy,xt,yt,tt\n")
    with pytest.raises(ReaderError, match="of 2 poses beside it, found 0"):
        read_track_covariance(path, Track(np.arange(2.0), np.zeros((2, 3))))
    assert not recwarn.list


def test_a_table_of_robot_and_id_reads_as_observer_and_target(tmp_path):
    log = read_sightings(written(tmp_path, "t,robot,id,range,bearing\n0.0,1,2,3.5,0.1\n0.5,2,1,3.5,0.2\n"))
    assert log.table.ids == ("1", "2")
    assert log.table.t == pytest.approx([0.0, 0.5])


def test_rows_without_a_stamp_in_a_stamped_table_are_left_out(tmp_path):
    log = read_sightings(written(tmp_path, "observer,target,bearing,t\na,b,0.1,0\nb,a,3.2,\n"))
    assert log.counts() == {"no time stamp": 1}


def test_truth_reads_with_and_without_height_and_refuses_a_robot_that_stands_twice(tmp_path):
    truth = read_swarm_truth(written(tmp_path, "id,x,y\nb,1,2\na,3,4\n"))
    assert truth.ids == ("b", "a")
    assert truth.position.shape == (2, 2)
    assert read_swarm_truth(written(tmp_path, "id,x,y,z\nb,1,2,3\n")).position.shape == (1, 3)
    with pytest.raises(ReaderError, match="robot b stands twice"):
        read_swarm_truth(written(tmp_path, "id,x,y\nb,1,2\nb,3,4\n"))
    with pytest.raises(ReaderError, match=r"s\.csv:3: expected finite"):
        read_swarm_truth(written(tmp_path, "id,x,y\nb,1,2\na,nan,4\n"))


def test_angles_need_their_unit():
    assert parse_angle("0.5deg") == pytest.approx(np.deg2rad(0.5))
    assert parse_angle(" 0.0087 rad ") == pytest.approx(0.0087)
    for text in ("0.5", "deg", "-1deg", "0rad", "half a degree"):
        with pytest.raises(UsageError, match=r"unit|positive"):
            parse_angle(text)
