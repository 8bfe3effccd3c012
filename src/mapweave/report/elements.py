"""HTML by elements: whatever is put into one is escaped, unless it is HTML already."""

from html import escape

VOID = {"br", "img"}  # elements that nothing is in


class Html(str):
    """Text that is HTML; all other text is escaped where it is put into an element."""

    __slots__ = ()


NOTHING = Html()


def joined(*inner: str) -> Html:
    """All of it as HTML, one after the other."""
    return Html("".join(part if isinstance(part, Html) else escape(part) for part in inner))


def tag(name: str, *inner: str, **attributes: str | int) -> Html:
    """The element `name` with what is in it; an attribute called as a word of Python has `_` behind."""
    given = "".join(f' {key.removesuffix("_")}="{escape(str(value))}"' for key, value in attributes.items())
    return Html(f"<{name}{given}>" if name in VOID else f"<{name}{given}>{joined(*inner)}</{name}>")
