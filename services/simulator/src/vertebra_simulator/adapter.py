"""Wiring: the robot's YARP ports, kept open and fed in real time."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from typing import Final

from vertebra.errors import CommandRefusedError, DeadlineError, DecodeError, NotConnectedError
from vertebra.service import Context
from vertebra.yarp import Incoming, NameClient, OnCall, OnData, Port, Value
from vertebra.yarp.objects import Image, Pair, Stamp, Vector
from vertebra_simulator import grabber
from vertebra_simulator.board import ControlBoard
from vertebra_simulator.body import Body
from vertebra_simulator.geometry import camera_rotation, inertial
from vertebra_simulator.scene import Scene
from vertebra_simulator.settings import SimulatorSettings

log = logging.getLogger(__name__)

STATE_RATE_HZ: Final = 50.0
_RETRY_S: Final = 1.0


async def serve(context: Context[SimulatorSettings]) -> None:
    """Be the robot until cancelled."""
    async with AsyncExitStack() as stack:
        renderer = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="renderer"))
        robot = Robot(context, renderer)
        await robot.open_ports(stack)
        context.ready()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(robot.stream_state(), name="state")
            tasks.create_task(robot.stream_images(), name="images")


class Robot:
    """The simulated robot: its body, what it sees, and its YARP ports."""

    def __init__(self, context: Context[SimulatorSettings], renderer: ThreadPoolExecutor) -> None:
        host, _, tcp_port = context.settings.name_server.rpartition(":")
        self._context = context
        self._names = NameClient(host, int(tcp_port))
        self._renderer = renderer
        self._began_s = time.monotonic()
        self._body = Body()
        self._board = ControlBoard(self._body)
        self._scene = Scene()
        self._ports: dict[str, Port] = {}
        self._rendered = context.counter("simulator_images", "Images that were rendered")
        self._skipped = context.counter("simulator_ticks_skipped", "Times that were too late")
        context.gauge(
            "simulator_readers",
            "Connections that read from the robot",
            lambda: sum(len(port.outputs) for port in self._ports.values()),
        )
        context.gauge(
            "simulator_refused",
            "Streamed commands that were damaged or did not fit the joints",
            lambda: sum(port.received.refused for port in self._ports.values()),
        )
        context.gauge(
            "simulator_dropped",
            "Messages that slow readers missed",
            lambda: sum(port.sent.dropped for port in self._ports.values()),
        )

    async def open_ports(self, stack: AsyncExitStack) -> None:
        """Open all YARP ports, waiting for the name server; `stack` closes them."""
        await self._open(stack, "head/rpc:i", on_call=self._on_head_call)
        await self._open(stack, "head/command:i", on_data=self._on_command)
        await self._open(stack, "camera/left/rpc", on_call=self._on_camera_call)
        for output in ("head/state:o", "head/stateExt:o", "imu", "camera/left"):
            await self._open(stack, output)

    async def _open(
        self,
        stack: AsyncExitStack,
        name: str,
        *,
        on_data: OnData | None = None,
        on_call: OnCall | None = None,
    ) -> None:
        settings = self._context.settings
        while True:
            try:
                port = await Port.open(
                    f"/{settings.robot}/{name}",
                    self._names,
                    on_data=on_data,
                    on_call=on_call,
                    bind_host=settings.bind_host,
                    advertise_host=settings.advertise_host or None,
                )
            except (NotConnectedError, DeadlineError) as error:
                self._context.report("name server", "error", str(error))
                await asyncio.sleep(_RETRY_S)
            else:
                self._context.report("name server", "ok")
                self._ports[name] = await stack.enter_async_context(port)
                return

    # --- what it is told ---------------------------------------------------------------------

    async def _on_head_call(self, incoming: Incoming) -> list[Value]:
        self._live()
        return self._board.answer(incoming.bottle(), time.time())

    async def _on_camera_call(self, incoming: Incoming) -> list[Value]:
        return grabber.answer(incoming.bottle(), self._scene.camera)

    def _on_command(self, incoming: Incoming) -> None:
        command = Pair.decode(incoming.payload)
        self._live()
        try:
            self._board.command(command.head, command.body.values)
        except CommandRefusedError as error:
            raise DecodeError(f"command refused: {error}") from error

    # --- what it tells -----------------------------------------------------------------------

    async def stream_state(self) -> None:
        """Tell where the joints are and what the IMU feels."""
        joints, extended, imu = (
            self._ports[name] for name in ("head/state:o", "head/stateExt:o", "imu")
        )
        async for count in self._ticks(STATE_RATE_HZ):
            self._live()
            stamp = Stamp(count, time.time()).to_envelope()
            if joints.outputs:
                joints.write(Vector.of(self._body.positions).encode(), envelope=stamp)
            if extended.outputs:
                extended.write(self._board.state().encode(), envelope=stamp)
            if imu.outputs:
                felt = inertial(self._body.positions, self._body.velocities)
                imu.write(Vector.of(felt).encode(), envelope=stamp)

    async def stream_images(self) -> None:
        """Show what the camera sees, as long as somebody looks."""
        port, camera = self._ports["camera/left"], self._scene.camera
        async for count in self._ticks(self._context.settings.camera_rate_hz):
            if not port.outputs:
                continue
            time_s = self._live()
            stamp = Stamp(count, time.time()).to_envelope()
            pixels = await asyncio.get_running_loop().run_in_executor(
                self._renderer, self._render, self._body.positions, time_s
            )
            image = Image.from_packed("rgb", camera.width, camera.height, pixels)
            port.write(image, envelope=stamp)
            self._rendered.inc()

    def _render(self, positions: list[float], time_s: float) -> bytes:
        return self._scene.render(camera_rotation(positions), time_s).tobytes()

    def _live(self) -> float:
        """Let the body move on to now; return the seconds that it has lived."""
        time_s = time.monotonic() - self._began_s
        self._body.advance_to(time_s)
        return time_s

    async def _ticks(self, rate_hz: float) -> AsyncIterator[int]:
        """Yield the number of each tick when it is due, without drift; late ones are skipped."""
        began_s = time.monotonic()
        count = 0
        while True:
            count += 1
            late = int((time.monotonic() - began_s) * rate_hz) - count
            if late > 0:
                self._skipped.inc(late)
                count += late
            await asyncio.sleep(began_s + count / rate_hz - time.monotonic())
            yield count
