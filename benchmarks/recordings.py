"""What recordings tell beside plane scans: point clouds, an IMU, tags; each against the same drive told otherwise.

    python benchmarks/recordings.py clouds|imu|tags     a Markdown table; clouds and tags need MAPWEAVE_DATA

clouds: the Intel log as a recording of its scans, and of clouds of 16 rings made of them (walls upright, floor and
ceiling flat, 1 cm noise), the scanner level or leaning; scored by the known relations. imu: a robot without wheels
that turns to and fro in a room, three seeds; a drive is lost where a pose is half a metre off. tags: MRCLAM as read, or
as a recording.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # recordings are made as the tests make them

from tests.io.made_clouds import cloud_bag
from tests.io.made_spins import error_of, spin_bag, truth_of
from tests.io.made_tags import tag_bag

import mapweave
from mapweave.api.map_landmarks import map_landmark_logs
from mapweave.api.map_options import MapOptions
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.laser_logs import read_laser

SEEDS, LOST = 3, 0.5  # [m]


def clouds(data: Path, folder: Path) -> list[str]:
    intel, relations = data / "carmen" / "intel.clf.gz", data / "carmen" / "intel.relations.gz"
    log = read_laser(intel)
    rows = ["| Intel as a recording of | translation error, mean | standard deviation | verdict |", "|---|---|---|---|"]
    for name, lean in (
        ("scans", None),
        ("clouds of a level scanner", 0.0),
        ("clouds of one that leans by 3 degrees", 3.0),
    ):
        path = cloud_bag(folder / f"{lean}.mcap", log, lean=None if lean is None else np.deg2rad(lean))
        out = folder / "out"
        verdict = mapweave.map(path, out, force=True).verdict
        score = mapweave.evaluate(out, relations).as_json()["relations"]
        rows.append(f"| {name} | {score['trans_mean']:.3f} m | {score['trans_std']:.3f} m | {verdict} |")
    return rows


def imu(_: Path, folder: Path) -> list[str]:
    rows = ["| turning by up to | scanner alone | lost | with an IMU | lost |", "|---|---|---|---|---|"]
    for rate, hz in ((1.0, 10), (2.0, 10), (2.0, 5)):
        cells = []
        for told in (False, True):
            errors = []
            for seed in range(SEEDS):
                truth, turns = truth_of(40.0, rate)
                path = folder / f"{rate}-{hz}-{seed}-{told}.mcap"
                spin_bag(path, truth, turns, imu=told, bias=0.02, seed=seed, every=100 // hz)
                errors.append(error_of(mapweave.map(path).maps[0].track, truth))
            lost = sum(far > LOST for _, far in errors)
            cells += [f"{np.median([rms for rms, _ in errors]):.3f} m", f"{lost} of {SEEDS}"]
        rows.append(f"| {rate} rad/s, {hz} scans a second | {' | '.join(cells)} |")
    return rows


def tags(data: Path, folder: Path) -> list[str]:
    rows = ["| MRCLAM | sightings | landmarks apart, at most | trajectories apart, at most |", "|---|---|---|---|"]
    for number in (6,):
        logs = read_landmark_logs(data / "mrclam" / f"MRCLAM_Dataset{number}.zip")
        logs = [log.until(logs[0].span[0] + 300.0) for log in logs]
        again = read_landmark_logs(tag_bag(folder / f"{number}.mcap", logs))
        one, two = (map_landmark_logs(read, MapOptions(), "").maps[0] for read in (logs, again))
        order = [two.landmarks.ids.index(name) for name in one.landmarks.ids]
        far = np.abs(two.landmarks.mean[order] - one.landmarks.mean).max()
        off = max(
            np.hypot(*(np.array([np.interp(a.t, b.t, b.pose[:, k]) for k in (0, 1)]) - a.pose[:, :2].T)).max()
            for a, b in ((one.tracks[robot], two.tracks[robot]) for robot in one.robots)
        )
        seen = sum(len(log.sightings) for log in again)
        rows.append(f"| set {number}, five minutes | {seen} | {1e3 * far:.3f} mm | {1e3 * off:.3f} mm |")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("clouds", "imu", "tags"))
    what = parser.parse_args().what
    with tempfile.TemporaryDirectory() as folder:
        print("\n".join(globals()[what](Path(os.environ.get("MAPWEAVE_DATA", "")), Path(folder))))


if __name__ == "__main__":
    main()
