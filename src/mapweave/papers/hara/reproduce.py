"""`reproduce hara`: odometry, matching, gate and particle filter on the paper's kind of loop, six times."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ...core.paths import checked_arguments
from ...core.version import __version__
from ...core.workers import Progress, no_progress, one_blas_thread
from ...io.directory import check_target
from ...io.kept import kept_parts, part
from ...laser.laser_map import GridMap
from ...report.result import Rows, written
from ...report.style import MUTED, SEQUENTIAL, TRUTH, Target, as_map, colour, figure
from ...sim.laser_worlds import CorridorConfig
from ..reproduction import Check, Claim, Drawing, Numbers, Reproduction, Section, question, rule, sentences
from .experiments import (
    HARD,
    SCANS,
    AlongRow,
    AlphaCurve,
    Bounds,
    GateRow,
    LocalisedStart,
    Method,
    Picture,
    alpha_curve,
    compare,
    counts,
    methods,
    starts_table,
    try_along,
    try_bounds,
    try_gate,
    try_starts,
)

LOOP = "papers/test_reproduce_hara.py"
STATEMENTS = "papers/test_hara_statements.py"

CLAIMS = (
    Claim(
        "Odometry alone bends the map (Fig. 4)",
        "sim/laser.py",
        f"{LOOP}::test_every_method_of_the_paper_is_compared_and_drawn",
        "20 m at the end",
        "odometry",
        rule(Check("odometry", "ATE [m], each drive, beyond the corridor's width", least=CorridorConfig().width)),
    ),
    Claim(
        "Intensity-ICP is better than odometry (Fig. 5)",
        "laser/icp_slam.py",
        f"{STATEMENTS}::test_intensity_icp_errs_half_of_odometry_at_most_and_less_than_icp_on_geometry",
        "drawn",
        "icp",
        rule(Check("icp", "ATE / odometry's, each drive", most=0.5)),
    ),
    Claim(
        "Matching fails on the way and the map turns away; the gate refuses it and carries the map (Figs. 5, 6)",
        "papers/hara/experiments.py",
        f"{LOOP}::test_where_matching_fails_the_gate_carries_the_map_and_refuses_rightly",
        "drawn",
        "gate",
        rule(
            Check("gate_fails", "ATE without the gate, widest pairs / narrowest", least=2.0),
            Check("gate_saves", "ATE with the gate / without, widest pairs", most=0.75),
            Check("gate_right", "share of refusals that are right", least=0.95),
        ),
    ),
    Claim(
        "The particle filter closes the loop where one hypothesis cannot (Fig. 7), as printed",
        "papers/hara/experiments.py",
        f"{STATEMENTS}::test_the_printed_filter_does_not_close_the_loop_where_matching_alone_does_not",
        "drawn",
        "printed",
        rule(Check("printed", "ATE / Intensity-ICP's, each drive", most=0.9)),
    ),
    Claim(
        "The same, our filter with calibrated intensity",
        "laser/particle_slam.py",
        f"{STATEMENTS}::test_our_filter_with_intensity_errs_a_fraction_of_geometry_and_of_odometry",
        "drawn",
        "ours",
        rule(Check("ours", "ATE / Intensity-ICP's, each drive", most=0.9)),
    ),
    Claim(
        "Intensity tells places apart where geometry does not",
        "papers/hara/light_edges.py",
        f"{STATEMENTS}::test_intensity_errs_a_seventh_of_the_best_geometry_and_of_the_least_that_geometry_can",
        "not measured",
        "geometry",
        rule(
            Check("geometry", "ATE / best geometry's", most=0.15),
            Check("geometry_bound", "root mean square / the least that geometry can", most=0.15),
        ),
    ),
    Claim(
        "Future work: the best weight of intensity",
        "papers/hara/experiments.py",
        f"{LOOP}::test_the_weight_of_intensity_is_found_from_the_log",
        "by experience",
        "alpha",
        question(Check("alpha", "ATE at the alpha found / at the best tried", most=1.25)),
    ),
    Claim(
        "Future work: light as a feature that range and angle leave alone",
        "laser/beam.py",
        f"{STATEMENTS}::test_the_feature_found_from_the_log_is_the_reflectance_and_maps_as_well_as_the_true_law",
        "not tried",
        "feature",
        question(Check("feature", "ATE of our filter / of the paper's", most=0.5)),
    ),
    Claim(
        "Future work: localisation with intensity in a finished map",
        "papers/hara/experiments.py",
        f"{LOOP}::test_no_trusted_start_is_wrong_and_light_tells_what_walls_cannot",
        "not tried",
        "localised",
        question(
            Check("starts_wrong", "wrong, with light and without", most=0.0),
            Check("starts_right", "share of starts in the building that light finds", least=0.75),
        ),
        "{starts} starts with light, {bare_starts} with geometry alone, which knows no twins",
    ),
)


@runtime_checkable
class Shown(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def figure(self) -> str: ...
    @property
    def grid(self) -> GridMap: ...
    @property
    def track(self) -> Float[np.ndarray, "n 2"]: ...
    @property
    def truth(self) -> Float[np.ndarray, "m 2"]: ...


def draw_maps(path: Target, pictures: Sequence[Shown]) -> None:
    """One panel a method, all at one scale."""
    across = 2
    down = -(-len(pictures) // across)
    with figure(path, 11.0, 3.6 * down + 0.3, nrows=down, ncols=across, squeeze=False) as (_, axes):
        for ax, p in zip(axes.ravel(), pictures, strict=False):
            cells = p.grid.cells()
            no_intensity = not cells[:, 2].any()
            colours = (
                {"color": MUTED} if no_intensity else {"c": cells[:, 2], "cmap": SEQUENTIAL, "vmin": 0.0, "vmax": 1.0}
            )
            ax.scatter(cells[:, 0], cells[:, 1], s=1.2, marker="s", linewidths=0, **colours)
            ax.plot(*p.track.T, color=colour(5), linewidth=0.8)
            ax.plot(*p.truth.T, color=TRUTH, linewidth=0.8, linestyle="--")
            as_map(ax, f"{p.figure}: {p.name}" if p.figure else p.name)
        for ax in axes.ravel()[len(pictures) :]:
            ax.set_visible(False)


def draw_alpha(path: Target, alphas: Sequence[float], error: np.ndarray, estimate: np.ndarray, at: np.ndarray) -> None:
    """Error against alpha, one line a drive and their mean, and the estimates where they fell."""
    with figure(path, 6.0, 3.6) as (_, ax):
        for each in error.T:
            ax.plot(alphas, each, color=MUTED, linewidth=0.8)
        ax.plot(alphas, error.mean(axis=1), "o-", color=colour(0), label="mean of the drives")
        ax.plot(estimate, at, "*", color=TRUTH, markersize=10, linestyle="none", label="alpha found from the log")
        ax.set_xscale("log")
        ax.set_ylim(bottom=0)
        ax.set_xlabel("alpha [m² per q²]")
        ax.set_ylabel("trajectory error [m]")
        ax.legend()


def draw_gate(path: Target, widths: Sequence[float], alone: np.ndarray, gated: np.ndarray, odometry: float) -> None:
    """Error without and with the gate over how far apart pairs may lie at first; one mark a drive."""
    with figure(path, 6.0, 3.6) as (_, ax):
        for k, (name, error) in enumerate((("Intensity-ICP", alone), ("gated", gated))):
            ax.plot(widths, error.mean(axis=1), "o-", color=colour(k), label=f"{name}, mean")
            for each in error.T:
                ax.plot(widths, each, ".", color=colour(k), alpha=0.6)
        ax.axhline(odometry, color=TRUTH, linestyle=":", label="odometry, mean")
        ax.set_ylim(bottom=0)
        ax.set_xlabel("pairs are taken up to [m]")
        ax.set_ylabel("trajectory error [m]")
        ax.legend()


WHY = """
The paper's corridor and its log are not published. Here the ring is 60 by 30 m, 2.5 m wide, driven for 200 m with 15 to
20 m of odometry error at the end, as the paper reports; the paper prints maps, no errors.

