"""`mapweave simulate WORLD`: each world's command is imported only when it is asked for."""

from cyclopts import App

WORLDS: dict[str, str] = {
    # world: where its command lives
    "landmarks": "mapweave.cli.simulate_landmarks:landmarks",
    "swarm": "mapweave.cli.simulate_swarm:swarm",
    "corridor": "mapweave.cli.simulate_laser:corridor",
    "office": "mapweave.cli.simulate_laser:office",
    "tunnel": "mapweave.cli.simulate_laser:tunnel",
}

app = App(name="simulate", help="Make recordings whose truth is known.")
for _name, _where in WORLDS.items():
    app.command(_where, name=_name)
