"""Every verb's result has one face: metrics, summary, files, a page's head, the main picture."""

import inspect
import json
import math
import re
import shutil
import zipfile
from typing import get_args

import pytest
from matplotlib.figure import Figure

import mapweave
from mapweave.io.directory import plain
from mapweave.report.html import HOLDS

HEAD = 200_000  # bytes of a page's head with its picture, however large the result


@pytest.fixture(scope="session")
def home(tmp_path_factory):
    """A small log of every kind, and what `map` and `locate` make of it."""
    home = tmp_path_factory.mktemp("results")
    mapweave.simulate_landmarks(home / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.map(home / "team", home / "team-map")
    corridor = mapweave.CorridorConfig(distance=12.0)
    mapweave.simulate_laser(home / "drive.mcap", corridor, seed=1)
    mapweave.map(home / "drive.mcap", home / "drive-map", method="gated")
    mapweave.simulate_swarm(home / "swarm.csv", mapweave.SwarmScene(robots=9), seed=1)
    mapweave.locate(home / "swarm.csv", home / "swarm-places", anchors={"1": (0.0, 0.0), "9": (20.0, 20.0)})
    return home


def ranging(home):
    mapweave.simulate_team(
        home / "radios", ranges=True, lasers=2, cameras=0, bearings=0, beacons=2, minutes=0.5, force=True
    )
    return mapweave.map(home / "radios")


def moving(home):
    made = mapweave.simulate_swarm(scene=mapweave.SwarmScene(robots=9, steps=4), seed=2)
    known = {made.table.ids[c]: made.position[0, c] for c in made.corners}
    return mapweave.locate(made.table, anchors=known)


LASER_WORLD = 'sensor = "laser"\noffice = 150.0\n'


def laser_exploration(home):
    (home / "world.toml").write_text(LASER_WORLD, encoding="utf-8")
    return mapweave.explore(str(home / "world.toml"), until=3)


def triangle(home):
    edge = "EDGE_SE2 {} {} 1 0 2.0944 100 0 0 100 0 400\n"
    (home / "triangle.g2o").write_text("".join(edge.format(i, (i + 1) % 3) for i in range(3)), encoding="utf-8")
    return home / "triangle.g2o"


def drives_live(home):
    log, history = home / "team", home / "history.sqlite"
    network = mapweave.Network(listen=("tcp/127.0.0.1:0",))
    options = {"rate": math.inf, "linger": 0.0, "history": history, "network": network, "say": lambda _: None}
    return mapweave.live_robot("r1", log, **options)


def two_lasers(home):
    world = mapweave.CorridorConfig(distance=6.0)
    return mapweave.map([mapweave.simulate_laser(world=world, seed=k).log for k in (1, 2)])


def the_same_drive(home):
    made = mapweave.map(mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=6.0), seed=1).log)
    return mapweave.compare(made, made)


def mixed(home):
    mapweave.simulate_team(home / "mixed", lasers=1, cameras=1, bearings=0, landmarks=8, minutes=0.5)
    return mapweave.map(home / "mixed")


