"""Signatures as `help()`, notebooks and editors at run time show them: names without their modules, a parameter a line.

They hold what Python's own hold (the same parameters, the same annotations as objects); only their text differs. What
an argument means for every verb is said here, once, and added to their docstrings.
"""

import inspect
import re
from collections.abc import Iterable
from types import FunctionType
from typing import Any, get_args

WIDTH = 80  # columns that a signature may take before it gets a line for every parameter
LONGEST_DEFAULT = 40  # letters; a longer one is told by its type alone
PACKAGE = __name__.partition(".")[0]
QUOTED = re.compile(r"('[^']*')")
MODULES = re.compile(r"\b(?:[^\W\d]\w*\.)+(?=[^\W\d])")
COMMON = {  # arguments that mean the same wherever a docstring does not say otherwise
    "out": "The folder to write; an earlier result there is replaced whole.",
    "seed": "Of everything drawn at random (0).",
    "force": "Write into `out` even when something other than a result stands there (False).",
    "executor": "Any `concurrent.futures.Executor` in place of `jobs`.",
    "on_progress": "Called as `on_progress(stage, done, total)`.",
    "stop": "Ends it as soon as it is set.",
    "say": "Called with a line where something happens.",
}
SECTION = re.compile(r"(?<=\nParameters\n----------\n).*?(?=\n\n[A-Z][a-z]+\n-{4,}\n|$)", re.DOTALL)


def with_common(docstring: str, arguments: Iterable[str]) -> str:
    """`docstring`, its section of parameters with those of `arguments` that it leaves to `COMMON`, in their order."""

    def completed(section: re.Match[str]) -> str:
        told = {entry.split("\n")[0]: entry for entry in re.split(r"\n(?=\S)", section[0])}
        common = {name: f"{name}\n    {COMMON[name]}" for name in arguments if name in COMMON}
        return "\n".join([(common | told)[name] for name in arguments if name in common or name in told])

    return SECTION.sub(completed, inspect.cleandoc(docstring))


class ReadableParameter(inspect.Parameter):
    """A parameter whose text has short names."""

    __slots__ = ()

    def __str__(self) -> str:
        stars = "*" if self.kind is self.VAR_POSITIONAL else "**" if self.kind is self.VAR_KEYWORD else ""
        text, equals = stars + self.name, "="
        if self.annotation is not self.empty:
            text, equals = f"{text}: {short_name(self.annotation)}", " = "
        return text if self.default is self.empty else f"{text}{equals}{short_default(self.default)}"


class ReadableSignature(inspect.Signature):
    """A signature whose text has short names, and a line for every parameter where one line does not hold all."""

    __slots__ = ()

    def __str__(self) -> str:
        returns = "" if self.return_annotation is self.empty else f" -> {short_name(self.return_annotation)}"
        parts = self._parts()
        line = f"({', '.join(parts)}){returns}"
        if len(line) <= WIDTH or not parts:
            return line
        return "(\n" + "".join(f"    {part},\n" for part in parts) + f"){returns}"

    def format(self, **_: Any) -> str:
        """The same text, however wide the page: Python 3.13 asks so."""
        return str(self)

    def _parts(self) -> list[str]:
        """The parameters in order, with `/` and `*` where Python writes them."""
        given = list(self.parameters.values())
        kinds = [one.kind for one in given]
        parts = [str(one) for one in given]
        if inspect.Parameter.KEYWORD_ONLY in kinds and inspect.Parameter.VAR_POSITIONAL not in kinds:
            parts.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
        only = kinds.count(inspect.Parameter.POSITIONAL_ONLY)
        if only:
            parts.insert(only, "/")
        return parts


def short_name(annotation: object) -> str:
    """The text of an annotation, every name without the module it comes from; text in quotes in it as it is."""
    if isinstance(annotation, str):
        return annotation
    pieces = QUOTED.split(inspect.formatannotation(annotation))
    return "".join(piece if k % 2 else MODULES.sub("", piece) for k, piece in enumerate(pieces))


def short_default(value: object) -> str:
    """The text of a default: a function or type by its name, one whose text is long by its type's."""
    if isinstance(value, FunctionType | type):
        return value.__name__
    text = repr(value)
    if text.startswith("<"):  # what a dataclass makes anew for every object
        return "..."
    return text if len(text) <= LONGEST_DEFAULT else f"{type(value).__name__}(...)"


def readable(value: object) -> None:
    """The signature of a function of this package is readable from now on, or those of a class's methods.

    Those of the classes that its fields hold too: one asks for help on what a result is made of.
    """
    waiting, seen = [value], set()
    while waiting:
        one = waiting.pop()
        if isinstance(one, FunctionType):
            _make_readable(one)
        elif isinstance(one, type) and one not in seen and _is_ours(one):
            seen.add(one)
            waiting += one.__bases__
            for member in vars(one).values():
                _make_readable(getattr(member, "__func__", member))
            for kind in inspect.get_annotations(one).values():
                waiting += [kind, *get_args(kind), *(inner for arg in get_args(kind) for inner in get_args(arg))]


def _make_readable(function: object) -> None:
    """`function` has a signature of its own; what is none, or does not come from this package, stays as it is."""
    if not isinstance(function, FunctionType) or not _is_ours(function):
        return
    plain = inspect.signature(function)
    if not isinstance(plain, ReadableSignature):
        given = [
            ReadableParameter(p.name, p.kind, default=p.default, annotation=p.annotation)
            for p in plain.parameters.values()
        ]
        function.__signature__ = ReadableSignature(given, return_annotation=plain.return_annotation)  # type: ignore[attr-defined]


def _is_ours(thing: type | FunctionType) -> bool:
    return thing.__module__.partition(".")[0] == PACKAGE
