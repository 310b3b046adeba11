"""`Transport` on the official YARP Python bindings, for labs that want their carriers.

The bindings block, so every port has a thread of its own here, named after it, which hands over to
the event loop at once. Payloads pass as YARP's bottles: what is no bottle on the wire (point
clouds) cannot be read this way.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import importlib
import logging
import queue
import socket
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, TypeVar

from vertebra.errors import (
    BusyError,
    CodecError,
    ConfigError,
    DeadlineError,
    NotConnectedError,
    VertebraError,
)
from vertebra.yarp import (
    Counters,
    Delivery,
    Dialect,
    Incoming,
    NameClient,
    OnCall,
    OnData,
    Reply,
    Value,
    decode,
    encode,
)
from vertebra.yarp.ports.incoming import PeerDialect
from vertebra.yarp.ports.link import find
from vertebra.yarp.ports.outputs import Payload, parts_of
from vertebra.yarp.protocol.hints import dialect_of
from vertebra_yarp.driver import check_free

log = logging.getLogger(__name__)

T = TypeVar("T")

CARRIER: Final = "fast_tcp"
CALL_TIMEOUT_S: Final = 10.0
_LOOK_EVERY_S: Final = 0.2
_HANDED_OVER: Final = 16
"""Messages that may wait for the event loop; more are dropped and counted."""


def load_bindings() -> Any:
    """Return the module of the bindings.

    Raises:
        ConfigError: There is none, or it is the `yarp` of PyPI.
    """
    try:
        module = importlib.import_module("yarp")
    except ImportError as error:
        raise ConfigError(
            f"the YARP Python bindings cannot be imported: {error}; build YARP with "
            "-DYARP_COMPILE_BINDINGS=ON -DCREATE_PYTHON=ON and put the folder of its yarp.py on "
            "PYTHONPATH, or leave VERTEBRA_YARP_DRIVER at native, which needs no YARP"
        ) from error
    if not hasattr(module, "Network"):
        raise ConfigError(
            f"the yarp in {getattr(module, '__file__', '?')} is not YARP's: PyPI's package `yarp` "
            "is another project; pip uninstall yarp, and put the folder of YARP's own yarp.py on "
            "PYTHONPATH, or leave VERTEBRA_YARP_DRIVER at native"
        )
    return module


class Bottles:
    """YARP's bottles from and to bytes.

    SWIG has no way to hand out the bytes of a C++ object, so two methods of the library are called
    directly; their names are part of its binary interface.
    """

    def __init__(self, yarp: Any) -> None:
        library = ctypes.CDLL(yarp._yarp.__file__)  # noqa: SLF001  - where SWIG has it
        self._yarp = yarp
        self._to_binary = library._ZN4yarp2os6Bottle8toBinaryEPm  # noqa: SLF001  - C++, not private
        self._to_binary.restype = ctypes.c_void_p
        self._to_binary.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
        self._from_binary = library._ZN4yarp2os6Bottle10fromBinaryEPKcm  # noqa: SLF001
        self._from_binary.restype = None
        self._from_binary.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t]
        probe = yarp.Bottle()
        probe.addFloat64(0.5)
        self.dialect = dialect_of(self.bytes_of(probe)) or Dialect.V3

    def bytes_of(self, bottle: Any) -> bytes:
        """Return a bottle as it is on the wire."""
        size = ctypes.c_size_t()
        address = self._to_binary(int(bottle.this), ctypes.byref(size))
        return ctypes.string_at(address, size.value)

    def of(self, payload: Payload) -> Any:
        """Return the bottle for a payload; raise `EncodeError`."""
        return self.of_bytes(b"".join(parts_of(payload, self.dialect)))

    def of_bytes(self, raw: bytes) -> Any:
        """Return the bottle that is these bytes on the wire."""
        bottle = self._yarp.Bottle()
        self._from_binary(int(bottle.this), raw, len(raw))
        return bottle


class BoundPort:
    """A port of YARP's own, and the one thread that may block in it."""

    def __init__(self, yarp: Any, bottles: Bottles, name: str) -> None:
        self.name = name
        self.yarp = yarp
        self.bottles = bottles
        self.port = yarp.Port()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=f"yarp {name}")
        self._closing = threading.Event()
        self._lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._watch: asyncio.Task[None] | None = None
        self._left: Future[None] | None = None

    async def run(self, work: Callable[..., T], *arguments: Any) -> T:
        """Do in the thread what may block."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._thread, lambda: work(*arguments))

    def begin(self, work: Callable[[], None]) -> None:
        """Leave the thread to `work`, which returns once `ended`."""
        self._thread.submit(work).add_done_callback(self._tell)

    def _tell(self, done: Future[None]) -> None:
        if error := done.exception():
            log.error("the thread of YARP port %s failed", self.name, exc_info=error)

    @property
    def ended(self) -> bool:
        """Whether the port is closing."""
        return self._closing.is_set()

    def watch(self, count: Callable[[], int]) -> None:
        """Notice when no connection is left."""
        self._watch = asyncio.create_task(self._follow(count))

    async def _follow(self, count: Callable[[], int]) -> None:
        while count():  # noqa: ASYNC110 - the library does not tell
            await asyncio.sleep(_LOOK_EVERY_S)
        self.lose("closed by the peer")

    def lose(self, reason: str) -> None:
        """Say why the connection has ended."""
        if not self._lost.done():
            self._lost.set_result(reason)

    async def wait_closed(self) -> str:
        """Return why the connection ended, when it has."""
        return await asyncio.shield(self._lost)

    def leave(self, reason: str) -> Future[None]:
        """Begin to close the port; return what is done when its thread has ended."""
        if self._left is None:
            self._closing.set()
            self.lose(reason)
            if self._watch is not None:
                self._watch.cancel()
            closing = ThreadPoolExecutor(1, thread_name_prefix=f"yarp {self.name} closing")
            self._left = closing.submit(self._shut)
            closing.shutdown(wait=False)
        return self._left

    async def close(self) -> None:
        """Close the port and end its thread."""
        await asyncio.wrap_future(self.leave("closed by us"))

    def _shut(self) -> None:
        self.port.interrupt()
        self.port.close()
        self._thread.shutdown()

    def incoming(self, raw: bytes, envelope: str, *, reply_wanted: bool) -> Incoming:
        """Return a message as the other driver has it; the bindings do not tell from whom."""
        return Incoming(
            memoryview(raw),
            envelope=envelope,
            sender=self.name,
            sender_host="",
            carrier=CARRIER,
            reply_wanted=reply_wanted,
            peer_dialect=PeerDialect(self.bottles.dialect),
        )


class BoundReader(BoundPort):
    """Reads an output port."""

    def start(self, on_data: OnData) -> None:
        """Begin to hand messages over."""
        self._on_data = on_data
        self._loop = asyncio.get_running_loop()
        self._free = threading.Semaphore(_HANDED_OVER)
        self._dropped = 0
        self.begin(self._read)
        self.watch(self.port.getInputCount)

    def _read(self) -> None:
        bottle, envelope = self.yarp.Bottle(), self.yarp.Bottle()
        while not self.ended:
            if not self.port.read(bottle):
                continue
            envelope.clear()
            self.port.getEnvelope(envelope)
            message = self.incoming(
                self.bottles.bytes_of(bottle), envelope.toString(), reply_wanted=False
            )
            if self._free.acquire(blocking=False):
                self._loop.call_soon_threadsafe(self._deliver, message)
                continue
            self._dropped += 1
            if self._dropped & (self._dropped - 1) == 0:
                log.error(
                    "%s lost %d messages so far: the service is slow", self.name, self._dropped
                )

    def _deliver(self, message: Incoming) -> None:
        self._free.release()
        if self.ended:
            return
        try:
            self._on_data(message)
        except CodecError as error:
            log.error("a message of %s is refused: %s", self.name, error)  # noqa: TRY400
        except Exception:
            log.exception("the reader of %s failed", self.name)


class BoundWriter(BoundPort):
    """Writes to whoever reads, newest first or in order; also into one input port of others."""

    def start(self, delivery: Delivery, depth: int) -> None:
        """Begin to send what `write` is given."""
        self.sent = Counters()
        self._latest = delivery == "latest"
        self._waiting: queue.Queue[tuple[Any, int, str]] = queue.Queue(1 if self._latest else depth)
        self._taken = asyncio.Event()
        self._taken.set()
        self._loop = asyncio.get_running_loop()
        self.begin(self._write)

    def write(self, payload: Payload, *, envelope: str = "") -> None:
        """See `Port.write`."""
        raw = b"".join(parts_of(payload, self.bottles.dialect))
        item = (self.bottles.of_bytes(raw), len(raw), envelope)
        while True:
            try:
                self._waiting.put_nowait(item)
            except queue.Full:
                if not self._latest:
                    self.sent.refused += 1
                    raise BusyError(f"the YARP port {self.name}", self._waiting.maxsize) from None
                with contextlib.suppress(queue.Empty):
                    self._waiting.get_nowait()
                    self._waiting.task_done()
                    self.sent.dropped += 1
            else:
                self._taken.clear()
                return

    async def wait_taken(self) -> bool:
        """See `Sender.wait_taken`."""
        taken = asyncio.create_task(self._taken.wait())
        ended = asyncio.create_task(self.wait_closed())
        try:
            await asyncio.wait([taken, ended], return_when=asyncio.FIRST_COMPLETED)
        finally:
            taken.cancel()
            ended.cancel()
        return self._taken.is_set()

    def _write(self) -> None:
        while not self.ended:
            try:
                bottle, size, envelope = self._waiting.get(timeout=_LOOK_EVERY_S)
            except queue.Empty:
                continue
            if envelope:
                self.port.setEnvelope(self.yarp.Bottle(envelope))
            if self.port.write(bottle):
                self.sent.messages += 1
                self.sent.bytes += size
            self._waiting.task_done()
            if not self._waiting.unfinished_tasks:
                self._loop.call_soon_threadsafe(self._note_taken)

    def _note_taken(self) -> None:
        if not self._waiting.unfinished_tasks:
            self._taken.set()


class BoundCaller(BoundPort):
    """Calls an RPC port."""

    @property
    def dialect(self) -> Dialect:
        """That of the bindings: a library of one generation does not reach the other."""
        return self.bottles.dialect

    async def call(self, values: Sequence[Value], *, timeout_s: float) -> list[Value]:
        """See `RpcClient.call`."""
        request, reply = self.bottles.of(values), self.yarp.Bottle()
        if self._lost.done():
            raise NotConnectedError(f"the connection to {self.name} has ended; connect again")
        try:
            async with asyncio.timeout(timeout_s):
                done = await self.run(self.port.write, request, reply)
        except TimeoutError:
            self.leave("a call was given up, and with it the place in the stream")
            raise DeadlineError(f"YARP port {self.name}", timeout_s) from None
        if not done:
            self.lose("a call failed")
            raise NotConnectedError(f"the connection to {self.name} was lost during a call")
        return decode(self.bottles.bytes_of(reply), self.dialect)

    async def close(self) -> None:
        """End it; of a call that was given up the library lets go in `CALL_TIMEOUT_S`."""
        if not self.ended:
            await super().close()


class BoundServer(BoundPort):
    """An RPC port; one call at a time, from whomever."""

    def start(self, on_call: OnCall) -> None:
        """Begin to answer."""
        self.sent = Counters()
        self._on_call = on_call
        self._loop = asyncio.get_running_loop()
        self.begin(self._serve)

    def write(self, payload: Payload, *, envelope: str = "") -> None:  # noqa: ARG002
        """Refuse: an RPC port only answers."""
        raise NotConnectedError(f"{self.name} answers calls, it has no readers")

    def _serve(self) -> None:
        request = self.yarp.Bottle()
        while not self.ended:
            if not self.port.read(request, True):  # noqa: FBT003 - will reply
                continue
            message = self.incoming(self.bottles.bytes_of(request), "", reply_wanted=True)
            asked = asyncio.run_coroutine_threadsafe(self._answer(message), self._loop)
            try:
                raw = asked.result(CALL_TIMEOUT_S)
            except TimeoutError:
                asked.cancel()
                raw = encode(["no answer in time"], self.bottles.dialect)
            self.port.reply(self.bottles.of_bytes(raw))
            self.sent.messages += 1

    async def _answer(self, message: Incoming) -> bytes:
        reply: Reply
        try:
            reply = await self._on_call(message)
        except VertebraError as error:
            reply = [str(error)]
        return reply if isinstance(reply, bytes) else encode(reply or [], self.bottles.dialect)


class BindingsDriver:
    """`Transport` on YARP's own library."""

    def __init__(self, yarp: Any, names: NameClient, advertise_host: str) -> None:
        self.names = names
        self._advertise_host = advertise_host
        self._yarp = yarp
        self._bottles = Bottles(yarp)

    async def read(self, source: str, reader_name: str, on_data: OnData) -> BoundReader:
        """See `Transport.read`: through a port of ours, as the library has it."""
        await find(source, self.names)
        reader = BoundReader(self._yarp, self._bottles, reader_name)
        await self._open(reader)
        connect = self._yarp.Network.connect
        if not await reader.run(connect, source, reader_name, CARRIER):
            await reader.close()
            raise NotConnectedError(f"YARP does not connect {source} to {reader_name}")
        reader.start(on_data)
        return reader

    async def dial(self, name: str) -> BoundCaller:
        """See `Transport.dial`."""
        caller = BoundCaller(self._yarp, self._bottles, name)
        caller.port.setRpcClient()
        caller.port.setTimeout(CALL_TIMEOUT_S)
        await self._add_output(caller, "anon_rpc", name, "tcp")
        return caller

    async def send_to(
        self, dest: str, sender_name: str, *, carrier: str = CARRIER, depth: int = 0
    ) -> BoundWriter:
        """See `Transport.send_to`."""
        writer = BoundWriter(self._yarp, self._bottles, sender_name)
        await self._add_output(writer, sender_name, dest, carrier)
        writer.start("queue" if depth else "latest", depth)
        return writer

    async def open_writer(self, name: str, *, delivery: Delivery, depth: int) -> BoundWriter:
        """See `Transport.open_writer`."""
        await check_free(name, self.names)
        writer = BoundWriter(self._yarp, self._bottles, name)
        await self._open(writer)
        writer.start(delivery, depth)
        return writer

    async def open_server(self, name: str, on_call: OnCall) -> BoundServer:
        """See `Transport.open_server`."""
        await check_free(name, self.names)
        server = BoundServer(self._yarp, self._bottles, name)
        await self._open(server)
        server.start(on_call)
        return server

    async def _open(self, port: BoundPort) -> None:
        # A tcp_port of our choice: those that a name server hands out may be taken on this machine.
        contact = self._yarp.Contact(port.name, "tcp", self._advertise_host, _free_tcp_port())
        if not await port.run(port.port.open, contact):
            await port.close()
            raise NotConnectedError(f"YARP does not open the port {port.name}; its log says why")

    async def _add_output(self, port: BoundPort, fake: str, dest: str, carrier: str) -> None:
        """Connect a port that is not registered to `dest`."""
        added = False
        try:
            await find(dest, self.names)
            await port.run(port.port.openFake, fake)
            added = await port.run(port.port.addOutput, dest, carrier)
        finally:
            if not added:
                await port.close()
        if not added:
            raise NotConnectedError(f"YARP cannot reach {dest} over {carrier}")
        port.watch(port.port.getOutputCount)


@contextlib.asynccontextmanager
async def bindings_driver(
    names: NameClient, *, advertise_host: str = ""
) -> AsyncIterator[BindingsDriver]:
    """Yield a driver on YARP's library, which uses the same name server.

    Raises:
        ConfigError: The bindings are not there.
    """
    yarp = load_bindings()
    yarp.Network.init()
    yarp.Network.setVerbosity(-1)
    yarp.Network.setNameServerContact(yarp.Contact("/root", "tcp", names.host, names.tcp_port))
    yield BindingsDriver(yarp, names, advertise_host)


def _free_tcp_port() -> int:
    with socket.socket() as listener:
        listener.bind(("", 0))
        return int(listener.getsockname()[1])
