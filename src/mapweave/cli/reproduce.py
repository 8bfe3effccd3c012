"""`mapweave reproduce PAPER`: each paper's command is imported only when it is asked for."""

from cyclopts import App

PAPERS: dict[str, tuple[str, str]] = {
    # paper: where its command lives, and what it does
    "kojima": (
        "mapweave.cli.reproduce_kojima:kojima",
        "Kojima, Okawa, Namerikawa: merging two maps, Table 2 and Figs. 4 to 7.",
    ),
    "hamatani": (
        "mapweave.cli.reproduce_hamatani:hamatani",
        "Hamatani, Nakamura, Naruse: five robots by bearings, Tables 1 to 3.",
    ),
    "hara": (
        "mapweave.cli.reproduce_hara:hara",
        "Hara, Kawata, Ohya, Yuta: laser maps with light intensity, Figs. 4 to 7.",
    ),
    "yuan": ("mapweave.cli.reproduce_yuan:yuan", "Yuan, Huang, Tao, Xi: active SLAM of two robots, Table 1."),
}

app = App(name="reproduce", help="Repeat a paper's experiment and set its figures beside ours.")
for _name, (_where, _help) in PAPERS.items():
    app.command(_where, name=_name, help=_help)
