"""The joints of the head: limits, speeds, and how they get from one place to another.

A command is planned at once into stretches of constant acceleration. Where a joint is at any time
follows from its plan in closed form, so that it makes no difference how often somebody looks.
Angles are in degrees. `neck_yaw` and `eyes_version` are positive to the left, `neck_pitch` and
`eyes_tilt` upwards, `neck_roll` towards the right shoulder.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from vertebra.errors import CommandRefusedError


class Mode(Enum):
    """How a joint is controlled; the value is YARP's word for it."""

    POSITION = "pos"
    POSITION_DIRECT = "posd"
    VELOCITY = "vel"
    MIXED = "mix"
    IDLE = "idl"


@dataclass(frozen=True, slots=True)
class JointSpec:
    """What a joint can do; position moves have its default speed until told otherwise."""

    name: str
    min_deg: float
    max_deg: float
    max_speed_deg_s: float
    max_acceleration_deg_s2: float
    default_speed_deg_s: float


# Ranges as configured on iCub heads (robotology/robots-configuration, iCubGenova01), whose six
# joints these are; the neck looks down to 30 degrees only. The eyes are faster than the neck.
HEAD: Final = (
    JointSpec("neck_pitch", -30.0, 22.0, 100.0, 400.0, 30.0),
    JointSpec("neck_roll", -20.0, 20.0, 100.0, 400.0, 30.0),
    JointSpec("neck_yaw", -50.0, 50.0, 100.0, 400.0, 30.0),
    JointSpec("eyes_tilt", -30.0, 30.0, 180.0, 1800.0, 90.0),
    JointSpec("eyes_version", -30.0, 30.0, 180.0, 1800.0, 90.0),
    JointSpec("eyes_vergence", 0.0, 50.0, 180.0, 1800.0, 90.0),
)


class Motion(NamedTuple):
    """Where a joint is and how it moves, in degrees and seconds."""

    position: float
    velocity: float
    acceleration: float


class Stretch(NamedTuple):
    """A time of constant acceleration."""

    duration_s: float
    acceleration: float


Plan = tuple[Stretch, ...]


def after(start: Motion, stretch: Stretch, time_s: float) -> Motion:
    """Return the motion `time_s` into a stretch."""
    acceleration = stretch.acceleration
    return Motion(
        start.position + (start.velocity + acceleration * time_s / 2) * time_s,
        start.velocity + acceleration * time_s,
        acceleration,
    )


def braking_distance(velocity: float, acceleration: float) -> float:
    """Return how far a joint still goes when it brakes; negative when it moves backwards."""
    return velocity * abs(velocity) / (2 * acceleration)


def plan_brake(velocity: float, acceleration: float) -> Plan:
    """Return the quickest way to stand still."""
    if velocity == 0:
        return ()
    return (Stretch(abs(velocity) / acceleration, -math.copysign(acceleration, velocity)),)


def plan_move(now: Motion, target: float, speed: float, acceleration: float) -> Plan:
    """Return the quickest way to stand still at `target`: a trapezoid of velocities.

    Neither `speed` nor `acceleration` is exceeded; a joint that is faster than `speed` brakes
    first, one that cannot stop before `target` goes past it and comes back.
    """
    remaining = target - now.position - braking_distance(now.velocity, acceleration)
    if remaining == 0:
        return plan_brake(now.velocity, acceleration)
    forward = math.copysign(1.0, remaining)
    distance = forward * (target - now.position)
    velocity = forward * now.velocity
    # Without a cruise the joint speeds up and brakes over the distance; v² = 2as on both sides.
    peak = min(speed, math.sqrt(max(0.0, acceleration * distance + velocity**2 / 2)))
    change_s = abs(peak - velocity) / acceleration
    change_to = math.copysign(acceleration, peak - velocity)
    changed = after(Motion(0.0, velocity, 0.0), Stretch(change_s, change_to), change_s).position
    cruise = max(0.0, distance - changed - braking_distance(peak, acceleration))
    stretches = (
        Stretch(change_s, forward * change_to),
        Stretch(cruise / peak if peak > 0 else 0.0, 0.0),
        Stretch(peak / acceleration, -forward * acceleration),
    )
    return tuple(stretch for stretch in stretches if stretch.duration_s > 0)


