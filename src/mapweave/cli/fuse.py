"""`mapweave fuse`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def fuse(
    *directories: Path,
    out: Path,
    weights: str | None = None,
    identities: Literal["known", "unknown"] | None = None,
    truth: Annotated[list[Path] | None, Parameter(negative="", consume_multiple=True)] = None,
    config: Path | None = None,
    seed: int = 0,
    decisions: Path | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Fuse the local maps of several runs into one map.

    Parameters
    ----------
    directories
        Results of `map` or `fuse`, of landmark logs or of laser logs; their robots are called DIR/robotK.
    out
        The folder to write, laid out as `map` does.
    weights
        How much each robot's map counts: constant, paper, diagonal, full, full-scaled or naive (full-scaled).
    identities
        Whether equal ids are one landmark (known), or which are the same is found out from the places alone (unknown).
    truth
        Score the result against this when it is done.
    config
        A TOML file with settings of fusing; options on the command line win.
    seed
        Kept in metrics.json; the result does not depend on it.
    decisions
        A decisions.toml of this result, edited: pairs of robots and places that are together, or apart (laser results).
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..api.fuse import fuse as run
    from .terminal import progress, say

    with progress() as on_progress:
        result = run(
            directories,
            out,
            weights=weights,
            identities=identities,
            truth=tuple(truth or ()),
            config=config,
            seed=seed,
            decisions=decisions,
            force=force,
            on_progress=on_progress,
        )
    say(result.summary())
    say(f"report: {out / 'report.html'}")
