"""`view`: a result's report in the browser, its map in the viewer where there is one."""

import os
import sys
import webbrowser
from pathlib import Path

from ..core.errors import ReaderError
from ..io.team_map import read_metrics, read_team_maps
from ..viewer.base import viewer


def view(directory: Path | str, *, browser: bool = True) -> list[str]:
    """Opens the report (unless there is no display or `browser` is False) and the viewer; what was done, line by line.

    Raises ReaderError when `directory` holds no result.
    """
    folder = Path(directory)
    read_metrics(folder)
    report = folder / "report.html"
    if not report.is_file():
        raise ReaderError(folder, "expected report.html, found none")
    if not (browser and _has_display()):
        return [f"report: {report}"]
    webbrowser.open(report.resolve().as_uri())
    done = [f"opened {report}"]
    shown = viewer(wanted=(folder / "landmarks.npz").is_file(), title=folder.name)
    if shown.name:
        for k, team in enumerate(read_team_maps(folder), 1):
            shown.show(team, f"component_{k}")
        done.append(f"opened the map in {shown.name}")
    return done


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
