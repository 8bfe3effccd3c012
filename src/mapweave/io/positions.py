"""What `locate` leaves: positions with covariances, tracks over time, and the network with its joint information."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from ..core.attitude import TURNS, Headings
from ..core.errors import ReaderError
from ..swarm.moving.result import RobotTrajectory
from ..swarm.result import JointInformation, OtherAnswer
from .npz import Spec, read_npz, write_npz
from .table import Table, read_table, write_table

ORDER = {2: ((0, 0), (0, 1), (1, 1)), 3: ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))}
NAMES = {2: ("var_x", "cov_xy", "var_y"), 3: ("var_x", "cov_xy", "var_y", "cov_xz", "cov_yz", "var_z")}
# No file of some systems may be called like these, whatever follows a dot.
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(1, 10))}
# Arrays of the joint information in `network.npz`, as `read_npz` takes them.
INFORMATION: dict[str, Spec] = {
    "row": ("whole", ("values",)),
    "column": ("whole", ("values",)),
    "value": ("number", ("values",)),
    "held": ("any", ("scalars",)),
    "width": ("whole", ()),
}


@dataclass(frozen=True, slots=True)
class Positions:
    """`positions.csv`. position: (n, d) [m]; cov: (n, d, d), NaN where the file says nothing; localisable: (n,)."""

    ids: tuple[str, ...]
    position: Float[np.ndarray, "n d"]
    cov: Float[np.ndarray, "n d d"]
    localisable: Bool[np.ndarray, " n"]


def write_positions(
    path: Path,
    ids: Sequence[str],
    position: Float[np.ndarray, "n d"],
    cov: Float[np.ndarray, "n d d"] | None,
    localisable: Bool[np.ndarray, " n"],
    sightings: Int[np.ndarray, " n"],
    outliers: Int[np.ndarray, " n"],
    heading: Headings | None = None,
    heading_var: Headings | None = None,
) -> None:
    """`id,x,y[,z],var_x,..,localisable,sightings,outliers[,heading,var_heading]`; what is not known stays empty.

    In space `rx,ry,rz,var_rx,var_ry,var_rz` of rotation vectors [rad].
    """
    n, d = position.shape
    head = ["id", *"xyz"[:d], *NAMES[d], "localisable", "sightings", "outliers"]
    columns = [list(ids), *position.T.tolist(), *_covariance_columns(cov, n, d)]
    columns += [localisable.astype(int).tolist(), sightings.tolist(), outliers.tolist()]
    if heading is not None:
        variance = np.full(heading.shape, np.nan) if heading_var is None else heading_var
        head += [*TURNS[d], *(f"var_{name}" for name in TURNS[d])]
        columns += np.column_stack([heading, variance]).T.tolist()
    write_table(path, head, zip(*columns, strict=True))


def write_others(path: Path, ids: Sequence[str], others: Sequence[OtherAnswer]) -> None:
    """`answer,chi2,id,x,y,z,rx,ry,rz`: answers that fit about as well, from 2 on; `positions.csv` is the first."""
    head = ["answer", "chi2", "id", *"xyz", *TURNS[3]]
    rows = [
        (number, one.chi2, name, *place, *turn)
        for number, one in enumerate(others, 2)
        for name, place, turn in zip(ids, one.position.tolist(), one.heading.tolist(), strict=True)
    ]
    write_table(path, head, rows)


def write_track(
    path: Path,
    t: Float[np.ndarray, " k"],
    position: Float[np.ndarray, "k d"],
    cov: Float[np.ndarray, "k d d"] | None,
    heading: Float[np.ndarray, " k"] | None = None,
) -> None:
    """`t,x,y[,z],var_x,..[,heading]`: one robot over time."""
    d = position.shape[1]
    head = ["t", *"xyz"[:d], *NAMES[d]]
    columns = [t.tolist(), *position.T.tolist(), *_covariance_columns(cov, len(t), d)]
    if heading is not None:
        head.append("heading")
        columns.append(heading.tolist())
    write_table(path, head, zip(*columns, strict=True))


def read_positions(path: Path) -> Positions:
    """What `write_positions` wrote; raises ReaderError where the table is none of its kind."""
    table = read_table(path)
    position, cov = _moments(table)
    if "localisable" not in table.columns:
        raise ReaderError(path, f"expected a column localisable, found {','.join(table.columns)}", 1)
    return Positions(tuple(table.names("id")), position, cov, table.numbers("localisable") > 0)


def read_track(path: Path) -> RobotTrajectory:
    """What `write_track` wrote; covariances are None where one is missing. Raises ReaderError."""
    table = read_table(path)
    position, cov = _moments(table, "t")
    t = table.numbers("t")
    if not (np.isfinite(t).all() and np.isfinite(position).all() and (np.diff(t) > 0).all()):
        raise ReaderError(path, "expected stamps that ascend strictly and finite positions")
    return RobotTrajectory(t, position, cov if np.isfinite(cov).all() else None)


def track_files(ids: Sequence[str]) -> dict[str, str]:
    """The file name of every robot's track: its id, with `_` for what file names cannot hold, each name once.

    Of ids that would share a name (also on systems that do not tell a from A) all but the first get `-2`, `-3`, ...
    """
    plain = {name: "".join(c if c.isalnum() or c in "-_." else "_" for c in name) for name in ids}
    plain = {name: f"{word}_" if word.split(".")[0].casefold() in DEVICES else word for name, word in plain.items()}
    taken: set[str] = set()
    seen: Counter[str] = Counter()
    out = {}
    for name in ids:
        word = plain[name]
        while word.casefold() in taken:
            seen[plain[name].casefold()] += 1
            word = f"{plain[name]}-{seen[plain[name].casefold()] + 1}"
        taken.add(word.casefold())
        out[name] = f"{word}.csv"
    return out


def write_network(path: Path, pairs: Int[np.ndarray, "m 2"], information: JointInformation | None) -> None:
    """`network.npz`: who sighted whom (m, 2, rows of `positions.csv`), and the joint information where it is known.

    The information matrix stands as the entries of its lower triangle: `row`, `column`, `value`, with `held` (s,) and
    `width`, the scalars a robot.
    """
    arrays: dict[str, np.ndarray] = {"pairs": pairs.astype(np.int32)}
    if information is not None:
        lower = sp.coo_matrix(sp.tril(information.matrix))
        arrays |= {
            "row": lower.row.astype(np.int32),
            "column": lower.col.astype(np.int32),
            "value": lower.data,
            "held": information.held,
            "width": np.array(information.width),
        }
    write_npz(path, **arrays)


def read_network(path: Path, n: int) -> tuple[Int[np.ndarray, "m 2"], JointInformation | None]:
    """What `write_network` wrote of n robots; raises ReaderError where it is damaged or of other robots."""
    try:
        held = read_npz(path, {"pairs": ("whole", ("pairs", 2))}, INFORMATION, "the network that locate writes")
        pairs = np.asarray(held["pairs"], dtype=np.int64)
        if len(pairs) and not 0 <= pairs.min() <= pairs.max() < n:
            raise ReaderError(path, f"expected pairs of {n} robots, found number {pairs.max()}")
        if "value" not in held:
            return pairs, None
        width = int(held["width"])
        lower = sp.coo_matrix((held["value"], (held["row"], held["column"])), shape=(n * width, n * width))
        known = np.asarray(held["held"], dtype=bool)
        if len(known) != n * width:
            raise ReaderError(path, f"expected {n} robots of {width} scalars, found {len(known)} in all")
        return pairs, JointInformation(sp.csc_matrix(lower + sp.tril(lower, -1).T), known, width)
    except (KeyError, ValueError, TypeError, OverflowError, IndexError) as error:
        raise ReaderError(path, f"expected the network that locate writes: {error}") from None


def _covariance_columns(cov: Float[np.ndarray, "n d d"] | None, n: int, d: int) -> list[list[float]]:
    """The columns `NAMES[d]`, NaN without covariances."""
    columns = np.full((len(NAMES[d]), n), np.nan) if cov is None else np.stack([cov[:, a, b] for a, b in ORDER[d]])
    return [column.tolist() for column in columns]


def _moments(table: Table, first: str = "id") -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d d"]]:
    """Positions and covariances (NaN where the table says nothing)."""
    dim = 3 if "z" in table.columns else 2
    wanted = (first, *"xyz"[:dim], *NAMES[dim])
    missing = [name for name in wanted if name not in table.columns]
    if missing:
        raise ReaderError(table.path, f"expected columns {','.join(wanted)}, found {','.join(table.columns)}", 1)
    place = np.column_stack([table.numbers(name) for name in "xyz"[:dim]])
    cov = np.full((len(table), dim, dim), np.nan)
    for name, (a, b) in zip(NAMES[dim], ORDER[dim], strict=True):
        cov[:, a, b] = cov[:, b, a] = table.numbers(name)
    wild = np.flatnonzero(np.isinf(place).any(axis=1) | np.isinf(cov).any(axis=(1, 2)))
    if len(wild):
        raise ReaderError(table.path, "expected finite positions and covariances", table.lines[int(wild[0])])
    return place, cov
