"""What `rmw_zenoh_cpp` puts on Zenoh: keys, the tokens of its graph, and attachments.

Protocol source: `docs/design.md` of ros2/rmw_zenoh, and what its release 0.2.5 (Jazzy) does.
Topics and services have keys of one form, `<domain>/<name>/<DDS type>/<type hash>`. Each node and
each endpoint is a liveliness token whose key says everything of it; their sum is the graph.
"""

from __future__ import annotations

import re
import struct
from typing import Final, Literal, get_args

import xxhash
from msgspec import Struct

from vertebra.errors import DecodeError
from vertebra.ros2.graph import Endpoint
from vertebra.ros2.names import Role, check_name, dds_type, ros_type
from vertebra.ros2.qos import Qos

NO_HASH: Final = "TypeHashNotSupported"
"""Stands where the hash of a type would, at nodes of ROS 2 Humble, which has none."""
ANY_HASH: Final = "*"
GID_BYTES: Final = 16

Kind = Literal["NN", "MP", "MS", "SS", "SC"]
"""Node; publisher and subscription of a topic; server and client of a service."""
_KINDS: Final[dict[str, Kind]] = {kind: kind for kind in get_args(Kind)}
_PLACES: Final[dict[Kind, tuple[Literal["writer", "reader"], Role]]] = {
    "MP": ("writer", "topic"),
    "MS": ("reader", "topic"),
    "SC": ("writer", "request"),
    "SS": ("reader", "request"),
}

_SPACE: Final = "@ros2_lv"
_SESSION: Final = re.compile(r"[0-9a-f]{1,32}")
_NUMBER: Final = re.compile(r"[0-9]{1,20}")
_NODE_CHUNKS: Final = 9
_ENDPOINT_CHUNKS: Final = 13
_BEST_EFFORT: Final = "2"
_TRANSIENT_LOCAL: Final = "1"
_DEFAULT_DEPTH: Final = 42
_NUMBERS: Final = struct.Struct("<qq")
_NAMED: Final = struct.Struct("<16sq17sq11s")
"""The same with the name, and its length, of what follows; so Jazzy's 0.2.0 to 0.2.3 have it."""
_FIRST_NAME: Final = b"\x0fsequence_number"


def key_of(domain_id: int, name: str, type_name: str, type_hash: str) -> str:
    """Return the key of a topic or service; it is an expression if the hash is `ANY_HASH`."""
    return f"{domain_id}{check_name(name)}/{dds_type(type_name)}/{type_hash or NO_HASH}"


def graph_of(domain_id: int) -> str:
    """Return the key expression of all tokens in a domain."""
    return f"{_SPACE}/{domain_id}/**"


class Token(Struct, frozen=True, kw_only=True):
    """What a node or an endpoint says of itself as long as it lives.

    Attributes:
        domain_id: Domain of its node.
        session: Identity of the Zenoh session, hexadecimal.
        node_id: Number of its node in the session.
        entity_id: Its own number in the session; a node's is that of the node.
        kind: What it is.
        enclave: Of its node.
        namespace: Of its node.
        node: Name of its node, without the namespace.
        name: Of its topic or service; empty at a node, as is what follows.
        type: ROS type of the topic, or of the whole service.
        type_hash: RIHS01; empty if its node cannot tell.
        qos: What it offers or requests.
    """

    domain_id: int
    session: str
    node_id: str
    entity_id: str
    kind: Kind
    enclave: str = "/"
    namespace: str = "/"
    node: str
    name: str = ""
    type: str = ""
    type_hash: str = ""
    qos: Qos = Qos()

    @property
    def key(self) -> str:
        """The key of the token."""
        place = (self.session, self.node_id, self.entity_id, self.kind)
        of_node = map(_mangle, (self.enclave, self.namespace, self.node))
        chunks = [_SPACE, str(self.domain_id), *place, *of_node]
        if self.kind != "NN":
            chunks += [_mangle(self.name), dds_type(self.type)]
            chunks += [self.type_hash or NO_HASH, qos_text(self.qos)]
        return "/".join(chunks)

    @property
    def participant(self) -> bytes:
        """Identity of its session, 16 bytes."""
        return bytes.fromhex(self.session.zfill(2 * GID_BYTES))

    @property
    def node_name(self) -> str:
        """Full name of its node."""
        return f"{self.namespace.rstrip('/')}/{self.node}"