RESULTS = {
    # what gives it: (the type, how it is had from `home`, its file of metrics)
    "map": (mapweave.TeamResult, lambda home: mapweave.map(home / "team", truth=home / "team"), "metrics.json"),
    "map, laser": (
        mapweave.LaserResult,
        lambda home: mapweave.map(home / "drive.mcap", method="gated", truth=home / "drive.truth.tum"),
        "metrics.json",
    ),
    "map, lasers": (mapweave.LaserResult, two_lasers, "metrics.json"),
    "map, mixed": (mapweave.MixedResult, mixed, "metrics.json"),
    "map, ranges": (mapweave.RangeResult, ranging, "metrics.json"),
    "fuse": (mapweave.TeamResult, lambda home: mapweave.fuse(home / "team-map"), "metrics.json"),
    "locate": (mapweave.Located, lambda home: mapweave.locate(home / "swarm.csv"), "metrics.json"),
    "locate, moving": (mapweave.Moved, moving, "metrics.json"),
    "localize": (
        mapweave.LocalizeResult,
        lambda home: mapweave.localize(home / "drive.mcap", home / "drive-map", start=(0.0, 0.0, 0.0)),
        "metrics.json",
    ),
    "compare": (mapweave.Comparison, the_same_drive, "metrics.json"),
    "explore": (mapweave.LandmarkExploration, lambda home: mapweave.explore(until=3), "metrics.json"),
    "explore, laser": (mapweave.LaserExploration, laser_exploration, "metrics.json"),
    "evaluate": (
        mapweave.TeamEvaluation,
        lambda home: mapweave.evaluate(home / "team-map", home / "team"),
        "metrics.json",
    ),
    "evaluate, swarm": (
        mapweave.SwarmEvaluation,
        lambda home: mapweave.evaluate(home / "swarm-places", home / "swarm.truth.csv"),
        "metrics.json",
    ),
    "simulate landmarks": (
        mapweave.SimulatedTeam,
        lambda home: mapweave.simulate_landmarks(robots=2, landmarks=8, minutes=0.5),
        "simulation.json",
    ),
    "simulate corridor": (
        mapweave.SimulatedDrive,
        lambda home: mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=3.0)),
        None,
    ),
    "simulate swarm": (
        mapweave.SimulatedSwarm,
        lambda home: mapweave.simulate_swarm(scene=mapweave.SwarmScene(robots=9)),
        None,
    ),
    "simulate team": (
        mapweave.SimulatedMixedTeam,
        lambda home: mapweave.simulate_team(lasers=1, cameras=1, bearings=0, landmarks=8, minutes=0.5),
        "simulation.json",
    ),
    "doctor, map": (mapweave.Causes, lambda home: mapweave.doctor(home / "team-map"), "metrics.json"),
    "self-test": (mapweave.SelfTest, lambda home: mapweave.self_test(), "metrics.json"),
    "doctor": (mapweave.Diagnosis, lambda home: mapweave.doctor(), "metrics.json"),
    "live robot": (mapweave.LiveRobot, drives_live, "metrics.json"),
    "solve": (mapweave.SolveResult, lambda home: mapweave.solve_pose_graph(triangle(home)), "metrics.json"),
    "reproduce hamatani": (
        mapweave.HamataniReproduction,
        lambda home: mapweave.reproduce_hamatani(quick=True),
        "metrics.json",
    ),
}


MARKS = {
    "reproduce hamatani": pytest.mark.long,
    "explore, laser": pytest.mark.slow,
    "self-test": pytest.mark.slow,
    "map, mixed": pytest.mark.slow,
}
PARAMS = [pytest.param(name, marks=MARKS.get(name, ())) for name in sorted(RESULTS)]


@pytest.fixture(scope="session", params=PARAMS)
def result(request, home):
    """One result, and the name of its file of metrics."""
    kind, make, file = RESULTS[request.param]
    made = make(home)
    assert isinstance(made, kind)
    return made, file


@pytest.fixture(scope="session")
def written(result, tmp_path_factory):
    """The folder of a result, where it has one."""
    made, file = result
    if file is None:
        return None
    out = tmp_path_factory.mktemp("written") / "out"
    made.write(out)
    return out


def test_a_result_keeps_the_protocol(result):
    made, _ = result
    assert isinstance(made, mapweave.Result)
    assert isinstance(made.metrics, dict)
    assert made.metrics["version"] == mapweave.__version__
    assert made.summary().strip()
    assert type(made).__name__ in repr(made)
    assert len(repr(made)) < 300


def test_a_results_page_head_is_small_and_says_what_the_summary_says(result):
    made, _ = result
    head = made._repr_html_()
    assert len(head.encode()) < HEAD
    assert head.startswith("<div>")
    assert '<img alt="the map"' in head
    assert head.count("<tr>") >= 2
    first = made.summary().splitlines()[0][:40]
    assert first.split("<")[0].split("&")[0].split("'")[0] in head


def test_a_results_picture_is_a_figure_with_something_on_it(result):
    made, _ = result
    figure = made.plot()
    assert isinstance(figure, Figure)
    assert any(ax.has_data() for ax in figure.axes)


