"""How the verdict on a claim is worked out from what was measured.

A rule asks something of every number that the run has for a claim. All of them as asked: it holds; half of them or
more: in part; fewer: it does not hold. Of what the paper leaves open the words are answered, in part, not answered.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isinf
from typing import Literal

Verdict = Literal["holds", "in part", "does not hold", "answered", "not answered"]
Numbers = Mapping[str, Sequence[float]]
HALF = 0.5  # of the numbers that are as asked, for "in part"


@dataclass(frozen=True, slots=True)
class Check:
    """What is asked of every number that `Reproduction.numbers` has under a name: to be within `least` and `most`.

    says: what the numbers are, in words that the bounds follow.
    """

    name: str
    says: str
    least: float = -inf
    most: float = inf

    @property
    def text(self) -> str:
        if isinf(self.most):
            return f"{self.says} ≥ {self.least:g}"
        return f"{self.says} ≤ {self.most:g}" if isinf(self.least) else f"{self.says} {self.least:g} to {self.most:g}"

    def passed(self, numbers: Numbers) -> list[bool]:
        """Of each number whether it is as asked; what is not a number is not."""
        return [bool(self.least <= v <= self.most) for v in numbers[self.name]]


@dataclass(frozen=True, slots=True)
class Rule:
    """A verdict by numbers. enough: the share of them that must be as asked; question: left open by the paper."""

    checks: tuple[Check, ...]
    enough: float = 1.0
    question: bool = False

    @property
    def text(self) -> str:
        told = "; ".join(check.text for check in self.checks)
        return told if self.enough >= 1.0 else f"{told} ({self.enough:.0%} of them are enough)"

    def verdict(self, numbers: Numbers) -> Verdict:
        passed = [ok for check in self.checks for ok in check.passed(numbers)]
        if passed and sum(passed) >= self.enough * len(passed):
            return "answered" if self.question else "holds"
        if passed and sum(passed) >= HALF * len(passed):
            return "in part"
        return "not answered" if self.question else "does not hold"


@dataclass(frozen=True, slots=True)
class Typed:
    """A word that no number can change: of a proof, which a test holds, or of a drawing, for a reader to look at."""

    word: Verdict
    text: Literal["a proof, held by the test", "a drawing"]

    def verdict(self, numbers: Numbers) -> Verdict:  # noqa: ARG002
        return self.word


def rule(*checks: Check, enough: float = 1.0) -> Rule:
    """For a claim of the paper."""
    return Rule(checks, enough)


def question(*checks: Check) -> Rule:
    """For what the paper leaves open or assumes."""
    return Rule(checks, question=True)
