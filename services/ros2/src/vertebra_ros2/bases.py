"""Mobile bases: driven by calls, stopped by one that beats everything."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final

import msgspec

from vertebra.bus import Closeable, Reply, Request
from vertebra.errors import CommandRefusedError, NotConnectedError, TransportError
from vertebra.messages import Twist
from vertebra.ros2 import mapping
from vertebra.ros2.actions import CANCEL_REFUSALS, CANCEL_TYPE, goal_id_of, part_of
from vertebra.ros2.qos import Qos
from vertebra_ros2.carried import Kit
from vertebra_ros2.drive import Drive, Runner, limits_of, read
from vertebra_ros2.routes import Base
from vertebra_ros2.services import JSON, Clients

CANCEL_WITHIN_S: Final = 1.0
"""So long an action may take to say that it cancels; meanwhile zero velocity overrules it."""
STOPPED_WITHIN_S: Final = 0.5
"""So long we wait at our end until the base knows that it shall stand."""
_NEWEST: Final = Qos(depth=1)  # and never latched: who comes late must not drive


class DrivenBase:
    """A base that takes velocities on a topic: the calls `drive`, `stop` and `limits`."""

    def __init__(self, kit: Kit, route: Base, clients: Clients) -> None:
        self._kit = kit
        self._route = route
        self._clients = clients
        self._stops = 0
        self._lost = "not looked for yet"
        self._presence: Closeable | None = None
        self._writer = kit.transport.writer(route.ros, route.type, _NEWEST)
        self._runner = Runner(route.key, self._say)
        calls = {"drive": self._drive, "stop": self._stop, "limits": self._limits}
        serve_at = kit.context.bus.serve
        self._served = [serve_at(f"{route.key}/{name}", _json(calls[name])) for name in calls]

    def look(self) -> None:
        """Tell whether the base is there; one that goes away is not driven when it comes back."""
        readers = self._kit.transport.graph.readers(self._route.ros)
        self._lost = "" if readers else f"nobody subscribes to {self._route.ros}; start the base"
        self._lost = self._lost or self._kit.clash(readers, self._route.type)
        problem = self._lost
        if not problem and self._writer.mismatch:
            problem = f"a subscriber does not hear us: its {self._writer.mismatch} differs"
        self._kit.report(f"base {self._route.key}", problem)
        if self._lost and self._presence is not None:
            self._runner.halt()
            self._presence.close()
            self._presence = None
        elif not self._lost and self._presence is None:
            token = f"@vertebra/parts/{self._route.key}"
            self._presence = self._kit.context.bus.declare_presence(token)

    def _say(self, drive: Drive) -> None:
        angular_rad_s = math.radians(drive.angular_deg_s)
        twist = Twist(
            linear_m_s=(drive.linear_m_s, 0.0, 0.0), angular_rad_s=(0.0, 0.0, angular_rad_s)
        )
        record = mapping.to_record(twist, self._route.type, time.time_ns())
        self._writer.write(self._kit.cdr.encode(record, self._route.type))

    async def _drive(self, request: Request) -> dict[str, Any]:
        drive = read(request.payload, self._route)
        self._need_base()
        if self._stops:
            raise CommandRefusedError("the base is being stopped; drive when stop has answered")
        self._runner.run(drive)
        return {
            "linear_m_s": drive.linear_m_s,
            "angular_deg_s": drive.angular_deg_s,
            "stops_in_s": drive.for_s,
        }

    async def _stop(self, _: Request) -> dict[str, Any]:
        """Stand still, and cancel what drives the base by itself.

        Zero is repeated for a while, also when this is over: what has not been cancelled yet
        would drive on.
        """
        self._runner.run(Drive(for_s=CANCEL_WITHIN_S))
        self._stops += 1
        try:
            cancelled = await asyncio.gather(*map(self._cancel, self._route.actions))
        finally:
            self._stops -= 1
        self._need_base()
        return {"cancelling": [goal for goals in cancelled for goal in goals]}

    async def _cancel(self, action: str) -> list[str]:
        """Cancel all goals of an action; return which. One that nobody offers has none."""
        name = part_of(action, "cancel_goal")
        if self._kit.transport.graph.service(name) is None:
            return []
        everything = Request(key="", payload=b"", encoding=JSON, timeout_s=CANCEL_WITHIN_S)
        try:
            reply = await self._clients.call(name, CANCEL_TYPE, everything)
        except TransportError as error:
            raise NotConnectedError(f"the base was told to stand, but {error}") from error
        answer = json.loads(reply.payload)
        goals = [goal_id_of(goal["goal_id"]) for goal in answer["goals_canceling"]]
        if answer["return_code"] and not goals:
            code = answer["return_code"]
            problem = CANCEL_REFUSALS.get(code, f"cancelling failed: {code}")
            raise CommandRefusedError(f"the base was told to stand, but of {action}: {problem}")
        return goals

    async def _limits(self, _: Request) -> dict[str, Any]:
        self._need_base()
        return limits_of(self._route)

    def _need_base(self) -> None:
        if self._lost:
            raise NotConnectedError(f"the base {self._route.key} is not there: {self._lost}")

    async def close(self) -> None:
        """End it; a base that is being driven is stopped first."""
        for served in self._served:
            served.close()
        with contextlib.suppress(TransportError):  # a base that is lost has no ears
            if self._runner.halt():
                await self._writer.delivered(STOPPED_WITHIN_S)
        if self._presence is not None:
            self._presence.close()
        self._writer.close()
        self._kit.report(f"base {self._route.key}", "")


def _json(
    call: Callable[[Request], Awaitable[dict[str, Any]]],
) -> Callable[[Request], Awaitable[Reply]]:
    async def answer(request: Request) -> Reply:
        return Reply(payload=msgspec.json.encode(await call(request)), encoding=JSON)

    return answer
