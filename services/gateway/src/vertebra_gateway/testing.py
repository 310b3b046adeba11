"""A robot that exists only on the backbone, for tests of the gateway and of its clients."""

from __future__ import annotations

import asyncio
import time
from typing import Any, Final

import msgspec

from vertebra.bus import Bus, Priority, Reply, Request
from vertebra.codec import CodecRegistry
from vertebra.errors import VertebraError
from vertebra.messages import Array, Image, JointState
from vertebra.service import MessagePublisher

JOINTS: Final = (
    "neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence",
)  # fmt: skip
LIMIT_DEG: Final = 30.0
MAX_VELOCITY_DEG_S: Final = 100.0


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


def _json(document: dict[str, Any]) -> Reply:
    return Reply(payload=msgspec.json.encode(document), encoding="application/json")
