"""How the base drives to a pose by itself: around what stands in its way, and turned as asked.

It keeps no plan: each look begins with where the base is now, so that nothing is lost when
somebody pushes it, or drives by hand for a while.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from vertebra_simulator.base import (
    MAX_ANGULAR_RAD_S,
    MAX_ANGULAR_RAD_S2,
    MAX_LINEAR_M_S,
    MAX_LINEAR_M_S2,
    RADIUS_M,
    STILL,
    Base,
    Pose,
    Velocity,
    turn_of,
)
from vertebra_simulator.floorplan import FloorPlan

ARRIVED_M: Final = 0.03
ARRIVED_RAD: Final = math.radians(2)
GIVES_UP_AFTER_S: Final = 10.0
"""So long the base may come no nearer."""
_PROGRESS_M: Final = 0.02

_CLEARANCE_M: Final = 0.08
_CRUISE_M_S: Final = 0.75 * MAX_LINEAR_M_S
_TURN_RAD_S: Final = 0.75 * MAX_ANGULAR_RAD_S
# Some of what the base can do is kept for corrections.
_BRAKE: Final = 0.5
_AHEAD_RAD: Final = math.radians(25)
"""With more to turn than this the base turns on the spot."""


class Failure(IntEnum):
    """Why the base gives up, in the numbers of Nav2's planner and controller in Jazzy."""

    NO_PROGRESS = 105
    GOAL_OCCUPIED = 206
    NO_WAY = 208


@dataclass(frozen=True, slots=True)
class Outlook:
    """What is left of a way.

    Attributes:
        velocity: What to drive now.
        distance_m: How far it is.
        remaining_s: About how long it takes.
        arrived: Whether the base stands where it should.
        failure: Why it cannot go on, if it cannot.
        problem: That in words.
    """

    velocity: Velocity = STILL
    distance_m: float = 0.0
    remaining_s: float = 0.0
    arrived: bool = False
    failure: Failure | None = None
    problem: str = ""


class Navigation:
    """On the way to a pose."""

    def __init__(self, plan: FloorPlan, goal: Pose) -> None:
        self.goal = goal
        self._plan = plan
        self._turning = False
        self._nearest = math.inf
        self._nearest_at_s = math.nan

    def look(self, base: Base) -> Outlook:
        """Return what to do from where the base is now."""
        obstacle = self._plan.obstacle(self.goal.place, RADIUS_M)
        if obstacle:
            problem = f"{obstacle} is where it should go"
            return Outlook(failure=Failure.GOAL_OCCUPIED, problem=problem)
        way = self._plan.way(base.pose.place, self.goal.place, RADIUS_M + _CLEARANCE_M)
        if not way:
            return Outlook(failure=Failure.NO_WAY, problem="no way leads there")
        distance_m = sum(map(math.dist, way, way[1:]))
        last_turn = turn_of(self.goal.heading_rad - base.pose.heading_rad)
        # Once there, the base turns; what it drifts meanwhile is not worth another approach.
        self._turning = distance_m < (2 * ARRIVED_M if self._turning else ARRIVED_M)
        if self._turning:
            return self._turn(base, distance_m, last_turn)
        if self._stalled(distance_m, base.time_s):
            problem = f"it came no nearer in {GIVES_UP_AFTER_S:g} s"
            return Outlook(failure=Failure.NO_PROGRESS, problem=problem)
        bearing = math.atan2(way[1].y - base.pose.y_m, way[1].x - base.pose.x_m)
        turn = turn_of(bearing - base.pose.heading_rad)
        velocity = Velocity(_ahead(distance_m, math.dist(*way[:2]), turn), _turn(turn))
        turns_s = (abs(turn) + abs(last_turn)) / _TURN_RAD_S
        return Outlook(velocity, distance_m, distance_m / _CRUISE_M_S + turns_s)

    def _turn(self, base: Base, distance_m: float, turn: float) -> Outlook:
        arrived = abs(turn) < ARRIVED_RAD
        still = base.velocity.linear_m_s == 0 and abs(base.velocity.angular_rad_s) < ARRIVED_RAD
        velocity = STILL if arrived else Velocity(0.0, _turn(turn))
        return Outlook(velocity, distance_m, abs(turn) / _TURN_RAD_S, arrived and still)

    def _stalled(self, distance_m: float, time_s: float) -> bool:
        if distance_m < self._nearest - _PROGRESS_M:
            self._nearest, self._nearest_at_s = distance_m, time_s
        return time_s - self._nearest_at_s > GIVES_UP_AFTER_S


def _ahead(distance_m: float, bend_m: float, turn: float) -> float:
    """Return how fast to drive: so that the base can stop at the goal, and slowly around bends."""
    if abs(turn) > _AHEAD_RAD:
        return 0.0
    braking = math.sqrt(2 * _BRAKE * MAX_LINEAR_M_S2 * distance_m)
    bending = 0.3 + bend_m
    return min(_CRUISE_M_S, braking, bending) * math.cos(turn) ** 2


def _turn(turn: float) -> float:
    """Return how fast to turn, so that the base looks there without going past it."""
    braking = math.sqrt(2 * _BRAKE * MAX_ANGULAR_RAD_S2 * abs(turn))
    return math.copysign(min(_TURN_RAD_S, braking, 3.0 * abs(turn)), turn)
