"""A control board as a robot part: joint state, limits, moves, stop."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.errors import NotConnectedError, TransportError
from vertebra.messages import Message
from vertebra.yarp import Incoming, Value
from vertebra_yarp import board, mapping
from vertebra_yarp.calls import JSON, RpcLink
from vertebra_yarp.carried import Carried, Kit
from vertebra_yarp.routes import ControlBoard, Stream
from vertebra_yarp.streams import InboundStream

log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S: Final = 5.0
ARRIVED_POLL_S: Final = 0.03


class PartState(InboundStream):
    """The positions of a control board."""

    def __init__(self, kit: Kit, part: Part) -> None:
        self._part = part
        route = part.route
        super().__init__(
            kit,
            Stream(yarp=f"{route.yarp}/state:o", key=f"{route.key}/state", type="JointState"),
        )

    def to_message(self, incoming: Incoming) -> Message:
        """Return the joint state; raise `DecodeError`, also before the joints are known."""
        names = [joint.name for joint in self._part.joints]
        return mapping.to_message(incoming.payload, self.route.type, names=names)


class Part(Carried):
    """A control board as a robot part: joint state, limits, moves, stop."""

    def __init__(self, kit: Kit, route: ControlBoard) -> None:
        super().__init__(kit, route.yarp)
        self.route = route
        self.joints: tuple[board.Joint, ...] = ()
        self._link = RpcLink(kit.transport, f"{route.yarp}/rpc:i")
        self._state: PartState | None = None
        self._moves = 0
        self._lost = f"the robot part {route.yarp} has not been reached yet"
        serve_at = kit.context.bus.serve
        self._served = [
            serve_at(f"{route.key}/limits", self._limits),
            serve_at(f"{route.key}/move", self._move),
            serve_at(f"{route.key}/stop", self._stop),
        ]

    async def work(self) -> None:
        """Stay connected to the board."""
        await self.persist(self._connect)

    async def _connect(self) -> str:
        try:
            (count,) = board.numbers_of(await self._ask(board.AXES), 1)
            joints = []
            for index in range(round(count)):
                answers = [await self._ask(request) for request in board.joint_requests(index)]
                joints.append(board.joint_of(index, *answers))
            self.joints = tuple(joints)
            if self._state is None:
                self._state = PartState(self.kit, self)
                self._state.start()
            log.info("%s has the joints %s", self.name, ", ".join(j.name for j in joints))
            self.kit.context.report(self.name, "ok")
            presence = self.kit.context.bus.declare_presence(f"@vertebra/parts/{self.route.key}")
            try:
                self._lost = await self._link.wait_closed()
            finally:
                presence.close()
        except TransportError as error:
            self._lost = str(error)
            raise
        return self._lost

    async def _ask(self, request: list[Value], timeout_s: float = CONNECT_TIMEOUT_S) -> list[Value]:
        reply = await self._link.call(request, timeout_s=timeout_s)
        return board.answer_of(reply, request)

    def _check_reached(self) -> None:
        if not self.joints:
            raise NotConnectedError(self._lost)

    async def _positions(self) -> dict[str, float]:
        values = await self._ask(board.ENCODERS)
        return board.positions_of(self.joints, board.numbers_of(values, len(self.joints)))

    async def _limits(self, _: Request) -> Reply:
        await self._link.caller()
        self._check_reached()
        return _json_reply(board.describe(self.joints))

    async def _move(self, request: Request) -> Reply:
        self._check_reached()
        move = board.read_move(request.payload, self.joints)
        self._moves += 1
        number = self._moves
        began_s = time.monotonic()
        modes = await self._ask(board.MODES)
        for command in board.move_requests(move, self.joints, modes):
            await self._ask(command)
        reached = False
        # A later move takes this one's place; what it reached then is where it is now.
        while move.wait and not reached and number == self._moves:
            (done,) = board.numbers_of(await self._ask(board.MOTION_DONE), 1)
            reached = bool(done)
            if not reached:
                await asyncio.sleep(ARRIVED_POLL_S)
        return _json_reply(
            {
                "reached": reached,
                "positions_deg": await self._positions(),
                "targets_deg": move.positions_deg,
                "duration_s": round(time.monotonic() - began_s, 3),
            }
        )

    async def _stop(self, _: Request) -> Reply:
        self._check_reached()
        self._moves += 1
        await self._ask(board.STOP)
        return _json_reply({"positions_deg": await self._positions()})

    async def close(self) -> None:
        """End it."""
        for served in self._served:
            served.close()
        await super().close()
        if self._state is not None:
            await self._state.close()
        await self._link.close()


def _json_reply(document: object) -> Reply:
    return Reply(payload=msgspec.json.encode(document), encoding=JSON)
