"""`mapweave reproduce PAPER`: a paper's experiment again, its figures beside ours."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from .terminal import progress, say, say_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..core.workers import Progress
    from ..papers.reproduction import Reproduction

Out = Annotated[Path | None, Parameter(help="A folder for metrics.json, report.html and figures.")]
Seed = Annotated[int, Parameter(help="The same seed gives the same figures.")]
Force = Annotated[
    bool, Parameter(negative="", help="Write into the folder even when something other than a result stands there.")
]

app = App(name="reproduce", help="Repeat a paper's experiment and set its figures beside ours.", help_epilogue="")


@app.command
def kojima(
    *, out: Out = None, quick: Annotated[bool, Parameter(negative="")] = False, seed: Seed = 0, force: Force = False
) -> None:
    """Kojima, Okawa, Namerikawa: merging two maps, Table 2 and Figs. 4 to 7.

    Parameters
    ----------
    quick
        20 worlds instead of 200.
    """
    from ..papers.kojima.reproduce import reproduce_kojima

    _tell(lambda tick: reproduce_kojima(out, quick=quick, seed=seed, force=force, on_progress=tick), out)


@app.command
def hamatani(
    *, out: Out = None, quick: Annotated[bool, Parameter(negative="")] = False, seed: Seed = 0, force: Force = False
) -> None:
    """Hamatani, Nakamura, Naruse: five robots by bearings, Tables 1 to 3.

    Parameters
    ----------
    quick
        3 trials a cell instead of the paper's 10.
    """
    from ..papers.hamatani.reproduce import reproduce_hamatani

    _tell(lambda tick: reproduce_hamatani(out, quick=quick, seed=seed, force=force, on_progress=tick), out)


@app.command
def hara(
    *, out: Out = None, quick: Annotated[bool, Parameter(negative="")] = False, seed: Seed = 0, force: Force = False
) -> None:
    """Hara, Kawata, Ohya, Yuta: a 200 m loop with and without light intensity, Figs. 4 to 7.

    Parameters
    ----------
    quick
        Two loops and 64 particles instead of six and 512.
    """
    from ..papers.hara.reproduce import reproduce_hara

    _tell(lambda tick: reproduce_hara(out, quick=quick, seed=seed, force=force, on_progress=tick), out)


@app.command
def yuan(
    *,
    out: Out = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    seed: Seed = 0,
    jobs: int = 1,
    force: Force = False,
) -> None:
    """Yuan, Huang, Tao, Xi: active SLAM of two robots, Table 1, Figs. 1 and 2.

    Parameters
    ----------
    quick
        4 runs a case instead of 30.
    jobs
        How many runs are worked on at once; the result is the same.
    """
    from ..papers.yuan.reproduce import reproduce_yuan

    _tell(lambda tick: reproduce_yuan(out, quick=quick, seed=seed, jobs=jobs, force=force, on_progress=tick), out)


def _tell(reproduce: "Callable[[Progress], Reproduction]", out: Path | None) -> None:
    """Tables, differences and claims on stdout, and where the page is."""
    with progress() as tick:
        result = reproduce(tick)
    say(f"{result.title}: {result.lead}\n")
    if result.warning:
        say(f"{result.warning}\n")
    for section in result.sections():
        if not (section.head or section.text):
            continue
        say(section.title)
        if section.text:
            say(section.text)
        if section.head:
            say_table(section.head, section.rows)
        say()
    say("What differs, and why")
    for sentence in result.differences():
        say(f"- {sentence}")
    say("\nClaim by claim")
    _, rows = result.claims_table()
    for claim, code, test, printed, here, verdict, judged, over, command in rows:
        say(
            f"- {claim}: {verdict}: printed {printed}; here {here}, over {over}; judged by: {judged} "
            f"({command}; {code}, {test})"
        )
    if out is not None:
        say(f"\nreport: {out / 'report.html'}")
