"""Actions: work that takes its time, tells how it goes, and can be cancelled.

An action at a key is four keys below it. `goal` takes a goal and answers `{"goal_id": ...}` once
it is accepted. `result` waits for the end of a goal and answers `{"status": ..., "result": ...}`,
with a `reason` if it has failed; it can be asked again. `cancel` tells one goal to end, or all
without a `goal_id`, and answers `{"cancelling": [...]}`. `feedback` streams how the goals go, as
`Native` with `{"goal_id": ..., "feedback": ...}`. ROS 2 actions are seen in the same form.
"""

from __future__ import annotations

import asyncio
import logging
import os
import re
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final, Generic, TypeVar

import msgspec

from vertebra.bus import Bus, Closeable, Reply, Request
from vertebra.errors import (
    BusyError,
    CommandRefusedError,
    DeadlineError,
    DecodeError,
    NotConnectedError,
    RemoteError,
    VertebraError,
)
from vertebra.goals import Ended, Goal, Goals
from vertebra.messages import Native
from vertebra.service.run import Context
from vertebra.service.settings import ServiceSettings

log = logging.getLogger(__name__)

JSON: Final = "application/json"
MAX_ACTIVE: Final = 16
"""So many goals of an action go on at once, unless its service says otherwise."""
ASK_AGAIN_S: Final = 10.0
"""After so long without a result it is asked for again: a service that died does not answer."""
GONE_AFTER_S: Final = 5.0
"""So long a service may be away before its goals are given up."""
LOOK_AGAIN_S: Final = 0.5
_FOR_NOW: Final = {NotConnectedError.__name__, BusyError.__name__}
_GOAL_ID: Final = re.compile(r"[0-9a-f]{32}")

T = TypeVar("T")
S = TypeVar("S", bound=ServiceSettings)
Feedback = Callable[[object], None]
"""Tells how a goal goes, with a Struct or a dict; never waits."""
Run = Callable[[T, Feedback], Awaitable[object]]
"""Does what a goal asks for and returns the result, a Struct or a dict.

It is cancelled when the goal is; what it returns nevertheless is the result of the cancelled goal.
A goal is aborted by the `VertebraError` that it raises.
"""


