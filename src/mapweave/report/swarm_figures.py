"""Figures of a located swarm, readable for five robots and for ten thousand."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection

from ..core.gaussian import chi2_quantile
from ..evaluation.swarm import squared_errors
from ..swarm.moving.result import SwarmTrack
from ..swarm.network import BearingNetwork
from ..swarm.result import SwarmEstimate
from .style import PALETTE, SEQUENTIAL, TRUTH, Target, as_map, colour, figure, name_points

FEW = 60  # robots up to which each is named
MOST_ERRORS = 8  # robots whose errors are drawn over time
SOME = 1500  # up to which each has its ellipse and each sighting its line
BLUE, ORANGE, RED = PALETTE[0], PALETTE[1], PALETTE[5]
PLANES = {2: ((0, 1),), 3: ((0, 1), (0, 2))}


def network_figure(
    path: Target, net: BearingNetwork, estimate: SwarmEstimate, truth: Float[np.ndarray, "n d"] | None = None
) -> float:
    """The network as located, with 95 % ellipses drawn as many times larger as is returned."""
    planes = PLANES[net.dim]
    unit = "1" if "scale free" in estimate.gauge else "m"
    scale = _magnification(net, estimate)
    low, high = _limits(estimate.position[:, planes[0]], estimate.localisable)
    tall = float(np.clip((high - low)[1] / (high - low)[0], 0.35, 1.3))
    width = 7.2 if len(planes) == 1 else 5.5
    bar = len(net) > SOME and estimate.cov is not None
    with figure(path, width * len(planes) + 1.3 * bar, width * tall + 0.8, ncols=len(planes)) as (fig, axes):
        for k, (ax, plane) in enumerate(zip(np.atleast_1d(axes), planes, strict=True)):
            _plane(ax, net, estimate, truth, plane, scale)
            as_map(ax, unit=unit)
            ax.set_aspect("equal", adjustable="box")
            if plane[1] == 2:
                ax.set_ylabel(f"z [{unit}]")
            if k == 0:
                ax.set_title("Robots as located")
        shown = fig.axes[0].get_legend_handles_labels()
        fig.legend(*shown, loc="outside lower center", ncols=3)
        if bar:
            fig.colorbar(
                fig.axes[0].collections[0], ax=fig.axes[: len(planes)], label="standard deviation [m]", shrink=0.8
            )
    return 1.0 if bar else scale


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


def tracks_figure(
    path: Target, ids: tuple[str, ...], track: SwarmTrack, anchors: Any, truth: dict[int, Float[np.ndarray, "k d"]]
) -> None:
    """Every robot's trajectory; with truth, thin beneath."""
    with figure(path, 7.2, 6.4) as (_, ax):
        for k, one in track.tracks.items():
            tint = colour(k)
            if k in truth and k not in anchors:
                label = "truth" if not any(h == "truth" for h in ax.get_legend_handles_labels()[1]) else None
                ax.plot(truth[k][:, 0], truth[k][:, 1], color=TRUTH, lw=0.7, ls="--", label=label)
            if len(one.t) == 1 or k in anchors:
                ax.plot(*one.position[0, :2], "^", color=TRUTH, ms=6)
            else:
                ax.plot(one.position[:, 0], one.position[:, 1], color=tint, lw=1.3)
                ax.plot(*one.position[-1, :2], "o", color=tint, ms=4)
        if len(track.tracks) <= FEW:
            ends = np.array([one.position[-1, :2] for one in track.tracks.values()]).reshape(-1, 2)
            name_points(ax, [ids[k] for k in track.tracks], ends, 7)
        ax.plot([], [], "^", color=TRUTH, ls="none", label="stands still")
        ax.plot([], [], "o-", color=BLUE, label="trajectory, and where it ends")
        as_map(ax, "Robots over time")
        ax.legend(loc="best")


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


