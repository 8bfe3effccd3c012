"""One HTML file that needs nothing beside it: figures inside, light and dark, printable.

It ends in a list of the files that stand there all the same, to open or save, and what each holds.
"""

import base64
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from itertools import zip_longest
from pathlib import Path
from urllib.parse import quote

from PIL import Image

from ..core.findings import Finding, verdict, verdict_line
from ..core.version import __version__
from ..io.directory import read_json, result_file
from .elements import NOTHING, Html, joined, tag
from .scene import Scene, script

ALIKE = 1000.0  # numbers of a column that differ by less have the same number of decimals
LONGEST_NUMBER = 24  # letters of a cell, beyond which it is a sentence
HOLDS = {
    "calibration.csv": "gain of intensity over range, found from the log",
    "calibration.json": "what was found of every robot: speed, turns, lag, bearing bias, range scale",
    "claims.md": "the paper's claims, each with what became of it here",
    "closures.csv": "every loop closure tried, with the reason why it was believed or refused",
    "components": "maps that nothing ties to this one",
    "decisions.toml": "what was decided on pairs of robots and on places, to be edited and given again",
    "dropped.csv": "rows that were left out, and why",
    "figures": "every figure as PNG",
    "fixes.csv": "a row for each position fix: how far off it is, and whether it was used",
    "gone.pgm": "walls of the map before that are gone",
    "gone.yaml": "resolution and origin of gone.pgm",
    "grid.npz": "the occupancy grid as arrays",
    "intensity.png": "light that the walls send back",
    "landmarks.csv": "landmarks with their covariances, a row each",
    "landmarks.npz": "landmarks with their joint covariance",
    "local": "each robot's own map",
    "graph.pyfg": "places found and ranges used, as PyFactorGraph reads it",
    "log": "the recordings, which map reads again",
    "map.pgm": "occupancy, as ROS navigation reads it",
    "map.tif": "occupancy where it lies on earth, as GeoTIFF",
    "map.yaml": "resolution and origin of map.pgm",
    "metrics.json": "all that the page says, for programs",
    "new.pgm": "walls of the map after that are new",
    "new.yaml": "resolution and origin of new.pgm",
    "network.npz": "who sighted whom, and the joint information matrix",
    "pose_graph.g2o": "poses and edges, for GTSAM, g2o and others",
    "positions.csv": "where each robot is, with covariances",
    "ranges.csv": "a row for each range: its residual, and whether it was used",
    "recording": "the simulated recordings, which map reads again",
    "result.npz": "the result itself, which mapweave.load gives back",
    "result.mcap": "map, paths and landmarks, for RViz and Foxglove",
    "robot_graph.npz": "keyframes with their returns, steps and closures",
    "runs.csv": "a row for each run, with its scores",
    "scans.csv": "a row for each scan: pose, innovation, decision",
    "state": "what --resume needs to go on",
    "tables": "the tables of this page in Markdown",
    "trajectories.geojson": "where each robot went on earth: longitude and latitude",
    "trajectories": "where each robot went: TUM or CSV, covariances beside",
    "world": "where each robot went in the world that fixes are told in, covariances beside",
}
_OPEN = "<details open>"  # of a figure
_NUMBER = re.compile(r"[-+−±]?\.?\d")
# On a dark screen paper becomes dark and ink light, and colours stay what they are: the grey of a pixel is turned where
# it is near white or black, its difference to that grey is kept.
_DARK = (
    '<svg width="0" height="0" aria-hidden="true" style="position:absolute"><filter id="dark" '
    'color-interpolation-filters="sRGB"><feColorMatrix values=".2126 .7152 .0722 0 0 .2126 .7152 .0722 0 0 .2126 .7152 '
    '.0722 0 0 0 0 0 1 0" result="grey"/><feComposite operator="arithmetic" in="SourceGraphic" in2="grey" k2=".5" '
    'k3="-.5" k4=".5" result="rest"/><feComponentTransfer in="grey" result="turned">{}</feComponentTransfer>'
    '<feComposite operator="arithmetic" in="rest" in2="turned" k2="2" k3="1" k4="-1"/></filter></svg>'
).format("".join(f'<feFunc{c} type="table" tableValues=".92 .8 .6 .4 .4 .42 .62 .55 .27 .16 .09"/>' for c in "RGB"))


