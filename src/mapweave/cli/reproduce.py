"""`mapweave reproduce PAPER`: each paper's command is imported only when it is asked for."""

from cyclopts import App

PAPERS: dict[str, str] = {
    # paper: where its command lives
    "kojima": "mapweave.cli.reproduce_kojima:kojima",
    "hamatani": "mapweave.cli.reproduce_hamatani:hamatani",
    "hara": "mapweave.cli.reproduce_hara:hara",
    "yuan": "mapweave.cli.reproduce_yuan:yuan",
}

app = App(name="reproduce", help="Repeat a paper's experiment and set its figures beside ours.")
for _name, _where in PAPERS.items():
    app.command(_where, name=_name)
