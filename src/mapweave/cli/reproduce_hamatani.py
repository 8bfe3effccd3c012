"""`mapweave reproduce hamatani`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def hamatani(
    *,
    out: Path | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Repeat the five robots of Hamatani, Nakamura and Naruse, and set Tables 1, 2 and 3 beside ours.

    Parameters
    ----------
    out
        A folder for metrics.json, report.html and figures.
    quick
        3 trials a cell instead of the paper's 10.
    seed
        The same seed gives the same figures.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..papers.hamatani.reproduce import reproduce_hamatani
    from .reproduce_said import say_reproduction
    from .terminal import progress

    with progress() as on_progress:
        result = reproduce_hamatani(out, quick=quick, seed=seed, force=force, on_progress=on_progress)
    say_reproduction(result, out)
