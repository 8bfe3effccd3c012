"""Swarms to move about in: robots that stand, with their ellipses and sightings, and robots that move, through time."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from ..core.records import Track
from ..swarm.moving.result import SwarmTrack
from ..swarm.network import BearingNetwork
from ..swarm.result import SwarmEstimate
from .scene import Scene, Shape
from .style import MUTED, PALETTE, TRUTH, colour
from .swarm_figures import SOME

LOCATED, LOST, OUTLIER = PALETTE[0], PALETTE[1], PALETTE[5]
PLANES = {2: ("x, y",), 3: ("x, y", "x, z")}
SIDES = {"x, y": [0, 1], "x, z": [0, 2]}


def network_scenes(net: BearingNetwork, estimate: SwarmEstimate, truth: Float[np.ndarray, "n d"] | None) -> list[Scene]:
    """One for each plane that is looked at: x and y, and x and z where robots fly."""
    return [_network(net, estimate, truth, plane) for plane in PLANES[net.dim]]


def told_network(net: BearingNetwork, estimate: SwarmEstimate, scale: float) -> str:
    """What the first of `network_scenes` shows; scale: how many times larger the picture beside draws ellipses."""
    if len(net) > SOME:
        told = "Robots as located, without their ellipses and sightings: there are too many."
    else:
        larger = f" figures/network.png draws them {scale:g} times larger." if scale != 1.0 else ""
        told = f"Robots as located, with 95 % ellipses.{larger}"
    if estimate.anchor.any():
        told += " Triangles are anchors."
    if not estimate.localisable.all():
        told += " Orange crosses are robots that cannot be located, drawn at a rough guess."
    return told


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
