"""The maps on the pages of swarms, pose graphs and explorations hold what the result holds, through time."""

import base64
import json
import re
from io import BytesIO
from itertools import permutations

import numpy as np
import pytest
from PIL import Image

import mapweave
from mapweave.core.names import robot_key
from mapweave.io.table import read_table
from mapweave.report.exploration import laser_exploration_scene
from mapweave.report.html import Page
from mapweave.report.scene import LEVELS
from mapweave.report.style import drawn
from mapweave.report.swarm import moved_scene, track_errors_figure

from .browser import CHROMIUM, seen_in_browser

WATCH = """<script>
window.errors = [];
window.addEventListener("error", (event) => window.errors.push(event.message));
const drawn = (tries) => {
  const ink = [...document.querySelectorAll(".scene canvas")].map((canvas) =>
    canvas.getContext("2d").getImageData(0, 0, canvas.width || 1, canvas.height || 1).data
      .filter((v, i) => i % 4 === 3 && v > 0).length);
  if (Math.min(...ink) === 0 && tries > 0) return setTimeout(() => drawn(tries - 1), 50);
  const times = [...document.querySelectorAll(".bar input[type=range]")];
  for (const slider of times) {
    slider.value = 300;
    slider.dispatchEvent(new Event("input"));
  }
  document.documentElement.dataset.seen = JSON.stringify({
    errors: window.errors, ink: ink, wide: document.documentElement.scrollWidth - window.innerWidth,
    sliders: times.length, told: [...document.querySelectorAll(".bar output")].map((one) => one.textContent),
  });
};
window.addEventListener("load", () => setTimeout(() => drawn(50), 300));
</script>"""

ROOMS = (
    'sensor = "laser"\nwalls = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]\nstarts = [[1.5, 2.0, 0.0]]\n'
)


def scenes(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    return [json.loads(held) for held in re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)]


def layers(scene):
    return {one["layer"]: one for one in [*scene["lines"], *scene["points"], *scene["tracks"]]}


def sightings(path, steps, lost=""):
    rng = np.random.default_rng(5)
    start = {name: rng.normal(0, 8, 2) for name in "abcde"}
    speed = {name: rng.normal(0, 0.3, 2) * (name not in "ab") for name in start}
    rows = []
    for k in range(steps):
        at = {name: start[name] + k * speed[name] for name in start}
        for i, j in permutations(at, 2):
            dx, dy = at[j] - at[i]
            rows.append(f"{k},{i},{j},{np.arctan2(dy, dx) + rng.normal(0, 0.005):.9f}")
        if lost:
            rows.append(f"{k},a,{lost},0.3")
    path.write_text("\n".join(["t,observer,target,bearing", *rows]) + "\n")
    return {name: tuple(start[name]) for name in "ab"}


@pytest.fixture(scope="module")
def located(tmp_path_factory):
    home = tmp_path_factory.mktemp("located")
    anchors = sightings(home / "s.csv", 1, lost="far")
    mapweave.locate(home / "s.csv", home / "out", anchors=anchors, sigma=0.01)
    return home / "out"


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    home = tmp_path_factory.mktemp("moved")
    anchors = sightings(home / "s.csv", 12)
    mapweave.locate(home / "s.csv", home / "out", anchors=anchors, sigma=0.01)
    return home / "out"


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    home = tmp_path_factory.mktemp("solved")
    rows = [f"VERTEX_SE2 {k} {min(k, 3)} {max(k - 3, 0)} 0" for k in range(6)]
    rows += [f"EDGE_SE2 {k} {k + 1} {int(k < 3)} {int(k >= 3)} 0 100 0 0 100 0 100" for k in range(5)]
    rows += ["EDGE_SE2 0 5 3 2 0 100 0 0 100 0 100", "EDGE_SE2 0 4 9 9 1 100 0 0 100 0 100"]
    (home / "g.g2o").write_text("\n".join(rows) + "\n")
    mapweave.solve_pose_graph(home / "g.g2o", home / "out", robust=True)
    return home / "out"


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    out = tmp_path_factory.mktemp("explored") / "out"
    return out, mapweave.explore("yuan", out, planner="coverage", until=9, association="known")


def test_robots_that_stand_are_on_the_page_where_they_were_located(located):
    (scene,) = scenes(located)
    found = layers(scene)
    rows = read_table(located / "positions.csv").columns
    at = dict(zip(rows["id"], zip(rows["x"], rows["y"], strict=True), strict=True))
    assert found["located"]["names"] == ["c", "d", "e"]
    assert found["anchors"]["names"] == ["a", "b"]
    assert found["cannot be located, drawn at a guess"]["names"] == ["far"]
    for name, x, y in zip("cde", found["located"]["x"], found["located"]["y"], strict=True):
        assert np.allclose((x, y), [float(v) for v in at[name]], atol=1e-3)
    assert len(found["sightings"]["segments"]) == 20
    assert len(found["located"]["ellipses"]) == 3
    low, high = scene["extent"][0], scene["extent"][1]
    assert low >= min(float(at[n][0]) for n in "abcde") - 1e-3
    assert high <= max(float(at[n][0]) for n in "abcde") + 1e-3