The paper's filter is there as printed: raw intensity, eqs. 7 to 9, every scan weighs and is followed by resampling.
Ours makes intensity independent of range and incidence by a curve found from the log itself, moves its particles by
matching against a local map and refines each against its own.

Without intensity our filter's default errs by {default:.2f} m on this ring, the printed one by {literal:.2f} m. Our
moves come from matching, which trusts wheels little, for logs whose wheels deserve no more. Along a flush wall matching
sees nothing: in straight stretches of 10 m it errs by {along:.2f} m, up to {most:.2f} m in a drive, where wheels err by
{wheels:.2f} m. Where wheels propose, as they should when they are good over a step, our filter errs by
{proposed:.2f} m, and our graph, told how good wheels are, by {graph:.2f} m. Shares of geometry are of the best geometry
in the table.

No estimator on geometry can err by less than {floor:.2f} m here, root mean square over many drives: where only flush
walls are in sight wheels alone tell the way, and what their noise leaves is the bound, with all else granted.
Intensity errs by {light:.3f} m, {share:.2f} x that bound: our graph, and then the rims of posters and doors as
landmarks, between two beams each. What rims and walls tell by their own noise would allow {ideal:.3f} m.

Matching starts from odometry and takes pairs up to 0.4 m, at last 0.1 m, apart; it then hardly leaves where odometry
says, and the gate finds little to refuse. The paper does not print how it keeps wrong pairs out. Where pairs may lie
farther apart, matching fails as in Fig. 5 and the gate mends it as in Fig. 6; {rightly} of {outside} refusals were
right: the match erred more about the step than odometry.

