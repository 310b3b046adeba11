"""Actions of ROS nodes on the backbone: three calls and a stream, as `vertebra.service` has them.

Every goal that we send is followed to its end, because ROS nodes forget results soon. A goal whose
acceptance nobody heard of is withdrawn: nothing shall move of which its caller was told otherwise.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Mapping
from typing import Any, Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.errors import (
    CommandRefusedError,
    DeadlineError,
    NotConnectedError,
    TransportError,
    VertebraError,
)
from vertebra.goals import MAX_ENDED
from vertebra.messages import Message, Native
from vertebra.ros2.actions import (
    CANCEL_REFUSALS,
    NO_GOAL,
    Part,
    goal_id_of,
    part_of,
    state_of,
    uuid_of,
)
from vertebra.ros2.mapping import Record
from vertebra.service.actions import (
    JSON,
    json_reply,
    named_goal,
    needed_goal,
    new_goal_id,
    read_json,
)
from vertebra_ros2.carried import Kit
from vertebra_ros2.routes import Action, Topic
from vertebra_ros2.services import Clients
from vertebra_ros2.topics import InboundTopic

log = logging.getLogger(__name__)

ASK_AGAIN_S: Final = 10.0
"""After so long without a result it is asked for again: its server may be another one by now."""
GONE_AFTER_S: Final = 10.0
"""So long a server may be away, and its goals are still waited for."""
LOOK_AGAIN_S: Final = 1.0
WITHDRAW_WITHIN_S: Final = 5.0
STOP_WITHIN_S: Final = 1.0


class InboundAction:
    """A ROS action: the calls `goal`, `result`, `cancel` and the stream `feedback` below a key."""

    def __init__(self, kit: Kit, route: Action, clients: Clients) -> None:
        self._kit = kit
        self._route = route
        self._clients = clients
        self._outcomes: dict[str, asyncio.Task[dict[str, Any] | VertebraError]] = {}
        self._unsure: set[str] = set()
        self._withdrawals: set[asyncio.Task[None]] = set()
        self._feedback = _Feedback(kit, route)
        handlers = {"goal": self._goal, "result": self._result, "cancel": self._cancel}
        self._served = [
            kit.context.bus.serve(f"{route.key}/{name}", handler)
            for name, handler in handlers.items()
        ]

    def look(self) -> None:
        """Read the feedback if it is wanted; tell when the action cannot be called."""
        self._feedback.look()
        offered = self._kit.transport.graph.service(part_of(self._route.ros, "send_goal"))
        problem = "nobody offers it" if offered is None else offered.problem
        self._kit.report(f"action {self._route.ros}", problem)

    async def _goal(self, request: Request) -> Reply:
        """Send a goal with the fields in JSON; answer `{"goal_id": ...}` once it is accepted."""
        goal_id = new_goal_id()
        document = {"goal_id": uuid_of(goal_id), "goal": read_json(request.payload)}
        self._unsure.add(goal_id)
        try:
            answer = await self._ask("send_goal", document, request.timeout_s)
        except (DeadlineError, asyncio.CancelledError):
            if goal_id in self._unsure:
                self._withdraw_later(goal_id)
            raise
        finally:
            self._unsure.discard(goal_id)
        if not answer["accepted"]:
            raise CommandRefusedError(f"the action server of {self._route.ros} refuses this goal")
        self._follow(goal_id)
        return json_reply({"goal_id": goal_id})

    async def _result(self, request: Request) -> Reply:
        """Wait for the end of the goal `{"goal_id": ...}`; answer its status and result."""
        goal_id = needed_goal(request.payload)
        following = self._outcomes.get(goal_id)
        if following is None:  # not ours, or from before a restart of this service
            return json_reply(await self._ask_result(goal_id, request.timeout_s))
        outcome = await asyncio.shield(following)
        if isinstance(outcome, VertebraError):
            raise outcome
        return json_reply(outcome)

    async def _cancel(self, request: Request) -> Reply:
        """Cancel the goal `{"goal_id": ...}`, or all; answer which goals are being cancelled."""
        goal_id = named_goal(request.payload)
        return json_reply({"cancelling": await self._ask_cancel(goal_id, request.timeout_s)})

    def _follow(self, goal_id: str) -> None:
        """Wait for the end of a goal of ours, and keep its result."""
        ended = [one for one, task in self._outcomes.items() if task.done()]
        for oldest in ended[: max(len(ended) - MAX_ENDED, 0)]:
            del self._outcomes[oldest]
        self._outcomes[goal_id] = self._kit.context.tasks.create_task(
            self._outcome(goal_id), name=f"a goal of {self._route.ros}"
        )

    async def _outcome(self, goal_id: str) -> dict[str, Any] | VertebraError:
        seen_s = time.monotonic()
        while True:
            try:
                return await self._ask_result(goal_id, ASK_AGAIN_S)
            except DeadlineError:
                seen_s = time.monotonic()
            except NotConnectedError as error:
                if time.monotonic() > seen_s + GONE_AFTER_S:
                    return NotConnectedError(
                        f"the action server of {self._route.ros} went away with this goal: {error}"
                    )
                await asyncio.sleep(LOOK_AGAIN_S)
            except VertebraError as error:
                return error

    async def _ask_result(self, goal_id: str, timeout_s: float) -> dict[str, Any]:
        answer = await self._ask("get_result", {"goal_id": uuid_of(goal_id)}, timeout_s)
        status = state_of(answer["status"])
        if status == "unknown":
            raise CommandRefusedError(
                f"the action server of {self._route.ros} does not know the goal {goal_id}; if it "
                "was restarted, its goals are lost"
            )
        return {"status": status, "result": answer["result"]}

    async def _ask_cancel(self, goal_id: str, timeout_s: float) -> list[str]:
        document = {"goal_info": {"goal_id": uuid_of(goal_id or NO_GOAL)}}
        answer = await self._ask("cancel_goal", document, timeout_s)
        code = answer["return_code"]
        if code:
            raise CommandRefusedError(CANCEL_REFUSALS.get(code, f"cancelling failed: {code}"))
        return [goal_id_of(goal["goal_id"]) for goal in answer["goals_canceling"]]

    def _withdraw_later(self, goal_id: str) -> None:
        withdrawing = self._withdraw(goal_id, WITHDRAW_WITHIN_S)
        task = self._kit.context.tasks.create_task(withdrawing)
        self._withdrawals.add(task)
        task.add_done_callback(self._withdrawals.discard)

    async def _withdraw(self, goal_id: str, timeout_s: float) -> None:
        try:
            cancelled = await self._ask_cancel(goal_id, timeout_s)
        except (TransportError, CommandRefusedError) as error:
            log.info("%s: withdrawing %s: %s", self._route.ros, goal_id, error)
        else:
            log.warning("%s: withdrew %s", self._route.ros, ", ".join(cancelled))

    async def _ask(self, part: Part, document: Mapping[str, Any], timeout_s: float) -> Any:
        name = part_of(self._route.ros, part)
        payload = msgspec.json.encode(document)
        asked = Request(key=self._route.key, payload=payload, encoding=JSON, timeout_s=timeout_s)
        return json.loads((await self._clients.call(name, "", asked)).payload)

    async def close(self) -> None:
        """End it; goals go on, but for those of whose acceptance nobody has heard."""
        unsure = tuple(self._unsure)
        self._unsure.clear()
        for served in self._served:
            served.close()
        for task in (*self._outcomes.values(), *self._withdrawals):
            task.cancel()
        await asyncio.gather(*(self._withdraw(goal_id, STOP_WITHIN_S) for goal_id in unsure))
        await self._feedback.close()
        self._kit.report(f"action {self._route.ros}", "")


class _Feedback(InboundTopic):
    """The feedback of all goals of an action."""

    def __init__(self, kit: Kit, action: Action) -> None:
        name = part_of(action.ros, "feedback")
        super().__init__(kit, Topic(ros=name, key=f"{action.key}/feedback"))

    def to_message(self, record: Record, type_name: str) -> Message:
        """Return the feedback with the identity of its goal as calls have it."""
        del type_name
        goal_id = goal_id_of(record["goal_id"])
        return Native(value={"goal_id": goal_id, "feedback": record["feedback"]})
