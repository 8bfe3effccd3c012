"""`mapweave reproduce yuan`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def yuan(
    *,
    out: Path | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    jobs: int = 1,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Repeat the active SLAM of Yuan, Huang, Tao and Xi, and set Table 1, Figs. 1 and 2 beside ours.

    Parameters
    ----------
    out
        A folder for metrics.json, report.html and figures.
    quick
        4 runs a case instead of 30.
    seed
        The same seed gives the same figures.
    jobs
        How many runs are worked on at once; the result is the same.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..papers.yuan.reproduce import reproduce_yuan
    from .reproduce_said import say_reproduction
    from .terminal import progress

    with progress() as on_progress:
        result = reproduce_yuan(out, quick=quick, seed=seed, jobs=jobs, force=force, on_progress=on_progress)
    say_reproduction(result, out)
