"""Wiring: the robot's YARP ports, kept open and fed in real time."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from typing import Final

from vertebra.errors import CommandRefusedError, DeadlineError, DecodeError, NotConnectedError
from vertebra.service import Context
from vertebra.yarp import Incoming, NameClient, OnCall, OnData, Port, Value, Vocab
from vertebra.yarp.objects import Image, Pair, Sound, Stamp, Vector, YarpObject
from vertebra_simulator import face, grabber, sound
from vertebra_simulator.board import ControlBoard
from vertebra_simulator.body import Body
from vertebra_simulator.gaze import GazeController
from vertebra_simulator.geometry import camera_rotation, inertial
from vertebra_simulator.inertials import METADATA, measurements
from vertebra_simulator.scene import Scene
from vertebra_simulator.settings import SimulatorSettings
from vertebra_simulator.ticks import ticks
from vertebra_simulator.wheels import serve_wheels

log = logging.getLogger(__name__)

STATE_RATE_HZ: Final = 50.0
FACE_RATE_HZ: Final = 10.0
_RETRY_S: Final = 1.0
STATES: Final = (
    "head/state:o", "head/stateExt:o", "head/inertials/measures:o", "imu", "gaze/x:o",
    "gaze/angles:o",
)  # fmt: skip
OUTPUTS: Final = (*STATES, "camera/left", "face/image:o", "microphone/audio:o")


async def serve(context: Context[SimulatorSettings]) -> None:
    """Be the robot until cancelled."""
    async with AsyncExitStack() as stack:
        renderer = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="renderer"))
        robot = Robot(context, renderer)
        async with asyncio.TaskGroup() as tasks:
            if context.settings.ros2:
                tasks.create_task(serve_wheels(context), name="wheels")
            await robot.open_ports(stack)
            context.ready()
            tasks.create_task(robot.stream_state(), name="state")
            tasks.create_task(robot.stream_images(), name="images")
            tasks.create_task(robot.stream_face(), name="face")
            tasks.create_task(robot.stream_sound(), name="sound")


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
        self._gaze = GazeController(self._body, self._scene.camera)
        self._face = face.Face()
        self._room = sound.Room()
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
        stack.push_async_callback(self._close_ports)
        for name, on_call in {
            "head/rpc:i": self._on_head_call,
            "head/inertials/rpc:o": self._on_inertials_call,
            "camera/left/rpc": self._on_camera_call,
            "gaze/rpc": self._on_gaze_call,
            "face/emotions/in": self._on_face_call,
        }.items():
            await self._open(name, on_call=on_call)
        for name, on_data in {
            "head/command:i": self._on_command,
            "gaze/xd:i": self._on_gaze_point,
            "gaze/angles:i": lambda incoming: self._gaze.look(incoming.bottle()),
            "gaze/mono:i": lambda incoming: self._gaze.look_at_pixel(incoming.bottle()),
            "speaker/audio:i": lambda incoming: self._room.play(
                Sound.decode(incoming.payload, incoming.dialect)
            ),
        }.items():
            await self._open(name, on_data=self._refusing(on_data))
        for name in OUTPUTS:
            await self._open(name)

    async def _open(
        self,
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
                self._ports[name] = port
                return

    async def _close_ports(self) -> None:
        # All at once: each may wait for a name server that is gone.
        await asyncio.gather(*(port.close() for port in self._ports.values()))

    # --- what it is told ---------------------------------------------------------------------

    async def _on_head_call(self, incoming: Incoming) -> list[Value]:
        self._live()
        return self._board.answer(incoming.bottle(), time.time())

    async def _on_camera_call(self, incoming: Incoming) -> list[Value]:
        return grabber.answer(incoming.bottle(), self._scene.camera)

    async def _on_inertials_call(self, incoming: Incoming) -> list[Value]:
        return METADATA if incoming.bottle() == ["getMetadata"] else [Vocab("fail")]

    async def _on_gaze_call(self, incoming: Incoming) -> list[Value]:
        self._live()
        return self._gaze.answer(incoming.bottle())

    async def _on_face_call(self, incoming: Incoming) -> list[Value]:
        return self._face.answer(incoming.bottle())

    def _on_command(self, incoming: Incoming) -> None:
        command = Pair.decode(incoming.payload, incoming.dialect)
        self._board.command(command.head, command.body.values)

    def _on_gaze_point(self, incoming: Incoming) -> None:
        self._gaze.look_at([*map(float, incoming.bottle())])  # type: ignore[arg-type]

    def _refusing(self, on_data: OnData) -> OnData:
        """Return `on_data` for a body that has lived on to now, its refusals told as faults."""

        def take(incoming: Incoming) -> None:
            self._live()
            try:
                on_data(incoming)
            except (CommandRefusedError, TypeError) as error:
                raise DecodeError(f"command refused: {error}") from error

        return take

    # --- what it tells -----------------------------------------------------------------------

    async def stream_state(self) -> None:
        """Tell where the joints are, where the eyes look and what the IMU feels."""
        async for count in ticks(STATE_RATE_HZ, self._skipped.inc):
            stamp = Stamp(count, time.time())
            self._live()
            for name in STATES:
                if self._ports[name].outputs:
                    state = self._state(name, stamp.time_s)
                    self._ports[name].write(state, envelope=stamp.to_envelope())

    def _state(self, name: str, time_s: float) -> YarpObject:
        """Return what one of `STATES` streams now."""
        felt = inertial(self._body.positions, self._body.velocities)
        match name:
            case "head/stateExt:o":
                return self._board.state()
            case "head/inertials/measures:o":
                return measurements(felt, time_s)
        vectors: dict[str, Iterable[float]] = {
            "head/state:o": self._body.positions,
            "imu": felt,
            "gaze/x:o": self._gaze.point,
            "gaze/angles:o": self._gaze.angles,
        }
        return Vector.of(vectors[name])

    async def stream_images(self) -> None:
        """Show what the camera sees, as long as somebody looks."""
        port, camera = self._ports["camera/left"], self._scene.camera
        async for count in ticks(self._context.settings.camera_rate_hz, self._skipped.inc):
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

    async def stream_face(self) -> None:
        """Show the face, as long as somebody looks."""
        port = self._ports["face/image:o"]
        async for count in ticks(FACE_RATE_HZ, self._skipped.inc):
            if port.outputs:
                stamp = Stamp(count, time.time()).to_envelope()
                image = Image.from_packed("rgb", face.WIDTH, face.HEIGHT, self._face.render())
                port.write(image, envelope=stamp)

    async def stream_sound(self) -> None:
        """Let the microphone hear, in real time."""
        port = self._ports["microphone/audio:o"]
        async for count in ticks(sound.RATE_HZ / sound.CHUNK, self._skipped.inc):
            heard = self._room.hear()
            if port.outputs:
                port.write(heard, envelope=Stamp(count, time.time()).to_envelope())

    def _render(self, positions: list[float], time_s: float) -> bytes:
        return self._scene.render(camera_rotation(positions), time_s).tobytes()

    def _live(self) -> float:
        """Let the body move on to now; return the seconds that it has lived."""
        time_s = time.monotonic() - self._began_s
        self._body.advance_to(time_s)
        return time_s
