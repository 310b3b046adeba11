"""Parts of a robot that are asked by calls: gaze, face, speaker."""

from __future__ import annotations

import asyncio
import time
from array import array
from typing import Any, Final

import msgspec

from vertebra.bus import Delivery, Request
from vertebra.errors import (
    CommandRefusedError,
    NotConnectedError,
    RemoteError,
    TransportError,
)
from vertebra.messages import AudioChunk
from vertebra.service import MessageReader
from vertebra.yarp import Value, from_text, to_text
from vertebra.yarp.objects import Sound, Vector
from vertebra_yarp import gaze
from vertebra_yarp.board import Command, read
from vertebra_yarp.calls import RpcLink
from vertebra_yarp.carried import Kit
from vertebra_yarp.device import ANSWER_S, Device
from vertebra_yarp.driver import Sink
from vertebra_yarp.links import Redialled
from vertebra_yarp.routes import FaceRoute, GazeRoute, SpeakerRoute
from vertebra_yarp.words import REFUSED

ARRIVED_POLL_S: Final = 0.05
STARTED_S: Final = 0.1
"""How long a gaze controller may need to notice that it has a new target."""
MAX_SOUND_S: Final = 30.0
_PIECE_S: Final = 0.5
_WAITING: Final = 64  # pieces of a stream


class Gaze(Device):
    """A gaze controller: points, angles and pixels to look at."""

    kind = "gaze"

    def __init__(self, kit: Kit, route: GazeRoute) -> None:
        self._words = gaze.WORDS[route.controller]()
        self._rpc = RpcLink(kit.transport, f"{route.yarp}/rpc")
        self._inputs: dict[str, Redialled[Sink]] = {}
        self._targets = 0
        super().__init__(
            kit,
            route.yarp,
            route.key,
            {
                "look_at": lambda request: self._look(read(request.payload, gaze.LookAt)),
                "look": lambda request: self._look(read(request.payload, gaze.Look)),
                "look_at_pixel": lambda request: self._look(
                    read(request.payload, gaze.LookAtPixel)
                ),
                "stop": self._stop,
            },
        )

    async def _look(self, target: gaze.Target) -> dict[str, Any]:
        began_s = time.monotonic()
        leaf, values = self._words.target(gaze.check(target))
        await self._done()  # a controller that is not there says so now
        (await self._input(leaf).get()).write(values)
        self._targets += 1
        number = self._targets
        await asyncio.sleep(STARTED_S)
        reached = False
        # A later target takes this one's place; where it looks then is where it looks.
        while target.wait and not reached and number == self._targets:
            await asyncio.sleep(ARRIVED_POLL_S)
            reached = await self._done()
        return {
            "reached": reached,
            **await self._where(),
            "duration_s": round(time.monotonic() - began_s, 3),
        }

    async def _stop(self, _: Request) -> dict[str, Any]:
        self._targets += 1
        reply = await self._rpc.call(self._words.stop, timeout_s=ANSWER_S)
        gaze.acknowledged(reply, self._words.stop)
        return await self._where()

    async def _done(self) -> bool:
        reply = await self._rpc.call(self._words.done, timeout_s=ANSWER_S)
        return gaze.is_done(reply, self._words.done)

    async def _where(self) -> dict[str, Any]:
        where: dict[str, Any] = {}
        if self._words.angles:
            names = ("azimuth", "elevation", "vergence")
            where["angles_deg"] = dict(
                zip(names, await self._read(self._words.angles), strict=True)
            )
        if self._words.point:
            where["point_m"] = await self._read(self._words.point)
        return where

    async def _read(self, leaf: str) -> list[float]:
        values = await self.glance(
            f"{self.name}/{leaf}", lambda got: Vector.decode(got.payload, got.dialect)
        )
        if len(values.values) != 3:
            raise RemoteError(REFUSED, f"{self.name}/{leaf} told {len(values.values)} numbers")
        return [round(value, 4) for value in values.values]

    def _input(self, leaf: str) -> Redialled[Sink]:
        if leaf not in self._inputs:
            dest = f"{self.name}/{leaf}"
            self._inputs[leaf] = Redialled(lambda: self.dial_input(dest))
        return self._inputs[leaf]

    async def close(self) -> None:
        """End it."""
        await super().close()
        for sink in self._inputs.values():
            await sink.close()
        await self._rpc.close()


class Express(Command, frozen=True, kw_only=True):
    """An expression to show, as the call `<face>/express` takes it."""

    expression: str
    part: str = "all"


