"""`view`: a result's report in the browser, its map in the Rerun viewer."""

import os
import sys
import webbrowser
from importlib.util import find_spec
from pathlib import Path
from tempfile import mkdtemp

from ..core.errors import EstimateError, ReaderError, UsageError
from ..core.paths import path_arguments, path_of
from ..io.finished import read_finished
from ..io.team_map import read_metrics
from ..report.result import ResultBase
from .in_memory import result_folder


@path_arguments
def view(
    directory: Path | str | ResultBase, *, browser: bool = True, rerun: bool = False, save: Path | str | None = None
) -> list[str]:
    """Open the report of a result in the browser, or its map in the Rerun viewer; returns what was done, a line each.

    Parameters
    ----------
    directory
        The result of any job, in memory or its folder. The report of one in memory is written to a folder among the
        system's temporary ones, which stays: a browser may ask for it long after.
    browser
        Open the report, unless there is no display (True).
    rerun
        Show walls, landmarks, closures, decisions and robots along time in the Rerun viewer (False): the extra
        `[viewer]`.
    save
        Write what Rerun would show to this .rrd file instead (nothing).

    Raises
    ------
    ReaderError
        Where `directory` holds no result, or a damaged one.
    UsageError
        Where Rerun is asked for and not installed, or has nothing to show.
    EstimateError
        Where the viewer cannot start.
    """
    if rerun or save is not None:
        with result_folder(directory, "directory") as folder:
            read_metrics(folder)
            return [_in_rerun(folder, None if save is None else Path(save))]
    if isinstance(directory, ResultBase):
        folder = Path(mkdtemp(prefix="mapweave-")) / "result"
        directory.write(folder)
    else:
        folder = path_of(directory, "directory", "a folder or a result in memory")
    read_metrics(folder)
    report = folder / "report.html"
    if not report.is_file():
        raise ReaderError(folder, "expected report.html, found none")
    if not (browser and _has_display()):
        return [f"report: {report}"]
    webbrowser.open(report.resolve().as_uri())
    return [f"opened {report}"]


def _in_rerun(folder: Path, save: Path | None) -> str:
    if find_spec("rerun") is None:
        raise UsageError("--rerun: the viewer is not installed: pip install 'mapweave[viewer]'")
    parts = read_finished(folder)
    if all(part.empty for part in parts):
        raise UsageError(f"{folder}: expected trajectories, walls, landmarks or positions to show, found none")
    if save is None and not _has_display():
        raise EstimateError("--rerun: no display to open the viewer on; --save FILE.rrd writes what it would show")
    from ..viewer.rerun_viewer import show_in_rerun  # noqa: PLC0415  (an extra)

    try:
        show_in_rerun(folder.resolve().name, parts, save)
    except (RuntimeError, OSError) as error:
        raise EstimateError(f"the Rerun viewer: {error}") from None
    return "opened the map in Rerun" if save is None else f"wrote {save}"


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
