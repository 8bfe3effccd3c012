"""`mapweave localize`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

Flag = Annotated[bool, Parameter(negative="")]


def localize(
    log: Path,
    /,
    *,
    map_: Annotated[Path, Parameter(name="--map")],
    out: Path,
    start: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    truth: Path | None = None,
    config: Path | None = None,
    particles: int | None = None,
    feature: Literal["normalised", "raw", "none"] | None = None,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    sensor_pose: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    mirrored: Flag = False,
    height: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    columns: str | None = None,
    beams: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    seed: int = 0,
    force: Flag = False,
) -> None:
    """Follow a robot in a laser map that was finished before.

    Parameters
    ----------
    log
        A laser log, as for map.
    map_
        A result of map from laser logs.
    out
        The folder the trajectory, metrics.json and report.html are written to.
    start
        The robot's first pose in the map, as x,y,theta in metres and radians; by default it is searched everywhere.
    truth
        A TUM trajectory in the map's frame, to say whether the start was right; the estimator never sees it.
    config
        A TOML file with settings, as for map.
    particles
        How many hypotheses follow the robot once its place is found.
    feature
        none: use geometry alone, even if the map holds intensity.
    scan_topic
        The LaserScan topic of a ROS recording, where there are several.
    odom_topic
        The odometry or tf topic of a ROS recording, where there are several.
    sensor_pose
        The pose of the scanner on the robot, as x,y,theta, if the log does not have it.
    mirrored
        The beams of the log run clockwise.
    height
        What of point clouds is a scan, from LOW,HIGH in metres above the floor, as for map.
    columns
        How a text log that is a table is read, as for map.
    beams
        The angle of its first beam and from beam to beam, as for map.
    seed
        The same seed gives the same result.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..api.localize import localize as run
    from ..api.map_options import LaserOptions
    from .terminal import degrees, numbers, pair, progress, say

    place = None
    if sensor_pose is not None:
        x, y, theta = numbers(sensor_pose, 3, "--sensor-pose")
        place = (x, y, theta)
    asked = LaserOptions(
        particles=particles,
        feature=feature,
        scan_topic=scan_topic,
        odom_topic=odom_topic,
        sensor_pose=place,
        mirrored=mirrored,
        height=pair(height, "--height"),
        columns=columns,
        beams=None if beams is None else degrees(beams, "--beams"),
    )
    first = None if start is None else numbers(start, 3, "--start")
    with progress() as on_progress:
        result = run(
            log,
            map_,
            out,
            start=first,
            truth=truth,
            config=config,
            laser=asked,
            seed=seed,
            force=force,
            on_progress=on_progress,
        )
    say(result.summary())
    say(f"report: {out / 'report.html'}")
