"""The conda recipe asks for what the package asks for, and the ROS 2 package starts commands that there are."""

import importlib.util
import re
import runpy
import sys
import tomllib
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from ruamel.yaml import YAML

from mapweave import __version__
from mapweave.cli import make_app

TOP = Path(__file__).resolve().parent.parent
ROS = TOP / "packaging" / "mapweave_ros"
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))
OF_CONDA = {"matplotlib": "matplotlib-base"}  # names there


def asked(words):
    """Name and condition of `numpy>=2.0` or `numpy >=2.0`."""
    name, condition = re.fullmatch(r"([\w.-]+)\s*(.*)", words).groups()
    return OF_CONDA.get(name, name), condition


def test_the_conda_recipe_agrees_with_the_package():
    recipe = YAML(typ="safe").load((TOP / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    project, needs = PROJECT["project"], recipe["requirements"]
    assert dict(map(asked, needs["run"])) == {
        "python": project["requires-python"], **dict(map(asked, project["dependencies"])),
    }  # fmt: skip
    assert dict(map(asked, PROJECT["build-system"]["requires"])).items() <= dict(map(asked, needs["host"])).items()
    assert recipe["package"] == {"name": project["name"], "version": __version__}
    scripts = [f"{name} = {place}" for name, place in project["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == scripts
    assert recipe["about"]["summary"] == project["description"]
    assert recipe["about"]["license"] == project["license"]


def test_nothing_in_the_description_of_a_wheel_leads_into_the_repository():
    spec = importlib.util.spec_from_file_location("hatch_build", TOP / "hatch_build.py")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    metadata = {}
    hook.LongDescription(str(TOP), {}).update(metadata)
    text, readme = metadata["readme"]["text"], (TOP / "README.md").read_text(encoding="utf-8")
    assert [place for place in re.findall(r"\]\(([^)]*)\)", text) if not place.startswith("http")] == []
    assert "<!--" not in text
    assert re.findall(r"^#+ .*$", text, re.MULTILINE) == re.findall(r"^#+ .*$", readme, re.MULTILINE)
    assert "read more" in text
    assert "| [live]" not in text


@pytest.fixture
def setup_told(monkeypatch):
    """What `setup.py` tells setuptools."""
    told = {}
    monkeypatch.setitem(sys.modules, "setuptools", SimpleNamespace(setup=told.update))
    runpy.run_path(str(ROS / "setup.py"))
    return told


def test_the_ros_package_installs_what_is_there_under_the_name_it_has(setup_told):
    manifest = ET.parse(ROS / "package.xml").getroot()  # noqa: S314  (ours)
    name, version = (manifest.findtext(tag) for tag in ("name", "version"))
    assert name == setup_told["name"] == ROS.name
    assert version == setup_told["version"] == re.match(r"\d+\.\d+\.\d+", __version__)[0]
    assert manifest.findtext("license") == setup_told["license"] == PROJECT["project"]["license"]
    assert manifest.findtext("export/build_type") == "ament_python"
    assert ("share/ament_index/resource_index/packages", [f"resource/{name}"]) in setup_told["data_files"]
    files = [ROS / file for _, some in setup_told["data_files"] for file in some]
    assert [file for file in files if not file.is_file()] == []
    assert [package for package in setup_told["packages"] if not (ROS / package / "__init__.py").is_file()] == []
    assert f"lib/{name}" in (ROS / "setup.cfg").read_text(encoding="utf-8")


def test_the_ros_packages_command_is_the_programs_own(setup_told):
    (line,) = setup_told["entry_points"]["console_scripts"]
    name, module, function = re.fullmatch(r"(\w+) = ([\w.]+):(\w+)", line).groups()
    assert PROJECT["project"]["scripts"][name] == f"{module}:{function}"
    assert callable(getattr(import_module(module), function))


@pytest.fixture
def launch_file(monkeypatch):
    """The launch file, run where `launch` keeps what it is given."""
    kept = {"LaunchContext": SimpleNamespace, "LaunchDescription": list}
    actions = {
        "DeclareLaunchArgument": lambda name, **more: (name, more),
        "ExecuteProcess": lambda **more: more["cmd"],
        "OpaqueFunction": lambda function: function,
    }
    for name, held in {"launch": kept, "launch.actions": actions}.items():
        module = ModuleType(name)
        module.__dict__.update(held)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("live_launch", ROS / "launch" / "live.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("given", "count"),
    [
        ({}, 3),
        ({"team_map": "false", "page": "False", "namespaces": "a*,b"}, 2),
        ({"connect": "tcp/10.0.0.1:7448", "tls": "keys", "domain": "7"}, 3),
        ({"insecure": "true"}, 3),
    ],
)
def test_the_launch_file_starts_commands_that_there_are_with_options_that_they_have(launch_file, given, count):
    *arguments, start = launch_file.generate_launch_description()
    values = {name: more["default_value"] for name, more in arguments} | {"robots": "r1,r2", "out": "result"} | given
    started = start(SimpleNamespace(launch_configurations=values))
    assert len(started) == count
    for program, *words in started:
        assert program in PROJECT["project"]["scripts"]
        make_app().parse_args(words, print_error=False, exit_on_error=False)
    of_robots = started[0]
    assert ("--team-map" in of_robots) == (values["team_map"] == "true")
    assert of_robots[of_robots.index("--pattern") + 1] == (given.get("namespaces") or "r1,r2")
    assert ("--graph" in of_robots) == ("connect" in given)
    assert {words[words.index("--connect") + 1] for words in started} == {given.get("connect", "tcp/localhost:7447")}
    assert [words[2] for words in started if "--insecure" in words] == ["map"] * ("insecure" in given)
