"""Every format that mapweave reads: how it is read, and small whole inputs to damage."""

import dataclasses
import gzip
import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from angulation import read_angulation
from PIL import Image

from mapweave.core import se2
from mapweave.core.findings import Finding
from mapweave.core.names import robot_name
from mapweave.core.records import Track
from mapweave.io.g2o import read_g2o, write_g2o
from mapweave.io.landmark_logs import is_landmark_log, read_landmark_logs
from mapweave.io.landmark_truth import read_relations, read_robot_truth, read_survey
from mapweave.io.laser_logs import LaserSource, is_laser_log, read_laser, robots_of
from mapweave.io.laser_map import read_grid, write_grid
from mapweave.io.laser_state import read_laser_states
from mapweave.io.local_map import read_local_map, write_local_map
from mapweave.io.positions import read_network, read_positions, read_track, write_network, write_positions, write_track
from mapweave.io.robot_graph import read_robot_graph, write_robot_graph
from mapweave.io.ros_map import read_plan, read_ros_map
from mapweave.io.sightings import read_sightings, read_swarm_odometry, read_swarm_truth, read_team_bearings
from mapweave.io.team_map import read_metrics, read_single_maps, read_team_maps, write_landmarks, write_tracks
from mapweave.io.tum import read_tum, write_tum
from mapweave.landmarks.landmark_map import LandmarkMap, LocalMap, RobotSightings, Submap
from mapweave.laser.laser_map import GridMap, IntensityCalibration
from mapweave.laser.pose_graph import PoseGraph
from mapweave.swarm.result import JointInformation
from mapweave.team.team_map import TeamMap

Files = dict[str, bytes]
Reader = Callable[[Path], object]
KEPT = 2000  # message definitions
MAY_BE_NAN = {"sigma", "heading", "n_eff", "intensities", "range_max", "residual_by_range"}


def not_finite(made: object, name: str = "result") -> str:
    """The first field of a result that holds a number which is not finite; empty when there is none."""
    if name in MAY_BE_NAN:
        return ""
    if isinstance(made, np.ndarray):
        return name if made.dtype.kind == "f" and not np.isfinite(made).all() else ""
    if isinstance(made, float):
        return "" if np.isfinite(made) else name
    if dataclasses.is_dataclass(made):
        if name == "bearings" and hasattr(made, "range"):  # sightings whose range is unknown
            made = dataclasses.replace(made, range=np.zeros(len(made.t)))
        parts = ((f.name, getattr(made, f.name)) for f in dataclasses.fields(made))
    elif isinstance(made, Mapping):
        parts = ((name, v) for v in made.values())
    elif isinstance(made, list | tuple):
        parts = ((name, v) for v in made)
    else:
        return ""
    return next((wild for part, value in parts if (wild := not_finite(value, part))), "")


