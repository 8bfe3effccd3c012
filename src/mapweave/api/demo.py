"""`demo`: a small simulated team, mapped, fused while it drives, and scored; everything from one seed."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from ..core.paths import checked_arguments
from ..core.workers import Progress, no_progress
from ..io.directory import check_target, result_directory
from ..io.mrclam import write_mrclam
from ..sim.landmarks import TeamWorld, simulate_team
from .map_landmarks import map_logs
from .map_options import MapOptions
from .team import TeamResult

WORLD = TeamWorld(robots=4, landmarks=24, minutes=5.0)
SHARE = {"2": 0.7, "4": 0.5}  # maps are unequal in practice
FUSE_EVERY = 15.0  # [s]


@checked_arguments
def demo(
    out: Path | str = "mapweave-demo", *, seed: int = 2012, force: bool = False, on_progress: Progress = no_progress
) -> TeamResult:
    """Simulate a small team, map what each robot saw, fuse the maps and score the result.

    The same seed gives the same result.

    Parameters
    ----------
    out
        The folder to write, with the simulated recording in `out/recording`.
    seed
        Of everything drawn at random (2012).

    Raises
    ------
    UsageError
        For an `out` that holds something other than a result.
    """
    target = Path(out)
    check_target(target, force=force)
    with TemporaryDirectory() as held:
        recording = Path(held) / "recording"
        on_progress("simulating", 0, 1)
        team = simulate_team(WORLD, seed)
        write_mrclam(recording, team)
        on_progress("simulating", 1, 1)
        options = MapOptions(share=SHARE, truth=(recording,), seed=seed, fuse_every=FUSE_EVERY, on_progress=on_progress)
        mapped = map_logs([recording], options)
    local = tuple(replace(m, source="recording") for m in mapped.local)  # where the log is in the result
    result = replace(mapped, title="Four robots, one map", local=local)
    with result_directory(target, force=force) as work:
        result.write_into(work)
        write_mrclam(work / "recording", team)
        result.finish(work)
    return result
