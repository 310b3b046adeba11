"""`vertebra ros2 send_goal`: a goal from its acceptance to its end, or to Ctrl-C."""

from __future__ import annotations

import asyncio
import os
from collections import deque
from typing import Any, Final

from vertebra.cli.ros2_session import Session, text_of
from vertebra.errors import CodecError, CommandRefusedError, DeadlineError, NotConnectedError
from vertebra.ros2.actions import (
    CANCEL_REFUSALS,
    CANCEL_TYPE,
    Part,
    goal_id_of,
    part_of,
    state_of,
    uuid_of,
)
from vertebra.ros2.names import check_name
from vertebra.ros2.qos import DEPTH, for_reader

ACCEPT_WITHIN_S: Final = 10.0
ASK_AGAIN_S: Final = 5.0
"""After so long without a result it is asked for again: its server may be gone by now."""
STOP_WITHIN_S: Final = 5.0


async def send_goal(session: Session) -> int:
    """Print the feedback and the end of a goal; it is cancelled with this program."""
    goal = _Goal(session, check_name(session.arguments.name))
    await goal.send(session.arguments.fields)
    timeout_s: float | None = session.arguments.timeout
    try:
        async with asyncio.timeout(timeout_s):
            return await goal.follow()
    except TimeoutError as error:
        await goal.cancel()
        raise DeadlineError(
            f"the goal {goal.id}, which is cancelled now", timeout_s or 0
        ) from error
    except asyncio.CancelledError:
        await goal.cancel()
        return 0


class _Goal:
    def __init__(self, session: Session, action: str) -> None:
        self.id = os.urandom(16).hex()
        self._session = session
        self._action = action
        self._type = ""
        self._is_accepted = False
        self._early: deque[str] = deque(maxlen=DEPTH)

    async def send(self, fields: dict[str, Any]) -> None:
        """Send it and print that it is accepted; its feedback is printed from now on."""
        session, request = self._session, {"goal_id": uuid_of(self.id), "goal": fields}
        sending = part_of(self._action, "send_goal")
        self._type = (await session.type_of(sending)).removesuffix("_SendGoal")
        self._read_feedback()
        try:
            answer = await self._call("send_goal", request, ACCEPT_WITHIN_S)
        except (DeadlineError, asyncio.CancelledError):
            await self.cancel()  # it may have been accepted nevertheless
            raise
        if not answer["accepted"]:
            raise CommandRefusedError(f"the action server of {self._action} refuses this goal")
        print(f"accepted: {self.id}", *self._early, sep="\n", flush=True)
        self._is_accepted = True

    def _read_feedback(self) -> None:
        session, name = self._session, part_of(self._action, "feedback")
        kind = f"{self._type}_FeedbackMessage"
        qos = for_reader((one.qos for one in session.transport.graph.writers(name)), DEPTH)

        def came(payload: bytes, _: int) -> None:
            try:
                record = session.cdr.decode(payload, kind)
                if goal_id_of(record["goal_id"]) != self.id:
                    return
                text = f"---\n{text_of(record['feedback'])}"
            except CodecError as error:
                text = f"--- {error}"
            if self._is_accepted:
                print(text, flush=True)
            else:  # it may overtake the answer that the goal is accepted
                self._early.append(text)

        session.transport.reader(name, kind, qos, came)

    async def follow(self) -> int:
        """Print how it ended; return the exit status."""
        while True:
            try:
                answer = await self._call("get_result", {"goal_id": uuid_of(self.id)}, ASK_AGAIN_S)
            except DeadlineError:
                continue
            status = state_of(answer["status"])
            if status == "unknown":
                raise NotConnectedError(
                    f"the action server of {self._action} does not know the goal any more; it was "
                    "restarted"
                )
            print(f"---\n{text_of({'status': status, 'result': answer['result']})}", flush=True)
            return 0 if status == "succeeded" else 1

    async def cancel(self) -> None:
        """Tell it to end, and print what became of that."""
        request = {"goal_info": {"goal_id": uuid_of(self.id)}}
        answer = await self._call("cancel_goal", request, STOP_WITHIN_S)
        print(CANCEL_REFUSALS.get(answer["return_code"], f"cancelled: {self.id}"), flush=True)

    async def _call(self, part: Part, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        kinds = {"send_goal": f"{self._type}_SendGoal", "get_result": f"{self._type}_GetResult"}
        return await self._session.call(
            part_of(self._action, part),
            request,
            timeout_s=timeout_s,
            type_name=kinds.get(part, CANCEL_TYPE),
        )
