"""Notebooks from the examples: `python examples/make_notebooks.py [FOLDER]`, one .ipynb a script.

A comment that begins a paragraph becomes text, the rest code; functions and blocks stay whole.
"""

import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def cells(source: str) -> list[dict]:
    """The cells of a script: its docstring as a title, then text and code in turn."""
    _, title, body = source.split('"""', 2)
    out = [_text(f"# {title.strip()}")]
    for part in _paragraphs(body):
        lines = part.split("\n")
        comment = []
        while lines and lines[0].startswith("# "):
            comment.append(lines.pop(0)[2:])
        if comment:
            out.append(_text(" ".join(comment)))
        if any(lines):
            out.append(_code("\n".join(lines).strip("\n")))
    return out


def notebook(source: str) -> dict:
    """A notebook of format 4.5; its cells have no output yet."""
    made = [{"id": f"cell-{k}", **cell} for k, cell in enumerate(cells(source))]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def scripts() -> list[Path]:
    """Every example but this one."""
    return sorted(path for path in HERE.glob("*.py") if path.name != Path(__file__).name)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for script in scripts():
        made = notebook(script.read_text(encoding="utf-8"))
        path = folder / f"{script.stem}.ipynb"
        path.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _paragraphs(body: str) -> list[str]:
    """Parts between blank lines; what is indented belongs to the part before."""
    parts: list[str] = []
    for part in body.strip("\n").split("\n\n"):
        if parts and (part.lstrip("\n").startswith(" ") or parts[-1].rstrip().endswith(":")):
            parts[-1] += f"\n\n{part}"
        elif part.strip():
            parts.append(part.strip("\n"))
    return parts


def _text(text: str) -> dict:
    return {"cell_type": "markdown", "metadata": {}, "source": text}


def _code(text: str) -> dict:
    return {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [], "source": text}


if __name__ == "__main__":
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "notebooks"
    main(where)
    print(f"{where}: {len(scripts())} notebooks")
