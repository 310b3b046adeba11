"""What may be asked of a gaze controller, and its words on the wire; no I/O.

`iKinGazeCtrl` (iCub, Vizzy) has an input port for each kind of target; azimuth is positive to the
right there. R1's `cer_gaze-controller` takes properties on one port; azimuth is positive to the
left. Here it is positive to the right for both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Final, Literal, Protocol

from msgspec import Meta

from vertebra.errors import CommandRefusedError, RemoteError
from vertebra.yarp import Value, Vocab
from vertebra_yarp.board import Command
from vertebra_yarp.words import REFUSED, Request, number, refusal

ACK: Final = "ack"

Triple = tuple[float, float, float]


class LookAt(Command, frozen=True, kw_only=True):
    """Look at a point, as the call `<gaze>/look_at` takes it.

    Attributes:
        point_m: In the root frame of the robot.
        wait: Answer when the gaze has arrived, not when it has started.
    """

    point_m: Triple
    wait: bool = True


class Look(Command, frozen=True, kw_only=True):
    """Look into a direction, as the call `<gaze>/look` takes it.

    Attributes:
        azimuth_deg: To the right.
        elevation_deg: Upwards.
        vergence_deg: How much the eyes are crossed.
        relative: To where it looks now, not to straight ahead.
        wait: As for `LookAt`.
    """

    azimuth_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    elevation_deg: Annotated[float, Meta(ge=-90, le=90)] = 0.0
    vergence_deg: Annotated[float, Meta(ge=-60, le=60)] = 0.0
    relative: bool = False
    wait: bool = True


class LookAtPixel(Command, frozen=True, kw_only=True):
    """Look at what a camera sees in a pixel, as the call `<gaze>/look_at_pixel` takes it.

    Attributes:
        camera: Of which eye.
        u_px: Column.
        v_px: Row.
        distance_m: How far ahead of the camera it is, as far as anybody knows.
        wait: As for `LookAt`.
    """

    u_px: Annotated[float, Meta(ge=0)]
    v_px: Annotated[float, Meta(ge=0)]
    camera: Literal["left", "right"] = "left"
    distance_m: Annotated[float, Meta(gt=0, le=100)] = 1.0
    wait: bool = True


Target = LookAt | Look | LookAtPixel


def check(target: Target) -> Target:
    """Return `target` if all its numbers are numbers; raise `CommandRefusedError`."""
    for field in target.__struct_fields__:
        value = getattr(target, field)
        numbers = value if isinstance(value, tuple) else (value,)
        if any(isinstance(item, float) and not math.isfinite(item) for item in numbers):
            raise CommandRefusedError(f"{field} = {value} is no place to look at")
    return target


class GazeWords(Protocol):
    """What to say to a gaze controller.

    Attributes:
        angles: Its port that streams azimuth, elevation and vergence in degrees, empty for none.
        point: Its port that streams where it looks, in metres, empty for none.
        done: Asks on `rpc` whether the gaze has arrived.
        stop: Tells it on `rpc` to stop.
    """

    angles: str
    point: str
    done: ClassVar[Request]
    stop: ClassVar[Request]

    def target(self, target: Target) -> tuple[str, list[Value]]:
        """Return the input port for a target, and what to send there.

        Raises:
            CommandRefusedError: This controller has no such thing.
        """
        ...


class IKin:
    """The words of `iKinGazeCtrl`."""

    angles = "angles:o"
    point = "x:o"
    done: ClassVar[Request] = [Vocab("get"), Vocab("done")]
    stop: ClassVar[Request] = [Vocab("stop")]

    def target(self, target: Target) -> tuple[str, list[Value]]:
        """See `GazeWords`."""
        if isinstance(target, LookAt):
            return "xd:i", [*target.point_m]
        if isinstance(target, LookAtPixel):
            return "mono:i", [target.camera, target.u_px, target.v_px, target.distance_m]
        mode = "rel" if target.relative else "abs"
        return "angles:i", [mode, target.azimuth_deg, target.elevation_deg, target.vergence_deg]


class Cer:
    """The words of `cer_gaze-controller`; it tells no angles that compare with others."""

    angles = ""
    point = ""
    done: ClassVar[Request] = ["done"]
    stop: ClassVar[Request] = ["stop"]

    def target(self, target: Target) -> tuple[str, list[Value]]:
        """See `GazeWords`."""
        image: list[Value] = []
        if isinstance(target, LookAt):
            kind, place = "cartesian", [*target.point_m]
        elif isinstance(target, LookAtPixel):
            kind, place = "image", [target.u_px, target.v_px, target.distance_m]
            image = [["image", target.camera]]
        elif target.relative or target.vergence_deg:
            raise CommandRefusedError("this robot looks at absolute angles, without vergence, only")
        else:
            kind, place = "angular", [-target.azimuth_deg, target.elevation_deg]
        return "target:i", [["target-type", kind], ["target-location", [*place]], *image]


WORDS: Final[dict[str, type[IKin | Cer]]] = {"ikin": IKin, "cer": Cer}


def acknowledged(reply: list[Value], request: Request) -> Sequence[Value]:
    """Return what follows the `[ack]` of a gaze controller; raise `RemoteError`."""
    if not reply or str(reply[0]) != ACK:
        raise refusal(reply, request)
    return reply[1:]


def is_done(reply: list[Value], request: Request) -> bool:
    """Say whether the gaze has arrived; raise `RemoteError`."""
    told = acknowledged(reply, request)
    if len(told) != 1:
        raise RemoteError(REFUSED, f"the robot told {told!r} where 0 or 1 belongs")
    return bool(number(told[0]))
