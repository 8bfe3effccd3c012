"""Real bearings: Roh's angulation data, and what the robots of MRCLAM set 6 saw of each other.

    MAPWEAVE_DATA=... python benchmarks/swarm_real.py [--table readings|angulation|drive] [--json FILE]

MAPWEAVE_DATA is the folder with `bearings/` and `mrclam/`.
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np
from angulation import as_sightings, read_angulation

import mapweave
from mapweave.api.locate import LocateConfig
from mapweave.core import se2
from mapweave.evaluation.swarm import similarity
from mapweave.io.sightings import read_team_bearings, read_team_truth
from mapweave.swarm.moving.poses import odometry_steps

HEADING = 0.5 * np.pi  # true of all nine places


def angulation(folder: Path) -> dict:
    """The bias found, and RMSE and NEES before and after it is allowed for."""
    bearings, places, beacons = read_angulation(folder)
    known = {f"b{k + 1}": p for k, p in enumerate(beacons)}
    d = beacons[None] - places[:, None]
    off = np.degrees(se2.wrap_angle(bearings - (np.arctan2(d[..., 1], d[..., 0]) - HEADING)[:, None]))
    out = {
        "bias_rms_deg": float(np.sqrt(np.mean(off.mean(axis=1) ** 2))),
        "bias_largest_deg": float(np.abs(off.mean(axis=1)).max()),
        "scatter_deg": float(np.median(off.std(axis=1))),
        "correlation_of_neighbours": float(
            np.median([np.corrcoef(off[p, :-1, b], off[p, 1:, b])[0, 1] for p in range(len(places)) for b in range(4)])
        ),
        "cases": {},
    }
    one = np.median(bearings, axis=1, keepdims=True)
    sigma = np.radians(out["scatter_deg"])
    cases = {
        "all 800 readings, heading as written down, sigma their scatter": (bearings, sigma, HEADING),
        "medians, heading as written down, sigma from the residuals": (one, None, HEADING),
        "medians, heading found, sigma from the residuals": (one, None, None),
    }
    for name, (z, noise, heading) in cases.items():
        fitted = noise
        if fitted is None:
            first = mapweave.locate(as_sightings(z, np.radians(1.0), heading), anchors=known, axis=heading is not None)
            fitted = np.radians(1.0) * np.sqrt(first.estimate.chi2 / first.estimate.dof)
        e = mapweave.locate(as_sightings(z, fitted, heading), anchors=known, axis=heading is not None).estimate
        error, cov = e.position[4:] - places, e.cov[4:]
        nees = np.einsum("ka,ka->k", error, np.linalg.solve(cov, error[..., None])[..., 0])
        out["cases"][name] = {
            "sigma_deg": float(np.degrees(fitted)),
            "rmse": float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
            "largest": float(np.linalg.norm(error, axis=1).max()),
            "promised": float(np.sqrt(np.trace(cov, axis1=1, axis2=2).mean())),
            "nees_per_dof": float(nees.mean() / 2),
            "reliable": e.reliable,
            "heading_off_deg": None
            if e.heading is None
            else np.degrees(se2.wrap_angle(e.heading[4:] - HEADING)).round(2).tolist(),
        }
    return out


def team(path: Path, seconds: float | None = None) -> dict:
    """Five robots that drive: bearings of each other and odometry, no range, no landmark, no heading, no anchor."""
    table, odometry = read_team_bearings(path)
    if seconds is not None:
        table = table.rows(table.t < table.t[0] + seconds)
    truth = read_team_truth(path)
    begun = time.perf_counter()
    track, there = tracked(table, odometry, truth)
    p = np.concatenate([one.position[ok] for one, ok, _ in there.values()])
    q = np.concatenate([at for _, _, at in there.values()])
    rigid = _left(p, q, scale=False)
    similar = _left(p, q, scale=True)
    span = float(table.t[-1] - table.t[0])
    second = ((table.t - table.t[0]) // 1.0).astype(int)
    n = len(table.ids)
    pairs = [len(np.unique(table.observer[second == s] * n + table.target[second == s])) for s in np.unique(second)]
    return {
        "sightings": len(table.observer),
        "seconds": span,
        "rmse": rigid[0],
        "rmse_after_scale": similar[0],
        "scale": similar[1],
        "odometry_alone": _dead_reckoning(table, odometry, truth),
        "turn_scale": {table.ids[k]: round(w, 3) for k, (_, w) in track.scale.items()},
        "outliers": int(track.outlier.sum()),
        "most_pairs_in_a_second": max(pairs),
        "pairs_needed_at_once": 3 * n - 4,
        "took_s": time.perf_counter() - begun,
    }


def tracked(table, odometry, truth):
    """The track, and by robot: its track, which stamps truth covers, the true positions there."""
    from mapweave.core.bearings import BearingTable
    from mapweave.swarm.moving.smooth import smooth_driving

    sigma = np.full(len(table.observer), np.radians(0.6))
    ready = BearingTable(table.ids, table.observer, table.target, table.direction, sigma, table.t, axis=False)
    track = smooth_driving(
        ready, {k: odometry[name] for k, name in enumerate(table.ids)}, {}, LocateConfig().commanded, covariance=False
    )
    return track, {k: (one, *_true(truth, table.ids[k], one.t)) for k, one in track.tracks.items()}


def _true(truth, name, t):
    rows = np.flatnonzero(np.array(truth.ids) == name)
    stamps = truth.t[rows]
    ok = (t >= stamps[0]) & (t <= stamps[-1])
    return ok, np.column_stack([np.interp(t[ok], stamps, truth.position[rows, c]) for c in range(2)])


def _dead_reckoning(table, odometry, truth) -> float:
    """RMSE [m] of every robot's odometry by itself, each aligned to its own truth."""
    errors = []
    for name in table.ids:
        t = np.arange(max(table.t[0], odometry[name].t[0]), min(table.t[-1], odometry[name].t[-1]), 0.5)
        ok, at = _true(truth, name, t)
        p = odometry_steps(odometry[name], t, LocateConfig().commanded).pose[ok, :2]
        errors.append(np.sum((se2.act(se2.align(p, at), p) - at) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(errors))))


