"""Common names for landmarks that every robot has named for itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..landmarks.landmark_map import LandmarkMap
from .identities import IdentityConfig, match_maps


@dataclass(frozen=True, slots=True)
class Identified:
    """maps: with common names, in the order given; labels[k]: own name -> common name; reasons[k]: why map k was
    matched with no other.
    """

    maps: tuple[LandmarkMap, ...]
    labels: Mapping[int, Mapping[str, str]]
    reasons: Mapping[int, str] = field(default_factory=dict)


def identify(maps: Sequence[LandmarkMap], robots: Sequence[str], cfg: IdentityConfig | None = None) -> Identified:
    """`maps` with names that mean the same landmark in all of them; the names they came with mean nothing.

    Every pair of maps is matched, the surest matches are believed first, and no landmark is one with two of another
    map. A common name is the one it has in its first map, prefixed by the robot where that is taken already.
    """
    classes: dict[tuple[int, str], set[tuple[int, str]]] = {(k, i): {(k, i)} for k, m in enumerate(maps) for i in m.ids}
    matched: set[int] = set()
    refusals: dict[int, str] = {}
    matches = []
    for a in range(len(maps)):
        for b in range(a + 1, len(maps)):
            match = match_maps(maps[a], maps[b], cfg)
            if match.accepted:
                matches.append((-len(match.links), match.chi2 / max(match.dof, 1), a, b, match.links))
                matched |= {a, b}
            else:
                refusals.setdefault(a, f"with {robots[b]}: {match.reason}")
                refusals.setdefault(b, f"with {robots[a]}: {match.reason}")
    for _, _, a, b, links in sorted(matches, key=lambda f: f[:4]):
        for i, j in links:
            one, two = classes[a, maps[a].ids[i]], classes[b, maps[b].ids[j]]
            if one is not two and not {k for k, _ in one} & {k for k, _ in two}:
                one |= two
                classes.update(dict.fromkeys(two, one))
    names = _names(maps, robots, classes)
    renamed = [LandmarkMap(tuple(names[k, i] for i in m.ids), m.mean, m.cov, m.frame) for k, m in enumerate(maps)]
    labels = {k: {i: names[k, i] for i in m.ids if names[k, i] != i} for k, m in enumerate(maps)}
    lonely = {k: why for k, why in refusals.items() if k not in matched}
    return Identified(tuple(renamed), labels, lonely)


def _names(
    maps: Sequence[LandmarkMap], robots: Sequence[str], classes: Mapping[tuple[int, str], set[tuple[int, str]]]
) -> dict[tuple[int, str], str]:
    names: dict[tuple[int, str], str] = {}
    taken: set[str] = set()
    for k, m in enumerate(maps):
        for i in m.ids:
            if (k, i) in names:
                continue
            name = i if i not in taken else f"{robots[k]}:{i}"
            taken.add(name)
            names.update(dict.fromkeys(classes[k, i], name))
    return names
