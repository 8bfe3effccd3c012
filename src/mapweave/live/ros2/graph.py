"""Who is in a ROS graph: robots with a laser, told by the namespaces of what they publish."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from ..messages import RefusedError
from .cdr import ODOMETRY, SCAN, TF, type_hash
from .wire import NO_HASH, PUBLISHER, Entity, Topic

Place = tuple[str, ...]  # namespaces, the outermost first


@dataclass(frozen=True, slots=True)
class RosRobot:
    """One robot of a graph. name: its namespace without slashes around, empty where there is none.

    tf, tf_static: topics of transforms, its own before those of all; scanners: its other scans; beside: other odometry,
    which is not heard.
    """

    name: str
    scan: Topic
    odometry: Topic | None
    tf: tuple[Topic, ...]
    scanners: tuple[Topic, ...] = ()
    beside: tuple[str, ...] = ()

    @property
    def called(self) -> str:
        return self.name or "the robot without a namespace"

    @property
    def topics(self) -> tuple[Topic, ...]:
        return (self.scan, *([self.odometry] if self.odometry else []), *self.tf)


@dataclass(slots=True)
class Graph:
    """The tokens that are held now. refused: by their reason and what was told of it."""

    entities: dict[str, Entity] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)

    def put(self, token: str) -> None:
        try:
            self.entities[token] = Entity.read(token)
        except RefusedError as error:
            self.refused.setdefault(token, str(error))

    def drop(self, token: str) -> None:
        self.entities.pop(token, None)

    def published(self, kind: str) -> list[Topic]:
        """Topics of a type that somebody publishes with a hash that we can read, each once, in the order of names.

        Another hash is another definition of the message: it is told in `refused`.
        """
        topics: dict[str, Topic] = {}
        for token, entity in sorted(self.entities.items()):
            topic = entity.topic
            if entity.kind != PUBLISHER or topic is None or topic.kind != kind:
                continue
            if topic.type_hash in {type_hash(kind), NO_HASH}:
                topics.setdefault(topic.name, topic)
            else:
                refusal = (
                    f"hash: {topic.name} is {kind} of another definition, {topic.type_hash}; ours {type_hash(kind)}"
                )
                self.refused.setdefault(token, refusal)
        return [topics[name] for name in sorted(topics)]

    def publishers_of(self, name: str, but: str) -> list[str]:
        """Nodes that publish the topic `name` in sessions other than `but`."""
        mine = (e for e in self.entities.values() if e.kind == PUBLISHER and e.topic and e.topic.name == name)
        return sorted({f"{e.namespace.rstrip('/')}/{e.node}" for e in mine if e.session != but})

    def robots(self) -> list[RosRobot]:
        """Every robot that publishes scans, in the order of names."""
        scans, odometry, tf = self.published(SCAN), self.published(ODOMETRY), self.published(TF)
        homes: dict[str, list[Topic]] = {}
        for topic in scans:
            homes.setdefault("/".join(_home(_place(topic), [_place(t) for t in (*odometry, *tf)])), []).append(topic)
        return [self._robot(name, homes, odometry, tf) for name in sorted(homes)]

    @staticmethod
    def _robot(name: str, homes: dict[str, list[Topic]], odometry: Sequence[Topic], tf: Sequence[Topic]) -> RosRobot:
        place: Place = tuple(name.split("/")) if name else ()
        others = [tuple(h.split("/")) for h in homes if h and h != name]
        free = [t for t in odometry if not any(_within(_place(t), other) for other in others)]
        mine = [t for t in free if _within(_place(t), place)] or (free if len(homes) == 1 else [])
        scan, *more = _best(homes[name], "scan")
        wheels = _best(mine, "odom")
        own = [t for t in tf if place and _within(_place(t), place)]
        shared = [t for t in tf if not _place(t)]
        beside = tuple(t.name for t in wheels[1:])
        return RosRobot(name, scan, wheels[0] if wheels else None, (*own, *shared), tuple(more), beside)


def chosen(robots: Sequence[RosRobot], name: str, pattern: str | None) -> RosRobot | None:
    """The only robot whose namespace fits `pattern`; without one that of `name`, or the only one; None while there

    is none. Raises RefusedError, listing them, where several could be meant.
    """
    if pattern is not None:
        fit = [r for r in robots if fnmatchcase(r.name, pattern.strip("/"))]
    else:
        fit = [r for r in robots if r.name == name] or list(robots)
    if len(fit) > 1:
        there = ", ".join(r.name or "one without a namespace" for r in fit)
        raise RefusedError("pattern", f"--pattern: which robot is {name}? There are {there}")
    return fit[0] if fit else None


def _place(topic: Topic) -> Place:
    return tuple(topic.name.strip("/").split("/")[:-1])


def _within(place: Place, home: Place) -> bool:
    return place[: len(home)] == home


def _home(place: Place, others: Iterable[Place]) -> Place:
    """The deepest namespace around a scan topic that holds odometry or transforms too; its own where none does."""
    about = list(others)
    return next((place[:n] for n in range(len(place), 0, -1) if any(_within(o, place[:n]) for o in about)), place)


def _best(topics: Iterable[Topic], word: str) -> list[Topic]:
    """Those whose last part is `word` first, then those nearest to the root."""
    return sorted(topics, key=lambda t: (t.name.rsplit("/", 1)[-1] != word, len(_place(t)), t.name))
