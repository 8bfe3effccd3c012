"""What can be set about the trackers of laser logs: beams, matching, the particle filter, checks of the log."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from ..core.config import config, expect_positive
from ..core.errors import ConfigError
from ..core.findings import Finding
from ..core.laser_log import LEAST_RETURNS
from .beam import FEATURES, STEERING, BeamConfig, IntensityCalibration
from .icp import IcpConfig
from .moving import MovingConfig
from .odometry_calibration import OdometryCalibrationConfig
from .particle_grid import CellConfig
from .scan_matching import BARE_TANGENT, FrontEndConfig

FILTER_LEAST_BEAMS = LEAST_RETURNS  # scans with fewer returns change no weights

REFINE_NEFF = 60.0  # independent returns in a scan, for refining
REFINE_SIGMA = 0.02  # [m] sd of each return, for refining
REFINE_KAPPA = 0.1  # [m] width of the robust kernel
REFINE_BARE_TANGENT = 0.03  # weight of the error along a line, for refining without a feature
REFINE_SD_XY = 0.05  # [m] a particle may be moved by refining and
REFINE_SD_TURN = 0.01  # [rad] turned
FILTER_SIGMA = 0.05  # [m] sd of each return in the weights of particles
FILTER_SHARED = 0.5  # a beam counts when matched in this share of the particles
PAPER_SIGMA2 = 7e-4  # [m^2] sigma_z of the paper's likelihood

COARSEST = 2.0  # [m] cell of a map in which a robot could still drive
POSITIVE = (
    "gate", "resolution", "beam.greatest_range", "cells.size", "icp.gate", "icp.least_gate",
    "front_end.keyframes", "front_end.neff", "front_end.sd_xy", "front_end.sd_turn", "filter.neff", "filter.bare_neff",
)  # settings that divide  # fmt: skip
METHODS = ("particle", "graph", "gated", "icp")
LIKELIHOODS = ("matched", "paper")


@config
class FilterConfig:
    """The particle filter; a single map refined the same way is the `gated` method's.

    proposal "front end": particles move as scan matching says and every particle is refined against its own map;
    "odometry": they move as odometry says and are not refined, which is the paper's filter.
    """

    proposal: str = "front end"  # "front end": particles move as matching says and are refined; "odometry": the paper's
    update_distance: float = 0.4  # [m] moved, or
    update_turn: float = 0.4  # [rad] moved before weights and maps change
    sd_xy: float = 0.02  # [m] + sd_xy_per_m d: spread of the particles' moves
    sd_xy_per_m: float = 0.05  # and so much more a metre driven
    sd_turn: float = 0.005  # [rad] + sd_turn_per_m d
    sd_turn_per_m: float = 0.0  # [rad] and so much more a metre driven
    refine_iterations: int = 3  # Gauss-Newton steps of refining; 0: none
    refine_tangent: float = 0.1  # weight of the error along the line, with a feature
    neff: float = 30.0  # independent returns in a scan, for weighing, with a feature and
    bare_neff: float = 10.0  # and without a feature


@config
class LaserTrackingConfig:
    """Settings of one laser log's trackers: method, particle filter, matching, occupancy, checks."""

    method: str = "graph"  # how a log is mapped: graph, which alone closes loops, particle, gated or icp
    particles: int = 100  # hypotheses of the particle filter
    feature: str = "normalised"  # light sent back: normalised, raw or none
    likelihood: str = "matched"  # what weighs particles: matched, or as in the paper
    resample: float = 0.5  # when n_eff falls to this share of the particles; 1: always, as the paper does
    gate: float = 3.0  # a match may deviate from odometry by this many standard deviations in x, y and theta,
    gate_sd_xy: float = 0.07  # [m] standard deviation in place and
    gate_sd_turn: float = 0.07  # [rad] being added to those of the front end: odometry and scan may be stamped apart
    matcher: str = "map"  # of the gated method: "map" (Gauss-Newton on lines) or "icp" (the paper's)
    threads: int = 0  # 0: as many as there are free cores; the result is the same
    resolution: float = 0.1  # [m] cell of the map handed over
    beam: BeamConfig = BeamConfig()
    moving: MovingConfig = MovingConfig()
    odometry: OdometryCalibrationConfig = OdometryCalibrationConfig()
    cells: CellConfig = CellConfig()
    front_end: FrontEndConfig = FrontEndConfig()
    filter: FilterConfig = FilterConfig()
    icp: IcpConfig = IcpConfig()

    def eps(self, sd: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """How far [m, m, rad] a match may deviate from an odometry increment allowed `sd`."""
        return np.asarray(self.gate * (sd + np.array([self.gate_sd_xy, self.gate_sd_xy, self.gate_sd_turn])))

    def check(self) -> None:
        """Raises ConfigError for a word that is not known or a number out of range."""
        for name, known in (
            ("method", METHODS),
            ("feature", FEATURES),
            ("likelihood", LIKELIHOODS),
            ("matcher", ("map", "icp")),
        ):
            if (said := getattr(self, name)) not in known:
                raise ConfigError(f"{name}: expected one of {', '.join(known)}, found {said!r}")
        if self.filter.proposal not in {"front end", "odometry"}:
            raise ConfigError(f"filter.proposal: expected 'front end' or 'odometry', found {self.filter.proposal!r}")
        if self.particles < 1:
            raise ConfigError(f"particles: expected at least 1, found {self.particles}")
        if not 0.0 <= self.resample <= 1.0:
            raise ConfigError(f"resample: expected a share from 0 to 1, found {self.resample}")
        expect_positive(self, "laser", *POSITIVE)
        if self.resolution > COARSEST:
            raise ConfigError(f"resolution: expected at most {COARSEST:g} [m], found {self.resolution:g}")


PAPER_FILTER = FilterConfig(
    proposal="odometry",
    update_distance=0.0,
    update_turn=0.0,
    sd_xy=0.005,
    sd_xy_per_m=0.04,
    sd_turn=0.002,
    sd_turn_per_m=0.015,
    refine_iterations=0,
    bare_neff=30.0,
)
"""The paper's filter for wheels that are good over a step: odometry proposes, every scan weighs."""


C = TypeVar("C", bound=LaserTrackingConfig)


@dataclass(frozen=True, slots=True)
class Feature:
    """What q is made of in this log, and why not what was asked for."""

    name: str
    calibration: IntensityCalibration | None
    findings: tuple[Finding, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' texts."""
        return tuple(f.text for f in self.findings)


GEOMETRY = Feature("none", None)


def weighed(cfg: C, feature: Feature) -> C:
    """The settings with light counting for what it is worth: in matching, the particles' weights and moves, and ICP.

    What holds a scan along its wall and how many returns are independent lies between the settings without light and
    those with it; a difference of q counts the same share of alpha. At a weight of 1 they are `cfg`.
    """
    if feature.name not in STEERING or feature.calibration is None or feature.calibration.weight >= 1.0:
        return cfg
    w, front, f = feature.calibration.weight, cfg.front_end, cfg.filter

    def between(bare: float, lit: float) -> float:
        return bare + w * (lit - bare)

    return replace(
        cfg,
        cells=replace(cfg.cells, alpha=w * cfg.cells.alpha),
        icp=replace(cfg.icp, alpha=w * cfg.icp.alpha),
        front_end=replace(front, alpha=w * front.alpha, tangent=between(BARE_TANGENT, front.tangent)),
        filter=replace(
            f,
            neff=between(f.bare_neff, f.neff),
            refine_tangent=between(REFINE_BARE_TANGENT, f.refine_tangent),
        ),
    )
