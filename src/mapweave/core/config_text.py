"""A configuration as TOML that people edit: every key with its default and what it means, from the source itself."""

import ast
import inspect
import io
import textwrap
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass

from .errors import ConfigError

WIDTH = 44  # columns in which meanings begin, where keys and values leave room


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a configuration. path: the tables it stands in, outermost first; meaning: empty where none is told."""

    path: tuple[str, ...]
    name: str
    value: object
    meaning: str

    @property
    def dotted(self) -> str:
        return ".".join((*self.path, self.name))


def keys(cfg: object, path: tuple[str, ...] = ()) -> Iterator[Key]:
    """Every key of `cfg`, an instance of a configuration class, those of a table before its inner tables.

    Where a job reads some keys alone, its class names them in `READ`, dotted, tables with a dot at the end.
    """
    read = getattr(cfg, "READ", ("",))
    meaning = meanings(type(cfg))
    inner = []
    for field in fields(cfg):  # type: ignore[arg-type]
        value = getattr(cfg, field.name)
        if is_dataclass(value):
            inner.append((field.name, value))
        else:
            yield Key(path, field.name, value, meaning.get(field.name, ""))
    for name, value in inner:
        yield from (key for key in keys(value, (*path, name)) if key.dotted.startswith(read))


def meanings(cls: type) -> dict[str, str]:
    """What each field of `cls` means: the comment at the end of its line, or the text that stands below it.

    Those that it inherits mean what they mean there.
    """
    inherited = [base for base in cls.__mro__[:0:-1] if is_dataclass(base)]
    return {name: text for c in (*inherited, cls) for name, text in own_meanings(inspect.getsource(c)).items()}


def own_meanings(source: str) -> dict[str, str]:
    """What the fields mean that the source of a class defines itself."""
    source = textwrap.dedent(source)
    (tree,) = ast.parse(source).body
    comments = {
        token.start[0]: token.string.lstrip("#").strip()
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    meaning: dict[str, str] = {}
    before = ""
    for node in getattr(tree, "body", []):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            before = node.target.id
            lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
            meaning[before] = " ".join(comments[k] for k in lines if k in comments)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and before:
            meaning[before] = " ".join(str(node.value.value).split())
    return meaning


def as_toml(cfg: object, head: str = "") -> str:
    """`cfg` as TOML with a comment a key; read again it gives an equal configuration.

    A key that is not set stands as a comment, since TOML has no word for that.
    """
    out = [f"# {line}" for line in head.splitlines()]
    table: tuple[str, ...] = ()
    for key in keys(cfg):
        if key.path != table:
            out += ["", f"[{'.'.join(key.path)}]"]
            table = key.path
        line = f"# {key.name} = (not set)" if key.value is None else f"{key.name} = {_toml(key.value)}"
        out.append(f"{line:<{WIDTH}}  # {key.meaning}" if key.meaning else line)
    return "\n".join(out).lstrip("\n") + "\n"


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(float(value)) if isinstance(value, float) else repr(int(value))
    if isinstance(value, str):
        text = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{text}"'
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    raise ConfigError(f"{value!r}: has no form in TOML")
