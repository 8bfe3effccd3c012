"""`mapweave view`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def view(
    directory: Path, /, *, rerun: Annotated[bool, Parameter(negative="")] = False, save: Path | None = None
) -> None:
    """Open the report of a result in the browser; without a display its path is printed.

    Parameters
    ----------
    directory
        What a command wrote.
    rerun
        Show walls, landmarks, closures, decisions and every robot along time in the Rerun viewer (the extra [viewer]).
    save
        Write what Rerun would show to this .rrd file instead.
    """
    from ..api.view import view as open_view
    from .terminal import say

    for line in open_view(directory, rerun=rerun, save=save):
        say(line)