def _left(p, q, *, scale: bool):
    s, R, t = similarity(p, q, scale=scale, turn=True)
    return float(np.sqrt(np.mean(np.sum((s * p @ R.T + t - q) ** 2, axis=1)))), s


def print_readings(roh: dict) -> None:
    headings = roh["cases"]["medians, heading found, sigma from the residuals"]["heading_off_deg"]
    rows = (
        ("bias, root mean square [°]", f"{roh['bias_rms_deg']:.1f}"),
        ("bias, largest [°]", f"{roh['bias_largest_deg']:.1f}"),
        ("scatter of readings, median [°]", f"{roh['scatter_deg']:.1f}"),
        ("correlation of neighbouring readings, median", f"{roh['correlation_of_neighbours']:.1f}"),
        ("heading of a place, furthest off [°]", f"{np.abs(headings).max():.1f}"),
    )
    print("| what | |\n|---|---|")
    for name, value in rows:
        print(f"| {name} | {value} |")


def print_angulation(roh: dict) -> None:
    print("| | sigma | RMSE | promised | NEES / dof | |")
    print("|---|---|---|---|---|---|")
    for name, c in roh["cases"].items():
        trust = "trusted" if c["reliable"] else "called unreliable"
        nees = c["nees_per_dof"]
        errors = f"{c['rmse']:.3f} m | {c['promised']:.3f} m | {nees:,.{0 if nees > 100 else 2}f}"
        print(f"| {name} | {c['sigma_deg']:.2f}° | {errors} | {trust} |")


def print_drive(six: dict) -> None:
    rows = (
        ("sightings", f"{six['sightings']:,}"),
        ("seconds", f"{six['seconds']:.0f}"),
        ("RMSE [m], one rigid frame", f"{six['rmse']:.2f}"),
        ("RMSE [m], scale taken out too", f"{six['rmse_after_scale']:.2f}"),
        ("scale", f"{six['scale']:.2f}"),
        ("RMSE [m] of odometry alone", f"{six['odometry_alone']:.1f}"),
        ("pairs that see each other in a second, at most", six["most_pairs_in_a_second"]),
        ("pairs that would tell the shape at once", six["pairs_needed_at_once"]),
        ("turns, share of what was commanded, least", f"{min(six['turn_scale'].values()):.2f}"),
        ("turns, share of what was commanded, most", f"{max(six['turn_scale'].values()):.2f}"),
        ("sightings left out [%]", f"{100 * six['outliers'] / six['sightings']:.0f}"),
    )
    print("| what | |\n|---|---|")
    for name, value in rows:
        print(f"| {name} | {value} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("MAPWEAVE_DATA"))
    parser.add_argument("--table", choices=("readings", "angulation", "drive"), help="this one alone")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    if asked.data is None:
        parser.error("say where the real logs are: --data or MAPWEAVE_DATA")
    found: dict[str, dict] = {}
    if asked.table != "drive":
        roh = found["roh_angulation"] = angulation(asked.data / "bearings" / "roh_angulation")
        if asked.table != "angulation":
            print_readings(roh)
        if asked.table != "readings":
            print_angulation(roh)
    if asked.table in {None, "drive"}:
        found["mrclam6"] = team(asked.data / "mrclam" / "MRCLAM_Dataset6.zip")
        print_drive(found["mrclam6"])
    if asked.json:
        asked.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