@dataclass(slots=True)
class Page:
    """A report being written, top to bottom; `html()` is the finished page."""

    title: str
    lead: str = ""
    parts: list[Html] = field(default_factory=list)
    scenes: int = 0

    def section(self, title: str) -> None:
        self.parts.append(tag("h2", title))

    def text(self, text: str, *, warn: bool = False) -> None:
        self.parts.append(tag("p", "⚠ ", text, class_="warn") if warn else tag("p", text))

    def verdict(self, findings: Sequence[Finding]) -> None:
        """What the findings make of the result, and which."""
        self.text(sentence_case(verdict_line(findings)) + ".", warn=verdict(findings) != "good")

    def cards(self, values: Sequence[tuple[str, str]], warnings: int = 0) -> None:
        """Headline figures as (what, value with unit); the last leads to the `warnings`, where there are any."""
        inner = [tag("div", tag("b", v), k, class_="card") for k, v in values]
        if warnings:
            some = "warnings" if warnings > 1 else "warning"
            inner.append(tag("a", tag("b", f"⚠ {warnings}"), some, ", below the map", class_="card", href="#warnings"))
        self.parts.append(tag("div", *inner, class_="cards"))

    def warnings(self, texts: Sequence[str]) -> None:
        """What was repaired, left out or is in doubt, an item each."""
        if texts:
            self.parts.append(tag("ul", *(tag("li", text) for text in texts), class_="warn", id="warnings"))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]], colours: Sequence[str] = ()) -> None:
        """Numbers stand right, columns of words left; colours: of what each row is about, where figures show it."""
        digits = [_decimals(column) for column in zip_longest(*rows)]
        cells = [[_shown(value, d) for value, d in zip(row, digits, strict=False)] for row in rows]
        kinds = [_kind(column) for column in zip_longest(*cells, fillvalue="")]
        marks = [tag("i", style=f"background:{colour}") for colour in colours] or [NOTHING] * len(cells)
        for row, mark in zip(cells, marks, strict=True):
            row[0] = joined(mark, row[0])
        top = tag("thead", _row("th", head, kinds))
        self.parts.append(_table(top, *(_row("td", row, kinds) for row in cells)))

    def figure(self, png: Path, caption: str, draw: Callable[..., object] | None = None, *what: object) -> None:
        """A PNG or GIF, inside the page; on a narrow screen it keeps a size at which it can be read, and moves aside.

        draw, what: who draws it first, and of what.
        On a page with a map to move about in it is folded away until asked for.
        """
        if draw is not None:
            draw(png, *what)
        shown = tag("figure", _picture(png, caption))
        self.parts.append(Html(f"{_OPEN}{tag('summary', caption)}{shown}</details>"))

    @contextmanager
    def folded(self, title: str, *, shut: bool) -> Iterator[None]:
        """What is written meanwhile stands under `title`, and where `shut` is seen once that is clicked."""
        self.parts.append(Html(f"<details{'' if shut else ' open class=part'}>{tag('summary', title)}"))
        yield
        self.parts.append(Html("</details>"))

    def scene(self, scene: Scene, caption: str, png: Path | None = None, *beside: Scene) -> None:
        """A map to move about in; its picture, drawn to `png`, shows where no script runs. Nothing of an empty scene.

        beside: what the picture shows too.
        """
        if png is not None:
            scene.draw(png, *beside)
        still = NOTHING if png is None else _picture(png, caption)
        if not scene.empty:
            self.scenes += 1
            self.parts.append(scene.html(caption, still))

    def put_into(self, html: str, name: str, *, top: bool = False) -> str:
        """`html`, a finished page, with this one in it, in place of the one put there by that name before.

        It is the last part before the files; with `top` it follows the page's first sentence. Scenes are left out: the
        other page may not hold what moves them.
        """
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        before, _, rest = html.partition(begin)
        after = rest.partition(end)[2] if rest else ""
        page = before + after
        if top:
            lead = re.search(r'<p class="lead">.*?</p>', page, re.DOTALL)
            at = lead.end() if lead else len(page)
        else:
            ends = (page.rfind(mark) for mark in ("<!-- files: begin -->", "<footer>"))
            at = next((place for place in ends if place >= 0), len(page))
        body = "".join(self.parts)
        if '<figure class="scene">' in page:
            body = body.replace(_OPEN, "<details>")
        return f"{page[:at]}{begin}{body}{end}{page[at:]}"

    def html(self, code: str = "") -> str:
        """The page, with a script of its own where it has one."""
        code = script() if self.scenes and not code else code
        moving = f"<script>{code}</script>" if code else ""
        body = "".join(self.parts)
        if self.scenes:
            body = body.replace(_OPEN, "<details>")
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"{tag('title', self.title)}<style>{_style()}</style></head><body>{_DARK}<main>{tag('h1', self.title)}"
            f"{tag('p', self.lead, class_='lead')}{body}"
            f"{tag('footer', 'mapweave ', __version__)}</main>{moving}</body></html>\n"
        )

    def write(self, path: Path) -> None:
        path.write_text(self.html(), encoding="utf-8", errors="backslashreplace")


