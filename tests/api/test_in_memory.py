"""Verbs take tables and arrays in memory, with the answers and the errors of the same data in files."""

import csv

import numpy as np
import pytest

import mapweave

from .frames import Frame


def columns(path):
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.fixture(scope="module")
def swarm(tmp_path_factory):
    path = tmp_path_factory.mktemp("swarm") / "swarm.csv"
    made = mapweave.simulate_swarm(path, mapweave.SwarmScene(robots=9), seed=3)
    known = {made.table.ids[c]: made.position[0, c] for c in made.corners}
    table = columns(path)
    numeric = {name: np.array(table[name], dtype=float) for name in ("bearing", "sigma")}
    return path, known, {**{name: [int(v) for v in table[name]] for name in ("observer", "target")}, **numeric}


def structured(table):
    out = np.zeros(len(table["bearing"]), dtype=[(n, "i8" if n in ("observer", "target") else "f8") for n in table])
    for name, values in table.items():
        out[name] = values
    return out


@pytest.mark.parametrize("shape", [dict, structured, lambda table: structured(table).view(np.recarray), Frame])
def test_a_swarm_is_located_from_a_table_in_memory_as_from_its_file(swarm, shape):
    path, known, table = swarm
    there = mapweave.locate(path, anchors=known)
    here = mapweave.locate(shape(table), anchors=known)
    assert here.estimate.ids == there.estimate.ids
    assert np.array_equal(here.estimate.position, there.estimate.position)


def test_mistakes_in_a_table_in_memory_are_told_as_those_of_a_file(swarm):
    _, _, table = swarm
    with pytest.raises(mapweave.ReaderError, match=r"sightings:3: expected a positive sigma \[rad\], found -1"):
        mapweave.locate({**table, "sigma": np.where(np.arange(len(table["sigma"])) == 2, -1.0, table["sigma"])})
    with pytest.raises(mapweave.ReaderError, match="expected observer,target and one of bearing"):
        mapweave.locate({name: table[name] for name in ("observer", "target")})
    with pytest.raises(mapweave.DataError, match="one length, found observer 3, target 2, bearing 3"):
        mapweave.locate({"observer": [1, 2, 3], "target": [2, 3], "bearing": [0.1, 0.2, 0.3]})
    with pytest.raises(mapweave.UsageError, match="sightings: expected a path or columns by name, found list"):
        mapweave.locate([1, 2, 3])
    with pytest.raises(mapweave.DataError, match=r"one value a row for bearing, found the shape \(3, 1\)"):
        mapweave.locate({"observer": [1, 2, 3], "target": [2, 3, 1], "bearing": np.zeros((3, 1))})


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    """A team's log as a folder of CSV, and as tables."""
    made = mapweave.simulate_landmarks(robots=2, landmarks=8, minutes=0.5, seed=1)
    subject = {code: name for name, code in made.barcodes.items()}
    robots = {r.number for r in made.robots}
    names = {code: f"robot{s}" if s in robots else str(s) for code, s in subject.items()}
    odometry = [(t, r.number, v, w) for r in made.robots for t, v, w in r.odometry.tolist()]
    sightings = [
        (t, r.number, names[code], *seen)
        for r in made.robots
        for t, code, seen in zip(r.stamps.tolist(), r.barcodes.tolist(), r.sightings.tolist(), strict=True)
        if code in names
    ]
    folder = tmp_path_factory.mktemp("team")
    tables = {}
    for file, head, rows in (
        ("odometry", ("t", "robot", "v", "w"), odometry),
        ("sightings", ("t", "robot", "id", "range", "bearing"), sightings),
    ):
        with (folder / f"{file}.csv").open("w", encoding="utf-8", newline="") as out:
            csv.writer(out).writerows([head, *rows])
        tables[file] = dict(zip(head, map(list, zip(*rows, strict=True)), strict=True))
    return folder, tables


def test_landmarks_are_mapped_from_tables_in_memory_as_from_their_files(team, tmp_path):
    folder, tables = team
    there = mapweave.map(folder, tmp_path / "files")
    here = mapweave.map(out=tmp_path / "tables", **tables)
    assert there.maps[0].landmarks.ids == here.maps[0].landmarks.ids
    for name in ("landmarks.csv", "trajectories/robot1.tum"):
        assert (tmp_path / "files" / name).read_bytes() == (tmp_path / "tables" / name).read_bytes()


def test_a_robot_without_odometry_and_one_of_several_can_be_mapped_from_tables(team):
    _, tables = team
    assert mapweave.map(sightings=tables["sightings"], robots=["2"]).metrics["robots"]["2"]["odometry"] == "none"


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"range": "far"}, mapweave.ReaderError, "sightings:1: expected a number for range, found 'far'"),
        ({"robot": "A"}, mapweave.ReaderError, "sightings:1: expected a whole number for robot, found 'A'"),
        ({"range": None}, mapweave.ReaderError, "expected the columns t,robot,id,range,bearing"),
    ],
)
def test_a_mistake_in_a_table_of_landmarks_is_named(team, change, error, said):
    _, tables = team
    ((name, value),) = change.items()
    sightings = {k: list(v) for k, v in tables["sightings"].items()}
    if value is None:
        del sightings[name]
    else:
        sightings[name] = [value, *map(str, sightings[name][1:])]
    with pytest.raises(error, match=said):
        mapweave.map(odometry=tables["odometry"], sightings=sightings)


