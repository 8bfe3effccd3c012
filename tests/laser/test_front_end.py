"""The local map as one robot fills it, the match without odometry, and the search round an old place."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.kernels.laser.local_map import count_matches
from mapweave.laser import closures
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.closures import (
    CLOSURE_SEARCH_REACH,
    CLOSURE_SEARCH_SD,
    CLOSURE_SEARCH_STEPS,
    Place,
    PlaceMatcher,
)
from mapweave.laser.scan_matching import FRONT_END_AGREE, FRONT_END_COARSE, KEYFRAME_DISTANCE, FrontEnd, FrontEndConfig
from mapweave.laser.scan_odometry import ScanOdometry

from .test_scan_matching import box_scan

CFG = FrontEndConfig(size=256)
SD = np.array([0.25, 0.25, 0.35])


def seen(pose, n=61, half=(3.0, 2.0)):
    return beams(box_scan(np.asarray(pose, float), n, half), "none", None, BeamConfig())


def mapped(*poses, cfg=CFG, **room):
    fe = FrontEnd(cfg)
    for pose in poses:
        fe.insert(seen(pose, **room), np.asarray(pose, float))
    return fe


def test_a_scan_becomes_a_keyframe_far_enough_from_the_last_in_place_or_heading():
    fe, kept, last = FrontEnd(CFG), 0, None
    rng = np.random.default_rng(1)
    pose = np.zeros(3)
    for _ in range(40):
        d = np.full(3, np.inf) if last is None else se2.between(last, pose)
        far = np.hypot(d[0], d[1]) >= KEYFRAME_DISTANCE or abs(d[2]) >= CFG.keyframe_turn
        assert fe.insert(seen(pose), pose) == far
        if far:
            last, kept = pose, kept + 1
        pose = se2.compose(pose, np.array([*rng.uniform(-0.1, 0.2, 2), rng.uniform(-0.2, 0.2)]))
        pose[:2] = np.clip(pose[:2], -1.0, 1.0)
    assert 5 < kept < 35
    assert len(fe.keyframes) == kept


def test_a_local_map_holds_the_last_keyframes_and_nothing_else():
    poses = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.1], [0.9, 0.3, -0.2], [0.4, 0.4, 0.5], [-0.2, 0.3, 1.0]]
    few = mapped(*poses, cfg=replace(CFG, keyframes=3))
    fresh = mapped(*poses[2:], cfg=CFG)
    held = mapped([0.3, -0.4, 2.0])
    held.hold([(seen(pose), np.array(pose)) for pose in poses[2:]])
    for other in (fresh, held):
        for a, b in zip(few.sums, other.sums, strict=True):
            np.testing.assert_allclose(a, b, atol=2e-3)
    held.hold([])
    assert not any(np.abs(level).max() > 1e-3 for level in held.sums)
    assert held.insert(seen(poses[0]), np.array(poses[0]))


@pytest.mark.parametrize(
    ("last", "step", "moved"),
    [
        ([0.0, 0.0, 0.0], [0.2, 0.0, 0.1], [0.25, 0.02, 0.12]),  # it drove on
        ([0.2, 0.1, 0.3], [0.3, 0.0, 0.0], [0.0, 0.0, 0.02]),  # it stopped
        ([-0.3, 0.2, -0.2], [0.1, 0.0, 0.0], [0.1, 0.05, 0.9]),  # it turned as nobody could know
        ([0.0, 0.0, 0.4], [0.1, 0.0, 0.1], [0.1, -0.05, -0.8]),
    ],
)
def test_without_odometry_a_scan_is_found_wherever_the_robot_turned(last, step, moved):
    fe = mapped([0.0, 0.0, 0.0], [0.2, 0.0, 0.9], [0.0, 0.1, -0.9], [0.1, 0.0, 1.8], [0.0, 0.0, -1.8])
    last, step = np.array(last), np.array(step)
    true = se2.compose(last, np.array(moved))
    found = fe.match_alone(seen(true), last, step, SD)
    assert np.abs(se2.between(true, found.pose)).max() < 0.04
    assert found.matches > 0.7 * found.beams
    np.testing.assert_allclose(se2.compose(se2.compose(last, step), found.innovation), found.pose, atol=1e-9)


@pytest.mark.parametrize("every", [1, 2])
def test_without_odometry_turns_of_any_width_are_found_in_rooms(every):
    sim = mapweave.simulate_laser(world=mapweave.OfficeConfig(rooms=2, visited=2), seed=1)
    odometry = ScanOdometry(FrontEndConfig(), tell_lines=False)
    for scan in sim.log.scans[::every]:
        odometry.advance(replace(scan, odometry=None), beams(scan, "none", None, BeamConfig()))
    pose = np.array(odometry.poses)
    true = se2.interpolate(sim.log.scan_t[::every], sim.truth.t, sim.truth.pose)
    told, was = se2.between(pose[:-1], pose[1:]), se2.between(true[:-1], true[1:])
    assert np.abs(was[:, 2]).max() > 1.5
    off = se2.between(was, told)
    assert np.abs(off[:, 2]).max() < 0.05
    turned = np.abs(was[:, 2]) > 0.5  # a corridor, which it drives straight, tells little of the way along it
    assert np.hypot(off[turned, 0], off[turned, 1]).max() < 0.1


def test_along_a_bare_corridor_a_robot_without_odometry_drives_on_as_it_did():
    room = {"half": (400.0, 1.0)}
    way = [np.array([0.5 * k, 0.0, 0.0]) for k in range(6)]
    fe = mapped(*way, cfg=FrontEndConfig(), **room)
    for step in ([0.3, 0.0, 0.0], [0.5, 0.0, 0.0]):
        true = se2.compose(way[-1], np.array(step))
        found = fe.match_alone(seen(true, **room), way[-1], np.array(step), SD)
        assert np.abs(se2.between(true, found.pose)).max() < 0.1


def in_a_corridor_of_doors(pose):
    """A scan over 180 degrees in a corridor 2 m wide, whose right wall stands back by 0.15 m at every second metre."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 181)
    x = np.linspace(-8.0, 12.0, 4001)
    right = np.where(x % 2.0 < 1.0, -1.0, -1.15)
    c, s = np.cos(angle + pose[2]), np.sin(angle + pose[2])
    r = np.full(len(angle), 30.0)
    for k in np.flatnonzero(s > 1e-3):
        r[k] = (1.0 - pose[1]) / s[k]
    for k in np.flatnonzero(s < -1e-3):
        far = (x - pose[0]) / c[k] if abs(c[k]) > 1e-9 else np.full(len(x), np.inf)
        within = (far > 0.0) & (pose[1] + far * s[k] <= right)
        r[k] = far[within].min() if within.any() else 30.0
    return beams(Scan(r, r < 9.0, None, -0.5 * np.pi, float(angle[1] - angle[0]), 9.0), "none", None, BeamConfig())


