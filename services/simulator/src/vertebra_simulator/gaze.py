"""The gaze controller: which joints turn how far so that the eyes look somewhere.

Its ports and words are those of `iKinGazeCtrl`; what it looks at is kept by the neck as far as that
can turn, and by the eyes beyond. Azimuth is positive to the right and elevation upwards, as there.
Points are in metres from where the axes of the head meet, x ahead, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from vertebra.errors import CommandRefusedError
from vertebra.yarp import Value, Vocab
from vertebra_simulator.body import Body, Joint, Mode
from vertebra_simulator.geometry import Vector, about_y, about_z, camera_rotation, head_rotation
from vertebra_simulator.scene import Camera

ACK: Final = Vocab("ack")
NACK: Final = Vocab("nack")
_BETWEEN_EYES_M: Final = 0.068
_FARTHEST_M: Final = 10.0
_NEAREST_M: Final = 0.05


class GazeController:
    """Turns a body's head and eyes."""

    def __init__(self, body: Body, camera: Camera) -> None:
        self._body = body
        self._camera = camera

    def look_at(self, point: Sequence[float]) -> None:
        """Look at a point; raise `CommandRefusedError` if it is none."""
        target = np.array(point, float)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise CommandRefusedError(f"a point has 3 finite coordinates, not {point!r}")
        distance = float(np.linalg.norm(target))
        if distance < _NEAREST_M:
            raise CommandRefusedError(f"{distance:g} m is nearer than {_NEAREST_M} m")
        self._turn(target / distance, math.degrees(2 * math.atan2(_BETWEEN_EYES_M / 2, distance)))

    def look(self, request: Sequence[Value]) -> None:
        """Look into a direction: `abs|rel azimuth elevation vergence`, in degrees.

        Raises:
            CommandRefusedError: It is none.
        """
        match request:
            case ["abs" | "rel" as mode, *angles] if len(angles) == 3:
                wanted = np.array([*map(_number, angles)])
            case _:
                raise CommandRefusedError(f"expected abs|rel azimuth elevation vergence: {request}")
        azimuth, elevation, vergence = wanted + (self.angles if mode == "rel" else 0.0)
        ahead = np.array([1.0, 0.0, 0.0])
        self._turn(about_z(-azimuth) @ about_y(-elevation) @ ahead, vergence)

    def look_at_pixel(self, request: Sequence[Value]) -> None:
        """Look at what the left camera sees in a pixel: `left u v z`, z metres ahead of it.

        Raises:
            CommandRefusedError: There is no such camera, or these are no numbers.
        """
        match request:
            case ["left", *numbers] if len(numbers) == 3:
                u, v, ahead = map(_number, numbers)
            case _:
                raise CommandRefusedError(f"expected left u v z: {request}")
        ray = camera_rotation(self._body.positions) @ self._camera.rays @ np.array([u, v, 1.0])
        self.look_at((ahead * ray).tolist())

    def answer(self, request: Sequence[Value]) -> list[Value]:
        """Return the answer to a request that came on `rpc`."""
        match request:
            case ["stop"]:
                for joint in self._body.joints:
                    joint.stop()
                return [ACK]
            case ["get", "done"]:
                return [ACK, int(all(joint.move_done for joint in self._body.joints))]
        return [NACK]

    @property
    def angles(self) -> Vector:
        """Azimuth, elevation and vergence of the present gaze, in degrees."""
        ahead, left, up = self._direction()
        return np.array(
            [
                -math.degrees(math.atan2(left, ahead)),
                math.degrees(math.asin(np.clip(up, -1.0, 1.0))),
                self._body.positions[5],
            ]
        )

    @property
    def point(self) -> Vector:
        """Where both eyes look."""
        vergence = math.radians(self._body.positions[5])
        near = _BETWEEN_EYES_M / 2 / math.tan(vergence / 2) if vergence > 0 else _FARTHEST_M
        return self._direction() * min(near, _FARTHEST_M)

    def _direction(self) -> Vector:
        positions = self._body.positions
        tilt, version = positions[3:5]
        eyes = head_rotation(positions) @ about_y(-tilt) @ about_z(version)
        return np.asarray(eyes @ np.array([1.0, 0.0, 0.0]))

    def _turn(self, direction: Vector, vergence_deg: float) -> None:
        neck_pitch, neck_roll, neck_yaw, *eyes = self._body.joints
        pitch, yaw = _pitch_and_yaw(direction)
        neck = [_within(neck_pitch, pitch), 0.0, _within(neck_yaw, yaw)]
        tilt, version = _pitch_and_yaw(head_rotation(neck).T @ direction)
        targets = [*neck, tilt, version, vergence_deg]
        for joint, target in zip((neck_pitch, neck_roll, neck_yaw, *eyes), targets, strict=True):
            joint.set_mode(Mode.POSITION)
            joint.move(_within(joint, target))


def _pitch_and_yaw(direction: Vector) -> tuple[float, float]:
    """Return how far to look up, then to the left, to look into a direction; never backwards."""
    ahead, left, up = direction.tolist()
    ahead = max(ahead, 0.0)
    return (
        math.degrees(math.atan2(up, ahead)),
        math.degrees(math.atan2(left, math.hypot(ahead, up))),
    )


def _within(joint: Joint, target: float) -> float:
    return min(max(target, joint.spec.min_deg), joint.spec.max_deg)


def _number(value: Value) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CommandRefusedError(f"a finite number was expected, not {value!r}")
    return float(value)
