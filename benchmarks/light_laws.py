"""Laws of light fitted to real logs: what `mapweave simulate .. --law lds01` and `neato` return.

MAPWEAVE_DATA=.. python benchmarks/light_laws.py

Light from white paint hit squarely by range: of each log the law found from the log itself (`laser/beam.py`), white
being what the brightest twentieth of its places exceeds; the median over logs, rounded to two digits. Exponent: of
the cosine of incidence, the median. Noise: how light of one place differs from scan to scan, in log units (1.48 times
the median of what remains of the law in places of 0.1 m that five scans and more hit within a window), less beams: how
much of it is the beam's own over the whole log, beyond what chance leaves of a mean. Least, most: weakest and strongest
light said.
"""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapweave.core import se2
from mapweave.io.laser_logs import read_laser
from mapweave.laser.beam import CALIBRATION_WINDOW, Beams, IntensityCalibration, beams, calibrated
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import calibrating, ways
from mapweave.sim.laser import FITTED

LOGS = {
    "lds01": ("tb3_jchee_maze.bag", "tb3_khaidarovs_wall.bag", "tb3_riya_2000.bag", "tb3_starchon_wall.bag"),
    "neato": ("neato_first_bag.bag",),
}
HITS = 5  # scans of a window that hit a place whose light is compared
CAP = 0.5  # [log units] greater differences count as this


class Law(NamedTuple):
    """light: (k,) at the ranges `FITTED`; the rest as `Reflectance` names it."""

    light: np.ndarray
    exponent: float
    relative_noise: float
    beams: float
    least: float
    most: float


def fit(path: Path) -> Law:
    cfg = LaserConfig()
    log = read_laser(path)
    returns = [beams(scan, "none", None, cfg.beam) for scan in log.scans]
    rows, poses = next(ways(log, returns, calibrating(len(returns)), cfg))
    scans = [returns[k] for k in rows]
    made = calibrated(scans, poses)
    if made is None:
        raise SystemExit(f"{path}: its light follows no law")
    law = made.whole
    at = np.array(FITTED)
    off = np.full((len(scans), max(len(scan.ranges) for scan in log.scans)), np.nan)
    for start in range(0, len(scans), CALIBRATION_WINDOW):
        _differences(off, scans, poses, range(start, min(start + CALIBRATION_WINDOW, len(scans))), law)
    capped = np.clip(off, -CAP, CAP)
    hits = np.isfinite(capped).sum(axis=0)
    own = np.array([np.nanmean(column) for column in capped.T[hits > 2 * HITS]])
    chance = np.nanvar(capped) * np.mean(1.0 / hits[hits > 2 * HITS])
    of_beams = float(np.sqrt(max(0.0, own.var() - chance)))
    noise = 1.4826 * float(np.nanmedian(np.abs(off)))
    said = np.concatenate([b.intensity for b in returns])
    white = float(np.sqrt(max(0.0, noise**2 - of_beams**2)))
    return Law(law.scale * law.gain(at), law.exponent, white, of_beams, float(said.min()), float(said.max()))


def _differences(
    off: np.ndarray, scans: list[Beams], poses: np.ndarray, part: range, law: IntensityCalibration
) -> None:
    """Fills in how light of the returns of scans `part` differs from the mean of its place, law apart."""
    points = np.concatenate([se2.act(poses[k], scans[k].s) for k in part])
    who = np.concatenate([np.full(len(scans[k].r), k) for k in part])
    b = [scans[k] for k in part]
    names = ("r", "c", "intensity", "support", "beam")
    r, c, light, support, beam = (np.concatenate([getattr(x, name) for x in b]) for name in names)
    y = np.log(np.maximum(light, 1.0) / (law.gain(r) * law.incidence(np.maximum(c, 0.15))))
    _, cell = np.unique(np.floor(points / 0.1).astype(int), axis=0, return_inverse=True)
    cell = cell.ravel()
    used = (support >= 3) & (np.bincount(cell)[cell] >= HITS)
    off[who[used], beam[used]] = (y - (np.bincount(cell, y) / np.bincount(cell))[cell])[used]


def main() -> None:
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "light"
    print("| law | log | " + " | ".join(f"{r:g} m" for r in FITTED) + " | exponent | noise | beams | least | most |")
    print("|---" * (len(FITTED) + 7) + "|")
    for name, files in LOGS.items():
        laws = []
        for file in files:
            laws.append(fit(folder / file))
            print(row(name, file, laws[-1]), flush=True)
        print(row(name, "all", of_all(laws)), flush=True)


def of_all(laws: list[Law]) -> Law:
    """The law of a scanner with several logs."""
    light, *middle = (np.median(column, axis=0) for column in list(zip(*laws, strict=True))[:4])
    return Law(light, *map(float, middle), min(law.least for law in laws), max(law.most for law in laws))


def row(name: str, of: str, law: Law) -> str:
    light = " | ".join(f"{float(f'{x:.2g}'):.0f}" for x in law.light)
    rest = f"{law.exponent:.2f} | {law.relative_noise:.3f} | {law.beams:.3f} | {law.least:.0f} | {law.most:.0f}"
    return f"| {name} | {of} | {light} | {rest} |"


if __name__ == "__main__":
    main()
