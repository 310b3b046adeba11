"""Actions: a ROS action as three calls and a stream.

An action is three services and two topics of its server. Its goals have identities of 16 bytes,
which are hexadecimal text on the backbone.
"""

from __future__ import annotations

import json
import os
import re
from typing import Any, Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.errors import CommandRefusedError
from vertebra_ros2.carried import Kit
from vertebra_ros2.routes import Action, Topic
from vertebra_ros2.services import JSON, Clients
from vertebra_ros2.topics import InboundTopic

STATUSES: Final = (
    "unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted",
)  # fmt: skip
"""`GoalStatus`, in words."""
CANCEL_REFUSALS: Final = {
    1: "the action server refuses to cancel",
    2: "the action server does not know this goal",
    3: "this goal has ended already",
}
_GOAL_ID: Final = re.compile(r"[0-9a-f]{32}")


class InboundAction:
    """A ROS action: the calls `goal`, `result`, `cancel` and the stream `feedback` below a key."""

    def __init__(self, kit: Kit, route: Action, clients: Clients) -> None:
        self._kit = kit
        self._route = route
        self._clients = clients
        feedback = Topic(ros=f"{route.ros}/_action/feedback", key=f"{route.key}/feedback")
        self._feedback = InboundTopic(kit, feedback)
        serve_at = kit.context.bus.serve
        self._served = [
            serve_at(f"{route.key}/goal", self._goal),
            serve_at(f"{route.key}/result", self._result),
            serve_at(f"{route.key}/cancel", self._cancel),
        ]

    def look(self) -> None:
        """Read the feedback if it is wanted; tell when the action cannot be called."""
        self._feedback.look()
        offered = self._kit.transport.graph.service(f"{self._route.ros}/_action/send_goal")
        problem = "nobody offers it" if offered is None else offered.problem
        self._kit.report(f"action {self._route.ros}", problem)

    async def _goal(self, request: Request) -> Reply:
        """Send a goal with the fields in JSON; answer `{"goal_id": ...}` once it is accepted."""
        goal_id = os.urandom(16)
        document = {"goal_id": {"uuid": list(goal_id)}, "goal": _document(request)}
        answer = await self._ask("send_goal", document, request)
        if not answer["accepted"]:
            raise CommandRefusedError(f"the action server of {self._route.ros} refuses this goal")
        return _reply({"goal_id": goal_id.hex()})

    async def _result(self, request: Request) -> Reply:
        """Wait for the end of the goal `{"goal_id": ...}`; answer its status and result."""
        answer = await self._ask("get_result", {"goal_id": _goal_id(request)}, request)
        status = answer["status"]
        word = STATUSES[status] if 0 <= status < len(STATUSES) else str(status)
        return _reply({"status": word, "result": answer["result"]})

    async def _cancel(self, request: Request) -> Reply:
        """Cancel the goal `{"goal_id": ...}`; answer which goals are being cancelled."""
        document = {"goal_info": {"goal_id": _goal_id(request)}}
        answer = await self._ask("cancel_goal", document, request)
        if answer["return_code"]:
            code = answer["return_code"]
            raise CommandRefusedError(CANCEL_REFUSALS.get(code, f"cancelling failed: {code}"))
        goals = [bytes(goal["goal_id"]["uuid"]).hex() for goal in answer["goals_canceling"]]
        return _reply({"cancelling": goals})

    async def _ask(self, part: str, document: dict[str, Any], request: Request) -> Any:
        name = f"{self._route.ros}/_action/{part}"
        asked = Request(
            key=request.key,
            payload=msgspec.json.encode(document),
            encoding=JSON,
            timeout_s=request.timeout_s,
        )
        return json.loads((await self._clients.call(name, "", asked)).payload)

    async def close(self) -> None:
        """End it."""
        for served in self._served:
            served.close()
        await self._feedback.close()
        self._kit.report(f"action {self._route.ros}", "")


def _document(request: Request) -> Any:
    try:
        return msgspec.json.decode(request.payload) if request.payload else {}
    except msgspec.DecodeError as error:
        raise CommandRefusedError(f"this is no JSON: {error}") from error


def _goal_id(request: Request) -> dict[str, list[int]]:
    document = _document(request)
    text = document.get("goal_id") if isinstance(document, dict) else None
    if not isinstance(text, str) or not _GOAL_ID.fullmatch(text):
        raise CommandRefusedError(
            'say which goal: {"goal_id": "<the 32 digits that the call of goal has answered>"}'
        )
    return {"uuid": list(bytes.fromhex(text))}


def _reply(document: dict[str, Any]) -> Reply:
    return Reply(payload=msgspec.json.encode(document), encoding=JSON)
