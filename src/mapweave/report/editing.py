"""The page on which somebody decides on places and robots: a map of the reports, with words to say beside it."""

from functools import cache
from importlib.resources import files

from .html import Page
from .scene import script

_BODY = """
<div id="map"></div>
<p id="told" role="status">reading the map</p>
<div class="bar edit"><label id="whole" hidden>map <select id="part"></select></label>
<label id="other" hidden>lay on it <select id="lay"></select></label><span id="hand" hidden>drag to move, with shift to
turn <label>by <input id="turn" type="range" min="-180" max="180" step="0.5" value="0"></label>
<button id="here">it lies here</button></span>
<button id="undo">undo</button><button id="save">save</button></div>
<div id="place" class="card" hidden><b></b><span></span><div class="bar">
<button data-word="together">believe it</button><button data-word="apart">forbid it</button>
<button data-word="undecided">as the scans say</button></div></div>
<h2 id="robots" hidden>Robots</h2><table id="pairs" hidden></table>
<h2>What is doubtful</h2><ul id="findings"></ul>
"""


def editing_page(title: str) -> str:
    """The whole page; it asks `/state.json` for what it shows and posts to `/decide`, `/undo`, `/save`."""
    page = Page(title, "Click a line between two places to believe or forbid it; all is solved again at once.")
    page.parts.append(_BODY)
    return page.html(f"{script()}{_script()}")


@cache
def _script() -> str:
    return (files(__package__) / "editing.js").read_text(encoding="utf-8")