@cache
def _style() -> str:
    return "\n" + (files(__package__) / "page.css").read_text(encoding="utf-8")


def told_list(words: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def sentence_case(text: str) -> str:
    """`text` with its first letter large, all others as they are."""
    return text[:1].upper() + text[1:]


def _picture(png: Path, caption: str) -> Html:
    with Image.open(png) as image:
        wide, high = image.size
    shown = tag("img", alt=caption, width=wide, height=high, style=f"--wide:{wide}px", src=_inside(png))
    return tag("div", shown, class_="wide", tabindex=0)


def _row(cell: str, texts: Sequence[str], kinds: Sequence[str]) -> Html:
    """A row of cells, each of the class of its column."""
    each = zip_longest(texts, kinds[: len(texts)], fillvalue="")
    return tag("tr", *(tag(cell, text, **({"class_": kind} if kind else {})) for text, kind in each))


def _table(head: Html, *rows: Html) -> Html:
    """A table, which the keyboard too moves aside where it is wider than the page."""
    return tag("table", head, tag("tbody", *rows), tabindex=0)


def _inside(image: Path) -> str:
    """A PNG or GIF as an address that holds it whole."""
    return f"data:image/{image.suffix[1:]};base64,{base64.b64encode(image.read_bytes()).decode('ascii')}"


def _decimals(column: Sequence[object]) -> int | None:
    """How many decimals give the largest number of a column four digits; None where that hides the smallest."""
    sizes = [abs(value) for value in column if isinstance(value, float) and value and math.isfinite(value)]
    if len(sizes) < 2 or max(sizes) >= ALIKE * min(sizes) or max(sizes) >= 1e4:
        return None
    return max(0, 3 - math.floor(math.log10(max(sizes))))


def _shown(value: object, decimals: int | None = None) -> str:
    if not isinstance(value, float):
        return "–" if value is None else str(value)
    return f"{value:.4g}" if decimals is None else f"{value:.{decimals}f}"


def _kind(column: Sequence[str]) -> str:
    """The class of a column: of sentences, of words, or none of numbers."""
    if any(len(text) > LONGEST_NUMBER for text in column):
        return "text"
    filled = [text for text in column if text not in {"", "–"}]
    return "word" if filled and not any(_NUMBER.match(text) for text in filled) else ""


def _unused(page: Page, metrics: Path) -> None:
    """What the logs held and no reader took, where there is such a thing."""
    rows = read_json(metrics).get("unused", []) if metrics.is_file() else []
    if rows:
        page.section("In the logs, and not used")
        names = [[Path(row["source"]).name, row["topic"], row["type"], row["messages"], row["reason"]] for row in rows]
        page.table(["log", "topic", "type", "messages", "why"], names)


def list_files(folder: Path) -> None:
    """`report.html` in `folder` ends in tables of what the logs held and nobody used, and of the other files there.

    They stand in place of those put before.
    """
    report = folder / "report.html"
    if not report.is_file():
        return
    page = Page("")
    _unused(page, folder / "metrics.json")
    page.section("Files")
    rows = []
    for path in sorted(p for p in folder.iterdir() if p != report):
        name = f"{path.name}/" if path.is_dir() else path.name
        rows.append(_row("td", [tag("a", name, href=quote(name)), HOLDS.get(path.name, "")], ["", "text"]))
    page.parts.append(_table(NOTHING, *rows))
    text = page.put_into(report.read_text(encoding="utf-8", errors="replace"), "files")
    with result_file(report) as work:
        work.write_text(text, encoding="utf-8", errors="backslashreplace")
