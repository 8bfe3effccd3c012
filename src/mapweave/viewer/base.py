"""What a viewer shows, and the viewer that shows nothing: callers never ask whether there is one."""

from importlib.util import find_spec
from typing import Protocol, runtime_checkable

from ..team.team_map import TeamMap


@runtime_checkable
class Viewer(Protocol):
    """Shows maps as they come."""

    @property
    def name(self) -> str: ...
    def show(self, team: TeamMap, entity: str = "map") -> None: ...


class NullViewer:
    """Shows nothing, silently."""

    name = ""

    def show(self, team: TeamMap, entity: str = "map") -> None:
        """Nothing."""


def viewer(*, wanted: bool = True, title: str = "mapweave") -> Viewer:
    """The Rerun viewer when it is wanted and installed (the extra `[viewer]`), else one that shows nothing."""
    if not wanted or find_spec("rerun") is None:
        return NullViewer()
    from .rerun_viewer import RerunViewer  # noqa: PLC0415  (an extra)

    return RerunViewer(title)
