"""A robot that exists only on the backbone, for tests of the gateway and of its clients."""

from __future__ import annotations

import asyncio
import math
import os
import time
from array import array
from typing import Any, Final

import msgspec

from vertebra.bus import Bus, Priority, Reply, Request
from vertebra.codec import CodecRegistry
from vertebra.errors import CommandRefusedError, VertebraError
from vertebra.messages import (
    Array,
    Image,
    JointState,
    LaserScan,
    Native,
    Odometry,
    Pose,
    Twist,
)
from vertebra.service import MessagePublisher

JOINTS: Final = (
    "neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence",
)  # fmt: skip
LIMIT_DEG: Final = 30.0
MAX_VELOCITY_DEG_S: Final = 100.0
BASE_LIMITS: Final = {
    "min_linear_m_s": -0.25,
    "max_linear_m_s": 0.5,
    "min_angular_deg_s": -90.0,
    "max_angular_deg_s": 90.0,
}
ROOM_M: Final = (-2.0, 4.0, -1.5, 2.5)
"""Walls of the room around the base: least and greatest x, least and greatest y."""
BEAMS: Final = 180
BASE_PERIOD_S: Final = 0.05


class FakeRobot:
    """What `deploy/robots/vizzy.yaml` describes: a head that is where it is told to be at once.

    Attributes:
        moves: The inputs of all moves that reached it.
        failure: Raised by its calls as long as it is set.
        delay_s: How long a move takes.
    """

    def __init__(self, bus: Bus, codecs: CodecRegistry) -> None:
        self.moves: list[dict[str, Any]] = []
        self.failure: VertebraError | None = None
        self.delay_s = 0.0
        self._positions_deg = dict.fromkeys(JOINTS, 0.0)
        self._state = MessagePublisher(bus, codecs, "vizzy/head/state")
        self._camera = MessagePublisher(bus, codecs, "vizzy/camera/left", priority=Priority.BULK)
        self._declared = [
            bus.serve("vizzy/head/limits", self._limits),
            bus.serve("vizzy/head/move", self._move),
            bus.serve("vizzy/head/stop", self._stop),
            bus.declare_presence("@vertebra/parts/vizzy/head"),
        ]

    def close(self) -> None:
        """Leave: from now on nobody answers and nobody is present."""
        for declared in self._declared:
            declared.close()

    def publish_state(self) -> None:
        """Publish where the joints are."""
        positions = tuple(self._positions_deg.values())
        self._state.publish(JointState(names=JOINTS, positions_deg=positions))

    def publish_image(self, shade: int = 128, *, width: int = 320, height: int = 240) -> int:
        """Publish an image of one shade; return its capture time."""
        captured_ns = time.time_ns()
        pixels = Array(bytes([shade]) * (width * height * 3), "|u1", (height, width, 3))
        self._camera.publish(Image(pixels=pixels, pixel_format="rgb8"), captured_ns=captured_ns)
        return captured_ns

    async def stream(self, rate_hz: float) -> None:
        """Publish state and images, for ever."""
        for number in range(1 << 62):
            self.publish_state()
            self.publish_image(number % 256)
            await asyncio.sleep(1.0 / rate_hz)

    async def _limits(self, _: Request) -> Reply:
        self._fail()
        limits = {
            "min_deg": -LIMIT_DEG,
            "max_deg": LIMIT_DEG,
            "min_velocity_deg_s": -MAX_VELOCITY_DEG_S,
            "max_velocity_deg_s": MAX_VELOCITY_DEG_S,
        }
        return _json({"joints": [{"name": joint, **limits} for joint in JOINTS]})

    async def _move(self, request: Request) -> Reply:
        self._fail()
        command = msgspec.json.decode(request.payload)
        self.moves.append(command)
        await asyncio.sleep(self.delay_s)
        self._positions_deg |= command["positions_deg"]
        return _json(
            {
                "reached": True,
                "positions_deg": self._positions_deg,
                "targets_deg": command["positions_deg"],
                "duration_s": self.delay_s,
            }
        )

    async def _stop(self, _: Request) -> Reply:
        self._fail()
        return _json({"positions_deg": self._positions_deg})

    def _fail(self) -> None:
        if self.failure is not None:
            raise self.failure


