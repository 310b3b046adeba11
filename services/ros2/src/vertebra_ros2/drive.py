"""Velocities that end by themselves: what a call of `drive` may ask, and its deadman."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from typing import Any, Final

import msgspec
from msgspec import Struct

from vertebra.errors import CommandRefusedError, TransportError
from vertebra_ros2.routes import Base

log = logging.getLogger(__name__)

PERIOD_S: Final = 0.05
"""Time between repetitions: most bases stop when they hear nothing for a part of a second."""
MAX_FOR_S: Final = 2.0
"""Longest time for which one call holds."""


class Drive(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a base shall drive, as the call `<base>/drive` takes it.

    Attributes:
        linear_m_s: Ahead.
        angular_deg_s: To the left.
        for_s: The base stops after this time unless a new command comes before.
    """

    linear_m_s: float = 0.0
    angular_deg_s: float = 0.0
    for_s: float = 0.5


STILL: Final = Drive()


def read(payload: bytes, route: Base) -> Drive:
    """Return what a call asks of a base that may do it; raise `CommandRefusedError`."""
    try:
        drive = msgspec.json.decode(payload or b"{}", type=Drive)
    except msgspec.DecodeError as error:
        fields = ", ".join(Drive.__struct_fields__)
        raise CommandRefusedError(f"this call takes a JSON object of {fields}: {error}") from error
    for name, value, limit, unit in (
        ("linear_m_s", drive.linear_m_s, route.max_linear_m_s, "m/s"),
        ("angular_deg_s", drive.angular_deg_s, route.max_angular_deg_s, "deg/s"),
    ):
        if not math.isfinite(value) or abs(value) > limit:
            raise CommandRefusedError(
                f"{name} = {value:g} {unit} is outside its limits, {-limit:g} to {limit:g} {unit}"
            )
    if not 0.0 < drive.for_s <= MAX_FOR_S:
        raise CommandRefusedError(
            f"for_s = {drive.for_s:g} s is outside its limits, above 0 to {MAX_FOR_S:g} s; "
            "send the command again before it ends"
        )
    return drive


def limits_of(route: Base) -> dict[str, Any]:
    """Return the answer of `<base>/limits`, in the form in which parts tell of their joints."""
    limits = {
        "name": "base",
        "min_linear_m_s": -route.max_linear_m_s,
        "max_linear_m_s": route.max_linear_m_s,
        "min_angular_deg_s": -route.max_angular_deg_s,
        "max_angular_deg_s": route.max_angular_deg_s,
    }
    return {"joints": [limits]}


class Runner:
    """Repeats a command until its time is up, says once that the base shall stand, and is silent.

    So whoever drives has to say so again and again, and a base whose operator, or whose adapter,
    dies stands still soon after. Others may drive it while nobody here does.
    """

    def __init__(self, name: str, say: Callable[[Drive], None]) -> None:
        self._name = name
        self._say = say
        self._drive = STILL
        self._until_s = 0.0
        self._task: asyncio.Task[None] | None = None

    def run(self, drive: Drive) -> None:
        """Drive so from now on, in place of what was said before; raise `TransportError`."""
        self._say(drive)
        self._drive = drive
        self._until_s = asyncio.get_running_loop().time() + drive.for_s
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._keep(), name=f"drive of {self._name}")

    def halt(self) -> bool:
        """Stand still and repeat nothing; return whether there was anything to end."""
        if self._task is None or self._task.done():
            return False
        self._task.cancel()
        self._task = None
        self._say(STILL)
        return True

    async def _keep(self) -> None:
        now_s = asyncio.get_running_loop().time
        try:
            while (left_s := self._until_s - now_s()) > 0:
                await asyncio.sleep(min(PERIOD_S, left_s))
                self._say(self._drive if now_s() < self._until_s else STILL)
        except TransportError as error:
            log.error("%s was lost while it was driven: %s", self._name, error)  # noqa: TRY400
