"""`mapweave simulate corridor`, `office` and `tunnel`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from ..api.simulate_laser import World
    from ..sim.laser import DriveConfig


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """How the world is driven and seen.

    Parameters
    ----------
    scan_every
        Metres between scans.
    speed
        Metres a second.
    people
        How many people walk about.
    beams
        Beams of the scanner, over 240 degrees.
    range_
        Metres the scanner reaches.
    sensor_pose
        Where the scanner stands on the robot, as x,y,theta in metres and radians.
    law
        How light falls off: spec (as the scanner's maker measured), second (another one, with a specular part),
        lds01 or neato (as in logs of these scanners).
    falloff
        Metres at which the light has halved, instead of the law's.
    exponent
        How light falls with the cosine of incidence, instead of the law's.
    specular
        Share of light that comes back from surfaces hit squarely, instead of the law's.
    end_error
        Metres the odometry is off at the end, as a pair low,high; 0,0 for no heading bias.
    """

    scan_every: float = 0.25
    speed: float = 0.5
    people: int = 0
    beams: int = 342
    range_: Annotated[float, Parameter(name="--range")] = 5.6
    sensor_pose: Annotated[str, Parameter(allow_leading_hyphen=True)] = "0,0,0"
    law: Literal["spec", "second", "lds01", "neato"] = "spec"
    falloff: float | None = None
    exponent: float | None = None
    specular: float | None = None
    end_error: str | None = None


def corridor(
    *,
    out: Path,
    long_leg: float = 60.0,
    short_leg: float = 30.0,
    width: float = 2.5,
    recess: float = 0.12,
    distance: float = 200.0,
    corner: float = 1.2,
    start: float = 15.0,
    drive: DriveOptions | None = None,
    seed: int = 0,
) -> None:
    """Simulate a drive round a ring of corridor: flush long legs, recessed doors on the short ones.

    Parameters
    ----------
    out
        The MCAP file to write; the true poses go to NAME.truth.tum beside it.
    long_leg
        Metres along the middle of a long side of the ring.
    short_leg
        Metres along the middle of a short side of the ring.
    width
        Metres from wall to wall.
    recess
        Metres doors of the short legs stand back.
    distance
        Metres driven.
    corner
        Radius of the driven corners, metres.
    start
        Where the drive begins: metres after the first corner of a long leg.
    seed
        The same seed gives the same log.
    """
    from ..sim.corridor import CorridorConfig

    config = CorridorConfig(
        long_leg=long_leg,
        short_leg=short_leg,
        width=width,
        recess=recess,
        distance=distance,
        corner=corner,
        start=start,
        drive=_drive(drive, (15.0, 20.0)),
    )
    _write(out, config, seed)


def office(
    *,
    out: Path,
    rooms: int = 4,
    room_width: float = 5.0,
    room_depth: float = 4.5,
    visited: int = 5,
    drive: DriveOptions | None = None,
    seed: int = 0,
) -> None:
    """Simulate a drive through an office floor, room by room.

    Parameters
    ----------
    out
        The MCAP file to write; the true poses go to NAME.truth.tum beside it.
    rooms
        Rooms on each side of the corridor.
    room_width
        Metres along the corridor.
    room_depth
        Metres away from it.
    visited
        How many rooms are driven into.
    seed
        The same seed gives the same log.
    """
    from ..sim.office import OfficeConfig

    config = OfficeConfig(
        rooms=rooms, room_width=room_width, room_depth=room_depth, visited=visited, drive=_drive(drive, (2.0, 4.0))
    )
    _write(out, config, seed)


def tunnel(
    *, out: Path, length: float = 80.0, width: float = 3.0, drive: DriveOptions | None = None, seed: int = 0
) -> None:
    """Simulate a drive down a long featureless tunnel with reflective marks, and back.

    Parameters
    ----------
    out
        The MCAP file to write; the true poses go to NAME.truth.tum beside it.
    length
        Metres from end to end.
    width
        Metres from wall to wall.
    seed
        The same seed gives the same log.
    """
    from ..sim.tunnel import TunnelConfig

    _write(out, TunnelConfig(length=length, width=width, drive=_drive(drive, (3.0, 6.0))), seed)


def _drive(given: DriveOptions | None, end_error: tuple[float, float]) -> "DriveConfig":
    from dataclasses import replace

    from ..sim.drift import DriftConfig
    from ..sim.laser import DriveConfig
    from ..sim.scanner import LAWS, Scanner
    from .terminal import numbers

    drive = given or DriveOptions()
    law = LAWS[drive.law]
    low, high = numbers(drive.end_error, 2, "--end-error") if drive.end_error else end_error
    x, y, theta = numbers(drive.sensor_pose, 3, "--sensor-pose")
    return DriveConfig(
        scan_every=drive.scan_every,
        odometry_every=min(0.05, drive.scan_every),
        speed=drive.speed,
        people=drive.people,
        sensor_pose=(x, y, theta),
        scanner=Scanner(beams=drive.beams, far=drive.range_),
        law=replace(
            law,
            falloff=law.falloff if drive.falloff is None else drive.falloff,
            exponent=law.exponent if drive.exponent is None else drive.exponent,
            specular=law.specular if drive.specular is None else drive.specular,
        ),
        drift=DriftConfig(end_error=(low, high) if high > 0 else None),
    )


def _write(out: Path, world: "World", seed: int) -> None:
    from ..api.simulate_laser import simulate_laser
    from .terminal import say

    recording = simulate_laser(out, world, seed=seed)
    say(f"{out}: {recording.summary()}")
    say(f"truth: {out.with_suffix('.truth.tum')}")
