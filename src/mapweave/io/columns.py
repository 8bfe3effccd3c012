"""Tables in memory: a mapping of columns, a structured array or a data frame becomes what readers of files give."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError
from .table import NAMED, Table


@runtime_checkable
class Framed(Protocol):
    """Columns by name, as a data frame or a structured array gives them."""

    def __getitem__(self, name: Any, /) -> Any: ...


Columns = Mapping[str, Any] | Framed


def table_of(given: Columns, label: str) -> Table:
    """The columns of `given` as a table that errors call `label`; its lines are its rows, counted from 1.

    Numbers stay arrays, anything else becomes text. Raises DataError for what has no columns, for columns of unequal
    length and for one of several dimensions.
    """
    columns: dict[str, Sequence[str] | np.ndarray] = {}
    for name in _names(given, label):
        values = np.asarray(given[name])
        if values.ndim != 1:
            raise DataError(f"{label}: expected one value a row for {name}, found the shape {values.shape}")
        key = str(name).strip().lower()
        numeric = values.dtype.kind in "fiub" and key not in NAMED
        columns[key] = values if numeric else [_as_text(v) for v in values.tolist()]
    sizes = {name: len(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1:
        told = ", ".join(f"{name} {n}" for name, n in sizes.items())
        raise DataError(f"{label}: expected columns of one length, found {told}")
    return Table(label, columns, range(1, next(iter(sizes.values()), 0) + 1))


def array_of(given: Columns, name: str, label: str, dims: int) -> Float[np.ndarray, "..."]:
    """The entry `name` as floats of `dims` dimensions; raises DataError where it is missing or of another shape."""
    if name not in _names(given, label):
        raise DataError(f"{label}: expected {name}, found {', '.join(map(str, _names(given, label)))}")
    try:
        values = np.asarray(given[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(f"{label}: expected numbers for {name}, all rows of one length") from None
    if values.ndim != dims:
        raise DataError(f"{label}: expected {dims} dimensions for {name}, found the shape {values.shape}")
    return values


def _names(given: Columns, label: str) -> list[Any]:
    found = given.keys() if isinstance(given, Mapping) else getattr(given, "columns", None)
    if found is None:
        found = getattr(getattr(given, "dtype", None), "names", None)
    if found is None:
        raise DataError(f"{label}: expected columns by name, found {type(given).__name__}")
    return list(found)


def _as_text(value: object) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
