"""How bad a log's wheels are, as the factor that `mapweave explore --laser --noise` takes.

    MAPWEAVE_DATA=.. python benchmarks/wheels.py [LOG...] [--stretch 5]      # without a log: the Intel one

The matched way (graph method) is cut into stretches; on each the wheels' error in heading and in length is held against
what the simulated wheels err by at factor 1 over as long a way with as much turning. The factor is the root mean square
of the ratio, and, so that single slips do not decide, the one of the middle stretch (median of squares over that of a
normal error). Beside them the same of simulated wheels whose factor is known.
"""

import argparse
import os
from pathlib import Path

import numpy as np

from mapweave.core import se2
from mapweave.io.laser_logs import read_laser
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_team import ODOMETRY_NOISE_ROTATION, ODOMETRY_NOISE_TRANSLATION, OdometryNoise, Wheels

MIDDLE = 0.4549  # median of a squared standard normal error


def stretches(pose: np.ndarray, stretch: float) -> np.ndarray:
    """Rows at which the way is cut, `stretch` [m] apart."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))])
    return np.searchsorted(way, np.arange(0.0, way[-1], stretch))


def factors(pose: np.ndarray, odometry: np.ndarray, stretch: float) -> dict[str, tuple[float, float]]:
    """Of heading and of length the factor of all stretches (root mean square) and of the middle one."""
    c = OdometryNoise()
    at = stretches(pose, stretch)
    step, told = (se2.log(se2.between(p[:-1], p[1:])) for p in (pose, odometry))
    cut = list(zip(at[:-1].tolist(), at[1:].tolist(), strict=True))
    turn = np.array([np.abs(step[a:b, 2]).sum() for a, b in cut])
    way = np.array([np.abs(step[a:b, 0]).sum() for a, b in cut])
    heading = np.array([(told[a:b, 2] - step[a:b, 2]).sum() for a, b in cut])
    length = np.array([(told[a:b, 0] - step[a:b, 0]).sum() for a, b in cut])
    var = {"heading": ODOMETRY_NOISE_ROTATION**2 * way + c.turning**2 * turn + (c.bias * way) ** 2}
    var["length"] = ODOMETRY_NOISE_TRANSLATION**2 * way + (c.scale * way) ** 2
    out = {}
    for name, error in (("heading", heading), ("length", length)):
        ratio = error**2 / var[name]
        out[name] = float(np.sqrt(ratio.mean())), float(np.sqrt(np.median(ratio) / MIDDLE))
    return out


def simulated(pose: np.ndarray, factor: float, seed: int) -> np.ndarray:
    """What simulated wheels of this factor tell along a way."""
    wheels = Wheels(OdometryNoise(factor=factor), np.random.default_rng(seed))
    out = [np.zeros(3)]
    for twist in se2.log(se2.between(pose[:-1], pose[1:])):
        out.append(se2.compose(out[-1], se2.exp(wheels.turned(twist))))
    return np.array(out)


def told(name: str, found: dict[str, tuple[float, float]]) -> str:
    both = (f"{factor:.1f}" for pair in found.values() for factor in pair)
    return f"| {name} | {' | '.join(both)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--stretch", type=float, default=5.0, help="[m]")
    args = parser.parse_args()
    print("| wheels | heading | its middle stretch | length | its middle stretch |\n|---|---|---|---|---|")
    for path in args.logs or [Path(os.environ["MAPWEAVE_DATA"]) / "carmen" / "intel.clf.gz"]:
        log = read_laser(path)
        pose = map_laser(log, LaserConfig(method="graph"), 0).scans.pose
        print(told(path.name, factors(pose, np.array([s.odometry for s in log.scans]), args.stretch)))
        for factor in (1.0, 4.0):
            print(told(f"simulated, factor {factor:g}", factors(pose, simulated(pose, factor, 0), args.stretch)))


if __name__ == "__main__":
    main()
