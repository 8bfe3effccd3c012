"""Figures of laser maps, and the maps to move about in: walls, trajectories, the closures believed and refused."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding, verdict
from ..core.names import robot_name
from ..core.records import Track
from ..laser.laser_map import GridMap, IntensityCalibration, LaserMap
from ..mapping.woven_map import ClosureRow
from .scene import Scene
from .style import LANDMARK, MUTED, SEQUENTIAL, TRUTH, as_map, colour, figure

DECISIONS = {"matched": 0, "odometry": 5, "skipped": 4, "empty": 3, "unseen": 2}  # decision -> colour
MOST_LAYERS = 12  # robots with a switch of their own below the map
MOST_Q = 1.0  # of the colour scale
READABLE: Any = {"frameon": True, "framealpha": 0.85, "edgecolor": "none"}  # a legend over data
PASSED_BY = 0.3  # occupancy up to which a cell's returns were of things that moved


def draw_intensity(path: Path, grid: GridMap, feature: str, who: str) -> None:
    """Every cell with returns in the colour of its feature (dark to bright for any colour vision).

    Cells that were mostly seen through are left out: somebody passed by.
    """
    solid = grid.occupancy()[grid.weight > 0] > PASSED_BY  # in the order of `cells`
    cells = grid.cells()[solid]
    with figure(path, *map_size(grid)) as (fig, ax):
        map_window(ax, grid)
        ax.set_facecolor("#F4F6F8")
        rows, cols = grid.shape
        dot = float(np.clip((900.0 / max(rows, cols)) ** 2, 4.0, 16.0))
        if feature == "none":
            ax.scatter(*cells[:, :2].T, s=dot, marker="s", color=MUTED, linewidths=0)
            title = f"{who}: no intensity used, geometry alone"
        else:
            order = np.argsort(cells[:, 3])
            drawn = ax.scatter(
                cells[order, 0],
                cells[order, 1],
                c=cells[order, 2],
                s=dot,
                marker="s",
                cmap=SEQUENTIAL,
                vmin=0.0,
                vmax=MOST_Q,
                linewidths=0,
            )
            fig.colorbar(drawn, ax=ax, label="brightness", shrink=0.7, extend="max")
            title = f"{who}: light sent back ({feature})"
        as_map(ax, title)
        ax.set_aspect("equal", adjustable="box")


def draw_tracks(path: Path, tracks: Mapping[str, Track], tint: str = colour(0)) -> None:
    """Trajectories under their names: the estimate in `tint`, odometry grey, truth black."""
    colours = {"estimate": tint, "odometry": MUTED, "truth": TRUTH}
    with figure(path, 7.0, 5.0) as (_, ax):
        for k, (name, track) in enumerate(tracks.items()):
            line = "--" if name == "truth" else "-"
            ax.plot(*track.pose[:, :2].T, line, color=colours.get(name, colour(k + 2)), label=name, linewidth=1.0)
        ax.plot(0.0, 0.0, "o", color=TRUTH, markersize=4)
        ax.legend()
        as_map(ax, "Where the robot drove")


def draw_scans(path: Path, local_map: LaserMap) -> None:
    """Along time: innovations, matched share, what was decided, effective number of particles."""
    scans = local_map.scans
    t = scans.t - scans.t[0]
    weighed = bool(np.isfinite(scans.n_eff).any())  # there were particles
    rows = 4 if weighed else 3
    with figure(path, 9.0, 1.9 * rows, nrows=rows, sharex=True) as (_, axes):
        step, turn, share = axes[:3]
        step.plot(t, 100 * scans.innovation[:, 0], ".", color=colour(0), markersize=2, label="ahead")
        step.plot(t, 100 * scans.innovation[:, 1], ".", color=colour(1), markersize=2, label="aside")
        step.set_ylabel("innovation [cm]")
        step.legend(loc="upper left", ncols=2, **READABLE)
        step.set_title("What every scan did to the estimate")
        turn.plot(t, np.degrees(scans.innovation[:, 2]), ".", color=colour(2), markersize=2)
        turn.set_ylabel("innovation [deg]")
        for ax, values in ((step, 100 * scans.innovation[:, :2]), (turn, np.degrees(scans.innovation[:, 2]))):
            _within(ax, values)
        part = scans.matches / np.maximum(scans.beams, 1)
        decision = np.array(scans.decision)
        for name, k in DECISIONS.items():
            mine = decision == name
            if mine.any():
                share.plot(
                    t[mine], 100 * part[mine], ".", color=colour(k), markersize=3, label=f"{name} ({mine.sum()})"
                )
        share.set_ylim(-3, 103)
        share.set_ylabel("returns matched [%]")
        if share.lines:
            share.legend(loc="lower left", ncols=4, **READABLE)
        if weighed:
            _draw_n_eff(axes[3], t, local_map)
        axes[-1].set_xlabel("time [s]")


def draw_calibration(path: Path, calibration: IntensityCalibration) -> None:
    """How light falls with range, and how far from it the log's returns are."""
    with figure(path, 9.0, 3.6, ncols=3) as (_, (gain, angle, rest)):
        r = np.linspace(calibration.knots[0], calibration.knots[-1], 300)
        gain.plot(r, calibration.gain(r), color=colour(0))
        gain.plot(calibration.knots, np.exp(calibration.log_gain), "o", color=colour(0), markersize=3)
        if len(calibration.gain_sd):
            sd = np.interp(r, calibration.knots, calibration.gain_sd)
            low, high = (calibration.gain(r) * np.exp(k * sd) for k in (-2.0, 2.0))
            gain.fill_between(r, low, high, color=colour(0), alpha=0.2, linewidth=0, label="2 s.d.")
            gain.legend()
        gain.set_yscale("log")
        gain.set_xlabel("range [m]")
        gain.set_ylabel("gain")
        gain.set_title("Light over range")
        degrees = np.linspace(0, 85, 200)
        c = np.maximum(np.cos(np.radians(degrees)), 0.15)
        angle.plot(degrees, calibration.incidence(c), color=colour(1))
        angle.set_ylim(0, 1.05)
        angle.set_xlabel("incidence [deg]")
        angle.set_ylabel("gain")
        sure = f" ± {calibration.exponent_sd:.2f}" if len(calibration.gain_sd) else ""
        angle.set_title(f"Incidence, p = {calibration.exponent:.2f}{sure}")
        spread = calibration.residual_by_range
        if len(spread) == len(calibration.knots):
            seen = spread > 0
            rest.plot(
                calibration.knots[seen],
                100 * spread[seen],
                "o-",
                color=colour(2),
                markersize=3,
                label="median near a knot",
            )
        rest.axhline(100 * calibration.residual, color=MUTED, linestyle="--", label="all returns, robust s.d.")
        rest.set_ylim(bottom=0)
        rest.set_xlabel("range [m]")
        rest.set_ylabel("residual of log intensity [%]")
        rest.set_title("What the curve leaves")
        rest.legend()


