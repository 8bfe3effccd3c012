"""What the paper claims, where each claim stands in the code, and the test that holds it."""

from ..reproduction import Claim, Verdict

COMMAND = "reproduce hamatani"
TEST = "papers/test_reproduce_hamatani.py"
TABLES = f"{TEST}::test_the_tables_of_the_paper_come_out_and_the_row_that_does_not_is_named"
SHAPE = f"{TEST}::test_what_the_paper_says_of_all_cells_is_judged_over_all_cells"
BEYOND = f"{TEST}::test_robots_anywhere_many_of_them_and_in_space_are_located_at_the_bound"


def _claim(
    verdict: Verdict, claim: str, code: str, test: str, printed: str, here: str, over: str = "{trials} trials a cell"
) -> Claim:
    return Claim(claim, code, test, printed, here, over, COMMAND, verdict)


CLAIMS = (
    _claim(
        "holds", "Sides with nothing known (Table 1), good guess", "swarm/kalman.py", TABLES, "0.47 to 6.69 m", "table1"
    ),
    _claim(
        "holds",
        "Angles with nothing known (Table 2), good guess",
        "swarm/kalman.py",
        TABLES,
        "0.007 to 0.38 deg",
        "table2",
    ),
    _claim(
        "holds", "Sides, two robots known (Table 3), good guess", "swarm/kalman.py", TABLES, "0.001 to 0.08 m", "table3"
    ),
    _claim(
        "does not hold",
        "The same from guesses of 25 m²",
        "swarm/kalman.py",
        TABLES,
        "as with a good guess",
        "bad_guess",
    ),
    _claim("does not hold", "Exact bearings cannot be used", "swarm/kalman.py", TABLES, "×", "exact"),
    _claim(
        "holds",
        "Without known robots the distances drift",
        "swarm/kalman.py",
        f"{TEST}::test_the_scale_drifts_with_fresh_jacobians_and_stays_with_the_first_ones_whatever_the_guess",
        "0.47 to 6.69 m",
        "drift",
    ),
    _claim(
        "in part",
        "Whatever the guess and the bearings, every angle errs less than 0.4 deg",
        "swarm/kalman.py",
        SHAPE,
        "0.007 to 0.391 deg",
        "angles",
    ),
    _claim(
        "in part",
        "With two robots known every side errs less than 0.1 m",
        "swarm/kalman.py",
        SHAPE,
        "0.001 to 0.08 m",
        "sides",
    ),
    _claim(
        "does not hold",
        "With two robots known all stand within millimetres of their places (Fig. 4)",
        "swarm/kalman.py",
        SHAPE,
        "0.0036 m at most",
        "places",
        "a run",
    ),
    _claim(
        "holds",
        "Errors grow with the noise of bearings (Tables 1 to 3)",
        "swarm/kalman.py",
        SHAPE,
        "8 of 9 rows",
        "grows",
    ),
    _claim(
        "answered",
        "Future work: random places (five robots, two known)",
        "swarm/batch.py",
        BEYOND,
        "-",
        "random",
        "{draws} draws",
    ),
    _claim("answered", "Future work: many robots", "swarm/batch.py", BEYOND, "-", "many", "{draws} draws a case"),
    _claim("answered", "Future work: space", "swarm/batch.py", BEYOND, "-", "space", "{draws} draws a case"),
)
