"""The first picture of README and documentation: the maps of three robots in one real building come together.

    python benchmarks/together.py [--result DIR]

The log of the Intel Research Lab is cut into three by time, and each part is the log of a robot that knows nothing of
the others: `mapweave map` maps all three with their starts unknown. First each map stands where it was drawn apart
from the others, then every one moves to its place in the common map, which ends the film. It is written to
`docs/images/together.gif`. MAPWEAVE_DATA is the folder with `carmen/`; DIR is kept, and used when it is there already.
"""

import argparse
import gzip
import os
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import mapweave
from mapweave.core import se2
from mapweave.laser.laser_map import GridMap
from mapweave.report.style import PALETTE

TOP = Path(__file__).resolve().parents[1]
FILM = TOP / "docs" / "images" / "together.gif"
ROBOTS = 3
SIDE, TURNED = 46.0, (0.5, -0.6, 0.8)  # [m] from map to map at first, [rad] by which each is turned then
STEPS, PASSES = 20, 3  # pictures on the way; how often the film is shown, which then stands still
WAIT, STEP, END = 1500, 70, 4000  # [ms] that the first, each, and the last picture stand
SIZE, DOTS, COLOURS = (9.0, 4.8), 100, 24  # [inch], dots an inch, of the film's palette
FAR, NEAR = 72.0, 38.0  # [m] half of the width that is seen at first and at last


def cut(log: Path, folder: Path) -> list[Path]:
    """`ROBOTS` logs with as many scans each, one after the other in time."""
    with gzip.open(log, "rt", encoding="ascii") as lines:
        rows = sorted((row.split() for row in lines if row.startswith(("FLASER", "ODOM"))), key=stamp)
    ends = np.quantile([stamp(row) for row in rows if row[0] == "FLASER"], np.linspace(0, 1, ROBOTS + 1)[1:-1])
    part = np.searchsorted(ends, [stamp(row) for row in rows])
    paths = [folder / f"robot{k + 1}.clf" for k in range(ROBOTS)]
    for k, path in enumerate(paths):
        own = [" ".join(row) for row, of in zip(rows, part, strict=True) if of == k]
        path.write_text("\n".join(own) + "\n", encoding="ascii")
    return paths


def stamp(row: list[str]) -> float:
    return float(row[-3])


def walls(grid: GridMap) -> np.ndarray:
    """(n, 2) [m] the middles of a grid's wall cells."""
    rows, columns = np.nonzero(grid.to_numpy() == 100)
    return grid.origin + grid.resolution * (np.column_stack([columns, rows]) + 0.5)


def picture(result: mapweave.LaserResult, share: float) -> Image.Image:
    """Every robot's own map, `share` of the way to its place; at the end the common map under all trajectories."""
    woven = result.components[0]
    drawing = Figure(figsize=SIZE, dpi=DOTS)
    canvas = FigureCanvasAgg(drawing)
    ax = drawing.add_axes((0.0, 0.0, 1.0, 1.0))
    middle = np.mean(walls(woven.grid), axis=0)
    for k, made in enumerate(result.maps):
        way, at = woven.tracks[made.robot].pose[:, :2], walls(woven.grid)
        if share < 1:
            place = se2.compose(woven.tracks[made.robot].pose[0], se2.inverse(made.track.pose[0]))
            way, at = (se2.act(place, points) for points in (made.track.pose[:, :2], walls(made.grid)))
            own = np.mean(at, axis=0)  # a map turns about its middle
            x = middle[0] + SIDE * (k - (ROBOTS - 1) / 2)
            lies = np.array([*(1 - share) * (np.array([x, middle[1]]) - own), (1 - share) * TURNED[k]])
            way, at = (own + se2.act(lies, points - own) for points in (way, at))
        ax.plot(*at.T, ".", color="black" if share == 1 else PALETTE[k], markersize=2.0, markeredgewidth=0)
        ax.plot(*way.T, "-", color=PALETTE[k], lw=0.8, alpha=0.8)
    half = np.array([1.0, SIZE[1] / SIZE[0]]) * (FAR + share * (NEAR - FAR))
    low, high = middle - half, middle + half
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ax.axis("off")
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--result", type=Path)
    asked = parser.parse_args()
    log = Path(os.environ["MAPWEAVE_DATA"]) / "carmen" / "intel.clf.gz"
    with tempfile.TemporaryDirectory() as folder:
        kept = asked.result or Path(folder) / "result"
        if not kept.is_dir():
            mapweave.map(cut(log, Path(folder)), kept)
        result = mapweave.load(kept, mapweave.LaserResult)
    if len(result.components) > 1:
        parser.error("the three maps did not become one")
    shares = (1 - np.cos(np.linspace(0, np.pi, STEPS + 1))) / 2
    shares[-1] = 1.0
    pictures = [picture(result, share).quantize(COLOURS, dither=Image.Dither.NONE) for share in shares]
    lasts = [WAIT] + [STEP] * (STEPS - 1) + [END]
    pictures[0].save(FILM, save_all=True, append_images=pictures[1:], duration=lasts, loop=PASSES - 1, optimize=True)
    print(f"{FILM.relative_to(TOP)}: {FILM.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