def test_robots_that_move_are_on_the_page_through_time(moved):
    (scene,) = scenes(moved)
    ways = {track["name"]: track for track in scene["tracks"]}
    assert set(ways) == set("cde")
    assert layers(scene)["standing still"]["names"] == ["a", "b"]
    for track in ways.values():
        assert (track["t"][0], track["t"][-1]) == (0.0, 11.0)
        assert track["theta"] is None
        assert len(track["ellipses"]) == len(track["t"])


def test_a_robot_that_moves_has_one_colour_in_every_picture(tmp_path):
    anchors = sightings(tmp_path / "s.csv", 12)
    found = mapweave.locate(tmp_path / "s.csv", anchors=anchors, sigma=0.01)
    ids, track, known = found.given.table.ids, found.track, found.given.anchors
    page = {ids.index(one["name"]): one["colour"] for one in moved_scene(ids, track, known, {}).data()["tracks"]}
    truth = {k: one.position for k, one in track.tracks.items()}
    errors = drawn(lambda sheet: track_errors_figure(sheet, ids, track, truth, known)).axes[0]
    assert {ids.index(line.get_label()): line.get_color() for line in errors.lines if line.get_label() in ids} == page
    ways = drawn(found.draw).axes[0]
    assert {line.get_color() for line in ways.lines if len(line.get_xdata()) == 12} == set(page.values())
    assert len(set(page.values())) == 3


def test_a_pose_graph_on_the_page_has_its_edges_by_kind(solved):
    (scene,) = scenes(solved)
    found = layers(scene)
    assert {name: len(found[name]["segments"]) for name in ("steps", "closures", "dropped")} == {
        "steps": 5,
        "closures": 1,
        "dropped": 1,
    }
    assert found["dropped"]["texts"][0].startswith("edge 6: 0 to 4")
    assert found["dropped"]["dashed"]


def test_an_exploration_on_the_page_shows_what_was_seen_when(explored):
    out, result = explored
    (scene,) = scenes(out)
    assert [track["name"].split(",")[0] for track in scene["tracks"]] == list(result.first.robots)
    assert scene["clock"] == "step"
    assert scene["tracks"][0]["t"][-1] == 9
    grid = scene["grid"]
    since = np.asarray(Image.open(BytesIO(base64.b64decode(grid["since"].split(",")[1]))))
    cells = np.asarray(Image.open(BytesIO(base64.b64decode(grid["png"].split(",")[1]))).convert("RGBA"))
    seen = cells[..., 3] > 0
    assert since.shape == seen.shape
    shares = [(since[seen] <= LEVELS * k / 4).mean() for k in range(5)]
    assert shares == sorted(shares)
    assert 0 < shares[0] < shares[2] < 1
    assert shares[-1] == 1.0
    mapped = layers(scene)["mapped landmarks"]
    assert mapped["names"] == list(result.first.map.landmarks.ids)
    known = [step for step in mapped["since"] if step is not None]
    assert min(known) == 0 < max(known) <= 9
    assert {robot_key(name) for name in result.first.robots} == {"1", "2"}


def test_a_laser_exploration_on_the_page_shows_the_map_as_it_came_about(tmp_path):
    (tmp_path / "rooms.toml").write_text(ROOMS)
    run = mapweave.explore(str(tmp_path / "rooms.toml"), until=6).first
    scene = json.loads(json.dumps(laser_exploration_scene(run).data()))
    (driven,) = (track for track in scene["tracks"] if track["t"])
    assert driven["name"] == run.robots[0]
    assert np.allclose(driven["x"][-1], run.tracks[0].pose[-1, 0], atol=1e-3)
    assert len(next(line for line in scene["lines"] if line["layer"] == "true walls")["segments"]) == 4
    cells = np.asarray(Image.open(BytesIO(base64.b64decode(scene["grid"]["png"].split(",")[1]))).convert("L"))
    assert ((cells[::-1] > 0) == ~run.map.unknown).all()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_maps_of_every_job_live_in_a_narrow_dark_browser(tmp_path, located, moved, solved, explored):
    page = Page("Jobs")
    for folder in (located, moved, solved, explored[0]):
        text = (folder / "report.html").read_text(encoding="utf-8")
        page.parts += re.findall(r'<figure class="scene">.*?</figure>', text, re.DOTALL)
        page.scenes += 1
    seen = seen_in_browser(page.html().replace("<head>", "<head>" + WATCH), tmp_path, 500, dark=True)
    assert seen["errors"] == []
    assert len(seen["ink"]) == 4
    assert min(seen["ink"]) > 500
    assert seen["wide"] <= 0
    assert seen["told"] == ["3 s", "step 3"]
