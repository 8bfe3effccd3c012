"""Compressed text logs: told by their content, used as far as they go, and bounded."""

import bz2
import gzip
import lzma
import zipfile
import zlib
from io import BytesIO

import numpy as np
import pytest

from mapweave.core.errors import ReaderError
from mapweave.io.files import LARGEST_SMALL, TextLog, zstd
from mapweave.io.laser_logs import read_laser

RNG = np.random.default_rng(0)
TEXT = "".join(
    f"FLASER 90 {' '.join(map(str, RNG.uniform(1, 5, 90).round(2)))} 0 0 0 0 0 0 {t} gfs {t}\n" for t in range(400)
).encode()


def zipped(method=zipfile.ZIP_DEFLATED, names=("run/some.log",), data=TEXT):
    out = BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        archive.writestr("__MACOSX/run/._some.log", b"\0\0\0\0")
        for name in names:
            archive.writestr(name, data)
    return out.getvalue()


def alone(method):
    out = BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        archive.writestr("some.log", TEXT)
    return out.getvalue()


PACKED = {
    "gzip": gzip.compress(TEXT),
    "bzip2": bz2.compress(TEXT, 1),
    "xz": lzma.compress(TEXT),
    "zstd": zstd.compress(TEXT),
    "zip": zipped(),
    "zip of bzip2": zipped(zipfile.ZIP_BZIP2),
    "zip as it is": zipped(zipfile.ZIP_STORED),
}
FRONT = {
    **{name: PACKED[name] for name in ("gzip", "bzip2", "xz", "zstd")},
    "zip": alone(zipfile.ZIP_DEFLATED),
    "zip as it is": alone(zipfile.ZIP_STORED),
}


def written(tmp_path, data, name="some.log"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("how", PACKED)
@pytest.mark.parametrize("name", ["some.log", "some.gz", "noname"])
def test_a_log_opens_however_it_is_compressed_and_called(tmp_path, how, name):
    log = read_laser(written(tmp_path, PACKED[how], name))
    assert len(log.scans) == 400
    assert log.warnings == ()


@pytest.mark.parametrize("how", ["gzip", "bzip2", "xz", "zstd"])
def test_streams_after_one_another_are_one_log(tmp_path, how):
    log = TextLog(written(tmp_path, PACKED[how] * 3))
    assert log.text.encode() == TEXT * 3
    assert log.truncated == ""


def test_padding_between_xz_streams_is_no_damage(tmp_path):
    log = TextLog(written(tmp_path, PACKED["xz"] + bytes(8) + PACKED["xz"] + bytes(4)))
    assert log.text.encode() == TEXT * 2
    assert log.truncated == ""


@pytest.mark.parametrize("how", FRONT)
def test_a_compressed_log_cut_short_gives_what_was_readable_and_says_so(tmp_path, how):
    data = FRONT[how]
    log = read_laser(written(tmp_path, data[: int(0.7 * len(data))]))
    assert 40 <= len(log.scans) < 400
    assert [f.code for f in log.findings] == ["log-short"]
    assert any("bytes of text" in w for w in log.warnings)


@pytest.mark.parametrize("how", ["gzip", "bzip2", "zip", "zip as it is"])  # xz and zstd may have no checksum of a part
def test_a_damaged_byte_costs_what_stands_after_it(tmp_path, how):
    data = bytearray(FRONT[how])
    data[3 * len(data) // 4] ^= 0x5A
    log = TextLog(written(tmp_path, bytes(data)))
    same = next(k for k, (a, b) in enumerate(zip(log.text.encode() + b"\0", TEXT, strict=False)) if a != b)
    assert same > 0.3 * len(TEXT)
    assert log.truncated


@pytest.mark.parametrize("how", ["gzip", "bzip2", "xz", "zstd"])
def test_a_stream_cut_in_its_head_is_an_error_that_says_so(tmp_path, how):
    with pytest.raises(ReaderError, match=rf"some\.log: the {how} stream .*nothing of it can be read"):
        TextLog(written(tmp_path, PACKED[how][:12]))


def test_a_zip_file_of_two_logs_is_an_error_that_names_them(tmp_path):
    path = written(tmp_path, zipped(names=("a.log", "b.log")))
    with pytest.raises(ReaderError, match=r"expected one log in the zip file, found 2 files: a\.log, b\.log"):
        read_laser(path)


def test_a_zip_file_of_nothing_is_an_error(tmp_path):
    with pytest.raises(ReaderError, match="expected one log in the zip file, found 0 files"):
        read_laser(written(tmp_path, zipped(names=())))


@pytest.mark.parametrize("how", ["gzip", "bzip2", "xz", "zstd", "zip"])
def test_a_decompression_bomb_is_refused(tmp_path, how):
    zeros = b"0" * (LARGEST_SMALL + 1)
    pack = {"gzip": gzip.compress, "bzip2": bz2.compress, "xz": lzma.compress, "zstd": zstd.compress}
    data = pack[how](zeros) if how in pack else zipped(data=zeros)
    with pytest.raises(ReaderError, match="no log is packed so well"):
        TextLog(written(tmp_path, data))


def test_a_zip_file_that_lies_about_its_size_is_read_no_further(tmp_path):
    data = alone(zipfile.ZIP_DEFLATED)
    lie = data.replace(len(TEXT).to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    log = TextLog(written(tmp_path, lie))
    assert log.truncated


def test_an_encrypted_zip_file_is_told(tmp_path):
    data = bytearray(alone(zipfile.ZIP_DEFLATED))
    for magic, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(magic) + at] |= 1
    with pytest.raises(ReaderError, match="encrypted"):
        TextLog(written(tmp_path, bytes(data)))


@pytest.mark.parametrize("how", PACKED)
def test_no_damage_to_a_compressed_log_is_more_than_a_reader_error(tmp_path, how):
    rng = np.random.default_rng(zlib.crc32(how.encode()))
    for _ in range(60):
        data = bytearray(PACKED[how])
        for at in rng.integers(0, len(data), rng.integers(1, 4)).tolist():
            data[at] = int(rng.integers(0, 256))
        try:
            TextLog(written(tmp_path, bytes(data[: rng.integers(0, len(data))] if rng.random() < 0.3 else data)))
        except ReaderError as error:
            assert "some.log: " in str(error)  # noqa: PT017
