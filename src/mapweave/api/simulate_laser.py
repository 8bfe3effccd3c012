"""Simulated drives with a laser scanner that tells intensity, as MCAP files with their truth beside."""

from pathlib import Path

from ..core.errors import UsageError
from ..core.threads import one_blas_thread
from ..io.mcap import write_mcap
from ..io.tum import write_tum
from ..sim.corridor import CorridorConfig, simulate_corridor
from ..sim.laser import LaserSimulation
from ..sim.office import OfficeConfig, simulate_office
from ..sim.tunnel import TunnelConfig, simulate_tunnel

World = CorridorConfig | OfficeConfig | TunnelConfig


@one_blas_thread()
def simulate_laser(out: Path | str | None = None, world: World | None = None, *, seed: int = 0) -> LaserSimulation:
    """The drive (the same for the same seed) through `world`, the ring corridor unless another is given.

    Written to the MCAP file `out` when one is given, with the true poses in FILE.truth.tum beside it. Raises
    UsageError for an `out` that is no `.mcap` file and for a world that cannot be.
    """
    world = world or CorridorConfig()
    _check(world)
    path = None if out is None else Path(out)
    if path is not None and (path.suffix != ".mcap" or path.is_dir()):
        raise UsageError(f"--out {path}: expected a file name such as corridor.mcap")
    if isinstance(world, CorridorConfig):
        made = simulate_corridor(world, seed)
    elif isinstance(world, OfficeConfig):
        made = simulate_office(world, seed)
    else:
        made = simulate_tunnel(world, seed)
    if path is not None:
        write_mcap(path, made.log, made.truth, range_min=world.drive.scanner.near)
        write_tum(path.with_suffix(".truth.tum"), made.truth)
    return made


def _check(world: World) -> None:
    drive = world.drive
    positive: dict[str, float] = {
        "--scan-every": drive.scan_every,
        "--speed": drive.speed,
        "--range": drive.scanner.far,
        "--beams": drive.scanner.beams - 1,
    }
    if isinstance(world, CorridorConfig):
        room = 0.5 * min(world.long_leg, world.short_leg) - world.corner
        positive |= {"--distance": world.distance, "--width": world.width, "--corner": world.corner, "--long-leg": room}
        positive |= {"--start": min(world.start - world.corner, world.long_leg - world.corner - world.start)}
    elif isinstance(world, OfficeConfig):
        positive |= {"--rooms": world.rooms, "--visited": world.visited}
    else:
        positive |= {"--length": world.length - 10, "--width": world.width}
    for option, value in positive.items():
        if not value > 0:
            raise UsageError(f"{option}: too small for this world")
    if drive.people < 0:
        raise UsageError(f"--people must be 0 or more, found {drive.people}")
