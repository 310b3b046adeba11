"""A program that watches a fleet by the gateway's WebSocket, and comes back as the page does."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import socket
import struct
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable
from typing import Any, Final, NamedTuple, Self

from websockets.asyncio.client import ClientConnection, connect
from websockets.client import ClientProtocol
from websockets.exceptions import WebSocketException
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from vertebra.codec import CodecRegistry
from vertebra.messages import Header, Message

from .fleet import Fleet

CAMERA: Final = "vizzy/camera/left"
FACES: Final = "vizzy/camera/left/faces"
SILENCE_LIMIT_S: Final = 3.0
RETRY_S: Final = (0.25, 1.5)
_HEAD: Final = struct.Struct("<II")
_ALIGNMENT: Final = 64


class Data(NamedTuple):
    """A data message of the gateway."""

    subscription: int
    key: str
    encoding: str
    dropped: int
    payload: bytes


def read_data(message: bytes) -> Data:
    """Take a data message of the gateway apart; see PROTOCOL.md."""
    subscription, length = _HEAD.unpack_from(message)
    head_end = _HEAD.size + length
    head = json.loads(message[_HEAD.size : head_end])
    payload = message[head_end + -head_end % _ALIGNMENT :]
    return Data(subscription, head["key"], head["encoding"], head["dropped"], payload)


def dial(fleet: Fleet, **options: Any) -> connect:
    """Return a connection to make to the gateway, as a program without cookies makes it."""
    return connect(
        f"{fleet.url.replace('http', 'ws')}/ws",
        subprotocols=[Subprotocol("vertebra.v1"), Subprotocol(f"token.{fleet.token}")],
        compression=None,
        proxy=None,
        max_size=None,
        **options,
    )


async def order(connection: ClientConnection, op: str, **members: Any) -> None:
    """Send a control message."""
    await connection.send(json.dumps({"op": op, **members}))


class FrugalReader:
    """A connection that takes bytes off its socket only when asked for the next message.

    A ready-made client reads ahead, and answers pings for an application that sleeps.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._address = parse_uri(f"{fleet.url.replace('http', 'ws')}/ws")
        token = Subprotocol(f"token.{fleet.token}")
        self._protocol = ClientProtocol(
            self._address, subprotocols=[Subprotocol("vertebra.v1"), token], max_size=None
        )
        self._socket = socket.socket()
        self._frames: deque[Frame] = deque()

    async def __aenter__(self) -> Self:
        self._socket.setblocking(False)
        loop = asyncio.get_running_loop()
        await loop.sock_connect(self._socket, (self._address.host, self._address.port))
        self._protocol.send_request(self._protocol.connect())
        while self._protocol.state is State.CONNECTING:
            await self._exchange()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._socket.close()

    async def send(self, **members: Any) -> None:
        """Send a control message."""
        self._protocol.send_text(json.dumps(members).encode())
        await self._flush()

    async def next(self) -> str | bytes:
        """Return the next message."""
        while True:
            while self._frames:
                frame = self._frames.popleft()
                if frame.opcode is Opcode.TEXT:
                    return bytes(frame.data).decode()
                if frame.opcode is Opcode.BINARY:
                    return bytes(frame.data)
            await self._exchange()

    async def _exchange(self) -> None:
        loop = asyncio.get_running_loop()
        await self._flush()
        self._protocol.receive_data(await loop.sock_recv(self._socket, 1 << 16))
        await self._flush()  # the answers to pings
        events = self._protocol.events_received()
        self._frames.extend(event for event in events if isinstance(event, Frame))

    async def _flush(self) -> None:
        loop = asyncio.get_running_loop()
        for piece in self._protocol.data_to_send():
            await loop.sock_sendall(self._socket, piece)


class Sighting(NamedTuple):
    """A message that came."""

    message: Message
    header: Header
    arrived_ns: int


class Watcher:
    """Watches keys, one message on its way at a time; dials again when the gateway is lost.

    Attributes:
        connections: How often it reached the gateway.
    """

    def __init__(self, fleet: Fleet, keys: Iterable[str]) -> None:
        self.connections = 0
        self._fleet = fleet
        self._keys = dict(enumerate(keys, 1))
        self._codecs = CodecRegistry.installed()
        self._newest: dict[str, Sighting] = {}
        self._followers: list[Callable[[str, Sighting], None]] = []

    async def newer(self, key: str, than_ns: int, *, timeout_s: float) -> Sighting:
        """Return the first message on `key` that was captured after a point in time."""
        found: asyncio.Future[Sighting] = asyncio.get_running_loop().create_future()

        def look(seen_key: str, sighting: Sighting) -> None:
            if seen_key == key and sighting.header.captured_ns > than_ns and not found.done():
                found.set_result(sighting)

        if key in self._newest:
            look(key, self._newest[key])
        self._followers.append(look)
        try:
            async with asyncio.timeout(timeout_s):
                return await found
        except TimeoutError:
            raise AssertionError(f"nothing new on {key} within {timeout_s:.1f} s") from None
        finally:
            self._followers.remove(look)

    async def collect(self, duration_s: float) -> dict[str, list[Sighting]]:
        """Return all messages that come during some time, by key."""
        seen: dict[str, list[Sighting]] = {key: [] for key in self._keys.values()}

        def look(key: str, sighting: Sighting) -> None:
            seen[key].append(sighting)

        self._followers.append(look)
        await asyncio.sleep(duration_s)
        self._followers.remove(look)
        return seen

    async def watch(self) -> None:
        """Watch for ever."""
        retry_s, limit_s = RETRY_S
        while True:
            with contextlib.suppress(OSError, TimeoutError, WebSocketException):
                async with dial(
                    self._fleet,
                    open_timeout=5.0,
                    close_timeout=0.5,
                    ping_interval=1.0,
                    ping_timeout=SILENCE_LIMIT_S,
                ) as connection:
                    self.connections += 1
                    retry_s = RETRY_S[0]
                    await self._listen(connection)
            await asyncio.sleep(retry_s * random.uniform(0.5, 1.0))
            retry_s = min(2 * retry_s, limit_s)

    async def _listen(self, connection: ClientConnection) -> None:
        for number, key in self._keys.items():
            await order(connection, "subscribe", id=number, key=key, window=1)
        async for message in connection:
            if isinstance(message, str):
                continue
            data = read_data(message)
            decoded, header = self._codecs.decode(data.payload, data.encoding)
            sighting = Sighting(decoded, header, time.time_ns())
            self._newest[data.key] = sighting
            for follower in tuple(self._followers):
                follower(data.key, sighting)
            await order(connection, "ack", id=data.subscription)


@contextlib.asynccontextmanager
async def watching(fleet: Fleet, *keys: str) -> AsyncIterator[Watcher]:
    """Watch the camera and the faces in it, or other keys, as long as the block runs."""
    watcher = Watcher(fleet, keys or (CAMERA, FACES))
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(watcher.watch())
        yield watcher
        task.cancel()
