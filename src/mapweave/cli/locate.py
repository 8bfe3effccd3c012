"""`mapweave locate`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def locate(
    sightings: Path,
    /,
    *,
    out: Path,
    anchor: Annotated[list[str] | None, Parameter(negative="")] = None,
    dim: int | None = None,
    sigma: str | None = None,
    distance: Annotated[list[str] | None, Parameter(negative="")] = None,
    method: str | None = None,
    axis: bool | None = None,
    odometry: Path | None = None,
    initial: Path | None = None,
    truth: Path | None = None,
    covariance: bool | None = None,
    acceleration: float | None = None,
    until: float | None = None,
    config: Path | None = None,
    filtered: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Find where every robot of a swarm is, from who sees whom in which direction.

    Parameters
    ----------
    sightings
        A table, CSV or Parquet: observer,target,bearing in radians; in space observer,target,azimuth,elevation or
        observer,target,bx,by,bz; optional sigma and t. With stamps of moving robots positions over time are found. Or
        an MRCLAM data set, of which bearings between robots and odometry are used.
    out
        The folder that positions.csv, metrics.json, report.html and figures are written to.
    anchor
        A known robot as a=0,0 or a=0,0,0; give it again for the next. Without two the answer is the shape alone.
    dim
        2 or 3; the table's columns say it already.
    sigma
        Standard deviation of a bearing with its unit, as 0.5deg or 0.0087rad; wins over the table's own. Where neither
        says it, 1 degree.
    distance
        A known distance as i,j=10 in metres, in place of a second anchor.
    method
        batch, robust, distributed, ekf, iekf or fej (batch).
    axis
        Whether bearings are against a common axis; without it every robot's heading is found too. Found out from
        mutual sightings when neither is given.
    odometry
        Velocities of moving robots, t,robot,v,w.
    initial
        First estimates id,x,y for the filters to start from.
    truth
        Score the result against id,x,y; no estimator sees it.
    covariance
        Covariances of all positions; left out beyond 20,000 robots unless asked for.
    acceleration
        How briskly robots without odometry move: density of white acceleration noise, in square metres a second cubed.
    until
        Use the first so many seconds of stamped sightings only.
    config
        A TOML file with settings; options on the command line win.
    filtered
        Of moving robots: what was known at each instant from the sightings until then, in place of what all say of it.
    seed
        The same seed gives the same result, to the byte.
    force
        Write into the folder even when something other than a result stands there.
    """
    from ..api.locate import locate as run
    from ..api.locate_options import parse_anchors, parse_distances
    from ..core.errors import UsageError
    from ..swarm.moving.result import TrackConfig
    from .terminal import progress, say

    if dim not in {None, 2, 3}:
        raise UsageError(f"--dim {dim}: expected 2 or 3")
    with progress() as on_progress:
        result = run(
            sightings,
            out,
            anchors=parse_anchors(anchor),
            dim=dim,
            sigma=sigma,
            distances=parse_distances(distance),
            method=method,
            axis=axis,
            odometry=odometry,
            initial=initial,
            truth=truth,
            covariance=covariance,
            motion=None if acceleration is None else TrackConfig(acceleration=acceleration),
            until=until,
            config=config,
            filtered=filtered,
            seed=seed,
            force=force,
            on_progress=on_progress,
        )
    say(result.summary())
    say(f"report: {out / 'report.html'}")