def _plane(
    ax: Axes,
    net: BearingNetwork,
    estimate: SwarmEstimate,
    truth: Float[np.ndarray, "n d"] | None,
    plane: tuple[int, int],
    scale: float,
) -> None:
    n, p = len(net), estimate.position[:, plane]
    lost, known = ~estimate.localisable, estimate.anchor
    free = ~lost & ~known
    std = None if estimate.cov is None else np.sqrt(np.trace(estimate.cov, axis1=1, axis2=2))
    if n > SOME:
        c = BLUE if std is None else std[free]
        ax.scatter(
            p[free, 0],
            p[free, 1],
            s=float(np.clip(6e4 / n, 1.0, 12.0)),
            c=c,
            cmap=None if std is None else SEQUENTIAL,
            linewidths=0,
            label="located",
            rasterized=True,
        )
    else:
        lines = np.stack([p[net.observer], p[net.target]], axis=1)
        wild = estimate.outlier
        ax.add_collection(LineCollection(list(lines[~wild]), colors="#C9CED6", linewidths=0.5, zorder=1))
        if wild.any():
            ax.add_collection(
                LineCollection(list(lines[wild]), colors=RED, linewidths=0.6, linestyles=":", zorder=1, label="outlier")
            )
        ax.plot(p[free, 0], p[free, 1], "o", color=BLUE, ms=_size(n), zorder=3, label="located")
        if estimate.cov is not None and free.any():
            _ellipses(ax, p[free], estimate.cov[free][:, plane][:, :, plane], scale)
    if truth is not None and not estimate.gauge and n <= FEW:
        q = truth[:, plane]
        ax.plot(q[:, 0], q[:, 1], "o", mfc="none", mec=TRUTH, mew=0.9, ms=_size(n) + 4, zorder=2, label="truth")
    if known.any():
        ax.plot(p[known, 0], p[known, 1], "^", color=TRUTH, ms=max(6.0, _size(n) + 2), zorder=4, label="anchor")
    if lost.any():
        label = f"cannot be located ({int(lost.sum())})"
        low, high = _limits(p, ~lost)
        edge = 0.02 * (high - low)
        p = np.where(lost[:, None], np.clip(p, low + edge, high - edge), p)
        ax.plot(p[lost, 0], p[lost, 1], "X", color=ORANGE, mec="#7A4A00", mew=0.5, ms=7, zorder=5, label=label)
    if n <= FEW:
        name_points(ax, net.ids, p)
    low, high = _limits(p, ~lost)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])


def _limits(p: np.ndarray, located: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits that the located robots set: a stray guess of one that is not cannot shrink the picture."""
    inner = p[located] if located.sum() > 1 else p
    low, high = inner.min(axis=0), inner.max(axis=0)
    room = max(0.12 * float((high - low).max()), 1e-9)
    return low - room, high + room


def _ellipses(ax: Axes, p: np.ndarray, cov: np.ndarray, scale: float) -> None:
    values, vectors = np.linalg.eigh(0.5 * (cov + cov.swapaxes(1, 2)))
    half = scale * np.sqrt(chi2_quantile(0.95, 2.0) * np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    ellipses = EllipseCollection(
        2 * half[:, 1],
        2 * half[:, 0],
        angle,
        units="xy",
        offsets=p,
        offset_transform=ax.transData,
        facecolors="none",
        edgecolors=BLUE,
        linewidths=0.8,
        zorder=2,
    )
    ax.add_collection(ellipses)
    ax.plot([], [], "-", color=BLUE, lw=0.8, label="95 % region" + (f", {scale:g} times larger" if scale != 1 else ""))


def _magnification(net: BearingNetwork, estimate: SwarmEstimate) -> float:
    """A round factor that makes the usual ellipse a fifth of the usual distance between robots, at least 1."""
    free = estimate.localisable & ~estimate.anchor
    if estimate.cov is None or not free.any():
        return 1.0
    std = float(np.median(np.sqrt(np.trace(estimate.cov[free], axis1=1, axis2=2))))
    both = estimate.localisable[net.observer] & estimate.localisable[net.target]
    if std <= 0.0 or not both.any():
        return 1.0
    gap = np.linalg.norm(estimate.position[net.target[both]] - estimate.position[net.observer[both]], axis=1)
    wanted = 0.1 * float(np.median(gap)) / std
    if wanted <= 1.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(s for s in (1.0, 2.0, 5.0) if s * power <= wanted * 1.0001) * power)


def _size(n: int) -> float:
    return float(np.clip(40.0 / np.sqrt(max(n, 1)), 2.0, 7.0))
