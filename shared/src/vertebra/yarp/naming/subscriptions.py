"""Persistent connections: which YARP ports a name server connects whenever both are there.

Somebody asks for them with `subscribe`, between two ports or by way of a topic: all that feed the
topic are connected to all that it feeds. Pure: who is there is asked of the table of names, and
what is to be connected is returned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from vertebra.yarp.protocol.bottle import Value

_MAX_SUBSCRIPTIONS: Final = 1000
_MAX_TOPICS: Final = 1000


@dataclass(frozen=True, slots=True)
class Match:
    """Two YARP ports that are to be connected.

    Attributes:
        afresh: One of them has just started: a connection that seems to be there is stale.
    """

    source: str
    dest: str
    carrier: str
    afresh: bool


@dataclass(frozen=True, slots=True)
class _End:
    """One end of a subscription, as it was written and what that means."""

    text: str
    carrier: str
    name: str


@dataclass(frozen=True, slots=True)
class _Subscription:
    source: _End
    dest: _End
    mode: str


class Subscriptions:
    """Persistent connections and topics.

    Args:
        is_live: Whether a port is registered and has announced itself.
    """

    def __init__(self, is_live: Callable[[str], bool]) -> None:
        self._is_live = is_live
        self._all: dict[tuple[str, str], _Subscription] = {}
        self._topics: dict[str, None] = {}

    def subscribe(self, source: str, dest: str, mode: str = "") -> bool:
        """Keep a connection, until `source` (mode `from`) or `dest` (`to`) goes, or for good.

        Returns False when there are too many.
        """
        ends = _end(source), _end(dest)
        for end in ends:
            if end.carrier == "topic" and not self.add_topic(end.name):
                return False
        pair = (ends[0].name, ends[1].name)
        if pair not in self._all and len(self._all) >= _MAX_SUBSCRIPTIONS:
            return False
        self._all[pair] = _Subscription(*ends, mode)
        for keeper in {"from": pair[:1], "to": pair[1:]}.get(mode, ()):
            if not self._is_live(keeper):
                del self._all[pair]
        return True

    def unsubscribe(self, source: str, dest: str) -> None:
        """Keep that connection no longer; one that exists is left alone."""
        self._all.pop((_end(source).name, _end(dest).name), None)

    def add_topic(self, name: str) -> bool:
        """Let a name be a topic; return False when there are too many."""
        if name not in self._topics and len(self._topics) >= _MAX_TOPICS:
            return False
        self._topics[name] = None
        return True

    def remove_topic(self, name: str) -> None:
        """Let a name be no topic."""
        self._topics.pop(name, None)

    def forget(self, name: str) -> None:
        """Drop what was to be kept only as long as the port `name` was there."""
        for pair, each in [*self._all.items()]:
            if {"from": pair[0], "to": pair[1]}.get(each.mode) == name:
                del self._all[pair]

    def matches(self, name: str, *, afresh: bool) -> list[Match]:
        """Return what is to be connected because of the port or topic `name`."""
        return self._live(self._pairs(name), afresh=afresh)

    def matches_of(self, source: str, dest: str) -> list[Match]:
        """Return what is to be connected because of this subscription."""
        ends = _end(source), _end(dest)
        if ends[1].carrier == "topic":
            return self.matches(ends[0].name, afresh=False)
        if ends[0].carrier == "topic":
            return self.matches(ends[1].name, afresh=False)
        return self._live([ends], afresh=False)

    def _live(self, pairs: Iterable[tuple[_End, _End]], *, afresh: bool) -> list[Match]:
        found: dict[Match, None] = {}
        for source, dest in pairs:
            if self._is_live(source.name) and self._is_live(dest.name):
                carrier = dest.carrier or source.carrier or "tcp"
                found[Match(source.name, dest.name, carrier, afresh)] = None
        return [*found]

    def _pairs(self, name: str) -> Iterator[tuple[_End, _End]]:
        for each in self._all.values():
            if name in (each.source.name, each.dest.name):
                yield each.source, each.dest
        for feeding in self._all.values():
            topic = feeding.dest.name
            if topic not in self._topics:
                continue
            for fed in self._all.values():
                if fed.source.name == topic and name in (
                    topic, feeding.source.name, fed.dest.name,
                ):  # fmt: skip
                    yield feeding.source, fed.dest

    def listed(self, name: str = "") -> list[Value]:
        """Return the subscriptions of a port, or all, as the bottle that YARP answers with."""
        reply: list[Value] = ["subscriptions"]
        for (source, dest), each in sorted(self._all.items()):
            if name and name not in (source, dest):
                continue
            entry: list[Value] = [
                "subscription", ["src", each.source.text], ["dest", each.dest.text],
            ]  # fmt: skip
            if each.mode:
                entry.append(["mode", each.mode])
            topics = [int(end in self._topics) for end in (source, dest)]
            if any(topics):
                entry.append(["topic", *topics])
            reply.append(entry)
        return reply

    def topics(self) -> list[Value]:
        """Return the names of the topics."""
        return [*self._topics]


def _end(text: str) -> _End:
    # `tcp://b` is the port /b: the slashes merge.
    carrier, separator, name = text.partition(":/")
    return _End(text, carrier, name) if separator and carrier else _End(text, "", text)
