"""The page's map: what it holds is what was given, and it lives in a browser without a network or an error."""

import base64
import json
import re
from io import BytesIO

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from PIL import Image

from mapweave.core.findings import Finding
from mapweave.core.records import Track
from mapweave.report.html import Page, list_files
from mapweave.report.scene import KINDS, MOST_CELLS, MOST_POSES, Scene
from mapweave.report.style import PALETTE
from mapweave.report.team_figures import thinned

from .browser import CHROMIUM, found_by_axe, seen_in_browser

WATCH = """<script>
window.errors = [];
window.addEventListener("error", (event) => window.errors.push(event.message));
const drawn = (tries) => {
  const canvas = document.querySelector(".scene canvas");
  const first = canvas.getContext("2d").getImageData(0, 0, canvas.width || 1, canvas.height || 1).data;
  const before = first.filter((v, i) => i % 4 === 3 && v > 0).length;
  if (before === 0 && tries > 0) return setTimeout(() => drawn(tries - 1), 50);
  const names = [], draws = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    if (/^(a.|7)$/.test(text)) names.push([x, y, this.measureText(text).width]);
    draws.call(this, text, x, y);
  };
  canvas.focus();
  canvas.dispatchEvent(new KeyboardEvent("keydown", {key: "+"}));
  const box = canvas.getBoundingClientRect();
  for (let x = 0; x < box.width; x += 6) for (let y = 0; y < box.height; y += 6)
    if (!document.querySelector(".tip").textContent.includes("landmark"))
      canvas.dispatchEvent(new PointerEvent("pointermove", {clientX: box.left + x, clientY: box.top + y}));
  document.querySelectorAll(".bar input[type=checkbox]").forEach((box) => box.click());
  document.querySelectorAll(".bar input[type=checkbox]").forEach((box) => box.click());
  const pixels = () => {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    copy.getContext("2d").drawImage(canvas, 0, 0);
    return copy.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  };
  const shade = (name) => rgb(css(name)), kinds = ["--free", "--wall"].map((name) => String(shade(name)));
  const opaque = () => {
    const all = pixels();
    let count = 0;
    for (let i = 0; i < all.length; i += 4) count += kinds.includes(`${all[i]},${all[i + 1]},${all[i + 2]}`);
    return count;
  };
  const bright = () => pixels().filter((v, i, all) => i % 4 === 0 && all[i + 3] === 255 && v === all[i + 1])
    .reduce((mean, v, i) => mean + (v - mean) / (i + 1), 0);
  names.length = 0;
  document.querySelector(".bar button[title^='all of it']").click();
  const written = names.slice(), whole = opaque();
  const slider = document.querySelector(".bar input[type=range]");
  const landmarks = () => {
    names.length = 0;
    slider.dispatchEvent(new Event("input"));
    return names.length - written.length;
  };
  slider.value = 800;
  const later = landmarks();
  slider.value = 500;
  const fewer = landmarks();
  const screen = bright();
  window.dispatchEvent(new Event("beforeprint"));
  const printed = {bright: bright(), shape: canvas.width / canvas.height - canvas.clientWidth / canvas.clientHeight};
  window.dispatchEvent(new Event("afterprint"));
  printed.after = bright() - screen;
  const tip = document.querySelector(".tip").textContent;
  const where = document.querySelector(".where"), click = (x, y) => {
    for (const kind of ["pointerdown", "pointerup"])
      canvas.dispatchEvent(new PointerEvent(kind, {clientX: box.left + x, clientY: box.top + y, pointerId: 1}));
  };
  canvas.setPointerCapture = () => {};
  canvas.dispatchEvent(new PointerEvent("pointermove", {clientX: box.left + 90, clientY: box.top + 90}));
  const place = where.textContent;
  canvas.dispatchEvent(new KeyboardEvent("keydown", {key: "m"}));
  click(100, 100);
  click(200, 100);
  const length = where.textContent;
  canvas.dispatchEvent(new KeyboardEvent("keydown", {key: "Escape"}));
  document.querySelectorAll("details").forEach((one) => (one.open = true));
  const told = {
    place: place, length: length, kinds: ["--free", "--wall", "--unseen"].map((name) => shade(name)[0]),
    margin: window.innerWidth - canvas.offsetWidth,
    errors: window.errors, ink: before, printed: printed,
    marks: document.querySelectorAll(".bar label svg").length,
    whole: whole, half: opaque(), written: written.length, fewer: [later, fewer],
    apart: written.every(([x, y], i) => written.every(([u, v, w], k) => k === i || Math.abs(v - y) > 9 || x > u + w
      || u > x)),
    tip: tip,
    wide: document.documentElement.scrollWidth - window.innerWidth,
    time: document.querySelector(".bar output").textContent,
    layers: [...document.querySelectorAll(".bar label")].map((label) => label.textContent),
    still: document.querySelectorAll(".still").length,
    figure: document.querySelector("figure img").offsetWidth, column: document.querySelector(".wide").clientWidth,
  };
  const view = document.querySelector(".scene .view"), ink = opaque();
  view.style.display = "none";
  setTimeout(() => {
    view.style.display = "";
    setTimeout(() => {
      told.back = opaque() - ink;
      document.documentElement.dataset.seen = JSON.stringify(told);
    }, 200);
  }, 200);
};
window.addEventListener("load", () => setTimeout(() => drawn(50), 300));
</script>"""


