"""Tables of scans whose columns the caller names."""

import numpy as np
import pytest

import mapweave
from mapweave.cli import main
from mapweave.core.errors import DataError, ReaderError, UsageError
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.scan_table import scan_table

BEAMS = (-0.3, 0.1)
WALL = [2.0, 2.1, 2.2, 2.3]


def read(tmp_path, text, columns="t,x,y,theta,ranges"):
    path = tmp_path / "table.csv"
    path.write_text(text)
    return read_laser(path, "1", LaserSource(table=scan_table(columns, BEAMS)))


def row(t, x=0.0, mark=",", ranges=WALL):
    return mark.join(map(str, (t, x, 0.5, 0.1, *ranges))) + "\n"


@pytest.mark.parametrize("mark", [",", ";", " ", "\t", ", "])
@pytest.mark.parametrize("header", ["", "t,x,y,theta,r0\n", "# made by\n"])
def test_a_row_is_a_scan_with_its_stamp_and_pose(tmp_path, mark, header):
    log = read(tmp_path, header + row(1.0, 2.0, mark) + row(2.0, 3.0, mark))
    assert log.scan_t.tolist() == [1.0, 2.0]
    assert np.allclose(log.scans[0].ranges, WALL)
    assert np.allclose(log.scans[0].odometry, [2.0, 0.5, 0.1])
    assert np.allclose(log.scans[0].angles(), [-0.3, -0.2, -0.1, 0.0])
    assert log.odometry_from == "poses"
    assert log.warnings == ()


def test_columns_may_stand_in_any_order_and_be_left_out(tmp_path):
    log = read(
        tmp_path,
        "7,1,2,3,9,9,10,20,30,5\n7,1,2,4,9,9,10,20,40,6\n",
        "-,ranges:3,-:2,intensities:3,t",
    )
    assert log.scans[1].ranges.tolist() == [1, 2, 4]
    assert log.scans[1].intensities.tolist() == [10, 20, 40]
    assert log.scan_t.tolist() == [5, 6]
    assert [f.code for f in log.findings] == ["no-odometry"]


def test_without_a_column_of_stamps_scans_are_a_second_apart(tmp_path):
    log = read(tmp_path, "1 2 3\n2 3 4\n", "ranges")
    assert log.scan_t.tolist() == [0.0, 1.0]
    assert "stamps-none" in {f.code for f in log.findings}


def test_empty_words_and_what_is_no_number_of_a_range_are_no_returns(tmp_path):
    log = read(tmp_path, row(1, ranges=["", "nan", "inf", 2.0]) + row(2, ranges=[0, -1, 1e300, ""]))
    assert [s.hit.tolist() for s in log.scans] == [[False, False, False, True], [False] * 4]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (row(1) + row(2, ranges=WALL[1:]) + row(3), "table.csv:2: expected 8 words, found 7"),
        (row(1) + row("x7") + row(3), "table.csv:2: could not convert string to float: 'x7'"),
        ("1,2,3\n1,2,3\n", "table.csv:1: expected 5 words or more, found 3"),
    ],
)
def test_a_row_that_is_not_like_the_first_is_named_by_file_and_line(tmp_path, text, said):
    with pytest.raises(ReaderError, match=said):
        read(tmp_path, text)


def test_a_last_row_cut_short_is_dropped_and_counted_and_an_empty_table_is_told(tmp_path):
    log = read(tmp_path, row(1) + row(2)[:9])
    assert log.dropped == {"last line cut short": 1}
    with pytest.raises(DataError, match="no laser scan"):
        read(tmp_path, "t,x,y,theta,ranges\n")


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("t,x,y,theta", "expected ranges, and x,y,theta together"),
        ("t,x,y,ranges", "expected ranges, and x,y,theta together"),
        ("t,tehta,ranges", "found 'tehta'"),
        ("t,t,ranges", "found 't' twice"),
        ("ranges,t", r"only the last may have no number \(ranges:N\)"),
        ("ranges:0,t", "found 'ranges:0'"),
        ("ranges:99999999999999999999,t", "found 'ranges:9"),
        ("t:2,ranges", "found 't:2'"),
        ("", "found ''"),
    ],
)
def test_columns_that_cannot_be_are_a_usage_error(columns, said):
    with pytest.raises(UsageError, match=said):
        scan_table(columns, BEAMS)


@pytest.mark.parametrize("beams", [(0.0, 0.0), (np.nan, 1.0), (1.0,)])
def test_beams_that_cannot_be_are_a_usage_error(beams):
    with pytest.raises(UsageError, match="--beams: expected"):
        scan_table("ranges", beams)


def test_the_command_line_maps_a_table_and_names_what_is_missing(tmp_path, capsys):
    angles = np.radians(np.arange(-90, 91, 2))
    with np.errstate(divide="ignore"):
        walls = np.minimum(4.0 / np.maximum(np.cos(angles), 1e-3), 3.0 / np.maximum(np.abs(np.sin(angles)), 1e-3))
    path = tmp_path / "table.txt"
    path.write_text("".join(row(t, 0.0, " ", walls.round(3)) for t in range(12)))
    words = ["map", str(path), "--out", str(tmp_path / "out"), "--columns", "t,x,y,theta,ranges"]
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert "expected both, found no --beams FIRST,STEP" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stopped:
        main([*words, "--beams", "-90,2"])
    assert stopped.value.code in {0, None}
    assert (tmp_path / "out" / "map.pgm").is_file()


def test_python_maps_a_table_with_beams_in_radians(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("".join(row(t) for t in range(5)))
    laser = mapweave.LaserOptions(columns="t,x,y,theta,ranges", beams=(-0.3, 0.1))
    assert [len(made.scans) for made in mapweave.map(path, laser=laser).maps] == [5]