Alpha is found as the variance of places over that of brightness, both from returns of scans that follow one another.

Errors are root mean square positions after one rigid alignment to the truth.
"""


@dataclass(frozen=True, slots=True, repr=False)
class HaraReproduction(Reproduction):
    """The experiments of Hara, Kawata, Ohya and Yuta as measured here, beside what they printed.

    errors: (methods, seeds) ATE [m]; pictures: the maps of one seed; gate: on the ring that is hard to match;
    starts: localised with intensity and without.
    """

    title: ClassVar[str] = "Hara, Kawata, Ohya, Yuta (2007)"
    claims: ClassVar[tuple[Claim, ...]] = CLAIMS
    command: ClassVar[str] = "reproduce hara"
    over: ClassVar[str] = "{drives} drives"

    seed: int
    quick: bool
    particles: int
    methods: tuple[Method, ...]
    errors: Float[np.ndarray, "m s"]
    pictures: tuple[Picture, ...]
    gate: tuple[GateRow, ...]
    along: tuple[AlongRow, ...]
    bounds: Bounds
    alpha: AlphaCurve
    starts: tuple[LocalisedStart, ...]
    timing: dict[str, float]

    def table(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """Head and rows: ATE [m] at each seed, mean, worst, and the mean as a share of odometry's."""
        seeds = self.errors.shape[1]
        head = ("method", "paper", *(f"seed {self.seed + k}" for k in range(seeds)), "mean [m]", "worst", "of odometry")
        rows: list[tuple[object, ...]] = []
        for method, e in zip(self.methods, self.errors, strict=True):
            share = e.mean() / self.errors[0].mean()
            cells = (*(f"{v:.2f}" for v in e), f"{e.mean():.3f}", f"{e.max():.2f}", f"{share:.3f}")
            rows.append((method.name, method.figure, *cells))
        return head, rows

    def gate_table(self) -> Rows:
        """Head and rows: error, and over all drives what the gate refuses, how much of it rightly, what it lets by."""
        head = (
            "method", "paper", "pairs up to [m]", "mean [m]", "worst", "scans", "too few pairs", "outside the gate",
            "rightly", "wrong inside",
        )  # fmt: skip
        rows: list[tuple[object, ...]] = []
        for r in self.gate:
            counts = [int(c.sum()) for c in (r.scans, r.few, r.outside, r.rightly, r.slipped)]
            alone = r.name == "odometry"
            pairs = "" if alone else f"{r.farthest:g}, at last {r.nearest:g}"
            cells = (counts[0], *([""] * 4 if alone else counts[1:]))
            rows.append((r.name, r.figure, pairs, f"{r.ate.mean():.2f}", f"{r.ate.max():.2f}", *cells))
        return head, rows

    def alpha_table(self) -> Rows:
        """Head and rows: mean and worst ATE [m] of Intensity-ICP at each alpha, and at the one found in each log."""
        head = ("alpha [m² per q²]", "mean [m]", "worst")
        rows: list[tuple[object, ...]] = [
            (f"{a:g}", f"{e.mean():.3f}", f"{e.max():.2f}")
            for a, e in zip(self.alpha.alphas, self.alpha.ate, strict=True)
        ]
        estimate = self.alpha.estimate
        e = self.alpha.at_estimate
        rows.append((f"found, {estimate.min():.2f} to {estimate.max():.2f}", f"{e.mean():.3f}", f"{e.max():.2f}"))
        return head, rows

    def along_table(self) -> Rows:
        head = ("what tells how far", "error in 10 m [m]", "worst drive")
        return head, [(r.name, f"{r.error.mean():.3f}", f"{r.error.max():.3f}") for r in self.along]

    def bounds_table(self) -> Rows:
        """Head and rows: least root mean square error [m] that can be had, and that of the best method."""
        head = ("from", "least possible [m]", "best here, root mean square", "method")
        names = ("geometry", "intensity")
        rows: list[tuple[object, ...]] = []
        for name, least in zip(names, (self.bounds.geometry, self.bounds.light), strict=True):
            best, error = self.best(name, squared=True)
            rows.append((f"{name} and wheels", f"{_rms(least):.3f}", f"{error:.3f}", best))
        return head, rows

    def sections(self) -> tuple[Section, ...]:
        paper, rest = ([p for p in self.pictures if bool(p.figure) == shown] for shown in (True, False))
        widths = [r.farthest for r in self.gate if r.name == "Intensity-ICP"]
        alone, gated = (
            np.array([r.ate for r in self.gate if r.name == name]) for name in ("Intensity-ICP", "gated Intensity-ICP")
        )
        return (
            Section(
                "Trajectory error [m] on the loop of 200 m",
                *self.table(),
                (
                    Drawing(
                        "maps.png",
                        "Figs. 4 to 7 side by side: cells in the colour of their light; dashed: the truth.",
                        lambda target: draw_maps(target, paper),
                    ),
                    Drawing(
                        "geometry.png",
                        "The same without intensity, and matching on lines. Grey cells: no intensity used.",
                        lambda target: draw_maps(target, rest),
                    ),
                ),
                file="methods",
            ),
            Section(
                "Figs. 5 and 6 where matching fails: flush walls, glass, sparse returns, quick turns, passers-by",
                *self.gate_table(),
                (
                    Drawing(
                        "gate.png",
                        "The farther apart pairs may lie, the more matching fails, and the more the gate saves.",
                        lambda target: draw_gate(target, widths, alone, gated, float(self.gate[0].ate.mean())),
                    ),
                ),
                file="gate",
            ),
            Section("Along flush walls: who knows how far the robot went", *self.along_table(), file="walls"),
            Section("How little can be known", *self.bounds_table(), file="bounds"),
            Section(
                "What a difference in intensity should count (Intensity-ICP)",
                *self.alpha_table(),
                (
                    Drawing(
                        "alpha.png",
                        "Error against alpha, and the alpha that each log tells of itself.",
                        lambda target: draw_alpha(
                            target, self.alpha.alphas, self.alpha.ate, self.alpha.estimate, self.alpha.at_estimate
                        ),
                    ),
                ),
                file="alpha",
            ),
            Section(
                f"Where am I: {1 + max((s.start for s in self.starts), default=-1)} logs of unknown start in a "
                "finished map",
                *starts_table(self.starts),
                file="starts",
            ),
        )

    @property
    def lead(self) -> str:
        return f"maps of a 200 m loop from scans with received light intensity, {self.errors.shape[1]} simulated drives"

    def error(self, name: str) -> float:
        """Mean ATE [m] of the method whose name, the number of particles left out, is `name`."""
        return float(self.drives(name).mean())

    def drives(self, name: str) -> Float[np.ndarray, " s"]:
        """ATE [m] of that method in each drive."""
        names = [m.name.replace(f"RBPF-{self.particles}", "RBPF") for m in self.methods]
        return np.asarray(self.errors[names.index(name)])

    def best(self, what: str, *, squared: bool = False) -> tuple[str, float]:
        """The method that errs least of those whose name tells `what`: its name, and its mean or rms ATE [m]."""
        known = [
            (m.name, _rms(e) if squared else float(e.mean()))
            for m, e in zip(self.methods, self.errors, strict=True)
            if what in m.name
        ]
        return min(known, key=lambda pair: pair[1])

    def refusals(self) -> tuple[int, int]:
        """Matches the gate refused in all gated rows, and how many of them rightly."""
        rows = [r for r in self.gate if r.name.startswith("gated")]
        return int(sum(r.outside.sum() for r in rows)), int(sum(r.rightly.sum() for r in rows))

    def measured(self) -> dict[str, str]:
        alone, gated = self.gate[-2], self.gate[-1]
        outside, rightly = self.refusals()
        name, geometry = self.best("geometry")
        most, light_error = self.best("intensity")
        ours = self.error("our RBPF, intensity")
        raw, geom = (self.error(f"paper's RBPF, {what}") for what in ("raw intensity", "geometry"))
        alphas, tried = self.alpha.estimate, self.alpha.ate.mean(axis=1)
        light, walls = counts(self.starts, "normalised"), counts(self.starts, "none")
        return {
            "starts": str(1 + max((s.start for s in self.starts), default=-1)),
            "bare_starts": str(walls.total()),
            "localised": "; ".join(
                f"{name}: {n['right']} right, {n['wrong']} wrong, {n['not sure']} not sure"
                for name, n in (("intensity", light), ("geometry", walls))
            ),
            "drives": str(self.errors.shape[1]),
            "odometry": f"{self.error('odometry'):.2f} m ATE",
            "icp": f"{self.error('Intensity-ICP'):.2f} m, ICP on geometry {self.error('ICP, geometry'):.2f} m",
            "gate": (
                f"{alone.ate.mean():.2f} m without, {gated.ate.mean():.2f} m with the gate (pairs up to "
                f"{gated.farthest:g} m); {rightly} of {outside} refusals right"
            ),
            "printed": f"{raw:.2f} m, on geometry {geom:.2f} m; Intensity-ICP {self.error('Intensity-ICP'):.2f} m",
            "ours": f"{ours:.3f} m",
            "feature": f"our filter {ours:.2f} m; raw intensity, the paper's filter {raw:.2f} m",
            "geometry": (
                f"{light_error:.3f} m ({most}): {light_error / geometry:.2f} x the best geometry ({name}, "
                f"{geometry:.2f} m), of which none can err less than {_rms(self.bounds.geometry):.2f} m"
            ),
            "alpha": (
                f"{alphas.min():.2f} to {alphas.max():.2f} found from the log: {self.alpha.at_estimate.mean():.2f} m; "
                f"best of {len(tried)} tried {tried.min():.2f} m, worst {tried.max():.2f} m"
            ),
        }

    def numbers(self) -> Numbers:
        """By the names of the rules: errors in metres, ratios of errors, shares."""
        odometry, icp = self.drives("odometry"), self.drives("Intensity-ICP")
        printed, ours = self.drives("paper's RBPF, raw intensity"), self.drives("our RBPF, intensity")
        narrow, alone, gated = self.gate[1], self.gate[-2], self.gate[-1]
        outside, rightly = self.refusals()
        light, walls = (self.best(what)[1] for what in ("intensity", "geometry"))
        square = self.best("intensity", squared=True)[1]
        bound = float(np.sqrt(np.mean(self.bounds.geometry**2)))
        seen, bare = counts(self.starts, "normalised"), counts(self.starts, "none")
        inside = [s.answer == "right" for s in self.starts if (s.feature, s.where) == ("normalised", "here")]
        return {
            "odometry": odometry.tolist(),
            "icp": (icp / odometry).tolist(),
            "gate_fails": [float(alone.ate.mean() / narrow.ate.mean())],
            "gate_saves": [float(gated.ate.mean() / alone.ate.mean())],
            "gate_right": [rightly / outside if outside else float("nan")],
            "printed": (printed / icp).tolist(),
            "ours": (ours / icp).tolist(),
            "geometry": [light / walls],
            "geometry_bound": [square / bound if bound > 0 else float("nan")],
            "alpha": [float(self.alpha.at_estimate.mean() / self.alpha.ate.mean(axis=1).min())],
            "feature": [float(ours.mean() / printed.mean())],
            "starts_wrong": [float(n["wrong"]) for n in (seen, bare)],
            "starts_right": [float(np.mean(inside)) if inside else float("nan")],
        }

    def differences(self) -> tuple[str, ...]:
        outside, rightly = self.refusals()
        floor, light = _rms(self.bounds.geometry), self.best("intensity", squared=True)[1]
        return sentences(
            WHY,
            default=self.error("our RBPF, geometry"),
            literal=self.error("paper's RBPF, geometry"),
            proposed=self.error("our RBPF, geometry, wheels propose"),
            graph=self.error("our graph, geometry, wheels known"),
            floor=floor,
            light=light,
            share=light / floor if floor > 0 else float("nan"),
            ideal=_rms(self.bounds.light),
            along=float(self.along[1].error.mean()),
            most=float(self.along[1].error.max()),
            wheels=float(self.along[0].error.mean()),
            outside=outside,
            rightly=rightly,
        )

    def draw(self, target: Target) -> None:
        """The maps of Figs. 4 to 7 side by side."""
        draw_maps(target, [p for p in self.pictures if p.figure])

    @property
    def metrics(self) -> dict[str, Any]:
        rows = [
            {
                "method": m.name,
                "figure": m.figure or None,
                "ate": e,
                "ate_mean": float(e.mean()),
                "ate_max": float(e.max()),
            }
            for m, e in zip(self.methods, self.errors, strict=True)
        ]
        gate = [
            {
                "method": r.name,
                "figure": r.figure,
                "farthest_pair": r.farthest,
                "nearest_pair": r.nearest,
                "ate": r.ate,
                "scans": int(r.scans.sum()),
                "too_few_pairs": int(r.few.sum()),
                "outside_gate": int(r.outside.sum()),
                "rightly": int(r.rightly.sum()),
                "wrong_inside": int(r.slipped.sum()),
            }
            for r in self.gate
        ]
        return {
            "version": __version__,
            "seed": self.seed,
            "quick": self.quick,
            "particles": self.particles,
            "methods": rows,
            "gate": gate,
            "along_walls": [{"method": r.name, "error_in_10_m": r.error} for r in self.along],
            "bounds": {"geometry": self.bounds.geometry, "intensity": self.bounds.light},
            "alpha": {
                "alphas": list(self.alpha.alphas),
                "ate": self.alpha.ate,
                "found": self.alpha.estimate,
                "ate_at_found": self.alpha.at_estimate,
            },
            "starts": [asdict(start) for start in self.starts],
            "notes": self.differences(),
            "claims": self.measured(),
            "timing": self.timing,
        }


