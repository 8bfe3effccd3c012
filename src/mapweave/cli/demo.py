"""`mapweave demo`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def demo(
    *, out: Path = Path("mapweave-demo"), seed: int = 2012, force: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Simulate a small team, map what each robot saw, weave the maps together, and score the result.

    Parameters
    ----------
    out
        The folder to write; open report.html in it.
    seed
        Another seed, another team.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..api.demo import demo as run
    from .terminal import progress, say

    say("Four simulated robots drive for five minutes among 24 landmarks, none knowing where the others began.")
    with progress() as on_progress:
        result = run(out, seed=seed, force=force, on_progress=on_progress)
    say(result.summary())
    say(f"Look at {out / 'report.html'}")
