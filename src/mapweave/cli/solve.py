"""`mapweave solve`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def solve(
    file: Path,
    /,
    *,
    out: Path,
    robust: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Find the poses that agree best with a planar pose graph.

    Parameters
    ----------
    file
        A g2o file, plain or gzipped: VERTEX_SE2 (may be missing), EDGE_SE2, EDGE_PRIOR_SE2 and FIX rows.
    out
        The folder the solved graph, its trajectory, metrics.json and report.html are written to.
    robust
        Drop the edges that contradict the others, and say which; edges from a vertex to the next are trusted.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..api.solve import solve_pose_graph
    from .terminal import say

    result = solve_pose_graph(file, out, robust=robust, force=force)
    say(result.summary())
    say(f"report: {out / 'report.html'}")
