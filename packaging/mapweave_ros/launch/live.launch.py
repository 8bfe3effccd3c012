"""One map of ROS 2 robots while they drive: `ros2 launch mapweave_ros live.launch.py robots:=tb1,tb2 out:=result`.

Ctrl-C ends it with a whole result in `out`.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction

ARGUMENTS = {
    "robots": (None, "names of the robots in the team, as tb1,tb2"),
    "out": (None, "the folder of the result"),
    "namespaces": ("", "the robots' namespaces, one each, with * and ? (their names)"),
    "router": ("tcp/localhost:7447", "where rmw_zenoh's router, or that of the bridges, listens"),
    "connect": ("", "where the team meets, if elsewhere, as with certificates it must (the router)"),
    "domain": ("0", "ROS_DOMAIN_ID of the graph"),
    "team_map": ("true", "publish the team's map and all poses in each robot's graph"),
    "tls": ("", "the folder of this machine's certificate, as `mapweave live keys` makes them"),
    "insecure": ("false", "hear other machines without certificates"),
    "page": ("true", "show the map in a browser, at port 8642"),
}
ENDING = "600"  # [s] that a process has for its result, from Ctrl-C on


def commands(given: dict[str, str]) -> list[list[str]]:
    """The processes: one that follows the robots, one that makes the map, and where asked for one that shows it."""
    on = {name for name in ("team_map", "insecure", "page") if given[name].lower() == "true"}
    team = ["--connect", given["connect"] or given["router"], *(["--tls", given["tls"]] if given["tls"] else [])]
    robots = ["live", "robot", "--name", given["robots"], "--source", "ros2", "--domain", given["domain"]]
    robots += ["--pattern", given["namespaces"] or given["robots"], *(["--team-map"] if "team_map" in on else [])]
    robots += ["--graph", given["router"]] if given["connect"] else []
    woven = ["live", "map", "--out", given["out"], "--robots", given["robots"]]
    woven += ["--insecure"] if "insecure" in on else []
    shown = [["live", "view"]] if "page" in on else []
    return [["mapweave", *words, *team] for words in (robots, woven, *shown)]


def start(context: LaunchContext) -> list[ExecuteProcess]:
    """What is started, with the arguments as they were given."""
    given = {name: context.launch_configurations[name] for name in ARGUMENTS}
    return [
        ExecuteProcess(cmd=words, output="screen", sigterm_timeout=ENDING, sigkill_timeout=ENDING)
        for words in commands(given)
    ]


def generate_launch_description() -> LaunchDescription:
    """The arguments with their defaults, and the processes."""
    told = [DeclareLaunchArgument(n, default_value=d, description=text) for n, (d, text) in ARGUMENTS.items()]
    return LaunchDescription([*told, OpaqueFunction(function=start)])
