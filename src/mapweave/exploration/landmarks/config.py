"""Everything that can be set about an exploration of a landmark world."""

import numpy as np
from jaxtyping import Float

from ...core.config import config
from ...landmarks.submap_slam import SubmapConfig


@config
class ExploreConfig:
    """Weights, thresholds and discretisation of one exploration."""

    submap: SubmapConfig = SubmapConfig()
    speeds: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)  # [m/s]
    turns: tuple[float, ...] = tuple(float(k) * np.pi / 8 for k in range(-4, 5))  # [rad/s]
    w_accuracy: float = 1 / 3
    w_area: float = 1 / 3
    w_apart: float = 1 / 3
    escape_uncertainty: float = 0.3  # C_t
    negligible_gain: int | None = None  # cells; a control that would see no more gains no area; see `gain_threshold`
    stall_steps: int = 10  # steps without gain after which the robot escapes whatever its uncertainty
    lost: float = 6.0  # [m], standard deviation of a robot's place in the map beyond which it looks for known landmarks
    literal_escape: bool = False  # the printed rule alone: deadlocks under the stated noise
    apart_distance: float = 20.0  # [m], d_t
    cell: float = 1.0  # [m]
    fuse_after: int = 10  # steps, n_s
    fuse_uncertainty: float = 0.3  # C_f
    fuse_by: int = 60  # steps after which a submap is handed over whatever its uncertainty
    fusion_gate: float = 18.42
    fusion_sure: float = 0.9  # probability above which two landmarks of unknown identity become one
    fusion_density: float = 4e-4  # [1/m^2] landmarks expected, times the chance that one beside a new one went unseen
    max_steps: int = 1500
    cover_radius: float = 10.0  # [m], discs of the coverage planner
    replan_every: int = 4  # steps
    gain_weight: float = 0.12  # [m] a newly seen cell is worth to the coverage planner
    loop_radius: float = 13.0  # [m], discs of the loop planner: fewer, so that a lap closes in time
    loop_rate: float = 20.5  # [m^2] of field a robot and step: how long the loop planner goes on to close loops
    loop_rate_alone: float = 17.0  # the same for one robot, whose lap is longer
    joint_rate: float = 23.5  # [m^2] of field a robot and step: how long the joint planner's laps take
    joint_rate_alone: float = 20.0  # the same for one robot
    joint_density: float = 1 / 275  # landmarks a square metre that the joint planner expects
    joint_error_weight: float = 60.0  # steps that a metre of expected map error is worth to it
    joint_tries: int = 1500  # plans it tries before the first step

    robot_radius: float = 0.3  # [m]
    wall_margin: float = 0.4  # [m] beyond the radius that planned ways and offered controls keep from walls
    wall_comfort: float = 1.2  # [m] beyond the radius that robots keep where nothing draws them nearer
    path_cell: float = 0.4  # [m], raster on which ways round walls are found
    put_off_after: int = 60  # steps after which a target among walls that was not seen is put off
    contact_steps: int = 40  # for so long the place where a robot met a wall unexpectedly is kept clear of

    @property
    def gain_threshold(self) -> int:
        """Cells that gain no area. None chosen: 12 as part of the area term, the printed 0 where there is no such term.

        The printed rule (no cell at all) keeps the paper's robots at specks which their area term is too weak to fetch.
        """
        if self.negligible_gain is not None:
            return self.negligible_gain
        return 12 if self.w_area else 0

    @property
    def controls(self) -> Float[np.ndarray, "m 2"]:
        """All (v, w) offered, slow and right-turning first."""
        return np.array([(v, w) for v in self.speeds for w in self.turns])