class Joint:
    """A joint of the head and the command it carries out.

    Attributes:
        spec: What it can do.
        mode: How it is controlled.
        target: Where the latest position move goes, clamped to the limits.
        speed: Of position moves.
        acceleration: Of position moves and of changes of velocity.
        direct_target: The latest position-direct reference, clamped to the limits.
        velocity_target: The latest velocity reference, clamped to the speed limit.
    """

    def __init__(self, spec: JointSpec) -> None:
        self.spec = spec
        self.mode = Mode.POSITION
        self.speed = spec.default_speed_deg_s
        self.acceleration = spec.max_acceleration_deg_s2 / 2
        start = self._within_limits(0.0)
        self.target = self.direct_target = start
        self.velocity_target = 0.0
        self._motion = Motion(start, 0.0, 0.0)
        self._plan: list[Stretch] = []
        self._destination = start

    @property
    def motion(self) -> Motion:
        """Where it is and how it moves."""
        return self._motion

    @property
    def moving(self) -> bool:
        """Whether its command is still being carried out."""
        return bool(self._plan)

    @property
    def move_done(self) -> bool:
        """Whether no position move is under way."""
        return not self.moving or self.mode in (Mode.VELOCITY, Mode.POSITION_DIRECT)

    def advance(self, duration_s: float) -> None:
        """Let time pass."""
        while self._plan:
            stretch = self._plan[0]
            if duration_s < stretch.duration_s:
                self._motion = after(self._motion, stretch, duration_s)
                self._plan[0] = Stretch(stretch.duration_s - duration_s, stretch.acceleration)
                break
            self._motion = after(self._motion, stretch, stretch.duration_s)
            duration_s -= stretch.duration_s
            del self._plan[0]
        if self._plan:  # rounding must not carry it a hair beyond
            position = self._within_limits(self._motion.position)
            self._motion = self._motion._replace(position=position)
        else:
            self._motion = Motion(self._destination, 0.0, 0.0)

    def set_mode(self, mode: Mode) -> None:
        """Control the joint in another way; if it moves, it stops first."""
        if mode is not self.mode:
            self.stop()
            self.mode = mode

    def move(self, target: float) -> None:
        """Go to `target`, or as far towards it as the limits let it.

        Raises:
            CommandRefusedError: The mode is another one, or this is no number.
        """
        self._require(target, Mode.POSITION, Mode.MIXED)
        self.target = self._within_limits(target)
        self._go(self.target, self.speed, self.acceleration)

    def follow(self, target: float) -> None:
        """Be at `target` as soon as the joint can: a position-direct reference.

        Raises:
            CommandRefusedError: The mode is another one, or this is no number.
        """
        self._require(target, Mode.POSITION_DIRECT)
        self.direct_target = self._within_limits(target)
        self._go(self.direct_target, self.spec.max_speed_deg_s, self.spec.max_acceleration_deg_s2)

    def run(self, velocity: float) -> None:
        """Move at `velocity` until told otherwise or until the limit, and stop there.

        Raises:
            CommandRefusedError: The mode is another one, or this is no number.
        """
        self._require(velocity, Mode.VELOCITY, Mode.MIXED)
        limit = self.spec.max_speed_deg_s
        self.velocity_target = min(max(velocity, -limit), limit)
        if self.velocity_target == 0:
            self._brake(self.acceleration)
        else:
            end = self.spec.max_deg if self.velocity_target > 0 else self.spec.min_deg
            self._go(end, abs(self.velocity_target), self.acceleration)

    def stop(self) -> None:
        """Stand still as soon as the joint can."""
        self.velocity_target = 0.0
        self._brake(self.spec.max_acceleration_deg_s2)
        self.target = self.direct_target = self._destination

    def set_speed(self, speed: float) -> None:
        """Set the speed of the position moves that follow, at most that of the joint.

        Raises:
            CommandRefusedError: It is not above 0.
        """
        self.speed = min(self._positive(speed, "speed"), self.spec.max_speed_deg_s)

    def set_acceleration(self, acceleration: float) -> None:
        """Set the acceleration of the moves that follow, at most that of the joint.

        Raises:
            CommandRefusedError: It is not above 0.
        """
        self.acceleration = min(
            self._positive(acceleration, "acceleration"), self.spec.max_acceleration_deg_s2
        )

    def _require(self, value: float, *modes: Mode) -> None:
        if self.mode not in modes:
            raise CommandRefusedError(
                f"{self.spec.name} is in control mode {self.mode.value!r}; "
                f"set {' or '.join(repr(mode.value) for mode in modes)} first"
            )
        if not math.isfinite(value):
            raise CommandRefusedError(f"{self.spec.name} cannot go to {value}")

    def _positive(self, value: float, what: str) -> float:
        if not (math.isfinite(value) and value > 0):
            raise CommandRefusedError(f"the {what} of {self.spec.name} cannot be {value}")
        return value

    def _within_limits(self, position: float) -> float:
        return min(max(position, self.spec.min_deg), self.spec.max_deg)

    def _go(self, target: float, speed: float, acceleration: float) -> None:
        acceleration = self._enough_to_stop(acceleration)
        self._destination = target
        self._plan = [*plan_move(self._motion, target, speed, acceleration)]

    def _brake(self, acceleration: float) -> None:
        acceleration = self._enough_to_stop(acceleration)
        way = braking_distance(self._motion.velocity, acceleration)
        self._destination = self._within_limits(self._motion.position + way)
        self._plan = [*plan_brake(self._motion.velocity, acceleration)]

    def _enough_to_stop(self, acceleration: float) -> float:
        """Return `acceleration`, or more if that would let the joint run into its limit.

        It may have been set lower in the middle of a move. The largest is always enough, because
        whatever was planned before could stop in time.
        """
        motion = self._motion
        end = self.spec.max_deg if motion.velocity > 0 else self.spec.min_deg
        room = abs(end - motion.position)
        needed = motion.velocity**2 / (2 * room) if room > 0 else math.inf
        largest = self.spec.max_acceleration_deg_s2
        return min(max(acceleration, needed if motion.velocity else 0.0), largest)


class Body:
    """All joints of the head, and the time that has passed for them."""

    def __init__(self, specs: Iterable[JointSpec] = HEAD) -> None:
        self.joints = tuple(Joint(spec) for spec in specs)
        self.time_s = 0.0

    def advance_to(self, time_s: float) -> None:
        """Let time pass until `time_s`; an earlier time changes nothing."""
        if time_s > self.time_s:
            for joint in self.joints:
                joint.advance(time_s - self.time_s)
            self.time_s = time_s

    @property
    def positions(self) -> list[float]:
        """Where the joints are."""
        return [joint.motion.position for joint in self.joints]

    @property
    def velocities(self) -> list[float]:
        """How fast they are."""
        return [joint.motion.velocity for joint in self.joints]

    @property
    def accelerations(self) -> list[float]:
        """How fast they get faster."""
        return [joint.motion.acceleration for joint in self.joints]
