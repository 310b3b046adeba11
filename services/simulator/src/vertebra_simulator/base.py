"""The wheels of the robot: how the base moves when it is told a velocity, and where it cannot go.

Two wheels drive it, so it goes ahead, back and turns, but not sideways. Time passes in steps of
the same length, so that it makes no difference how often somebody looks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from vertebra.errors import CommandRefusedError
from vertebra_simulator.floorplan import FloorPlan, Point

STEP_S: Final = 0.01
COMMAND_HOLDS_S: Final = 0.5
"""So long a velocity holds; then the base stops."""

RADIUS_M: Final = 0.25
WHEEL_RADIUS_M: Final = 0.1
TRACK_M: Final = 0.4

# Of a human's careful walk: people are around.
MAX_LINEAR_M_S: Final = 0.8
MAX_ANGULAR_RAD_S: Final = math.radians(90)
MAX_LINEAR_M_S2: Final = 0.8
MAX_ANGULAR_RAD_S2: Final = math.radians(180)


class Velocity(NamedTuple):
    """How the base drives: ahead, and to the left."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0

    def held(self) -> Velocity:
        """Return it within what the base can do."""
        return Velocity(
            _within(self.linear_m_s, MAX_LINEAR_M_S),
            _within(self.angular_rad_s, MAX_ANGULAR_RAD_S),
        )


STILL: Final = Velocity()


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the base is and where it looks, to the left of where it started."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    @property
    def place(self) -> Point:
        """Where it is."""
        return Point(self.x_m, self.y_m)


class Base:
    """The base in a room, and the time that has passed for it.

    Attributes:
        pose: Where it is.
        velocity: How it drives now.
        wheels_rad: How far the left and the right wheel have turned.
        stuck: What keeps it from going on; empty if nothing does.
    """

    def __init__(self, plan: FloorPlan) -> None:
        self.pose = Pose()
        self.velocity = STILL
        self.wheels_rad = (0.0, 0.0)
        self.stuck = ""
        self.time_s = 0.0
        self._plan = plan
        self._target = STILL
        self._until_s = 0.0

    @property
    def wheel_speeds_rad_s(self) -> tuple[float, float]:
        """How fast the left and the right wheel turn."""
        linear, angular = self.velocity
        left, right = linear - angular * TRACK_M / 2, linear + angular * TRACK_M / 2
        return left / WHEEL_RADIUS_M, right / WHEEL_RADIUS_M

    def drive(self, velocity: Velocity) -> None:
        """Drive so from now on, as fast as the base can at most, until `COMMAND_HOLDS_S` from now.

        Raises:
            CommandRefusedError: This is no number; the base stops.
        """
        if not all(map(math.isfinite, velocity)):
            self._target = STILL
            raise CommandRefusedError(f"{velocity} is no velocity; the base stops")
        self._target = velocity.held()
        self._until_s = self.time_s + COMMAND_HOLDS_S

    def advance_to(self, time_s: float) -> None:
        """Let time pass until `time_s`, but for a rest of less than a step."""
        while self.time_s + STEP_S <= time_s:
            if self.velocity == self._target == STILL:
                self.time_s = time_s
                return
            self._step()
            self.time_s += STEP_S

    def _step(self) -> None:
        if self.time_s >= self._until_s:
            self._target = STILL
        linear, angular = self.velocity
        self.velocity = Velocity(
            linear + _within(self._target.linear_m_s - linear, MAX_LINEAR_M_S2 * STEP_S),
            angular + _within(self._target.angular_rad_s - angular, MAX_ANGULAR_RAD_S2 * STEP_S),
        )
        ahead = moved(self.pose, self.velocity, STEP_S)
        self.stuck = self._plan.obstacle(ahead.place, RADIUS_M)
        if self.stuck:
            self.velocity = Velocity(0.0, self.velocity.angular_rad_s)
            ahead = moved(self.pose, self.velocity, STEP_S)
        self.pose = ahead
        left, right = self.wheels_rad
        left_rad_s, right_rad_s = self.wheel_speeds_rad_s
        self.wheels_rad = (left + left_rad_s * STEP_S, right + right_rad_s * STEP_S)


def moved(pose: Pose, velocity: Velocity, duration_s: float) -> Pose:
    """Return where a base is that has driven so for a while: on an arc, or straight ahead."""
    linear, angular = velocity
    half = angular * duration_s / 2
    heading = pose.heading_rad + half  # the chord of the arc
    way = linear * duration_s * (math.sin(half) / half if half else 1.0)
    return Pose(
        pose.x_m + way * math.cos(heading),
        pose.y_m + way * math.sin(heading),
        turn_of(pose.heading_rad + 2 * half),
    )


def turn_of(angle_rad: float) -> float:
    """Return an angle as a turn of at most half a circle."""
    return math.remainder(angle_rad, 2 * math.pi)


def _within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
