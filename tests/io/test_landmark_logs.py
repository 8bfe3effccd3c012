"""MRCLAM and CSV logs: what is read, what is mended and counted, what is refused and where."""

import shutil
import zipfile

import numpy as np
import pytest

from mapweave.core.errors import DataError, ReaderError
from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Odometry
from mapweave.io.landmark_logs import is_landmark_log, read_landmark_logs

from .mrclam_folder import drive, glances, rows, write


def refused(path, match, line=None):
    with pytest.raises(ReaderError, match=match) as told:
        read_landmark_logs(path)
    assert told.value.line == line
    return str(told.value)


def test_a_folder_and_a_zip_of_it_give_the_same_logs(tmp_path):
    folder = write(tmp_path / "set")
    archive = shutil.make_archive(str(tmp_path / "set"), "zip", tmp_path, "set")
    a, b = read_landmark_logs(folder), read_landmark_logs(tmp_path / "set.zip")
    assert archive.endswith("set.zip")
    assert [log.log_hash for log in a] == [log.log_hash for log in b]
    assert [log.robot for log in a] == ["robot1", "robot2"]
    assert a[0].sightings.counts() == {"6": 4, "7": 4}
    assert is_landmark_log(tmp_path)  # a folder around the folder is opened too


def test_carriage_returns_change_nothing(tmp_path):
    a = write(tmp_path / "a")
    b = shutil.copytree(a, tmp_path / "b")
    for file in b.iterdir():
        file.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
    assert [log.log_hash for log in read_landmark_logs(a)] == [log.log_hash for log in read_landmark_logs(b)]


def test_truth_files_change_nothing_and_make_no_robot(tmp_path):
    folder = write(tmp_path / "set")
    before = read_landmark_logs(folder)
    (folder / "Landmark_Groundtruth.dat").write_text("no numbers here")
    (folder / "Robot1_Groundtruth.dat").write_text("nor here")
    (folder / "Robot9_Groundtruth.dat").write_text("nor here")
    assert [log.log_hash for log in before] == [log.log_hash for log in read_landmark_logs(folder)]


def test_an_unlisted_barcode_is_a_landmark_from_twenty_sightings_and_a_misread_below(tmp_path):
    seen = sorted(glances(n=3) + glances(n=20, codes=(72,)) + glances(n=19, codes=(43,)))
    (log, _) = read_landmark_logs(write(tmp_path / "set", {1: (drive(), seen), 2: (drive(), glances())}))
    assert log.sightings.counts() == {"6": 3, "7": 3, "barcode:72": 20}
    assert log.dropped == {"misread barcode": 19}


def test_another_robot_is_seen_as_a_robot_and_its_own_barcode_is_a_misread(tmp_path):
    seen = glances(codes=(63, 14, 5))
    (log, _) = read_landmark_logs(write(tmp_path / "set", {1: (drive(), seen), 2: (drive(), glances())}))
    assert log.sightings.counts() == {"6": 4, "robot2": 4}
    assert log.dropped == {"misread barcode": 4}


def test_a_robot_without_files_is_no_robot_and_its_number_a_landmark(tmp_path):
    (log,) = read_landmark_logs(write(tmp_path / "set", {1: (drive(), glances(codes=(63, 14)))}))
    assert set(log.sightings.counts()) == {"2", "6"}


def test_a_robot_without_odometry_is_read_and_told(tmp_path):
    log = read_landmark_logs(write(tmp_path / "set", {1: (None, glances()), 2: (drive(), glances())}))[0]
    assert log.odometry is None
    assert any("no odometry" in w for w in log.warnings)


def test_an_empty_robot_does_not_stop_the_others(tmp_path):
    empty, full = read_landmark_logs(write(tmp_path / "set", {1: ([], []), 2: (drive(), glances())}))
    assert len(empty) == 0
    assert any("saw nothing" in w for w in empty.warnings)
    assert len(full.sightings) == 8


def test_a_team_that_saw_nothing_is_refused(tmp_path):
    with pytest.raises(DataError, match="no robot saw anything"):
        read_landmark_logs(write(tmp_path / "set", {1: (drive(), []), 2: (drive(), None)}))


def test_a_team_that_saw_bearings_alone_is_refused_for_that(tmp_path):
    (tmp_path / "odometry.csv").write_text("t,robot,v,w\n0,1,0.1,0\n1,1,0.1,0\n")
    (tmp_path / "sightings.csv").write_text("t,robot,id,range,bearing\n0.2,1,L1,,0.1\n0.5,1,L2,,0.3\n")
    with pytest.raises(DataError, match="no sighting has its range, and bearings alone begin no map"):
        read_landmark_logs(tmp_path)


