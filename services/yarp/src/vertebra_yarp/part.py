"""A control board as a robot part: joint state, limits, moves, velocities, modes, stop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Any, Final

import msgspec

from vertebra.bus import Delivery, Request
from vertebra.errors import (
    CodecError,
    CommandRefusedError,
    DecodeError,
    NotConnectedError,
    TransportError,
)
from vertebra.messages import JointCommand, Message
from vertebra.service import MessageReader
from vertebra.yarp import Dialect, Incoming
from vertebra.yarp.objects import JointData, Pair, Vector
from vertebra_yarp import board, mapping, words
from vertebra_yarp.calls import RpcLink
from vertebra_yarp.carried import Kit
from vertebra_yarp.device import ANSWER_S, Device, Handler
from vertebra_yarp.links import Redialled
from vertebra_yarp.routes import ControlBoard, Stream
from vertebra_yarp.streams import InboundStream
from vertebra_yarp.velocity import Runner

log = logging.getLogger(__name__)

ARRIVED_DEG: Final = 0.1
"""A joint that stands this near to its target has arrived, whatever its board says."""
ARRIVED_POLL_S: Final = 0.03
LOOK_AGAIN_S: Final = 1.0
"""Time between two looks for `stateExt:o`, which a robot that is starting opens after `state:o`."""


class PartState(InboundStream):
    """The joint state of a control board: all it measures if it has `stateExt:o`, or positions."""

    def __init__(self, kit: Kit, part: Part) -> None:
        self._part = part
        self._extended = False
        super().__init__(
            kit,
            Stream(yarp=f"{part.name}/state:o", key=f"{part.key}/state", type="JointState"),
        )

    async def _read(self) -> str:
        extended = f"{self._part.name}/stateExt:o"
        self._extended = await self._is_there(extended)
        source = extended if self._extended else f"{self._part.name}/state:o"
        self.route = msgspec.structs.replace(self.route, yarp=source)
        if self._extended:
            return await super()._read()
        reading = asyncio.create_task(super()._read())
        better = asyncio.create_task(self._wait_for(extended))
        try:
            await asyncio.wait([reading, better], return_when=asyncio.FIRST_COMPLETED)
        finally:
            reading.cancel()
            better.cancel()
            await asyncio.wait([reading, better])
        return better.result() if reading.cancelled() else reading.result()

    async def _is_there(self, name: str) -> bool:
        return await self.kit.transport.names.query(name) is not None

    async def _wait_for(self, name: str) -> str:
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            with contextlib.suppress(TransportError):  # who follows the names tells of it
                if await self._is_there(name):
                    return f"{name} has appeared, and tells more"

    def to_message(self, incoming: Incoming) -> Message:
        """Return the joint state; raise `DecodeError`, also before the joints are known."""
        joints, dialect = self._part.joints, incoming.dialect
        if not self._extended:
            names = [joint.name for joint in joints]
            return mapping.to_message(
                incoming.payload, self.route.type, names=names, dialect=dialect
            )
        data = JointData.decode(incoming.payload, dialect)
        try:
            return board.state_of(data, joints)
        except ValueError as error:
            raise DecodeError(
                f"the state of {self.name} does not fit its joints: {error}"
            ) from error


class Part(Device):
    """A control board as a robot part.

    Commands take turns: each is checked, then told to the robot as a whole. A command takes the
    place of an earlier one that is still being waited for.
    """

    kind = "control board"

    def __init__(self, kit: Kit, route: ControlBoard) -> None:
        self.route = route
        self.joints: tuple[board.Joint, ...] = ()
        self._words = words.words_of(Dialect.V3)
        # YARP 4.0 has renamed this port of `controlBoard_nws_yarp`, and no other.
        self._link = RpcLink(kit.transport, f"{route.yarp}/rpc:i", f"{route.yarp}/nws/rpc:i")
        self._stream = Redialled(lambda: self.dial_input(f"{route.yarp}/command:i"))
        self._state: PartState | None = None
        self._turn = asyncio.Lock()
        self._commands = 0
        self._runner = Runner(route.yarp, self._turn, self._say_velocity, self._stop_joints)
        self._lost = f"the robot part {route.yarp} has not been reached yet"
        calls = {
            "limits": self._limits,
            "modes": self._modes,
            "speeds": self._speeds,
            "move": self._move,
            "move_by": self._move_by,
            "velocity": self._velocity,
            "direct": self._direct,
            "stop": self._stop,
        }
        super().__init__(
            kit, route.yarp, route.key, {name: self._reached(calls[name]) for name in calls}
        )

    # --- its life ----------------------------------------------------------------------------

    async def work(self) -> None:
        """Stay connected to the board, and take the commands that stream to `<key>/command`."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.persist(self._connect))
            tasks.create_task(self._take_commands())

    async def _connect(self) -> str:
        try:
            self._words = words.words_of((await self._link.caller()).dialect)
            self.joints = tuple([joint async for joint in self._read_joints()])
            await self._stream.get()
            await self._stop_running()  # whatever it did when it was lost
            if self._state is None:
                self._state = PartState(self.kit, self)
                self._state.start()
            log.info("%s has the joints %s", self.name, ", ".join(j.name for j in self.joints))
            self.connected()
            presence = self.kit.context.bus.declare_presence(f"@vertebra/parts/{self.route.key}")
            try:
                self._lost = await self._link.wait_closed()
            finally:
                presence.close()
        except TransportError as error:
            self._lost = str(error)
            raise
        return self._lost

    async def _read_joints(self) -> Any:
        (count,) = words.numbers_of(await self._ask(self._words.axes()), 1)
        for index in range(round(count)):
            yield board.joint_of(
                index,
                await self._ask(self._words.name(index)),
                await self._ask(self._words.position_limits(index)),
                await self._ask(self._words.velocity_limits(index)),
            )

    async def close(self) -> None:
        """End it; joints that run are stopped first."""
        with contextlib.suppress(TransportError):  # a board that is lost has no ears
            await self._stop_running()
        await super().close()
        if self._state is not None:
            await self._state.close()
        await self._stream.close()
        await self._link.close()

    # --- what it is told ---------------------------------------------------------------------

    def _reached(self, call: Callable[[bytes], Awaitable[dict[str, Any]]]) -> Handler:
        async def answer(request: Request) -> dict[str, Any]:
            if not self.joints:
                raise NotConnectedError(self._lost)
            return await call(request.payload)

        return answer

    async def _limits(self, _: bytes) -> dict[str, Any]:
        await self._link.caller()
        return dict(board.describe(self.joints))

    async def _modes(self, payload: bytes) -> dict[str, Any]:
        command = board.read(payload, board.Modes)
        if command.modes:
            modes = board.check_modes(command, self.joints)
            async with self._taking_over():
                await self._ask(self._words.set_modes(self._indices(command.modes), modes))
        told = [board.mode_name(word) for word in await self._read_modes()]
        names = [joint.name for joint in self.joints]
        return {"modes": dict(zip(names, told, strict=True))}

    async def _speeds(self, payload: bytes) -> dict[str, Any]:
        command = board.read(payload, board.Speeds)
        if command.speeds_deg_s:
            board.check_speeds(command, self.joints)
            await self._set_speeds(command.speeds_deg_s)
        speeds = await self._ask(self._words.speeds())
        return {"speeds_deg_s": self._by_name(words.numbers_of(speeds, len(self.joints)))}

    async def _move(self, payload: bytes) -> dict[str, Any]:
        return await self._carry_out(board.check_move(board.read(payload, board.Move), self.joints))

    async def _move_by(self, payload: bytes) -> dict[str, Any]:
        relative = board.read(payload, board.MoveBy)
        return await self._carry_out(board.absolute(relative, self.joints, await self._positions()))

    async def _velocity(self, payload: bytes) -> dict[str, Any]:
        command = board.check_velocity(board.read(payload, board.Velocity), self.joints)
        await self._run(command)
        return {
            "velocities_deg_s": command.velocities_deg_s,
            "stops_in_s": command.for_s,
            "positions_deg": await self._positions(),
        }

    async def _direct(self, payload: bytes) -> dict[str, Any]:
        command = board.read(payload, board.Direct)
        await self._follow(command)
        return {
            "targets_deg": command.positions_deg,
            "positions_deg": await self._positions(),
        }

    async def _stop(self, _: bytes) -> dict[str, Any]:
        async with self._taking_over():
            await self._ask(self._words.stop_all())
        return {"positions_deg": await self._positions()}

    async def _take_commands(self) -> None:
        """Carry out what streams to `<key>/command`; what is refused is reported and counted."""
        context = self.kit.context
        subscription = context.bus.subscribe(f"{self.route.key}/command", Delivery.latest())
        async for received in MessageReader(subscription, context.codecs, JointCommand):
            try:
                await self._take_command(received.message)
            except (CommandRefusedError, CodecError, TransportError) as error:
                self.refuse(error)
                context.report(f"{self.name} command", "warning", str(error))
            else:
                context.report(f"{self.name} command", "ok")

    async def _take_command(self, message: JointCommand) -> None:
        if not self.joints:
            raise NotConnectedError(self._lost)
        command = board.streamed(message)
        if isinstance(command, board.Velocity):
            await self._run(board.check_velocity(command, self.joints))
        elif isinstance(command, board.Direct):
            await self._follow(command)
        else:
            await self._carry_out(board.check_move(command, self.joints))

    # --- what it tells the robot -------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def _taking_over(self) -> Any:
        """Take the turn: what was commanded before is not waited for and not repeated any more."""
        async with self._turn:
            self._commands += 1
            await self._stop_running()
            yield

    async def _carry_out(self, move: board.Move) -> dict[str, Any]:
        began_s = time.monotonic()
        indices = self._indices(move.positions_deg)
        async with self._taking_over():
            number = self._commands
            await self._need_mode("pos", indices)
            if move.velocity_deg_s is not None:
                await self._set_speeds(dict.fromkeys(move.positions_deg, move.velocity_deg_s))
            targets = [*map(float, move.positions_deg.values())]
            await self._ask(self._words.move(indices, targets))
        reached = move.wait and await self._wait_arrived(number, indices, move.positions_deg)
        return {
            "reached": reached,
            "positions_deg": await self._positions(),
            "targets_deg": move.positions_deg,
            "duration_s": round(time.monotonic() - began_s, 3),
        }

    async def _wait_arrived(
        self, number: int, indices: Sequence[int], targets_deg: dict[str, float]
    ) -> bool:
        """Wait until a move is done; False if a later command has taken its place."""
        seen: dict[str, float] = {}
        while number == self._commands:
            (done,) = words.numbers_of(await self._ask(self._words.arrived(indices)), 1)
            if done:
                return True
            # Some boards never say so, for example the `fakeMotionControl` of YARP 3.12.
            positions = await self._positions()
            before, seen = seen, {name: positions[name] for name in targets_deg}
            near = all(abs(seen[name] - deg) <= ARRIVED_DEG for name, deg in targets_deg.items())
            if near and seen == before:
                return True
            await asyncio.sleep(ARRIVED_POLL_S)
        return False

    async def _run(self, command: board.Velocity) -> None:
        indices = self._indices(command.velocities_deg_s)
        velocities = [*map(float, command.velocities_deg_s.values())]
        async with self._turn:
            self._commands += 1
            if not set(indices) <= set(self._runner.joints):
                await self._need_mode("vel", indices)
            await self._runner.run(indices, velocities, command.for_s)

    async def _follow(self, command: board.Direct) -> None:
        board.check_direct(command, self.joints, await self._positions())
        indices = self._indices(command.positions_deg)
        async with self._taking_over():
            await self._need_mode("posd", indices)
            head = self._words.direct_head(indices)
            await self._stream_command(head, [*command.positions_deg.values()])

    async def _say_velocity(self, joints: Sequence[int], velocities: Sequence[float]) -> None:
        await self._stream_command(self._words.velocity_head(joints), velocities)

    async def _stop_running(self) -> None:
        running = self._runner.joints
        self._runner.forget()
        if running:
            await self._stop_joints(running)

    async def _stop_joints(self, joints: Sequence[int]) -> None:
        await self._ask(self._words.stop(joints))

    async def _stream_command(self, head: words.Request, values: Sequence[float]) -> None:
        sink = await self._stream.get()
        sink.write(Pair(head, Vector.of(values)))

    async def _need_mode(self, mode: str, indices: Sequence[int]) -> None:
        """Set a control mode where it is another one; a moving joint would stop if set again."""
        modes = await self._read_modes()
        others = [index for index in indices if modes[index] != mode]
        if others:
            await self._ask(self._words.set_modes(others, [mode] * len(others)))

    async def _set_speeds(self, speeds: dict[str, float]) -> None:
        for request in self._words.set_speeds(self._indices(speeds), [*speeds.values()]):
            await self._ask(request)

    # --- what it asks the robot --------------------------------------------------------------

    async def _ask(self, request: words.Request) -> list[Any]:
        reply = await self._link.call(request, timeout_s=ANSWER_S)
        return self._words.answer(reply, request)

    async def _positions(self) -> dict[str, float]:
        values = await self._ask(self._words.positions())
        return self._by_name(words.numbers_of(values, len(self.joints)))

    async def _read_modes(self) -> list[str]:
        request = self._words.modes()
        if request is not None:
            return [*map(str, await self._ask(request))]
        state: JointData = await self.glance(
            f"{self.name}/stateExt:o", lambda got: JointData.decode(got.payload, got.dialect)
        )
        return [*map(str, state.control_mode.words)]

    def _indices(self, names: Iterable[str]) -> list[int]:
        return board.indices_of(names, self.joints)

    def _by_name(self, values: Sequence[float]) -> dict[str, float]:
        return board.by_name(self.joints, values)
