"""Tiny MRCLAM folders for tests: what a robot team writes, in a few rows."""

from pathlib import Path

CODES = {1: 5, 2: 14, 6: 63, 7: 81, 8: 7}
HEADER = "# tiny data set\n# Time [s]    ...\n"


def rows(table, fmt="{:.3f}") -> str:
    return HEADER + "".join("\t".join(fmt.format(v) for v in row) + "\n" for row in table)


def drive(start=0.0, n=50, dt=0.02, v=0.1, w=0.05):
    return [(start + k * dt, v, w) for k in range(n)]


def glances(start=0.1, n=4, codes=(63, 81), dt=0.2):
    return [(start + k * dt, code, 2.0 + 0.1 * i, 0.1 * i) for k in range(n) for i, code in enumerate(codes)]


def write(folder: Path, robots=None, codes=None) -> Path:
    """A folder with `robots` {K: (odometry rows or None, measurement rows or None)}."""
    folder.mkdir(parents=True, exist_ok=True)
    table = CODES if codes is None else codes
    (folder / "Barcodes.dat").write_text(HEADER + "".join(f"  {s} \t {b}\n" for s, b in table.items()))
    for k, (odometry, seen) in (robots or {1: (drive(), glances()), 2: (drive(), glances())}).items():
        if odometry is not None:
            (folder / f"Robot{k}_Odometry.dat").write_text(rows(odometry))
        if seen is not None:
            (folder / f"Robot{k}_Measurement.dat").write_text(rows(seen))
    return folder