def median_deviation(track: Track) -> float | None:
    """Median standard deviation of the positions of `track` along one axis [m]; None where it has no covariances."""
    if track.cov is None or not len(track.t):
        return None
    return float(np.sqrt(np.median(np.trace(track.cov[:, :2, :2], axis1=1, axis2=2) / 2)))


def aligned(truth: Track, estimate: Track) -> Track:
    """The truth carried to the estimate by the one rigid motion that fits both best where they overlap."""
    inside = (truth.t >= estimate.t[0]) & (truth.t <= estimate.t[-1])
    if inside.sum() < 2:
        return truth
    at = se2.interpolate(truth.t[inside], estimate.t, estimate.pose)
    T = se2.align(truth.pose[inside, :2], at[:, :2])
    return Track(truth.t, se2.compose(T, truth.pose), None, estimate.frame)


def _draw_n_eff(ax: Any, t: Float[np.ndarray, " n"], local_map: LaserMap) -> None:
    scans = local_map.scans
    known = np.isfinite(scans.n_eff)
    ax.plot(t[known], scans.n_eff[known], color=colour(0), linewidth=0.8, label="effective particles")
    again = known & scans.resampled
    ax.plot(t[again], scans.n_eff[again], "v", color=colour(5), markersize=3, label=f"resampled ({again.sum()})")
    ax.set_ylim(0, 1.3 * local_map.particles)  # room for the legend
    ax.set_ylabel("effective particles")
    ax.legend(loc="upper left", ncols=2, **READABLE)


def map_window(ax: Any, grid: GridMap) -> None:
    """The axes show the cells beams reached, with a metre round them."""
    rows, cols = np.nonzero((grid.hits > 0) | (grid.passes > 0))
    if len(rows):
        x, y = grid.origin
        ax.set_xlim(x + cols.min() * grid.resolution - 1, x + (cols.max() + 1) * grid.resolution + 1)
        ax.set_ylim(y + rows.min() * grid.resolution - 1, y + (rows.max() + 1) * grid.resolution + 1)