def test_walls_that_come_into_view_do_not_pull_a_scan_along():
    fe = FrontEnd(FrontEndConfig())
    fe.ends = True
    for k in range(8):  # it drives backwards, so that what is new stands beside it
        fe.insert(in_a_corridor_of_doors((-0.45 * k, 0.0, 0.0)), np.array([-0.45 * k, 0.0, 0.0]))
    true = np.array([-0.45 * 8, 0.0, 0.0])
    for off in (0.0, 0.03, -0.03):
        found = fe.match(in_a_corridor_of_doors(true), np.add(true, [off, 0.0, 0.0]), np.array([0.1, 0.1, 0.05]))
        assert np.abs(found.pose - true).max() < 0.03


@pytest.mark.parametrize("sd", [[0.3, 0.26, 0.05], [0.1, 0.5, 0.02], [2.0, 2.0, 1.0]])
def test_a_search_begins_where_most_returns_match_of_all_starts_within_reach(monkeypatch, sd):
    monkeypatch.setattr(closures, "CLOSURE_SEARCH_XY", 0.9)
    monkeypatch.setattr(closures, "CLOSURE_SEARCH_TURN", 0.1)
    monkeypatch.setattr(closures, "CLOSURE_SEARCH_BEAMS", 30)
    matcher, sd = PlaceMatcher(CFG), np.array(sd)
    matcher.front_end.hold([(seen(p), np.array(p)) for p in ([0.0, 0.0, 0.0], [0.2, 0.0, 1.0], [0.0, 0.1, -1.0])])
    b, predicted = seen([0.3, 0.2, 0.1]), np.array([-0.1, 0.5, 0.15])
    thin = slice(None, None, len(b.q) // 30)

    def fits(pose):
        s, normal, q = (np.ascontiguousarray(a[thin]) for a in (b.s, b.normal, b.q))
        return count_matches(
            matcher.front_end.coarse, FRONT_END_COARSE, s, normal, q, 0.0, FRONT_END_AGREE, pose, CLOSURE_SEARCH_REACH
        )

    reach = np.minimum(CLOSURE_SEARCH_SD * sd, [0.9, 0.9, 0.1])
    steps = np.array(CLOSURE_SEARCH_STEPS)
    axes = [h * np.arange(-20, 21) for h in steps]
    axes = [axis[np.abs(axis) <= r + 1e-12] for axis, r in zip(axes, reach, strict=True)]
    starts = [se2.compose(predicted, np.array([x, y, a])) for x in axes[0] for y in axes[1] for a in axes[2]]
    counts = [fits(pose) for pose in starts]
    np.testing.assert_allclose(matcher._search(b, predicted, sd), starts[int(np.argmax(counts))], atol=1e-12)
    assert max(counts) > min(counts)


def test_only_an_unsure_place_is_searched(monkeypatch):
    monkeypatch.setattr(closures, "CLOSURE_LEAST_MATCHES", 10)
    matcher, asked = PlaceMatcher(CFG), []
    monkeypatch.setattr(matcher, "_search", lambda _b, predicted, _sd: asked.append(predicted) or predicted)
    place, at = Place([(seen([0.0, 0.0, 0.0]), np.zeros(3))]), np.array([0.1, 0.0, 0.05])
    for sd, searched in (([0.24, 0.24], 0), ([0.26, 0.1], 1), ([0.1, 0.26], 2)):
        matcher.match(place, seen(at), at, np.diag([*np.square(sd), 1e-4]))
        assert len(asked) == searched