class FakeBase:
    """What a part `base` with a part `action` at `navigate` describes: it drives through anything.

    Attributes:
        drives: The inputs of all drives that reached it.
        stops: How often it was stopped.
        goals: The poses it was sent to.
        delay_s: How long a drive takes to be answered.
        failure: Raised by its calls as long as it is set.
    """

    def __init__(self, bus: Bus, codecs: CodecRegistry) -> None:
        self.drives: list[dict[str, Any]] = []
        self.stops = 0
        self.goals: list[dict[str, Any]] = []
        self.delay_s = 0.0
        self.failure: VertebraError | None = None
        self.x_m = self.y_m = self.heading_rad = 0.0
        self._linear_m_s = self._angular_rad_s = 0.0
        self._stops_at_s = 0.0
        self._goal_id = b""
        self._began_s = 0.0
        self._results: dict[str, asyncio.Future[str]] = {}
        self._odometry = MessagePublisher(bus, codecs, "vizzy/base/odometry")
        self._scan = MessagePublisher(bus, codecs, "vizzy/base/scan")
        self._feedback = MessagePublisher(bus, codecs, "vizzy/base/navigate/feedback")
        calls = {
            "limits": self._tell_limits,
            "drive": self._drive,
            "stop": self._stop,
            "navigate/goal": self._goal,
            "navigate/result": self._result,
            "navigate/cancel": self._cancel,
        }
        self._declared = [
            *(bus.serve(f"vizzy/base/{name}", handler) for name, handler in calls.items()),
            bus.declare_presence("@vertebra/parts/vizzy/base"),
        ]

    def close(self) -> None:
        """Leave: from now on nobody answers and nobody is present."""
        for declared in self._declared:
            declared.close()

    async def live(self) -> None:
        """Move and publish, for ever."""
        while True:
            self.step(BASE_PERIOD_S)
            await asyncio.sleep(BASE_PERIOD_S)

    def step(self, duration_s: float) -> None:
        """Move for a moment and publish where that led."""
        if self._goal_id:
            self._approach()
        elif time.monotonic() > self._stops_at_s:
            self._linear_m_s = self._angular_rad_s = 0.0
        self.heading_rad += self._angular_rad_s * duration_s
        self.x_m += self._linear_m_s * math.cos(self.heading_rad) * duration_s
        self.y_m += self._linear_m_s * math.sin(self.heading_rad) * duration_s
        self._publish()

    def _publish(self) -> None:
        captured_ns = time.time_ns()
        pose = Pose(
            position_m=(self.x_m, self.y_m, 0.0),
            orientation_xyzw=(
                0.0, 0.0, math.sin(self.heading_rad / 2), math.cos(self.heading_rad / 2),
            ),
            frame_id="odom",
        )  # fmt: skip
        twist = Twist(
            linear_m_s=(self._linear_m_s, 0.0, 0.0), angular_rad_s=(0.0, 0.0, self._angular_rad_s)
        )
        self._odometry.publish(
            Odometry(pose=pose, twist=twist, child_frame_id="base_link"), captured_ns=captured_ns
        )
        ranges = [self._range_m(2 * math.pi * beam / BEAMS - math.pi) for beam in range(BEAMS)]
        self._scan.publish(
            LaserScan(
                ranges_m=Array.of(array("f", ranges)),
                angle_min_rad=-math.pi,
                angle_increment_rad=2 * math.pi / BEAMS,
                range_min_m=0.05,
                range_max_m=8.0,
                frame_id="base_link",
            ),
            captured_ns=captured_ns,
        )

    def _range_m(self, bearing_rad: float) -> float:
        """Return how far away the wall is in a direction."""
        low_x, high_x, low_y, high_y = ROOM_M
        cosine = math.cos(self.heading_rad + bearing_rad) or 1e-9
        sine = math.sin(self.heading_rad + bearing_rad) or 1e-9
        to_x = ((high_x if cosine > 0 else low_x) - self.x_m) / cosine
        to_y = ((high_y if sine > 0 else low_y) - self.y_m) / sine
        return max(0.0, min(to_x, to_y))

    async def _tell_limits(self, _: Request) -> Reply:
        self._fail()
        return _json({"joints": [{"name": "base", **BASE_LIMITS}]})

    async def _drive(self, request: Request) -> Reply:
        self._fail()
        command = msgspec.json.decode(request.payload)
        self.drives.append(command)
        await asyncio.sleep(self.delay_s)
        linear_m_s = command.get("linear_m_s", 0.0)
        angular_deg_s = command.get("angular_deg_s", 0.0)
        stops_in_s = command.get("for_s", 0.5)
        self._linear_m_s, self._angular_rad_s = linear_m_s, math.radians(angular_deg_s)
        self._stops_at_s = time.monotonic() + stops_in_s
        return _json(
            {"linear_m_s": linear_m_s, "angular_deg_s": angular_deg_s, "stops_in_s": stops_in_s}
        )

    async def _stop(self, _: Request) -> Reply:
        self._fail()
        self.stops += 1
        self._linear_m_s = self._angular_rad_s = 0.0
        self._end("canceled")
        return _json({})

    async def _goal(self, request: Request) -> Reply:
        self._fail()
        self._end("aborted")
        self.goals.append(msgspec.json.decode(request.payload)["pose"])
        self._goal_id, self._began_s = os.urandom(16), time.monotonic()
        self._results[self._goal_id.hex()] = asyncio.get_running_loop().create_future()
        return _json({"goal_id": self._goal_id.hex()})

    async def _result(self, request: Request) -> Reply:
        goal_id = msgspec.json.decode(request.payload)["goal_id"]
        return _json({"status": await asyncio.shield(self._results[goal_id]), "result": {}})

    async def _cancel(self, request: Request) -> Reply:
        goal_id = msgspec.json.decode(request.payload)["goal_id"]
        if goal_id != self._goal_id.hex():
            raise CommandRefusedError("this goal has ended already")
        self._end("canceled")
        return _json({"cancelling": [goal_id]})

    def _approach(self) -> None:
        """Head for the goal and tell how far it is."""
        position = self.goals[-1]["pose"]["position"]
        ahead = complex(position["x"] - self.x_m, position["y"] - self.y_m)
        distance_m = abs(ahead)
        if distance_m < 0.05:
            self._end("succeeded")
            return
        self.heading_rad = math.atan2(ahead.imag, ahead.real)
        self._linear_m_s = min(0.4, distance_m / BASE_PERIOD_S)
        feedback = {
            "distance_remaining": distance_m,
            "navigation_time": _duration(time.monotonic() - self._began_s),
            "estimated_time_remaining": _duration(distance_m / 0.4),
            "number_of_recoveries": 0,
        }
        goal_id = {"uuid": Array(self._goal_id, "|u1", (16,))}
        self._feedback.publish(Native(value={"goal_id": goal_id, "feedback": feedback}))

    def _end(self, status: str) -> None:
        if self._goal_id:
            self._results[self._goal_id.hex()].set_result(status)
            self._goal_id = b""
            self._linear_m_s = 0.0

    def _fail(self) -> None:
        if self.failure is not None:
            raise self.failure


def _duration(seconds: float) -> dict[str, int]:
    """Return a duration as `builtin_interfaces/msg/Duration` has it."""
    return {"sec": int(seconds), "nanosec": int(seconds % 1 * 1e9)}


def _json(document: dict[str, Any]) -> Reply:
    return Reply(payload=msgspec.json.encode(document), encoding="application/json")
