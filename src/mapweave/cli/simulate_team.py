"""`mapweave simulate team`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def team(
    *,
    out: Path,
    lasers: int = 2,
    cameras: int = 2,
    bearing_cameras: int = 0,
    bearings: int = 1,
    rooms: int = 1,
    landmarks: int = 15,
    minutes: float = 5.0,
    noise: float = 1.0,
    bias: float = 1.0,
    outliers: float = 0.0,
    calibration: Literal["real", "random"] = "real",
    clock: float = 0.0,
    everything: Annotated[bool, Parameter(negative="")] = False,
    ranges: Annotated[bool, Parameter(negative="")] = False,
    beacons: int = 0,
    nlos: float = 0.0,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate a team in which every robot carries something else, with its truth.

    Parameters
    ----------
    out
        The folder to write: robotK.mcap of every laser robot, odometry.csv and sightings.csv of the others, truth/.
    lasers
        How many robots with a laser scanner and wheels, and no camera.
    cameras
        How many robots with wheels and a camera that measures range and bearing of landmarks and of other robots.
    bearing_cameras
        How many robots with wheels and a camera that measures bearings alone.
    bearings
        How many robots with nothing but bearings to the others: no wheels, no landmarks.
    rooms
        How many rooms in a row; the walls between them stop lasers and robots, cameras look over them.
    landmarks
        How many landmarks; the rooms grow with them.
    minutes
        How long they drive.
    noise
        Random errors of wheels and cameras, relative to a real team's.
    bias
        Systematic errors of a `real` calibration, relative to a real team's.
    outliers
        The share of sightings that carry a wrong label or are wrong by metres.
    calibration
        `real`: systematic errors as a real team's; `random`: wheels and cameras drawn from a much wider range.
    clock
        Standard deviation of the clocks of the laser logs, in seconds.
    everything
        Every robot carries a laser, wheels and a range camera, on the same ways: what a mixed team is compared with.
    ranges
        Every robot carries wheels and a ranging radio and nothing else: ranges.mcap in place of the other logs.
    beacons
        How many radios stand somewhere, with --ranges.
    nlos
        The share of ranges that go round something and are too long, with --ranges.
    seed
        The same seed gives the same bytes.
    force
        Write into the folder even when something else stands there.
    """
    from ..api.simulate_team import simulate_team
    from .terminal import say

    recording = simulate_team(
        out,
        lasers=lasers,
        cameras=cameras,
        bearing_cameras=bearing_cameras,
        bearings=bearings,
        rooms=rooms,
        landmarks=landmarks,
        minutes=minutes,
        noise=noise,
        bias=bias,
        outliers=outliers,
        calibration=calibration,
        clock=clock,
        everything=everything,
        ranges=ranges,
        beacons=beacons,
        nlos=nlos,
        seed=seed,
        force=force,
    )
    say(f"{out}: {recording.summary()}")
