"""Maps and trajectories in the Rerun viewer."""

import numpy as np
import rerun as rr

from ..core.gaussian import ellipse
from ..team.team_map import TeamMap

AROUND = np.linspace(0.0, 2 * np.pi, 33)
COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0), (240, 228, 66))


class RerunViewer:
    """Spawns the Rerun viewer and logs to it; `show` may be called again as a map grows."""

    name = "Rerun"

    def __init__(self, title: str, *, spawn: bool = True) -> None:
        rr.init(title, spawn=spawn)

    def show(self, team: TeamMap, entity: str = "map") -> None:
        """Landmarks with their 95 % ellipses, and every trajectory in a colour of its own."""
        landmarks = team.landmarks
        rr.log(f"{entity}/landmarks", rr.Points2D(landmarks.mean, labels=list(landmarks.ids), radii=0.03))
        rings = []
        for i, p in enumerate(landmarks.mean):
            a, b, angle = ellipse(landmarks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])
            ring = np.column_stack([a * np.cos(AROUND), b * np.sin(AROUND)])
            c, s = np.cos(angle), np.sin(angle)
            rings.append(p + ring @ np.array([[c, s], [-s, c]]))
        rr.log(f"{entity}/ellipses", rr.LineStrips2D(rings))
        for k, (robot, track) in enumerate(team.tracks.items()):
            rr.log(f"{entity}/{robot}", rr.LineStrips2D([track.pose[:, :2]], colors=[COLOURS[k % len(COLOURS)]]))
