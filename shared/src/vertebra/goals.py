"""Goals of actions: the states that ROS 2 gives them, and a bounded book of them; no I/O."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Generic, Literal, TypeVar

State = Literal["accepted", "executing", "canceling", "succeeded", "canceled", "aborted"]
Ended = Literal["succeeded", "canceled", "aborted"]
Event = Literal["execute", "cancel", "succeed", "abort", "canceled"]
"""What happens to a goal; `cancel` begins what `canceled` ends."""

KEEP_ENDED_NS: Final = 900 * 10**9
"""So long the result of a goal can be asked for, as rclpy's action servers keep it."""
MAX_ENDED: Final = 256
"""So many results are kept at most."""

_ENDING: Final[dict[State, Event]] = {
    "succeeded": "succeed",
    "canceled": "canceled",
    "aborted": "abort",
}
_NEXT: Final[dict[tuple[State, Event], State]] = {
    ("accepted", "execute"): "executing",
    ("accepted", "cancel"): "canceling",
    ("executing", "cancel"): "canceling",
    ("executing", "succeed"): "succeeded",
    ("executing", "abort"): "aborted",
    ("canceling", "succeed"): "succeeded",
    ("canceling", "abort"): "aborted",
    ("canceling", "canceled"): "canceled",
}
"""The state machine of rcl_action; all else cannot happen."""


class Goal:
    """A goal that was accepted.

    Attributes:
        id: Its identity, 32 hexadecimal digits.
        accepted_ns: When it was accepted (UTC).
        state: What it is doing now.
        ended_ns: When it ended; 0 before.
    """

    def __init__(self, goal_id: str, accepted_ns: int) -> None:
        self.id = goal_id
        self.accepted_ns = accepted_ns
        self.state: State = "accepted"
        self.ended_ns = 0

    @property
    def ended(self) -> bool:
        """Whether nothing happens to it any more."""
        return self.state in _ENDING

    @property
    def cancelable(self) -> bool:
        """Whether it can still be told to end."""
        return (self.state, "cancel") in _NEXT

    def advance(self, event: Event, now_ns: int) -> None:
        """Let something happen to it; raise `ValueError` if that cannot happen in its state."""
        following = _NEXT.get((self.state, event))
        if following is None:
            raise ValueError(f"goal {self.id}: {event!r} cannot happen when {self.state}")
        self.state = following
        if self.ended:
            self.ended_ns = now_ns

    def end(self, state: Ended, now_ns: int) -> None:
        """Let it end, whatever has to happen before; raise `ValueError` if it has ended."""
        if state == "canceled" and self.cancelable:
            self.advance("cancel", now_ns)
        elif self.state == "accepted":
            self.advance("execute", now_ns)
        self.advance(_ENDING[state], now_ns)


G = TypeVar("G", bound=Goal)


class Goals(Generic[G]):
    """The goals of one action: those that go on, and those whose result may still be asked for."""

    def __init__(self) -> None:
        self._goals: dict[str, G] = {}

    def __iter__(self) -> Iterator[G]:
        return iter(self._goals.values())

    def __contains__(self, goal_id: object) -> bool:
        return goal_id in self._goals

    def add(self, goal: G) -> None:
        """Note a new goal, whose identity no other has."""
        self._goals[goal.id] = goal

    def get(self, goal_id: str) -> G | None:
        """Return a goal; None if it is not known, or not any more."""
        return self._goals.get(goal_id)

    def active(self) -> list[G]:
        """Return the goals that have not ended, oldest first."""
        return [goal for goal in self if not goal.ended]

    def cancelable(self, until_ns: int | None = None, goal_id: str = "") -> list[G]:
        """Return what can be cancelled of all goals accepted until then, and of the one named."""
        return [
            goal
            for goal in self
            if goal.cancelable
            and (until_ns is None or goal.accepted_ns <= until_ns or goal.id == goal_id)
        ]

    def forget_old(self, now_ns: int) -> None:
        """Forget those that ended too long ago, and the oldest of too many that ended."""
        ended = sorted((goal for goal in self if goal.ended), key=lambda goal: goal.ended_ns)
        too_many = len(ended) - MAX_ENDED
        for place, goal in enumerate(ended):
            if place < too_many or now_ns - goal.ended_ns > KEEP_ENDED_NS:
                del self._goals[goal.id]
