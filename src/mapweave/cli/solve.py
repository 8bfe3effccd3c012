"""`mapweave solve`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from ..report.result import ResultBase


def solve(
    file: Path,
    /,
    *,
    out: Path,
    robust: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Find the poses that agree best with a planar pose graph, or place robots and beacons by their ranges.

    Parameters
    ----------
    file
        A g2o file, plain or gzipped: VERTEX_SE2 (may be missing), EDGE_SE2, EDGE_PRIOR_SE2 and FIX rows. Or a .pyfg
        file with ranges (EDGE_RANGE), whose vertices only name what is placed.
    out
        The folder the solved graph, its trajectory, metrics.json and report.html are written to.
    robust
        Drop the edges that contradict the others, and say which; edges from a vertex to the next are trusted. Ranges
        that contradict are always rejected.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..io.pyfg import is_pyfg
    from .terminal import say

    result: ResultBase
    if is_pyfg(file):
        from ..api.ranges import solve_ranges

        result = solve_ranges(file, out, force=force)
    else:
        from ..api.solve import solve_pose_graph

        result = solve_pose_graph(file, out, robust=robust, force=force)
    say(result.summary())
    say(f"report: {out / 'report.html'}")
