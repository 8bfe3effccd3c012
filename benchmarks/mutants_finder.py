"""One-line mistakes that can be made in a Python source: which there are, and the source with one of them."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, order=True)
class Mutant:
    """`old` at bytes `start` to `end` of a source becomes `new`, on one line."""

    path: str
    line: int
    start: int
    end: int
    kind: str
    old: str
    new: str

    def apply(self, source: bytes) -> bytes:
        return source[: self.start] + self.new.encode() + source[self.end :]

    def lines(self, source: bytes) -> tuple[str, str]:
        """The line before and after, without what stands around it."""
        low, high = source.rfind(b"\n", 0, self.start) + 1, source.find(b"\n", self.end)
        old, new = source[low:high], source[low : self.start] + self.new.encode() + source[self.end : high]
        return old.decode().strip(), new.decode().strip()


ARITHMETIC = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*")}
COMPARISONS = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
GUARD = 2e-6  # constants up to this, and from its inverse on, keep zero from being divided by or stand for infinity
BOUNDS = {"min", "max", "minimum", "maximum"}
SKIPPED_FIELDS = {"annotation", "returns", "decorator_list"}
SKIPPED_NODES = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)
SKIPPED_KEYWORDS = {"axis", "dtype", "stacklevel"}


class Finder:
    """Every mistake that can be made in one source."""

    def __init__(self, path: str, source: bytes) -> None:
        self.path, self.source, self.tree = path, source, ast.parse(source)
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.parts = [(*span, ast.dump(ast.parse(source[slice(*span)]))) for span in map(self._span, self.tree.body)]

    def mutants(self) -> list[Mutant]:
        found = set(self._of(self.tree, in_index=False))
        return sorted(m for m in found if m.old != m.new and self._parses(m))

    def _of(self, node: ast.AST, *, in_index: bool) -> Iterator[Mutant]:
        if isinstance(node, ast.ClassDef) and any(ast.unparse(word) == "config" for word in node.decorator_list):
            return  # settings, chosen on logs
        if isinstance(node, SKIPPED_NODES) or (isinstance(node, ast.keyword) and node.arg in SKIPPED_KEYWORDS):
            return
        if getattr(node, "lineno", 0) == getattr(node, "end_lineno", None):
            yield from self._of_operator(node, in_index=in_index)
            yield from self._of_value(node, in_index=in_index)
        for field, value in ast.iter_fields(node):
            if field in SKIPPED_FIELDS:
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from self._of(
                        child, in_index=in_index or (isinstance(node, ast.Subscript) and field == "slice")
                    )
        if isinstance(node, ast.FunctionDef | ast.For | ast.While):
            yield from self._exits(node)

    def _of_operator(self, node: ast.AST, *, in_index: bool) -> Iterator[Mutant]:
        match node:
            case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
                yield from self._between(left, right, *ARITHMETIC[type(op)], "arithmetic")
                if isinstance(op, ast.Add | ast.Sub) and not in_index:
                    yield self._whole(node, self._text(left), "lost term")
                    minus = "-" if isinstance(op, ast.Sub) else ""
                    yield self._whole(node, f"{minus}({self._text(right)})", "lost term")
            case ast.UnaryOp(op=ast.USub(), operand=operand) if not in_index:
                yield self._whole(node, f"({self._text(operand)})", "sign")
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                yield self._whole(node, f"({self._text(operand)})", "condition")
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
                yield from self._between(left, right, *COMPARISONS[type(op)], "comparison")
            case ast.BoolOp(op=op, values=[left, right, *_]):
                words = ("and", "or") if isinstance(op, ast.And) else ("or", "and")
                yield from self._between(left, right, *words, "condition")
            case ast.AugAssign(target=target, op=op, value=value) if type(op) in ARITHMETIC:
                yield from self._between(target, value, *ARITHMETIC[type(op)], "arithmetic")

    def _of_value(self, node: ast.AST, *, in_index: bool) -> Iterator[Mutant]:
        match node:
            case ast.Attribute(value=value, attr="T"):
                yield self._whole(node, self._text(value), "lost transpose")
            case ast.Call(func=ast.Attribute(attr="clip"), args=[value, _, _]):
                yield self._whole(node, f"({self._text(value)})", "lost bound")
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[first, second]) if name in BOUNDS:
                kept = second if isinstance(first, ast.Constant) else first
                yield self._whole(node, f"({self._text(kept)})", "lost bound")
            case ast.Constant(value=float() as value) if GUARD < abs(value) < 1 / GUARD and not in_index:
                yield self._whole(node, repr(10.0 * value), "constant")

    def _exits(self, node: ast.FunctionDef | ast.For | ast.While) -> Iterator[Mutant]:
        """`if ...: continue` and `if ...: return`, where more follows in the same block."""
        for inner in node.body[:-1]:
            if isinstance(inner, ast.If) and isinstance(inner.body[-1], ast.Continue | ast.Return):
                last = inner.body[-1]
                if last.lineno == last.end_lineno:
                    yield self._whole(last, "pass", "lost exit")

    def _between(self, left: ast.expr, right: ast.expr, old: str, new: str, kind: str) -> Iterator[Mutant]:
        low, high = self._span(left)[1], self._span(right)[0]
        at = self.source[low:high].find(old.encode())
        if at >= 0 and b"\n" not in self.source[low:high]:
            yield self._mutant(left.end_lineno or 0, low + at, low + at + len(old), new, kind)

    def _whole(self, node: ast.expr | ast.stmt, new: str, kind: str) -> Mutant:
        return self._mutant(node.lineno, *self._span(node), new, kind)

    def _mutant(self, line: int, start: int, end: int, new: str, kind: str) -> Mutant:
        return Mutant(self.path, line, start, end, kind, self.source[start:end].decode(), new)

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        low = self.starts[node.lineno - 1] + node.col_offset
        return low, self.starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)

    def _text(self, node: ast.expr) -> str:
        low, high = self._span(node)
        return self.source[low:high].decode()

    def _parses(self, mutant: Mutant) -> bool:
        """Whether the statement of the module that holds it is Python still, and means something else."""
        low, high, meaning = next(part for part in self.parts if part[0] <= mutant.start < part[1])
        part = self.source[low : mutant.start] + mutant.new.encode() + self.source[mutant.end : high]
        try:
            return ast.dump(ast.parse(part)) != meaning
        except SyntaxError:
            return False