class Outcome(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How a goal ended.

    Attributes:
        status: Whether it was reached, cancelled or given up.
        result: The fields of the result; empty unless the action says more.
        reason: Why it was aborted, if anybody said so.
    """

    status: Ended
    result: dict[str, Any]
    reason: str = ""


def _accept_all(_: object) -> None:
    """Refuse nothing."""


def serve_action(
    context: Context[S],
    key: str,
    run: Run[T],
    goal_type: type[T],
    *,
    accept: Callable[[T], None] = _accept_all,
    max_active: int = MAX_ACTIVE,
) -> Closeable:
    """Serve an action below `key`; goals that are no `goal_type` are refused.

    `accept` refuses a goal with a `CommandRefusedError`, before anything is done. Each goal is a
    task of the service; closing the action cancels those that go on.
    """
    return _ActionServer(context, key, run, goal_type, accept=accept, max_active=max_active)


def new_goal_id() -> str:
    """Return an identity that no other goal has."""
    return os.urandom(16).hex()


def named_goal(payload: bytes) -> str:
    """Return the goal that a call names; empty if it names none; raise `CommandRefusedError`."""
    document = read_json(payload)
    text = document.get("goal_id", "")
    if text and not (isinstance(text, str) and _GOAL_ID.fullmatch(text)):
        raise CommandRefusedError(f"{text!r} is no goal_id: it is what the call of goal answered")
    return str(text)


def needed_goal(payload: bytes) -> str:
    """Return the goal that a call names; raise `CommandRefusedError`, also if it names none."""
    goal_id = named_goal(payload)
    if not goal_id:
        raise CommandRefusedError(
            'say which goal: {"goal_id": "<the 32 digits that the call of goal has answered>"}'
        )
    return goal_id


def read_json(payload: bytes) -> dict[str, Any]:
    """Return the JSON object of a call, empty for none; raise `CommandRefusedError`."""
    try:
        return msgspec.json.decode(payload, type=dict[str, Any]) if payload else {}
    except msgspec.DecodeError as error:
        raise CommandRefusedError(f"this is no JSON object: {error}") from error


def json_reply(document: object) -> Reply:
    """Return an answer in JSON."""
    return Reply(payload=msgspec.json.encode(document), encoding=JSON)


async def outcome_of(bus: Bus, key: str, goal_id: str) -> Outcome:
    """Wait, however long it takes, for the end of a goal of the action at `key`.

    Raises:
        NotConnectedError: Its service is gone, and did not come back within `GONE_AFTER_S`.
        RemoteError: It does not know this goal, for example because it was restarted.
        DecodeError: Its answer is no outcome.
    """
    named = msgspec.json.encode({"goal_id": goal_id})
    seen_s = time.monotonic()
    while True:
        try:
            reply = await bus.call(f"{key}/result", named, encoding=JSON, timeout_s=ASK_AGAIN_S)
            return msgspec.json.decode(reply.payload, type=Outcome)
        except msgspec.DecodeError as error:
            raise DecodeError(f"{key}/result answered no outcome: {error}") from error
        except DeadlineError:
            seen_s = time.monotonic()
        except (NotConnectedError, RemoteError) as error:
            kind = error.kind if isinstance(error, RemoteError) else type(error).__name__
            if kind == DeadlineError.__name__:
                seen_s = time.monotonic()
            elif kind not in _FOR_NOW or time.monotonic() > seen_s + GONE_AFTER_S:
                raise
            else:
                await asyncio.sleep(LOOK_AGAIN_S)


class _Running(Goal):
    """A goal and who works on it."""

    task: asyncio.Task[None]

    def __init__(self, goal_id: str, accepted_ns: int) -> None:
        super().__init__(goal_id, accepted_ns)
        self.has_ended = asyncio.Event()
        self.outcome: Outcome | None = None


class _ActionServer(Generic[T]):
    """See `serve_action`."""

    def __init__(
        self,
        context: Context[Any],
        key: str,
        run: Run[T],
        goal_type: type[T],
        *,
        accept: Callable[[T], None],
        max_active: int,
    ) -> None:
        self._tasks = context.tasks
        self._key = key
        self._run = run
        self._goal_type = goal_type
        self._accept = accept
        self._max_active = max_active
        self._goals: Goals[_Running] = Goals()
        self._publisher = context.publisher(f"{key}/feedback")
        handlers = {"goal": self._goal, "result": self._result, "cancel": self._cancel}
        self._served = [
            context.bus.serve(f"{key}/{name}", handler) for name, handler in handlers.items()
        ]

    async def _goal(self, request: Request) -> Reply:
        try:
            wanted = msgspec.json.decode(request.payload or b"{}", type=self._goal_type)
        except msgspec.DecodeError as error:
            raise CommandRefusedError(f"this is no goal of {self._key}: {error}") from error
        if len(self._goals.active()) >= self._max_active:
            raise BusyError(self._key, self._max_active)
        self._accept(wanted)
        now_ns = time.time_ns()
        self._goals.forget_old(now_ns)
        goal = _Running(new_goal_id(), now_ns)
        self._goals.add(goal)
        goal.advance("execute", now_ns)
        goal.task = self._tasks.create_task(self._work(goal, wanted), name=f"goal of {self._key}")
        goal.task.add_done_callback(lambda _: self._cut_off(goal))
        return json_reply({"goal_id": goal.id})

    async def _result(self, request: Request) -> Reply:
        goal = self._known(needed_goal(request.payload))
        await goal.has_ended.wait()
        return json_reply(goal.outcome)

    async def _cancel(self, request: Request) -> Reply:
        goal_id = named_goal(request.payload)
        goals = [self._known(goal_id)] if goal_id else self._goals.active()
        if goal_id and goals[0].ended:
            raise CommandRefusedError(f"goal {goal_id} has ended already: {goals[0].state}")
        for goal in goals:
            if goal.cancelable:
                goal.advance("cancel", time.time_ns())
                goal.task.cancel()
        return json_reply({"cancelling": [goal.id for goal in goals]})

    def _known(self, goal_id: str) -> _Running:
        goal = self._goals.get(goal_id)
        if goal is None:
            raise CommandRefusedError(f"{self._key} does not know the goal {goal_id}")
        return goal

    async def _work(self, goal: _Running, wanted: T) -> None:
        def tell(feedback: object) -> None:
            document = {"goal_id": goal.id, "feedback": msgspec.to_builtins(feedback)}
            self._publisher.publish(Native(value=document))

        try:
            result = msgspec.to_builtins(await self._run(wanted, tell))
        except VertebraError as error:
            self._end(goal, "aborted", reason=str(error))
        except Exception as error:  # a bug in one goal must not end the service
            log.exception("a goal of %s failed", self._key)
            self._end(goal, "aborted", reason=f"{type(error).__name__}: {error}")
        else:
            if goal.task.cancelling():
                self._cut_off(goal, result)
            else:
                self._end(goal, "succeeded", result)

    def _cut_off(self, goal: _Running, result: Any = None) -> None:
        """End a goal whose task was cancelled, perhaps before its first step."""
        if goal.state == "canceling":
            self._end(goal, "canceled", result)
        elif not goal.ended:
            self._end(goal, "aborted", result, reason="its service stops")

    def _end(self, goal: _Running, state: Ended, result: Any = None, reason: str = "") -> None:
        goal.outcome = Outcome(status=state, result={} if result is None else result, reason=reason)
        goal.end(state, time.time_ns())
        goal.has_ended.set()

    def close(self) -> None:
        """End it, and the goals that go on."""
        for served in self._served:
            served.close()
        for goal in self._goals.active():
            goal.task.cancel()
        self._publisher.close()
