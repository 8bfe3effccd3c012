"""Pose graphs as g2o text: `VERTEX_SE2 i x y theta`, `EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33`."""

from pathlib import Path

import numpy as np

from ..laser.pose_graph import PoseGraph
from .rows import open_text, write_rows


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """`path` holds the graph; its first vertex is fixed."""
    vertices = np.column_stack([np.arange(len(graph)), graph.pose])
    I = graph.information
    upper = np.column_stack([I[:, 0, 0], I[:, 0, 1], I[:, 0, 2], I[:, 1, 1], I[:, 1, 2], I[:, 2, 2]])
    with open_text(path) as file:
        write_rows(file, "VERTEX_SE2 %d %.9g %.9g %.9g\n", vertices)
        if len(graph):
            file.write("FIX 0\n")
        edges = np.column_stack([graph.first, graph.second, graph.measured, upper])
        write_rows(file, "EDGE_SE2 %d %d" + " %.9g" * 9 + "\n", edges)
