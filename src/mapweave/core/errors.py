"""One base class; every message names what was expected and what was found."""

from collections.abc import Mapping
from typing import Any


class MapweaveError(Exception):
    """Something a user can mend; the command line prints it as one line and exits with `exit_code`."""

    exit_code = 1


class UsageError(MapweaveError):
    """The command or call itself is wrong: a bad option, an output directory that holds something else."""

    exit_code = 2


class ReaderError(MapweaveError):
    """An input file is missing, truncated or malformed; the message names file and line."""

    def __init__(self, file: object, message: str, line: int | None = None) -> None:
        where = f"{file}:{line}" if line is not None else f"{file}"
        super().__init__(" ".join(f"{where}: {message}".splitlines()))
        self.file, self.line = str(file), line


class DataError(MapweaveError):
    """The data was read but cannot give an answer (no robots, no sightings, nothing in common)."""


class ConfigError(UsageError):
    """A configuration file or option has an unknown key or a value outside its range."""


class EstimateError(MapweaveError):
    """The estimate itself failed: no convergence, a matrix that is not positive definite."""


class VerdictError(MapweaveError):
    """A result was asked for that is good, and its verdict is another; `result` is that result, written as asked."""

    def __init__(self, message: str, result: Any) -> None:
        super().__init__(message)
        self.result = result


def expect_at_most(limits: Mapping[str, tuple[float, float]]) -> None:
    """Raises UsageError for the first option of which more was asked (or NaN) than `limits` allow: (value, most)."""
    for option, (value, most) in limits.items():
        if not value <= most:
            raise UsageError(f"{option}: expected at most {most:,.10g}, found {value:,.10g}")
