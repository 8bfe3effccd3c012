"""`mapweave config JOB`."""

from typing import Annotated, Literal

from cyclopts import Parameter


def config(
    job: Literal["map", "fuse", "locate", "localize", "explore"],
    /,
    *,
    laser: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Print every setting of a job with its default and meaning, as TOML to edit and hand back with --config.

    Parameters
    ----------
    job
        map, fuse, locate, localize or explore.
    laser
        The settings for laser logs (map, fuse) or laser worlds (explore).
    """
    from ..api.configuration import configuration
    from .terminal import say

    say(configuration(job, laser=laser).rstrip("\n"))
