"""The page of woven maps: who hangs together, every pair with its decision, closures and both maps drawn."""

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colors, image

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.laser.pose_graph import PoseGraph
from mapweave.laser.robot_graph import RobotGraph
from mapweave.mapping.merge import Merge
from mapweave.mapping.woven_map import ClosureRow, WovenMap
from mapweave.report import style
from mapweave.report.laser import MOST_PARTS, write_laser_report
from mapweave.report.style import PALETTE
from mapweave.report.woven import MOST_PICTURES, robot_colour, truths_in

from ..conftest import save_a_dot
from ..io.made_laser_map import made_laser_map

T = np.array([0.5, -0.3, 0.2])


def graph(robot, track):
    """Ten keyframes, each of which sees a line of points ahead."""
    pose = track.pose[:: max(1, len(track.t) // 10)][:10]
    n, seen = len(pose), np.column_stack([np.full(20, 1.5), np.linspace(-1, 1, 20)])
    return RobotGraph(
        robot=robot,
        t=track.t[:: max(1, len(track.t) // 10)][:10],
        pose=pose,
        cov=np.tile(np.eye(3) * 1e-3, (n, 1, 1)),
        path=np.arange(n) * 0.3,
        step=se2.between(pose[:-1], pose[1:]),
        step_information=np.tile(np.eye(3) * 1e4, (n - 1, 1, 1)),
        closures=(),
        start=20 * np.arange(n + 1),
        points=np.tile(seen, (n, 1)),
        normals=np.tile([-1.0, 0.0], (20 * n, 1)),
        q=None,
        lined=np.ones(20 * n, dtype=bool),
        sensor=np.zeros((n, 2)),
    )


@pytest.fixture(scope="module")
def woven():
    made = made_laser_map()
    maps = [replace(made, robot=k, method="graph", graph=graph(k, made.track)) for k in "123"]
    tracks = {"1": made.track, "2": Track(made.track.t, se2.compose(T, made.track.pose))}
    graphs = [m.graph for m in maps]
    pose = np.concatenate([graphs[0].pose, se2.compose(T, graphs[1].pose)])

    def row(a, b, accepted):
        at = np.array([pose[1, :2], pose[15, :2]])
        return ClosureRow(a, 100.0, b, 101.0, at, T, 0.8, 0.5, 0.9, 1.2, accepted, "why")

    closures = (row("1", "1", True), row("1", "2", True), row("1", "2", False), row("1", "3", False))
    one = WovenMap(
        robots=("1", "2"),
        tracks=tracks,
        grid=made.grid,
        feature="normalised",
        calibration=None,
        graph=PoseGraph.of(pose, [], [], []),
        owner=np.repeat([0, 1], len(graphs[0])),
        t=np.concatenate([graphs[0].t, graphs[1].t]),
        closures=closures,
    )
    alone = replace(one, robots=("3",), tracks={"3": made.track}, closures=())
    merges = (
        Merge("1", "2", True, "merged on 9 closures", transform=T, score=0.8, agreeing=9, chi2=3.0, alike=0.98, best=T),
        Merge("1", "3", False, "two places fit equally well", score=0.7, second=0.97, best=T, rival=-T),
        Merge("2", "3", False, "too little overlap: none of 5 submaps is found in the other map"),
    )
    return maps, (one, alone), merges


@pytest.fixture(scope="module")
def page(woven, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    maps, components, merges = woven
    write_laser_report(folder, maps, {}, [], components, merges, ("robot1: its log goes on",))
    return folder, (folder / "report.html").read_text()


def test_the_page_says_who_hangs_together_and_decides_every_pair_in_words(page):
    _, html = page
    for words in (
        "3 robots, 2 maps that nothing ties together; 2 of them in the first.",
        "Not in the first map: robot3. Why: robot1 and robot3: two places fit equally well; 1 more in the table of",
        "robot1 and robot2 in one map: 5 x 3 m, in the frame of robot1&#x27;s first pose.",
        "robot3 alone",
        "robot1: its log goes on",
        "merged on 9 closures",
        "robot1 and robot3: not merged: two places fit equally well.",
        "too little overlap: none of 5 submaps is found in the other map",
    ):
        assert words in html, words
    assert html.count(">not merged</td>") == 2
    assert "of 4 loop closures tried 2 are believed" in html


def test_the_head_of_the_page_is_the_map_and_who_is_not_in_it(page):
    _, html = page
    order = [html.index(words) for words in ("2 of 3", "Not in the first map", '<figure class="scene"', "Which robots")]
    assert order == sorted(order)


def test_a_robot_has_one_colour_in_all_maps_of_the_page(page):
    _, html = page
    drawn = re.findall(r'"name":"(robot\d)","colour":"(#\w+)"', html)
    assert len(drawn) == 5, "two in the map of both, three in their own"
    assert len(set(drawn)) == len({colour for _, colour in drawn}) == 3


def test_a_picture_shows_every_pair_that_has_a_place(page):
    folder, _ = page
    assert sorted(p.name for p in (folder / "figures").glob("pair_*")) == [
        "pair_robot1_robot2.png",
        "pair_robot1_robot3.png",
    ]
    wide = image.imread(folder / "figures" / "pair_robot1_robot3.png")
    blue, pink = (_drawn(wide, robot_colour(k)) for k in (0, 2))
    assert blue[:, : wide.shape[1] // 2].any()
    assert blue[:, wide.shape[1] // 2 :].any()
    assert pink.any()


def test_robots_and_closures_are_drawn_in_colours_of_their_own(page):
    folder, _ = page
    drawn = image.imread(folder / "figures" / "component1_map.png")
    assert all(_drawn(drawn, robot_colour(k)).sum() > 50 for k in range(2))
    assert len({robot_colour(k) for k in range(7)}) == 7
    ties = image.imread(folder / "figures" / "component1_closures.png")
    assert all(_drawn(ties, PALETTE[k]).sum() > 10 for k in (0, 2, 5))
    assert (folder / "intensity.png").is_file()


@pytest.mark.slow
def test_of_many_pairs_the_page_shows_some_and_counts_the_others(woven, tmp_path, monkeypatch):
    monkeypatch.setattr(style, "save", save_a_dot)
    maps, components, merges = woven
    many = (merges[0],) * (MOST_PICTURES + 3)
    write_laser_report(tmp_path, maps, {}, [], components, many)
    html = (tmp_path / "report.html").read_text()
    assert "3 more pairs are in the table only." in html
    assert len(re.findall("<summary>robot1 and robot2: merged", html)) == MOST_PICTURES


@pytest.mark.slow
def test_of_many_robots_the_page_holds_some_and_a_row_of_each(woven, tmp_path, monkeypatch):
    monkeypatch.setattr(style, "save", save_a_dot)  # pictures are counted
    maps, components, _ = woven
    many = [replace(maps[0], robot=str(k)) for k in range(1, MOST_PARTS + 4)]
    one = replace(components[0], robots=tuple(m.robot for m in many), tracks={m.robot: m.track for m in many})
    write_laser_report(tmp_path, many, {}, [], [one], ())
    html = (tmp_path / "report.html").read_text()
    assert len(re.findall(r"<summary>Robot \d+: ", html)) == MOST_PARTS
    assert len(re.findall(r'<td[^>]*><i style="background:#\w+"></i>robot\d+</td>', html)) == len(many)
    assert len(list((tmp_path / "figures").glob("*_scans.png"))) == len(many)


@pytest.mark.slow
def test_the_page_does_not_depend_on_how_long_the_work_took(woven, tmp_path):
    maps, components, merges = woven
    slow = [replace(made, timing={**made.timing, "ms_per_scan": 77.7}) for made in maps]
    pages = []
    for k, some in enumerate((maps, slow)):
        (tmp_path / str(k)).mkdir()
        write_laser_report(tmp_path / str(k), some, {}, [], components, merges)
        pages.append((tmp_path / str(k) / "report.html").read_bytes())
    assert pages[0] == pages[1]


def test_the_truth_of_all_robots_is_moved_by_one_motion(woven):
    (one, _) = woven[1]
    away = np.array([3.0, 1.0, 0.7])
    truths = {k: Track(t.t, se2.compose(away, t.pose)) for k, t in one.tracks.items()}
    for told, robot in zip(truths_in(one, truths), one.robots, strict=True):
        assert np.allclose(told.pose, one.tracks[robot].pose, atol=1e-9)
    late = {k: Track(t.t + 1e6, t.pose) for k, t in one.tracks.items()}
    assert truths_in(one, late) == []


def _drawn(pixels, colour):
    return (np.abs(pixels[..., :3] - colors.to_rgb(colour)) < 0.02).all(axis=-1)
