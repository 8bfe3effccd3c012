"""Laser logs whose light was spoilt on purpose."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Scan

Light = Callable[[int, Scan], np.ndarray]


def with_light(log: LaserLog, made: Light) -> LaserLog:
    """The log with the intensities that `made` gives for the number and the record of every scan."""
    scans = tuple(replace(scan, intensities=made(k, scan)) for k, scan in enumerate(log.scans))
    return replace(log, scans=scans)


def shuffled_along_walls(log: LaserLog, seed: int = 0, share: float = 0.1) -> LaserLog:
    """Light of returns of nearly one range changes places within every scan: how it falls with range stays."""
    rng = np.random.default_rng(seed)

    def made(_: int, scan: Scan) -> np.ndarray:
        light = np.array(scan.intensities)
        shelf = np.floor(np.log(np.maximum(scan.ranges, 1e-3)) / share)
        for value in np.unique(shelf[scan.hit]):
            at = np.flatnonzero(scan.hit & (shelf == value))
            light[at] = light[rng.permutation(at)]
        return light

    return with_light(log, made)


def fixed_to_the_scanner(log: LaserLog, seed: int = 0) -> LaserLog:
    """Every beam has a gain of its own, alike to that of its neighbours; places do not matter."""
    rng = np.random.default_rng(seed)
    n = max(len(scan.ranges) for scan in log.scans)
    gain = np.exp(0.3 * np.convolve(rng.standard_normal(n + 8), np.ones(9) / 3.0, "valid"))

    def made(_: int, scan: Scan) -> np.ndarray:
        noise = np.exp(0.03 * rng.standard_normal(len(scan.ranges)))
        return np.where(scan.hit, 1000.0 * gain[: len(scan.ranges)] * noise / (1.0 + scan.ranges**2), 0.0)

    return with_light(log, made)


def of_another(log: LaserLog, others: Sequence[Scan]) -> LaserLog:
    """The light of another drive, beam for beam."""

    def made(k: int, scan: Scan) -> np.ndarray:
        light = others[k % len(others)].intensities
        assert light is not None
        return np.where(scan.hit, np.maximum(np.resize(light, len(scan.ranges)), 1.0), 0.0)

    return with_light(log, made)


def stuck_from(log: LaserLog, row: int) -> LaserLog:
    """From scan `row` on every beam repeats its light of that scan."""
    last = np.maximum(np.array(log.scans[row].intensities), 1.0)
    return with_light(log, lambda k, scan: np.array(scan.intensities) if k < row else np.resize(last, len(scan.ranges)))


def in_another_unit_from(log: LaserLog, row: int, factor: float) -> LaserLog:
    """From scan `row` on light is `factor` times as strong."""
    return with_light(log, lambda k, scan: np.array(scan.intensities) * (factor if k >= row else 1.0))
