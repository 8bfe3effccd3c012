"""Scans that take their time while the robot drives: put right, and which way round is found."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Scan, Track, frozen
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.scan_matching import FrontEndConfig
from mapweave.laser.sweep import sweep_of, swept
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser

BEAMS, PERIOD, NOISE = 360, 0.2, 0.005  # [s], [m]
CORNERS = [(-5, -4), (6, -4), (6, 1), (3, 1), (3, 4), (-5, 4)]  # [m] of the room,
BOXES = [(-3.0, 1.5, 1.0), (0.5, -2.5, 0.8), (4.5, -1.0, 0.6), (-3.5, -2.5, 0.7)]  # and x, y, side of what stands in it


def outline(corners):
    return np.array([[a, b] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)], dtype=float)


def walls():
    out = [outline(CORNERS)]
    for x, y, side in BOXES:
        h = side / 2
        out.append(outline([(x - h, y - h), (x + h, y - h), (x + h, y + h), (x - h, y + h)]))
    return np.concatenate(out)


WALLS = walls()


def seen(pose, angle):
    """The range [m] of one beam from each pose (n, 3) at each angle (n,) in the robot's frame."""
    d = np.column_stack([np.cos(pose[:, 2] + angle), np.sin(pose[:, 2] + angle)])
    a, e = WALLS[:, 0], WALLS[:, 1] - WALLS[:, 0]
    off = a[None] - pose[:, None, :2]
    cross = d[:, None, 0] * e[None, :, 1] - d[:, None, 1] * e[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (off[..., 0] * e[None, :, 1] - off[..., 1] * e[None, :, 0]) / cross
        u = (off[..., 0] * d[:, None, 1] - off[..., 1] * d[:, None, 0]) / cross
    return np.where((r > 0) & (u >= 0) & (u <= 1), r, np.inf).min(axis=1)


def at(t):
    """The robot's pose at t (n,) [s]: round the room in loops, turning this way and that by up to 1.3 rad/s."""
    heading = 0.25 * t + 1.6 * np.sin(0.8 * t)
    return np.column_stack([-0.5 + 1.5 * np.cos(0.25 * t), 0.2 + 1.2 * np.sin(0.25 * t), heading])


def drive(sweep, *, scans=120, opening=2 * np.pi, wheels=True, seed=0):
    """A log whose scans take `sweep` [s] around their stamps, negative in reverse, and say that they take its size."""
    rng = np.random.default_rng(seed)
    step = opening / BEAMS
    angle = -opening / 2 + step * np.arange(BEAMS)
    when = 1.0 + PERIOD * np.arange(scans)
    stamps = np.arange(0.0, when[-1] + 1.0, 0.05)
    odometry = Track(stamps, at(stamps) * [1.01, 1.01, 1.0], frame="odom")
    log = []
    for t in when:
        beam_t = t + sweep * (np.arange(BEAMS) / (BEAMS - 1) - 0.5)
        r = seen(at(beam_t), angle) + rng.normal(0.0, NOISE, BEAMS)
        pose = se2.interpolate(np.array([t]), stamps, odometry.pose)[0]
        own = frozen(pose) if wheels else None
        log.append(Scan(frozen(r), frozen(np.ones(BEAMS), bool), None, angle[0], step, 20.0, odometry=own))
    rows = odometry if wheels else None
    return LaserLog("1", "made", when, tuple(log), rows, log_hash="made", sweep=abs(sweep))


def asked(log):
    return sweep_of(log, BeamConfig(), FrontEndConfig())


@pytest.mark.parametrize("sweep", [PERIOD, -PERIOD])
def test_beams_lie_where_the_robot_saw_them_from(sweep):
    log = drive(sweep, scans=30)
    truth = at(log.scan_t)
    plain, right = [], []
    for k in range(1, 30):
        step = se2.between(truth[k - 1], truth[k + 1] if k < 29 else truth[k]) * (0.5 if k < 29 else 1.0)
        for scan, out in ((log.scans[k], plain), (swept(log.scans[k], step, PERIOD, sweep), right)):
            s = se2.act(truth[k], beams(scan, "none", None, BeamConfig()).s)
            out.append(np.median(np.abs(np.min([off_wall(s, wall) for wall in WALLS], axis=0))))
    assert np.mean(right) < 0.012
    assert np.mean(plain) > 3 * np.mean(right)


def off_wall(s, wall):
    """How far points (n, 2) lie from a wall (2, 2) [m]."""
    a, e = wall[0], wall[1] - wall[0]
    share = np.clip((s - a) @ e / (e @ e), 0.0, 1.0)
    return np.hypot(*(s - a - share[:, None] * e).T)


@pytest.mark.parametrize("wheels", [True, False])
@pytest.mark.parametrize("seed", [0, 1])
def test_which_way_round_is_found_in_the_log(seed, wheels):
    assert asked(drive(PERIOD, wheels=wheels, seed=seed)) == PERIOD
    assert asked(drive(-PERIOD, wheels=wheels, seed=seed)) == -PERIOD


def test_the_time_of_a_part_of_a_circle_is_taken_as_it_is_stated():
    assert asked(drive(0.07, scans=40, opening=np.radians(240))) == 0.07


def test_a_driver_that_states_another_time_means_a_revolution_in_reverse():
    log = replace(drive(-PERIOD), sweep=0.0107)
    assert asked(log) == pytest.approx(-PERIOD)


def test_nothing_is_found_where_nothing_is_stated_or_told():
    log = drive(PERIOD)
    assert asked(replace(log, sweep=0.0)) == 0.0
    assert asked(replace(log, scans=log.scans[:20], scan_t=log.scan_t[:20])) == 0.0  # too few that turn
    slow = replace(log, scan_t=10.0 * log.scan_t)
    assert asked(slow) == 0.0
    pause = swept(log.scans[3], np.array([0.1, 0.0, 0.1]), 2.0, PERIOD)
    assert pause.motion is None


@pytest.mark.parametrize("method", ["graph", "gated"])
def test_a_map_of_swept_scans_is_right(method):
    log = drive(-PERIOD, scans=200)
    errors = []
    for one in (log, replace(log, sweep=0.0)):
        made = map_laser(one, LaserConfig(method=method), 0)
        truth, found = (se2.between(pose[0], pose) for pose in (at(one.scan_t), np.array(made.scans.pose)))
        off = se2.between(truth, found)
        errors.append(np.sqrt(np.mean(off[:, 2] ** 2)))
        told = [f.value for f in made.findings if f.code == "scans-swept"]
        assert told == ([pytest.approx(-PERIOD)] if one.sweep else [])
    assert errors[0] < 0.02
    assert errors[1] > 2 * errors[0]
