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
    """Repeat the map merging of Kojima, Okawa and Namerikawa, and set Table 2 and Fig. 7 beside ours.

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
    from .terminal import progress, say, say_table

    with progress() as on_progress:
        result = reproduce_kojima(out, quick=quick, seed=seed, force=force, on_progress=on_progress)
    say(f"Kojima, Okawa, Namerikawa: two robots, 700 merges, {result.seeds} simulated worlds\n")
    for title, (head, rows) in (
        ("Table 2, errors (root mean square over the worlds, and the spread between worlds)", result.table2()),
        ("Fig. 7, trace of the global covariance [m² + rad²]", result.trace_table()),
        ("Is the covariance honest? (1 is)", result.honesty_table()),
        (f"Unequal maps, used once ({result.unequal_seeds} worlds)", result.unequal_table()),
    ):
        say(title)
        say_table(head, rows)
        say()
    say("What differs, and why")
    for sentence in result.differences():
        say(f"- {sentence}")
    if out is not None:
        say(f"\nreport: {out / 'report.html'}")
