"""Where the mathematics lives, which tests must notice a mistake in it, and the mistakes that change nothing."""

import re
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
HOUSE = HERE / "src" / "mapweave"


class GoneError(LookupError):
    """A source or a test that an area names is not where it is looked for."""


@dataclass(frozen=True)
class Area:
    """Sources, each the file of a room that defines a name (`room:name`), and the tests that must notice.

    `first` tells within seconds; `then` is asked about what `first` lets through. Mistakes in kernels are tried with
    nothing compiled in `first`, which takes less than compiling, but where `compiled` says that it does not.
    """

    name: str
    sources: tuple[str, ...]
    first: tuple[str, ...]
    then: tuple[str, ...] = ()
    compiled: bool = False

    def files(self) -> list[Path]:
        return sorted({defining(source) for source in self.sources})

    def check_tests(self) -> None:
        for test in (*self.first, *self.then):
            if not (HERE / test.split("::")[0]).exists():
                raise GoneError(f"area {self.name!r}: no test {test}")


def defining(source: str) -> Path:
    """The one file of the room whose top level defines the name of `room:name`."""
    room, _, name = source.partition(":")
    wanted = re.compile(rf"^(?:def|class) {name}\b|^{name}\b[^=\n]*=", re.MULTILINE)
    found = [f for f in sorted((HOUSE / room).rglob("*.py")) if wanted.search(f.read_text())]
    if len(found) != 1:
        where = ", ".join(f.relative_to(HOUSE).as_posix() for f in found) or "no file"
        raise GoneError(f"{source}: one file of {room}/ should define {name}, but {where} does")
    return found[0]


SUBMAPS = "tests/exploration/test_submap_fusion.py"
HAND_OVER = (
    "the_hand_over_residual_has_the_jacobian_of_its_differences",
    "a_hand_over_equals_conditioning_and_mapping_the_whole_map_and_submap",
    "a_submap_without_common_landmarks_leaves_the_old_ones_unchanged",
    "unknown_landmarks_are_recognised_and_duplicates_merged",
    "merging_two_pairs_of_duplicates_is_conditioning_on_both_at_once",
    "landmarks_that_one_submap_holds_apart_are_never_merged",
    "a_landmark_between_two_that_it_may_be_is_left_out",
    "a_landmark_that_may_be_new_stays_one_until_more_is_known",
    "distances_of_pairs_after_a_constraint_are_those_of_the_constrained_covariance",
    "of_two_that_a_landmark_may_be_the_one_known_well_is_merged_first",
    "pairs_are_weighed_together_with_the_covariance_of_all_their_differences_after_what_was_merged",
    "which_duplicates_are_surest_depends_on_the_covariances_of_the_pairs_themselves",
)

