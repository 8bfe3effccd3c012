"""Simulated recordings of a team of robots among landmarks, as MRCLAM files."""

from dataclasses import asdict
from pathlib import Path

from ..core.recording import TeamRecording
from ..core.threads import one_blas_thread
from ..core.version import __version__
from ..io.directory import result_directory, write_json
from ..io.mrclam import write_mrclam
from ..sim.landmarks import TeamWorld, simulate_team


@one_blas_thread()
def simulate_landmarks(
    out: Path | str | None = None,
    *,
    robots: int = 3,
    landmarks: int = 15,
    minutes: float = 5.0,
    noise: float = 1.0,
    bias: float = 1.0,
    outliers: float = 0.01,
    misreads: float = 0.001,
    seed: int = 0,
    force: bool = False,
) -> TeamRecording:
    """The recording (the same for the same seed), written to the folder `out` when one is given.

    noise, bias: relative to a real team's; outliers, misreads: probabilities. Raises UsageError for a world that
    cannot be, or an `out` that holds something other than an earlier recording.
    """
    world = TeamWorld(
        robots=robots,
        landmarks=landmarks,
        minutes=minutes,
        noise=noise,
        bias=bias,
        outliers=outliers,
        misreads=misreads,
    )
    world.check()
    if out is None:
        return simulate_team(world, seed)
    with result_directory(Path(out), force=force) as work:
        team = simulate_team(world, seed)
        write_mrclam(work, team)
        write_json(work / "simulation.json", {"version": __version__, "seed": seed, "world": asdict(world)})
    return team