def test_a_result_writes_its_folder_whole_and_its_metrics_are_those_of_the_file(result, written, tmp_path):
    made, file = result
    if file is None:
        out = tmp_path / ("drive.mcap" if isinstance(made, mapweave.SimulatedDrive) else "swarm.csv")
        made.write(out)
        assert out.stat().st_size > 0
        assert list(tmp_path.glob("*.truth.*"))
        return
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work\n", encoding="utf-8")
    with pytest.raises(mapweave.UsageError):
        made.write(tmp_path / "mine")
    told = json.loads((written / file).read_text(encoding="utf-8"))
    assert set(told) == set(made.metrics)
    if file != "simulation.json":
        page = (written / "report.html").read_text(encoding="utf-8")
        assert '<figure class="scene">' in page or kept_figures(made)
        named = re.findall(r'<td><a href="([^"]+)">', page)
        assert {name.rstrip("/") for name in named} == {p.name for p in written.iterdir()} - {"report.html"}
        assert kept_figures(made) or {name.rstrip("/") for name in named} <= set(HOLDS)


def kept_figures(made):
    """Of results that are no map: statistics over many runs, scores, checks and what was told."""
    no_map = (
        mapweave.HamataniReproduction
        | mapweave.Evaluation
        | mapweave.SelfTest
        | mapweave.Causes
        | mapweave.Diagnosis
        | mapweave.LiveRobot
    )
    return isinstance(made, no_map)


def test_a_picture_goes_onto_an_axis_of_ones_own(home):
    made, axes = mapweave.load(home / "team-map"), Figure().subplots(1, 2)
    assert made.plot(axes[1]) is axes[1].figure
    assert axes[1].has_data()
    assert not axes[0].has_data()
    mapweave.load(home / "swarm-places").plot(axes[0])
    assert axes[0].has_data()
    with pytest.raises(mapweave.UsageError, match="ax: this picture has several parts"):
        mapweave.doctor().plot(axes[0])


def bytes_of(folder):
    """Every file but for pages, pictures and what a run took."""
    paths = [p for p in folder.rglob("*") if p.is_file() and p.suffix not in {".html", ".png"}]
    out = {p.relative_to(folder).as_posix(): p.read_bytes() for p in paths}
    for name in {"metrics.json", "simulation.json"} & out.keys():
        out[name] = {k: v for k, v in json.loads(out[name]).items() if k != "timing"}
    return out


def test_a_result_is_loaded_as_it_was_written(result, written, tmp_path):
    made, file = result
    if file is None:
        pytest.skip("a log and its truth, no folder")
    again = mapweave.load(written, type(made))
    assert again.summary() == made.summary()
    told = json.loads(json.dumps(plain(again.metrics)))
    held = json.loads((written / file).read_text(encoding="utf-8"))
    assert {**told, "timing": 0} == {**held, "timing": 0}
    again.write(tmp_path / "again")
    assert bytes_of(tmp_path / "again") == bytes_of(written)


def broken(folder, how):
    if how == "half copied":
        (folder / "trajectories" / "robot1.tum").unlink()
    elif how == "edited":
        path = folder / "trajectories" / "robot1.tum"
        path.write_text(path.read_text().replace("1", "2", 1))
    elif how == "metrics edited":
        path = folder / "metrics.json"
        path.write_text(path.read_text().replace('"seed": 0', '"seed": 1'))
    elif how == "another version":
        with zipfile.ZipFile(folder / "result.npz") as held:
            parts = {name: held.read(name) for name in held.namelist()}
        with zipfile.ZipFile(folder / "result.npz", "w") as held:
            for name, part in parts.items():
                held.writestr(name, part.replace(b'"frame"', b'"Frame"'))
    elif how == "torn":
        path = folder / "result.npz"
        path.write_bytes(path.read_bytes()[:-500])
    elif how == "none":
        (folder / "result.npz").unlink()


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ("half copied", r"robot1\.tum: no such file.*not whole"),
        ("edited", r"robot1\.tum: it is not as the result wrote it"),
        ("metrics edited", r"metrics\.json: seed: it is not as the result wrote it"),
        ("another version", r"result\.npz: mapweave .* wrote it, whose .* is not this one's: make the result again"),
        ("torn", r"result\.npz: expected a result"),
        ("none", r"result\.npz: no such file: the result is not whole, or of an earlier version"),
    ],
)
def test_a_folder_that_is_not_the_result_any_more_is_refused_in_one_line(home, tmp_path, how, told):
    shutil.copytree(home / "team-map", tmp_path / "out")
    assert mapweave.load(tmp_path / "out", mapweave.TeamResult).maps[0].robots == ("robot1", "robot2")
    broken(tmp_path / "out", how)
    with pytest.raises(mapweave.ReaderError, match=told) as error:
        mapweave.load(tmp_path / "out")
    assert "\n" not in str(error.value)


