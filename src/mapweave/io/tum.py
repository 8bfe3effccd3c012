"""TUM trajectories, lines `t x y z qx qy qz qw` and `#` comments, and the covariance of every pose beside them."""

from pathlib import Path
from warnings import catch_warnings

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import DataError, ReaderError
from ..core.records import Track
from .table import open_text, write_rows

COVARIANCE_HEAD = "t,xx,xy,yy,xt,yt,tt"

LARGEST = 1e100  # whose square is a number yet
UNIT = 0.01  # by which the norm of a quaternion may be off 1
STAMP = 1e-5  # [s] by which two files may differ that round to microseconds
ROUNDED = 1e-5  # of the greatest variance that the least eigenvalue of a covariance may lie below 0, of rounding


def read_tum(path: Path, frame: str = "map") -> Track:
    """The trajectory in `path`, seen from above; raises ReaderError as `read_tum_rows` does."""
    return track_from(read_tum_rows(path), frame)


def read_tum_rows(path: Path) -> Float[np.ndarray, "n 8"]:
    """The rows `t x y z qx qy qz qw` in `path`, stably sorted; of equal stamps the last is kept.

    Raises ReaderError naming the first line that is not eight finite numbers.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ReaderError(path, f"expected a TUM trajectory: {error}") from None
    rows: list[tuple[float, ...]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = tuple(map(float, words))
        except ValueError:
            raise ReaderError(path, f"expected numbers `t x y z qx qy qz qw`, found {line.strip()!r}", number) from None
        if len(row) != 8 or not np.isfinite(row).all():
            raise ReaderError(path, f"expected 8 finite numbers `t x y z qx qy qz qw`, found {len(row)}", number)
        if max(map(abs, row)) > LARGEST:
            raise ReaderError(path, f"expected numbers under {LARGEST:g}, found {max(map(abs, row)):g}", number)
        rows.append(row)
    if not rows:
        raise ReaderError(path, "expected a trajectory, found no poses")
    held = np.array(rows)
    held = held[np.argsort(held[:, 0], kind="stable")]
    return np.asarray(held[np.append(np.diff(held[:, 0]) > 0, True)])


def read_result_track(path: Path) -> Track:
    """The trajectory of a result, with the covariances beside it where there are any.

    That of a robot which nothing places is empty, as are the covariances beside it. Raises ReaderError for a line that
    does not parse or turns no way, and for covariances of other stamps.
    """
    beside = path.with_suffix(".cov.csv")
    if not path.stat().st_size and beside.exists() and beside.stat().st_size == len(COVARIANCE_HEAD) + 1:
        return Track(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    rows = read_tum_rows(path)
    if not (np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1.0) < UNIT).all():
        raise ReaderError(path, "expected unit quaternions, found another")
    return read_track_covariance(beside, track_from(rows)) if beside.exists() else track_from(rows)


def track_from(rows: np.ndarray, frame: str = "map") -> Track:
    """A Track of rows `t x y z qx qy qz qw` of ascending stamps."""
    qx, qy, qz, qw = rows[:, 4:].T
    theta = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    return Track(rows[:, 0], np.column_stack([rows[:, 1], rows[:, 2], se2.wrap_angle(theta)]), None, frame)


def write_tum(path: Path, track: Track) -> None:
    """`path` holds one line a stamp, ascending; z and roll and pitch are zero."""
    if len(track.t) > 1 and not (np.diff(track.t) > 0).all():
        raise DataError(f"{path.name}: stamps of a trajectory must ascend strictly")
    _write_lines(path, track.t, track.pose, "%.6f %.6f %.6f 0 0 0 %.9f %.9f\n")


def write_exact_tum(path: Path, t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]) -> None:
    """`path` holds one line a pose, in the order given, with as many digits as the numbers have."""
    _write_lines(path, t, pose, "%.17g %.17g %.17g 0 0 0 %.17g %.17g\n")


def _write_lines(path: Path, t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"], line: str) -> None:
    half = 0.5 * pose[:, 2]
    rows = np.column_stack([t, pose[:, :2], np.sin(half), np.cos(half)])
    with open_text(path) as file:
        write_rows(file, line, rows + 0.0)


def write_track_covariance(path: Path, track: Track) -> None:
    """`path` holds `t,xx,xy,yy,xt,yt,tt` [m^2, m rad, rad^2], a line for each line of the trajectory."""
    if track.cov is None:
        return
    P = track.cov
    rows = np.column_stack([track.t, P[:, 0, 0], P[:, 0, 1], P[:, 1, 1], P[:, 0, 2], P[:, 1, 2], P[:, 2, 2]])
    with open_text(path) as file:
        file.write(COVARIANCE_HEAD + "\n")
        write_rows(file, "%.6f" + ",%.6e" * 6 + "\n", rows)


def read_track_covariance(path: Path, track: Track) -> Track:
    """`track` with the covariances of the file written beside it.

    Raises ReaderError where the file does not hold seven finite numbers for each pose, at its stamp, or a matrix that
    is no covariance.
    """
    try:
        with catch_warnings(action="ignore"):  # of a file without rows, which is told below
            rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise ReaderError(path, f"expected the covariances of a trajectory: {error}") from None
    if rows.shape != (len(track.t), 7) or not np.isfinite(rows).all():
        raise ReaderError(
            path, f"expected {COVARIANCE_HEAD} of {len(track.t)} poses beside it, found {len(rows)} or other numbers"
        )
    if (off := np.abs(rows[:, 0] - track.t) > STAMP).any():
        k = int(np.argmax(off))
        found = f"expected the pose at {track.t[k]:.6f} s, found {rows[k, 0]:.6f}: not of this trajectory"
        raise ReaderError(path, found, k + 2)
    _, xx, xy, yy, xt, yt, tt = rows.T
    cov = np.stack([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]).transpose(2, 0, 1)
    least = np.linalg.eigvalsh(cov)[:, 0]
    if (wrong := least < -ROUNDED * np.abs(cov).max(axis=(1, 2))).any():
        raise ReaderError(path, "expected a covariance, found one with a negative variance", int(np.argmax(wrong)) + 2)
    return Track(track.t, track.pose, cov, track.frame)
