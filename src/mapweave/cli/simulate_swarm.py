"""`mapweave simulate swarm`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

Flag = Annotated[bool, Parameter(negative="")]


def swarm(
    *,
    out: Path,
    robots: int = 100,
    dim: int = 2,
    layout: Literal["grid", "random", "clusters"] = "grid",
    k: int = 8,
    range_: Annotated[float | None, Parameter(name="--range")] = None,
    sigma: str = "1deg",
    missing: float = 0.0,
    outliers: float = 0.0,
    mutual: Flag = False,
    single: Flag = False,
    axis: bool = True,
    blockers: int = 0,
    steps: int = 1,
    interval: float = 1.0,
    drive: Flag = False,
    seed: int = 0,
) -> None:
    """Simulate a swarm of camera robots that see each other: sightings, and the truth beside them.

    Parameters
    ----------
    out
        The table of sightings to write, CSV or Parquet by its suffix; the truth goes to NAME.truth.csv beside it.
    robots
        How many robots, about one in every cell of 10 m.
    dim
        2: in the plane; 3: in space.
    layout
        grid: cells of 10 m, jittered by 3 m either way; random; clusters.
    k
        Every robot sees its k nearest.
    range_
        Every robot sees all within this many metres, instead.
    sigma
        Standard deviation of a bearing, with its unit: 0.5deg or 0.0087rad.
    missing
        Share of the sightings that are lost.
    outliers
        Share of the sightings that point anywhere.
    mutual
        Whoever is seen sees back.
    single
        Of two robots only one sees the other.
    axis
        Whether there is a common axis; without it every robot has a heading of its own.
    blockers
        Objects that move about and block the view.
    steps
        More than one: robots move, and every sighting bears its time. The robots at the corners stand still.
    interval
        Seconds between steps.
    drive
        Robots drive as wheeled ones do, and their odometry is written to NAME.odometry.csv.
    seed
        The same seed gives the same bytes.
    """
    from ..api.simulate_swarm import simulate_swarm
    from ..core.bearings import parse_angle
    from ..core.errors import UsageError
    from ..sim.swarm import SwarmScene
    from .terminal import say

    if mutual and single:
        raise UsageError("--mutual and --single exclude each other")
    if dim not in {2, 3}:
        raise UsageError(f"--dim {dim}: expected 2 or 3")
    scene = SwarmScene(
        robots=robots,
        dim=2 if dim == 2 else 3,
        layout=layout,
        k=k,
        range=range_,
        sigma=parse_angle(sigma),
        missing=missing,
        outliers=outliers,
        visibility="mutual" if mutual else "single" if single else "directed",
        axis=axis,
        blockers=blockers,
        steps=steps,
        interval=interval,
        drive=drive,
    )
    simulated = simulate_swarm(out, scene, seed=seed)
    say(f"{out}: {robots} robots in {dim}D, {len(simulated.table.observer)} sightings, sigma {sigma}, seed {seed}")
    places = simulated.position[0].tolist()
    anchors = [
        f"--anchor {simulated.table.ids[c]}=" + ",".join(f"{v:.9f}" for v in places[c]) for c in simulated.corners
    ]
    say("robots at the corners, as anchors: " + " ".join(anchors))
