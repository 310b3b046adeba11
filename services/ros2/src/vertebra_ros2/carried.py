"""What all routes have in common."""

from __future__ import annotations

from typing import Protocol

from prometheus_client import Counter

from vertebra.errors import CodecError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Transport
from vertebra.ros2.graph import Endpoint
from vertebra.service import Context
from vertebra_ros2.settings import Ros2Settings


class Kit:
    """What every route has at hand.

    Attributes:
        origin: Begins the origin of every message that came from this ROS domain.
    """

    def __init__(self, context: Context[Ros2Settings], transport: Transport, types: Types) -> None:
        self.context = context
        self.transport = transport
        self.types = types
        self.cdr = Cdr(types)
        self.origin = f"ros2:{context.settings.domain_id}:"
        self.refused = context.counter("ros2_refused", "Messages that could not be read or mapped")
        self.dropped = context.counter("ros2_dropped", "Messages that came faster than we read")
        self.messages = Counter(
            "ros2_messages",
            "Messages that a route carried",
            ["ros", "key", "direction"],
            namespace="vertebra",
            registry=context.metrics,
        )

    def report(self, what: str, problem: str) -> None:
        """Tell operators what is wrong with a part; nothing, if `problem` is empty."""
        self.context.report(what, "warning" if problem else "ok", problem)

    def clash(self, endpoints: list[Endpoint], type_name: str) -> str:
        """Return why endpoints do not mean what we mean by a type, in words; empty if they do.

        An endpoint that says nothing of its type's definition is believed, and so is one of a type
        that is not known here.
        """
        for one in endpoints:
            if one.type != type_name:
                return f"{one.kind} of type {one.type} where {type_name} is meant"
        try:
            ours = self.types.hash_of(type_name)
        except CodecError:
            return ""
        for one in endpoints:
            if one.type_hash and one.type_hash != ours:
                node = self.transport.graph.node_of(one) or "a node without name"
                return (
                    f"{node} has another definition of {type_name} ({one.type_hash}) than we "
                    f"({ours}); put its package into VERTEBRA_ROS2_TYPES, or build that node anew"
                )
        return ""


class Carried(Protocol):
    """A route at work."""

    def look(self) -> None:
        """Do what the graph, as it is now, makes necessary; called after each change of it."""
        ...

    async def close(self) -> None:
        """End it."""
        ...