def team() -> Scene:
    scene = Scene("a hall")
    known = np.zeros((40, 60), bool)
    known[5:35, 5:55] = True
    occupied = np.zeros_like(known)
    occupied[5, 5:55] = True
    since = np.tile(np.linspace(100.0, 140.0, 60), (40, 1))
    scene.grid("walls", known, occupied, (-1.0, 5.0, -1.0, 3.0), np.where(known, since, np.nan))
    t = np.linspace(100.0, 140.0, 50)
    pose = np.column_stack([np.linspace(0, 4, 50), np.sin(t / 5), np.zeros(50)])
    scene.track("robot 1", "robot <1>", Track(t, pose, np.tile(0.01 * np.eye(3), (50, 1, 1))), "#0072B2")
    at = np.array([[1.0, 2.0], [3.0, 0.5]])
    scene.points(
        "landmarks", ["7", "</script>"], at, "#888888", ["landmark 7", "landmark x"], np.tile(np.eye(2), (2, 1, 1)),
        since=[130.0, None],
    )  # fmt: skip
    scene.points("anchors", [f"a{k}" for k in range(9)], np.tile([[2.0, 1.0]], (9, 1)), "#000000", shape="triangle")
    scene.path("truth", np.array([[0.0, 0.0], [4.0, 0.0]]), "#000000")
    scene.lines("closures", np.array([[0.0, 0.0, 1.0, 2.0]]), "#009E73", ["accepted"])
    return scene


def data(scene: Scene) -> dict:
    page = Page("Hall")
    page.scene(scene, "a hall")
    found = re.search(r'<script type="application/json">(.*?)</script>', page.html(), re.DOTALL)
    return json.loads(found[1])


def test_the_page_holds_what_was_given():
    held = data(team())
    assert held["points"][0]["names"] == ["7", "</script>"]
    assert held["tracks"][0]["t"][0] == 100.0
    assert held["extent"] == [-1.0, 5.0, -1.0, 3.0]
    half, other, _ = held["points"][0]["ellipses"][0]
    assert half == other == pytest.approx(np.sqrt(5.991), abs=1e-3)


def test_long_trajectories_are_thinned_and_keep_their_ends():
    n = 20 * MOST_POSES
    pose = np.column_stack([np.arange(n), np.zeros(n), np.zeros(n)]).astype(float)
    scene = Scene("long")
    scene.track("robot 1", "robot 1", Track(np.arange(float(n)), pose), "#000")
    x = data(scene)["tracks"][0]["x"]
    assert len(x) <= MOST_POSES
    assert (x[0], x[-1]) == (0.0, n - 1.0)


