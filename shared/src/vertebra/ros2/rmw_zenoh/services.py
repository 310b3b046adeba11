"""ROS services as `rmw_zenoh_cpp` has them: a request is a Zenoh query, open until its reply."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from functools import partial
from typing import Final

import zenoh

from vertebra.bus import Delivery, Subscription
from vertebra.errors import DeadlineError, DecodeError, NotConnectedError, VertebraError
from vertebra.ros2.driver import OnRequest
from vertebra.ros2.graph import Endpoint
from vertebra.ros2.names import check_name
from vertebra.ros2.qos import Qos
from vertebra.ros2.rmw_zenoh import wire
from vertebra.ros2.rmw_zenoh.session import Session, in_loop, refusals
from vertebra.ros2.rmw_zenoh.wire import Attachment

log = logging.getLogger(__name__)

MATCH_WITHIN_S: Final = 2.0
"""So long a client waits for a server that is not there yet."""
MAX_REQUESTS: Final = 64
"""So many requests may wait for our answer."""
MAX_CALLS: Final = 8
"""So many calls of a client are under way at once: a ROS node keeps 10 requests, no more."""
_QOS: Final = Qos()
"""What ROS says of services; it changes nothing."""


class ServiceClient:
    """See `driver.Client`."""

    def __init__(self, session: Session, name: str, type_name: str) -> None:
        self._session = session
        self._name = name
        self._type = type_name
        self._calls = 0
        self._closed = False
        self._waiting: set[asyncio.Future[bytes]] = set()
        self._turn = asyncio.Semaphore(MAX_CALLS)
        check_name(name)
        self._announced = session.announce("SC", name, type_name, _QOS)

    async def call(self, payload: bytes, *, timeout_s: float) -> bytes:
        """Send a request and return the reply."""
        began_s = time.monotonic()
        server = await self._find_server(min(MATCH_WITHIN_S, timeout_s))
        left_s = began_s + timeout_s - time.monotonic()
        try:
            async with asyncio.timeout(left_s), self._turn:
                return await self._ask(server, payload, left_s)
        except TimeoutError as error:
            raise DeadlineError(f"the ROS service {self._name}", timeout_s) from error

    def _servers(self) -> list[Endpoint]:
        """Return the servers, first those that mean by the type what we mean."""
        ours = self._session.hash_of(self._type)
        servers = self._session.readers(self._name, "request")
        fit = [one for one in servers if one.type == self._type]
        return sorted(fit, key=lambda one: one.type_hash != ours)

    async def _find_server(self, timeout_s: float) -> Endpoint:
        try:
            async with asyncio.timeout(timeout_s):
                await self._session.until(lambda: self._closed or self._servers())
        except TimeoutError as error:
            raise NotConnectedError(
                f"nobody offers the ROS service {self._name}; start its node, and look whether "
                "'vertebra ros2 services' lists it"
            ) from error
        self._check_open()
        server, ours = self._servers()[0], self._session.hash_of(self._type)
        if ours and server.type_hash not in (ours, ""):
            raise NotConnectedError(
                f"{server.node}, which offers the ROS service {self._name}, has another definition "
                f"of {self._type} ({server.type_hash}) than we ({ours}); put its package into "
                "VERTEBRA_ROS2_TYPES, or build that node anew"
            )
        return server

    def _check_open(self) -> None:
        if self._closed:
            raise NotConnectedError(f"the client of {self._name} is closed")

    async def _ask(self, server: Endpoint, payload: bytes, timeout_s: float) -> bytes:
        self._check_open()
        loop = asyncio.get_running_loop()
        self._calls += 1
        answer: asyncio.Future[bytes] = loop.create_future()

        def settle(reply: bytes) -> None:
            if not answer.done():  # of several servers the first counts
                answer.set_result(reply)

        def arrived(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                in_loop(loop, settle, reply.ok.payload.to_bytes())

        attachment = Attachment(self._calls, time.time_ns(), self._announced.gid)
        self._waiting.add(answer)
        try:
            with refusals(f"a request to {self._name}"):
                self._session.zenoh.get(
                    wire.key_of(self._session.domain_id, self._name, self._type, server.type_hash),
                    arrived,
                    target=zenoh.QueryTarget.ALL_COMPLETE,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=timeout_s + 1,  # the caller's deadline comes first
                    payload=payload,
                    attachment=attachment.encode(),
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
            return await answer
        finally:
            self._waiting.discard(answer)

    def close(self) -> None:
        """End it; calls that wait fail."""
        if self._closed:
            return
        self._closed = True
        for answer in self._waiting:
            if not answer.done():
                answer.set_exception(NotConnectedError(f"the client of {self._name} closes"))
        self._announced.close()


class ServiceServer:
    """Offers a service; each request is a task of its own, and a query that is open meanwhile."""

    def __init__(self, session: Session, name: str, type_name: str, on_request: OnRequest) -> None:
        self._name = name
        self._on_request = on_request
        self._closed = False
        self._tasks: set[asyncio.Task[None]] = set()
        self._requests: Subscription[tuple[str, zenoh.Query]] = Subscription(
            name, Delivery.queue(MAX_REQUESTS), key_of=lambda _: ""
        )
        declared = [
            session.zenoh.declare_queryable(key, partial(self._arrived, key), complete=True)
            for key in session.own_keys(name, type_name)
        ]
        self._announced = session.announce("SS", name, type_name, _QOS, declared)
        session.follow(self._requests, self._came)

    def _arrived(self, key: str, query: zenoh.Query) -> None:
        self._requests.offer((key, query))

    def _came(self, request: tuple[str, zenoh.Query]) -> None:
        key, query = request
        attachment = query.attachment
        try:
            asked = wire.read_attachment(b"" if attachment is None else attachment.to_bytes())
        except DecodeError:
            query.drop()
            raise
        if self._closed:
            query.drop()
            return
        if len(self._tasks) >= MAX_REQUESTS:
            log.error("%s: a request is lost: %d are open already", self._name, MAX_REQUESTS)
            query.drop()
            return
        task = asyncio.get_running_loop().create_task(self._answer(key, query, asked))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, key: str, query: zenoh.Query, asked: Attachment) -> None:
        with query:
            request = b"" if query.payload is None else query.payload.to_bytes()
            try:
                reply = await self._on_request(request)
            except VertebraError as error:
                log.error("%s: a request gets no answer: %s", self._name, error)  # noqa: TRY400
                return
            if reply is None:
                return
            attachment = Attachment(asked.sequence, time.time_ns(), asked.gid).encode()
            with contextlib.suppress(zenoh.ZError):  # the session has gone: nobody waits
                query.reply(key, reply, attachment=attachment)

    def close(self) -> None:
        """End it, and what is being answered."""
        if self._closed:
            return
        self._closed = True
        for task in self._tasks:
            task.cancel()
        self._announced.close()
        self._requests.close()
