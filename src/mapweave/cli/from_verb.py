"""Commands made of the verbs they call: what can be given, of which type, by default what, and what it means.

A verb's source is read, not imported: `--help` waits for nothing that the verb needs. What the command line spells
otherwise than Python is an `Option` of the command's entry; what Python alone can be given is left out.
"""

import ast
import inspect
import re
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import reduce
from importlib import import_module
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from cyclopts import Parameter

from ..core.config_text import own_meanings
from ..core.errors import VerdictError
from ..core.paths import at_home, holds_paths
from ..core.signatures import COMMON
from ..kernels.compiling import nothing_collected
from .terminal import progress, say, until_interrupted

PACKAGE = Path(__file__).parent.parent
PLAIN: dict[str, Any] = {
    "Path": Path,
    "AnyConfig": Path,
    "str": str,
    "int": int,
    "float": float,
    "bool": bool,
    "None": None,
}
OURS = {"on_progress", "executor", "stop", "say", "wall"}  # what a command hands to a verb by itself
REQUIRED = inspect.Parameter.empty
ABSENT = object()  # as a default: nothing, where the verb's own default is something that cannot be typed
SECTION = re.compile(r"\n\n[A-Z][a-z]+\n-{4,}\n")
QUOTED = re.compile(r"`([^`]+)`")
CONFIGURATION = re.compile(r'configuration\("(\w+)"(, laser=True)?\)')
IN_PYTHON = re.compile(
    r"Settings as (.*?) prints them: a TOML file, its tables as mappings, or an object of a configuration class"
)
SHOWN_DEFAULT = re.compile(r" \(([^()]*)\)(?=[.,;:]|$)")