def files_in(folder: Path) -> Files:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def one(folder: Path) -> Path:
    """The only file in `folder`, where there is one."""
    inside = sorted(p for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []
    return inside[0] if inside else folder / "missing"


def track(n: int = 6) -> Track:
    t = np.arange(float(n))
    return Track(t, np.column_stack([0.3 * t, 0.1 * t, 0.05 * t]), np.tile(0.01 * np.eye(3), (n, 1, 1)))


def compile_messages_once() -> None:
    """What the bag library makes of message definitions, anew for every recording it opens, is kept by its text."""
    from rosbags.highlevel import anyreader
    from rosbags.serde import utils
    from rosbags.typesys import store

    from mapweave.io import bag

    made: dict[str, dict[str, object]] = {}

    def run(text: str, names: dict[str, object]) -> None:
        if text not in made:
            whole = dict(names)
            exec(text, whole)  # noqa: S102  (as the library does)
            if len(made) > KEPT:
                made.clear()
            made[text] = whole
        names.update(made[text])

    for module in (utils, store):
        module.exec = run  # type: ignore[attr-defined]

    definitions: dict[tuple[str, frozenset], object] = {}
    build = store.Typestore.get_msgdef

    def definition(self: store.Typestore, name: str) -> object:
        if name not in self.cache:
            key = name, frozenset(self.types.items())
            if key not in definitions:
                if len(definitions) > KEPT:
                    definitions.clear()
                definitions[key] = build(self, name)
            self.cache[name] = definitions[key]
        return self.cache[name]

    store.Typestore.get_msgdef = definition
    parse = lru_cache(KEPT)(anyreader.get_types_from_msg)
    anyreader.get_types_from_msg = bag.get_types_from_msg = parse


# ---- landmark logs


def landmark_folder() -> Files:
    rng = np.random.default_rng(0)
    files = {"Barcodes.dat": "# Subject # Barcode #\n 1 5\n 2 14\n 6 63\n 7 81\n 8 7\n"}
    files["Landmark_Groundtruth.dat"] = "# s x y sx sy\n" + "".join(
        f"{s} {s}.5 1.25 0.0001 0.0001\n" for s in (6, 7, 8)
    )
    for k in (1, 2):
        t = 1_000_000 + np.arange(30) * 0.1
        files[f"Robot{k}_Odometry.dat"] = "# t v w\n" + "".join(f"{s:.3f} 0.1 0.05\n" for s in t)
        seen = "".join(
            f"{s:.3f} {c} {2 + 0.1 * rng.normal():.3f} 0.1\n" for s in t[::3] for c in (63, 81, 7, 5 if k == 2 else 14)
        )
        files[f"Robot{k}_Measurement.dat"] = "# t c r b\n" + seen
        files[f"Robot{k}_Groundtruth.dat"] = "# t x y a\n" + "".join(f"{s:.3f} 0.1 0.2 0.3\n" for s in t)
    return {name: text.encode() for name, text in files.items()}


def read_landmarks_of_all_kinds(folder: Path) -> object:
    where = one(folder) if [p.suffix for p in folder.iterdir()] == [".zip"] else folder
    is_landmark_log(where)
    logs = read_landmark_logs(where)
    return logs, [list(log.events()) for log in logs]


def read_truth(folder: Path) -> object:
    return read_survey(folder), read_robot_truth(folder)


def zipped(files: Files) -> bytes:
    import io
    import zipfile

    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return held.getvalue()


def csv_folder() -> Files:
    t = np.arange(20) * 0.1
    drive = "t,robot,v,w\n" + "".join(f"{s:.1f},{k},0.1,0.0\n" for s in t for k in (1, 2))
    seen = "t,robot,id,range,bearing\n" + "".join(
        f"{s:.1f},{k},{i},2.5,0.1\n" for s in t for k in (1, 2) for i in ("a", "b", "robot1")
    )
    return {"odometry.csv": drive.encode(), "sightings.csv": seen.encode()}


# ---- laser logs


def carmen() -> Files:
    rows = []
    for k in range(4):
        x = 0.1 * k
        ranges = " ".join(f"{2 + 0.01 * (k + b):.2f}" for b in range(8))
        rows.append(f"ODOM {x} 0 0.01 0.1 0 0 {k}.0 host {k}.0")
        rows.append(f"FLASER 8 {ranges} {x + 0.1} 0 0.01 {x} 0 0.01 {k}.5 host {k}.5")
        light = " ".join(str(100 + b) for b in range(8))
        rows.append(
            f"ROBOTLASER1 0 -1.57 3.14 0.448 80 0.01 0 8 {ranges} 8 {light} {x} 0 0 {x} 0 0 0 0 0 0 0 {k}.6 h {k}"
        )
    return {"log.clf": "\n".join(rows).encode() + b"\n"}


def stampless() -> Files:
    rows = [f"Odometry {0.1 * k} 0 0\nLaser 8 " + " ".join(f"{2 + 0.01 * b:.2f}" for b in range(8)) for k in range(4)]
    return {"log.log": "\n".join(rows).encode() + b"\n"}


def wheel_ticks() -> Files:
    ranges = " ".join(str(900 + b) for b in range(120))
    rows = [f"{100_000 * k} 0 {50 * k} {52 * k} {'0 ' * 20}{ranges} 0" for k in range(3)]
    return {"exp.dat": "\n".join(rows).encode() + b"\n"}


def read_laser_log(folder: Path) -> object:
    path = one(folder)
    if not is_laser_log(path):
        return None
    out = []
    for name in robots_of(path, LaserSource()):
        log = read_laser(path, "1", LaserSource(name=name))
        out += [log, log.stamps(), list(log.events())]
    return out


def bag(suffix: str) -> Callable[[Path], list[Files]]:
    def seeds(work: Path) -> list[Files]:
        from tests.io.ros_logs import driving, usual

        work.mkdir(parents=True, exist_ok=True)
        single = usual(work / f"one{suffix}", n=6).write()
        team = usual(work / f"team{suffix}", n=3)
        for k in range(4):
            driving(team, "robot2", k)
        return [{"a" + suffix: p.read_bytes()} for p in (single, team.write())]

    return seeds


def sensors(suffix: str) -> Callable[[Path], list[Files]]:
    """Recordings of point clouds beside an IMU, of scans with several echoes, and of tags told in three ways."""

    def seeds(work: Path) -> list[Files]:
        from tests.io.ros_logs import Recording

        work.mkdir(parents=True, exist_ok=True)
        made = [Recording(work / f"{name}{suffix}") for name in ("clouds", "echoes", "tags")]
        clouds, echoes, tags = made
        grid = np.stack(np.meshgrid(np.linspace(-2, 2, 12), np.linspace(-2, 2, 12), [-0.4, 0.0]), axis=-1).reshape(
            -1, 3
        )
        for k in range(6):
            t = 10.0 + 0.1 * k
            for out in made:
                out.tf(t, "base_link", "camera", x=0.1)
                out.odom(t, 0.1 * k)
            clouds.cloud(t, grid + 0.1 * k)
            echoes.echoes(t, [[2.0 + 0.01 * k, 3.0], [], [2.5]] * 9)
            if suffix != ".bag":
                tags.objects(t, [("4", (2.0 - 0.1 * k, 1.0, 0.2)), ("7", (3.0, -0.1 * k, 0.2))])
                tags.markers(t, [("9", (2.0 - 0.1 * k, -1.0, 0.2))])
                tags.tags(t, [3])
            tags.tf(t, "camera", "tag36h11:3", x=2.0 - 0.1 * k, y=0.4)
            for j in range(5):
                clouds.imu(t + 0.02 * j, 0.1)
        return [{"a" + suffix: out.write().read_bytes()} for out in made]

    return seeds


def read_any_recording(folder: Path) -> object:
    path = one(folder)
    return read_landmark_logs(path) if is_landmark_log(path) else read_laser_log(folder)


# ---- swarms


def sightings() -> list[Files]:
    flat = "t,observer,target,bearing,sigma\n" + "".join(f"{k}.0,{k},{(k + 1) % 5},0.{k},0.01\n" for k in range(5))
    deep = "observer,target,azimuth,elevation\na,b,0.1,0.2\nb,a,3.0,-0.2\nc,a,1.0,0.0\n"
    unit = "observer,target,bx,by,bz\na,b,1,0,0\nb,a,0,1,0\n"
    return [{"s.csv": text.encode()} for text in (flat, deep, unit)]


def parquet(work: Path) -> list[Files]:
    from mapweave.core.bearings import BearingTable, unit
    from mapweave.io.sightings import write_sightings

    work.mkdir(parents=True, exist_ok=True)
    one_two = np.array([0, 1, 2]), np.array([1, 2, 0])
    table = BearingTable(("a", "b", "c"), *one_two, unit(np.array([0.1, 0.2, 0.3])), np.full(3, 0.01), np.arange(3.0))
    write_sightings(work / "s.parquet", table)
    return [{"s.parquet": (work / "s.parquet").read_bytes()}]


# ---- results


def local_map() -> LocalMap:
    rng = np.random.default_rng(0)
    return LocalMap(
        "robot2",
        Submap("robot2", np.zeros(3), ("9", "barcode:72"), rng.normal(size=(2, 2)), np.eye(7), "local_2"),
        track(),
        {"9": 4, "barcode:72": 21},
        RobotSightings(np.arange(3.0), ("robot4", "robot1", "robot4"), np.ones(3), np.zeros(3)),
        nis_median=1.25,
        dropped={"misread barcode": 2},
        calibration={"lag": (0.21, 0.01)},
        findings=(Finding("saw-nothing", action="taken care of"),),
    )


def a_local_map(work: Path) -> list[Files]:
    write_local_map(work, local_map())
    return [files_in(work)]


def a_grid(work: Path) -> list[Files]:
    ones = np.ones((4, 5))
    grid = GridMap(0.1, np.zeros(2), ones, ones, np.ones((4, 5, 2)), ones, ones)
    write_grid(work / "grid.npz", grid, IntensityCalibration(ones[0], ones[0], 0.9, 1.0, 0.1, 5, ones[0]), "normalised")
    return [files_in(work)]


def a_team(work: Path) -> list[Files]:
    marks = LandmarkMap(("3", "7"), np.array([[1.0, 2], [3, 4]]), 0.01 * np.eye(4))
    team = TeamMap(
        ("robot1",), marks, {"robot1": track()}, {"3": (robot_name("1"),), "7": ("robot1",)}, {"3": 4, "7": 9}
    )
    work.mkdir(parents=True)
    write_landmarks(work, team)
    write_tracks(work, team)
    (work / "metrics.json").write_text(json.dumps({"version": "1", "robots": {"1": {"warnings": []}}, "fusion": []}))
    (work / "local" / "robot1").mkdir(parents=True)
    (work / "local" / "robot1" / "landmarks.npz").write_bytes((work / "landmarks.npz").read_bytes())
    return [files_in(work)]


def read_result(folder: Path) -> object:
    return read_metrics(folder), read_team_maps(folder), read_single_maps(folder)


def a_tum(work: Path) -> list[Files]:
    write_tum(work / "a.tum", track())
    return [files_in(work)]


def a_graph(work: Path) -> list[Files]:
    pose = track().pose
    step = se2.between(pose[:-1], pose[1:])
    graph = PoseGraph(pose, np.arange(5), np.arange(1, 6), step, np.tile(np.eye(3), (5, 1, 1)))
    write_g2o(work / "a.g2o", graph)
    return [files_in(work), {"a.g2o.gz": gzip.compress((work / "a.g2o").read_bytes(), 1)}]


def a_laser_graph(work: Path) -> list[Files]:
    from tests.io.test_robot_graph import graph

    out = []
    for k, light in enumerate((True, False)):
        write_robot_graph(work / str(k) / "graph.npz", graph(light=light))
        out.append(files_in(work / str(k)))
    return out


def a_laser_state(work: Path) -> list[Files]:
    from tests.io.test_laser_state import kept, made_map

    kept(work, made_map())
    return [{n: data for n, data in files_in(work).items() if n.endswith((".npz", ".json"))}]


def a_swarm(work: Path) -> list[Files]:
    n, rng = 4, np.random.default_rng(0)
    work.mkdir(parents=True)
    count = np.arange(n)
    spread = np.tile(0.01 * np.eye(2), (n, 1, 1))
    write_positions(work / "positions.csv", tuple("abcd"), rng.normal(size=(n, 2)), spread, count > 0, count, count)
    write_track(work / "a.csv", np.arange(float(n)), rng.normal(size=(n, 2)), spread)
    matrix = JointInformation(sp.eye(2 * n, format="csc"), np.ones(2 * n, dtype=bool), 2)
    write_network(work / "network.npz", np.array([[0, 1], [1, 2]]), matrix)
    return [files_in(work)]


def read_swarm(folder: Path) -> object:
    read_positions(folder / "positions.csv")  # of robots that were not located it says nothing
    pairs, information = read_network(folder / "network.npz", 4)
    return read_track(folder / "a.csv"), pairs, None if information is None else information.matrix.data


# ---- floor plans


def a_map(work: Path) -> list[Files]:
    work.mkdir(parents=True)
    Image.fromarray((np.arange(80).reshape(8, 10) * 3).astype(np.uint8)).save(work / "m.pgm")
    Image.fromarray((np.arange(80).reshape(8, 10) * 3).astype(np.uint8)).save(work / "m.png")
    yaml = (
        "image: {}\nresolution: 0.05\norigin: [-1.0, -2.0, 0.1]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return [{"map.yaml": yaml.format(name).encode(), name: (work / name).read_bytes()} for name in ("m.pgm", "m.png")]


def read_map(folder: Path) -> object:
    made = read_ros_map(folder / "map.yaml")
    plans = [read_plan(p, 0.05, np.zeros(3)) for p in sorted(folder.iterdir()) if p.suffix in (".pgm", ".png")]
    return made, made.extent(), made.walls(), plans


def an_angulation(_: Path) -> list[Files]:
    rows = "\n".join("10.5,20.5,200.0" for _ in range(3)).encode()
    return [{"landmark.csv": b"0,0,1\n1,0,2\n0,1,3\n", "(X1.0,Y2.0).csv": rows, "(X2.0,Y2.0).csv": rows}]


def always(*files: Files) -> Callable[[Path], list[Files]]:
    return lambda _: list(files)


def of_file(read: Callable[[Path], object]) -> Reader:
    return lambda folder: read(one(folder))


RELATIONS = b"# t1 t2 x y z roll pitch yaw\n" + b"1.0 2.0 0.1 0.2 0 0 0 0.3\n" * 5
TRUTH = b"id,x,y,t,heading\na,1,2,0.0,0.1\nb,3,4,0.0,0.2\n"

FORMATS: dict[str, tuple[Reader, Callable[[Path], list[Files]]]] = {
    "mrclam": (read_landmarks_of_all_kinds, always(landmark_folder(), {"set.zip": zipped(landmark_folder())})),
    "csv": (read_landmarks_of_all_kinds, always(csv_folder())),
    "truth": (read_truth, always(landmark_folder())),
    "survey": (of_file(read_survey), always({"s.csv": b"id,x,y\n1,2.0,3.0\n2,4.0,5.0\n"})),
    "bearings": (read_team_bearings, always(landmark_folder())),
    "carmen": (read_laser_log, always(carmen(), {"log.gz": gzip.compress(carmen()["log.clf"], 1)})),
    "stampless": (read_laser_log, always(stampless())),
    "ticks": (read_laser_log, always(wheel_ticks())),
    "bag": (read_laser_log, bag(".bag")),
    "db3": (read_laser_log, bag(".db3")),
    "mcap": (read_laser_log, bag(".mcap")),
    "sensors-bag": (read_any_recording, sensors(".bag")),
    "sensors-db3": (read_any_recording, sensors(".db3")),
    "sensors-mcap": (read_any_recording, sensors(".mcap")),
    "sightings": (of_file(read_sightings), always(*sightings())),
    "parquet": (of_file(read_sightings), parquet),
    "swarm-truth": (of_file(read_swarm_truth), always({"t.csv": TRUTH})),
    "swarm-odometry": (of_file(read_swarm_odometry), always({"o.csv": b"t,robot,v,w\n0,a,1,0\n1,a,1,0\n0,b,1,0\n"})),
    "local-map": (read_local_map, a_local_map),
    "grid": (of_file(read_grid), a_grid),
    "team": (read_result, a_team),
    "laser-graph": (of_file(read_robot_graph), a_laser_graph),
    "laser-state": (read_laser_states, a_laser_state),
    "swarm": (read_swarm, a_swarm),
    "tum": (of_file(read_tum), a_tum),
    "relations": (of_file(read_relations), always({"r.relations": RELATIONS})),
    "g2o": (of_file(read_g2o), a_graph),
    "map": (read_map, a_map),
    "angulation": (read_angulation, an_angulation),
}
