"""The page that `locate` leaves: what was found, how sure it is, and who could not be located.

With swarms to move about in: robots that stand, with their ellipses and sightings, and robots that move, through time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..core.gaussian import chi2_quantile
from ..core.records import Track
from ..evaluation.swarm import squared_errors
from ..swarm.factors import bearing_factor, state
from ..swarm.moving.result import SwarmTrack
from ..swarm.network import BearingNetwork
from ..swarm.result import SwarmEstimate
from .html import Page
from .scene import Scene, Shape
from .style import MUTED, PALETTE, TRUTH, Target, as_map, colour, figure

FEW = 60  # robots up to which each is named
MOST_ERRORS = 8  # robots whose errors are drawn over time
SOME = 1500  # up to which each has its ellipse and each sighting its line
BLUE, ORANGE, RED = PALETTE[0], PALETTE[1], PALETTE[5]


def shape_figure(
    path: Path,
    net: BearingNetwork,
    estimate: SwarmEstimate,
    aligned: Float[np.ndarray, "n d"],
    truth: Float[np.ndarray, "n d"],
) -> None:
    """The paper's Fig. 4: the shape is right; beside it the same, brought onto the truth."""
    with figure(path, 10.0, 4.8, ncols=2) as (fig, axes):
        for ax, p, title, unit in (
            (axes[0], estimate.position, "As answered: place and scale are free", "1"),
            (axes[1], aligned, "The same shape, fitted to the truth", "m"),
        ):
            if p is aligned:
                ax.plot(truth[:, 0], truth[:, 1], "o", mfc="none", mec=TRUTH, ms=_size(len(net)) + 3, label="truth")
            ok = estimate.localisable
            ax.plot(p[ok, 0], p[ok, 1], "*", color=BLUE, ms=_size(len(net)), ls="none", label="located")
            as_map(ax, title, unit)
        fig.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2)