def test_a_page_of_many_robots_many_hours_and_many_places_stays_small_and_says_so():
    n, robots, places = 5000, 200, 50_000
    track = Track(np.arange(float(n)), np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
    ends = np.linspace(0.0, 1.0, 4 * places).reshape(-1, 4)
    scene = Scene("long")
    for k in range(robots):
        scene.track("robots", f"robot {k}", track, "#000")
    scene.lines("places believed", ends, "#000", [f"robot {k}, and so on" for k in range(places)])
    page = scene.html("A year.")
    assert len(page) < 10e6
    assert "Shown: 40,000 of 1,000,000 poses, 40,000 of 50,000 places believed." in page
    held = data(scene)
    assert {(t["t"][0], t["t"][-1], len(t["t"]), len(t["ellipses"])) for t in held["tracks"]} == {(0, n - 1, 200, 200)}
    (line,) = held["lines"]
    assert len(line["segments"]) == len(line["texts"]) == 40_000
    assert line["texts"][-1] == f"robot {places - 1}, and so on"
    assert "Shown" not in team().html("Two robots.")


def test_no_line_goes_through_a_time_of_which_nothing_is_known():
    t = np.concatenate([np.arange(0.0, 1000.0, 0.5), np.arange(1400.0, 1402.0, 0.5)])
    pose = np.column_stack([t, np.zeros_like(t), np.zeros_like(t)])
    track = Track(t, pose)
    scene = Scene("two stretches")
    scene.track("robot 1", "robot 1", track, "#000")
    scene.track("robot 2", "robot 2", Track(t[:50], pose[:50]), "#000")
    broken, whole = data(scene)["tracks"]
    assert [(broken["x"][k - 1] < 1000.0, broken["x"][k] >= 1400.0) for k in broken["gaps"]] == [(True, True)]
    assert whole["gaps"] == []
    drawn = thinned(track, most=300)[:, 0]
    (at,) = np.flatnonzero(np.isnan(drawn))
    assert drawn[at - 1] < 1000.0
    assert drawn[at + 1] >= 1400.0
    assert not np.isnan(thinned(Track(t[:50], pose[:50]))).any()


def test_a_wall_one_cell_thick_is_kept_in_a_large_grid():
    known = np.ones((3 * MOST_CELLS, 30), bool)
    occupied = np.zeros_like(known)
    occupied[4001] = True
    scene = Scene("large")
    scene.grid("walls", known, occupied, (0.0, 1.0, 0.0, 100.0))
    png = base64.b64decode(data(scene)["grid"]["png"].split(",")[1])
    image = np.asarray(Image.open(BytesIO(png)).convert("L"))
    assert max(image.shape) <= MOST_CELLS
    assert (image[::-1][4001 // 3] == KINDS[2]).all()


def test_what_is_unknown_free_and_wall_is_told_exactly():
    known = np.zeros((300, 400), bool)
    known[100:] = True
    occupied = np.zeros_like(known)
    occupied[150:153] = True
    scene = Scene("exact")
    scene.grid("walls", known, occupied, (0.0, 4.0, 0.0, 3.0))
    png = base64.b64decode(data(scene)["grid"]["png"].split(",")[1])
    pixels = np.asarray(Image.open(BytesIO(png)).convert("L"))[::-1]
    for where, grey in zip((~known, known & ~occupied, occupied), KINDS, strict=True):
        assert (pixels[where] == grey).all()


def test_nothing_that_is_not_finite_reaches_the_page():
    scene = Scene("odd")
    scene.points("places", ["a"], np.array([[np.nan, np.inf]]), "#000", ["a"])
    assert data(scene)["points"][0]["x"] == [0.0]


def test_what_is_hidden_at_first_does_not_shrink_the_rest():
    scene = Scene("a hall and where wheels alone would be", hidden=["odometry"])
    scene.path("robot 1", np.array([[0.0, 0.0], [4.0, 2.0]]), "#000")
    scene.path("odometry", np.array([[0.0, 0.0], [90.0, -70.0]]), "#000")
    assert data(scene)["extent"] == [0.0, 4.0, 0.0, 2.0]
    scene.hidden.append("robot 1")
    assert data(scene)["extent"] == [0.0, 90.0, -70.0, 2.0]


def test_figures_fold_beside_a_map_and_stand_open_where_there_is_none(tmp_path):
    Image.new("L", (9, 9)).save(tmp_path / "f.png")
    for with_map in (False, True):
        page, score = Page("Hall"), Page("")
        if with_map:
            page.scene(team(), "a hall")
        page.figure(tmp_path / "f.png", "a figure")
        score.figure(tmp_path / "f.png", "its score")
        html = score.put_into(page.html(), "score")
        assert re.findall(r"<details( open)?><summary>", html) == 2 * ["" if with_map else " open"]


@pytest.mark.parametrize(("sd", "share"), [(0.3, 1.0), (30.0, 0.0)])
def test_a_picture_shows_ellipses_whole_and_does_not_grow_for_huge_ones(sd, share):
    scene, at = Scene("a map"), np.array([[0.0, 0.0], [10.0, 0.0], [5.0, 8.0]])
    scene.points("landmarks", ["1", "2", "3"], at, "#808080", ["", "", ""], np.tile(np.eye(2) * sd**2, (3, 1, 1)))
    ax = Figure().add_subplot()
    scene._draw_on(ax, ())
    low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
    ends = [np.array([k * 2.4477 * sd, 0.0]) + p for p in at for k in (-1, 1)]
    assert np.mean([((p > low) & (p < high)).all() for p in ends]) == share
    assert (high - low).max() < 1.5 * 10.0


def test_ellipses_of_robots_that_nothing_holds_are_drawn_only_as_far_as_they_show():
    """With half axes of 1e25 m the picture of a swarm whose bearings pointed backwards was never done."""
    scene, at = Scene("a swarm"), np.array([[0.0, 0.0], [10.0, 0.0], [5.0, 8.0]])
    scene.points("robots", ["1", "2", "3"], at, "#808080", ["", "", ""], np.tile(np.diag([1e50, 1.0]), (3, 1, 1)))
    ax = Figure().add_subplot()
    scene._draw_on(ax, ())
    (ellipses,) = (one for one in ax.collections if isinstance(one, EllipseCollection))
    assert ellipses.get_widths().max() <= 2.0 * 1e3 * 10.0
    assert np.allclose(ellipses.get_heights(), 2.0 * 2.4477, rtol=1e-3)


def test_what_was_found_stands_where_its_robot_was():
    scene = Scene("a drive")
    track = Track(np.arange(11.0), np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)]))
    found = [
        Finding("scan-gap", "1", (4.0, 6.0), 2.0),
        Finding("scan-gap", "1", (90.0, 91.0), 1.0),
        Finding("robots-apart"),
    ]
    scene.findings(found, {"1": track})
    (layer,) = data(scene)["points"]
    assert (layer["layer"], layer["x"], layer["y"]) == ("findings", [5.0], [0.0])
    assert layer["texts"][0].startswith("note: robot 1: from 4.0 s to 6.0 s: no scans")