def _within(ax: Any, values: np.ndarray) -> None:
    """Limits that hold all but a hundredth of the values."""
    most = np.nanquantile(np.abs(values), 0.99) if np.isfinite(values).any() else 0.0
    if most > 0:
        ax.set_ylim(-1.3 * most, 1.3 * most)


def map_size(grid: GridMap) -> tuple[float, float]:
    rows, cols = grid.shape
    return 9.0, float(np.clip(7.6 * rows / max(cols, 1) + 0.8, 3.2, 9.0))


BELIEVED, DOUBTFUL, REFUSED = colour(2), colour(1), colour(5)
PLACES_BELIEVED, PLACES_DOUBTFUL, PLACES_REFUSED = "places believed", "places doubtful", "places refused"
MOST_SECOND = 0.85  # score of the next best place, over that of the one believed, from which on it is doubtful
MOST_NIS = 11.3  # of a place believed: 99 % of right ones are nearer to what the rest of the graph says
SHADES = "Walls stand out, what is known to be free is light, what nobody saw is grey (black on a dark screen)."


def walls(scene: Scene, grid: GridMap) -> None:
    """The occupied cells of `grid` dark, what beams went through white, the rest open."""
    known = (grid.hits > 0) | (grid.passes > 0)
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return
    window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    occupied = grid.occupancy()[window] > 0.5
    x, y = grid.origin
    h = grid.resolution
    extent = (x + cols[0] * h, x + (cols[-1] + 1) * h, y + rows[0] * h, y + (rows[-1] + 1) * h)
    scene.grid("walls", known[window], occupied, extent)


def laser_scene(
    grid: GridMap,
    tracks: Mapping[str, Track],
    colours: Mapping[str, str],
    closures: Sequence[ClosureRow] = (),
    others: Mapping[str, Track] | None = None,
    findings: Iterable[Finding] = (),
    *,
    edited: bool = False,
) -> Scene:
    """Walls and paths, in one frame. tracks: robot -> its path; colours: robot -> colour; others: layer -> more.

    Places believed and other trajectories are hidden at first, as they cover the map, and places that are doubtful
    where the verdict is good. edited: for a page that decides on places: none is hidden, each is called by its number
    in `closures`.
    """
    findings = tuple(findings)
    places = [] if edited else [PLACES_BELIEVED, *([PLACES_DOUBTFUL] if verdict(findings) == "good" else [])]
    hidden = [*places, *(others or {})]
    scene = Scene("Laser map with the trajectories of its robots", hidden, (PLACES_DOUBTFUL, PLACES_REFUSED))
    walls(scene, grid)
    for layer, shade in ((PLACES_BELIEVED, BELIEVED), (PLACES_DOUBTFUL, DOUBTFUL), (PLACES_REFUSED, REFUSED)):
        ids = [k for k, c in enumerate(closures) if _kind(c) == layer]
        if ids:
            rows = [closures[k] for k in ids]
            ends, texts = np.array([c.at.ravel() for c in rows]), [_closure_text(c) for c in rows]
            dashed = layer != PLACES_BELIEVED
            scene.lines(layer, ends, shade, texts, dashed=dashed, ids=ids if edited else ())
    for layer, track in (others or {}).items():
        scene.track(layer, layer, track, LANDMARK)
    for robot, track in tracks.items():
        layer = robot_name(robot) if len(tracks) <= MOST_LAYERS else "robots"
        scene.track(layer, robot_name(robot), track, colours[robot])
    scene.findings(findings, tracks)
    return scene


def _kind(c: ClosureRow) -> str:
    """The layer of a place: doubtful where another lies as near, or the rest of the graph says something else."""
    if not c.accepted:
        return PLACES_REFUSED
    close = c.second is not None and c.second > MOST_SECOND
    return PLACES_DOUBTFUL if close or (c.nis is not None and c.nis > MOST_NIS) else PLACES_BELIEVED


def _closure_text(c: ClosureRow) -> str:
    ends = (
        f"{robot_name(robot)} at {stamp:.1f} s" for robot, stamp in ((c.robot_a, c.stamp_a), (c.robot_b, c.stamp_b))
    )
    second = f"\nthe next best place scores {100 * c.second:.0f} % of it" if c.second else ""
    return f"{', '.join(ends)}\n{_kind(c).removeprefix('places ')}: {c.reason}{second}"
