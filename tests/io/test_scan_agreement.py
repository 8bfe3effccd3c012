"""Scans and wheels that tell one motion are left alone; turned scanners and other units are told, corridors are not."""

import re

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.io.assemble import RawLog, RawScan
from mapweave.io.scan_checks import scan_agreement

REACH = 30.0


def ranges(pose, size, rng, beams=180, noise=0.01) -> np.ndarray:
    """`beams` over half a turn in a hall of `size` [m] about the origin; noise [m]."""
    angle = pose[2] + np.linspace(-np.pi / 2, np.pi / 2, beams)
    u = np.stack([np.cos(angle), np.sin(angle)])
    half = np.array(size)[:, None] / 2
    with np.errstate(divide="ignore"):
        far = np.where(u > 0, half - pose[:2, None], -half - pose[:2, None]) / u
    return far.min(axis=0) + rng.normal(0, noise, beams)


def drive(
    seed: int, size=(12.0, 9.0), *, mount=0.0, scale=1.0, wheels=lambda pose: pose, beams=180, noise=0.01
) -> list[Scan]:
    """Straight ways and turns on the spot; `mount` of the scanner [rad], ranges times `scale`, odometry as `wheels`."""
    rng = np.random.default_rng(seed)
    pose, scans, turn = np.zeros(3), [], 0.0
    for k in range(500):
        turn = rng.uniform(0.05, 0.3) if k % 20 == 12 else turn
        step = [0.05, 0.0, 0.0] if k % 20 < 12 else [0.0, 0.0, turn]
        pose = se2.compose(pose, np.array(step))
        seen = ranges(se2.compose(pose, np.array([0.0, 0.0, mount])), size, rng, beams, noise) * scale
        hit = (seen > 0) & (seen < REACH)
        scans.append(
            Scan(
                np.where(hit, seen, REACH),
                hit,
                None,
                -np.pi / 2,
                np.pi / (beams - 1),
                REACH,
                odometry=np.array(wheels(pose), float),
            )
        )
    return scans


@pytest.mark.parametrize("seed", [1, 2])
def test_a_right_log_is_left_alone_in_halls_and_corridors(seed):
    found = scan_agreement(drive(seed))
    assert found.finding("1") is None
    assert found.scale == pytest.approx(1.0, abs=0.15)
    assert found.direction == pytest.approx(0.0, abs=0.1)
    assert scan_agreement(drive(seed, (400.0, 2.0))).finding("1") is None


@pytest.mark.parametrize("beams", [361, 721, 1441])
def test_beams_a_fraction_of_a_degree_apart_tell_the_motion_as_well(beams):
    """Walls were seen to lie as two neighbouring returns do, which noise turns anywhere."""
    found = scan_agreement(drive(1, beams=beams, noise=0.03))
    assert found.finding("1") is None
    assert found.scale == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"mount": 0.5}, r"the scans move (2[6-9]|3[0-2])\.\d.* degrees to the right"),
        ({"mount": np.pi}, r"the scans move 1[78]\d\.\d.* degrees"),
        ({"scale": 2.0}, r"the scans move (1\.[89]|2|2\.1) times"),
        ({"wheels": lambda p: [p[0], -p[1], p[2]]}, r"the scans move (0\.\d+ times|1[78]\d\.\d.* degrees)"),
        ({"wheels": lambda p: [p[0], p[1], -p[2]]}, r"the scans move 0\.\d+ times"),
    ],
)
def test_what_contradicts_the_wheels_is_told(wrong, told):
    for seed in (3, 4):
        found = scan_agreement(drive(seed, **wrong)).finding("1")
        assert found is not None
        assert re.match(r"(?s).*" + told, found.text), found


@pytest.mark.parametrize(("unit", "told"), [(1000.0, "the odometry is not used"), (39.37, "in inches"), (1.0, None)])
def test_odometry_in_another_unit_is_left_out_and_told(unit, told):
    log = RawLog("1", "here", "")
    for k, scan in enumerate(drive(5)):
        odometry = scan.odometry * np.array([unit, unit, 1.0])
        log.scans.append(
            RawScan(0.2 * k, scan.ranges, None, scan.angle_min, scan.angle_increment, 0.0, REACH, odometry=odometry)
        )
    read = log.finish()
    if told is None:
        assert not read.findings
        return
    assert [f.code for f in read.findings] == ["wheels-fast", "no-odometry"]
    assert told in read.findings[0].action
    assert read.odometry is None
    assert all(scan.odometry is None for scan in read.scans)
