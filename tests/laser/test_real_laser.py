"""Real logs: known relations of the Intel Research Lab, and two rooms driven round."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.records import Track
from mapweave.core.truth import Relations
from mapweave.evaluation.trajectory import exact_pairs, nearest, score_relations
from mapweave.io.landmark_truth import read_relations
from mapweave.io.laser_logs import read_laser
from mapweave.kernels.laser.refine import ScanCost, refine
from mapweave.kernels.laser.tiles import NearestRule
from mapweave.laser.beam import beams
from mapweave.laser.particle_grid import ParticleGrid
from mapweave.laser.particle_slam import as_points
from mapweave.laser.scan_odometry import blended
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.mapping.weave import weave

pytestmark = pytest.mark.data


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "all_of_them", "exact"), [("particle", 0.04, 0.02), ("gated", 0.12, 0.06), ("graph", 0.036, 0.018)]
)
def test_the_intel_log_keeps_its_known_relations(data, method, all_of_them, exact):
    """Published: scan matching 0.220 m, a particle filter 0.070 m. 30 particles here, 100 are the default."""
    log = read_laser(data / "carmen" / "intel.clf.gz")
    known = read_relations(data / "carmen" / "intel.relations.gz")
    made = map_laser(log, LaserConfig(method=method, particles=30), 0)
    every = score_relations(made.track, known)
    pairs = exact_pairs(known, log.scan_t, made.scans.host)
    sure = score_relations(made.track, Relations(known.t1[pairs], known.t2[pairs], known.pose[pairs]))
    assert every.used == every.n == 2984
    assert sure.used == 373
    assert every.trans_mean <= all_of_them
    assert sure.trans_mean <= exact


@pytest.mark.slow
@pytest.mark.parametrize("name", ["urg04lx/exp1.dat.gz", "carmen/loop5.log.gz"])
def test_a_place_seen_again_lies_where_it_was_seen_first(data, name):
    """Scans of the later half that overlap the map of the first quarter are refined against it: they hardly move."""
    log = read_laser(data / name)
    cfg = LaserConfig(method="particle", particles=30, threads=1)
    made = map_laser(log, cfg, 0)
    assert sum(d == "odometry" for d in made.scans.decision) <= 0.02 * len(log.scans)
    poses = np.array(made.scans.pose)  # as filters have them: of what is read-only kernels are compiled again
    seen = [beams(scan, "none", None, cfg.beam) for scan in log.scans]
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T)))
    first, row = ParticleGrid(1, cfg.cells), np.zeros(1, int)
    for k in np.flatnonzero(way < 0.25 * way[-1]):
        first.insert(row, poses[k][None], as_points(seen[k]), seen[k].w.astype(np.float32))
    gap = []
    for k in np.flatnonzero(way > 0.45 * way[-1]):
        points = as_points(seen[k])
        if (first.score(row, poses[k][None], points) < 0.04).mean() < 0.5:
            continue
        found = refine(
            first.tile_maps,
            row,
            poses[k][None],
            points,
            seen[k].normal,
            NearestRule(1.0, 0.04),
            ScanCost(60 / 0.02**2, 0.03, 0.1),
            np.diag([4.0, 4.0, 9.0]),
            10,
            np.empty((0, len(points)), np.float32),
        )
        gap.append(np.hypot(*(found[0, :2] - poses[k, :2])))
    assert len(gap) > 20
    assert np.median(gap) < 0.10


@pytest.mark.long
def test_the_intel_log_cut_into_three_robots_is_woven_again(data):
    """Starts hidden, nothing shared in time: poses of different robots keep the relations as one robot's do."""
    log = read_laser(data / "carmen" / "intel.clf.gz")
    known = read_relations(data / "carmen" / "intel.relations.gz")
    cfg = LaserConfig(method="graph", threads=1)
    cuts = np.quantile(log.scan_t, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
    cuts[-1] += 1.0
    parts = [map_laser(part_of(log, *cuts[k : k + 2], str(k + 1)), cfg, 0) for k in range(3)]
    woven = weave([part.graph for part in parts])
    assert woven.component.tolist() == [0, 0, 0]
    assert not woven.joint.dropped
    t, pose = [], []
    for part, keyframes in zip(parts, woven.pose, strict=True):
        t.append(part.track.t)
        pose.append(blended(part.track.pose, np.searchsorted(part.track.t, part.graph.t), keyframes))
    owner = np.repeat(np.arange(3), [len(x) for x in t])
    stamps = np.concatenate(t)
    across = owner[nearest(stamps, known.t1)[0]] != owner[nearest(stamps, known.t2)[0]]
    asked = Relations(known.t1[across], known.t2[across], known.pose[across])
    told = score_relations(Track(stamps, np.concatenate(pose)), asked)
    single = score_relations(map_laser(log, cfg, 0).track, asked)
    assert told.used == single.used > 500
    assert told.trans_mean <= 1.2 * single.trans_mean


def part_of(log, first, end, robot):
    """The log's stamps from `first` up to `end` as a log of its own."""
    rows = np.flatnonzero((log.scan_t >= first) & (log.scan_t < end))
    wheels = (log.odometry.t >= first) & (log.odometry.t < end)
    odometry = replace(log.odometry, t=log.odometry.t[wheels], pose=log.odometry.pose[wheels])
    scans = tuple(log.scans[k] for k in rows)
    return replace(log, robot=robot, scan_t=log.scan_t[rows], scans=scans, odometry=odometry)
