"""Which old places a new keyframe is matched against."""

import numpy as np

from ..core import se2
from .closures import ClosureConfig, Matcher
from .keyframe_graph import KeyframeGraph


class LoopSearch:
    """Keyframes wait here until they are matched against old places, a few at a time."""

    def __init__(self, cfg: ClosureConfig, matcher: Matcher, robots: int) -> None:
        self.cfg, self.matcher = cfg, matcher
        self._untried: list[list[int]] = [[] for _ in range(robots)]
        self._path = np.full(robots, -np.inf)

    def offer(self, graph: KeyframeGraph, i: int) -> None:
        """Keyframe `i` will be tried when its robot drove far enough since the last one that was."""
        node = graph.nodes[i]
        if node.path - self._path[node.robot] >= self.cfg.every:
            self._path[node.robot] = node.path
            self._untried[node.robot].append(i)

    def step(self, graph: KeyframeGraph, j: int) -> None:
        """At most `tries` matches of robot j's keyframes, the oldest first."""
        left = self.cfg.tries
        while self._untried[j] and left > 0:
            i = self._untried[j].pop(0)
            for k in self.candidates(graph, i)[:left]:
                cov = graph.relative(k, i)
                if cov is None:
                    continue
                left -= 1
                match = self.matcher.match(
                    graph.place(k), graph.nodes[i].beams, se2.between(graph.pose[k], graph.pose[i]), cov
                )
                graph.close(k, i, match)
                if match.accepted:
                    moved = match.innovation @ np.linalg.solve(cov + 1e-12 * np.eye(3), match.innovation)
                    graph.due |= bool(moved > graph.cfg.resolve_innovation**2)

    def candidates(self, graph: KeyframeGraph, i: int) -> list[int]:
        """Solved keyframes near in the estimate, one a chain (another robot, or this one long ago), nearest first."""
        c, node, n = self.cfg, graph.nodes[i], graph.known
        d = np.hypot(*(graph.pose[:n, :2] - graph.pose[i, :2]).T)
        robot = graph.robot[:n]
        near = (d < c.reach) & ((robot != node.robot) | (graph.path[:n] < node.path - c.far))
        out: list[tuple[float, int]] = []
        for j in np.unique(robot[near]):
            mine = np.flatnonzero(near & (robot == j))
            best = int(mine[np.argmin(d[mine])])
            out.append((float(d[best]), best))
        return [k for _, k in sorted(out)]
