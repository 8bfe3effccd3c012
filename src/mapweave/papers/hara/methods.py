"""The methods of Hara, Kawata, Ohya and Yuta as configurations of ours, and how a map is scored."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...core.records import Track
from ...evaluation.trajectory import align_tracks, ate
from ...laser.config import PAPER_FILTER
from ...laser.scan_matching import FrontEndConfig
from ...mapping.config import LaserConfig

# What a gate allows wheels like the simulated ones, which err by a few per cent: the paper's "found by experience".
WHEELS = FrontEndConfig(sd_xy=0.01, sd_xy_per_m=0.06, sd_turn=0.01, sd_turn_per_m=0.02, sd_turn_per_rad=0.05)
ICP = LaserConfig(method="icp")
GATED = LaserConfig(method="gated", matcher="icp", front_end=WHEELS, gate_sd_xy=0.0, gate_sd_turn=0.0)
# The paper's filter to the letter: raw intensity, eqs. 7 to 9, every scan weighs and is followed by resampling.
PRINTED = LaserConfig(method="particle", feature="raw", filter=PAPER_FILTER, likelihood="paper", resample=1.0)
# Odometry proposes as in the paper, each particle is then refined across the walls of its own map: of all ways to map
# without light that were tried the one that errs least on wheels that are good over a step.
WHEELS_PROPOSE = replace(PAPER_FILTER, refine_iterations=3)

GRAPH = LaserConfig()
WHEELS_KNOWN = replace(GRAPH, feature="none", front_end=WHEELS)  # told how good the wheels are; no light


class Method(NamedTuple):
    """figure: of the paper, where it shows one; rims: whether the poses found are then moved until walls and rims of
    light are seen in one place each.
    """

    name: str
    figure: str
    cfg: LaserConfig | None  # None: odometry alone
    rims: bool = False


def methods(particles: int) -> tuple[Method, ...]:
    """In the order of the paper; matching and filtering with geometry alone and with intensity."""
    ours = LaserConfig(method="particle", particles=particles)
    printed = replace(PRINTED, particles=particles)
    return (
        Method("odometry", "Fig. 4", None),
        Method("ICP, geometry", "", replace(ICP, feature="none")),
        Method("Intensity-ICP", "Fig. 5", ICP),
        Method("gated ICP, geometry", "", replace(GATED, feature="none")),
        Method("gated Intensity-ICP", "Fig. 6", GATED),
        Method("gated, on lines, intensity", "", LaserConfig(method="gated")),
        Method(f"paper's RBPF-{particles}, geometry", "", replace(printed, feature="none")),
        Method(f"paper's RBPF-{particles}, raw intensity", "Fig. 7", printed),
        Method(f"our RBPF-{particles}, geometry", "", replace(ours, feature="none")),
        Method(
            f"our RBPF-{particles}, geometry, wheels propose", "", replace(ours, feature="none", filter=WHEELS_PROPOSE)
        ),
        Method(f"our RBPF-{particles}, intensity", "Fig. 7, ours", ours),
        Method("our graph, geometry", "", replace(GRAPH, feature="none")),
        Method("our graph, geometry, wheels known", "", WHEELS_KNOWN),
        Method("our graph, intensity", "", GRAPH),
        Method("our graph, intensity, rims", "", GRAPH, rims=True),
    )


def score(track: Track, truth: Track) -> float:
    """ATE [m] after one rigid alignment."""
    T = align_tracks([(track, truth, True)])
    error, _ = ate(track, truth, T if T is not None else np.zeros(3), dense=True)
    return float("nan") if error is None else error
