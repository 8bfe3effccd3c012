"""The documentation: Markdown pages, the reference out of the docstrings, formulas as MathML that shows offline."""

import re
import runpy
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

import mapweave

project = "mapweave"
author = "The mapweave authors"
copyright = author  # noqa: A001  (what Sphinx calls it)
version = release = mapweave.__version__
language = "en"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
root_doc = "index"
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"mapweave {release}"  # the pages of several releases may stand side by side
html_theme_options = {"navigation_with_keys": True}
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"
highlight_language = "text"  # commands are no Python
pygments_style = "default"
pygments_dark_style = "github-dark"
myst_enable_extensions = ["dollarmath", "amsmath", "attrs_inline"]
myst_heading_anchors = 4
default_role = "code"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_ivar = True
suppress_warnings = ["misc.highlighting_failure"]

LITERAL = re.compile(r'(?<=<span class="pre">)[^<]{20,}')  # the text alone: the slash of the closing tag ends no part
ORDER = ("Verbs", "Results and records", "Configuration", "Errors")


def group(name: str) -> str:
    """The part of the reference that a public name stands in."""
    thing = getattr(mapweave, name)
    if not isinstance(thing, type):
        return "Verbs"
    if issubclass(thing, Exception):
        return "Errors"
    return "Configuration" if name.endswith(("Config", "Options", "Scene")) else "Results and records"


def reference() -> str:
    """The page of every public name, by group."""
    names = sorted(name for name in mapweave.__all__ if not name.startswith("_"))
    directive = {"Verbs": "autofunction", "Errors": "autoexception"}
    lines = [
        "# Python reference",
        "",
        "What `import mapweave` offers; [from Python](../python.md) tells how to use it.",
        "",
    ]
    for title in ORDER:
        lines += [f"## {title}", ""]
        for name in (one for one in names if group(one) == title):
            kind = directive.get(title, "autoclass")
            options = ["   :members:", "   :exclude-members: __new__, __init__"] if kind == "autoclass" else []
            lines += ["```{eval-rst}", f".. {kind}:: mapweave.{name}", *options, "```", ""]
    return "\n".join(lines)


def plain_text(_app: Sphinx, _what: str, _name: str, _thing: object, _options: object, lines: list[str]) -> None:
    """Escape what reStructuredText would read as markup: docstrings are plain text with `code` in backticks."""
    for k, line in enumerate(lines):
        if line.lstrip().startswith((">>>", "...", ".. ", ":")):
            continue
        parts = re.split(r"(`+[^`]*`+)", line)
        text = [re.sub(r"(?<!\\)([*|])", r"\\\1", part) for part in parts[::2]]
        text = [re.sub(r"^(?=\w)", r"\\ ", part) if at else part for at, part in enumerate(text)]
        lines[k] = "".join(part for pair in zip(text, [*parts[1::2], ""], strict=True) for part in pair)


def mathml(tex: str, display: str = "inline") -> str:
    """A formula; names with a digit stay one word, and a tilde is a relation: the converter knows neither."""
    named = re.sub(r"\\operatorname\{(\w*\d\w*)\}", r"\\text{\1}", tex)
    return convert(named, display=display).replace("<mi>&#x0007E;</mi>", "<mo>&#x0223C;</mo>")


def breakable(
    _app: Sphinx, _page: str, _template: str, context: dict[str, Any], _doctree: nodes.document | None
) -> None:
    """Long names of files and lists of columns may go on in the next line where a part of them ends."""
    if "body" in context:
        context["body"] = LITERAL.sub(lambda m: re.sub(r"(?<=[/,_:])(?=[\w.])", "<wbr>", m[0]), context["body"])


def math_inline(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(mathml(node.astext()))
    raise nodes.SkipNode


def math_block(self: HTML5Translator, node: nodes.math_block) -> None:
    self.body.append(f'<div class="math">{mathml(node.astext(), "block")}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (math_inline, None), (math_block, None))
    app.connect("html-page-context", breakable)
    app.connect("autodoc-process-docstring", plain_text, priority=900)
    page = Path(app.srcdir) / "reference" / "index.md"
    page.parent.mkdir(exist_ok=True)
    text = reference()
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")
    here = Path(app.srcdir)
    make = runpy.run_path(str(here.parent / "examples" / "make_notebooks.py"))["main"]
    make(here / "recipes" / "notebooks")
    return {"parallel_read_safe": True}