def _rms(errors: Float[np.ndarray, " s"]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


@checked_arguments
@one_blas_thread()
@kept_parts()
def reproduce_hara(
    out: Path | str | None = None,
    *,
    quick: bool = False,
    seed: int = 0,
    force: bool = False,
    loop: CorridorConfig | None = None,
    on_progress: Progress = no_progress,
) -> HaraReproduction:
    """Run the experiments of Hara, Kawata, Ohya and Yuta: laser SLAM with received light intensity.

    Written to `out` if given; the same seed gives the same figures.

    Parameters
    ----------
    out
        The folder to write: tables, figures, claims and how they came out; an earlier result there is replaced whole.
    quick
        2 loops, 64 particles and 6 starts, not 6, 512 and 100 (False).
    loop
        The ring of corridor that is driven (the paper's kind).

    Raises
    ------
    UsageError
        For an `out` that holds something other than a result.
    """
    check_target(out, force=force)
    begun = perf_counter()
    particles, seeds = (64, 2) if quick else (512, 6)
    chosen = methods(particles)
    drives = range(seed, seed + seeds)
    errors, pictures = compare(chosen, drives, seed, on_progress, loop)
    hard = HARD if loop is None else replace(loop, drive=HARD.drive)
    gate = part(try_gate, drives, hard, on_progress=on_progress)
    along = part(try_along, drives, loop)
    bounds = part(try_bounds, drives, loop, on_progress=on_progress)
    alpha = part(alpha_curve, drives, loop, on_progress=on_progress)
    starts = part(try_starts, 6 if quick else 100, seed, SCANS, loop, on_progress=on_progress)
    timing = {"all": perf_counter() - begun}
    result = HaraReproduction(
        seed, quick, particles, chosen, errors, pictures, gate, along, bounds, alpha, starts, timing
    )
    return written(result, out, force=force)
