"""Two robots that drive at once and know nothing of each other: their laser maps are merged at the end."""

import numpy as np

import mapweave
from mapweave.core import se2
from mapweave.mapping.weave import weave
from mapweave.sim.laser import DriveConfig, Scanner, WallStyle, WorldBuilder, drive, through

# Drivers stand here: two simulated robots in one flat, rooms below and above a corridor, each room of its own size.
flat = WorldBuilder("flat", WallStyle(), np.random.default_rng(3))
for x in (0.0, 5.0, 11.0, 20.0):
    flat.plain((x, 0), (x, 5), 0.6)
for x in (0.0, 8.0, 14.0, 20.0):
    flat.plain((x, 7), (x, 13), 0.6)
for y, doors in ((0.0, ()), (5, (2.5, 8, 15)), (7, (4, 11, 17)), (13, ())):
    ends = [0, *(d + side for d in doors for side in (-0.6, 0.6)), 20]
    for a, b in zip(ends[::2], ends[1::2], strict=True):
        flat.plain((a, y), (b, y), 0.6)
for x, y, wide, deep in ((0.5, 0.2, 1.4, 0.7), (9, 0.1, 1.8, 0.6), (18, 1, 1, 2), (6, 11, 1, 1.5), (12, 12, 1.6, 0.8)):
    flat.box(x, y, wide, deep, 0.4)
left = [(2.5, 2), (2.5, 6), (8, 6), (8, 2), (9.5, 2.5), (8, 3.5), (8, 6), (11, 6), (11, 10), (12, 9), (11, 8), (11, 6)]
right = [(17, 10), (17, 6), (11, 6), (11, 10), (10, 10.5), (11, 8), (11, 6), (8, 6), (8, 2.5), (7, 2), (8, 3.5), (8, 6)]
scanner = DriveConfig(scanner=Scanner(far=12.0))
routes = through(left, 0.4), through(right, 0.4)
drives = [drive(flat.world(), route, scanner, seed=k) for k, route in enumerate(routes)]

# Both are mapped as their scans come, in turn.
slams = [mapweave.LaserSlam(robot=str(k + 1)) for k in range(2)]
for step in range(max(len(d.log.scans) for d in drives)):
    for slam, d in zip(slams, drives, strict=True):
        if step < len(d.log.scans):
            scan = d.log.scans[step]
            ranges = np.where(scan.hit, scan.ranges, np.inf)
            slam.add_scan(d.log.scan_t[step], ranges, scan.angles(), odometry=scan.odometry)

# Their keyframes are tried against each other; two maps become one where enough places agree and no other way fits.
graphs = [graph for slam in slams if (graph := slam.result().maps[0].graph) is not None]
woven = weave(graphs)
for merge in woven.merges:
    print(merge.reason)

# Where robot 2 began, as the map says and in truth.
begun = se2.compose(woven.pose[1][0], se2.inverse(graphs[1].pose[0]))
true = se2.between(drives[0].truth.pose[0], drives[1].truth.pose[0])
print(f"robot 2 began at {np.round(begun, 2).tolist()}, in truth at {np.round(true, 2).tolist()} [m, m, rad]")
