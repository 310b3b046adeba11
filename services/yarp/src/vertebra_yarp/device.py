"""What all things of a robot have in common that are asked by calls."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final

import msgspec

from vertebra.bus import Reply, Request
from vertebra.errors import DeadlineError, NotConnectedError, VertebraError
from vertebra.yarp import Incoming, PortNotFoundError
from vertebra_yarp.calls import JSON
from vertebra_yarp.carried import Carried, Kit
from vertebra_yarp.driver import Sink

ANSWER_S: Final = 5.0
"""Longest time that a robot may take for an answer."""

Handler = Callable[[Request], Awaitable[dict[str, Any]]]


class Device(Carried):
    """Something of a robot whose calls are served below its key, in JSON."""

    def __init__(self, kit: Kit, yarp: str, key: str, calls: Mapping[str, Handler]) -> None:
        super().__init__(kit, yarp, key)
        serve = kit.context.bus.serve
        self._served = [serve(f"{key}/{name}", self._answering(calls[name])) for name in calls]

    async def work(self) -> None:
        """Wait: calls come by themselves, and connections are made when there is one."""
        await asyncio.get_running_loop().create_future()

    async def close(self) -> None:
        """End it."""
        for served in self._served:
            served.close()
        await super().close()

    async def glance(self, source: str, decode: Callable[[Incoming], Any]) -> Any:
        """Return the next object that streams on the YARP port `source`.

        Raises:
            NotConnectedError, DeadlineError: There is no such port, or nothing comes.
        """
        seen: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def arrived(incoming: Incoming) -> None:
            if not seen.done():
                seen.set_result(decode(incoming))

        reader_name = f"{self.kit.own_name}/glance{source}"
        link = await self.kit.transport.read(source, reader_name, arrived)
        try:
            async with asyncio.timeout(ANSWER_S):
                return await seen
        except TimeoutError:
            raise DeadlineError(f"YARP port {source}", ANSWER_S) from None
        finally:
            await link.close()

    async def dial_input(self, dest: str, **how: Any) -> Sink:
        """Connect to the YARP input port `dest`; see `Transport.send_to`."""
        sender_name = f"{self.kit.own_name}/sender{dest}"
        return await self.kit.transport.send_to(dest, sender_name, **how)

    def _answering(self, call: Handler) -> Callable[[Request], Awaitable[Reply]]:
        async def answer(request: Request) -> Reply:
            try:
                document = await call(request)
            except PortNotFoundError as error:  # to the caller it is all the same
                self.refuse(error)
                raise NotConnectedError(str(error)) from error
            except VertebraError as error:
                self.refuse(error)
                raise
            self.traffic.messages += 1
            return Reply(payload=msgspec.json.encode(document), encoding=JSON)

        return answer
