"""The plane that latitudes and longitudes are laid on."""

import numpy as np
import pytest

from mapweave.core.fixes import Fixes, datum_of, earth_of, enu_of, geodetic_of, place_of

# Worked values of the pymap3d package's documentation and tests (its `lla0`, `xyz0`, `lla1`, `enu0`).
PLACE, EARTH_XYZ = np.array([42.0, -82.0, 200.0]), np.array([660675.2518247, -4700948.68316, 4245737.66222])
OTHER = np.array([42.002581974253744, -81.99775181226, 1139.7018])
ENU = np.array([186.277521, 286.84222, 939.69262])


def test_places_on_earth_are_where_published_values_have_them():
    assert earth_of(PLACE) == pytest.approx(EARTH_XYZ, abs=1e-4)
    assert geodetic_of(EARTH_XYZ)[:2] == pytest.approx(PLACE[:2], abs=1e-8)
    assert geodetic_of(EARTH_XYZ)[2] == pytest.approx(PLACE[2], abs=1e-3)
    assert earth_of(np.array([0.0, 0.0, 0.0])) == pytest.approx([6378137.0, 0.0, 0.0])
    assert earth_of(np.array([90.0, 0.0, 0.0])) == pytest.approx([0.0, 0.0, 6356752.314245179], abs=1e-8)


def test_east_north_up_is_where_published_values_have_it():
    assert enu_of(OTHER, PLACE) == pytest.approx(ENU, abs=0.02)
    assert place_of(ENU, PLACE)[:2] == pytest.approx(OTHER[:2], abs=2e-7)


@pytest.mark.parametrize("lat", [-89.9, -33.9, 0.0, 35.7, 78.0])
@pytest.mark.parametrize("lon", [-179.999, -70.0, 0.0, 139.7, 180.0])
def test_the_way_to_the_plane_and_back_is_none(lat, lon):
    datum = np.array([lat, lon, 30.0])
    enu = np.array([[0.0, 0.0, 0.0], [1000.0, -2000.0, 10.0], [-40000.0, 30000.0, 0.0]])
    assert enu_of(place_of(enu, datum), datum) == pytest.approx(enu, abs=1e-6)


def test_a_metre_north_is_about_nine_millionths_of_a_degree():
    north, east = place_of(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([60.0, 10.0, 0.0]))
    assert north[0] - 60.0 == pytest.approx(1 / 111412.24, rel=1e-4)  # of a degree of latitude at 60 degrees
    assert east[1] - 10.0 == pytest.approx(1 / 55800.0, rel=1e-3)  # and of longitude


def test_the_datum_lies_amid_the_fixes_whatever_jumps_and_over_the_date_line():
    place = np.array([[10.0, 179.9999, 5.0], [10.0001, -179.9999, 5.0], [10.0002, 179.9998, 5.0], [80.0, 0.0, 0.0]])
    fixes = Fixes(np.arange(4.0), place, np.full((4, 2, 2), np.nan))
    datum = datum_of([fixes])
    assert abs(datum[0] - 10.0) < 0.001
    assert 180.0 - abs(datum[1]) < 0.001
    assert datum_of([]) is None
    assert datum_of([Fixes(np.arange(4.0), place, np.full((4, 2, 2), np.nan), frame="mocap")]) is None
