"""What the browser looks at: a real router and gateway, and a robot in the test's own hands."""

from __future__ import annotations

import asyncio
import math
import os
import signal
import sys
import time
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final, TypeVar

import httpx
import numpy as np

from vertebra.bus import Bus, Priority, Reply, Request, ZenohBus
from vertebra.bus.router import running_router
from vertebra.codec import ENCODING, CodecRegistry
from vertebra.messages import Array, Box, Face, Faces, Image
from vertebra.service import MessagePublisher
from vertebra.testing.ports import free_tcp_port
from vertebra_gateway.testing import FakeBase, FakeRobot

PROFILES: Final = Path(__file__).parent / "robots"
WIDTH: Final = 320
HEIGHT: Final = 240
SIDE: Final = 40
WALL_RGB: Final = (40, 90, 140)
SQUARE_RGB: Final = (250, 200, 20)
RATE_HZ: Final = 25.0
RESULT_AFTER_S: Final = 0.03
START_S: Final = 20.0
T = TypeVar("T", "Robot", FakeBase)


class Gateway:
    """The gateway as a process of its own, which can die, freeze and come back."""

    def __init__(self, router: str, heartbeats: Path, profiles: Path) -> None:
        self._profiles = profiles
        self.tcp_port = free_tcp_port()
        self.token = "a-token-for-tests"
        self._router = router
        self._heartbeats = heartbeats
        self._process: Process | None = None

    @property
    def url(self) -> str:
        """Where the dashboard is."""
        return f"http://127.0.0.1:{self.tcp_port}/"

    async def start(self) -> None:
        """Start it and wait until it answers."""
        environment = {
            **{name: value for name, value in os.environ.items() if "VERTEBRA" not in name},
            "VERTEBRA_ROUTER": self._router,
            "VERTEBRA_HEARTBEAT_DIR": str(self._heartbeats),
            "VERTEBRA_GATEWAY_TCP_PORT": str(self.tcp_port),
            "VERTEBRA_GATEWAY_TOKEN": self.token,
            "VERTEBRA_GATEWAY_ROBOTS": str(self._profiles),
        }
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "vertebra_gateway", env=environment
        )
        async with asyncio.timeout(START_S), httpx.AsyncClient(base_url=self.url) as client:
            while True:
                assert self._process.returncode is None, "the gateway ended; see its log above"
                try:
                    if (await client.get("healthz")).is_success:
                        return
                except httpx.TransportError:
                    await asyncio.sleep(0.02)

    def freeze(self) -> None:
        """Let it stand still, with all its connections open."""
        self._signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self._signal(signal.SIGCONT)

    async def kill(self) -> None:
        """End it without a chance to say goodbye; harmless when repeated."""
        if self._process is not None:
            self._signal(signal.SIGKILL)
            await self._process.wait()
            self._process = None

    def _signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)


class Robot(FakeRobot):
    """A robot whose camera sees a square that moves from side to side, and finds it, as a face.

    Attributes:
        stops: How often it was stopped.
        most_moves_at_once: How many moves were under way at the same time, at most.
        blind: It finds nothing more: no results are published.
        still: The square stays where it is.
    """

    def __init__(self, bus: Bus, codecs: CodecRegistry) -> None:
        super().__init__(bus, codecs)
        self.stops = 0
        self.most_moves_at_once = 0
        self._moves_under_way = 0
        self.blind = False
        self.still = False
        self._images = MessagePublisher(bus, codecs, "vizzy/camera/left", priority=Priority.BULK)
        self._imu = bus.publisher("vizzy/imu", encoding=ENCODING)
        self._faces = MessagePublisher(bus, codecs, "vizzy/camera/left/faces")

    def publish_rubbish(self) -> None:
        """Publish on the IMU's key what is no frame, though it says so."""
        self._imu.put(b"rubbish")

    async def live(self) -> None:
        """Publish joints, images and faces, for ever."""
        began_s = time.monotonic()
        async with asyncio.TaskGroup() as tasks:
            while True:
                moved_s = 0.0 if self.still else time.monotonic() - began_s
                x = round((WIDTH - SIDE) * (0.5 + 0.5 * math.sin(2.0 * moved_s)))
                captured_ns = time.time_ns()
                self.publish_state()
                self._images.publish(_image_with_square(x), captured_ns=captured_ns)
                if not self.blind:
                    tasks.create_task(self._find(x, captured_ns))
                await asyncio.sleep(1.0 / RATE_HZ)

    async def _find(self, x: int, captured_ns: int) -> None:
        await asyncio.sleep(RESULT_AFTER_S)
        box = Box(x=float(x), y=100.0, width=float(SIDE), height=float(SIDE))
        faces = Faces(
            faces=(Face(track_id=7, box=box, score=0.875),), image_width=WIDTH, image_height=HEIGHT
        )
        self._faces.publish(faces, captured_ns=captured_ns)

    async def _move(self, request: Request) -> Reply:
        self._moves_under_way += 1
        self.most_moves_at_once = max(self.most_moves_at_once, self._moves_under_way)
        try:
            return await super()._move(request)
        finally:
            self._moves_under_way -= 1

    async def _stop(self, request: Request) -> Reply:
        self.stops += 1
        return await super()._stop(request)


def _image_with_square(x: int) -> Image:
    pixels = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    pixels[:] = WALL_RGB
    pixels[100 : 100 + SIDE, x : x + SIDE] = SQUARE_RGB
    pixels[0, 0] = (255, 0, 0)
    pixels[0, -1] = (0, 255, 0)
    pixels[-1, 0] = (0, 0, 255)
    pixels[-1, -1] = (1, 2, 3)
    return Image(pixels=Array(pixels.tobytes(), "|u1", pixels.shape), pixel_format="rgb8")


class Lab:
    """A router, a gateway, and the place where robots can be."""

    def __init__(self, gateway: Gateway, router: str) -> None:
        self.gateway = gateway
        self.router = router
        self._codecs = CodecRegistry.installed()

    @asynccontextmanager
    async def robot(self) -> AsyncIterator[Robot]:
        """Have a robot here for the length of a block."""
        async with self._living(Robot) as robot:
            yield robot

    @asynccontextmanager
    async def base(self) -> AsyncIterator[FakeBase]:
        """Have the base of the robot here for the length of a block."""
        async with self._living(FakeBase) as base:
            yield base

    @asynccontextmanager
    async def _living(self, kind: type[T]) -> AsyncIterator[T]:
        bus = await ZenohBus.open(self.router, timeout_s=5)
        one = kind(bus, self._codecs)
        living = asyncio.create_task(one.live())
        try:
            yield one
        finally:
            living.cancel()
            await asyncio.wait([living])
            await bus.close()


@asynccontextmanager
async def running_lab(heartbeats: Path, profiles: Path = PROFILES) -> AsyncIterator[Lab]:
    """Have a lab for the length of a block."""
    router = f"tcp/127.0.0.1:{free_tcp_port()}"
    with running_router([router]):
        gateway = Gateway(router, heartbeats, profiles)
        await gateway.start()
        try:
            yield Lab(gateway, router)
        finally:
            await gateway.kill()
