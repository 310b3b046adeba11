"""The ROS graph: which endpoints there are, of which nodes, and what they say of themselves.

DDS tells of each endpoint its topic, type, QoS and USER_DATA, in which ROS puts the hash of the
type and, at services, who belongs together. The names of nodes come by a topic of their own,
`ros_discovery_info`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal

from msgspec import Struct

from vertebra.errors import DecodeError
from vertebra.messages import Array
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.names import DISCOVERY_TYPE, DISCOVERY_TYPE_HUMBLE, Role, ros_name, ros_type
from vertebra.ros2.qos import Qos

OTHER_MIDDLEWARE: Final = (
    "its node runs another middleware than Cyclone DDS (Jazzy's default is Fast DDS), which keeps "
    "the caller where this driver cannot see it: start that node with "
    "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or set VERTEBRA_ROS2_DRIVER=rclpy here"
)
GID_BYTES: Final = 16
_Place = tuple[Literal["writer", "reader"], Role, str]
_PARTS: Final[dict[Role, str]] = {"topic": "", "request": "_Request", "reply": "_Response"}


class Endpoint(Struct, frozen=True, kw_only=True):
    """A writer or a reader of another participant.

    Attributes:
        gid: Its identity, which begins with that of its participant.
        kind: Which of both.
        role: Whether it is of a topic, or of requests or replies of a service.
        name: ROS name of the topic or service.
        type: ROS type; of a service the whole one, such as `std_srvs/srv/Trigger`.
        qos: What it offers or requests.
        type_hash: What it says its type is; empty if it does not.
        identity: What joins the endpoints of one client or server of rmw_cyclonedds; empty at
            those of other middleware on DDS.
        node: Full name of its node; empty where that is told apart from it, as on DDS.
    """

    gid: bytes
    kind: Literal["writer", "reader"]
    role: Role
    name: str
    type: str
    qos: Qos
    type_hash: str = ""
    identity: str = ""
    node: str = ""


class Service(Struct, frozen=True, kw_only=True):
    """A ROS service that somebody offers.

    Attributes:
        type: Its type; empty if its servers do not agree.
        reachable: Whether all its servers look for the client in the request, as rmw_cyclonedds
            does. Fast DDS has it where the driver `dds` cannot put it.
    """

    type: str
    reachable: bool

    @property
    def problem(self) -> str:
        """Why it cannot be called, and what mends it; empty if it can."""
        if not self.type:
            return "its servers do not agree on its type; stop one of them"
        return "" if self.reachable else OTHER_MIDDLEWARE


def entries_of(text: bytes) -> dict[str, str]:
    """Return the entries of a USER_DATA, `key=value;` each; what is none is left out."""
    entries = text.decode("utf-8", "replace").split(";")
    pairs = (entry.partition("=") for entry in entries)
    return {key: value for key, equals, value in pairs if equals}


def endpoint_of(
    *,
    gid: bytes,
    kind: Literal["writer", "reader"],
    topic: str,
    type_name: str,
    qos: Qos,
    user_data: bytes,
) -> Endpoint | None:
    """Return what DDS tells of an endpoint with this USER_DATA; None if it is none of ROS."""
    known, whole = ros_name(topic), ros_type(type_name)
    if known is None or whole is None or not whole.endswith(_PARTS[known.role]):
        return None
    entries = entries_of(user_data)
    return Endpoint(
        gid=gid,
        kind=kind,
        role=known.role,
        name=known.name,
        type=whole.removesuffix(_PARTS[known.role]),
        qos=qos,
        type_hash=entries.get("typehash", ""),
        identity=entries.get("serviceid") or entries.get("clientid", ""),
    )


def nodes_of(payload: bytes, cdr: Cdr) -> tuple[bytes, dict[str, frozenset[bytes]]]:
    """Return the participant and its nodes that a sample of `ros_discovery_info` tells of.

    Raises:
        DecodeError: It is none, neither of Humble nor of a later release.
    """
    try:
        record = cdr.decode(payload, DISCOVERY_TYPE)
    except DecodeError:
        record = cdr.decode(payload, DISCOVERY_TYPE_HUMBLE)
    nodes = {
        f"{node['node_namespace'].rstrip('/')}/{node['node_name']}": frozenset(
            map(_gid, [*node["reader_gid_seq"], *node["writer_gid_seq"]])
        )
        for node in record["node_entities_info_seq"]
    }
    return _gid(record["gid"]), nodes


class Graph:
    """Everything of other participants that is known now.

    Attributes:
        ignored: Beginnings of gids whose endpoints are as little shown as our own.
    """

    def __init__(self) -> None:
        self.ignored: tuple[bytes, ...] = ()
        self._endpoints: dict[bytes, Endpoint] = {}
        self._by_place: dict[_Place, dict[bytes, Endpoint]] = {}
        self._nodes: dict[bytes, Mapping[str, frozenset[bytes]]] = {}

    def add(self, endpoint: Endpoint) -> None:
        """Note an endpoint, or what has changed of it."""
        self.remove(endpoint.gid)
        self._endpoints[endpoint.gid] = endpoint
        self._by_place.setdefault(_place(endpoint), {})[endpoint.gid] = endpoint

    def remove(self, gid: bytes) -> bool:
        """Forget an endpoint; say whether it was known."""
        known = self._endpoints.pop(gid, None)
        if known is None:
            return False
        at_place = self._by_place[_place(known)]
        del at_place[gid]
        if not at_place:
            del self._by_place[_place(known)]
        return True

    def ignore(self, participants: Iterable[bytes]) -> None:
        """Show nothing of these participants from now on, but of all others."""
        self.ignored = tuple(participants)

    def knows(self, participant: bytes) -> bool:
        """Say whether a participant is there, ignored or not."""
        return any(gid.startswith(participant) for gid in self._nodes)

    def set_nodes(self, participant: bytes, nodes: Mapping[str, frozenset[bytes]]) -> None:
        """Note which endpoints the nodes of a participant have, by their full names."""
        self._nodes[participant] = nodes

    def remove_participant(self, gid: bytes) -> None:
        """Forget the nodes of a participant."""
        self._nodes.pop(gid, None)

    def nodes(self) -> list[str]:
        """Return the full names of all nodes, sorted."""
        return sorted(name for nodes in self._nodes.values() for name in nodes)

    def node_of(self, endpoint: Endpoint) -> str:
        """Return the full name of an endpoint's node; empty if nobody told."""
        if endpoint.node:
            return endpoint.node
        for nodes in self._nodes.values():
            for name, gids in nodes.items():
                if endpoint.gid in gids:
                    return name
        return ""

    def writers(self, name: str, role: Role = "topic") -> list[Endpoint]:
        """Return who writes a topic, or requests or replies of a service."""
        return self._find("writer", role, name)

    def readers(self, name: str, role: Role = "topic") -> list[Endpoint]:
        """Return who reads a topic, or requests or replies of a service."""
        return self._find("reader", role, name)

    def topics(self) -> dict[str, frozenset[str]]:
        """Return the types of each topic; one that has more than one is nobody's to read."""
        found: dict[str, set[str]] = {}
        for (_, role, name), endpoints in self._by_place.items():
            shown = [one for gid, one in endpoints.items() if not gid.startswith(self.ignored)]
            if role == "topic" and shown:
                found.setdefault(name, set()).update(one.type for one in shown)
        return {name: frozenset(types) for name, types in sorted(found.items())}

    def services(self) -> dict[str, Service]:
        """Return all services that are offered."""
        offered = sorted(
            name for kind, role, name in self._by_place if (kind, role) == ("reader", "request")
        )
        found = ((name, self.service(name)) for name in offered)
        return {name: service for name, service in found if service is not None}

    def service(self, name: str) -> Service | None:
        """Return a service; None if nobody offers it."""
        servers = self.readers(name, "request")
        types = {one.type for one in servers}
        if not servers:
            return None
        return Service(
            type=types.pop() if len(types) == 1 else "",
            reachable=all(one.identity for one in servers),
        )

    def _find(self, kind: Literal["writer", "reader"], role: Role, name: str) -> list[Endpoint]:
        found = self._by_place.get((kind, role, name), {})
        return [one for gid, one in found.items() if not gid.startswith(self.ignored)]


def _place(endpoint: Endpoint) -> _Place:
    return (endpoint.kind, endpoint.role, endpoint.name)


def _gid(record: Mapping[str, Array]) -> bytes:
    return bytes(record["data"].data)[:GID_BYTES]  # Humble's have 8 more, all zero
