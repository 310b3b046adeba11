"""The ROS graph as rclpy tells it, for the driver `rclpy`.

rclpy does not tell of changes: a thread looks again and again, and hands over what is new.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any, Final

from msgspec import Struct
from rclpy.topic_endpoint_info import TopicEndpointTypeEnum

from vertebra.ros2.graph import Endpoint, Graph, endpoint_of
from vertebra.ros2.rclpy.classes import qos_of
from vertebra.ros2.rclpy.node import Inbox, RosNode

LOOK_EVERY_S: Final = 0.25
_NODES: Final = b"everybody"
"""rclpy does not tell which participant a node is of."""


class Seen(Struct, frozen=True):
    """The graph at one moment, without ourselves."""

    endpoints: dict[bytes, Endpoint]
    nodes: dict[str, frozenset[bytes]]


class GraphWatch:
    """Keeps a graph as rclpy tells it."""

    def __init__(self, ros: RosNode, graph: Graph, changed: Callable[[], None]) -> None:
        self._ros = ros
        self._graph = graph
        self._changed = changed
        self._told = Seen({}, {})
        self._inbox = Inbox(1, self._take_over)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros2 graph", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        seen = self._told
        try:
            while not self._stopping.wait(LOOK_EVERY_S):
                before, seen = seen, self._look()
                if seen != before:
                    self._inbox.put(seen)
        except Exception as error:  # noqa: BLE001  - a thread that ends must not end silently
            self._ros.fail(error)

    def _look(self) -> Seen:
        node = self._ros.node
        us = (node.get_name(), node.get_namespace())
        nodes = {full_name(*one): set[bytes]() for one in node.get_node_names_and_namespaces()}
        nodes.pop(full_name(*us), None)
        endpoints = {}
        for topic, _ in node.get_topic_names_and_types(no_demangle=True):
            infos = [
                *node.get_publishers_info_by_topic(topic, no_mangle=True),
                *node.get_subscriptions_info_by_topic(topic, no_mangle=True),
            ]
            for info in infos:
                endpoint = _endpoint(topic, info)
                if endpoint is None or endpoint.gid.startswith(self._ros.participant):
                    continue
                endpoints[endpoint.gid] = endpoint
                name = full_name(info.node_name, info.node_namespace)
                if name in nodes:
                    nodes[name].add(endpoint.gid)
        return Seen(endpoints, {name: frozenset(gids) for name, gids in nodes.items()})

    def _take_over(self, seen: Seen) -> None:
        before, self._told = self._told, seen
        for gid in before.endpoints.keys() - seen.endpoints.keys():
            self._graph.remove(gid)
        for gid, endpoint in seen.endpoints.items():
            if before.endpoints.get(gid) != endpoint:
                self._graph.add(endpoint)
        self._graph.set_nodes(_NODES, seen.nodes)
        self._changed()

    async def close(self) -> None:
        """Look no more."""
        self._stopping.set()
        await asyncio.to_thread(self._thread.join)


def full_name(node: str, namespace: str) -> str:
    """Return the full name of a node."""
    return f"{namespace.rstrip('/')}/{node}"


def _endpoint(topic: str, info: Any) -> Endpoint | None:
    """Return what ROS tells of an endpoint; None if it is none of ROS."""
    # As rmw_cyclonedds says it. rclpy reaches services of every middleware, whoever joins them.
    type_hash = str(info.topic_type_hash)
    known = f"typehash={type_hash};" if type_hash.startswith("RIHS") else ""
    return endpoint_of(
        gid=bytes(info.endpoint_gid),
        kind="writer" if info.endpoint_type == TopicEndpointTypeEnum.PUBLISHER else "reader",
        topic=topic,
        type_name=info.topic_type,
        qos=qos_of(info.qos_profile),
        user_data=f"serviceid=rclpy;{known}".encode(),
    )