class Face(Device):
    """A face that shows expressions."""

    kind = "face"

    def __init__(self, kit: Kit, route: FaceRoute) -> None:
        self._route = route
        self._rpc = RpcLink(kit.transport, route.yarp)
        super().__init__(kit, route.yarp, route.key, {"express": self._express})

    async def _express(self, request: Request) -> dict[str, Any]:
        wanted = read(request.payload, Express)
        values = say(self._route, wanted)
        reply = await self._rpc.call(values, timeout_s=ANSWER_S)
        if reply and str(reply[0]) in ("fail", "nack", "nak"):
            raise RemoteError(REFUSED, f"the face answered {to_text(reply)} to {to_text(values)}")
        return {**msgspec.to_builtins(wanted), "answer": to_text(reply)}

    async def close(self) -> None:
        """End it."""
        await super().close()
        await self._rpc.close()


def say(route: FaceRoute, wanted: Express) -> list[Value]:
    """Return what to say to a face; raise `CommandRefusedError` for what it cannot show."""
    for what, given, known in (
        ("expression", wanted.expression, route.expressions),
        ("part", wanted.part, route.parts),
    ):
        if given not in known:
            raise CommandRefusedError(f"there is no {what} {given!r}; known: {', '.join(known)}")
    words = {"part": route.parts[wanted.part], "expression": route.expressions[wanted.expression]}
    return from_text(route.say.format(**words))


class Speaker(Device):
    """A speaker that plays sounds."""

    kind = "speaker"

    def __init__(self, kit: Kit, route: SpeakerRoute) -> None:
        # With tcp each piece is acknowledged: what was taken is known, and no piece is lost.
        self._sink = Redialled(lambda: self.dial_input(route.yarp, carrier="tcp", depth=1))
        self._turn = asyncio.Lock()
        super().__init__(kit, route.yarp, route.key, {"play": self._play})

    async def work(self) -> None:
        """Play what streams to `<key>/audio`; what cannot be played is reported and counted."""
        context = self.kit.context
        subscription = context.bus.subscribe(f"{self.key}/audio", Delivery.queue(_WAITING))
        async for received in MessageReader(subscription, context.codecs, AudioChunk):
            try:
                await self._say(received.message)
            except (CommandRefusedError, TransportError) as error:
                self.refuse(error)
                context.report(f"{self.name} audio", "warning", str(error))
            else:
                self.traffic.messages += 1
                context.report(f"{self.name} audio", "ok")

    async def _play(self, request: Request) -> dict[str, Any]:
        chunk, _ = self.kit.context.codecs.decode(request.payload, request.encoding)
        if not isinstance(chunk, AudioChunk):
            raise CommandRefusedError(f"a speaker plays an AudioChunk, not {type(chunk).__name__}")
        await self._say(chunk)
        duration_s = chunk.samples.shape[0] / chunk.rate_hz
        return {"taken": True, "duration_s": round(duration_s, 3), "rate_hz": chunk.rate_hz}

    async def _say(self, chunk: AudioChunk) -> None:
        pieces = sounds(chunk)
        async with self._turn:
            sink = await self._sink.get()
            for piece in pieces:
                sink.write(piece)
                if not await sink.wait_taken():
                    raise NotConnectedError(f"{self.name} went away while it was being played to")

    async def close(self) -> None:
        """End it."""
        await super().close()
        await self._sink.close()


def sounds(chunk: AudioChunk) -> list[Sound]:
    """Return a sound in pieces that players can take; raise `CommandRefusedError`."""
    instants, channels = chunk.samples.shape
    if chunk.samples.dtype != "<i2" or not instants or not channels or chunk.rate_hz <= 0:
        raise CommandRefusedError("a speaker plays 16-bit samples, at least one")
    if instants > MAX_SOUND_S * chunk.rate_hz:
        raise CommandRefusedError(
            f"{instants / chunk.rate_hz:g} s of sound is longer than {MAX_SOUND_S:g} s; "
            "play it in parts"
        )
    samples = array("h", bytes(chunk.samples.data))
    piece = max(1, round(_PIECE_S * chunk.rate_hz)) * channels
    return [
        Sound(chunk.rate_hz, channels, _planar(samples[start : start + piece], channels))
        for start in range(0, len(samples), piece)
    ]


def _planar(interleaved: array[int], channels: int) -> array[int]:
    planar = array("h")
    for channel in range(channels):
        planar.extend(interleaved[channel::channels])
    return planar
