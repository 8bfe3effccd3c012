"""What the paper claims, where each claim stands in the code, the test that holds it, and how it is judged."""

from ..reproduction import Claim
from ..verdicts import Check, Rule, question, rule

COMMAND = "reproduce kojima"
THEOREMS = "papers/test_relative_theorems.py"
EXPERIMENT = "papers/test_reproduce_kojima.py"


def _lower(name: str) -> Rule:
    return rule(
        Check(name, "share by which it is lower", least=0.01),
        Check(f"{name}_half", "that over the printed one", least=0.5),
    )


CLAIMS = (
    Claim(
        "Each robot maps its landmarks by EKF-SLAM (Figs. 4, 5)",
        "papers/kojima/world.py",
        "papers/test_kojima_world.py::test_local_maps_are_consistent_when_the_filter_is_told_the_truth_about_its_noise",
        "drawn",
        "local",
        "{worlds} worlds",
        COMMAND,
        rule(Check("local", "root mean square error [m]", most=0.01)),
    ),
    Claim(
        "Both weightings merge them into one map (Fig. 6)",
        "papers/kojima/rls.py",
        f"{EXPERIMENT}::test_both_weightings_put_every_landmark_within_centimetres_of_the_truth_and_of_each_other",
        "drawn",
        "merged",
        "{worlds} worlds",
        COMMAND,
        rule(Check("merged", "root mean square error [m], both", most=0.01)),
    ),
    Claim(
        "The proposed weights lower the robot's error (Table 2)",
        "papers/kojima/experiments.py",
        f"{EXPERIMENT}::test_in_the_papers_set_up_the_proposed_weights_differ_from_plain_rls_by_less_than_1_percent",
        "1.17 to 0.945 cm (-19 %)",
        "robot",
        "{worlds} worlds",
        COMMAND,
        _lower("robot"),
    ),
    Claim(
        "The proposed weights lower the landmarks' error (Table 2)",
        "papers/kojima/experiments.py",
        f"{EXPERIMENT}::test_in_the_papers_set_up_the_proposed_weights_differ_from_plain_rls_by_less_than_1_percent",
        "2.95 to 2.60 cm (-12 %)",
        "landmark",
        "{worlds} worlds",
        COMMAND,
        _lower("landmark"),
    ),
    Claim(
        "Weights from the maps' covariances pay (here: unequal maps, certain and widest pair)",
        "papers/kojima/unequal_maps.py",
        f"{EXPERIMENT}::test_weights_pay_when_maps_are_unequal_and_share_more_than_two_landmarks",
        "-12 %",
        "unequal",
        "{unequal_worlds} worlds",
        COMMAND,
        rule(Check("unequal", "error with eq. 14 and with full weights / without, both pairs", most=0.88)),
    ),
    Claim(
        "Theorem 1: the determinant of the covariance falls at every update",
        "papers/kojima/rls.py",
        f"{THEOREMS}::test_theorem_1_the_determinant_falls_strictly_with_every_update",
        "proved, Fig. 7",
        "falls",
        "{worlds} worlds, 700 updates",
        COMMAND,
        rule(Check("falls", "share of updates at which the trace falls, each weighting and reference", least=1.0)),
    ),
    Claim(
        "Theorem 2: the covariance converges to a constant",
        "papers/kojima/limits.py",
        f"{EXPERIMENT}::test_the_trace_falls_at_every_update_and_settles_only_when_map_1_is_the_prior",
        "proved, Fig. 7",
        "settles",
        "{worlds} worlds, 700 updates",
        COMMAND,
        rule(Check("settles", "limit of the trace, each weighting and reference", least=1e-6)),
    ),
    Claim(
        "Theorem 2: the constant is that of eqs. 24-27",
        "papers/kojima/limits.py",
        f"{THEOREMS}::test_the_printed_limit_is_exact_when_the_map_holds_every_landmark_and_wrong_otherwise",
        "proved",
        "closed",
        "{settled} maps",
        COMMAND,
        rule(Check("closed", "median difference / limit", most=0.01)),
    ),
    Claim(
        "Theorem 2, how fast: as 1/k from 100 updates on",
        "papers/kojima/settling.py",
        f"{THEOREMS}::test_under_the_papers_own_prior_the_error_falls_as_1_over_k_at_once_and_with_delta_80_only_later",
        "not told",
        "speed",
        "{settled} maps each",
        COMMAND,
        question(Check("speed", "spread of k times the error / its mean, both maps, δ = 1 and 80", most=0.05)),
    ),
    Claim(
        "Assumption 1: common landmarks are known; here they are found, and 98 of 100 believed from six in common on",
        "fusion/identities.py",
        f"{EXPERIMENT}::test_with_six_in_common_98_alignments_of_100_are_right_but_not_98_are_believed_and_none_wrongly",
        "assumed",
        "identities",
        "{trials} trials each",
        COMMAND,
        rule(
            Check("alignments", "share of alignments right, believed or not, from six in common on", least=0.98),
            Check("believed", "share believed and right", least=0.98),
            Check("wrong", "wrongly believed", most=0.0),
        ),
    ),
)
