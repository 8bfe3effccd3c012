"""What the paper claims, where each claim stands in the code, the test that holds it, and how it is judged."""

from ..reproduction import Claim
from ..verdicts import Check, Rule, question, rule
from .printed import WITHIN

COMMAND = "reproduce hamatani"
TEST = "papers/test_reproduce_hamatani.py"
TABLES = f"{TEST}::test_the_tables_of_the_paper_come_out_and_the_row_that_does_not_is_named"
SHAPE = f"{TEST}::test_what_the_paper_says_of_all_cells_is_judged_over_all_cells"
BEYOND = f"{TEST}::test_robots_anywhere_many_of_them_and_in_space_are_located_at_the_bound"


def _claim(
    judged: Rule, claim: str, code: str, test: str, printed: str, here: str, over: str = "{trials} trials a cell"
) -> Claim:
    return Claim(claim, code, test, printed, here, over, COMMAND, judged)


def _cells(table: int, where: str = "") -> Check:
    """Of a table's cells with noisy bearings, ours over the printed figure."""
    says = f"table {table}: ours / printed in each cell" if where else "ours / printed in each cell"
    return Check(f"table{table}{where}", says, 1 / WITHIN[table], WITHIN[table])


def _located(name: str) -> Rule:
    return question(
        Check(f"{name}, bound", "RMSE / bound in each row", most=1.25),
        Check(f"{name}, nees", "median NEES/dof in each row", 0.8, 1.25),
    )


CLAIMS = (
    _claim(
        rule(_cells(1)),
        "Sides with nothing known (Table 1), good guess",
        "swarm/kalman.py",
        TABLES,
        "0.47 to 6.69 m",
        "table1",
    ),
    _claim(
        rule(_cells(2)),
        "Angles with nothing known (Table 2), good guess",
        "swarm/kalman.py",
        TABLES,
        "0.007 to 0.38 deg",
        "table2",
    ),
    _claim(
        rule(_cells(3)),
        "Sides, two robots known (Table 3), good guess",
        "swarm/kalman.py",
        TABLES,
        "0.001 to 0.08 m",
        "table3",
    ),
    _claim(
        rule(*(_cells(table, " from afar") for table in WITHIN)),
        "The same from guesses of 25 m²",
        "swarm/kalman.py",
        TABLES,
        "as with a good guess",
        "bad_guess",
    ),
    _claim(
        rule(Check("exact", "side [m] with two robots known, each guess, exact bearings", least=1e-6)),
        "Exact bearings cannot be used",
        "swarm/kalman.py",
        TABLES,
        "×",
        "exact",
    ),
    _claim(
        rule(Check("drift", "side over that with first-estimate Jacobians, exact start", least=10.0)),
        "Without known robots the distances drift",
        "swarm/kalman.py",
        f"{TEST}::test_the_scale_drifts_with_fresh_jacobians_and_stays_with_the_first_ones_whatever_the_guess",
        "0.47 to 6.69 m",
        "drift",
    ),
    _claim(
        rule(Check("angles", "angle [deg] in each cell", most=0.4)),
        "Whatever the guess and the bearings, every angle errs less than 0.4 deg",
        "swarm/kalman.py",
        SHAPE,
        "0.007 to 0.391 deg",
        "angles",
    ),
    _claim(
        rule(Check("sides", "side [m] in each cell", most=0.1)),
        "With two robots known every side errs less than 0.1 m",
        "swarm/kalman.py",
        SHAPE,
        "0.001 to 0.08 m",
        "sides",
    ),
    _claim(
        rule(Check("places", "farthest robot [m]", most=0.01)),
        "With two robots known all stand within millimetres of their places (Fig. 4)",
        "swarm/kalman.py",
        SHAPE,
        "0.0036 m at most",
        "places",
        "a run",
    ),
    _claim(
        rule(Check("grows", "error at 25 deg² / at 0.01 deg², each row", least=1.0), enough=0.85),
        "Errors grow with the noise of bearings (Tables 1 to 3)",
        "swarm/kalman.py",
        SHAPE,
        "8 of 9 rows",
        "grows",
    ),
    _claim(
        _located("random"),
        "Future work: random places (five robots, two known)",
        "swarm/batch.py",
        BEYOND,
        "-",
        "random",
        "{draws} draws",
    ),
    _claim(_located("many"), "Future work: many robots", "swarm/batch.py", BEYOND, "-", "many", "{draws} draws a case"),
    _claim(_located("space"), "Future work: space", "swarm/batch.py", BEYOND, "-", "space", "{draws} draws a case"),
)
