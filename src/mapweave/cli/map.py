"""`mapweave map`: one command for every kind of log."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from ..api.map_options import LaserOptions


@Parameter(name="*", group="Laser logs")
@dataclass(frozen=True, kw_only=True)
class Laser:
    """Options of laser logs.

    Parameters
    ----------
    particles
        How many hypotheses --method particle carries (100); also of graph where intensity distinguishes places.
    feature
        What is used of the intensity of returns: normalised, raw or none (normalised where there is intensity).
    likelihood
        How a scan weights a hypothesis: matched, or paper (as printed by Hara et al.).
    resample
        Resample when the effective number of hypotheses falls below this share (0.5); 1 is always.
    scan_topic
        The LaserScan or PointCloud2 topic of a ROS recording, when there are several.
    odom_topic
        The odometry or tf topic of a ROS recording, when there are several.
    sensor_pose
        The pose of the scanner on the robot, as x,y,theta in metres and radians, if the log does not have it.
    mirrored
        The beams of the log run clockwise.
    height
        What of point clouds is a scan: from LOW to HIGH, as LOW,HIGH in metres above the floor (0.2 above the floor to
        0.5 above the scanner).
    columns
        How text logs that are tables are read, a scan a row: t,x,y,theta,ranges in seconds, metres and radians. Also
        ranges:N, intensities:N, and - or -:N for columns that are not used. With --beams.
    beams
        The angle of the first beam and from beam to beam, as FIRST,STEP in degrees counter-clockwise from ahead.
    loops
        Close loops (--method graph); --no-loops leaves them open.
    merge
        Make one map of all robots that can be merged (--method graph); --no-merge keeps one map per robot.
    resume
        A finished result of --method graph to add the logs to, as new robots or as longer logs of its robots.
    """

    particles: int | None = None
    feature: Literal["normalised", "raw", "none"] | None = None
    likelihood: Literal["matched", "paper"] | None = None
    resample: float | None = None
    scan_topic: str | None = None
    odom_topic: str | None = None
    sensor_pose: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    mirrored: Annotated[bool, Parameter(negative="")] = False
    height: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    columns: str | None = None
    beams: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    loops: bool = True
    merge: bool = True
    resume: Path | None = None


def map_logs(
    *logs: Path,
    out: Path,
    robots: str | None = None,
    method: str | None = None,
    weights: str | None = None,
    share: str | None = None,
    start: Annotated[list[str] | None, Parameter(negative="")] = None,
    truth: Annotated[list[Path] | None, Parameter(negative="", consume_multiple=True)] = None,
    config: Path | None = None,
    seed: int = 0,
    jobs: int = 1,
    cluster: str | None = None,
    fuse_every: float | None = None,
    refine: bool = True,
    online: Annotated[bool, Parameter(negative="")] = False,
    calibration: Path | None = None,
    survey: Path | None = None,
    decisions: Path | None = None,
    radios: str | None = None,
    laser: Laser | None = None,
    mcap: Annotated[bool, Parameter(negative="")] = False,
    strict: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Make one map of the logs of a team: a local map for each robot, then all of them merged.

    Parameters
    ----------
    logs
        An MRCLAM data set (folder or zip), a folder with odometry.csv and sightings.csv, laser logs, or a recording of
        ranging radios and odometry.
    out
        The folder the map, the trajectories, metrics.json and report.html are written to.
    robots
        Use these robots only, as 1,2.
    method
        How each robot is mapped; landmark logs: ekf; laser logs: graph (the only one that closes loops and merges
        robots), particle, gated or icp.
    weights
        How much each robot's map counts: constant, paper, diagonal, full, full-scaled or naive (full-scaled).
    share
        Use the first share of a robot's time span only, as 1:1.0,2:0.5.
    start
        Where a robot starts in the map if that is known, as robot2=x,y,theta in metres and radians; for laser logs and
        mixed teams also robot2=x,y,theta,sigma with its standard deviation in metres.
    truth
        Score the result against this when it is done; no estimator ever sees it.
    config
        A TOML file with settings; options on the command line win.
    seed
        The same seed gives the same result, to the byte.
    jobs
        How many robots are mapped at once; the result is the same.
    cluster
        The address of a Dask scheduler (tcp://host:8786) whose workers map the robots, instead of --jobs.
    fuse_every
        Also fuse every so many seconds while the logs play, and report how the map grew.
    refine
        Smooth the whole team at the end (landmark logs); --no-refine keeps the fused map of the filters.
    online
        Smooth while the logs play (landmark logs), and report the time and lag of each step.
    calibration
        Known calibration of the robots, in the form of calibration.json; a value without sd is fixed.
    survey
        Landmarks at known places, as id,x,y or id,x,y,sd in metres; their frame becomes the map's.
    decisions
        A decisions.toml of this result, edited: pairs of robots and places that are together, or apart (laser logs).
    radios
        Which robot each radio is on, as n_7=turtle01,n_3=turtle03, where names do not say it (recordings of ranges).
    mcap
        Also write result.mcap: map, paths, landmarks and walls as messages for RViz and Foxglove.
    strict
        Exit with status 1 unless the verdict is good; the result is written all the same.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..api.map_options import MapOptions, expect_there, parse_radios, parse_robots, parse_shares, parse_starts
    from .terminal import progress, say

    at_once = MapOptions(  # what cannot be is told before the imports below, which take a second
        method=method,
        weights=weights,
        share=parse_shares(share),
        truth=tuple(truth or ()),
        config=config,
        seed=seed,
        jobs=jobs,
        fuse_every=fuse_every,
        refine=refine,
        online=online,
        calibration=calibration,
        survey=survey,
        decisions=decisions,
        radios=parse_radios(radios),
        laser=_laser(laser),
    )
    at_once.check()
    starts, named = parse_starts(start), parse_robots(robots)
    expect_there(logs)

    from ..api.map import map as run
    from ..core.errors import VerdictError

    try:
        with progress() as on_progress:
            result = run(
                logs,
                out=out,
                robots=named,
                method=method,
                weights=weights,
                share=at_once.share,
                start=starts,
                truth=truth,
                config=config,
                seed=seed,
                jobs=jobs,
                cluster=cluster,
                fuse_every=fuse_every,
                refine=refine,
                online=online,
                calibration=calibration,
                survey=survey,
                decisions=decisions,
                radios=at_once.radios,
                laser=at_once.laser,
                mcap=mcap,
                strict=strict,
                force=force,
                on_progress=on_progress,
            )
    except VerdictError as error:
        say(error.result.summary())
        say(f"report: {out / 'report.html'}")
        raise
    say(result.summary())
    say(f"report: {out / 'report.html'}")


def _laser(given: Laser | None) -> "LaserOptions":
    from ..api.map_options import LaserOptions
    from .terminal import degrees, numbers, pair

    asked = given or Laser()
    place = None
    if asked.sensor_pose is not None:
        x, y, theta = numbers(asked.sensor_pose, 3, "--sensor-pose")
        place = (x, y, theta)
    return LaserOptions(
        particles=asked.particles,
        feature=asked.feature,
        likelihood=asked.likelihood,
        resample=asked.resample,
        scan_topic=asked.scan_topic,
        odom_topic=asked.odom_topic,
        sensor_pose=place,
        mirrored=asked.mirrored,
        height=pair(asked.height, "--height"),
        no_loops=not asked.loops,
        no_merge=not asked.merge,
        resume=asked.resume,
        columns=asked.columns,
        beams=None if asked.beams is None else degrees(asked.beams, "--beams"),
    )
