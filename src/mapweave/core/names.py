"""Names of robots: `robotK` in code and folders, `K` in tables; a robot of a fused result is `DIR/robotK` in both."""

from collections.abc import Collection


def robot_key(robot: str) -> str:
    """`K` of `robotK`; any other name as it is."""
    number = robot.removeprefix("robot")
    return number if number.isdecimal() else robot


def robot_name(key: str) -> str:
    """`robotK` of `K`; any other name as it is."""
    return f"robot{key}" if key.isdecimal() else key


def unused(prefix: str, taken: Collection[str]) -> str:
    """`prefix` with a number behind it that makes a name which is not among those `taken`."""
    k = len(taken)
    while f"{prefix}{k}" in taken:
        k += 1
    return f"{prefix}{k}"


def in_order(name: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """A sort key under which numbers in names count as numbers: 2 before 11, robot2 before robot11.

    No two names have the same: 01 stands before 1.
    """
    parts: list[tuple[int, int, str]] = []
    word = ""
    digits = False
    for letter in name:
        if word and letter.isdecimal() != digits:
            parts.append((0, int(word), "") if digits else (1, 0, word))
            word = ""
        digits = letter.isdecimal()
        word += letter
    if word:
        parts.append((0, int(word), "") if digits else (1, 0, word))
    return tuple(parts), name
