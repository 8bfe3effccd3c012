"""What tests of relative fusion assert of the theory, with the number that each measured: the tests are run.

    python benchmarks/asserted.py

A test tells what it asserts where it does, `record_property("asserted", (statement, limit, number))`. Where several
tell the same statement, the number nearest to its limit is printed: the least of those that must exceed it, else the
greatest.
"""

import sys
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[1]
FILES = (
    "fusion/test_relative_information_model.py",
    "fusion/test_relative_information.py",
    "papers/test_relative_theorems.py",
    "papers/test_reproduce_kojima.py",
)
Told = tuple[str, str, float]  # statement, limit, number


class Listener:
    """Keeps what the tests tell, in their order."""

    def __init__(self) -> None:
        self.told: list[Told] = []

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if "record_property" in getattr(item, "fixturenames", ())]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            self.told += [told for name, told in report.user_properties if name == "asserted"]


def rows(told: list[Told]) -> list[str]:
    """A row a statement: its limit, and of the numbers that were told the one nearest to that."""
    numbers: dict[tuple[str, str], list[float]] = {}
    for statement, limit, number in told:
        numbers.setdefault((statement, limit), []).append(number)
    return [
        f"| {statement} | {limit} | {(min if limit.startswith('>') else max)(found):#.3g}".rstrip(".") + " |"
        for (statement, limit), found in numbers.items()
    ]


def main() -> None:
    listener = Listener()
    files = [str(TOP / "tests" / name) for name in FILES]
    code = pytest.main(["-q", "--all", "-p", "no:cacheprovider", *files], plugins=[listener])
    if code:
        sys.exit(int(code))
    print("| statement | asserted | measured |\n|---|---|---|")
    print("\n".join(rows(listener.told)))


if __name__ == "__main__":
    main()
