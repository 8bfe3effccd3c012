"""The script that every page with a map begins with: a report's, and the live one."""

from functools import cache
from importlib.resources import files


@cache
def viewport() -> str:
    """`viewport(canvas, extent, draw)` in JavaScript: moving, zooming, measuring, a scale bar."""
    return (files(__package__) / "viewport.js").read_text(encoding="utf-8")
