"""The map of one component: landmarks and the trajectories of the robots tied into it, all in one frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap


@dataclass(frozen=True, slots=True)
class TeamMap:
    """What `map` and `fuse` write and `evaluate` reads. `members[id]`: who saw it; `sightings[id]`: how often;
    `first_seen[id]`: when first [s], on the tracks' clock, as far as known.

    left_out[robot]: spans (begin, end) [s] between two poses of its track in which nothing says where it was.
    """

    robots: tuple[str, ...]
    landmarks: LandmarkMap
    tracks: Mapping[str, Track] = field(default_factory=dict)
    members: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sightings: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    first_seen: Mapping[str, float] = field(default_factory=dict)
