"""What DDS is told of types and QoS."""

from __future__ import annotations

from typing import Any, Final
from xml.sax.saxutils import quoteattr

from cyclonedds.core import Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.util import duration

from vertebra.errors import CodecNotFoundError
from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import Field
from vertebra.ros2.names import DISCOVERY_TYPE, dds_type
from vertebra.ros2.qos import Qos

_BLOCK_AT_MOST: Final = duration(milliseconds=100)
_LEAST_KEPT: Final = 256
"""So many samples may wait in a reader for the thread that takes them."""
_IDL: Final[dict[str, Any]] = {
    # `byte` for uint8 and int8: a Cyclone DDS 0.10 that is told of TK_UINT8 dies of it.
    "bool": bool, "byte": idl.byte, "uint8": idl.byte, "int8": idl.byte, "int16": idl.int16,
    "uint16": idl.uint16, "int32": idl.int32, "uint32": idl.uint32, "int64": idl.int64,
    "uint64": idl.uint64, "float32": idl.float32, "float64": idl.float64, "string": str,
}  # fmt: skip
_ARRAY: Final[Any] = idl.array
_SEQUENCE: Final[Any] = idl.sequence
_CALLER: Final = (Field("guid", "uint64"), Field("seq", "int64"))


_POLICIES: Final = {
    2: "durability", 4: "deadline", 5: "latency budget", 6: "ownership", 8: "liveliness",
    10: "partition", 11: "reliability", 12: "destination order", 23: "data representation",
}  # fmt: skip
"""Numbers of the DDS specification."""


class Raw:
    """A sample that is its payload; subclasses carry what DDS announces of their type."""

    __slots__ = ("payload", "sample_info")

    sample_info: Any

    def __init__(self, payload: bytes) -> None:
        self.payload = payload

    def serialize(self, **_: Any) -> bytes:
        """Return the payload to write."""
        return self.payload

    @classmethod
    def deserialize(cls, payload: bytes) -> Raw:
        """Return the sample that was read."""
        return cls(payload)

    deserialize_key = deserialize


class RawTypes:
    """The class of raw samples of each type.

    Announced is the true form of a type, if it is known and DDS can say it: ROS nodes match by the
    name alone, but other programs compare what is announced.
    """

    def __init__(self, types: Types) -> None:
        self._types = types
        self._raw: dict[str, Any] = {}
        self._announced: dict[str, Any] = {}

    def raw(self, type_name: str) -> Any:
        """Return the class of a message, or of a request or a reply."""
        if type_name not in self._raw:
            announced = self._announce(type_name)
            told = ("__idl__", "__idl_typename__")
            namespace = {name: getattr(announced, name) for name in told}
            self._raw[type_name] = type("Raw", (Raw,), {"__slots__": (), **namespace})
        return self._raw[type_name]

    def _announce(self, type_name: str) -> Any:
        if type_name == DISCOVERY_TYPE:  # Humble's has another form, which DDS would not let pass
            return _only_name(type_name)
        is_part = type_name.split("/")[1] != "msg" and type_name.endswith(("_Request", "_Response"))
        try:
            return self._struct(type_name, _CALLER if is_part else ())
        except CodecNotFoundError:
            return _only_name(type_name)

    def _struct(self, type_name: str, before: tuple[Field, ...] = ()) -> type[IdlStruct]:
        if type_name not in self._announced:
            fields = (*before, *self._types.definition(type_name))
            members = {field.name: self._member(field) for field in fields}
            self._announced[type_name] = _make(type_name, members)
        known: type[IdlStruct] = self._announced[type_name]
        return known

    def _member(self, field: Field) -> Any:
        if field.type == "wstring":
            raise CodecNotFoundError("this library announces no wstring")
        one = _IDL.get(field.type) or self._struct(field.type)
        if field.plural == "one":
            return one
        if field.plural == "array":
            return _ARRAY[one, field.count]
        return _SEQUENCE[one, field.count] if field.count else _SEQUENCE[one]


def _only_name(type_name: str) -> type[IdlStruct]:
    return _make(type_name, {"unknown": idl.byte})


def _make(type_name: str, members: dict[str, Any]) -> type[IdlStruct]:
    leaf = type_name.rpartition("/")[2]
    full = dds_type(type_name).replace("::", ".")
    return make_idl_struct(leaf, full, members, dataclassify=False)


def dds_qos(qos: Qos, said: str, *, reads: bool = False) -> Any:
    """Return DDS's QoS of an endpoint that says `said` in its USER_DATA.

    A reader keeps all, up to a limit: what DDS refuses then is counted, or comes again if it is
    reliable. What a history of the last overwrites, nobody would know of.
    """
    history = Policy.History.KeepLast(qos.depth)
    policies = [
        Policy.Reliability.Reliable(max_blocking_time=_BLOCK_AT_MOST)
        if qos.reliability == "reliable"
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal
        if qos.durability == "transient_local"
        else Policy.Durability.Volatile,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]
    if reads:
        limit = max(qos.depth, _LEAST_KEPT)
        limits = Policy.ResourceLimits(
            max_samples=limit, max_instances=-1, max_samples_per_instance=-1
        )
        policies += [Policy.History.KeepAll, limits]
    else:
        policies += [history, Policy.WriterDataLifecycle(autodispose=False)]
        if qos.durability == "transient_local":  # this, not the history, is what late joiners get
            kept = Policy.DurabilityService(
                cleanup_delay=0,
                history=history,
                max_samples=-1,
                max_instances=-1,
                max_samples_per_instance=-1,
            )
            policies.append(kept)
    if said:
        policies.append(Policy.Userdata(data=said.encode()))
    return DdsQos(*policies)


def ros_qos(qos: Any) -> Qos:
    """Return what an endpoint offers or requests."""
    return Qos(
        reliability="best_effort" if Policy.Reliability.BestEffort in qos else "reliable",
        durability="volatile" if Policy.Durability.Volatile in qos else "transient_local",
    )


def mismatch_of(status: Any) -> str:
    """Return the name of the policy that keeps an endpoint apart from another one, if any."""
    if not status.total_count:
        return ""
    number = int(status.last_policy_id)
    return _POLICIES.get(number, f"policy {number}")


def user_data_of(qos: Any) -> bytes:
    """Return the USER_DATA in a QoS."""
    found = [bytes(policy.data) for policy in qos if isinstance(policy, Policy.Userdata)]
    return found[0] if found else b""


def configuration(interface: str, peers: tuple[str, ...]) -> str:
    """Return Cyclone DDS's configuration; with peers, nothing is sent by multicast.

    The loopback interface has no multicast: there the host is its own peer.
    """
    if interface == "lo" and not peers:
        peers = ("127.0.0.1",)
    general = f"<NetworkInterface name={quoteattr(interface)}/>" if interface else ""
    general = f"<Interfaces>{general}</Interfaces>" if general else ""
    discovery = ""
    if peers:
        general += "<AllowMulticast>false</AllowMulticast>"
        found = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers)
        discovery = (
            "<ParticipantIndex>auto</ParticipantIndex>"
            "<MaxAutoParticipantIndex>119</MaxAutoParticipantIndex>"
            f"<Peers>{found}</Peers>"
        )
    return (
        f'<CycloneDDS><Domain Id="any"><General>{general}</General>'
        f"<Discovery>{discovery}</Discovery></Domain></CycloneDDS>"
    )