AREAS = (
    Area(
        "poses and Gaussians",
        ("core:composed_covariance", "core:joseph"),
        ("tests/core/test_se2.py", "tests/core/test_gaussian.py"),
        ("tests/solve", "tests/kernels/test_submap.py", "tests/fusion/test_submaps.py"),
    ),
    Area(
        "solver",
        (
            "solve:Cholesky",
            "solve:gauss_newton",
            "solve:dissect",
            "solve:Elimination",
            "solve:Information",
            "solve:minimise",
            "solve:Pattern",
            "solve:Factor",
            "solve:GemanMcClure",
        ),
        ("tests/solve",),
        ("tests/fusion/test_submaps.py",),
    ),
    Area(
        "landmark filter",
        (
            "kernels/landmarks:replay",
            "kernels/landmarks:pose_covariance",
            "kernels/landmarks:arc",
            "kernels/landmarks:trust",
            "kernels/landmarks:smooth",
            "kernels/landmarks:consider",
            "kernels/landmarks:quadratic",
        ),
        ("tests/kernels/test_ekf.py", "tests/kernels/test_ekf_drive_noise.py", "tests/kernels/test_ekf_smooth.py"),
        ("tests/landmarks",),
    ),
    Area(
        "association",
        ("landmarks:jcbb", "landmarks:pairing_probabilities"),
        (
            "tests/landmarks/test_association.py",
            "tests/landmarks/test_association_oracle.py",
            "tests/landmarks/test_pairing.py",
        ),
        ("tests/fusion/test_unknown_identities.py",),
    ),
    Area(
        "fusion",
        (
            "fusion:align_robust",
            "fusion:variance_factors",
            "fusion:fuse_relative",
            "fusion:baseline_pair",
            "fusion:Measurement",
            "fusion:JoinLayout",
            "fusion:MapTerm",
            "fusion:Consensus",
        ),
        (
            "tests/fusion/test_relative_information.py",
            "tests/fusion/test_relative_information_model.py",
            "tests/papers/test_relative_theorems.py",
            "tests/fusion/test_submaps.py",
            "tests/fusion/test_cluster.py",
            "tests/fusion/test_joint_fit.py",
            "tests/fusion/test_outlier_rejection.py",
        ),
        ("tests/fusion/test_join.py",),
    ),
    Area(
        "identities",
        ("fusion:joint_fit", "fusion:match_maps"),
        ("tests/fusion/test_joint_fit.py", "tests/fusion/test_identity_pieces.py"),
        ("tests/fusion/test_identities.py",),
    ),
    Area(
        "handover",
        ("fusion:hand_over", "fusion:MapAndSubmap"),
        tuple(f"{SUBMAPS}::test_{name}" for name in HAND_OVER),
        (SUBMAPS,),
    ),
    Area(
        "outlier rejection",
        ("fusion:find_outliers",),
        ("tests/fusion/test_outlier_rejection.py", "tests/fusion/test_cluster.py"),
        ("tests/fusion/test_join.py",),
    ),
    Area(
        "swarm",
        (
            "swarm:angle_jacobian",
            "swarm:bearing_factor",
            "swarm:linear_start",
            "swarm:contradictions",
            "swarm:normalise",
            "swarm:mutual_headings",
            "swarm:sighting_matrix",
        ),
        (
            "tests/swarm/test_bearing_model.py",
            "tests/swarm/test_factors.py",
            "tests/swarm/test_headings.py",
            "tests/swarm/test_gauge.py",
            "tests/swarm/test_network.py",
            "tests/swarm/test_contradiction.py",
            "tests/swarm/test_batch.py",
            "tests/swarm/test_free.py",
            "tests/swarm/test_linear.py",
            "tests/swarm/test_beacons.py",
            "tests/swarm/test_kalman.py",
        ),
        ("tests/swarm/test_anything.py", "tests/swarm/test_robust.py"),
    ),
    Area(
        "laser matching",
        (
            "kernels/laser:intensity_icp",
            "kernels/laser:score_field",
            "kernels/laser:align_scan",
            "kernels/laser:refine",
            "laser:FrontEnd",
        ),
        (
            "tests/kernels/test_align_scan.py",
            "tests/kernels/test_field.py",
            "tests/laser/test_scan_matching.py",
            "tests/laser/test_front_end.py",
            "tests/laser/test_match_information.py",
            "tests/laser/test_icp.py",
        ),
        ("tests/laser/test_icp_slam.py", "tests/laser/test_particle_slam.py"),
    ),
    Area(
        "particle filter",
        ("kernels/laser:systematic", "kernels/laser:inherit", "laser:log_likelihood"),
        ("tests/kernels/test_resample.py", "tests/kernels/test_tiles.py", "tests/laser/test_particle_pieces.py"),
        (
            "tests/laser/test_particle_ancestry.py",
            "tests/laser/test_particle_slam.py",
        ),
    ),
    Area(
        "closures and pose graph",
        ("laser:Closure", "laser:edge_factor", "laser:cycle_squares", "laser:solve_graph", "laser:step_covariance"),
        (
            "tests/laser/test_step_noise.py",
            "tests/laser/test_front_end.py",
            "tests/laser/test_consistency.py",
            "tests/laser/test_robust_graph.py",
            "tests/laser/test_closures.py",
        ),
        ("tests/laser/test_laser_team.py", "tests/laser/test_graph_slam.py"),
    ),
    Area(
        "place search",
        ("kernels/laser:branch_and_bound", "kernels/laser:lay_onto_lines", "laser:likelihood_field"),
        ("tests/laser/test_place_search.py",),
        ("tests/laser/test_merge.py",),
        compiled=True,
    ),
    Area(
        "joint pass",
        ("kernels/laser:refine_poses", "laser:joint_pass"),
        ("tests/laser/test_joint_pass.py",),
    ),
    Area(
        "team smoothing",
        (
            "team:CommandedMotion",
            "team:team_covariance",
            "team:step_factor",
            "team:team_problem",
            "team:sighting_factors",
            "team:scan_factor",
            "team:Smoothed",
        ),
        (
            "tests/team/test_commanded_motion.py",
            "tests/team/test_team_algebra.py",
            "tests/team/test_scan_factors.py",
            "tests/team/test_smooth_pieces.py",
            "tests/team/test_smoothing.py::test_all_derivatives_are_those_of_differences",
        ),
        ("tests/team/test_smoothing.py",),
    ),
    Area(
        "walls",
        ("kernels/walls:cast", "kernels/walls:cast_in_grid", "kernels/walls:mark_near", "kernels/walls:mark_in_sight"),
        (
            "tests/kernels/test_raycast.py",
            "tests/kernels/test_wall_grid.py",
            "tests/core/test_walls.py",
            "tests/kernels/test_sight.py",
        ),
    ),
    Area(
        "exploration",
        (
            "kernels/exploration:arc_points",
            "kernels/exploration:drive_laps",
            "kernels/exploration:expected_uncertainty",
            "kernels/exploration:improve_tours",
            "kernels/exploration:balanced_tours",
            "kernels/exploration:spread",
        ),
        (
            "tests/kernels/test_objective.py",
            "tests/kernels/test_arcs.py",
            "tests/kernels/test_wavefront.py",
            "tests/kernels/test_tour_moves.py",
            "tests/kernels/test_laps.py",
        ),
        ("tests/exploration/test_planners.py",),
    ),
)