def deviation_figure(
    path: Path,
    estimate: SwarmEstimate,
    aligned: Float[np.ndarray, "n d"] | None,
    truth: Float[np.ndarray, "n d"] | None,
) -> None:
    """How sure each robot is; with truth, whether it is as sure as it should be."""
    assert estimate.cov is not None  # noqa: S101
    free = estimate.localisable & ~estimate.anchor
    std = np.sqrt(np.trace(estimate.cov[free], axis1=1, axis2=2))
    honest = truth is not None and aligned is not None and not estimate.gauge
    with figure(path, 9.5 if honest else 5.5, 3.6, ncols=2 if honest else 1) as (_, axes):
        ax = np.atleast_1d(axes)[0]
        unit = "1" if "scale free" in estimate.gauge else "m"
        if len(std) <= FEW // 2:
            names = [name for name, here in zip(estimate.ids, free, strict=True) if here]
            ax.barh(names, std, color=BLUE)
            ax.invert_yaxis()
        else:
            ax.hist(std, bins=min(60, max(8, len(std) // 5)), color=BLUE)
            ax.set_ylabel("robots")
        ax.set_title("Standard deviation of each robot")
        ax.set_xlabel("standard deviation, the scale being free" if unit == "1" else "standard deviation [m]")
        if honest and truth is not None and aligned is not None:
            e = (aligned - truth)[free]
            have = np.isfinite(e).all(axis=1)
            d = np.sort(squared_errors(e[have], estimate.cov[free][have]))
            share = (np.arange(len(d)) + 0.5) / max(len(d), 1)
            said = np.array([chi2_quantile(float(s), float(estimate.dim)) for s in share])
            axes[1].plot(said, d, ".", color=BLUE, ms=4)
            top = float(said.max(initial=1.0))
            axes[1].plot([0, top], [0, top], color=TRUTH, lw=1)
            axes[1].set_title("Squared errors over their covariances")
            axes[1].set_xlabel(f"chi-square quantile, {estimate.dim} degrees of freedom")
            axes[1].set_ylabel("found")


def residual_figure(
    path: Path, whitened: Float[np.ndarray, " r"], outlier: Bool[np.ndarray, " m"], left: float
) -> None:
    """Whitened residuals beside the density they should have; `left`: the variance that fitting leaves them."""
    with figure(path, 5.5, 3.6) as (_, ax):
        edge = 5.0
        ax.hist(
            np.clip(whitened, -edge, edge),
            bins=np.linspace(-edge, edge, int(np.clip(len(whitened) // 10, 11, 61))),
            density=True,
            color=BLUE,
        )
        x = np.linspace(-edge, edge, 200)
        ax.plot(x, np.exp(-0.5 * x * x / left) / np.sqrt(2.0 * np.pi * left), color=TRUTH, lw=1.2, label="expected")
        ax.set_title(f"Residuals over sigma ({int(outlier.sum())} outliers not used)")
        ax.set_xlabel("residual / sigma (beyond 5: at 5)")
        ax.set_ylabel("density")
        ax.legend()


def track_errors_figure(
    path: Target, ids: tuple[str, ...], track: SwarmTrack, truth: dict[int, Float[np.ndarray, "k d"]], anchors: Any
) -> None:
    """Errors over time and the two standard deviations that were promised."""
    t0 = min(float(one.t[0]) for one in track.tracks.values())
    with figure(path, 8.0, 3.8) as (_, ax):
        shown = [k for k in track.tracks if k in truth and k not in anchors][:MOST_ERRORS]
        for k in shown:
            one, tint = track.tracks[k], colour(k)
            error = np.linalg.norm(one.position - truth[k], axis=1)
            ax.plot(one.t - t0, error, color=tint, lw=0.9, label=ids[k])
            if one.cov is not None:
                ax.plot(one.t - t0, 2.0 * np.sqrt(np.trace(one.cov, axis1=1, axis2=2)), color=tint, lw=0.7, ls=":")
        ax.set_title("Position error (solid) and two standard deviations (dotted)")
        ax.set_xlabel("time [s]")
        ax.set_ylabel("error [m]")
        ax.set_ylim(bottom=0.0)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _size(n: int) -> float:
    return float(np.clip(40.0 / np.sqrt(max(n, 1)), 2.0, 7.0))


ROWS = 40  # robots listed on the page
FREE = "Known positions (--anchor) are too few to fix everything. The shape is found;"
MORE = "Two known positions fix it, or one and a known distance."


@dataclass(frozen=True, slots=True)
class NetworkStory:
    """What is drawn of robots that stand still. truth, aligned: (n, d) or None; `aligned` is the estimate as scored."""

    network: BearingNetwork
    estimate: SwarmEstimate
    truth: Float[np.ndarray, "n d"] | None = None
    aligned: Float[np.ndarray, "n d"] | None = None


@dataclass(frozen=True, slots=True)
class MovedStory:
    """What is drawn of robots that move. truth: by robot index, at the track's stamps."""

    ids: tuple[str, ...]
    track: SwarmTrack
    anchors: Mapping[int, Float[np.ndarray, " d"]]
    truth: Mapping[int, Float[np.ndarray, "k d"]]


def write_network_report(out: Path, story: NetworkStory, lines: Sequence[str], metrics: Mapping[str, Any]) -> None:
    """report.html and figures/ in `out`."""
    net, estimate = story.network, story.estimate
    figures = out / "figures"
    page = Page("Where every robot is", lines[0])
    page.cards(_cards(metrics, estimate), len(metrics["warnings"]))
    if estimate.gauge:
        page.text(f"{FREE} {estimate.gauge}. {MORE}", warn=True)
    page.section("The network")
    front, *sides = network_scenes(net, estimate, story.truth)
    page.scene(front, told_network(net, estimate), figures / "network.png", *sides)
    for side in sides:
        page.scene(side, "The same from the side.")
    page.warnings(metrics["warnings"])
    if estimate.gauge and story.truth is not None and story.aligned is not None:
        page.figure(
            figures / "shape.png",
            "The shape as answered, and fitted to the truth.",
            shape_figure,
            net,
            estimate,
            story.aligned,
            story.truth,
        )
    lost = estimate.not_localisable
    if lost:
        page.section("Robots that cannot be located")
        page.text(
            f"{len(lost)} of {len(estimate.ids)}: the sightings leave at least one direction of each free, whatever "
            f"the noise. {', '.join(lost[:200])}{', ..' if len(lost) > 200 else ''}"
        )
    free = estimate.localisable & ~estimate.anchor
    if estimate.cov is not None and free.any() and np.any(net.sigma > 0):
        page.section("How sure")
        page.figure(
            figures / "spread.png",
            "Standard deviations, and (with truth) whether errors are as large as they say.",
            deviation_figure,
            estimate,
            story.aligned,
            story.truth,
        )
    residuals = whitened(net, estimate)
    if np.any(net.sigma > 0) and len(residuals):
        page.section("Sightings")
        left = float(np.clip(estimate.dof / max(len(residuals), 1), 0.05, 1.0))
        page.figure(
            figures / "residuals.png",
            "Residuals of all sightings used, over their standard deviations.",
            residual_figure,
            residuals,
            estimate.outlier,
            left,
        )
    page.section("Robots")
    unit = "" if "scale free" in estimate.gauge else " [m]"
    page.table(["robot", *(f"{axis}{unit}" for axis in "xyz"[: net.dim]), f"sd{unit}", "located"], _robots(estimate))
    some = f"The {ROWS} least sure of {len(estimate.ids):,}; all stand in positions.csv. "
    page.text(f"{some if len(estimate.ids) > ROWS else ''}sd: standard deviation of the position, over all axes.")
    page.section("As the command told it")
    for text in lines:
        page.text(text)
    page.write(out / "report.html")


def write_moved_report(out: Path, story: MovedStory, lines: Sequence[str], metrics: Mapping[str, Any]) -> None:
    """report.html and figures/ in `out`."""
    figures = out / "figures"
    page = Page("Where every robot went", lines[0])
    page.cards(_cards(metrics), len(metrics["warnings"]))
    if story.track.gauge:
        page.text(f"{FREE} {story.track.gauge}. {MORE}", warn=True)
    page.section("Trajectories")
    truth = dict(story.truth)
    scene = moved_scene(story.ids, story.track, story.anchors, truth)
    page.scene(scene, "The trajectory of every robot, and its 95 % ellipse at the time shown.", figures / "tracks.png")
    page.warnings(metrics["warnings"])
    if truth and not story.track.gauge:
        track_errors_figure(figures / "errors.png", story.ids, story.track, truth, story.anchors)
        first = f" The first {MOST_ERRORS} robots." if len(truth) > MOST_ERRORS else ""
        page.figure(figures / "errors.png", f"Errors against the truth, and what the covariances promise.{first}")
    page.section("As the command told it")
    for text in lines:
        page.text(text)
    page.write(out / "report.html")


def whitened(net: BearingNetwork, estimate: SwarmEstimate) -> Float[np.ndarray, " r"]:
    """Residuals over sigma of the sightings used, between robots that could be located."""
    use = ~estimate.outlier & estimate.localisable[net.observer] & estimate.localisable[net.target]
    x = state(estimate.position, estimate.heading)
    return -bearing_factor(net.select(use)).whitened(x).ravel()


def _cards(metrics: Mapping[str, Any], estimate: SwarmEstimate | None = None) -> list[tuple[str, str]]:
    lost = len(metrics["not_localisable"])
    cards = [
        ("robots", f"{metrics['robots']:,}"),
        ("sightings", f"{metrics['sightings']:,}"),
        ("cannot be located", f"{lost:,}"),
        ("reliable", "yes" if metrics["reliable"] else "no"),
    ]
    if estimate is not None and estimate.cov is not None and "scale free" not in estimate.gauge:
        free = estimate.localisable & ~estimate.anchor
        if free.any():
            sd = np.median(np.sqrt(np.trace(estimate.cov[free], axis1=1, axis2=2)))
            cards.append(("median sd of a position", f"{sd:.3g} m"))
    for key, name, form in (
        ("rmse", "RMSE against the truth", "{:.3g} m"),
        ("rmse_over_crlb", "RMSE over the Cramér-Rao bound", "{:.2f}"),
        ("nees_per_dof", "NEES per degree of freedom (honest: 1)", "{:.2f}"),
        ("distance_error", "distance error", "{:.3g} m"),
        ("angle_error_deg", "angle error", "{:.3g}°"),
    ):
        if metrics.get(key) is not None:
            cards.append((name, form.format(metrics[key])))
    return cards


def _robots(estimate: SwarmEstimate) -> list[list[object]]:
    std = None if estimate.cov is None else np.sqrt(np.trace(estimate.cov, axis1=1, axis2=2))
    order = (
        np.arange(len(estimate.ids)) if std is None or len(std) <= ROWS else np.argsort(-np.nan_to_num(std, nan=np.inf))
    )
    return [
        [
            estimate.ids[k],
            *(float(v) for v in estimate.position[k]),
            None if std is None or not np.isfinite(std[k]) else float(std[k]),
            "anchor" if estimate.anchor[k] else "yes" if estimate.localisable[k] else "no",
        ]
        for k in order[:ROWS].tolist()
    ]


LOCATED, LOST, OUTLIER = PALETTE[0], PALETTE[1], PALETTE[5]
PLANES = {2: ("x, y",), 3: ("x, y", "x, z")}
SIDES = {"x, y": [0, 1], "x, z": [0, 2]}


def network_scenes(net: BearingNetwork, estimate: SwarmEstimate, truth: Float[np.ndarray, "n d"] | None) -> list[Scene]:
    """One for each plane that is looked at: x and y, and x and z where robots fly."""
    return [_network(net, estimate, truth, plane) for plane in PLANES[net.dim]]


def told_network(net: BearingNetwork, estimate: SwarmEstimate) -> str:
    """What the first of `network_scenes` shows."""
    if len(net) > SOME:
        caption = "Robots as located, without their ellipses and sightings: there are too many."
    else:
        caption = "Robots as located, with 95 % ellipses."
    if estimate.anchor.any():
        caption += " Triangles are anchors."
    if not estimate.localisable.all():
        caption += " Orange crosses are robots that cannot be located, drawn at a rough guess."
    return caption


def _network(net: BearingNetwork, estimate: SwarmEstimate, truth: Float[np.ndarray, "n d"] | None, plane: str) -> Scene:
    unit = "scale is free" if "scale free" in estimate.gauge else "in m"
    scene = Scene("Robots as located", hidden=["sightings left out"], axes=f"{plane} {unit}")
    side, p = SIDES[plane], estimate.position
    lost, known = ~estimate.localisable, estimate.anchor
    free = ~lost & ~known
    few = len(net) <= SOME
    if few:
        ends = np.concatenate([p[net.observer][:, side], p[net.target][:, side]], axis=1)
        sound = ~(lost[net.observer] | lost[net.target])
        for layer, rows, shade in (
            ("sightings", sound & ~estimate.outlier, MUTED),
            ("sightings left out", sound & estimate.outlier, OUTLIER),
        ):
            scene.lines(layer, ends[rows], shade, dashed=shade == OUTLIER)
    if truth is not None and not estimate.gauge:
        here = np.isfinite(truth).all(axis=1)
        scene.points("truth", _named(net, here), truth[here][:, side], TRUTH, named=False, shape="ring", stray=True)
    sd = None if estimate.cov is None else np.sqrt(np.trace(estimate.cov, axis1=1, axis2=2))
    kinds: tuple[tuple[str, Bool[np.ndarray, " n"], str, Shape], ...] = (
        ("located", free, LOCATED, "dot"),
        ("anchors", known, TRUTH, "triangle"),
        ("cannot be located, drawn at a guess", lost, LOST, "cross"),
    )
    for layer, rows, shade, shape in kinds:
        cov = estimate.cov[rows][:, side][:, :, side] if estimate.cov is not None and few and shape == "dot" else None
        scene.points(
            layer, _named(net, rows), p[rows][:, side], shade, cov=cov, shape=shape,
            stray=shape == "cross" and bool((~lost).sum() > 1), sd=None if sd is None or shape != "dot" else sd[rows],
        )  # fmt: skip
    return scene


def moved_scene(
    ids: tuple[str, ...],
    track: SwarmTrack,
    anchors: Mapping[int, Float[np.ndarray, " d"]],
    truth: Mapping[int, Float[np.ndarray, "k d"]],
) -> Scene:
    """Where everybody went, from above, through time."""
    unit = "scale is free" if "scale free" in track.gauge else "in m"
    scene = Scene("Where every robot went", hidden=["truth"], axes=f"x, y {unit}")
    still = [k for k, one in track.tracks.items() if len(one.t) == 1 or k in anchors]
    for k, true in truth.items():
        if k in track.tracks and k not in still and not track.gauge:
            scene.path("truth", true[:, :2], TRUTH)
    for k, one in track.tracks.items():
        if k in still:
            continue
        heading = np.zeros(len(one.t)) if one.heading is None else one.heading
        cov = None
        if one.cov is not None:
            cov = np.zeros((len(one.t), 3, 3))
            cov[:, :2, :2] = one.cov[:, :2, :2]
        way = Track(one.t, np.column_stack([one.position[:, :2], heading]), cov)
        scene.track("robots", ids[k], way, colour(k), heads=one.heading is not None)
    at = np.array([track.tracks[k].position[0, :2] for k in still]).reshape(-1, 2)
    scene.points("standing still", [ids[k] for k in still], at, TRUTH, shape="triangle")
    return scene


def _named(net: BearingNetwork, rows: Bool[np.ndarray, " n"]) -> list[str]:
    return [name for name, here in zip(net.ids, rows, strict=True) if here]
