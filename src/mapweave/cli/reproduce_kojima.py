"""`mapweave reproduce kojima`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def kojima(
    *,
    out: Path | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Repeat the map merging of Kojima, Okawa and Namerikawa, and set Table 2 and Figs. 4 to 7 beside ours.

    Parameters
    ----------
    out
        A folder for metrics.json, report.html and figures.
    quick
        20 worlds instead of 200.
    seed
        The same seed gives the same figures.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..papers.kojima.reproduce import reproduce_kojima
    from .reproduce_said import say_reproduction
    from .terminal import progress

    with progress() as on_progress:
        result = reproduce_kojima(out, quick=quick, seed=seed, force=force, on_progress=on_progress)
    say_reproduction(result, out)
