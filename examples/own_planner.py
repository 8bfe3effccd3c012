"""A planner of one's own: a function from what the team knows to the robots' speeds and turn rates."""

from typing import Any

import numpy as np

import mapweave


def sweep(belief: Any, poses: np.ndarray, cfg: mapweave.ExploreConfig) -> np.ndarray:
    """Every robot drives straight on and turns left near the edge of the field.

    poses: (M, 3) [m, m, rad]; returns (M, 2): speed [m/s] and turn rate [rad/s], which must be among those of `cfg`.
    """
    ahead = poses[:, :2] + 12.0 * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    leaving = ((ahead < belief.lower) | (ahead > belief.upper)).any(axis=1)
    return np.column_stack([np.where(leaving, 1.0, 2.0), np.where(leaving, max(cfg.commands.turns) / 2, 0.0)])


# A planner is named as module:function; in a script or notebook the module is __main__.
for planner in (f"{__name__}:sweep", "coverage"):
    result = mapweave.explore("yuan", planner=planner, until=60, seed=2)
    first = result.first
    print(f"{planner}: {100 * first.moments[-1].explored:.0f} % of the field seen in {result.runs[0].steps} steps")
