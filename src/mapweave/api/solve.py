"""Anybody's planar pose graph, solved."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import EstimateError
from ..core.gaussian import chi2_quantile
from ..core.paths import checked_arguments, is_path, path_of
from ..core.records import Track
from ..core.version import __version__
from ..io.directory import check_target, write_json
from ..io.g2o import G2oFile, graph_of, is_graph, read_g2o_file, write_g2o
from ..io.table import open_text
from ..io.tum import write_track_covariance, write_tum
from ..laser.pose_graph import PoseGraph
from ..laser.robust_graph import RobustGraphConfig, SolvedGraph, solve_graph
from ..report.result import ResultBase, written
from ..report.small_pages import graph_scene, write_solve_report
from ..report.style import Target

CHANCE = 1e-6  # that a sound graph is called doubtful, in each way it is looked at
EXPECTED = "a path or a pose graph in memory"
TOLD = 5  # dropped edges named one by one on the terminal


@dataclass(frozen=True, slots=True, repr=False)
class SolveResult(ResultBase):
    """What `solve_pose_graph` gives: the graph with its poses solved, and the edges rejected as outliers.

    covariance: (n, 3, 3) of every pose, zero where it is held; None when the solve did not converge. doubts: those of
    `warnings` for which the result is not to be trusted; none when it is.
    """

    source: Path
    file: G2oFile
    solved: SolvedGraph
    covariance: Float[np.ndarray, "n 3 3"] | None
    robust: bool
    doubts: tuple[str, ...]
    warnings: tuple[str, ...]
    timing: dict[str, float] = field(compare=False)

    @property
    def metrics(self) -> dict[str, Any]:
        s, ids = self.solved, self.file.ids
        parts = int(s.component.max()) + 1
        return {
            "version": __version__,
            "source": self.source.name,
            "poses": len(s.graph),
            "edges": s.graph.edges,
            "robust": self.robust,
            "residual": "z^-1 (x_i^-1 x_j) as x, y, theta",
            "status": str(s.status),
            "chi2_before": s.chi2_before,
            "chi2": s.chi2,
            "dof": s.dof,
            "iterations": s.iterations,
            "rounds": s.rounds,
            "fixed": [ids[k] for k in s.fixed],
            "priors": len(self.file.priors),
            "closures_dropped": len(s.dropped),
            "dropped": [
                {"edge": d.edge, "from": ids[d.first], "to": ids[d.second], "nis": d.nis, "reason": d.reason}
                for d in s.dropped
            ],
            "components": [[ids[k] for k in np.flatnonzero(s.component == c).tolist()] for c in range(parts)],
            "component_sizes": np.bincount(s.component).tolist(),
            "trusted": not self.doubts,
            "doubts": list(self.doubts),
            "warnings": list(self.warnings),
            "timing": self.timing,
        }

    def lines(self) -> list[str]:
        s = self.solved
        sizes = f"{len(s.graph)} poses, {s.graph.edges} edges"
        chi2 = f"chi-square {s.chi2_before:.6g} before, {s.chi2:.6g} after ({s.dof} degrees of freedom)"
        lines = [f"{sizes}: {chi2}, {s.iterations} iterations"]
        if self.robust:
            lines.append(f"{len(s.dropped)} of {s.graph.edges} edges contradict the others and were dropped")
        ids = self.file.ids
        lines += [f"dropped edge {d.edge} ({ids[d.first]} to {ids[d.second]}): {d.reason}" for d in s.dropped[:TOLD]]
        lines += [warning for warning in self.warnings if warning not in self.doubts]
        return [*lines, *(f"not to be trusted: {why}" for why in self.doubts)]

    def draw(self, target: Target) -> None:
        """The solved poses and the edges between them."""
        graph_scene(self.file.graph.pose, self.solved, self.file.ids).draw(target)

    def write_into(self, folder: Path) -> None:
        graph, ids = self.solved.graph, self.file.ids
        write_json(folder / "metrics.json", self.metrics)
        write_g2o(folder / "pose_graph.g2o", graph, ids, self.solved.fixed)
        track = Track(np.array(ids, dtype=float), graph.pose, self.covariance)
        write_tum(folder / "trajectories" / "robot1.tum", track)
        if self.covariance is not None:
            write_track_covariance(folder / "trajectories" / "robot1.cov.csv", track)
        with open_text(folder / "closures.csv") as file:
            file.write("edge,from,to,nis,used,reason\n")
            why = {d.edge: d.reason for d in self.solved.dropped}
            for k, (i, j) in enumerate(zip(graph.first.tolist(), graph.second.tolist(), strict=True)):
                if abs(i - j) != 1 or k in why:
                    nis, used = float(self.solved.nis[k]), int(k not in why)
                    file.write(f'{k},{ids[i]},{ids[j]},{nis:.6g},{used},"{why.get(k, "")}"\n')
        write_solve_report(folder, self.source.name, self.file.graph.pose, self.solved, ids, self.lines())


@checked_arguments
def solve_pose_graph(
    file: Path | str | PoseGraph | Mapping[str, Any],
    out: Path | str | None = None,
    *,
    robust: bool = False,
    force: bool = False,
) -> SolveResult:
    """Solve a planar pose graph, anybody's: the poses that agree best with its edges, and their covariances.

    Written to `out` if given; stamps of the trajectory are the vertices' numbers.

    Parameters
    ----------
    file
        A g2o file with VERTEX_SE2 and EDGE_SE2 rows. Or the graph in memory: a `PoseGraph`, or `edges`, a table with
        the columns `from`, `to` (whole numbers), x [m], y [m], theta [rad] of the pose of `to` in the frame of `from`
        and `information` (m, 3, 3) over these [1/m^2, 1/rad^2], beside `poses` to start from, a table with the columns
        id, x, y, theta or rows of x, y, theta numbered from 0 (found by walking along the edges).
    robust
        Reject edges that contradict the others, those from a vertex to the next excepted (False).

    Raises
    ------
    ReaderError
        For a file that is missing or damaged, with its line.
    DataError
        For a graph that cannot be solved.
    EstimateError
        For a solve that failed.
    UsageError
        For an `out` that holds something other than a result. Nothing is written then.

    Examples
    --------
    >>> import numpy as np
    >>> steps = {"from": [0, 1], "to": [1, 2], "x": [1.0, 1.0], "y": [0.0, 0.0], "theta": [0.0, 0.0]}
    >>> solve_pose_graph({"edges": {**steps, "information": [100.0 * np.eye(3)] * 2}}).solved.graph.pose[2].tolist()
    [2.0, 0.0, 0.0]
    """
    check_target(out, force=force, reads=(file,))
    started = perf_counter()
    held = graph_of(file, "file") if is_graph(file) else read_g2o_file(path_of(file, "file", EXPECTED), parts=True)
    source = path_of(file, "file") if is_path(file) else Path("in memory")
    read = perf_counter()
    cfg = RobustGraphConfig(method="gnc" if robust else "none")
    solved = solve_graph(held.graph, cfg, fixed=held.fixed, priors=held.priors)
    if not np.isfinite(solved.graph.pose).all() or not np.isfinite(solved.chi2):
        raise EstimateError(f"{source}: the solve ended with numbers that are not finite ({solved.status})")
    done = perf_counter()
    covariance = solved.covariances() if solved.solution.information is not None else None
    timing = {"read": read - started, "solve": done - read, "covariance": perf_counter() - done}
    doubts = _doubts(held, solved, robust=robust)
    warnings = (*_warnings(held, solved), *doubts)
    result = SolveResult(source, held, solved, covariance, robust, doubts, warnings, timing)
    return written(result, out, force=force)


def _warnings(held: G2oFile, solved: SolvedGraph) -> tuple[str, ...]:
    warnings = list(held.warnings)
    if not held.started.any():
        warnings.append("the file has no vertices: the solve starts from poses found by walking along its edges")
    sizes = np.bincount(solved.component)
    if len(sizes) > 1:
        parts = ", ".join(
            f"{size} poses from vertex {held.ids[int(np.argmax(solved.component == c))]} on"
            for c, size in enumerate(sizes.tolist()[:6])
        )
        more = "" if len(sizes) <= 6 else f" and {len(sizes) - 6} more"
        warnings.append(
            f"the graph falls into {len(sizes)} parts that no edge ties, each solved in its own frame: {parts}{more}"
        )
    return tuple(warnings)


def _doubts(held: G2oFile, solved: SolvedGraph, *, robust: bool) -> tuple[str, ...]:
    """Why the solution is not to be trusted."""
    doubts: list[str] = []
    if not solved.converged:
        doubts.append(f"the solve did not converge ({solved.status})")
    limit = chi2_quantile(1.0 - CHANCE, 3.0)
    for prior, nis in zip(held.priors, solved.prior_nis.tolist(), strict=True):
        if nis > limit:
            where = f"the prior of vertex {held.ids[prior.vertex]} contradicts the rest of the graph"
            doubts.append(f"{where}: it lies {np.sqrt(nis):.1f} standard deviations from the solution without it")
    for vertex, nis in zip(solved.fixed, solved.fixed_nis.tolist(), strict=True):
        if nis > limit:
            where = f"vertex {held.ids[vertex]} is held where the rest of the graph does not put it"
            doubts.append(f"{where}: it lies {np.sqrt(nis):.1f} standard deviations from there")
    ties = int((np.abs(solved.graph.second - solved.graph.first) != 1).sum())
    if 2 * len(solved.dropped) > ties:
        doubts.append(f"{len(solved.dropped)} of {ties} edges beside the steps were dropped, more than were believed")
    if solved.dof > 0 and solved.chi2 > chi2_quantile(1.0 - CHANCE, float(solved.dof)):
        mend = "" if robust else "; --robust drops those that contradict"
        doubts.append(
            f"edges contradict each other or are less sure than they say: chi-square {solved.chi2:.6g} with "
            f"{solved.dof} degrees of freedom{mend}"
        )
    return tuple(doubts)
