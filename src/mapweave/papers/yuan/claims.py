"""What the paper claims, where each claim stands in the code, and the test that holds it."""

from ..reproduction import Claim

COMMAND = "reproduce yuan"
WHOLE = "exploration/test_exploration.py"
FIGURES = f"{WHOLE}::test_the_papers_planner_finishes_every_run_within_its_figures"
WRITTEN = "papers/test_reproduce_yuan.py"
FUSION = "exploration/test_submap_fusion.py"


def _claim(claim: str, code: str, test: str, printed: str, here: str, over: str = "{runs} runs") -> Claim:
    return Claim(claim, code, test, printed, here, over, COMMAND)


CLAIMS = (
    _claim("Every landmark is seen (Table 1)", "exploration/landmarks/team.py", FIGURES, "30 and 30 of 30", "all"),
    _claim(
        "Two robots: steps min / max / mean (Table 1)",
        "exploration/landmarks/objective.py",
        FIGURES,
        "208 / 371 / 296",
        "steps_two",
    ),
    _claim(
        "Two robots: map error and C/N (Table 1), calibrated noise",
        "fusion/handover.py",
        FIGURES,
        "0.282 m, 0.327 m²",
        "accuracy_two",
    ),
    _claim(
        "The same with the printed noise",
        "fusion/handover.py",
        f"{WHOLE}::test_with_the_printed_noise_robots_that_get_lost_find_back",
        "0.282 m",
        "printed_noise",
        "{few} runs",
    ),
    _claim(
        "One robot: steps min / max / mean (Table 1)",
        "exploration/landmarks/objective.py",
        FIGURES,
        "310 / 705 / 503",
        "steps_one",
    ),
    _claim(
        "One robot: map error and C/N (Table 1), calibrated noise",
        "fusion/handover.py",
        f"{WRITTEN}::test_with_all_noise_in_position_one_robot_errs_little_more_than_two",
        "0.361 m, 0.490 m²",
        "accuracy_one",
    ),
    _claim("One robot takes longer than two (Table 1)", "exploration/landmarks/team.py", FIGURES, "1.70", "efficiency"),
    _claim(
        "One robot maps less well than two (Table 1)",
        "exploration/landmarks/team.py",
        f"{WRITTEN}::test_with_all_noise_in_position_one_robot_errs_little_more_than_two",
        "1.28, 1.50",
        "accuracy",
    ),
    _claim(
        "Runs of two robots and of one (Figs. 1, 2)",
        "report/exploration.py",
        f"{WRITTEN}::test_the_tables_hold_the_papers_figures_and_every_case_ours",
        "drawn",
        "drawn",
        "a run each",
    ),
    _claim(
        "Nearest neighbours tell which landmark is which",
        "landmarks/association.py",
        f"{WRITTEN}::test_nearest_neighbours_make_an_honest_map_and_unsure_ones_most_of_the_wrong_matches",
        "used",
        "neighbour",
        "{few} runs",
    ),
    _claim(
        "Without the gain in area robots stay where they are (eq. 19, 20)",
        "exploration/landmarks/objective.py",
        f"{WHOLE}::test_the_area_term_is_worth_its_steps_with_the_same_escape_on_both_sides",
        "not told",
        "area",
        "{few} runs",
    ),
    _claim(
        "Without the escape to a frontier robots get caught",
        "exploration/landmarks/steering.py",
        f"{WHOLE}::test_without_the_escape_no_run_ends",
        "not told",
        "escape",
        "{few} runs",
    ),
    _claim(
        "The distance to the others' submaps makes the team more efficient (eq. 20)",
        "exploration/landmarks/objective.py",
        "exploration/test_planners.py::test_distance_to_a_hull_is_signed_and_works_for_a_segment_and_a_point",
        "not told",
        "apart",
        "{few} runs",
    ),
    _claim(
        "A robot that fails leaves the others at work",
        "exploration/landmarks/team.py",
        f"{WHOLE}::test_a_robot_that_dies_leaves_no_landmark_missed_and_an_honest_map",
        "not told",
        "dead",
        "{few} runs",
    ),
)
