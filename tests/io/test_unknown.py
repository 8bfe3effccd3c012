"""Files of no known format: what is said of them."""

import gzip
import zipfile

import numpy as np
import pytest

import mapweave
from mapweave.core.errors import MapweaveError, ReaderError
from mapweave.io.landmark_logs import is_landmark_log
from mapweave.io.laser_logs import read_laser
from mapweave.io.unknown import FORMATS, nearest_formats, not_known

from .ros_logs import usual


def written(tmp_path, text, name="some.log"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("PARAM a 1\nLASER 3 1 2 3\nFLASER", "CARMEN"),
        ("Odometry 1 2 3\nPose 1 2 3\n", "a log without stamps"),
        ("O 1 2 3\nL 1 2\n", "a log in centimetres"),
        (" ".join(["1.5"] * 200), "URG-04LX with wheel ticks"),
        ("time,robot,range\n1,2,3\n", "CSV tables"),
        ("1 2 3\n4 5 6\n", "MRCLAM"),
        ("VERTEX_SE2 1 2 3 4\n", "a pose graph"),
        ("1 2 3 0 0 0 0 1\n", "a trajectory"),
        ("observer,target,bearing\n1,2,0.5\n", "a swarm"),
    ],
)
def test_the_nearest_format_is_that_of_the_same_words_or_shape(text, first):
    nearest = nearest_formats(text.splitlines())
    assert nearest[0].name == first
    assert len(nearest) == 3
    assert len({f.name for f in FORMATS}) == len(FORMATS)


def test_the_error_names_the_file_how_it_begins_and_what_three_formats_need(tmp_path):
    path = written(tmp_path, f"Odometry 1 2 3\nx\x1b[31m\x07 {'long ' * 40}\nthird\n")
    with pytest.raises(ReaderError) as told:
        mapweave.map(path)
    text = str(told.value)
    assert text.startswith(
        f"{path}: expected a log of a known format, found text that begins 'Odometry 1 2 3' / 'x.[31m."
    )
    assert text.count(" needs ") == 3
    assert text.isprintable()
    assert "third" not in text
    assert len(text) - len(str(path)) < 700


def test_what_is_taken_for_a_log_or_a_map_is_told_for_what_it_is(tmp_path):
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "metrics.json").write_text("{}")
    with pytest.raises(ReaderError, match="result: it is a result: expected the logs it is of"):
        mapweave.map(tmp_path / "result")
    file = written(tmp_path, "text")
    with pytest.raises(ReaderError, match=r"some\.log: expected a mapweave result with metrics\.json, found none"):
        mapweave.fuse([file, tmp_path / "result"])
    with pytest.raises(ReaderError, match="nowhere: no such file or folder"):
        mapweave.localize(file, tmp_path / "nowhere")
    with pytest.raises(MapweaveError, match=r"swarm\.xyz: expected a file name such as swarm\.csv"):
        mapweave.simulate_swarm(tmp_path / "swarm.xyz")


@pytest.mark.parametrize("data", [b"", b"\n \n", gzip.compress(b"", mtime=0)], ids=["nothing", "blanks", "packed"])
def test_an_empty_file_is_told(tmp_path, data):
    with pytest.raises(ReaderError, match=r"some\.log: expected a log, found an empty file"):
        mapweave.map(written(tmp_path, data))


def test_a_folder_of_nothing_that_is_known_names_what_it_holds(tmp_path):
    written(tmp_path, "hello", "notes.txt")
    assert "found 1 entries: 'notes.txt'" in str(not_known(tmp_path))
    with pytest.raises(ReaderError, match=r"found 1 entries: 'notes\.txt'"):
        mapweave.map(tmp_path)


def test_the_one_of_several_logs_that_is_not_known_is_named(tmp_path):
    with pytest.raises(ReaderError, match=r"odd\.txt: expected a log of a known format"):
        mapweave.map([usual(tmp_path / "a.bag").write(), written(tmp_path, "hello", "odd.txt")])


def test_a_zip_file_of_two_texts_is_told_by_map_too(tmp_path):
    path = tmp_path / "two.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.log", "hello")
        archive.writestr("b.log", "hello")
    with pytest.raises(ReaderError, match=r"expected one log in the zip file, found 2 files: a\.log, b\.log"):
        mapweave.map(path)


def test_a_cut_zip_file_of_one_log_is_no_damaged_landmark_log(tmp_path):
    for name, wrong in (("some.log", False), ("Barcodes.dat", True)):
        path = tmp_path / f"{name}.zip"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(name, "FLASER " * 100)
        path.write_bytes(path.read_bytes()[:300])
        if wrong:
            with pytest.raises(ReaderError, match="cut short"):
                is_landmark_log(path)
        else:
            assert not is_landmark_log(path)


def test_landmark_logs_in_a_zip_file_of_another_name_are_known(tmp_path):
    path = tmp_path / "set.data"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Barcodes.dat", "1 5\n")
        archive.writestr("Robot1_Odometry.dat", "0 0 0\n")
    assert is_landmark_log(path)
    assert not is_landmark_log(written(tmp_path, "FLASER", "log.zip"))


def test_no_damage_to_a_file_is_more_than_an_error_that_names_it(tmp_path):
    rng = np.random.default_rng(5)
    whole = [usual(tmp_path / name).write().read_bytes() for name in ("a.bag", "b.db3", "c.mcap")]
    whole += [b"Odometry 0 0 0\nLaser 4 1 1 1 1\n" * 20, b" ".join([b"1000 0 5 6", *[b"150"] * 140]) + b"\n"]
    for k in range(100):
        data = bytearray(whole[k % len(whole)])
        for at in (rng.random(rng.integers(1, 6)) ** 3 * len(data)).astype(int).tolist():
            data[at] = int(rng.integers(0, 256))
        try:
            read_laser(written(tmp_path, bytes(data[: rng.integers(1, len(data))] if k % 3 == 0 else data)))
        except MapweaveError as error:
            assert "some.log" in str(error)  # noqa: PT017
