"""What Zenoh refuses before any of our code sees it, counted: strangers at the door and names that are not one's own.

Zenoh tells of it in log lines on the process's standard output alone, so that is read here: for the command line only.
"""

import os
import re
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

STRANGER, FORGED = "strangers", "not on the access list"
REASONS = (  # words of a line, what it counts as; None: of no interest
    (re.compile(r"is unauthorized to"), FORGED),
    (re.compile(r"access_control"), None),
    (re.compile(r"interceptor"), None),
    (re.compile(r"Skipping name verification"), None),
    (
        re.compile(r"zenoh_link_tls.*(received fatal alert|invalid peer certificate|peer sent no certificates)"),
        STRANGER,
    ),
)
DENIED = re.compile(r"CertCommonName\((?P<who>[^)]*)\).* is unauthorized to (?P<what>.+) \(\w+\) on (?P<key>\S+)")
HEARD_THERE = re.compile(r"[^/]+/[^/]+/@map\b")  # keys that robots listen at
FIRST_JUDGED = "Reply"
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
LOG_LEVELS = "error,zenoh_link_tls=warn,zenoh::net::routing::interceptor::access_control=trace"


@contextmanager
def watched() -> Iterator[Counter[str]]:
    """Counts of what was refused; while it lasts, this process's own words go past Zenoh's."""
    counts: Counter[str] = Counter()
    sys.stdout.flush()
    ours = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    before, sys.stdout = sys.stdout, os.fdopen(ours, "w", buffering=1, encoding=sys.stdout.encoding, errors="replace")
    reader = Thread(target=_read, args=(reading, counts), daemon=True)
    reader.start()
    try:
        yield counts
    finally:
        sys.stdout.flush()
        os.dup2(sys.stdout.fileno(), 1)  # the pipe's last writer goes: the reader ends
        reader.join(1.0)
        sys.stdout.close()
        sys.stdout = before


def reason_of(line: str) -> tuple[bool, str | None]:
    """Whether Zenoh's line is understood, and what it counts as, if anything."""
    plain = COLOUR.sub("", line)
    for words, reason in REASONS:
        if words.search(plain):
            return True, reason
    return False, None


class Denials:
    """Which of Zenoh's lines on denied words tell of words that were said.

    As soon as somebody listens at a key Zenoh judges all that might be said there, and logs each denial in one go, the
    reply first: robots, which listen to map processes, were accused of what they never tried.
    """

    def __init__(self) -> None:
        self._judged: set[tuple[str, str]] = set()

    def said(self, line: str) -> bool:
        """Whether this one is about a word that was said."""
        denial = DENIED.search(line)
        if denial is None or not HEARD_THERE.match(denial["key"]):
            return True
        pair = (denial["who"], denial["key"])
        if denial["what"] == FIRST_JUDGED:
            self._judged.add(pair)
        return pair not in self._judged


def plain(reason: str, line: str) -> str:
    """A refusal in words: who was refused what."""
    denial = DENIED.search(line)
    if reason == FORGED and denial is not None:
        return f"refused: {reason}: {denial['who']} may not {denial['what'].lower()} on {denial['key']}"
    if reason == STRANGER:
        why = line.rpartition("unicast: ")[2].partition(". Hint")[0].strip()
        return f"refused: {reason}: a process without a valid certificate of this team's authority ({why})"
    return f"refused: {reason}: {line.strip()}"


def _read(reading: int, counts: Counter[str]) -> None:
    denials = Denials()
    with os.fdopen(reading, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            known, reason = reason_of(line)
            text = COLOUR.sub("", line)
            if reason is not None and (reason != FORGED or denials.said(text)):
                counts[reason] += 1
                if counts[reason] == 1:
                    print(plain(reason, text), file=sys.stderr)  # noqa: T201
            elif not known:
                sys.stderr.write(line)
