"""`mapweave reproduce hara`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def hara(
    *,
    out: Path | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Repeat the map building of Hara, Kawata, Ohya and Yuta: a 200 m loop, with and without light intensity.

    Parameters
    ----------
    out
        A folder for metrics.json, report.html and the maps of Figs. 4 to 7 side by side.
    quick
        Two loops and 64 particles instead of six and 512.
    seed
        The first of the loops; the same seed gives the same figures.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..papers.hara.reproduce import reproduce_hara
    from .reproduce_said import say_reproduction
    from .terminal import progress

    with progress() as on_progress:
        result = reproduce_hara(out, quick=quick, seed=seed, force=force, on_progress=on_progress)
    say_reproduction(result, out)
