"""Whatever fails on what one robot told costs that robot's part alone: who it is, and what can be made without it."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from ..core.errors import MapweaveError, UsageError

Made = TypeVar("Made")


def in_words(error: BaseException) -> str:
    """What failed, in one line: an error of ours by its text, any other with its name."""
    text = " ".join(str(error).split())
    return text if isinstance(error, MapweaveError) and text else f"{type(error).__name__}: {text}".removesuffix(": ")


def without_culprits(
    robots: Sequence[str], make: Callable[[Sequence[str]], Made]
) -> tuple[Made | None, tuple[str, ...], dict[str, str]]:
    """What `make` gives of as many of `robots` as it can, of which, and why it failed with each of the others.

    Where `make` fails for all together, those it fails for alone are left out, then, if that is not enough, those it
    fails for beside the ones that come before. None where nothing could be made.
    """
    failed: dict[str, str] = {}

    def made(some: Sequence[str], blame: str = "") -> Made | None:
        try:
            return make(some)
        except UsageError:  # what was asked for, and no robot's fault
            raise
        except Exception as error:  # noqa: BLE001  (whatever it is, the others get their map)
            if blame:
                failed[blame] = in_words(error)
            return None

    whole = made(robots, robots[0] if len(robots) == 1 else "")
    if whole is not None or len(robots) < 2:
        return whole, tuple(robots if whole is not None else ()), failed
    alone = {name: made([name], name) for name in robots}
    kept = [name for name in robots if alone[name] is not None]
    if len(kept) < 2:
        return (alone[kept[0]] if kept else None), tuple(kept), failed
    if failed and (together := made(kept)) is not None:
        return together, tuple(kept), failed
    best, held = alone[kept[0]], kept[:1]
    for name in kept[1:]:
        more = made([*held, name], name)
        if more is not None:
            best, held = more, [*held, name]
    return best, tuple(held), failed
