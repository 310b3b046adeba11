"""The deadman of velocity commands: joints run for as long as somebody wants them to."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import Final

from vertebra.errors import TransportError

log = logging.getLogger(__name__)

PERIOD_S: Final = 0.05
"""Time between repetitions: many a robot's firmware stops joints that hear nothing for 0.1 s."""


class Runner:
    """Repeats a velocity command until its time is up, then stops the joints.

    So whoever commands a velocity has to say so again and again, and a robot whose operator, or
    whose adapter, dies stands still soon after.

    Attributes:
        joints: Those that run, by number; those of a board that was lost, until `forget`.
    """

    def __init__(
        self,
        name: str,
        turn: asyncio.Lock,
        say: Callable[[Sequence[int], Sequence[float]], Awaitable[None]],
        stop: Callable[[Sequence[int]], Awaitable[None]],
    ) -> None:
        self.joints: tuple[int, ...] = ()
        self._name = name
        self._turn = turn
        self._say = say
        self._stop = stop
        self._velocities: tuple[float, ...] = ()
        self._until_s = 0.0
        self._task: asyncio.Task[None] | None = None

    async def run(self, joints: Sequence[int], velocities: Sequence[float], for_s: float) -> None:
        """Run these joints from now on; those that ran and are not among them stop.

        The caller holds the turn. Raises `TransportError`.
        """
        others = [joint for joint in self.joints if joint not in joints]
        if others:
            await self._stop(others)
        await self._say(joints, velocities)
        self.joints, self._velocities = tuple(joints), tuple(velocities)
        self._until_s = asyncio.get_running_loop().time() + for_s
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._keep(), name=f"velocity of {self._name}")

    def forget(self) -> None:
        """Repeat nothing more; the caller stops the joints, or has another use for them."""
        self.joints, self._until_s = (), 0.0
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _keep(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            while True:
                # A turn for each time: a joint that is being stopped must not be told to run.
                async with self._turn:
                    left_s = self._until_s - loop.time()
                    if left_s <= 0:  # nobody asked for more while we waited
                        joints, self.joints = self.joints, ()
                        await self._stop(joints)
                        return
                    await self._say(self.joints, self._velocities)
                await asyncio.sleep(min(PERIOD_S, left_s))
        except TransportError as error:
            log.error("%s was lost while its joints ran: %s", self._name, error)  # noqa: TRY400
