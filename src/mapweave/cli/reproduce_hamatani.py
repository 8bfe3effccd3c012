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
    from ..papers.hamatani.reproduce import PRINTED, TITLES, reproduce_hamatani
    from .terminal import progress, say, say_table

    with progress() as on_progress:
        result = reproduce_hamatani(out, quick=quick, seed=seed, force=force, on_progress=on_progress)
    say("Hamatani, Nakamura, Naruse: five robots, bearings alone\n")
    say(f"Settings: {result.settings()}\n")
    for number in PRINTED:
        say(TITLES[number])
        say_table(*result.table(number))
        say()
    say("The drift of scale, nothing known")
    say_table(*result.drift_table())
    say("\nWhat differs, and why")
    for sentence in result.differences():
        say(f"- {sentence}")
    if out is not None:
        say(f"\nreport: {out / 'report.html'}")
