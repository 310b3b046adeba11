"""A participant of the ROS graph that is a node of rclpy; see `vertebra.ros2.driver`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, Final

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks

from vertebra.errors import ConfigError, DeadlineError, NotConnectedError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import OnPayload, OnRequest, Participation
from vertebra.ros2.graph import Graph
from vertebra.ros2.names import check_name
from vertebra.ros2.qos import Qos
from vertebra.ros2.rclpy.classes import class_of, policy_of, profile_of
from vertebra.ros2.rclpy.node import Inbox, RosNode, open_node, refusals
from vertebra.ros2.rclpy.services import ServiceClient, ServiceServer
from vertebra.ros2.rclpy.watch import GraphWatch

_BATCH: Final = 64
_LOOK_EVERY_S: Final = 0.01


class RclpyTransport:
    """One node; see `driver.Transport`. Open it with `rclpy_driver`."""

    def __init__(self, ros: RosNode, types: Types) -> None:
        self._cdr = Cdr(types)
        self.graph = Graph()
        self._listeners: list[Callable[[], None]] = []
        self._ros = ros
        self._watch = GraphWatch(ros, self.graph, self._tell_changed)

    @property
    def failed(self) -> asyncio.Future[None]:
        """Ends with the error that stopped ROS."""
        return self._ros.failed

    @property
    def participant(self) -> bytes:
        """What the gids of our endpoints begin with."""
        return self._ros.participant

    def on_graph(self, changed: Callable[[], None]) -> None:
        """Call `changed` after each change of the graph."""
        self._listeners.append(changed)

    def _tell_changed(self) -> None:
        for changed in self._listeners:
            changed()

    def reader(self, name: str, type_name: str, qos: Qos, on_payload: OnPayload) -> TopicReader:
        """Read a topic."""
        return TopicReader(self._ros, name, type_name, qos, on_payload)

    def writer(self, name: str, type_name: str, qos: Qos) -> TopicWriter:
        """Write a topic."""
        return TopicWriter(self._ros, name, type_name, qos)

    def client(self, name: str, type_name: str) -> ServiceClient:
        """Be a client of a service; `type_name` such as `std_srvs/srv/Trigger`."""
        return ServiceClient(self._ros, self._cdr, name, type_name)

    def server(self, name: str, type_name: str, on_request: OnRequest) -> ServiceServer:
        """Offer a service."""
        return ServiceServer(self._ros, self._cdr, name, type_name, on_request)

    async def close(self) -> None:
        """Leave the graph."""
        await self._watch.close()
        await self._ros.close()


class TopicReader:
    """See `driver.Reader`."""

    def __init__(
        self, ros: RosNode, name: str, type_name: str, qos: Qos, on_payload: OnPayload
    ) -> None:
        self._ros = ros
        self._on_payload = on_payload
        self._closed = False
        self._lost = 0
        self.mismatch = ""
        self._inbox = Inbox(qos.depth, self._came)
        self._subscription: Any = None
        wanted = class_of(type_name)
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._differs, message_lost=self._loses
        )
        with refusals(f"to read {name} as {type_name}"):
            self._subscription = ros.node.create_subscription(
                wanted, check_name(name), self._take, profile_of(qos),
                raw=True, event_callbacks=events,
            )  # fmt: skip

    @property
    def dropped(self) -> int:
        """Payloads that were let go because we were late."""
        return self._inbox.dropped + self._lost

    def _take(self, payload: bytes, info: dict[str, Any]) -> None:
        """Take in the thread what came, and at once what waits behind it: that is far cheaper."""
        self._inbox.put((payload, info["source_timestamp"]))
        for _ in range(_BATCH):
            if self._subscription is None or self._closed:
                return
            more = self._subscription.handle.take_message(None, True)  # noqa: FBT003 - raw
            if more is None:
                return
            self._inbox.put((more[0], more[1]["source_timestamp"]))

    def _differs(self, event: Any) -> None:
        self.mismatch = policy_of(event)

    def _loses(self, event: Any) -> None:
        self._lost = event.total_count

    def _came(self, item: tuple[bytes, int]) -> None:
        if not self._closed:
            self._on_payload(*item)

    def close(self) -> None:
        """End it."""
        if not self._closed:
            self._closed = True
            self._ros.in_thread(lambda: self._ros.node.destroy_subscription(self._subscription))


class TopicWriter:
    """See `driver.Writer`."""

    def __init__(self, ros: RosNode, name: str, type_name: str, qos: Qos) -> None:
        self._ros = ros
        self._name = check_name(name)
        self._closed = False
        self.mismatch = ""
        wanted, events = (
            class_of(type_name),
            PublisherEventCallbacks(incompatible_qos=self._differs),
        )
        with refusals(f"to write {name} as {type_name}"):
            self._publisher = ros.node.create_publisher(
                wanted, name, profile_of(qos), event_callbacks=events
            )

    def _differs(self, event: Any) -> None:
        self.mismatch = policy_of(event)

    def write(self, payload: bytes) -> None:
        """Send a payload."""
        self._check_open()
        with refusals(f"{len(payload)} bytes for {self._name}"):
            self._publisher.publish(payload)

    async def matched(self) -> None:
        """Wait until somebody reads the topic."""
        self._check_open()
        while not self._publisher.get_subscription_count():
            await asyncio.sleep(_LOOK_EVERY_S)
            self._check_open()

    async def delivered(self, timeout_s: float) -> None:
        """Wait until all who read the topic have what was written.

        Raises:
            DeadlineError: Somebody has not got it in time.
        """
        self._check_open()
        within = Duration(seconds=timeout_s)
        if not await asyncio.to_thread(self._publisher.wait_for_all_acked, within):
            raise DeadlineError(f"a subscriber of {self._name}", timeout_s)

    def _check_open(self) -> None:
        if self._closed:
            raise NotConnectedError(f"the writer of {self._name} is closed")

    def close(self) -> None:
        """End it."""
        if not self._closed:
            self._closed = True
            self._ros.in_thread(lambda: self._ros.node.destroy_publisher(self._publisher))


@asynccontextmanager
async def rclpy_driver(part: Participation, types: Types) -> AsyncIterator[RclpyTransport]:
    """Be a node while the block runs; on which middleware RMW_IMPLEMENTATION says.

    Raises:
        ConfigError: This driver does not go with that middleware, or with these settings.
        TransportError: ROS cannot start.
    """
    middleware = rclpy.get_rmw_implementation_identifier()
    if "zenoh" in middleware:
        raise ConfigError(
            f"the driver rclpy does not run on {middleware}; choose the driver rmw_zenoh, or set "
            "RMW_IMPLEMENTATION to rmw_cyclonedds_cpp or rmw_fastrtps_cpp"
        )
    transport = RclpyTransport(RosNode(*await asyncio.to_thread(open_node, part)), types)
    try:
        yield transport
    finally:
        await transport.close()
