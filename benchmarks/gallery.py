"""Pictures of every kind of result, made by commands anybody can repeat, and the page that shows them.

    python benchmarks/gallery.py [--only NAME]... [--page]

Every command runs in one folder, in order; the pictures go to `docs/images/gallery/`, and those of other pages to
`docs/images/`, made light. `--page` writes the page `docs/gallery.md` alone. MAPWEAVE_DATA is the folder with
`mrclam/`; without it the picture of real bearings stays as it is.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

TOP = Path(__file__).resolve().parents[1]
PAGE, PICTURES = TOP / "docs" / "gallery.md", TOP / "docs" / "images" / "gallery"
WIDEST, COLOURS = 900, 256  # [pixels], of the palette
SET_6 = Path(os.environ.get("MAPWEAVE_DATA", "")).resolve() / "mrclam" / "MRCLAM_Dataset6.zip"

CORNERS = "--anchor 1=0.822,-1.381 --anchor 36=50.775,52.563"  # where two robots of seed 0 stand


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture: the file that the commands write, and the commands since the picture before.

    title: in the gallery, or the page that shows it.
    """

    name: str
    title: str
    caption: str
    file: str
    commands: tuple[str, ...]

    @property
    def image(self) -> Path:
        return (PICTURES if self.caption else PICTURES.parent) / f"{self.name}.png"


GALLERY = (
    Picture(
        "landmarks",
        "One map of four robots",
        "Landmarks with 95 % ellipses, and the trajectories of four robots that started in unknown places.",
        "team-map/figures/fused_map.png",
        (
            "mapweave simulate landmarks --out team --robots 4 --landmarks 30 --seed 3",
            "mapweave map team --out team-map --truth team",
        ),
    ),
    Picture(
        "uncertainty",
        "What fusing gains",
        "The standard deviation of every landmark in each robot's own map, and in the fused map.",
        "team-map/figures/uncertainty.png",
        (),
    ),
    Picture(
        "woven",
        "Two laser robots in one map",
        "Two drives through one office, each mapped as a pose graph, and merged where scans agree.",
        "woven/figures/component1_map.png",
        (
            "mapweave simulate office --out a.mcap --seed 3 --visited 3",
            "mapweave simulate office --out b.mcap --seed 3 --visited 6",
            "mapweave map a.mcap b.mcap --out woven",
        ),
    ),
    Picture(
        "graph",
        "A pose graph",
        "The pose graph of that map, solved again: `solve` draws this of any g2o file.",
        "graph/figures/graph.png",
        ("mapweave solve woven/pose_graph.g2o --out graph",),
    ),
    Picture(
        "mixed",
        "A mixed team",
        "Lasers, cameras and sightings of each other: walls, landmarks and trajectories in one frame.",
        "mixed-map/figures/map.png",
        (
            "mapweave simulate team --out mixed --minutes 3 --seed 2",
            "mapweave map mixed --out mixed-map",
        ),
    ),
    Picture(
        "swarm",
        "A swarm in space",
        "64 robots located from the bearings at which they see each other, with 95 % regions.",
        "swarm-map/figures/network.png",
        (
            "mapweave simulate swarm --out swarm.csv --dim 3 --robots 64 --seed 1",
            "mapweave locate swarm.csv --out swarm-map --dim 3 --sigma 1deg",
        ),
    ),
    Picture(
        "exploration",
        "Robots that decide where to drive",
        "Two robots that know nothing but the border of the field: their trajectories, and the landmarks they mapped.",
        "exploration/figures/map.png",
        ("mapweave explore yuan --planner loop --until landmarks --seed 1 --out exploration",),
    ),
    Picture(
        "explored",
        "When ground was first seen",
        "The same run: the step at which every place was seen for the first time.",
        "exploration/figures/explored.png",
        (),
    ),
)

OTHERS = (  # of other pages, which print the commands where they are told
    Picture("demo", "docs/getting-started.md", "", "mapweave-demo/figures/fused_map.png", ("mapweave demo",)),
    Picture(
        "locate-network",
        "docs/locate.md",
        "",
        "bearings/figures/network.png",
        (
            "mapweave simulate swarm --out swarm.csv --robots 36 --sigma 0.5deg",
            f"mapweave locate swarm.csv --out bearings --truth swarm.truth.csv {CORNERS}",
        ),
    ),
    Picture(
        "locate-shape",
        "docs/locate.md",
        "",
        "shape/figures/shape.png",
        (
            "mapweave simulate swarm --out shape.csv --robots 9 --seed 1",
            "mapweave locate shape.csv --out shape --truth shape.truth.csv",
        ),
    ),
    Picture(
        "locate-tracks",
        "docs/locate.md",
        "",
        "driven/figures/tracks.png",
        (f"mapweave locate {SET_6} --out driven --sigma 0.6deg --truth {SET_6}",),
    ),
    Picture(
        "explore-office",
        "docs/methods/active-exploration.md",
        "",
        "office/figures/map.png",
        ("mapweave explore office-1000 --robots 4 --out office",),
    ),
)


def page() -> str:
    """The page as it stands in the documentation."""
    out = [
        "# Gallery",
        "",
        "Every picture is a file that the commands under it write; `python benchmarks/gallery.py` makes them all anew.",
        "Each result also holds a `report.html` with all figures and numbers and, where there is a map, an interactive",
        "one.",
    ]
    for picture in GALLERY:
        where = picture.image.relative_to(PAGE.parent).as_posix()
        out += ["", f"## {picture.title}", "", f"![{picture.title}]({where})", "", picture.caption, ""]
        if picture.commands:
            out += ["```", *picture.commands, "```", "", f"`{picture.file}`"]
        else:
            out += [f"Of the same result: `{picture.file}`"]
    return "\n".join(out) + "\n"


def lighten(source: Path, target: Path) -> None:
    """The picture, at most `WIDEST` pixels wide, with a palette of its own."""
    with Image.open(source) as image:
        full = image.convert("RGB")
    if full.width > WIDEST:
        full = full.resize((WIDEST, round(full.height * WIDEST / full.width)), Image.Resampling.LANCZOS)
    target.parent.mkdir(parents=True, exist_ok=True)
    full.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(target, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=[p.name for p in (*GALLERY, *OTHERS)], metavar="NAME")
    parser.add_argument("--page", action="store_true")
    asked = parser.parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    if asked.page:
        return
    env = {**os.environ, "PYTHONPATH": str(TOP / "src")}
    with tempfile.TemporaryDirectory() as folder:
        for picture in (*GALLERY, *OTHERS):
            if (asked.only and picture.name not in asked.only) or (
                picture.name == "locate-tracks" and not SET_6.exists()
            ):
                continue
            for command in picture.commands:
                words = [sys.executable, "-m", *shlex.split(command)]
                subprocess.run(words, cwd=folder, env=env, check=True)
            lighten(Path(folder) / picture.file, picture.image)
            print(f"{picture.image.relative_to(TOP)}: {picture.image.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