@dataclass(frozen=True)
class Equivalent:
    """A mistake after which every result is the same, with the reason; `before` and `after` are whole lines."""

    source: str
    before: str
    after: str
    reason: str


EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "fusion:variance_factors",
        "last = np.abs(np.log(new / factors)).max() < VARIANCE_STILL or i == VARIANCE_ROUNDS - 1",
        "last = np.abs(np.log(new / factors)).max() < VARIANCE_STILL and i == VARIANCE_ROUNDS - 1",
        "the rounds go on after the factors stand still, and move them by less than that",
    ),
    Equivalent(
        "fusion:find_exchanged",
        "for a, b in zip(*linear_sum_assignment(np.minimum(distance, 1e3)), strict=True):",
        "for a, b in zip(*linear_sum_assignment(np.minimum(distance, 10000.0)), strict=True):",
        "distances beyond a kilometre, and those of what nobody else holds, are beyond every gate either way",
    ),
    Equivalent(
        "fusion:find_exchanged",
        "weight = np.where(self.counts, 1.0, 1e-9) * here",
        "weight = np.where(self.counts, 10.0, 1e-9) * here",
        "what counts outweighs what does not a thousand million times or ten thousand million times",
    ),
    Equivalent(
        "fusion:match_maps",
        "matches.append((-len(match.links), match.chi2 / max(match.dof, 1), a, b, match.links))",
        "matches.append((-len(match.links), match.chi2 / (match.dof), a, b, match.links))",
        "a match is accepted with several links alone, whose chi-square has more than one degree of freedom",
    ),
    Equivalent(
        "kernels/laser:align_scan",
        "if d0 * d0 + d1 * d1 < 1e-10 and abs(d2) < 1e-5:",
        "if d0 * d0 + d1 * d1 < 1e-10 and abs(d2) < 0.0001:",
        "a search whose last step was below what any scan tells ends one step sooner",
    ),
    Equivalent(
        "kernels/exploration:balanced_tours",
        "if shorter < length - 1e-9:",
        "if shorter < length:",
        "the margin keeps orders of equal length from being exchanged for rounding; they are as long",
    ),
    Equivalent(
        "fusion:joint_fit",
        "blocks = Q.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)] + 1e-12 * np.eye(2)",
        "blocks = Q.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)] - 1e-12 * np.eye(2)",
        "far below the rounding of information in metres, it only keeps zero from being divided by",
    ),
    Equivalent(
        "fusion:baseline_pair",
        "return H.reshape((*d.shape[:-2], 2 * n, 3 + 2 * n))",
        "return H.reshape((*d.shape[:-2], 2 * n, 3 - 2 * n))",
        "any length below zero is the one that is left to find, and that is 3 + 2 n",
    ),
    Equivalent(
        "laser:cycle_squares",
        "squares = np.where(np.tri(n, k=-1, dtype=bool).T, squares, 0.0)",
        "squares = np.where(np.tri(n, k=-1, dtype=bool), squares, 0.0)",
        "the same cycles run the other way round: to first order, which is all a covariance tells, the same square",
    ),
    Equivalent(
        "kernels/walls:mark_in_sight",
        "if (ring - 1) * cell > best:",
        "if (-(1)) * cell > best:",
        "rings beyond the best view are looked at too, and nothing there can be nearer",
    ),
    Equivalent(
        "kernels/walls:cast_in_grid",
        "c0, c1 = _index(min(x0, x1) - SLACK, cell, cols), _index(max(x0, x1) + SLACK, cell, cols)",
        "c0, c1 = _index(min(x0, x1) + SLACK, cell, cols), _index(max(x0, x1) + SLACK, cell, cols)",
        "a wall on a border is in the bucket beyond it still, which every beam that meets the wall enters",
    ),
    Equivalent(
        "fusion:find_exchanged",
        "for a, b in zip(*linear_sum_assignment(np.minimum(distance, 1e3)), strict=True):",
        "for a, b in zip(*linear_sum_assignment((distance)), strict=True):",
        "distances beyond a kilometre, and those of what nobody else holds, are beyond every gate either way",
    ),
    Equivalent(
        "solve:Cholesky",
        "Z[:p, :p] = 0.5 * (own + own.T)",
        "Z[:p, :p] = 0.5 * (own + own)",
        "both halves are the same but for rounding",
    ),
    Equivalent(
        "fusion:align_robust",
        "if n * (n - 1) // 2 <= HYPOTHESES:",
        "if n * (n) // 2 <= HYPOTHESES:",
        "it asks another way of 35 points alone, whose spread is all pairs as well",
    ),
    Equivalent(
        "fusion:MapAndSubmap",
        "return [], frozenset()",
        "pass",
        "without any pair the way on ends at the same return, which comes twice",
    ),
    Equivalent(
        "core:log",
        "d = np.where(small, 1.0, w)",
        "d = np.where(small, 10.0, w)",
        "where the turn is small the series stands, and this only keeps zero from being divided by",
    ),
    Equivalent(
        "core:align",
        "a, b = source - ms, target - mt",
        "a, b = source - ms, target",
        "products with points that lie about their own middle sum to the same wherever the others' middle is",
    ),
    Equivalent(
        "core:align",
        "a, b = source - ms, target - mt",
        "a, b = source, target - mt",
        "products with points that lie about their own middle sum to the same wherever the others' middle is",
    ),
    Equivalent(
        "core:align",
        "a, b = source - ms, target - mt",
        "a, b = source - ms, target + mt",
        "products with points that lie about their own middle sum to the same wherever the others' middle is",
    ),
    Equivalent(
        "core:align",
        "a, b = source - ms, target - mt",
        "a, b = source + ms, target - mt",
        "products with points that lie about their own middle sum to the same wherever the others' middle is",
    ),
    Equivalent(
        "solve:minimise",
        "damping, raised = damping * max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3), 2.0",
        "damping, raised = damping * max(1 / 3, 1 - (2 * (gain) - 1) ** 3), 2.0",
        "where the gain is more than one, the damping falls to a third either way; the bound keeps the cube finite",
    ),
    Equivalent(
        "kernels/exploration:lap_sightings",
        "if dx * dx + dy * dy > SURELY_BEYOND * reach * reach:",
        "if dx * dx > SURELY_BEYOND * reach * reach:",
        "a look that is surely beyond is left without asking exactly; those that are asked are not in view either",
    ),
    Equivalent(
        "kernels/exploration:lap_sightings",
        "if dx * dx + dy * dy > SURELY_BEYOND * reach * reach:",
        "if (dy * dy) > SURELY_BEYOND * reach * reach:",
        "a look that is surely beyond is left without asking exactly; those that are asked are not in view either",
    ),
    Equivalent(
        "team:team_covariance",
        "information = term.normal(x)[0] + TINY * np.eye(term.columns.shape[1])",
        "information = term.normal(x)[0] - TINY * np.eye(term.columns.shape[1])",
        "far below the information of any prior, and lost in its rounding",
    ),
    Equivalent(
        "solve:Pattern",
        "if 4 * len(where) > len(into):",
        "if 4 * len(where) <= len(into):",
        "both ways add up the same numbers in the same order; the choice is one of time alone",
    ),
    Equivalent(
        "solve:Pattern",
        "if 4 * len(where) > len(into):",
        "if 4 / len(where) > len(into):",
        "both ways add up the same numbers in the same order; the choice is one of time alone",
    ),
    Equivalent(
        "kernels/laser:intensity_icp",
        "ix0, ix1 = max(cell_of((bx - reach) * inverse), 0), min(cell_of((bx + reach) * inverse), cols - 1)",
        "ix0, ix1 = max(cell_of((-(reach)) * inverse), 0), min(cell_of((bx + reach) * inverse), cols - 1)",
        "cells farther left are looked into too, and nothing there is nearer",
    ),
    Equivalent(
        "team:Smoothed",
        "span = np.maximum(at[k + 1] - at[k], 1e-9) if len(at) > 1 else np.ones(len(t))",
        "span = (at[k + 1] - at[k]) if len(at) > 1 else np.ones(len(t))",
        "a robot's instants are stamps that differ by more",
    ),
    Equivalent(
        "solve:minimise",
        "if cfg.damping == 0 or new < cost or (small and new <= cost * (1 + ROUNDING)):",
        "if cfg.damping == 0 or new < cost or (small and new <= cost / (1 + ROUNDING)):",
        "a step below the tolerance that changes the cost by rounding is left instead of taken; both end converged",
    ),
)


