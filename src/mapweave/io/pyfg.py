"""Ranges, odometry and priors as text in the format of PyFactorGraph (`.pyfg`), planar.

Rows: `VERTEX_SE2 t name x y theta`, `VERTEX_XY name x y`, `EDGE_SE2 t a b x y theta` and `VERTEX_SE2:PRIOR t a x y
theta` with the upper triangle of a covariance, `VERTEX_XY:PRIOR t a x y` with one of x, y, `EDGE_RANGE t a b range
variance`. A robot is called by the letters of its poses' names. Source: PyFactorGraph, py_factor_graph/io/pyfg_text.py.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import ReaderError
from ..core.names import in_order
from ..core.records import Track
from ..ranges.network import Motions, Priors, RangeNetwork, Ranges
from .files import TextLog, is_number
from .table import open_text

POSE, PLACE, STEP, RANGE = "VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_RANGE"
POSE_PRIOR, PLACE_PRIOR = "VERTEX_SE2:PRIOR", "VERTEX_XY:PRIOR"
# Of each kind: whether a stamp comes first, how many names, how many numbers.
ROWS = {
    POSE: (True, 1, 3), PLACE: (False, 1, 2), POSE_PRIOR: (True, 1, 9), PLACE_PRIOR: (True, 1, 5),
    STEP: (True, 2, 9), RANGE: (True, 2, 2),
}  # fmt: skip
IN_SPACE = ("VERTEX_SE3", "VERTEX_XYZ", "EDGE_SE3")
FREE = 1e6  # [rad^2] variance of a beacon's heading, which says nothing
UPPER = np.triu_indices(3)


@dataclass(frozen=True, slots=True)
class PyfgFile:
    """network: what was measured; places: (n, 3) where the file's vertices stand, which may be the truth: no estimate
    reads them; warnings: rows passed over.
    """

    network: RangeNetwork
    places: Float[np.ndarray, "n 3"]
    warnings: tuple[str, ...]

    def truth(self) -> tuple[dict[str, Track], dict[str, tuple[float, float]]]:
        """Trajectories of the robots and places of the beacons, as the vertices stand."""
        net = self.network
        tracks = {name: net.track(k, self.places, frame="survey") for k, name in enumerate(net.robots)}
        at = self.places[net.is_beacon, :2].tolist()
        return tracks, {name: (x, y) for name, (x, y) in zip(net.beacons, at, strict=True)}


def is_pyfg(path: Path) -> bool:
    """Whether the text at `path`, packed or not, begins as such a file: its first row of a kind has a name in it."""
    if not path.is_file():
        return False
    try:
        head = TextLog(path).head()
    except ReaderError:
        return False
    first: list[str] = next((words for words in head if words[0].startswith((*ROWS, *IN_SPACE))), [])
    return len(first) > 2 and any(word[:1].isalpha() and not is_number(word) for word in first[1:4])


def read_pyfg(path: Path) -> PyfgFile:
    """The file at `path`, plain or packed. Raises ReaderError naming the line for a row that does not parse, a vertex
    told twice or never, a range to itself or of no positive length, a covariance that is none; and for one in space.
    """
    log = TextLog(path)
    rows: dict[str, list[_Row]] = {kind: [] for kind in ROWS}
    unread: Counter[str] = Counter()
    for line, text in log.lines():
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        kind = words[0]
        if kind.startswith(IN_SPACE):
            raise ReaderError(path, f"expected a planar graph, found {kind}: graphs in space are not solved", line)
        if kind not in ROWS:
            unread[kind[:40]] += 1
            continue
        stamped, names, numbers = ROWS[kind]
        cut = 1 + stamped
        values = _finite([*words[1:cut], *words[cut + names :]])
        if values is None or len(values) != stamped + numbers:
            told = f"{kind}{' stamp' * stamped}{' name' * names} and {numbers} finite numbers"
            raise ReaderError(path, f"expected {told}, found {text[:80]!r}", line)
        rows[kind].append(_Row(line, words[cut : cut + names], values))
    if log.truncated:
        raise ReaderError(path, log.truncated)
    return _network(path, rows, unread)


def _finite(words: Sequence[str]) -> list[float] | None:
    try:
        values = [float(word) for word in words]
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


class _Row(NamedTuple):
    line: int
    names: list[str]
    values: list[float]  # a stamp, where the kind has one, then the numbers


def _network(path: Path, rows: dict[str, list[_Row]], unread: Counter[str]) -> PyfgFile:
    if not rows[POSE]:
        raise ReaderError(path, f"expected {POSE} rows, found none")
    robots = tuple(sorted({_robot(row) for row in rows[POSE]}, key=in_order))
    order = sorted(rows[POSE], key=lambda row: (robots.index(_robot(row)), row.values[0]))
    places = sorted(rows[PLACE], key=lambda row: in_order(row.names[0]))
    index: dict[str, int] = {}
    for row in (*order, *places):
        if row.names[0] in index:
            raise ReaderError(path, f"vertex {row.names[0]} is told twice", row.line)
        index[row.names[0]] = len(index)
    beacons = tuple(row.names[0] for row in places)
    owner = [robots.index(_robot(row)) for row in order] + [len(robots) + k for k in range(len(beacons))]
    at = np.array([row.values[1:] for row in order] + [[*row.values, 0.0] for row in places])
    t = np.array([row.values[0] for row in order] + [np.nan] * len(beacons))
    steps, ranged, held = rows[STEP], rows[RANGE], [*rows[POSE_PRIOR], *rows[PLACE_PRIOR]]
    for row in ranged:
        if min(row.values[1:]) <= 0:
            raise ReaderError(path, f"expected a range and a variance above 0, found {row.values[1:]}", row.line)
    for row in steps:
        if {*row.names} & set(beacons):
            raise ReaderError(path, f"{STEP} {' '.join(row.names)}: a beacon has no heading", row.line)
    ends = _nodes(path, steps, index, 2)
    z = np.array([row.values for row in steps]).reshape(-1, 10)
    motions = Motions(ends[:, 0], ends[:, 1], z[:, 1:4], _covariances(path, steps, z[:, 4:]))
    ends, z = _nodes(path, ranged, index, 2), np.array([row.values for row in ranged]).reshape(-1, 3)
    ranges = Ranges.of_points(ends[:, 0], ends[:, 1], z[:, 0], z[:, 1], np.sqrt(z[:, 2]))
    known = np.array([r.values[1:] if len(r.values) == 10 else _flat(r.values[1:]) for r in held]).reshape(-1, 9)
    node = _nodes(path, held, index, 1)[:, 0]
    priors = Priors(node, known[:, :3], _covariances(path, held, known[:, 3:]))
    told = ", ".join(f"{n} {kind}" for kind, n in sorted(unread.items()))
    warnings = (f"rows of other kinds than {', '.join(ROWS)} are passed over: {told}",) if told else ()
    net = RangeNetwork(robots, beacons, np.array(owner), t, motions, ranges, priors, tuple(index))
    return PyfgFile(net, at, warnings)


def _robot(row: _Row) -> str:
    """Whose pose it is: the letters its name begins with."""
    return row.names[0].rstrip("0123456789") or "robot"


def _nodes(path: Path, rows: Sequence[_Row], index: dict[str, int], n: int) -> Int[np.ndarray, "m n"]:
    for row in rows:
        if missing := [name for name in row.names if name not in index]:
            raise ReaderError(path, f"there is no vertex {missing[0]}", row.line)
        if len({*row.names}) < n:
            raise ReaderError(path, f"expected two vertices, found one from {row.names[0]} to itself", row.line)
    return np.array([[index[name] for name in row.names] for row in rows], np.int64).reshape(-1, n)


def _flat(values: Sequence[float]) -> list[float]:
    """A place's prior as a pose's: x, y and the upper triangle of their covariance."""
    x, y, xx, xy, yy = values
    return [x, y, 0.0, xx, xy, 0.0, yy, 0.0, FREE]


def _covariances(path: Path, rows: Sequence[_Row], upper: Float[np.ndarray, "m 6"]) -> Float[np.ndarray, "m 3 3"]:
    out = np.empty((len(upper), 3, 3))
    out[:, UPPER[0], UPPER[1]] = out[:, UPPER[1], UPPER[0]] = upper
    wrong = np.flatnonzero(np.linalg.eigvalsh(out)[:, 0] <= 0.0)
    if len(wrong):
        row = rows[int(wrong[0])]
        raise ReaderError(path, f"expected a positive definite covariance of {' '.join(row.names)}", row.line)
    return out


def write_pyfg(path: Path, net: RangeNetwork, pose: Float[np.ndarray, "n 3"]) -> None:
    """`path` holds `net` with its vertices at `pose`; ranges whose sd the log does not say have the variance given."""
    names = net.names or tuple(_called(net))
    beacon = net.is_beacon
    m, r, p = net.motions, net.ranges, net.priors
    with open_text(path) as file:
        for k in np.flatnonzero(~beacon).tolist():
            file.write("{} {:.9f} {} {:.9g} {:.9g} {:.9g}\n".format(POSE, net.t[k], names[k], *pose[k]))
        for k in np.flatnonzero(beacon).tolist():
            file.write("{} {} {:.9g} {:.9g}\n".format(PLACE, names[k], *pose[k, :2]))
        for node, z, cov in zip(p.node.tolist(), p.z, p.cov, strict=True):
            place = beacon[node]
            values = (*z[:2], *cov[:2, :2][np.triu_indices(2)]) if place else (*z, *cov[UPPER])
            t = 0.0 if place else net.t[node]
            file.write(f"{PLACE_PRIOR if place else POSE_PRIOR} {t:.9f} {names[node]} {_numbers(values)}\n")
        for i, j, z, cov in zip(m.first.tolist(), m.second.tolist(), m.z, m.cov, strict=True):
            file.write(f"{STEP} {net.t[j]:.9f} {names[i]} {names[j]} {_numbers((*z, *cov[UPPER]))}\n")
        for a, b, t, z, sd in zip(r.a.tolist(), r.b.tolist(), r.t, r.z, r.sd, strict=True):
            file.write(f"{RANGE} {t:.9f} {names[a]} {names[b]} {_numbers((z, sd**2))}\n")


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def _called(net: RangeNetwork) -> list[str]:
    """Names as the format has them: a letter a robot and numbers, beacons `L0`, `L1`."""
    letters = "ABCDEFGHIJKMNOPQRSTUVWXYZ"
    number = np.arange(len(net.owner)) - np.searchsorted(net.owner, net.owner)
    called = [letters[k] if k < len(letters) else f"R{k}_" for k in range(len(net.robots))]
    return [
        f"{called[k]}{n}" if k < len(called) else f"L{k - len(called)}"
        for k, n in zip(net.owner.tolist(), number.tolist(), strict=True)
    ]
