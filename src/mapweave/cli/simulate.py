"""`mapweave simulate WORLD`: each world's command is imported only when it is asked for."""

from cyclopts import App

WORLDS: dict[str, tuple[str, str]] = {
    # world: where its command lives, and what it does
    "landmarks": (
        "mapweave.cli.simulate_landmarks:landmarks",
        "A team with cameras among landmarks, in the MRCLAM layout.",
    ),
    "team": ("mapweave.cli.simulate_team:team", "A mixed team: laser robots, camera robots, robots that see robots."),
    "swarm": ("mapweave.cli.simulate_swarm:swarm", "A swarm of camera robots that see each other."),
    "corridor": ("mapweave.cli.simulate_laser:corridor", "A laser drive round a ring of corridor."),
    "office": ("mapweave.cli.simulate_laser:office", "A laser drive through an office floor."),
    "tunnel": ("mapweave.cli.simulate_laser:tunnel", "A laser drive down a tunnel and back."),
}

app = App(name="simulate", help="Make recordings whose truth is known.")
for _name, (_where, _help) in WORLDS.items():
    app.command(_where, name=_name, help=_help)