def test_no_folder_of_a_result_and_a_result_of_another_kind_are_refused(home, tmp_path):
    with pytest.raises(mapweave.ReaderError, match=r"expected a mapweave result with metrics\.json, found none"):
        mapweave.load(tmp_path)
    with pytest.raises(mapweave.UsageError, match=r"expected a map of laser logs \(LaserResult\), found a map of l"):
        mapweave.load(home / "team-map", mapweave.LaserResult)


FACE = {"metrics", "summary", "write", "plot", "_repr_html_"}
NO_RESULT = {
    "configuration",
    "edit",
    "live_explore",
    "live_follow",
    "live_keys",
    "live_view",
    "read",
    "view",
}  # text, a log, nothing
PROTOCOLS = {mapweave.Result, mapweave.MapResult, mapweave.Evaluation}
NONE = {mapweave.Log, mapweave.LiveTeam}  # what verbs give that is no result


def given_by(annotation):
    """The types of this package that a verb of this annotation gives, one or several, in a list or not."""
    inner = [kind for arg in get_args(annotation) for kind in given_by(arg)]
    own = isinstance(annotation, type) and annotation.__module__.startswith("mapweave.") and annotation not in NONE
    return [annotation, *inner] if own else inner


VERBS = {name: verb for name in mapweave.__all__ if inspect.isfunction(verb := getattr(mapweave, name))}


@pytest.mark.parametrize("name", sorted(VERBS))
def test_what_a_verb_gives_has_the_whole_face_of_a_result(name):
    kinds = given_by(inspect.signature(VERBS[name]).return_annotation)
    assert bool(kinds) == (name not in NO_RESULT)
    for kind in kinds:
        assert set(dir(kind)) >= FACE, kind
        assert kind in PROTOCOLS or not inspect.isabstract(kind), kind


def test_every_type_that_a_verb_gives_is_tried_here_or_is_a_reproduction():
    kinds = {kind for verb in VERBS.values() for kind in given_by(inspect.signature(verb).return_annotation)}
    left = kinds - PROTOCOLS - {kind for kind, _, _ in RESULTS.values()}
    assert {kind.__name__ for kind in left} == {"HaraReproduction", "KojimaReproduction", "YuanReproduction"}


def test_every_result_type_that_is_offered_is_tried_here_or_is_a_reproduction():
    kinds = {getattr(mapweave, name) for name in mapweave.__all__ if name != "__version__"}
    results = {kind for kind in kinds if isinstance(kind, type) and hasattr(kind, "_repr_html_")}
    tried = {kind for kind, _, _ in RESULTS.values()}
    left = {kind.__name__ for kind in results - tried - PROTOCOLS}
    papers = {"HaraReproduction", "KojimaReproduction", "YuanReproduction"}
    assert left == {*papers, "RelationEvaluation", "TrackEvaluation"}
    for name in left:
        kind = getattr(mapweave, name)
        assert not kind.__abstractmethods__
        assert set(dir(kind)) >= FACE


@pytest.mark.parametrize("name", ["local/robot1/local_map.json", "landmarks.npz", "metrics.json", "result.npz"])
def test_a_result_that_is_not_whole_is_neither_scored_nor_fused_nor_shown(name, tmp_path):
    """A robot whose local map was not copied was missing from the fused map, and nothing said so."""
    team = tmp_path / "team"
    mapweave.simulate_landmarks(team, robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.map(team, tmp_path / "out")
    if name == "metrics.json":
        (tmp_path / "out" / name).write_text("{}", encoding="utf-8")
    else:
        (tmp_path / "out" / name).unlink()
    with pytest.raises(mapweave.ReaderError, match=name):
        mapweave.evaluate(tmp_path / "out", team)
    with pytest.raises(mapweave.ReaderError, match=name):
        mapweave.fuse(tmp_path / "out")
    with pytest.raises(mapweave.ReaderError, match=name):
        mapweave.view(tmp_path / "out", browser=False)
