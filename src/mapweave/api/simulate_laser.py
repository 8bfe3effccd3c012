"""Simulated drives with a laser scanner that tells intensity, as MCAP files with their truth beside."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import se2
from ..core.errors import UsageError, expect_at_most
from ..core.paths import path_arguments, path_of
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.mcap import write_mcap
from ..io.tum import write_tum
from ..report.result import ResultBase
from ..sim.laser import LaserSimulation, stream
from ..sim.laser_worlds import (
    CorridorConfig,
    OfficeConfig,
    TunnelConfig,
    simulate_corridor,
    simulate_office,
    simulate_tunnel,
)
from ..sim.satellites import placed, simulated_fixes

if TYPE_CHECKING:
    from ..report.style import Target

MOST_BEAMS, MOST_PEOPLE, MOST_ROOMS, MOST_SCANS = 20_000, 1000, 500, 200_000  # a log of gigabytes
FARTHEST = 100_000.0  # [m]

World = CorridorConfig | OfficeConfig | TunnelConfig


@dataclass(frozen=True, slots=True, repr=False)
class SimulatedDrive(ResultBase, LaserSimulation):
    """A simulated drive with a laser scanner, its world and seed. It is written to a file, not to a folder."""

    config: World
    seed: int

    @property
    def metrics(self) -> dict[str, Any]:
        way = (len(self.log.scans) - 1) * self.config.drive.scan_every
        return {
            "version": __version__,
            "seed": self.seed,
            "kind": type(self.config).__name__.removesuffix("Config").lower(),
            "scans": len(self.log.scans),
            "stamps": len(self.log.stamps()),
            "driven_m": way,
            "world": asdict(self.config),
        }

    def lines(self) -> list[str]:
        m = self.metrics
        return [f"{m['scans']} scans over {m['driven_m']:.0f} m, {m['stamps']} stamps, seed {self.seed}"]

    def draw(self, target: "Target") -> None:
        """The walls and the true trajectory."""
        from ..report.simulation import draw_world  # noqa: PLC0415  (figures cost half a second)

        walls = self.world.segments.reshape(-1, 4)
        draw_world(target, "the simulated drive", {"true way": self.truth.pose[:, :2]}, walls=walls)

    def write(self, folder: Path | str, *, force: bool = False) -> None:
        """The MCAP file `folder`, and the true poses in FILE.truth.tum beside it; files there are replaced."""
        del force
        path = _mcap(folder)
        write_mcap(path, self.log, self.truth, range_min=self.config.drive.scanner.near)
        write_tum(path.with_suffix(".truth.tum"), self.truth)

    def write_into(self, folder: Path) -> None:
        self.write(folder / "drive.mcap")


@path_arguments
@one_blas_thread()
def simulate_laser(
    out: Path | str | None = None, world: World | None = None, *, fixes: float | None = None, seed: int = 0
) -> SimulatedDrive:
    """Simulate a drive with a laser scanner that measures received light intensity.

    Written to `out` if given; the same seed gives the same drive.

    Parameters
    ----------
    out
        The MCAP file to write; the true poses stand beside it in FILE.truth.tum.
    world
        A `CorridorConfig` (a ring of corridor), an `OfficeConfig` or a `TunnelConfig` (the ring).
    fixes
        Also carry a satellite receiver with so much noise [m] on either axis; drives of other seeds lie elsewhere, and
        the truth is east and north of one datum (no receiver).
    seed
        Of everything drawn at random (0).

    Raises
    ------
    UsageError
        For an `out` that is no `.mcap` file, or a world that cannot be.
    """
    world = world or CorridorConfig()
    _check(world)
    if fixes is not None and not 0 < fixes <= FARTHEST:
        raise UsageError(f"--fixes: expected a noise of more than 0 m, found {fixes:g}")
    if out is not None:
        _mcap(out)
    if isinstance(world, CorridorConfig):
        simulated = simulate_corridor(world, seed)
    elif isinstance(world, OfficeConfig):
        simulated = simulate_office(world, seed)
    else:
        simulated = simulate_tunnel(world, seed)
    if fixes is not None:
        simulated = _with_fixes(simulated, fixes, seed)
    result = SimulatedDrive(
        simulated.log, simulated.truth, simulated.reflectance, simulated.world, simulated.heading_bias, world, seed
    )
    if out is not None:
        result.write(out)
    return result


def _with_fixes(drive: LaserSimulation, sd: float, seed: int) -> LaserSimulation:
    """The drive with a receiver's fixes, its truth in the world they are told in."""
    rng = stream(seed, "fixes")
    truth = replace(drive.truth, pose=np.asarray(se2.compose(placed(rng), drive.truth.pose)))
    return replace(drive, log=replace(drive.log, fixes=simulated_fixes(truth, sd, rng)), truth=truth)


def _mcap(out: Path | str) -> Path:
    path = path_of(out, "out")
    if path.suffix != ".mcap" or path.is_dir():
        raise UsageError(f"--out {path}: expected a file name such as corridor.mcap")
    return path


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
        straight = (world.corner, world.long_leg - world.corner)
        if room > 0 and not straight[0] < world.start < straight[1]:
            between = f"between {straight[0]:g} and {straight[1]:g} m along a leg of {world.long_leg:g} m"
            raise UsageError(f"--start: expected {between}, found {world.start:g}")
    elif isinstance(world, OfficeConfig):
        positive |= {"--rooms": world.rooms, "--visited": world.visited}
    else:
        positive |= {"--length": world.length - 10, "--width": world.width}
    for option, value in positive.items():
        if not value > 0:
            raise UsageError(f"{option}: too small for this world")
    expect_at_most({"--beams": (drive.scanner.beams, MOST_BEAMS), "--people": (drive.people, MOST_PEOPLE)})
    if isinstance(world, OfficeConfig):
        expect_at_most({"--rooms": (world.rooms, MOST_ROOMS)})
        way = 2 * world.rooms * world.room_width + 4 * world.visited * (world.room_width + world.room_depth)
    elif isinstance(world, CorridorConfig):
        expect_at_most({"--long-leg": (world.long_leg, FARTHEST), "--short-leg": (world.short_leg, FARTHEST)})
        way = world.distance
    else:
        way = 2 * world.length
    expect_at_most({"metres driven": (way, FARTHEST), "scans": (way / drive.scan_every, MOST_SCANS)})
    if drive.people < 0:
        raise UsageError(f"--people must be 0 or more, found {drive.people}")
