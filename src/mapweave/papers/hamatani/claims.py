"""What the paper claims, where each claim stands in the code, and the test that holds it."""

from ..reproduction import Claim

COMMAND = "reproduce hamatani"
TEST = "papers/test_reproduce_hamatani.py"
TABLES = f"{TEST}::test_the_tables_of_the_paper_come_out_and_the_row_that_does_not_is_named"
BEYOND = f"{TEST}::test_robots_anywhere_many_of_them_and_in_space_are_located_at_the_bound"


def _claim(claim: str, code: str, test: str, printed: str, here: str, over: str = "{trials} trials a cell") -> Claim:
    return Claim(claim, code, test, printed, here, over, COMMAND)


CLAIMS = (
    _claim("Sides with nothing known (Table 1), good guess", "swarm/kalman.py", TABLES, "0.47 to 6.69 m", "table1"),
    _claim("Angles with nothing known (Table 2), good guess", "swarm/kalman.py", TABLES, "0.007 to 0.38 deg", "table2"),
    _claim("Sides, two robots known (Table 3), good guess", "swarm/kalman.py", TABLES, "0.001 to 0.08 m", "table3"),
    _claim("The same from guesses of 25 m²", "swarm/kalman.py", TABLES, "as with a good guess", "bad_guess"),
    _claim("Exact bearings cannot be used", "swarm/kalman.py", TABLES, "×", "exact"),
    _claim(
        "Without known robots the distances drift",
        "swarm/kalman.py",
        f"{TEST}::test_the_scale_drifts_with_fresh_jacobians_and_stays_with_the_first_ones_whatever_the_guess",
        "0.47 to 6.69 m",
        "drift",
    ),
    _claim(
        "Future work: random places (five robots, two known)", "swarm/batch.py", BEYOND, "-", "random", "{draws} draws"
    ),
    _claim("Future work: many robots", "swarm/batch.py", BEYOND, "-", "many", "{draws} draws a case"),
    _claim("Future work: space", "swarm/batch.py", BEYOND, "-", "space", "{draws} draws a case"),
)
