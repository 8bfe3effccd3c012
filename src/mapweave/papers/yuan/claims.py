"""What the paper claims, where each claim stands in the code, and the test that holds it."""

from ..reproduction import Claim, Verdict

COMMAND = "reproduce yuan"
WHOLE = "exploration/test_exploration.py"
FIGURES = f"{WHOLE}::test_the_papers_planner_finishes_every_run_within_its_figures"
WRITTEN = "papers/test_reproduce_yuan.py"
FUSION = "exploration/test_submap_fusion.py"


def _claim(
    verdict: Verdict, claim: str, code: str, test: str, printed: str, here: str, over: str = "{runs} runs"
) -> Claim:
    return Claim(claim, code, test, printed, here, over, COMMAND, verdict)


CLAIMS = (
    _claim(
        "holds", "Every landmark is seen (Table 1)", "exploration/landmarks/team.py", FIGURES, "30 and 30 of 30", "all"
    ),
    _claim(
        "holds",
        "Two robots: steps min / max / mean (Table 1)",
        "exploration/landmarks/objective.py",
        FIGURES,
        "208 / 371 / 296",
        "steps_two",
    ),
    _claim(
        "in part",
        "Two robots: map error and C/N (Table 1), calibrated noise",
        "fusion/handover.py",
        FIGURES,
        "0.282 m, 0.327 m²",
        "accuracy_two",
    ),
    _claim(
        "does not hold",
        "The same with the printed noise",
        "fusion/handover.py",
        f"{WHOLE}::test_with_the_printed_noise_robots_that_get_lost_find_back",
        "0.282 m",
        "printed_noise",
        "{few} runs",
    ),
    _claim(
        "holds",
        "One robot: steps min / max / mean (Table 1)",
        "exploration/landmarks/objective.py",
        FIGURES,
        "310 / 705 / 503",
        "steps_one",
    ),
    _claim(
        "does not hold",
        "One robot: map error and C/N (Table 1), calibrated noise",
        "fusion/handover.py",
        f"{WRITTEN}::test_with_all_noise_in_position_one_robot_errs_little_more_than_two",
        "0.361 m, 0.490 m²",
        "accuracy_one",
    ),
    _claim(
        "holds",
        "One robot takes longer than two (Table 1)",
        "exploration/landmarks/team.py",
        FIGURES,
        "1.70",
        "efficiency",
    ),
    _claim(
        "holds",
        "One robot maps less well than two (Table 1)",
        "exploration/landmarks/team.py",
        f"{WRITTEN}::test_with_all_noise_in_position_one_robot_errs_little_more_than_two",
        "1.28, 1.50",
        "accuracy",
    ),
    _claim(
        "holds",
        "Runs of two robots and of one (Figs. 1, 2)",
        "report/exploration.py",
        f"{WRITTEN}::test_the_tables_hold_the_papers_figures_and_every_case_ours",
        "drawn",
        "drawn",
        "a run each",
    ),
    _claim(
        "holds",
        "Nearest neighbours tell which landmark is which",
        "landmarks/association.py",
        f"{WRITTEN}::test_nearest_neighbours_make_an_honest_map_and_unsure_ones_most_of_the_wrong_matches",
        "used",
        "neighbour",
        "{few} runs",
    ),
    _claim(
        "in part",
        "Without the gain in area robots stay where they are (eq. 19, 20)",
        "exploration/landmarks/objective.py",
        f"{WHOLE}::test_the_area_term_is_worth_its_steps_with_the_same_escape_on_both_sides",
        "not told",
        "area",
        "{few} runs",
    ),
    _claim(
        "holds",
        "Without the escape to a frontier robots get caught",
        "exploration/landmarks/steering.py",
        f"{WHOLE}::test_without_the_escape_no_run_ends",
        "not told",
        "escape",
        "{few} runs",
    ),
    _claim(
        "does not hold",
        "The distance to the others' submaps makes the team more efficient (eq. 20)",
        "exploration/landmarks/objective.py",
        "exploration/test_planners.py::test_distance_to_a_hull_is_signed_and_works_for_a_segment_and_a_point",
        "not told",
        "apart",
        "{few} runs",
    ),
    _claim(
        "does not hold",
        "The accuracy term makes the map more accurate (eq. 17, 20)",
        "exploration/landmarks/objective.py",
        f"{WRITTEN}::test_the_tables_hold_the_papers_figures_and_every_case_ours",
        "not told",
        "careful",
        "{few} runs",
    ),
    _claim(
        "holds",
        "Submaps are independent: fusing one leaves the other robots' as they are (eq. 13 to 16)",
        "fusion/handover.py",
        f"{FUSION}::test_a_fusion_keeps_the_covariance_symmetric_and_touches_no_other_submap",
        "proved",
        "independent",
        "{few} runs",
    ),
    _claim(
        "holds",
        "A robot that fails leaves the others at work",
        "exploration/landmarks/team.py",
        f"{WHOLE}::test_a_robot_that_dies_leaves_no_landmark_missed_and_an_honest_map",
        "not told",
        "dead",
        "{few} runs",
    ),
)
