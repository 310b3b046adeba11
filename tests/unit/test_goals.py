"""The goals of an action: which state follows which, and which are kept."""

from __future__ import annotations

from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.goals import KEEP_ENDED_NS, MAX_ENDED, Ended, Event, Goal, Goals

EVENTS: tuple[Event, ...] = get_args(Event)
ENDED: tuple[Ended, ...] = get_args(Ended)


@pytest.mark.parametrize(
    ("events", "state"),
    [
        (["execute", "succeed"], "succeeded"),
        (["execute", "abort"], "aborted"),
        (["execute", "cancel", "canceled"], "canceled"),
        (["execute", "cancel", "succeed"], "succeeded"),
        (["execute", "cancel", "abort"], "aborted"),
        (["cancel", "canceled"], "canceled"),
    ],
)
def test_goal_goes_its_way(events: list[Event], state: str) -> None:
    goal = Goal("1", 5)
    assert goal.state == "accepted"
    for event in events:
        assert not goal.ended
        goal.advance(event, 7)
    assert (goal.state, goal.ended, goal.ended_ns) == (state, True, 7)


@pytest.mark.parametrize(
    ("events", "impossible"),
    [
        ([], "succeed"),
        ([], "canceled"),
        (["execute"], "execute"),
        (["execute"], "canceled"),
        (["cancel"], "execute"),
        (["cancel"], "cancel"),
    ],
)
def test_what_cannot_happen_changes_nothing(events: list[Event], impossible: Event) -> None:
    goal = Goal("1", 0)
    for event in events:
        goal.advance(event, 1)
    before = goal.state
    with pytest.raises(ValueError, match=f"'{impossible}' cannot happen when {before}"):
        goal.advance(impossible, 2)
    assert goal.state == before


@given(st.lists(st.sampled_from(EVENTS), max_size=12))
def test_ended_goal_stays_as_it_is(events: list[Event]) -> None:
    goal = Goal("1", 0)
    for number, event in enumerate(events, 1):
        before, ended_ns = goal.state, goal.ended_ns
        try:
            goal.advance(event, number)
        except ValueError:
            assert goal.state == before
        else:
            assert before not in ENDED
        if before in ENDED:
            assert (goal.state, goal.ended_ns) == (before, ended_ns)
        assert goal.ended == (goal.state in ENDED) == bool(goal.ended_ns)


@given(st.lists(st.sampled_from(EVENTS), max_size=4), st.sampled_from(ENDED))
def test_goal_can_end_whatever_it_is_doing(events: list[Event], state: Ended) -> None:
    goal = Goal("1", 0)
    for event in events:
        try:
            goal.advance(event, 1)
        except ValueError:
            continue
    if goal.ended:
        with pytest.raises(ValueError, match="cannot happen"):
            goal.end(state, 2)
    else:
        goal.end(state, 2)
        assert (goal.state, goal.ended_ns) == (state, 2)


def running(*ids: str) -> Goals[Goal]:
    """Return goals, the n-th of which was accepted at n."""
    goals: Goals[Goal] = Goals()
    for accepted_ns, goal_id in enumerate(ids, 1):
        goal = Goal(goal_id, accepted_ns)
        goal.advance("execute", accepted_ns)
        goals.add(goal)
    return goals


def test_which_goals_can_be_cancelled() -> None:
    goals = running("a", "b", "c", "d")
    known = goals.get("b")
    assert known is not None
    known.advance("cancel", 5)

    def names(found: list[Goal]) -> list[str]:
        return [goal.id for goal in found]

    assert names(goals.cancelable()) == ["a", "c", "d"]
    assert names(goals.cancelable(until_ns=3)) == ["a", "c"]
    assert names(goals.cancelable(until_ns=1, goal_id="d")) == ["a", "d"]
    assert names(goals.active()) == ["a", "b", "c", "d"]


def test_goals_that_ended_are_kept_for_a_time() -> None:
    goals = running("a", "b")
    ended = goals.get("a")
    assert ended is not None
    ended.advance("succeed", 10)
    goals.forget_old(10 + KEEP_ENDED_NS)
    assert "a" in goals
    goals.forget_old(11 + KEEP_ENDED_NS)
    assert [goal.id for goal in goals] == ["b"]


def test_not_more_than_so_many_that_ended_are_kept() -> None:
    goals = running(*map(str, range(MAX_ENDED + 3)))
    for goal in goals:
        goal.advance("succeed", goal.accepted_ns)
    goals.forget_old(MAX_ENDED)
    assert [goal.id for goal in goals] == [str(number) for number in range(3, MAX_ENDED + 3)]
