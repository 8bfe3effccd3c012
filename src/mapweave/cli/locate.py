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
    """Find where every robot of a swarm is, from the bearings at which they see each other.

    Parameters
    ----------
    sightings
        A table, CSV or Parquet: observer,target,bearing in radians; in space observer,target,azimuth,elevation or
        observer,target,bx,by,bz; optional sigma and t (stamps of moving robots give positions over time). Or an
        MRCLAM data set, of which the bearings between robots and the odometry are used.
    out
        The folder that positions.csv, metrics.json, report.html and figures are written to.
    anchor
        The known position of a robot, as a=0,0 or a=0,0,0; repeat it for more. With fewer than two only the shape is
        found.
    dim
        2: in the plane; 3: in space; by default as the table's columns say.
    sigma
        Standard deviation of a bearing with its unit, as 0.5deg or 0.0087rad; overrides the table's own
        column. Without either, 1 degree.
    distance
        A known distance as i,j=10 in metres, instead of a second anchor.
    method
        batch (default), robust (some sightings are wrong), distributed (robots talk to those they see), or one of the
        filters ekf, iekf and fej.
    axis
        Whether bearings are measured from a common axis; if not, every robot's heading is estimated too. By default
        mutual sightings decide.
    odometry
        Velocities of moving robots, t,robot,v,w.
    initial
        Initial estimates id,x,y for the filters.
    truth
        Score the result against id,x,y; no estimator sees it.
    covariance
        Covariances of all positions; by default up to 20,000 robots.
    acceleration
        How fast robots without odometry change speed: density of white acceleration noise, in m^2/s^3.
    until
        Use the first so many seconds of stamped sightings only.
    config
        A TOML file with settings; options on the command line win.
    filtered
        For moving robots: estimates from the sightings up to each instant, instead of from all sightings.
    seed
        Kept in metrics.json; the result does not depend on it.
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