@dataclass(frozen=True)
class Named:
    """A mistake that tests once let pass, and the tests that find it now; `before` and `after` are whole lines."""

    source: str
    before: str
    after: str
    tests: tuple[str, ...]


DRIVE, CLOSURES = ("tests/kernels/test_ekf_drive_noise.py",), ("tests/laser/test_closures.py",)
JOINT = ("tests/landmarks/test_association.py",)
IDENTITY = ("tests/fusion/test_joint_fit.py", "tests/fusion/test_identity_pieces.py")
PARTICLES = ("tests/kernels/test_resample.py", "tests/laser/test_particle_pieces.py")

ONCE_LET_PASS: tuple[Named, ...] = (
    Named(
        "kernels/landmarks:arc",
        "Q[0, 1] += dx * q02 - dy * q12 - dx * dy * q22",
        "Q[0, 1] += dx * q02 - dy * q12 + dx * dy * q22",
        DRIVE,
    ),
    Named(
        "kernels/landmarks:arc",
        "rest = noise.rest_xy * noise.rest_xy * dt",
        "rest = noise.rest_xy * noise.rest_xy",
        DRIVE,
    ),
    Named(
        "fusion:variance_factors",
        "return np.asarray(np.clip(out, VARIANCE_LEAST, VARIANCE_GREATEST))",
        "return np.asarray(out)",
        ("tests/fusion/test_submaps.py",),
    ),
    Named("landmarks:jcbb", "if self.limits[len(pairs)] > D:", "if True:", JOINT),
    Named(
        "landmarks:jcbb",
        "limits = [chi2_quantile(float(probability), float(d * (k + 1))) for k in range(m)]",
        "limits = [chi2_quantile(float(probability), float(d)) for k in range(m)]",
        JOINT,
    ),
    Named(
        "fusion:joint_fit",
        "self.floor, self.scale_information = 2 * noise**2 * np.eye(len(a)), scale_sigma**-2",
        "self.floor, self.scale_information = 2 * noise**2 * np.eye(len(a)), 1e12",
        IDENTITY,
    ),
    Named(
        "fusion:joint_fit",
        "V = self.Pb + C @ self.Pa @ C.T + self.floor",
        "V = self.Pb + self.Pa + self.floor",
        IDENTITY,
    ),
    Named(
        "fusion:match_maps",
        "return np.asarray(cfg.gate * np.sqrt(both + (scale * off[:, None]) ** 2))",
        "return np.asarray(cfg.gate * np.sqrt(both + 0.0 * off[:, None]))",
        IDENTITY,
    ),
    Named(
        "swarm:contradictions",
        "bad[rows] = off > CONSISTENCY_GATE * sigma[rows]",
        "bad[rows] = off > 10 * cfg.gate * sigma[rows]",
        ("tests/swarm/test_contradiction.py",),
    ),
    Named(
        "kernels/laser:align_scan",
        "return pose, rotate_information(H, R), cost",
        "return pose, H.copy(), cost",
        ("tests/laser/test_match_information.py",),
    ),
    Named(
        "kernels/walls:cast",
        "if np.hypot(mx - px, my - py) <= far + half:",
        "if np.hypot(mx - px, my - py) <= far:",
        ("tests/kernels/test_raycast.py",),
    ),
    Named(
        "kernels/laser:systematic",
        "while drawn < n and drawn + u < sum_to:",
        "while drawn < n and drawn + 0.5 < sum_to:",
        PARTICLES,
    ),
    Named(
        "laser:log_likelihood",
        "state.poses, state.total = state.poses[ancestors], state.total[ancestors]",
        "state.poses = state.poses[ancestors]",
        PARTICLES,
    ),
    Named(
        "solve:minimise",
        "if cfg.damping == 0 or new < cost or (small and new <= cost * (1 + ROUNDING)):",
        "if cfg.damping == 0 or new < 1.01 * cost or (small and new <= cost * (1 + ROUNDING)):",
        ("tests/solve/test_minimise.py",),
    ),
    Named("laser:Closure", "if nis > CLOSURE_GATE:", "if nis > 100 * CLOSURE_GATE:", CLOSURES),
    Named("laser:Closure", "if values[1] < CLOSURE_LEAST_INFORMATION:", "if False:", CLOSURES),
    Named(
        "mapping:KeyframeGraph",
        "C = se2.turned_covariance(-(self.pose[a, 2] - self.pose[k, 2]), C)",
        "C = np.asarray(C)",
        CLOSURES,
    ),
    Named(
        "laser:step_covariance",
        "J = R @ np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])",
        "J = R @ np.array([[1.0, 0.0, step[1]], [0.0, 1.0, -step[0]], [0.0, 0.0, 1.0]])",
        CLOSURES,
    ),
    Named(
        "laser:step_covariance",
        "scatter = 0.5 * blur * (lines[0, 0] + lines[1, 1])",
        "scatter = 0.0",
        CLOSURES,
    ),
    Named(
        "mapping:LoopSearch",
        "near &= (robot != node.robot) | (graph.path[:n] < node.path - CLOSURE_FAR)",
        "near &= robot == robot",
        CLOSURES,
    ),
)
