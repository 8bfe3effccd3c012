"""A camera's view of 58 degrees: it turns away from all it saw within a step or two, and wheels carry the robot on."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.records import Scan, frozen
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.scan_matching import FrontEndConfig, ScanMatch, better
from mapweave.laser.scan_odometry import ScanOdometry, field_of_view
from mapweave.laser.wheel_worth import Median
from mapweave.mapping.segments import Borders
from mapweave.sim.laser import DriftConfig, DriveConfig, Scanner, drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

CAMERA = Scanner(beams=320, opening=np.radians(58.0), near=0.45, far=5.0, noise=0.01)
SD = np.array([0.1, 0.1, 0.06])


def seen(ranges: np.ndarray, odometry: np.ndarray, wide: float = np.radians(58.0)) -> Scan:
    n = len(ranges)
    hit = np.isfinite(ranges)
    r = frozen(np.where(hit, ranges, 8.0))
    return Scan(r, frozen(hit, bool), None, -wide / 2, wide / (n - 1), 8.0, odometry=odometry)


def looking(heading: float, box: float = 3.0, n: int = 120) -> np.ndarray:
    """Ranges from the middle of a square room of walls that are no two alike: one has a step of its own."""
    angle = heading + np.linspace(-np.radians(29.0), np.radians(29.0), n)
    side = np.array([1.0, 1.25, 0.8, 1.5])[np.round(angle / (np.pi / 2)).astype(int) % 4]
    off = (angle + np.pi / 4) % (np.pi / 2) - np.pi / 4
    return box * side / np.cos(off)


def turned_by(step: float, far: np.ndarray | None = None) -> str:
    """What becomes of a scan after the robot has turned by `step` [rad], its wheels say; far: what it sees then."""
    odometry = ScanOdometry(FrontEndConfig())
    for heading, ranges in ((0.0, looking(0.0)), (step, looking(step) if far is None else far)):
        scan = seen(ranges, np.array([0.0, 0.0, heading]))
        info = odometry.advance(scan, beams(scan, "none", None, BeamConfig()))
    return info.decision


def test_what_was_never_looked_at_need_not_match_and_what_was_must():
    assert turned_by(1.5) == "unseen"
    assert turned_by(0.2) == "matched"
    other = 1.5 + np.random.default_rng(1).uniform(0.0, 4.0, 120)
    assert turned_by(0.02, other) == "odometry"


def test_wheels_go_on_over_what_was_unseen_and_nothing_is_cut():
    borders = Borders()
    odometry = ScanOdometry(FrontEndConfig())
    whys = []
    for k in range(12):
        scan = seen(looking(1.3 * k), np.array([0.0, 0.0, 1.3 * k]))
        info = odometry.advance(scan, beams(scan, "none", None, BeamConfig()))
        whys.append(borders.seen(0.5 * k, info, odometry.step, wheels=True))
    assert set(whys) == {""}
    assert se2.wrap_angle(odometry.pose[2] - 1.3 * 11) == pytest.approx(0.0, abs=0.05)


def test_what_wheels_tell_of_a_step_is_told_whatever_the_scans_say_and_nothing_where_they_were_set_anew():
    odometry, told = ScanOdometry(FrontEndConfig()), []
    for k, wheels in enumerate(([1.0, 2.0, 0.5], [1.0, 2.0, 0.7], [5.0, 5.0, 0.0], None)):
        scan = replace(seen(looking(0.1 * k), np.zeros(3)), odometry=None if wheels is None else np.array(wheels))
        odometry.advance(scan, beams(scan, "none", None, BeamConfig()), leapt=k == 2)
        told.append(odometry.told)
    np.testing.assert_allclose(told[1], [0.0, 0.0, 0.2], atol=1e-12)
    assert told[2] is told[3] is None


def test_points_lie_in_a_view_by_its_sector_and_reach():
    scan = seen(np.full(10, 3.0), np.zeros(3), wide=1.0)
    view = field_of_view(scan)
    at = np.array([-0.51, -0.49, 0.0, 0.49, 0.51, np.pi])
    points = 2.0 * np.column_stack([np.cos(at), np.sin(at)])
    assert [view.share_of(p[None]) for p in points] == [0, 1, 1, 1, 0, 0]
    assert view.share_of(np.array([[7.9, 0.0], [8.1, 0.0]])) == 0.5
    behind = Scan(scan.ranges, scan.hit, None, -0.5, 1 / 9, 8.0, np.array([1.0, 0.0, np.pi]))
    assert field_of_view(behind).share_of(np.array([[0.0, 0.0], [2.0, 0.0]])) == 0.5
    backwards = Scan(scan.ranges, scan.hit, None, 0.5, -1 / 9, 8.0)
    assert [field_of_view(backwards).share_of(p[None]) for p in points] == [0, 1, 1, 1, 0, 0]


def test_a_match_far_from_where_wheels_put_it_must_win_returns():
    def match(matches: int, *off: float) -> ScanMatch:
        return ScanMatch(np.zeros(3), np.eye(3), np.array(off), matches, 100)

    here = match(50, 0.0, 0.0, 0.0)
    little, far = (0.0, 0.0, 0.03), (0.0, 0.0, 0.6)
    assert better(here, match(52, *little), SD, costs=True).matches == 52
    assert better(here, match(60, *far), SD, costs=True) is here
    assert better(here, match(95, *far), SD, costs=True).matches == 95
    assert better(match(52, *little), here, SD, costs=True).matches == 52
    assert better(here, match(60, *far), SD, costs=False).matches == 60


def test_the_median_of_steps_is_not_moved_by_some_that_are_wrong():
    rng = np.random.default_rng(3)
    median = Median()
    for k in range(400):
        median.see(abs(rng.normal(0.0, 0.4)) if k % 4 else 30.0)
    assert median.of(1.0) == pytest.approx(0.4, rel=0.4)
    assert Median().of(1.0) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [904, 906, 912])
def test_offices_are_mapped_in_one_piece(seed):
    rng = np.random.default_rng([seed, 77])
    cfg = OfficeConfig(
        rooms=int(rng.integers(3, 7)),
        room_width=float(rng.uniform(4, 7)),
        room_depth=float(rng.uniform(3.5, 6)),
        corridor=float(rng.uniform(1.8, 3)),
        visited=int(rng.integers(3, 7)),
        drive=DriveConfig(scanner=CAMERA, drift=DriftConfig(end_error=(1.0, 4.0))),
    )
    sim = drive(office_world(cfg, seed), office_route(cfg, seed), cfg.drive, seed)
    made = mapweave.map([sim.log])
    (track,) = made.components[0].tracks.values()
    at = se2.interpolate(track.t, sim.truth.t, sim.truth.pose)[:, :2]
    off = se2.act(se2.align(track.pose[:, :2], at), track.pose[:, :2]) - at
    assert np.hypot(*off.T).max() < 1.0
    assert not {f.code for f in made.findings} & {"track-cut", "segment-apart", "scene-jump"}
