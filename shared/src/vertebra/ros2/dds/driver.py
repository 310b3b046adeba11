"""A ROS 2 node on DDS: its topics, and what it sees of others.

Payloads pass through undecoded. What rmw_cyclonedds puts around them is made here: names and QoS,
USER_DATA with the hash of the type, and `ros_discovery_info`, by which others know our node.
Writing holds Python's lock: writers keep a bounded history and never wait for a slow reader.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, Final, Literal

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import DDSException, InstanceState
from cyclonedds.domain import Domain
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.util import duration

from vertebra.errors import DeadlineError, NotConnectedError, TransportError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.dds.announced import Raw, configuration, mismatch_of, ros_qos, user_data_of
from vertebra.ros2.dds.participant import Input, Participant, delete, write
from vertebra.ros2.dds.services import ServiceClient, ServiceServer
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import OnPayload, OnRequest, Participation
from vertebra.ros2.graph import Graph, endpoint_of, nodes_of
from vertebra.ros2.names import DISCOVERY_TOPIC, DISCOVERY_TYPE, dds_name
from vertebra.ros2.qos import LATCHED, Qos

_GRAPH_DEPTH: Final = 16384
"""So many news of the graph wait for the event loop at most."""
_PARTICIPANT_BYTES: Final = 12
"""The beginning of an endpoint's gid is that of its participant."""
_MAX_WRITERS: Final = 1024
"""A reader remembers the gids of so many, also of those that have gone."""


class DdsTransport:
    """One participant; see `driver.Transport`. Open it with `dds_driver`."""

    def __init__(self, part: Participation, types: Types) -> None:
        self.graph = Graph()
        self._cdr = Cdr(types)
        self._node = {"node_namespace": part.namespace, "node_name": part.node}
        self._changed: list[Callable[[], None]] = []
        self._announcing = True
        self._dds = Participant(part.domain_id, types, self._announce_soon)
        self._announcer = self._dds.make_writer(DISCOVERY_TOPIC, DISCOVERY_TYPE, LATCHED)
        self._announce()
        self._follow_graph()

    @property
    def failed(self) -> asyncio.Future[None]:
        """Ends with the error that stopped DDS."""
        return self._dds.failed

    @property
    def participant(self) -> bytes:
        """What the gids of our endpoints begin with."""
        return self._dds.gid[:_PARTICIPANT_BYTES]

    def on_graph(self, changed: Callable[[], None]) -> None:
        """Call `changed` after each change of the graph."""
        self._changed.append(changed)

    def reader(self, name: str, type_name: str, qos: Qos, on_payload: OnPayload) -> TopicReader:
        """Read a topic."""
        return TopicReader(self._dds, self.graph, name, type_name, qos, on_payload=on_payload)

    def writer(self, name: str, type_name: str, qos: Qos) -> TopicWriter:
        """Write a topic."""
        return TopicWriter(self._dds, name, type_name, qos)

    def client(self, name: str, type_name: str) -> ServiceClient:
        """Be a client of a service; `type_name` such as `std_srvs/srv/Trigger`."""
        return ServiceClient(self._dds, name, type_name)

    def server(self, name: str, type_name: str, on_request: OnRequest) -> ServiceServer:
        """Offer a service."""
        return ServiceServer(self._dds, name, type_name, on_request)

    async def close(self) -> None:
        """Leave the domain."""
        self._announcing = True  # there is nothing to tell any more
        await self._dds.close()

    def _follow_graph(self) -> None:
        dds = self._dds
        for topic, came in (
            (BuiltinTopicDcpsPublication, lambda sample: self._endpoint_came(sample, "writer")),
            (BuiltinTopicDcpsSubscription, lambda sample: self._endpoint_came(sample, "reader")),
            (BuiltinTopicDcpsParticipant, self._participant_came),
        ):
            reader = BuiltinDataReader(dds.entity, topic)
            dds.attach(Input("discovery", reader, _GRAPH_DEPTH, came, only_valid=False))
        everybody = Qos(durability="transient_local", depth=1000)
        reader = dds.make_reader(DISCOVERY_TOPIC, DISCOVERY_TYPE, everybody)
        dds.attach(Input(DISCOVERY_TOPIC, reader, _GRAPH_DEPTH, self._nodes_came))

    def _endpoint_came(self, sample: Any, kind: Literal["writer", "reader"]) -> None:
        gid = sample.key.bytes
        if gid.startswith(self.participant):
            return
        if sample.sample_info.instance_state != InstanceState.Alive:
            if self.graph.remove(gid):
                self._tell_changed()
            return
        endpoint = endpoint_of(
            gid=gid,
            kind=kind,
            topic=sample.topic_name,
            type_name=sample.type_name,
            qos=ros_qos(sample.qos),
            user_data=user_data_of(sample.qos),
        )
        if endpoint is not None:
            self.graph.add(endpoint)
            self._tell_changed()

    def _participant_came(self, sample: Any) -> None:
        if sample.sample_info.instance_state != InstanceState.Alive:
            self.graph.remove_participant(sample.key.bytes)
            self._tell_changed()

    def _nodes_came(self, sample: Raw) -> None:
        participant, nodes = nodes_of(sample.payload, self._cdr)
        if participant != self._dds.gid:
            self.graph.set_nodes(participant, nodes)
            self._tell_changed()

    def _tell_changed(self) -> None:
        for changed in self._changed:
            changed()

    def _announce_soon(self) -> None:
        """Tell of our endpoints, once for all that changes now."""
        if not self._announcing:
            self._announcing = True
            asyncio.get_running_loop().call_soon(self._announce)

    def _announce(self) -> None:
        self._announcing = False

        def gids(kind: type[Any]) -> list[Any]:
            return [{"data": one.guid.bytes} for one in self._dds.own if isinstance(one, kind)]

        node = {
            **self._node,
            "reader_gid_seq": gids(DataReader),
            "writer_gid_seq": gids(DataWriter),
        }
        record = {"gid": {"data": self._dds.gid}, "node_entities_info_seq": [node]}
        write(self._announcer, self._cdr.encode(record, DISCOVERY_TYPE))


