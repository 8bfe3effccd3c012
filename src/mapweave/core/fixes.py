"""Position fixes of a robot (satellites, motion capture), and the plane that latitudes and longitudes are laid on.

WGS 84: an ellipsoid of semi-axis `A` and flattening `F`. A point's place east, north and up of a datum (ENU) is its
place in the earth's frame (ECEF) less the datum's, turned [Groves, 2013, eq. 2.112, 2.150].
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from .records import freeze

A, F = 6378137.0, 1.0 / 298.257223563  # [m], of WGS 84
E2 = F * (2.0 - F)  # squared eccentricity
TIMES = 8  # of Bowring's iteration for a latitude: three give a nanometre near the ground
EARTH = "WGS 84"
"""The frame of fixes in latitude, longitude and height."""


def earth_of(place: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """x, y, z [m] in the earth's frame of latitude [deg], longitude [deg] and height over the ellipsoid [m]."""
    lat, lon, h = np.radians(place[..., 0]), np.radians(place[..., 1]), place[..., 2]
    N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    flat = (N + h) * np.cos(lat)
    return np.stack([flat * np.cos(lon), flat * np.sin(lon), (N * (1.0 - E2) + h) * np.sin(lat)], axis=-1)


def geodetic_of(xyz: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """Latitude [deg], longitude [deg] and height [m] of points in the earth's frame: the inverse of `earth_of`."""
    x, y, z = xyz[..., 0], xyz[..., 1], xyz[..., 2]
    p = np.hypot(x, y)
    b = A * (1.0 - F)
    u = np.arctan2(z, (1.0 - F) * p)
    for _ in range(TIMES):
        lat = np.arctan2(z + E2 / (1.0 - E2) * b * np.sin(u) ** 3, p - E2 * A * np.cos(u) ** 3)
        u = np.arctan2((1.0 - F) * np.sin(lat), np.cos(lat))
    N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    h = p * np.cos(lat) + z * np.sin(lat) - A**2 / N
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), h], axis=-1)


def _axes(datum: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: east, north and up at the datum, in the earth's frame."""
    lat, lon = np.radians(datum[:2])
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])


def enu_of(place: Float[np.ndarray, "... 3"], datum: Float[np.ndarray, "3"]) -> Float[np.ndarray, "... 3"]:
    """East, north, up [m] of the datum, of latitudes [deg], longitudes [deg] and heights [m]."""
    return np.asarray((earth_of(place) - earth_of(np.asarray(datum, float))) @ _axes(datum).T)


def place_of(enu: Float[np.ndarray, "... 3"], datum: Float[np.ndarray, "3"]) -> Float[np.ndarray, "... 3"]:
    """Latitude [deg], longitude [deg], height [m] of what lies east, north and up [m] of the datum."""
    return geodetic_of(earth_of(np.asarray(datum, float)) + np.asarray(enu, float) @ _axes(datum))


@dataclass(frozen=True, slots=True)
class Fixes:
    """Where an antenna on one robot was, as something outside the robot tells.

    t: (k,) [s], ascending; place: (k, 3) latitude [deg], longitude [deg], height [m] where `frame` is `EARTH`, else x,
    y, z [m] in `frame`; cov: (k, 2, 2) [m^2] over x, y (east, north) as the log has it, NaN where it does not say;
    antenna: (2,) [m] where it stands on the robot; topic: where they were read; dropped: reason -> fixes left out.
    """

    t: Float[np.ndarray, " k"]
    place: Float[np.ndarray, "k 3"]
    cov: Float[np.ndarray, "k 2 2"]
    antenna: Float[np.ndarray, "2"] = field(default_factory=lambda: np.zeros(2))
    frame: str = EARTH
    topic: str = ""
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "t", "place", "cov", "antenna")

    def __len__(self) -> int:
        return len(self.t)

    def xy(self, datum: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "k 2"]:
        """East and north [m] of the datum; x and y of a frame that has none."""
        return np.asarray((self.place if datum is None else enu_of(self.place, datum))[:, :2])

    def within(self, first: float, last: float) -> "Fixes":
        """Those from `first` to `last` [s]."""
        return self.select((self.t >= first) & (self.t <= last))

    def select(self, kept: np.ndarray) -> "Fixes":
        """The rows of a mask or an index."""
        return replace(self, t=self.t[kept], place=self.place[kept], cov=self.cov[kept])


def datum_of(fixes: Sequence[Fixes]) -> Float[np.ndarray, "3"] | None:
    """Latitude [deg], longitude [deg] and height [m] amid the fixes of the first that has any; None where none is.

    A median, which fixes that jump do not move; on the date line of the fixes' majority.
    """
    first = next((f for f in fixes if f.frame == EARTH and len(f)), None)
    if first is None:
        return None
    lon = np.degrees(np.unwrap(np.radians(first.place[:, 1])))
    middle = np.median(np.column_stack([first.place[:, 0], lon, first.place[:, 2]]), axis=0)
    return np.array([middle[0], (middle[1] + 180.0) % 360.0 - 180.0, middle[2]])
