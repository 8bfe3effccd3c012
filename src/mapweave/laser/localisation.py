"""Where a robot was in a map that was finished before."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..core.records import Track
from .laser_map import ScanRecords


@dataclass(frozen=True, slots=True)
class Localisation:
    """One log tracked in a finished map.

    track: poses in `map` at every odometry and every scan stamp (before the start was found: carried back by
    odometry); scans: as for mapping, innovation against odometry. start: "given" or "global"; found_t: stamp [s] at
    which the hypotheses had become one, None where they never did (a given start: the first stamp); found_scans:
    scans used until then; matched: share of the returns after that which the map explains; trusted: whether that
    share, and the hypotheses being one, speak for the answer; feature: the one really used.
    """

    robot: str
    source: str
    track: Track
    scans: ScanRecords
    start: str
    found_t: float | None
    found_scans: int | None
    matched: float
    trusted: bool
    feature: str
    particles: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)
