"""A ROS node and the thread that runs its callbacks, for the driver `rclpy`.

What comes is handed over to the event loop, where everything else happens. Whatever rclpy may be
waiting on is deleted in the thread, so that nothing is while it is in use.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Final

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from vertebra.errors import CodecError, ConfigError, TransportError
from vertebra.ros2.driver import Participation

log = logging.getLogger(__name__)

_TELL_EVERY_S: Final = 10.0
_LOOK_EVERY_S: Final = 0.001
_PARTICIPANT_BYTES: Final = 12
"""The beginning of an endpoint's gid is that of its participant."""


class Inbox:
    """What came for somebody in the event loop.

    Attributes:
        dropped: What was let go because the event loop was late.
    """

    def __init__(self, depth: int, taken: Callable[[Any], None]) -> None:
        self.dropped = 0
        self._told = 0
        self._told_at_s = 0.0
        self._depth = depth
        self._waiting: deque[Any] = deque(maxlen=depth)
        self._taken = taken
        self._loop = asyncio.get_running_loop()

    def put(self, item: Any) -> None:
        """Hand over from another thread."""
        self.dropped += len(self._waiting) == self._depth
        self._waiting.append(item)
        with contextlib.suppress(RuntimeError):  # the event loop has closed: nobody is left
            self._loop.call_soon_threadsafe(self._hand_over)

    def _hand_over(self) -> None:
        now_s = time.monotonic()
        if self.dropped > self._told and now_s > self._told_at_s + _TELL_EVERY_S:
            log.error("%d samples were lost: the event loop was late", self.dropped - self._told)
            self._told, self._told_at_s = self.dropped, now_s
        while self._waiting:
            item = self._waiting.popleft()
            try:
                self._taken(item)
            except CodecError as error:
                log.warning("refused a sample: %s", error)


class RosNode:
    """A node and its thread.

    Attributes:
        node: That of rclpy.
        participant: What the gids of its endpoints begin with.
        failed: Ends with the error that stopped a thread.
    """

    def __init__(self, node: Any, participant: bytes) -> None:
        self.node = node
        self.participant = participant
        self._loop = asyncio.get_running_loop()
        self.failed: asyncio.Future[None] = self._loop.create_future()
        self._work: deque[Callable[[], object]] = deque()
        self._stopping = self._closed = False
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._run, name="ros2 rclpy", daemon=True)
        self._thread.start()

    def in_thread(self, work: Callable[[], object]) -> None:
        """Do it in the thread, between two callbacks and in the order of these calls."""
        if not self._closed:
            self._work.append(work)
            self._executor.create_task(self._do_work)  # these it does in an order of its own

    def _do_work(self) -> None:
        while self._work:
            self._work.popleft()()

    def _run(self) -> None:
        try:
            while not self._stopping:
                self._executor.spin_once()
        except Exception as error:  # noqa: BLE001  - a thread that ends must not end silently
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """Tell, from a thread, what has stopped it."""
        failure = TransportError(f"ROS stopped: {error!r}; restart this service")

        def tell() -> None:
            if not self.failed.done():
                self.failed.set_exception(failure)

        with contextlib.suppress(RuntimeError):  # the event loop has closed: nobody is left
            self._loop.call_soon_threadsafe(tell)

    async def close(self) -> None:
        """Leave the graph."""

        def stop() -> None:
            self._stopping = True

        def end() -> None:
            self._thread.join()
            self._executor.shutdown()
            self.node.destroy_node()
            self.node.context.try_shutdown()

        self.in_thread(stop)
        self._closed = True
        await asyncio.to_thread(end)
        self.failed.cancel()


@contextlib.contextmanager
def refusals(of: str) -> Iterator[None]:
    """Let what rclpy refuses be a `TransportError`; all that it raises are `RuntimeError`s."""
    try:
        yield
    except RuntimeError as error:
        raise TransportError(f"ROS refused {of}: {error}") from error


def open_node(part: Participation) -> tuple[Any, bytes]:
    """Return a node of rclpy, and what the gids of its endpoints begin with; reads files.

    Raises:
        ConfigError: rclpy has no such setting.
        TransportError: ROS cannot start.
    """
    context = Context()
    try:
        with _discovery(part):
            rclpy.init(
                args=[],
                context=context,
                domain_id=part.domain_id,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            node = rclpy.create_node(
                part.node,
                namespace=part.namespace,
                context=context,
                use_global_arguments=False,
                start_parameter_services=False,
            )
            return node, _gid_of(node)[:_PARTICIPANT_BYTES]
    except RuntimeError as error:  # what rclpy raises is one
        context.try_shutdown()
        raise TransportError(f"ROS does not start in domain {part.domain_id}: {error}") from error


def _gid_of(node: Any) -> bytes:
    """Return a gid of ours. rclpy tells none, but every node writes this topic.

    Our own writer is known before those of others, should one of them have a node of our name.
    """
    ours = (node.get_name(), node.get_namespace())
    while True:
        for info in node.get_publishers_info_by_topic("/parameter_events"):
            if (info.node_name, info.node_namespace) == ours:
                return bytes(info.endpoint_gid)
        time.sleep(_LOOK_EVERY_S)  # also what is our own has to be discovered


@contextlib.contextmanager
def _discovery(part: Participation) -> Iterator[None]:
    """Let ROS look for others as `part` says: it takes that from its environment alone."""
    if part.interface not in ("", "lo"):
        raise ConfigError(
            f"the driver rclpy does not choose the network interface {part.interface!r}: that is "
            "for ROS's own middleware (CYCLONEDDS_URI, or a profile of Fast DDS); set "
            "VERTEBRA_ROS2_INTERFACE to auto"
        )
    wanted = {}
    if part.interface == "lo":
        wanted["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if part.peers:
        wanted["ROS_STATIC_PEERS"] = ";".join(part.peers)
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
