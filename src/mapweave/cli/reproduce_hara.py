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
    from ..papers.hara.reproduce import NOTES, reproduce_hara
    from .terminal import progress, say, say_table

    with progress() as on_progress:
        result = reproduce_hara(out, quick=quick, seed=seed, force=force, on_progress=on_progress)
    say(f"Hara, Kawata, Ohya, Yuta: trajectory error [m] on a loop of 200 m, {result.errors.shape[1]} drives\n")
    say_table(*result.table())
    say("\nWhat differs, and why")
    for note in NOTES:
        say(f"- {note}")
    if out is not None:
        say(f"\nreport: {out / 'report.html'}")