def test_rows_that_are_not_finite_or_not_positive_are_dropped_and_counted(tmp_path):
    odometry = [*drive(), (1.0, np.nan, 0.0), (np.inf, 0.1, 0.0)]
    seen = [*glances(), (0.9, 63, -1.0, 0.0), (0.9, 63, 0.0, 0.0), (0.9, 81, 2.0, np.nan), (np.nan, 81, 2.0, 0.0)]
    (log, _) = read_landmark_logs(write(tmp_path / "set", {1: (odometry, seen), 2: (drive(), glances())}))
    assert log.dropped == {"odometry: not finite": 2, "sighting: not finite": 2, "sighting: range not positive": 2}
    assert len(log.sightings) == 8
    assert len(log.odometry.t) == 50


def test_rows_out_of_order_are_sorted_and_told_and_repeated_stamps_keep_the_last(tmp_path):
    odometry = drive()
    odometry = [*odometry[:10], odometry[11], odometry[10], *odometry[12:], (odometry[-1][0], 0.3, 0.0)]
    seen = glances()
    seen = [*seen[2:], *seen[:2], seen[0]]
    (log, _) = read_landmark_logs(write(tmp_path / "set", {1: (odometry, seen), 2: (drive(), glances())}))
    assert log.dropped == {"odometry: stamp repeated": 1, "sighting: told twice": 1}
    assert log.odometry.v[-1] == 0.3
    assert (np.diff(log.odometry.t) > 0).all()
    assert (np.diff(log.sightings.t) >= 0).all()
    assert sum("step back in time" in w for w in log.warnings) == 2


def test_a_word_in_a_line_names_file_and_line(tmp_path):
    folder = write(tmp_path / "set")
    file = folder / "Robot2_Odometry.dat"
    file.write_text(file.read_text().replace("0.060\t0.100", "0.060\tfast"))
    assert "Robot2_Odometry.dat:6:" in refused(folder, "expected a number for v, found 'fast'", 6)


def test_a_short_line_names_file_and_line(tmp_path):
    folder = write(tmp_path / "set")
    file = folder / "Robot1_Measurement.dat"
    file.write_text(file.read_text() + "0.9\t63\n")
    refused(folder, "expected 4 columns .*, found 2", 11)


def test_bytes_that_are_no_text_name_file_and_line(tmp_path):
    folder = write(tmp_path / "set")
    file = folder / "Robot1_Measurement.dat"
    file.write_bytes(file.read_bytes() + b"\xff\xfe\x00")
    refused(folder, "expected text", 11)


def test_a_barcode_that_is_no_whole_number_names_file_and_line(tmp_path):
    folder = write(tmp_path / "set")
    file = folder / "Robot1_Measurement.dat"
    file.write_text(rows([(0.1, 63.5, 2.0, 0.0)]))
    refused(folder, "expected a whole number for barcode, found 63.5", 3)


def test_missing_barcodes_are_refused(tmp_path):
    folder = write(tmp_path / "set")
    (folder / "Barcodes.dat").unlink()
    refused(folder, r"expected Barcodes\.dat")


def test_barcodes_that_do_not_parse_or_repeat_are_refused_with_the_line(tmp_path):
    folder = write(tmp_path / "set")
    file = folder / "Barcodes.dat"
    whole = file.read_text()
    file.write_text(whole + "nine 9\n")
    refused(folder, "expected a number for subject, found 'nine'", 8)
    file.write_text(whole + "9 63\n")
    refused(folder, "expected every number once", 8)
    file.write_text("# nothing\n")
    refused(folder, "found none")


