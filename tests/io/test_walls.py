"""What no reader may break on: each input once ended in a traceback, a hang or gigabytes, and gives one clear line."""

import dataclasses
import gzip
import io
import json
import os
import resource
import sqlite3
import struct
import subprocess
import sys
import threading
import zipfile
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from angulation import read_angulation
from PIL import Image

from mapweave.core.errors import DataError, MapweaveError, ReaderError
from mapweave.io.directory import read_json
from mapweave.io.landmark_logs import read_csv_landmarks, read_landmark_logs
from mapweave.io.landmark_truth import read_survey
from mapweave.io.laser_logs import read_laser
from mapweave.io.laser_map import read_grid, write_grid
from mapweave.io.local_map import read_local_map, write_local_map
from mapweave.io.ros_map import read_ros_map
from mapweave.io.salvage import LARGEST_CHUNK, _bag_chunks, _mcap_chunks, zstd
from mapweave.io.sightings import read_sightings, read_swarm_truth
from mapweave.io.team_map import read_landmarks, read_members, read_metrics
from mapweave.io.tum import read_tum
from mapweave.laser.laser_map import GridMap

from . import mrclam_folder
from .ros_logs import Recording, usual
from .test_local_map import some_map

ROOT = Path(__file__).parents[2]


def repacked(path, change):
    """The zip `path` with its entries (name -> bytes) changed."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    change(entries)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)


def entry(values, shape=None, descr=None):
    """An .npy entry of `values` that says it has another shape or type."""
    out, values = io.BytesIO(), np.asarray(values)
    fields = {"descr": descr or values.dtype.str, "fortran_order": False, "shape": shape or values.shape}
    np.lib.format.write_array_header_1_0(out, fields)
    return out.getvalue() + values.tobytes()


@pytest.mark.parametrize(
    ("name", "held", "said"),
    [
        (
            "mean",
            entry(np.zeros((2, 2)), shape=(10**12, 2)),
            "mean: expected at most 1000 MB in a file, found 16000000 MB",
        ),
        ("mean", entry(np.zeros((2, 2)), shape=(10**6, 2)), "mean: 16000000 bytes promised, found 32"),
        ("mean", entry(np.zeros((2, 2)), shape=(-1, 2)), "mean: expected the shape landmarksx2, found -1x2"),
        ("mean", entry(np.zeros(4)), "mean: expected the shape landmarksx2, found 4"),
        ("mean", entry(np.full((2, 2), np.nan)), "mean: expected finite numbers"),
        ("mean", entry(np.zeros((2, 2), dtype=complex)), "mean: expected landmarksx2 number, found complex128"),
        ("mean", entry(np.zeros((2, 2)), descr="|O"), "mean: expected landmarksx2 number, found object"),
        ("mean", b"\x93NUMPY\x01\x00\x46\x00{'descr': '<f8', 'shape': (", "expected saved arrays: "),
        ("seen_target", entry(np.array([0, 9, 1])), "expected as many robots as local_map.npz holds, found 2"),
        ("track_t", entry(np.array([0.0, 2, 1, 3, 4])), "track_t: expected stamps that ascend strictly"),
    ],
)
def test_arrays_that_promise_what_they_do_not_hold_are_refused(tmp_path, name, held, said):
    write_local_map(tmp_path, some_map())
    repacked(tmp_path / "local_map.npz", lambda entries: entries.update({f"{name}.npy": held}))
    with pytest.raises(ReaderError, match=said.replace(".", r"\.")):
        read_local_map(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("landmarks", "none", "landmarks: expected names with whole numbers, found 'none'"),
        ("landmarks", {"9": -1, "barcode:72": 1}, "landmarks: expected names with whole numbers"),
        ("robot", 7, "robot: expected text, found 7"),
        ("robot", "a\nb", "robot: expected text"),
        ("dropped", 3, "dropped: expected names with whole numbers, found 3"),
        ("calibration", {"lag": [1, 2]}, "calibration: expected value and sd by name"),
        ("calibration", 1, "calibration: expected value and sd by name, found 1"),
        ("findings", "careful", "findings: expected a list of findings, found 'careful'"),
        ("findings", [{"code": "other"}], "findings: expected a finding, found"),
        ("findings", [{"code": "ranges-nan", "value": "few"}], "findings: ranges-nan: expected the values of its text"),
        ("nis_median", "low", "nis_median: expected a number or null, found 'low'"),
        ("down_weighted", 1.5, "down_weighted: expected a whole number, found 1.5"),
    ],
)
def test_a_local_map_of_another_shape_is_told_by_its_key(tmp_path, key, value, said):
    write_local_map(tmp_path, some_map())
    told = json.loads((tmp_path / "local_map.json").read_text())
    (tmp_path / "local_map.json").write_text(json.dumps(told | {key: value}))
    with pytest.raises(ReaderError, match=said):
        read_local_map(tmp_path)


@pytest.mark.filterwarnings("error")
def test_a_grid_of_halves_is_read_without_a_warning(tmp_path):
    cells = np.ones((4, 5), np.int32)
    halves = np.ones((4, 5, 2), np.float16)
    light = np.ones((4, 5), np.float32)
    write_grid(tmp_path / "grid.npz", GridMap(0.1, np.zeros(2), cells, cells, halves, light, light), None, "none")
    with np.load(tmp_path / "grid.npz") as saved:
        held = {name: saved[name] for name in saved.files}
    np.savez(tmp_path / "grid.npz", **{**held, "mean": halves})
    assert read_grid(tmp_path / "grid.npz")[0].mean.max() == 1.0


def test_a_stream_damaged_inside_a_saved_grid_is_told(tmp_path):
    path = tmp_path / "grid.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("resolution.npy", entry(np.arange(1000.0)))
    data = bytearray(path.read_bytes())
    data[60:90] = bytes(30)
    path.write_bytes(bytes(data))
    with pytest.raises(ReaderError, match=r"grid\.npz: expected a grid map"):
        read_grid(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "brackets nested too deep"),
        ('{"version": NaN}', "NaN is not finite"),
        ('{"version": 1e999}', "1e999 is not finite"),
        ("[1]", "expected a JSON object, found list"),
        ('{"robots": 1}', "expected the metrics of a mapweave result"),
        ('{"a": "\udcff"}', "expected JSON: 'utf-8' codec"),
    ],
)
def test_metrics_that_are_none_are_told(tmp_path, text, said):
    (tmp_path / "metrics.json").write_text(text, errors="surrogateescape")
    with pytest.raises(ReaderError, match=said):
        read_metrics(tmp_path)
    if "robots" not in text:
        with pytest.raises(ReaderError, match=said):
            read_json(tmp_path / "metrics.json")


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (b"3,1,2,1,0,1,1,\n", r"3: expected 8 fields"),
        (b"\x97,1,2,1,0,1,1,4\n", "expected a CSV table in UTF-8"),
        (b"3,1,2,1,0,1,1,4.5\n", r"2: expected a whole number for sightings, found '4.5'"),
        (b"3,1,2,1,0,1,1,inf\n", r"2: expected a whole number for sightings, found 'inf'"),
        (b"3,1,2,1,0,1,1," + b"9" * 400 + b"\n", r"2: expected a whole number for sightings, found '9999"),
        (b"w" * 140_000 + b",1,2,1,0,1,1,4\n", r"2: expected fields with commas between: field larger than"),
    ],
)
def test_a_landmark_table_with_bad_rows_is_told_with_its_line(tmp_path, rows, said):
    path = tmp_path / "landmarks.csv"
    path.write_bytes(b"id,x,y,var_x,cov_xy,var_y,robots,sightings\n" + (b"\n" if said[0] == "3" else b"") + rows)
    if said[0] == "3":
        path.write_bytes(path.read_bytes().replace(b",1,1,\n", b",1,1\n"))
    with pytest.raises(ReaderError, match=said):
        read_members(path)


def test_a_picture_whose_chunk_announces_gigabytes_takes_none(tmp_path):
    grey = np.zeros((10, 8), np.uint8)
    Image.fromarray(grey).save(tmp_path / "m.png")
    data = (tmp_path / "m.png").read_bytes()
    at = data.index(b"IDAT")
    (tmp_path / "m.png").write_bytes(data[: at - 4] + struct.pack(">I", 2**31 - 1) + data[at:])
    (tmp_path / "map.yaml").write_text("image: m.png\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\n")
    limit = resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + 2**30, limit[1]))
    try:
        read_ros_map(tmp_path / "map.yaml")
    except ReaderError as error:
        assert "expected a PGM or PNG image" in str(error)  # noqa: PT017  (either is right, gigabytes are not)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limit)


@pytest.mark.parametrize("code", ["1e25", "-1e300"])
def test_a_barcode_beyond_whole_numbers_is_told_with_its_line(tmp_path, code):
    (tmp_path / "Barcodes.dat").write_text("1 5\n6 72\n")
    (tmp_path / "Robot1_Measurement.dat").write_text(f"0.0 72 1.0 0.1\n1.0 {code} 1.0 0.1\n")
    with pytest.raises(ReaderError, match=r"Robot1_Measurement\.dat:2: expected a whole number for barcode"):
        list(read_landmark_logs(tmp_path))


def test_a_trajectory_with_numbers_whose_squares_are_none_is_refused(tmp_path):
    (tmp_path / "t.tum").write_text("0 1 1 0 0 0 0 1\n1 1 1 0 0 0 1e308 1\n")
    with pytest.raises(ReaderError, match=r"t\.tum:2: expected numbers under 1e\+100, found 1e\+308"):
        read_tum(tmp_path / "t.tum")


def test_a_direction_of_any_length_is_a_direction(tmp_path):
    (tmp_path / "s.csv").write_text("observer,target,bx,by,bz\na,b,1,0,0\nb,a,-1e308,1e308,0\n")
    assert read_sightings(tmp_path / "s.csv").table.direction[1] == pytest.approx([-(0.5**0.5), 0.5**0.5, 0.0])


def test_a_parquet_table_with_words_that_are_no_text_is_refused(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    words = pyarrow.StringArray.from_buffers(
        2, pyarrow.array([0, 1, 2], pyarrow.int32()).buffers()[1], pyarrow.py_buffer(b"\xff\xfe")
    )
    parquet.write_table(
        pyarrow.table({"observer": words, "target": words, "bearing": [0.0, 1.0]}), tmp_path / "s.parquet"
    )
    with pytest.raises(ReaderError, match=r"s\.parquet: expected a Parquet table"):
        read_sightings(tmp_path / "s.parquet")


LONG = "w" * 140_000


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (f"0.0,1,{LONG},1,0", r"sightings\.csv:3: expected fields with commas between: field larger than"),
        (f"0.0,1,{LONG[:300]},1,0", r"sightings\.csv:3: expected an id of at most 200 letters .*, found 'wwww"),
        ('0.0,1,"a,1,0', r"sightings\.csv:3: expected 5 columns|field in quotes that is not closed"),
        ("0.0,1,a\x1b[31m,1,0", r"sightings\.csv:3: expected an id"),
        (f"0.0,{'9' * 30},a,1,0", r"sightings\.csv:3: expected a whole number for robot, found '9999"),
        ("0.0,-3,a,1,0", r"sightings\.csv:3: expected a whole number for robot, found '-3'"),
        ("0.0,inf,a,1,0", r"sightings\.csv:3: expected a whole number for robot, found 'inf'"),
        ("0.0,1,a,1", r"sightings\.csv:3: expected 5 columns, found 4"),
    ],
)
def test_rows_of_a_csv_log_that_cannot_be_are_told_with_their_line(tmp_path, row, said):
    (tmp_path / "sightings.csv").write_text(f"t,robot,id,range,bearing\n0.0,1,a,1.0,0.0\n{row}\n")
    with pytest.raises(ReaderError, match=said):
        read_csv_landmarks(tmp_path)


@pytest.mark.parametrize("subject", ["inf", "nan", "1e30"])
def test_a_survey_of_numbers_that_are_no_subjects_is_refused(tmp_path, subject):
    (tmp_path / "Landmark_Groundtruth.dat").write_text(f"6 1 2 0.1 0.1\n{subject} 1 2 0.1 0.1\n")
    with pytest.raises(ReaderError, match=r"Groundtruth\.dat:2: expected the number of a subject"):
        read_survey(tmp_path)
    (tmp_path / "s.csv").write_text("id,x,y\n1,inf,0\n")
    with pytest.raises(ReaderError, match=r"s\.csv:2: expected id,x,y with numbers"):
        read_survey(tmp_path / "s.csv")


@pytest.mark.parametrize("name", ["a\x00b", "\x1b[2J", "x" * 300, "a\u2028b"])
def test_an_id_that_could_not_be_shown_or_name_a_file_is_refused(tmp_path, name):
    path = tmp_path / "s.csv"
    path.write_text(f"observer,target,bearing\na,b,0.1\n{name},b,0.1\n")
    with pytest.raises(ReaderError, match=r"s\.csv:\d: expected"):
        read_sightings(path)


def test_a_robot_that_saw_nothing_has_events_of_its_odometry_alone(tmp_path):
    robots = {1: (mrclam_folder.drive(), mrclam_folder.glances()), 2: (mrclam_folder.drive(), None)}
    log = read_landmark_logs(mrclam_folder.write(tmp_path, robots))[1]
    events = list(log.events())
    assert len(events) == 1
    assert events[0].t == log.odometry.t[-1]


def test_a_small_file_that_unpacks_to_gigabytes_is_refused(tmp_path):
    bomb = gzip.compress(b"0 " * 60_000_000, 1)
    (tmp_path / "log.clf.gz").write_bytes(bomb)
    with pytest.raises(ReaderError, match="no log is packed so well"):
        read_laser(tmp_path / "log.clf.gz")
    folder = mrclam_folder.write(tmp_path / "set")
    with zipfile.ZipFile(tmp_path / "set.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in folder.iterdir():
            archive.write(path, path.name)
        archive.writestr("Robot3_Odometry.dat", b"0 " * 60_000_000)
    with pytest.raises(ReaderError, match="no log is packed so well"):
        read_landmark_logs(tmp_path / "set.zip")


def test_a_text_that_memory_does_not_hold_is_refused_with_its_size(tmp_path, monkeypatch):
    def none_left(*_):
        raise MemoryError

    monkeypatch.setattr("mapweave.io.files.unpacked", none_left)
    (tmp_path / "log.gz").write_bytes(gzip.compress(b"FLASER 0\n"))
    with pytest.raises(ReaderError, match=r"log\.gz: \d+ bytes hold more text than there is memory for"):
        read_laser(tmp_path / "log.gz", "1")


@pytest.mark.parametrize("cut", [12, 60, 100, 129])
def test_a_recording_that_grows_while_its_parts_are_counted_is_read_as_far_as_it_was_written(cut, tmp_path):
    mcap = (b"\x01" + struct.pack("<Q", 120) + bytes(120)) * 9
    bag = (struct.pack("<I", 8) + struct.pack("<I", 4) + b"op=\x07" + struct.pack("<I", 113) + bytes(113)) * 9
    for chunks, data in ((_mcap_chunks, mcap), (_bag_chunks, bag)):
        (tmp_path / "a").write_bytes(data)
        for whole in (cut, len(data)):
            with (tmp_path / "a").open("rb") as file:
                counted = threading.Thread(target=lambda: list(chunks(file, whole)), daemon=True)
                counted.start()
                counted.join(20.0)
                assert not counted.is_alive()


@pytest.mark.slow
def test_a_recording_with_a_chunk_that_unpacks_to_gigabytes_is_refused(tmp_path):
    zeros = bytes(LARGEST_CHUNK + 1)
    packed = zstd.compress(zeros)
    chunk = struct.pack("<QQQI", 0, 0, len(zeros), 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
    record = b"\x06" + struct.pack("<Q", len(chunk) + len(packed)) + chunk + packed
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + record)
    packed = lz4.frame.compress(zeros)
    head = b"".join(struct.pack("<I", len(f)) + f for f in (b"op=\x05", b"compression=lz4", b"size=\x00\x00\x00\x10"))
    chunk = struct.pack("<I", len(head)) + head + struct.pack("<I", len(packed)) + packed
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + chunk)
    for name in ("a.mcap", "a.bag"):
        with pytest.raises(ReaderError, match=f"{name}: a part of [0-9]+ bytes unpacks to over"):
            read_laser(tmp_path / name)


@pytest.mark.parametrize("suffix", [*(pytest.param(s, marks=pytest.mark.slow) for s in (".bag", ".db3")), ".mcap"])
def test_torn_recordings_give_what_is_left_or_one_line(tmp_path, suffix):
    whole = usual(tmp_path / f"a{suffix}", n=12).write().read_bytes()
    rng = np.random.default_rng(0)
    read = 0
    for k in range(30):
        data = bytearray(whole)
        at = int(rng.integers(len(data)))
        value = (b"\xff\xff\xff\x7f", b"\xff" * 8, bytes(8), b"\x00\x00\x00\x40")[k % 4]
        data[at : at + len(value)] = value
        (tmp_path / f"b{suffix}").write_bytes(bytes(data[: at + 200] if k % 3 == 0 else data))
        try:
            log = read_laser(tmp_path / f"b{suffix}")
        except (ReaderError, DataError):
            continue
        assert np.isfinite(log.scan_t).all()
        read += 1
    assert read > 5


@pytest.mark.parametrize("key", ["origin", "resolution", "image", "free_thresh"])
def test_brackets_nested_deep_in_a_map_file_are_told_at_once(tmp_path, key):
    held = {"image": "m.pgm", "resolution": 0.1, "origin": [0, 0, 0]} | {key: "[" * 10_000 + "]" * 10_000}
    (tmp_path / "m.pgm").write_bytes(b"P5\n2 2\n255\n" + bytes(4))
    (tmp_path / "map.yaml").write_text("".join(f"{name}: {value}\n" for name, value in held.items()))
    with pytest.raises(ReaderError, match=r"expected"):
        read_ros_map(tmp_path / "map.yaml")


def test_a_table_of_bearings_without_numbers_is_told(tmp_path):
    (tmp_path / "landmark.csv").write_text("0,0\n")
    (tmp_path / "(X1.0,Y2.0).csv").write_text("nan\n")
    with pytest.raises(ReaderError, match="expected rows of finite numbers"):
        read_angulation(tmp_path)


@pytest.mark.parametrize("letter", [0x110000, 0xFFFFFFFF, 0xD800])
@pytest.mark.parametrize("order", ["<", ">"])
def test_names_of_letters_that_do_not_exist_are_refused(tmp_path, letter, order):
    ids = np.array([[0x61, letter]], f"{order}u4").view(f"{order}U2")[:, 0]
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": ids.dtype.str, "fortran_order": False, "shape": (1,)})
    with zipfile.ZipFile(tmp_path / "landmarks.npz", "w") as archive:
        archive.writestr("ids.npy", head.getvalue() + ids.tobytes())
        archive.writestr("mean.npy", entry(np.zeros((1, 2))))
        archive.writestr("cov.npy", entry(np.eye(2)))
    with pytest.raises(ReaderError, match=r"landmarks\.npz: ids: expected text, found what is no letter"):
        read_landmarks(tmp_path / "landmarks.npz")


def test_truth_of_a_swarm_without_finite_stamps_is_refused(tmp_path):
    (tmp_path / "t.csv").write_text("id,x,y,t\na,1,2,0\na,1,2,inf\n")
    with pytest.raises(ReaderError, match=r"t\.csv:3: expected a finite t for a"):
        read_swarm_truth(tmp_path / "t.csv")


@pytest.mark.parametrize(
    ("rows", "dropped"),
    [
        ("Odometry 0 0 0\nLaser 3 1 2 3\nOdometry 1e308 inf 0\nLaser 3 1 2 3\n", 1),
        ("Odometry 0 0 0\nLaser 3 1 2 3\nOdometry 0 0 nan\nLaser 3 1 2 3\nLaser 3 1 2 3\n", 2),
        ("ODOM 0 0 0 0 0 0 1.0 h 1\nFLASER 3 1 2 3 inf 0 0 0 0 0 1.0 h 1\nFLASER 3 1 2 3 0 0 0 0 0 0 2.0 h 2\n", 1),
        ("ODOM 0 0 0 0 0 0 1.0 h 1\nFLASER 3 1 2 3 0 0 0 0 0 0 nan h 1\nFLASER 3 1 2 3 0 0 0 0 0 0 2.0 h 2\n", 1),
    ],
)
def test_scans_whose_pose_or_stamp_no_robot_can_have_are_dropped_and_counted(tmp_path, rows, dropped):
    (tmp_path / "a.log").write_text(rows)
    log = read_laser(tmp_path / "a.log")
    assert log.dropped["scan with a stamp, pose or angle that none can have"] == dropped
    assert all(np.isfinite(scan.ranges).all() and np.isfinite(scan.odometry).all() for scan in log.scans)


@pytest.mark.parametrize("first", ["FLASER 3 1 2 3 0 0 0 0 0 0 2.0 h 2", "Laser 3 1 2 3", "1 0 0 0 0 100 200 300"])
def test_a_line_of_a_laser_log_that_would_be_millions_of_words_is_refused(tmp_path, first):
    (tmp_path / "a.log").write_text("\n".join([first] * 3) + "\nFLASER " + "0 " * 600_000 + "\n")
    with pytest.raises(
        ReaderError, match=r"a\.log:4: expected lines of at most 1048576 characters, found one of 1200007"
    ):
        read_laser(tmp_path / "a.log")


@pytest.mark.parametrize("step", [0.0, 1e-45, 1e30])
def test_scans_whose_beams_no_scanner_has_are_dropped_and_counted(tmp_path, step):
    recording = Recording(tmp_path / "a.mcap")
    for k in range(3):
        recording.odom(k, 0.1 * k)
        recording.scan(k, [1.0, 2.0, 3.0])
    t, topic, kind, message = recording.rows[1]
    recording.rows[1] = t, topic, kind, dataclasses.replace(message, angle_increment=step, angle_max=-1.5)
    log = read_laser(recording.write())
    assert len(log.scans) == 2
    assert log.dropped["scan with a stamp, pose or angle that none can have"] == 1


@pytest.mark.parametrize("said", ["inf", "nan", "1e308", "-1"])
def test_a_row_that_announces_no_count_of_ranges_is_told(tmp_path, said):
    (tmp_path / "a.log").write_text(f"Odometry 0 0 0\nLaser 3 1 2 3\nLaser {said} 1 2 3\nOdometry 0 0 0\n")
    with pytest.raises(ReaderError, match=rf"a\.log:3: Laser says {said} ranges, found 3"):
        read_laser(tmp_path / "a.log")
    (tmp_path / "a.log").write_text(f"ODOM 0 0 0 0 0 0 1 h 1\nFLASER {said} 1 2 3 0 0 0 0 0 0 1.0 h 1\n")
    with pytest.raises(ReaderError, match=r"a\.log:2: FLASER"):
        read_laser(tmp_path / "a.log")


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_message_type_that_no_program_can_be_made_of_is_damage(tmp_path, suffix):
    path = usual(tmp_path / f"a{suffix}", n=3).write()
    whole = path.read_bytes()
    assert b"MSG: std_msgs/" in whole
    path.write_bytes(whole.replace(b"MSG: std_msgs/", b"MSG: 3td_msgs/"))
    if suffix == ".mcap":  # ROS 2 types of that name are known
        assert len(read_laser(path).scans) == 3
        return
    with pytest.raises(DataError, match="no laser scan in it"):
        read_laser(path)


@pytest.mark.parametrize("column", ["name", "type"])
def test_a_topic_without_a_name_or_type_in_a_database_is_left_out(tmp_path, column):
    path = usual(tmp_path / "a.db3", n=3).write()
    whole = sqlite3.connect(path)
    whole.execute("PRAGMA writable_schema = 1")
    whole.execute("UPDATE sqlite_master SET sql = replace(sql, ' NOT NULL', '') WHERE name = 'topics'")
    whole.commit()
    whole.close()
    again = sqlite3.connect(path)
    again.execute(f"UPDATE topics SET {column} = NULL WHERE name LIKE '/scan%'")  # noqa: S608  (our own words)
    again.commit()
    again.close()
    with pytest.raises(MapweaveError, match=r"a\.db3"):
        read_laser(path)


def test_an_error_is_one_line_whatever_the_file_is_called():
    assert "\n" not in str(ReaderError("a\nb", "expected\nmuch"))
    assert isinstance(ReaderError("a", "b"), MapweaveError)


@pytest.mark.slow
def test_a_short_seeded_fuzz_of_every_format_finds_nothing(tmp_path):
    words = [sys.executable, str(ROOT / "benchmarks" / "fuzz.py"), "--inputs", "40", "--keep", str(tmp_path)]
    path = os.pathsep.join([str(ROOT / "src"), str(ROOT)])
    env = os.environ | {"PYTHONPATH": path}
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=False)  # noqa: S603  (our own)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " over 29 formats" in done.stdout
    assert ", 0 findings" in done.stdout.splitlines()[-1]
