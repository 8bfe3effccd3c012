"""What the paper claims, where each claim stands in the code, the test that holds it, and how it is judged."""

from ..reproduction import Claim
from ..verdicts import Check, Rule, Typed, rule

COMMAND = "reproduce yuan"
WHOLE = "exploration/test_exploration.py"
FIGURES = f"{WHOLE}::test_the_papers_planner_finishes_every_run_within_its_figures"
WRITTEN = "papers/test_reproduce_yuan.py"
JUDGED = "papers/test_yuan_claims.py"
FUSION = "exploration/test_submap_fusion.py"


def _claim(
    judged: Rule | Typed, claim: str, code: str, test: str, printed: str, here: str, over: str = "{runs} runs"
) -> Claim:
    return Claim(claim, code, test, printed, here, over, COMMAND, judged)


def _more(name: str, says: str) -> Rule:
    """More by 5 %: less is not told from chance by so few runs."""
    return rule(Check(name, says, least=1.05))


CLAIMS = (
    _claim(
        rule(Check("finished", "share of runs, two robots and one", least=1.0)),
        "Every landmark is seen (Table 1)",
        "exploration/landmarks/team.py",
        FIGURES,
        "30 and 30 of 30",
        "all",
    ),
    _claim(
        rule(Check("steps_two", "each of three / printed", 0.8, 1.25)),
        "Two robots: steps min / max / mean (Table 1)",
        "exploration/landmarks/objective.py",
        FIGURES,
        "208 / 371 / 296",
        "steps_two",
    ),
    _claim(
        rule(Check("accuracy_two", "each of both / printed", most=1.25)),
        "Two robots: map error and C/N (Table 1), calibrated noise",
        "fusion/handover.py",
        FIGURES,
        "0.282 m, 0.327 m²",
        "accuracy_two",
    ),
    _claim(
        rule(Check("printed_noise", "map error and C/N / printed", most=1.25)),
        "The same with the printed noise",
        "fusion/handover.py",
        f"{WHOLE}::test_with_the_printed_noise_robots_that_get_lost_find_back",
        "0.282 m",
        "printed_noise",
        "{few} runs",
    ),
    _claim(
        rule(Check("steps_one", "each of three / printed", 0.8, 1.25)),
        "One robot: steps min / max / mean (Table 1)",
        "exploration/landmarks/objective.py",
        FIGURES,
        "310 / 705 / 503",
        "steps_one",
    ),
    _claim(
        rule(Check("accuracy_one", "each of both / printed", most=1.25)),
        "One robot: map error and C/N (Table 1), calibrated noise",
        "fusion/handover.py",
        f"{JUDGED}::test_one_robot_errs_and_is_unsure_by_more_than_a_quarter_beyond_the_print",
        "0.361 m, 0.490 m²",
        "accuracy_one",
    ),
    _claim(
        _more("efficiency", "steps of one / of two"),
        "One robot takes longer than two (Table 1)",
        "exploration/landmarks/team.py",
        FIGURES,
        "1.70",
        "efficiency",
    ),
    _claim(
        _more("accuracy", "error and C/N of one / of two"),
        "One robot maps less well than two (Table 1)",
        "exploration/landmarks/team.py",
        f"{JUDGED}::test_one_robot_maps_less_well_than_two",
        "1.28, 1.50",
        "accuracy",
    ),
    _claim(
        Typed("holds", "a drawing"),
        "Runs of two robots and of one (Figs. 1, 2)",
        "report/exploration.py",
        f"{WRITTEN}::test_the_tables_hold_the_papers_figures_and_every_case_ours",
        "drawn",
        "drawn",
        "a run each",
    ),
    _claim(
        rule(
            Check("neighbour_nees", "NEES/dof of both", most=1.25),
            Check("neighbour_error", "map error of both / with landmarks known, same seeds", most=1.25),
        ),
        "Nearest neighbours tell which landmark is which",
        "landmarks/association.py",
        f"{WRITTEN}::test_nearest_neighbours_make_an_honest_map_and_unsure_ones_most_of_the_wrong_matches",
        "used",
        "neighbour",
        "{few} runs",
    ),
    _claim(
        rule(
            Check("area_steps", "steps without it / with it, each escape", least=1.25),
            Check("area_stuck", "share of runs that never finish without it, each escape", least=0.5),
        ),
        "Without the gain in area robots stay where they are (eq. 19, 20)",
        "exploration/landmarks/objective.py",
        f"{WHOLE}::test_the_area_term_is_worth_its_steps_with_the_same_escape_on_both_sides",
        "not told",
        "area",
        "{few} runs",
    ),
    _claim(
        rule(Check("escape", "share of runs that never finish without it", least=0.9)),
        "Without the escape to a frontier robots get caught",
        "exploration/landmarks/steering.py",
        f"{WHOLE}::test_without_the_escape_no_run_ends",
        "not told",
        "escape",
        "{few} runs",
    ),
    _claim(
        _more("apart", "steps without it / with it"),
        "The distance to the others' submaps makes the team more efficient (eq. 20)",
        "exploration/landmarks/objective.py",
        f"{JUDGED}::test_without_the_distance_to_the_others_the_team_takes_no_more_steps",
        "not told",
        "apart",
        "{few} runs",
    ),
    _claim(
        _more("careful", "error and C/N without it / with it"),
        "The accuracy term makes the map more accurate (eq. 17, 20)",
        "exploration/landmarks/objective.py",
        f"{JUDGED}::test_without_the_accuracy_term_the_map_errs_no_more",
        "not told",
        "careful",
        "{few} runs",
    ),
    _claim(
        Typed("holds", "a proof, held by the test"),
        "Submaps are independent: fusing one leaves the other robots' as they are (eq. 13 to 16)",
        "fusion/handover.py",
        f"{FUSION}::test_a_fusion_keeps_the_covariance_symmetric_and_touches_no_other_submap",
        "proved",
        "independent",
        "{few} runs",
    ),
    _claim(
        rule(
            Check("dead_finished", "share of runs that finish", least=0.95), Check("dead_nees", "NEES/dof", most=1.25)
        ),
        "A robot that fails leaves the others at work",
        "exploration/landmarks/team.py",
        f"{WHOLE}::test_a_robot_that_dies_leaves_no_landmark_missed_and_an_honest_map",
        "not told",
        "dead",
        "{few} runs",
    ),
)
