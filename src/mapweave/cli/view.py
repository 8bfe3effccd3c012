"""`mapweave view`."""

from pathlib import Path


def view(directory: Path, /) -> None:
    """Open the report of a result in the browser, and the map in Rerun where the extra [viewer] is installed.

    Without a display the report's path is printed.

    Parameters
    ----------
    directory
        What a command wrote.
    """
    from ..api.view import view as open_view
    from .terminal import say

    for line in open_view(directory):
        say(line)
