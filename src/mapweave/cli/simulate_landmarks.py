"""`mapweave simulate landmarks`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def landmarks(
    *,
    out: Path,
    robots: int = 3,
    landmarks: Annotated[int, Parameter(name="--landmarks")] = 15,
    minutes: float = 5.0,
    noise: float = 1.0,
    bias: float = 1.0,
    outliers: float = 0.01,
    misreads: float = 0.001,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate a team of robots with cameras among landmarks, as files in the layout of the MRCLAM data sets.

    Parameters
    ----------
    out
        The folder to write: odometry, sightings and true poses of every robot, surveyed landmarks, barcodes.
    robots
        How many robots.
    landmarks
        How many landmarks; the floor grows with them, 8 square metres each.
    minutes
        How long they drive.
    noise
        Random errors of odometry and camera, relative to a real team's.
    bias
        Systematic errors (turn and speed scale, command lag, range scale, bearing bias), relative to a real team's.
    outliers
        The probability that a range is wrong by about a metre.
    misreads
        The probability that a sighting carries a barcode nobody listed.
    seed
        The same seed gives the same bytes.
    force
        Write into the folder even when something else stands there.
    """
    from ..api.simulate_landmarks import simulate_landmarks
    from .terminal import say

    recording = simulate_landmarks(
        out,
        robots=robots,
        landmarks=landmarks,
        minutes=minutes,
        noise=noise,
        bias=bias,
        outliers=outliers,
        misreads=misreads,
        seed=seed,
        force=force,
    )
    say(f"{out}: {recording.summary()}")
