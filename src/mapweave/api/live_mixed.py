"""A mixed team that drives: what its robots made apart is tied as `map` ties it before smoothing."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..fusion.compared_logs import with_copies_marked
from ..fusion.join import fuse
from ..landmarks.mapping import local_map
from ..live.joined import Apart, Joined, SightedAt, Tied
from ..team.clocks import on_camera_clock
from ..team.mixed import first_layout, regained
from ..team.relation import SURE_THETA
from ..team.relative_frame import CLOCK_TOGETHER, PLACING_LEVER, UNMOVED, Body, Labels
from ..team.team_map import TeamMap
from .map_mixed import MixedMapConfig, maps_landmarks, without_contradicted
from .team import team_maps

TOGETHER = CLOCK_TOGETHER * PLACING_LEVER  # times the sd that independent sightings would give a tie

Anchors = Mapping[str, Float[np.ndarray, "3"]]


def join_apart(apart: Apart, landmarks: Sequence[LandmarkLog], cfg: MixedMapConfig, seed: int = 0) -> Joined:
    """What sightings tie of a mixed team.

    landmarks: what robots without a laser told so far. Laser robots are each by itself, whatever walls say of them, as
    sightings overrule walls.
    """
    read = [without_contradicted(on_camera_clock(log), cfg) for log in with_copies_marked(list(landmarks))]
    mapped, frames, labels = _landmark_maps(read, cfg, seed)
    lasers = [Body({robot: way}, {}, own_clock=True) for robot, way in apart.ways.items()]
    layout = first_layout(read, lasers, mapped, labels, cfg.smoothing, cfg.placing)
    anchors = {**frames, **{robot: way.pose[0] for robot, way in apart.ways.items()}}
    tied: dict[str, Tied] = {}
    sighted: dict[str, SightedAt] = {}
    for body in layout.bodies:
        first = _first(body, anchors, apart)
        if first is not None:
            tied |= _ties(body, first, anchors, apart)
            sighted |= _placed(body, first, anchors, apart, cfg.placing.sure_xy)
    words = [
        f"{_called(tie.a, apart)} and {_called(tie.b, apart)}: tied by {tie.agree} of {tie.of} sightings"
        for tie in layout.ties
    ]
    return Joined(tied, sighted, words, cfg.placing.sure_xy)


def _landmark_maps(
    read: Sequence[LandmarkLog], cfg: MixedMapConfig, seed: int
) -> tuple[Sequence[TeamMap], Anchors, Labels]:
    """Robots' landmark maps fused, the frames of robots in these, and what landmarks are called there."""
    local = [local_map(log, cfg.ekf, seed) for log in read if maps_landmarks(log)]
    if not local:
        return (), {}, {}
    fusion = fuse(local, cfg.fuse)
    whole = team_maps(local, fusion)
    mapped = [team for team in whole if len(team.landmarks)]
    fitted, _ = regained(mapped, read, fusion.labels, cfg.smoothing, cfg.placing)
    frames = {
        robot: component.frames[robot]
        for component, team in zip(fusion.components, whole, strict=False)  # robots that mapped nothing come after
        for robot in component.robots
        if any(fit.tracks.get(robot) is team.tracks[robot] for fit in fitted)  # else its sightings place it anew
    }
    return fitted, frames, fusion.labels


def _first(body: Body, anchors: Anchors, apart: Apart) -> str | None:
    """The robot beside which the others are told: the first laser robot, if there is one."""
    held = [robot for robot in body.robots if robot in anchors]
    return min(held, key=lambda robot: (robot not in apart.ways, in_order(robot)), default=None)


def _ties(body: Body, first: str, anchors: Anchors, apart: Apart) -> dict[str, Tied]:
    """By the team's names, robots with a map of their own beside `first`; the errors of two ties are independent.

    Of one tie they are not: sightings err together for seconds, and most where frames begin, far from where robots met.
    """
    base, spread = body.moves.get(first, UNMOVED)
    J = se2.inverse_jacobian(base)
    back, back_cov = se2.inverse(base), J @ spread @ J.T
    out = {}
    for robot in body.robots:
        if robot not in anchors or robot == first:
            continue
        T, cov = body.moves.get(robot, UNMOVED)
        at = se2.between(se2.compose(base, anchors[first]), se2.compose(T, anchors[robot]))
        whole = se2.composed_covariance(back, back_cov, T, cov)
        out[apart.called[robot]] = Tied(apart.called[first], np.asarray(at), TOGETHER**2 * whole)
    return out


def _placed(body: Body, first: str, anchors: Anchors, apart: Apart, sure_xy: float) -> dict[str, SightedAt]:
    """By the team's names, robots without a map beside `first`, where they told last that they were.

    Their covariance is the largest that sightings may have that place a robot.
    """
    base, _ = body.moves.get(first, UNMOVED)
    root = se2.compose(base, anchors[first])
    cov = np.diag([sure_xy**2, sure_xy**2, SURE_THETA**2])
    out = {}
    for robot in body.robots:
        if robot not in anchors:
            track = body.tracks[robot]
            t, told = apart.told.get(robot, (float(track.t[-1]), np.zeros(3)))
            pose = se2.interpolate(np.array([t]), track.t, track.pose)[0]
            out[apart.called[robot]] = SightedAt(apart.called[first], np.asarray(se2.between(root, pose)), cov, told)
    return out


def _called(robots: Sequence[str], apart: Apart) -> str:
    return ", ".join(apart.called[robot] for robot in sorted(robots, key=in_order))
