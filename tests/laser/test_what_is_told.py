"""Logs handed over with a mistake: the map says which, with the number found; a right log is mapped without a word."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import DataError
from mapweave.io.assemble import RawLog, RawScan
from mapweave.laser.config import LaserConfig
from mapweave.laser.mapping import map_laser
from mapweave.sim.office import OfficeConfig, simulate_office

CFG = LaserConfig(method="graph", feature="none")


@pytest.fixture(scope="module")
def office():
    return simulate_office(OfficeConfig(rooms=2, visited=2), 5).log


def told(log, change=lambda scan: scan, rows=lambda rows: rows):
    """What is said of the log when each scan, and the rows of odometry, are changed before it is read."""
    raw = RawLog("1", "office", "")
    for t, scan in zip(log.scan_t.tolist(), log.scans, strict=True):
        ranges = np.where(scan.hit, scan.ranges, np.inf)
        mount, far = scan.T_robot_sensor, scan.range_max
        raw.scans.append(
            change(RawScan(t, ranges, None, scan.angle_min, scan.angle_increment, 0.0, far, mount, odometry=None))
        )
    raw.odometry = rows([tuple(row) for row in np.column_stack([log.odometry.t, log.odometry.pose]).tolist()])
    return map_laser(raw.finish(), CFG, 0).warnings


def test_nothing_is_told_of_a_right_log(office):
    assert told(office) == ()


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_ranges_of_another_scale_are_told_with_the_factor(office, factor):
    said = told(office, lambda raw: replace(raw, ranges=factor * raw.ranges, range_max=factor * raw.range_max))
    (line,) = [text for text in said if "times as far as the wheels tell" in text]
    assert float(line.split()[3]) == pytest.approx(factor, abs=0.06)
    assert not any("something moved along" in text for text in said)


def test_a_scanner_mounted_turned_is_told_once_with_the_angle(office):
    said = told(office, lambda raw: replace(raw, T_robot_sensor=np.array([0.0, 0.0, np.radians(20)])))
    (line,) = [text for text in said if "degrees to the" in text]
    assert float(line.split()[3]) == pytest.approx(20.0, abs=1.0)
    assert "to the left of where the wheels lead" in line


def test_angles_between_beams_that_are_wrong_are_told_with_the_factor(office):
    wide = lambda raw: replace(raw, angle_min=1.1 * raw.angle_min, angle_increment=1.1 * raw.angle_increment)
    (line,) = [text for text in told(office, wide) if "the scans turn" in text]
    assert float(line.split()[3]) == pytest.approx(1.1, abs=0.03)


def test_scans_that_are_stamped_late_are_told_with_the_lag(office):
    said = told(office, lambda raw: replace(raw, t=raw.t + 0.5))
    assert any(text.startswith("the scans bear stamps 0.50 s after those of the odometry") for text in said)


def test_odometry_that_never_turns_or_is_another_drives_is_told(office):
    other = simulate_office(OfficeConfig(rooms=2, visited=2), 6).log.odometry.pose.tolist()
    for rows in (
        lambda rows: [(t, x, y, 0.0) for t, x, y, _ in rows],
        lambda rows: [(row[0], *pose) for row, pose in zip(rows, other, strict=False)],
    ):
        assert any("the scans and the wheels tell different motions" in text for text in told(office, rows=rows))


def test_a_robot_that_is_carried_to_another_room_is_told_with_the_time(office):
    first, last = 40, len(office.scans) - 40
    jump = office.scan_t[last]
    end, begin = np.array(office.scans[first].odometry), np.array(office.scans[last].odometry)

    def joined(rows):
        early = [row for row in rows if row[0] <= office.scan_t[first]]
        late = [
            (r[0], *np.asarray(se2.compose(end, se2.between(begin, np.array(r[1:]))))) for r in rows if r[0] >= jump
        ]
        return early + late

    kept = [k for k in range(len(office.scans)) if k <= first or k >= last]
    log = replace(office, scan_t=office.scan_t[kept], scans=tuple(office.scans[k] for k in kept))
    (line,) = [text for text in told(log, rows=joined) if "the scene changes at once" in text]
    assert line.startswith(f"at {jump:.1f} s ")


def test_ranges_in_millimetres_are_refused_with_the_log_and_how_long_they_are(office):
    said = r"office: the median of the ranges is \d{4}: expected returns between 0.02 and 25 m; are the ranges in"
    with pytest.raises(DataError, match=said):
        told(office, lambda raw: replace(raw, ranges=1000.0 * raw.ranges, range_max=1000.0 * raw.range_max))


def test_a_log_whose_beams_all_lie_beyond_the_scanners_range_is_told(office):
    lines = told(office, lambda raw: replace(raw, ranges=1000.0 * raw.ranges))
    n = len(office.scans)
    assert lines == (f"{n} of {n} scans have no return at all: are the ranges in metres?",)
