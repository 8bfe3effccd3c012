"""`mapweave evaluate`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def evaluate(
    directory: Path,
    /,
    *,
    truth: Annotated[list[Path], Parameter(negative="", consume_multiple=True)],
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Score a result against the truth: errors, and whether its uncertainty is honest.

    The score is added to the result's report.html and metrics.json, in place of an earlier one.

    Parameters
    ----------
    directory
        What `map`, `fuse` or `locate` wrote.
    truth
        An MRCLAM data set (folder or zip), a landmark survey `id,x,y`, TUM trajectories, relations, or the truth of a
        simulated swarm; found out from the name and the first lines.
    json
        Print JSON with the keys documented for `metrics.json`.
    """
    from ..api.evaluate import evaluate as score
    from .terminal import say, warn

    evaluation = score(directory, truth)
    try:
        evaluation.add_to(directory, truth)
    except OSError as error:
        warn(f"{error.filename}: {error.strerror}: the report is left as it is")
    if json:
        from json import dumps

        from ..io.directory import plain

        say(dumps(plain(evaluation.as_json()), indent=1, ensure_ascii=False))
        return
    say(evaluation.summary())
