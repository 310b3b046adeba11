"""WebSocket clients: what they ask is done, what they watch is sent as fast as they read."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any, Final, Literal

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketDisconnected

from vertebra.errors import VertebraError
from vertebra_gateway import ws_protocol
from vertebra_gateway.link import UNTIL_READ
from vertebra_gateway.problems import Problem, problem_of
from vertebra_gateway.resources import Robots
from vertebra_gateway.streams import Outlet, Streams
from vertebra_gateway.ws_protocol import (
    SUBPROTOCOL,
    Acknowledge,
    Call,
    Conversation,
    End,
    Order,
    Subscribe,
    Unsubscribe,
)

log = logging.getLogger(__name__)

MAX_ANSWERS: Final = 256
"""Control messages that wait; a client that does not read its answers is not listened to."""
_TELL_DROPS_EVERY_S: Final = 1.0
TotalName = Literal["sent", "dropped", "lost"]


class _Subscription:
    """One subscription of one client."""

    def __init__(self, order: Subscribe, client: Client, streams: Streams) -> None:
        self.order = order
        self.told = (0, 0)
        self.outlet = Outlet(
            lambda: client.wake(self),
            delivery=order.buffer(),
            max_rate_hz=order.max_rate_hz or 0.0,
            window=order.window or 0,
            on_refusal=lambda reason: client.refused(order.id, reason),
        )
        self._feed = streams.attach(order.key, order.form, self.outlet)
        self._lost_before = self._feed.lost

    @property
    def counts(self) -> tuple[int, int]:
        """Items dropped because the client is slow, and lost before they got here."""
        return self.outlet.dropped, self._feed.lost - self._lost_before


class Client:
    """One connected client: a lane for control, one for data, and what it has open.

    Attributes:
        sent: Data messages sent to it.
    """

    def __init__(self, websocket: WebSocket, streams: Streams, robots: Robots) -> None:
        self.sent = 0
        self._websocket = websocket
        self._streams = streams
        self._robots = robots
        self._conversation = Conversation(time.time_ns)
        self._subscriptions: dict[int, _Subscription] = {}
        self._answers: deque[str] = deque()
        self._answers_changed = asyncio.Event()
        self._answers_changed.set()  # the robots are told at once
        self._answers_taken = asyncio.Event()
        self._answers_sent = asyncio.Event()
        self._robots_changed = True
        self._ready: dict[_Subscription, None] = {}
        self._ready_changed = asyncio.Event()
        self._gone_drops = [0, 0]
        self._connected_s = time.monotonic()

    def describe(self) -> dict[str, Any]:
        """Return its row in the table of clients."""
        counts = [subscription.counts for subscription in self._subscriptions.values()]
        address = self._websocket.client
        return {
            "client": f"{address.host}:{address.port}" if address is not None else "",
            "connected_s": round(time.monotonic() - self._connected_s, 1),
            "subscriptions": len(self._subscriptions),
            "sent": self.sent,
            "dropped": self._gone_drops[0] + sum(dropped for dropped, _ in counts),
            "lost": self._gone_drops[1] + sum(lost for _, lost in counts),
        }

    async def run(self) -> None:
        """Serve the client until it leaves."""
        self._robots.changed.add(self._tell_robots)
        try:
            async with asyncio.TaskGroup() as tasks:
                workers = [
                    tasks.create_task(_until_gone(work))
                    for work in (self._send_answers, self._send_data, self._tell_drops)
                ]
                calls: set[asyncio.Task[None]] = set()
                await _until_gone(lambda: self._listen(tasks, calls))
                for task in (*workers, *calls):
                    task.cancel()
        finally:
            self._robots.changed.discard(self._tell_robots)
            for subscription in self._subscriptions.values():
                self._leave(subscription)
            self._subscriptions.clear()

    def wake(self, subscription: _Subscription) -> None:
        """Have a subscription served: something may wait for the client there."""
        self._ready[subscription] = None
        self._ready_changed.set()

    def refused(self, subscription_id: int, reason: str) -> None:
        """Tell the client why a subscription brings nothing, unless it reads nothing anyway."""
        if len(self._answers) < MAX_ANSWERS:
            self._answer(ws_protocol.error(subscription_id, Problem(status=422, detail=reason)))

    def _answer(self, text: str) -> None:
        self._answers.append(text)
        self._answers_sent.clear()
        self._answers_changed.set()

    def _tell_robots(self) -> None:
        self._robots_changed = True
        self._answers_sent.clear()
        self._answers_changed.set()

    async def _listen(self, tasks: asyncio.TaskGroup, calls: set[asyncio.Task[None]]) -> None:
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            outcome = self._conversation.receive(message["bytes"] if text is None else text)
            if isinstance(outcome, End):
                await self._websocket.close(outcome.code, outcome.reason)
                return
            if isinstance(outcome, str):
                self._answer(outcome)
            elif isinstance(outcome, Call):
                task = tasks.create_task(self._call(outcome))
                calls.add(task)
                task.add_done_callback(calls.discard)
            elif outcome is not None:
                self._carry_out(outcome)
            while len(self._answers) >= MAX_ANSWERS:
                self._answers_taken.clear()
                await self._answers_taken.wait()

    def _carry_out(self, order: Order) -> None:
        if isinstance(order, Subscribe):
            try:
                self._subscriptions[order.id] = _Subscription(order, self, self._streams)
            except VertebraError as error:
                self._conversation.subscriptions.discard(order.id)
                self._answer(ws_protocol.error(order.id, problem_of(error)))
            else:
                self._answer(ws_protocol.subscribed(order.id))
        elif isinstance(order, Unsubscribe):
            self._leave(self._subscriptions.pop(order.id))
            self._answer(ws_protocol.unsubscribed(order.id))
        elif isinstance(order, Acknowledge):
            self._subscriptions[order.id].outlet.acknowledge()

    def _leave(self, subscription: _Subscription) -> None:
        self._ready.pop(subscription, None)
        dropped, lost = subscription.counts
        self._gone_drops[0] += dropped
        self._gone_drops[1] += lost
        order = subscription.order
        self._streams.detach(order.key, order.form, subscription.outlet)

    async def _call(self, order: Call) -> None:
        try:
            body = await self._robots.call(order.robot, order.path, order.body, order.timeout_s)
            answer = ws_protocol.reply(order.id, body)
        except VertebraError as error:
            answer = ws_protocol.error(order.id, problem_of(error))
        self._conversation.call_ended(order.id)
        self._answer(answer)

    async def _send_answers(self) -> None:
        while True:
            await self._answers_changed.wait()
            self._answers_changed.clear()
            while self._answers or self._robots_changed:
                if self._robots_changed:
                    self._robots_changed = False
                    text = ws_protocol.robots(self._robots.describe())
                else:
                    text = self._answers.popleft()
                    self._answers_taken.set()
                await self._websocket.send({"type": "websocket.send", "text": text})
            self._answers_sent.set()

    async def _send_data(self) -> None:
        until_read = self._websocket.scope.get("extensions", {}).get(UNTIL_READ, {}).get("wait")
        while True:
            await self._ready_changed.wait()
            self._ready_changed.clear()
            batch, self._ready = self._ready, {}
            for subscription in batch:
                await self._send_waiting(subscription)
            if until_read is not None:
                await until_read()

    async def _send_waiting(self, subscription: _Subscription) -> None:
        outlet = subscription.outlet
        for _ in range(outlet.waiting):
            await self._answers_sent.wait()  # control overtakes data
            left = self._subscriptions.get(subscription.order.id) is not subscription
            item = None if left else outlet.take()
            if item is None:
                return
            if not item.head:
                item.head = ws_protocol.shared_head(
                    item.key, item.encoding, item.sent_ns, item.captured_ns
                )
            message = ws_protocol.data_message(
                subscription.order.id, item.head, outlet.dropped, item.payload
            )
            self.sent += 1
            await self._websocket.send({"type": "websocket.send", "bytes": message})

    async def _tell_drops(self) -> None:
        while True:
            await asyncio.sleep(_TELL_DROPS_EVERY_S)
            if self._answers:
                continue  # the client is not reading; it is told when it does
            for subscription in self._subscriptions.values():
                counts = subscription.counts
                if counts != subscription.told:
                    subscription.told = counts
                    self._answer(ws_protocol.drops(subscription.order.id, *counts))


async def _until_gone(work: Callable[[], Awaitable[None]]) -> None:
    """Run until done or until the client is gone, which is no error."""
    try:
        await work()
    except (WebSocketDisconnect, WebSocketDisconnected, OSError):
        return


class Clients:
    """All WebSocket clients."""

    def __init__(self, streams: Streams, robots: Robots) -> None:
        self._streams = streams
        self._robots = robots
        self._clients: set[Client] = set()
        self._gone: dict[TotalName, int] = {"sent": 0, "dropped": 0, "lost": 0}

    def __len__(self) -> int:
        return len(self._clients)

    def describe(self) -> list[dict[str, Any]]:
        """Return the table of clients."""
        return [client.describe() for client in self._clients]

    def total(self, name: TotalName) -> int:
        """Return how many data messages were `sent`, `dropped` or `lost` so far."""
        return self._gone[name] + sum(int(row[name]) for row in self.describe())

    async def serve(self, websocket: WebSocket) -> None:
        """Serve one client from its handshake to its end."""
        if SUBPROTOCOL not in websocket.scope.get("subprotocols", ()):
            await websocket.accept()
            await websocket.close(1008, f"offer the subprotocol {SUBPROTOCOL}")
            return
        await websocket.accept(subprotocol=SUBPROTOCOL)
        client = Client(websocket, self._streams, self._robots)
        self._clients.add(client)
        try:
            await client.run()
        finally:
            self._clients.discard(client)
            row = client.describe()
            for name in self._gone:
                self._gone[name] += row[name]
