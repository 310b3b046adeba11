"""Services for the driver `rclpy`: requests and replies pass as payloads on our side of it."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any, Final

from rclpy.serialization import deserialize_message, serialize_message

from vertebra.errors import (
    CodecError,
    CodecNotFoundError,
    DeadlineError,
    EncodeError,
    NotConnectedError,
    TransportError,
)
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.driver import OnRequest
from vertebra.ros2.names import check_name
from vertebra.ros2.qos import Qos
from vertebra.ros2.rclpy.classes import class_of, profile_of
from vertebra.ros2.rclpy.node import Inbox, RosNode, refusals

log = logging.getLogger(__name__)

MATCH_WITHIN_S: Final = 2.0
"""So long a client waits for a server that is not there yet."""
MAX_REQUESTS: Final = 64
"""So many requests may wait for our answer."""
MAX_CALLS: Final = 8
"""So many calls of a client are under way at once: a ROS node keeps 10 requests, no more."""
_LOOK_EVERY_S: Final = 0.01
_QOS: Final = profile_of(Qos(depth=MAX_REQUESTS))


class ServiceClient:
    """See `driver.Client`."""

    def __init__(self, ros: RosNode, cdr: Cdr, name: str, type_name: str) -> None:
        self._ros = ros
        self._cdr = cdr
        self._reply = f"{type_name}_Response"
        self._name = check_name(name)
        self._type = class_of(type_name)
        self._turn = asyncio.Semaphore(MAX_CALLS)
        self._waiting: set[asyncio.Future[bytes]] = set()
        self._client = ros.node.create_client(self._type, name, qos_profile=_QOS)
        self._closed = False

    async def call(self, payload: bytes, *, timeout_s: float) -> bytes:
        """Send a request and return the reply."""
        request = _decode(payload, self._type.Request)
        began_s = time.monotonic()
        await self._find_server(min(MATCH_WITHIN_S, timeout_s))
        try:
            async with asyncio.timeout(began_s + timeout_s - time.monotonic()), self._turn:
                return await self._ask(request)
        except TimeoutError as error:
            raise DeadlineError(f"the ROS service {self._name}", timeout_s) from error

    async def _find_server(self, timeout_s: float) -> None:
        try:
            async with asyncio.timeout(timeout_s):
                while not self._is_ready():  # noqa: ASYNC110 - the library does not tell
                    await asyncio.sleep(_LOOK_EVERY_S)
        except TimeoutError as error:
            raise NotConnectedError(
                f"nobody offers the ROS service {self._name}; start its node, and look whether "
                "'vertebra ros2 services' lists it"
            ) from error

    def _is_ready(self) -> bool:
        if self._closed:
            raise NotConnectedError(f"the client of {self._name} is closed")
        return bool(self._client.service_is_ready())

    async def _ask(self, request: Any) -> bytes:
        if self._closed:
            raise NotConnectedError(f"the client of {self._name} is closed")
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

        def came(reply: bytes) -> None:
            if not answer.done():
                answer.set_result(reply)

        inbox = Inbox(1, came)
        with refusals(f"a call of {self._name}"):
            asked = self._client.call_async(request)
        asked.add_done_callback(lambda done: inbox.put(serialize_message(done.result())))
        self._waiting.add(answer)
        try:
            return _whole(self._cdr, await answer, self._reply)
        finally:
            self._waiting.discard(answer)
            self._client.remove_pending_request(asked)

    def close(self) -> None:
        """End it; calls that wait fail."""
        if self._closed:
            return
        self._closed = True
        for answer in self._waiting:
            if not answer.done():
                answer.set_exception(NotConnectedError(f"the client of {self._name} closes"))
        self._ros.in_thread(lambda: self._ros.node.destroy_client(self._client))


class ServiceServer:
    """Offers a service; each request is a task of its own."""

    def __init__(
        self, ros: RosNode, cdr: Cdr, name: str, type_name: str, on_request: OnRequest
    ) -> None:
        self._ros = ros
        self._cdr = cdr
        self._request = f"{type_name}_Request"
        self._name = check_name(name)
        self._type = class_of(type_name)
        self._on_request = on_request
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False
        self._inbox = Inbox(MAX_REQUESTS, self._came)
        ros.in_thread(self._open)

    def _open(self) -> None:
        """Offer it, in the thread: no request comes before all is in place.

        rclpy answers as soon as the callback returns. So ours returns what was asked, and the
        sending of it begins the work. (A callback that awaits would keep its thread busy.)
        """
        self._service = self._ros.node.create_service(
            self._type, self._name, lambda request, _: request, qos_profile=_QOS
        )
        self._send = self._service.send_response
        self._service.send_response = lambda request, caller: self._inbox.put((request, caller))

    def _came(self, asked: tuple[Any, Any]) -> None:
        if self._closed:
            return
        if len(self._tasks) >= MAX_REQUESTS:
            log.error("%s: a request is lost: %d are open already", self._name, MAX_REQUESTS)
            return
        task = asyncio.get_running_loop().create_task(self._answer(*asked))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, request: Any, caller: Any) -> None:
        try:
            asked = _whole(self._cdr, serialize_message(request), self._request)
            reply = await self._on_request(asked)
            if reply is None or self._closed:
                return
            with refusals("it"):
                self._send(_decode(reply, self._type.Response), caller)
        except (TransportError, CodecError) as error:
            log.error("%s: a reply is lost: %s", self._name, error)  # noqa: TRY400

    def close(self) -> None:
        """End it, and what is being answered."""
        if self._closed:
            return
        self._closed = True
        for task in self._tasks:
            task.cancel()
        self._ros.in_thread(lambda: self._ros.node.destroy_service(self._service))


def _whole(cdr: Cdr, payload: bytes, type_name: str) -> bytes:
    """Return a payload without what rmw_fastrtps leaves behind it: it tells an estimated size."""
    try:
        return payload[: cdr.size(payload, type_name)]
    except CodecNotFoundError:  # then nobody here looks into it
        return payload


def _decode(payload: bytes, wanted: Any) -> Any:
    try:
        return deserialize_message(payload, wanted)
    except RuntimeError as error:  # what rclpy raises is one
        raise EncodeError(f"{len(payload)} bytes are no {wanted.__name__}: {error}") from error