class Given(NamedTuple):
    """What a function or a dataclass takes: its annotation's source, its default, and what its docstring says of it."""

    annotation: ast.expr | None
    default: object
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """How the command line spells an argument, where not as Python does.

    parse: what makes the argument of what was typed, or its module and name; signed: a minus may stand first.
    """

    kind: Any = None
    parse: Callable[[Any], Any] | str | None = None
    help: str = ""
    name: str = ""
    default: object = None
    signed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """An argument that is a dataclass, spelt by its fields. of: its module and name; only: these fields (all)."""

    of: str
    only: tuple[str, ...] = ()
    options: Mapping[str, Option] = field(default_factory=dict)
    title: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One command. words: what is given without a name, in order; several: what may be given so as often as wanted.

    leave: arguments that Python alone takes; extra: options that the verb does not know. `before` is called with what
    was asked ahead of the verb's import, `call` with the verb and that in the verb's place, `said` with the result.
    """

    verb: str
    does: str = ""
    example: str = ""
    words: tuple[str, ...] = ()
    several: str = ""
    options: Mapping[str, Option | Group] = field(default_factory=dict)
    leave: tuple[str, ...] = ()
    extra: Mapping[str, Option] = field(default_factory=dict)
    before: Callable[[dict[str, Any]], None] | None = None
    call: Callable[[Callable[..., Any], dict[str, Any]], Any] | None = None
    said: Callable[[Any, dict[str, Any]], None] | None = None


def make(name: str, command: Command) -> Callable[..., None]:
    """The function that Cyclopts makes the command of."""
    taken = source_of(command.verb)
    shown = list(_parameters(command, taken))
    signature = inspect.Signature([one for one, *_ in shown])

    def run(*words: Any, **options: Any) -> None:
        bound = signature.bind(*words, **options)
        bound.apply_defaults()
        given: dict[str, Any] = {}
        groups: dict[str, dict[str, Any]] = {key: {} for _, _, key, _ in shown if key}
        for parameter, target, key, parse in shown:
            value = bound.arguments[parameter.name]
            if holds_paths(parameter.annotation):  # --out=~/here, which no shell expands
                value = at_home(value, parameter.name)
            (groups[key] if key else given)[target] = value if parse is None else _callable(parse)(value)
        for key, fields in groups.items():
            group = command.options[key]
            given[key] = _thing(group.of)(**fields) if isinstance(group, Group) else None
        _run(command, given, taken)

    run.__name__ = name
    run.__doc__ = command.does
    run.__signature__ = signature  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one, *_ in shown}
    return run


def _run(command: Command, given: dict[str, Any], taken: Mapping[str, Given]) -> None:
    if command.before is not None:
        command.before(given)
    with nothing_collected():
        verb = _thing(command.verb)
    said = command.said or summary_and_report
    call = command.call or (lambda verb, asked: verb(**{name: asked[name] for name in asked if name in taken}))
    with (
        progress() if "on_progress" in taken else nullcontext() as tick,
        until_interrupted() if "stop" in taken else nullcontext() as stop,
    ):
        handed = {"on_progress": tick, "stop": stop, "say": say}
        try:
            result = call(verb, given | {name: thing for name, thing in handed.items() if name in taken})
        except VerdictError as error:
            failed: VerdictError | None = error
            result = error.result
        else:
            failed = None
    said(result, given)
    if failed is not None:
        raise failed


def summary_and_report(result: Any, given: Mapping[str, Any]) -> None:
    """A result in a few lines, and where its page is."""
    say(result.summary())
    say(f"report: {given['out'] / 'report.html'}")


def source_of(where: str) -> dict[str, Given]:
    """What `module:name` takes, by its source."""
    module, _, name = where.partition(":")
    text = (PACKAGE / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
    node = next(n for n in ast.parse(text).body if getattr(n, "name", None) == name)
    meaning = _told(ast.get_docstring(node) or "")  # type: ignore[arg-type]
    if isinstance(node, ast.ClassDef):
        meaning = own_meanings("\n".join(text.splitlines()[node.lineno - 1 : node.end_lineno])) | meaning
        found: list[tuple[str, ast.expr | None, ast.expr | None]] = [
            (n.target.id, n.annotation, n.value)
            for n in node.body
            if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)
        ]
    elif isinstance(node, ast.FunctionDef):
        plain, named = node.args.args, node.args.kwonlyargs
        bare: list[ast.expr | None] = [None] * (len(plain) - len(node.args.defaults))
        defaults = [*bare, *node.args.defaults, *node.args.kw_defaults]
        found = [(a.arg, a.annotation, d) for a, d in zip([*plain, *named], defaults, strict=True)]
    return {key: Given(kind, _value(default), meaning.get(key, COMMON.get(key, ""))) for key, kind, default in found}


def _value(default: ast.expr | None) -> object:
    if default is None:
        return REQUIRED
    try:
        return ast.literal_eval(default)
    except ValueError:  # made by a call: an Option says what the command line takes instead
        return None


def _told(docstring: str) -> dict[str, str]:
    """What the section of the parameters says of each."""
    _, _, section = docstring.partition("\nParameters\n----------\n")
    told: dict[str, str] = {}
    name = ""
    for line in SECTION.split(section)[0].splitlines():
        if line[:1].strip():
            name = line.strip()
        else:
            told[name] = f"{told.get(name, '')} {line.strip()}".strip()
    return told


def _parameters(
    command: Command, taken: Mapping[str, Given]
) -> Iterator[tuple[inspect.Parameter, str, str, Callable[[Any], Any] | str | None]]:
    """Parameters in the order of a signature, each with the argument it becomes, the group it is of and its parser."""
    order = [*command.words, *([command.several] if command.several else [])]
    for name in [*order, *(key for key in taken if key not in order)]:
        option = command.options.get(name)
        if name in command.leave or (name in OURS and option is None):
            continue
        if isinstance(option, Group):
            fields = source_of(option.of)
            for key in option.only or fields:
                own = option.options.get(key, Option())
                yield _parameter(command, key, fields[key], own, fields, option.title), key, name, own.parse
        else:
            own = option or Option()
            yield _parameter(command, name, taken[name], own, taken), name, "", own.parse
    for name, option in command.extra.items():
        yield _parameter(command, name, Given(None, False, ""), option, taken), name, "", option.parse


def _parameter(
    command: Command, name: str, given: Given, option: Option, taken: Mapping[str, Given], title: str = ""
) -> inspect.Parameter:
    kind = option.kind if option.kind is not None else _kind(given.annotation)
    default = option.default if option.default is not None else given.default
    if default is ABSENT:
        default = None
    elif name in command.words or (name == "out" and default is None):
        default = REQUIRED
    if isinstance(default, str) and kind is Path:
        default = Path(default)
    flag = kind is bool and default is False
    offered = {*taken} - OURS - {*command.leave, *command.words}
    spelt: dict[str, Any] = {"help": option.help or _spoken(given.meaning, offered, default)}
    if option.name:
        spelt["name"] = option.name
    if title:
        spelt["group"] = title
    if flag or "list" in str(kind):
        spelt["negative"] = ""
    if "list[pathlib" in str(kind):
        spelt["consume_multiple"] = True
    parameter = Parameter(**spelt, allow_leading_hyphen=option.signed)
    how: Any = inspect.Parameter.KEYWORD_ONLY
    if name in command.words:
        how = inspect.Parameter.POSITIONAL_ONLY
    elif name == command.several:
        how, default = inspect.Parameter.VAR_POSITIONAL, REQUIRED
    return inspect.Parameter(name, how, default=default, annotation=Annotated[kind, parameter])


def _kind(annotation: ast.expr | None) -> Any:
    """What of an annotation can be typed: a path before a text, a text before a number."""
    parts = [annotation]
    while isinstance(first := parts[0], ast.BinOp):
        parts[:1] = [first.left, first.right]
    kinds: dict[str, Any] = {}
    for part in parts:
        text = ast.unparse(part) if part is not None else ""
        if text in PLAIN:
            kinds[text] = PLAIN[text]
        elif isinstance(part, ast.Subscript) and ast.unparse(part.value) == "Literal":
            kinds[text] = Literal[ast.literal_eval(part.slice)]
    if "Path" in kinds:
        kinds.pop("str", None)
    elif "str" in kinds:
        kinds = {key: kind for key, kind in kinds.items() if key not in {"int", "float"}}
    if not kinds.keys() - {"None"}:
        raise TypeError(f"nothing of {ast.unparse(annotation) if annotation else None} can be typed")
    return reduce(or_, kinds.values())


def _spoken(meaning: str, offered: Container[str], default: object) -> str:
    """What a docstring says, in the words of the command line: options by their names, a default that is shown once."""
    text = IN_PYTHON.sub(r"A TOML file of settings, as \1 prints them", meaning)
    text = CONFIGURATION.sub(lambda m: f"mapweave config {m[1]}{' --laser' if m[2] else ''}", text)
    text = QUOTED.sub(lambda m: f"--{m[1].replace('_', '-')}" if m[1] in offered else m[1], text)
    told = f"{default:g}" if isinstance(default, float) else str(default)
    return SHOWN_DEFAULT.sub(lambda m: "" if m[1] == told else m[0], text)


def _callable(parse: Callable[[Any], Any] | str) -> Callable[[Any], Any]:
    return _thing(parse) if isinstance(parse, str) else parse


def _thing(where: str) -> Any:
    module, _, name = where.partition(":")
    return getattr(import_module(f"{__package__.partition('.')[0]}.{module}"), name)