def read_token(key: str) -> Token:
    """Return what a token says, without what later releases may add to it.

    Raises:
        DecodeError: It is no token of rmw_zenoh.
        NameMappingError: It names a topic or service as ROS cannot.
    """
    space, *chunks = key.split("/")
    if space != _SPACE or len(chunks) + 1 < _NODE_CHUNKS:
        raise DecodeError(f"{key!r} is no token of rmw_zenoh")
    domain_id, session, node_id, entity_id, letters = chunks[:5]
    kind = _KINDS.get(letters)
    if not _NUMBER.fullmatch(domain_id) or not _SESSION.fullmatch(session) or kind is None:
        raise DecodeError(f"{key!r} is the token of neither a node nor an endpoint")
    enclave, namespace, node = map(_unmangle, chunks[5:8])
    name = type_name = type_hash = ""
    qos = Qos()
    if kind != "NN":
        if len(chunks) + 1 < _ENDPOINT_CHUNKS:
            raise DecodeError(f"{key!r} is the token of an endpoint that does not say of what")
        name = check_name(_unmangle(chunks[8]))
        type_name = ros_type(chunks[9]) or ""
        if not type_name:
            raise DecodeError(f"{chunks[9]!r} is no type of ROS, in the token {key!r}")
        type_hash = "" if chunks[10] == NO_HASH else chunks[10]
        qos = read_qos(chunks[11])
    return Token(
        domain_id=int(domain_id),
        session=session,
        node_id=node_id,
        entity_id=entity_id,
        kind=kind,
        enclave=enclave,
        namespace=namespace,
        node=node,
        name=name,
        type=type_name,
        type_hash=type_hash,
        qos=qos,
    )


def endpoint_of(token: Token, key: str) -> Endpoint:
    """Return what an endpoint is in the graph, from its token and the key that it was read from.

    Its gid there begins with its participant, and ends with what messages of it carry.
    """
    kind, role = _PLACES[token.kind]
    return Endpoint(
        gid=token.participant + gid_of(key),
        kind=kind,
        role=role,
        name=token.name,
        type=token.type,
        qos=token.qos,
        type_hash=token.type_hash,
        identity="" if role == "topic" else key,
        node=token.node_name,
    )


def gid_of(token_key: str) -> bytes:
    """Return the identity of what has this token: 16 bytes, in each attachment of its messages."""
    return xxhash.xxh3_128_digest(token_key.encode())[::-1]


def _mangle(name: str) -> str:
    return name.replace("/", "%")


def _unmangle(chunk: str) -> str:
    return chunk.replace("%", "/")


def qos_text(qos: Qos) -> str:
    """Return a QoS as tokens have it: what is rmw_zenoh's default is left empty."""
    reliability = _BEST_EFFORT if qos.reliability == "best_effort" else ""
    durability = _TRANSIENT_LOCAL if qos.durability == "transient_local" else ""
    depth = "" if qos.depth == _DEFAULT_DEPTH else str(qos.depth)
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def read_qos(text: str) -> Qos:
    """Return the QoS in a token; deadline, lifespan and liveliness, which decide nothing, go.

    Raises:
        DecodeError: It is none.
    """
    reliability, durability, history, *_ = (*text.split(":"), "", "", "")
    depth = history.partition(",")[2] or str(_DEFAULT_DEPTH)
    if text.count(":") < 2 or not _NUMBER.fullmatch(depth):
        raise DecodeError(f"{text!r} is no QoS of rmw_zenoh such as '::,10:,:,:,,'")
    return Qos(
        reliability="best_effort" if reliability == _BEST_EFFORT else "reliable",
        durability="transient_local" if durability == _TRANSIENT_LOCAL else "volatile",
        depth=int(depth),
    )


class Attachment(Struct, frozen=True):
    """What goes with each message, request and reply.

    Attributes:
        sequence: Number of the message at its publisher, or of the request at its client; from 1.
        sent_ns: When it was sent (UTC, ns).
        gid: Identity of the publisher or client; a reply has that of its request.
    """

    sequence: int
    sent_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """Return its bytes."""
        numbers = _NUMBERS.pack(self.sequence, self.sent_ns)
        return numbers + bytes([len(self.gid)]) + self.gid


def read_attachment(data: bytes) -> Attachment:
    """Return an attachment, in today's form or that of Jazzy's first releases.

    Raises:
        DecodeError: It is none of rmw_zenoh.
    """
    if data.startswith(_FIRST_NAME) and len(data) > _NAMED.size:
        _, sequence, _, sent_ns, _ = _NAMED.unpack_from(data)
        sized_gid = data[_NAMED.size :]
    elif len(data) > _NUMBERS.size:
        sequence, sent_ns = _NUMBERS.unpack_from(data)
        sized_gid = data[_NUMBERS.size :]
    else:
        sequence, sent_ns, sized_gid = 0, 0, b""
    if not sized_gid or sized_gid[0] != len(sized_gid) - 1:
        raise DecodeError(
            f"{len(data)} bytes that go with a message are no attachment of rmw_zenoh; its node "
            "runs no release of it, or one before Jazzy's 0.2.0: update it"
        )
    return Attachment(sequence, sent_ns, sized_gid[1:])