def test_an_empty_scene_is_left_out():
    page = Page("Empty")
    page.scene(Scene("nothing"), "nothing")
    assert "<figure" not in page.html()
    assert "<script" not in page.html()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("width", [500, 900, 1400])
@pytest.mark.parametrize("dark", [False, True])
def test_the_map_lives_in_a_browser(tmp_path, width, dark):
    page = Page("Hall")
    page.scene(team(), "a hall")
    Image.new("L", (924, 300)).save(tmp_path / "f.png")
    page.figure(tmp_path / "f.png", "a figure")
    seen = seen_in_browser(page.html().replace("<head>", "<head>" + WATCH), tmp_path, width, dark=dark)
    assert seen["errors"] == []
    assert seen["ink"] > 1000
    assert seen["wide"] <= 0
    assert seen["tip"].startswith("landmark")
    assert seen["time"] == "20 s"
    assert seen["layers"] == ["walls", "closures", "robot 1", "truth", "landmarks", "anchors"]
    assert 0.3 * seen["whole"] < seen["half"] < 0.7 * seen["whole"], "half of the map is known at half of the time"
    assert 2 <= seen["written"] < 10, "some names are left to pointing"
    assert seen["apart"]
    assert seen["fewer"] == [0, -1], "what is not known yet is not named"
    assert seen["still"] == 0
    assert seen["back"] == 0, "a map that was hidden for a while is what it was"
    assert seen["printed"]["bright"] > 150, "paper is white, whatever the screen"
    assert seen["printed"]["shape"] == pytest.approx(0, abs=0.01)
    assert seen["printed"]["after"] == 0
    free, wall, unseen = seen["kinds"]
    assert abs(free - unseen) > 20 < abs(free - wall)
    assert seen["margin"] < 60, "the map fills the width"
    assert re.fullmatch(r"x -?\d+\.\d+, y -?\d+\.\d+ m", seen["place"])
    assert re.fullmatch(r"\d+\.\d+ m, -?0\.0° from x", seen["length"])
    assert seen["marks"] == 5, "every layer of one look has its mark; walls have none"
    assert seen["figure"] == pytest.approx(min(924, max(0.8 * 924, seen["column"])), abs=2), "text stays readable"


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize(("width", "dark"), [(500, False), (900, True), (1400, False)])
def test_nothing_on_a_page_keeps_anybody_from_using_it(tmp_path, width, dark):
    page = Page("Hall", "Two robots in a hall.")
    page.cards([("robots", "2"), ("size", "9 x 3 m")], warnings=1)
    page.scene(team(), "a hall", tmp_path / "hall.png")
    page.warnings(["a scan was left out"])
    page.section("Numbers")
    page.table([f"a long name of column {k}" for k in range(9)], [range(9)] * 2, colours=PALETTE[:2])
    Image.new("L", (924, 300)).save(tmp_path / "f.png")
    page.figure(tmp_path / "f.png", "a figure")
    (tmp_path / "metrics.json").write_text("{}")
    page.write(tmp_path / "report.html")
    list_files(tmp_path)
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "metrics.json" in html
    assert found_by_axe(html, tmp_path, width, dark=dark) == []


