"""`mapweave simulate WORLD`: each world's command is imported only when it is asked for."""

from cyclopts import App

WORLDS: dict[str, tuple[str, str, str]] = {
    # world: where its command lives, what it does, and what an example writes
    "landmarks": (
        "mapweave.cli.simulate_landmarks:landmarks",
        "A team with cameras among landmarks, in the MRCLAM layout.",
        "team --robots 5",
    ),
    "team": (
        "mapweave.cli.simulate_team:team",
        "A mixed team: laser robots, camera robots, robots that see robots.",
        "mixed --minutes 3",
    ),
    "swarm": (
        "mapweave.cli.simulate_swarm:swarm",
        "A swarm of camera robots that see each other.",
        "swarm.csv --robots 36 --sigma 0.5deg",
    ),
    "corridor": ("mapweave.cli.simulate_laser:corridor", "A laser drive round a ring of corridor.", "drive.mcap"),
    "office": ("mapweave.cli.simulate_laser:office", "A laser drive through an office floor.", "drive.mcap --seed 3"),
    "tunnel": ("mapweave.cli.simulate_laser:tunnel", "A laser drive down a tunnel and back.", "drive.mcap"),
}

app = App(name="simulate", help="Make logs of simulated robots, and their truth.", help_epilogue="")
for _name, (_where, _help, _example) in WORLDS.items():
    _shown = f"Example: mapweave simulate {_name} --out {_example}"
    app.command(_where, name=_name, help=_help, help_epilogue=_shown)