class TopicReader:
    """See `driver.Reader`."""

    def __init__(
        self,
        dds: Participant,
        graph: Graph,
        name: str,
        type_name: str,
        qos: Qos,
        *,
        on_payload: OnPayload,
    ) -> None:
        self._dds = dds
        self._graph = graph
        self._gids: dict[int, bytes] = {}
        self._on_payload = on_payload
        self._closed = False
        topic = dds_name("topic", name)
        self._reader = dds.make_reader(topic, type_name, qos)
        self._input = Input(topic, self._reader, qos.depth, self._came)
        dds.attach(self._input)
        dds.add_own(self._reader)

    @property
    def dropped(self) -> int:
        """Payloads that were let go because the event loop was late."""
        return self._input.dropped

    @property
    def mismatch(self) -> str:
        """The QoS for which a writer is not heard."""
        if self._closed:
            return ""
        return mismatch_of(self._reader.get_requested_incompatible_qos_status())

    def _came(self, sample: Raw) -> None:
        if not self._closed and not self._is_ignored(sample.sample_info.publication_handle):
            self._on_payload(sample.payload, sample.sample_info.source_timestamp)

    def _is_ignored(self, writer: int) -> bool:
        """Say whether a sample is of ourselves, or of a participant that the graph ignores."""
        gid = self._gids.get(writer)
        if gid is None:
            known = self._reader.get_matched_publication_data(writer)
            if known is None:  # it has gone already
                return False
            if len(self._gids) >= _MAX_WRITERS:
                self._gids.clear()
            gid = self._gids[writer] = known.key.bytes
        return gid.startswith((self._dds.gid[:_PARTICIPANT_BYTES], *self._graph.ignored))

    def close(self) -> None:
        """End it."""
        if not self._closed:
            self._closed = True
            self._dds.end(self._reader)


class TopicWriter:
    """See `driver.Writer`."""

    def __init__(self, dds: Participant, name: str, type_name: str, qos: Qos) -> None:
        self._dds = dds
        self._closed = False
        self._name = name
        self._change: asyncio.Event | None = None
        self._writer = dds.make_writer(dds_name("topic", name), type_name, qos)
        dds.add_own(self._writer)

    @property
    def mismatch(self) -> str:
        """The QoS for which a reader does not hear us."""
        if self._closed:
            return ""
        return mismatch_of(self._writer.get_offered_incompatible_qos_status())

    def write(self, payload: bytes) -> None:
        """Send a payload."""
        if self._closed:
            raise self._closed_error()
        write(self._writer, payload)

    async def matched(self) -> None:
        """Wait until somebody reads the topic; raise `NotConnectedError` if this is closed."""
        while not self._closed and not self._writer.get_matched_subscriptions():
            if self._change is None:
                self._change = self._dds.follow_matches(self._writer)
            self._change.clear()
            await self._change.wait()
        if self._closed:
            raise self._closed_error()

    async def delivered(self, timeout_s: float) -> None:
        """Wait until all who read the topic have what was written.

        Raises:
            DeadlineError: Somebody has not got it in time.
        """
        try:
            await asyncio.to_thread(self._writer.wait_for_acks, duration(seconds=timeout_s))
        except DDSException as error:
            raise self._closed_error() from error
        except AttributeError as error:  # what cyclonedds 11.0.1 raises for its own timeout
            raise DeadlineError(f"a subscriber of {self._name}", timeout_s) from error

    def _closed_error(self) -> NotConnectedError:
        return NotConnectedError(f"the writer of {self._name} is closed")

    def close(self) -> None:
        """End it."""
        if not self._closed:
            self._closed = True
            self._dds.end(self._writer)
            if self._change is not None:
                self._change.set()  # who waits for a reader learns that none will come


@asynccontextmanager
async def dds_driver(part: Participation, types: Types) -> AsyncIterator[DdsTransport]:
    """Be a participant while the block runs; without an interface or peers CYCLONEDDS_URI says all.

    Raises:
        TransportError: DDS cannot start, for example because there is no such interface.
    """
    domain: Any = None
    try:
        if part.interface or part.peers:
            domain = Domain(part.domain_id, configuration(part.interface, part.peers))
        transport = DdsTransport(part, types)
    except DDSException as error:
        used = part.interface or os.environ.get("CYCLONEDDS_URI", "that the system gives")
        raise TransportError(
            f"DDS does not start in domain {part.domain_id} on the interface {used}: {error}; "
            "a domain is 0 to 232, the interfaces are listed by 'ip addr'"
        ) from error
    try:
        yield transport
    finally:
        await transport.close()
        if domain is not None:
            delete(domain)