@pytest.fixture(scope="module")
def drive():
    made = mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=8.0), seed=1)
    log = made.log
    first = log.scans[0]
    scans = {
        "t": log.scan_t,
        "ranges": np.array([np.where(s.hit, s.ranges, np.inf) for s in log.scans]),
        "angles": first.angles(),
        "intensities": np.array([s.intensities for s in log.scans]),
        "range_max": first.range_max,
    }
    pose = log.odometry.pose
    return made, scans, {"t": log.odometry.t, "x": pose[:, 0], "y": pose[:, 1], "theta": pose[:, 2]}


def test_scans_are_mapped_from_arrays_as_from_a_log(drive):
    made, scans, odometry = drive
    there = mapweave.map(made.log, method="gated").maps[0]
    here = mapweave.map(scans=scans, odometry=odometry, method="gated").maps[0]
    assert np.abs(here.track.pose - there.track.pose).max() < 1e-6
    assert here.feature == there.feature
    two = mapweave.map(scans=[scans, scans], odometry=[odometry, odometry], method="gated", robots=["2"])
    assert [m.robot for m in two.maps] == ["2"]


def test_arrays_of_scans_that_do_not_fit_are_named(drive):
    _, scans, odometry = drive
    with pytest.raises(mapweave.DataError, match="expected ranges of 2 scans by"):
        mapweave.map(scans={**scans, "t": scans["t"][:2]}, odometry=odometry)
    with pytest.raises(mapweave.DataError, match="evenly spaced"):
        mapweave.map(scans={**scans, "angles": np.array(scans["angles"]) ** 2}, odometry=odometry)
    with pytest.raises(mapweave.DataError, match="odometry: expected theta, found t, x, y"):
        mapweave.map(scans=scans, odometry={k: odometry[k] for k in ("t", "x", "y")})
    with pytest.raises(mapweave.DataError, match="scans: expected ranges, found t"):
        mapweave.map(scans={"t": scans["t"]})
    with pytest.raises(mapweave.UsageError, match="as many tables of odometry as of scans"):
        mapweave.map(scans=[scans, scans], odometry=[odometry])


def test_logs_and_tables_exclude_each_other(drive, team):
    made, scans, _ = drive
    folder, tables = team
    with pytest.raises(mapweave.UsageError, match="found both"):
        mapweave.map(made.log, scans=scans)
    with pytest.raises(mapweave.UsageError, match="found both"):
        mapweave.map(scans=scans, sightings=tables["sightings"])
    with pytest.raises(mapweave.UsageError, match="found neither"):
        mapweave.map()
    with pytest.raises(mapweave.UsageError, match="found both"):
        mapweave.map([made.log, folder])
    with pytest.raises(mapweave.UsageError, match="--particles: only for laser logs"):
        mapweave.map(**tables, laser=mapweave.LaserOptions(particles=5))


def test_a_robot_is_localized_by_scans_and_a_map_in_memory_as_by_files(tmp_path):
    drive = mapweave.simulate_laser(tmp_path / "drive.mcap", mapweave.CorridorConfig(distance=6.0), seed=1)
    made = mapweave.map([drive.log], tmp_path / "out", method="gated", laser=mapweave.LaserOptions(feature="none"))
    scans = {
        "t": drive.log.scan_t,
        "ranges": np.stack([np.where(s.hit, s.ranges, np.inf) for s in drive.log.scans]),
        "angles": drive.log.scans[0].angles(),
    }
    steps = [s.odometry for s in drive.log.scans]
    wheels = {"t": drive.log.scan_t, **{n: [p[k] for p in steps] for k, n in enumerate(("x", "y", "theta"))}}
    files = mapweave.localize(tmp_path / "drive.mcap", tmp_path / "out", start=(0.0, 0.0, 0.0))
    for log, where, odometry in (
        (drive.log, made, None),
        (drive.log, tmp_path / "out", None),
        (scans, made, wheels),
    ):
        found = mapweave.localize(log, where, start=(0.0, 0.0, 0.0), odometry=odometry)
        assert found.metrics["localisation"]["map"] == (str(where) if where is not made else "in memory")
        at_scans = np.searchsorted(files.localisation.track.t, found.localisation.scans.t)
        np.testing.assert_allclose(found.localisation.scans.pose, files.localisation.track.pose[at_scans], atol=0.02)
    with pytest.raises(mapweave.UsageError, match="odometry: expected scans in memory"):
        mapweave.localize(drive.log, made, odometry=wheels)


def test_robots_are_named_by_number_key_or_name(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=6, minutes=1.0, seed=1)
    maps = [
        mapweave.map(tmp_path / "team", robots=[robot], share={robot: 0.5}, refine=False)
        for robot in (2, "2", "robot2")
    ]
    assert [m.maps[0].robots for m in maps] == [("robot2",)] * 3
    assert len({m.maps[0].tracks["robot2"].pose.tobytes() for m in maps}) == 1


def test_robots_may_be_named_in_any_order(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=6, minutes=1.0, seed=1)
    one, other = (mapweave.map(tmp_path / "team", robots=robots) for robots in ([1, 2], [2, 1, 2]))
    assert [m.robot for m in other.local] == ["robot1", "robot2"]
    assert other.summary() == one.summary()


@pytest.mark.parametrize(
    "call",
    [
        lambda: mapweave.map([1, 2]),
        lambda: mapweave.map(5),
        lambda: mapweave.fuse([1]),
        lambda: mapweave.evaluate(3, "truth"),
        lambda: mapweave.evaluate("out", 3),
        lambda: mapweave.localize(4, "out"),
        lambda: mapweave.solve_pose_graph(None),
    ],
)
def test_what_is_no_path_is_told_and_raises_no_type_error(call):
    with pytest.raises(mapweave.MapweaveError, match="expected"):
        call()