DARKENED = """<script>
window.addEventListener("load", () => {
  const image = document.querySelector("figure img"), sheet = document.createElement("canvas");
  [sheet.width, sheet.height] = [image.naturalWidth, image.naturalHeight];
  const pen = sheet.getContext("2d", {willReadFrequently: true});
  pen.filter = getComputedStyle(image).filter;
  pen.drawImage(image, 0, 0);
  const seen = [...Array(sheet.width / 20).keys()].map((k) => [...pen.getImageData(20 * k + 10, 10, 1, 1).data]);
  document.documentElement.dataset.seen = JSON.stringify(seen);
});
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_on_a_dark_page_paper_is_dark_ink_is_light_and_robots_keep_their_colours(tmp_path):
    colours = ["#FFFFFF", "#2B2F33", "#000000", *PALETTE]
    image = Image.new("RGB", (20 * len(colours), 20))
    for k, one in enumerate(colours):
        image.paste(one, (20 * k, 0, 20 * k + 20, 20))
    image.save(tmp_path / "f.png")
    page = Page("Dark")
    page.figure(tmp_path / "f.png", "colours")
    seen = seen_in_browser(page.html().replace("<head>", "<head>" + DARKENED), tmp_path, 900, dark=True)
    paper, ink, black, *robots = (np.array(pixel[:3]) for pixel in seen)
    assert paper.max() < 40
    assert ink.min() > 150
    assert black.min() > 200
    for one, was in zip(robots, PALETTE, strict=True):
        assert np.abs(one - [int(was[i : i + 2], 16) for i in (1, 3, 5)]).max() < 30, was