def test_a_truncated_zip_is_refused(tmp_path):
    write(tmp_path / "set")
    file = shutil.make_archive(str(tmp_path / "set"), "zip", tmp_path, "set")
    data = (tmp_path / "set.zip").read_bytes()
    (tmp_path / "set.zip").write_bytes(data[: len(data) // 2])
    assert file in refused(tmp_path / "set.zip", "cut short")


def test_a_zip_with_a_damaged_member_is_refused(tmp_path):
    folder = write(tmp_path / "set")
    with zipfile.ZipFile(tmp_path / "set.zip", "w") as archive:
        for file in sorted(folder.iterdir()):
            archive.write(file, f"set/{file.name}")
    data = bytearray((tmp_path / "set.zip").read_bytes())
    at = data.index(b"tiny data set")
    data[at : at + 4] = b"TINY"
    (tmp_path / "set.zip").write_bytes(bytes(data))
    refused(tmp_path / "set.zip", "damaged")


def test_two_data_sets_in_one_zip_are_refused(tmp_path):
    write(tmp_path / "both" / "one")
    write(tmp_path / "both" / "two")
    refused(tmp_path / "both", "mixed")
    shutil.make_archive(str(tmp_path / "both"), "zip", tmp_path / "both")
    refused(tmp_path / "both.zip", "mixed")


def test_robots_recorded_on_different_days_are_refused(tmp_path):
    day = 86400.0
    refused(write(tmp_path / "a", {1: (drive(), glances()), 2: (drive(day), glances(day))}), "two mixed: robot2")
    refused(write(tmp_path / "b", {1: (drive(), glances(day)), 2: (drive(), glances())}), "its sightings starts 24.0 h")
    refused(write(tmp_path / "c", {1: (drive() + drive(day), glances())}), "stamps 24.0 h apart")


def test_a_single_stamp_far_away_is_dropped_and_counted(tmp_path):
    (log,) = read_landmark_logs(write(tmp_path / "set", {1: ([(1e9, 0.0, 0.0), *drive()], glances())}))
    assert log.dropped == {"odometry: stamp far from the rest": 1}


def test_what_is_no_log_is_refused(tmp_path):
    refused(tmp_path, "found neither")
    refused(tmp_path / "absent", "no such file")
    (tmp_path / "file").write_text("hello")
    refused(tmp_path / "file", "neither")


def test_asking_for_a_robot_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(DataError, match="no robot 9; there are 1, 2"):
        read_landmark_logs(write(tmp_path / "set"), [9])


def test_plain_csv_gives_the_same_log_as_mrclam(tmp_path):
    (tmp_path / "csv").mkdir()
    seen = [(t, k, i, r, b) for k in (1, 2) for t, i, r, b in glances()]
    names = {63: "6", 81: "7"}
    (tmp_path / "csv" / "odometry.csv").write_text(
        "robot,t,v,w\n" + "".join(f"{k},{t:.3f},{v},{w}\n" for k in (1, 2) for t, v, w in drive())
    )
    (tmp_path / "csv" / "sightings.csv").write_text(
        "t,robot,id,range,bearing\n" + "".join(f"{t:.3f},{k},{names[i]},{r},{b}\n" for t, k, i, r, b in seen)
    )
    plain, mrclam = read_landmark_logs(tmp_path / "csv"), read_landmark_logs(write(tmp_path / "set"))
    for a, b in zip(plain, mrclam, strict=True):
        assert a.log_hash == b.log_hash


def test_csv_mistakes_name_file_and_line(tmp_path):
    file = tmp_path / "sightings.csv"
    file.write_text("t,robot,id,range\n")
    refused(tmp_path, "expected the columns", 1)
    file.write_text("t,robot,id,range,bearing\n0,1,a,1,0\n0,1,b,far,0\n")
    refused(tmp_path, "expected a number for range, found 'far'", 3)
    file.write_text("t,robot,id,range,bearing\n0,one,a,1,0\n")
    refused(tmp_path, "expected a whole number for robot, found 'one'", 2)
    file.write_text("t,robot,id,range,bearing\n0,1,a,1\n")
    refused(tmp_path, "expected 5 columns, found 4", 2)
    file.write_text("t,robot,id,range,bearing\n0,1,,1,0\n")
    refused(tmp_path, "expected an id", 2)


def test_csv_robots_see_each_other_and_never_themselves(tmp_path):
    (tmp_path / "sightings.csv").write_text(
        "t,robot,id,range,bearing\n0,1,robot2,1,0\n0,1,robot1,1,0\n1,1,robot7,1,0\n1,2,oak,1,0\n"
    )
    one, two = read_landmark_logs(tmp_path)
    assert one.sightings.counts() == {"robot2": 1}
    assert one.dropped == {"sighting of itself or of no robot": 2}
    assert two.sightings.counts() == {"oak": 1}


def test_events_hold_every_row_once_in_order(tmp_path):
    (log, _) = read_landmark_logs(write(tmp_path / "set"))
    (whole,) = log.events()
    assert whole.t == log.span[1]
    middle = float(np.mean(log.span))
    for cuts in ((middle,), (log.span[0], middle, middle, log.span[1] + 1.0)):
        events = list(log.events(cuts))
        assert [e.t for e in events] == sorted(e.t for e in events)
        assert len(events) == len(set(cuts[: len(cuts) - (len(cuts) > 1)])) + 1
        odometry = [e.record.odometry for e in events if e.record.odometry is not None]
        for name in ("t", "v", "w"):
            together = np.concatenate([getattr(o, name) for o in odometry])
            assert np.array_equal(together, getattr(log.odometry, name))
        for name in ("t", "what", "range", "bearing"):
            together = np.concatenate([getattr(e.record, name) for e in events])
            assert np.array_equal(together, getattr(log.sightings, name))
        assert all(np.all(e.record.t <= e.t) for e in events)


def test_a_share_is_the_first_part_of_the_time_and_keeps_the_hash():
    t = np.linspace(0.0, 10.0, 101)
    table = SightingTable(t, np.zeros(101, np.int64), np.ones(101), np.zeros(101), ("a",))
    log = LandmarkLog("robot1", Odometry(t, t, t), table)
    part = log.share(0.25)
    assert part.span == (0.0, 2.5)
    assert part.log_hash == log.log_hash
    assert log.share(1.0) is log
    with pytest.raises(DataError, match="share"):
        log.share(0.0)


def test_a_log_with_one_number_changed_has_another_hash():
    t = np.arange(3.0)
    a = SightingTable(t, np.zeros(3, np.int64), np.ones(3), np.zeros(3), ("a",))
    b = SightingTable(t, np.zeros(3, np.int64), np.ones(3), np.array([0.0, 0.0, 1e-9]), ("a",))
    assert LandmarkLog("robot1", None, a).log_hash != LandmarkLog("robot1", None, b).log_hash


@pytest.mark.data
@pytest.mark.parametrize(
    ("number", "rows_of_odometry", "rows_of_sightings"),
    [(3, (121773, 121137, 123727, None, 123655), None), (6, None, 19371)],
)
def test_the_real_logs_are_read_whole(data, number, rows_of_odometry, rows_of_sightings):
    logs = read_landmark_logs(data / "mrclam" / f"MRCLAM_Dataset{number}.zip")
    assert [log.robot for log in logs] == [f"robot{k}" for k in range(1, 6)]
    if rows_of_odometry:
        assert tuple(None if log.odometry is None else len(log.odometry.t) for log in logs) == rows_of_odometry
    if rows_of_sightings:
        assert sum(len(log.sightings) for log in logs) == rows_of_sightings
    assert all(
        set(log.sightings.counts()) <= {str(k) for k in range(6, 21)} | {f"robot{k}" for k in range(1, 6)}
        for log in logs
    )


def test_a_sighting_without_a_range_tells_its_bearing_alone(tmp_path):
    home = tmp_path / "log"
    home.mkdir()
    told = ["1.0,1,6,2.5,0.1", "2.0,1,7,,0.2", "3.0,1,robot2,,-0.3", "4.0,1,6,nan,0.4", "5.0,2,6,1.0,0.0"]
    (home / "sightings.csv").write_text("\n".join(["t,robot,id,range,bearing", *told, ""]), encoding="utf-8")
    first, second = read_landmark_logs(home)
    assert first.sightings.counts() == {"6": 1}
    assert first.bearings.counts() == {"7": 1, "robot2": 1}
    assert np.isnan(first.bearings.range).all()
    np.testing.assert_allclose(first.bearings.bearing, [0.2, -0.3])
    assert sum(first.dropped.values()) == 1  # a range that is said but no number
    assert first.span == (1.0, 3.0)
    assert not len(second.bearings)
    assert first.until(2.5).bearings.counts() == {"7": 1}
    (home / "sightings.csv").write_text("t,robot,id,bearing\n1.0,1,6,0.1\n", encoding="utf-8")
    with pytest.raises(DataError, match="bearings alone begin no map"):
        read_landmark_logs(home)
    (home / "sightings.csv").write_text("t,robot,id\n1.0,1,6\n", encoding="utf-8")
    with pytest.raises(ReaderError, match="expected the columns"):
        read_landmark_logs(home)


def test_subjects_written_in_place_of_barcodes_are_read_as_such_and_told(tmp_path):
    right = read_landmark_logs(write(tmp_path / "a", {1: (drive(), glances(n=15, codes=(63, 81, 7, 14)))}))[0]
    wrong = read_landmark_logs(write(tmp_path / "b", {1: (drive(), glances(n=15, codes=(6, 7, 8, 2)))}))[0]
    assert right.warnings == ()
    assert wrong.warnings == ("its sightings tell subjects in place of barcodes: read as such",)
    assert wrong.sightings.counts() == right.sightings.counts() == {"6": 15, "7": 15, "8": 15, "2": 15}
