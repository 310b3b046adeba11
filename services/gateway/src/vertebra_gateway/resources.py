"""The robots as they are now: profile, presence, limits, and the way to call them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

import msgspec

from vertebra.bus import Bus, PresenceEvent, Subscription
from vertebra.codec import ENCODING, CodecRegistry, to_json_value
from vertebra.errors import CodecError, DecodeError, NotConnectedError, TransportError
from vertebra.messages import Header
from vertebra_gateway.commands import InputCheck, Limits, read_limits
from vertebra_gateway.problems import ProblemError
from vertebra_gateway.profile import Profile, Resource
from vertebra_gateway.sounds import read_wav

log = logging.getLogger(__name__)

_ASK_EVERY_S: Final = 3.0
_ASK_AGAIN_S: Final = 0.5
_JSON: Final = "application/json"


class Robot:
    """One robot of the fleet.

    Attributes:
        profile: What it offers.
        reason: Why it is not online; empty if it is.
        away: Why parts of it are away, by their key.
        limits: The limits of its calls, by path, as the robot told them last.
    """

    def __init__(self, profile: Profile) -> None:
        self.profile = profile
        self.reason = "not asked yet"
        self.away: dict[str, str] = {}
        self.limits: dict[str, Limits] = {}
        self.checks = {
            resource.path: InputCheck(resource)
            for resource in profile.resources
            if resource.kind == "call"
        }

    @property
    def online(self) -> bool:
        """Whether it can be reached now."""
        return not self.reason

    def lacks(self, resource: Resource) -> str:
        """Return why the part that a resource belongs to is away, empty if it is not."""
        keys = (key for key in self.away if f"{resource.key}/".startswith(f"{key}/"))
        return next((self.away[key] for key in keys), "")

    def reason_of(self, resource: Resource) -> str:
        """Return why a resource cannot be reached now, empty if it can."""
        return self.reason or self.lacks(resource)

    def require(self, resource: Resource) -> None:
        """Raise `NotConnectedError` with the reason if a resource cannot be reached now."""
        reason = self.reason_of(resource)
        if reason:
            what = "" if self.reason else f"{resource.path!r} of "
            raise NotConnectedError(f"{what}robot {self.profile.robot!r} is away: {reason}")

    def resource(self, path: str) -> Resource:
        """Return the resource at `path`; raise `ProblemError` 404."""
        found = self.profile.resource(path)
        if found is None:
            known = [resource.path for resource in self.profile.resources]
            raise ProblemError(
                404,
                f"robot {self.profile.robot!r} has no resource {path!r}; known: {', '.join(known)}",
                known=known,
            )
        return found

    def describe(self) -> dict[str, Any]:
        """Return what the web is told about it."""
        return {
            "name": self.profile.robot,
            "description": self.profile.description,
            "online": self.online,
            "reason": self.reason,
            "away": {
                part.path: self.away[part.key]
                for part in self.profile.parts
                if part.key in self.away
            },
            "resources": [
                {
                    "path": resource.path,
                    "kind": resource.kind,
                    "method": resource.http_method,
                    "url": f"/api/robots/{self.profile.robot}/{resource.path}",
                    "key": resource.key,
                    "description": resource.description,
                    "content_type": resource.content_type,
                    "input": resource.input,
                    "output": resource.output,
                    "limits": msgspec.to_builtins(self.limits.get(resource.path)),
                    "takes": resource.takes,
                    "reason": self.reason_of(resource),
                    "control": resource.control,
                }
                for resource in self.profile.resources
            ],
        }


class Robots:
    """All robots.

    Attributes:
        changed: Called when a robot comes, goes or changes; viewers add and remove theirs.
    """

    def __init__(self, bus: Bus, codecs: CodecRegistry, profiles: Iterable[Profile]) -> None:
        self.changed: set[Callable[[], None]] = set()
        self._bus = bus
        self._codecs = codecs
        self._robots = {profile.robot: Robot(profile) for profile in profiles}

    def __iter__(self) -> Iterator[Robot]:
        return iter(self._robots.values())

    def describe(self) -> list[dict[str, Any]]:
        """Return what the web is told about all of them."""
        return [robot.describe() for robot in self._robots.values()]

    def robot(self, name: str) -> Robot:
        """Return the robot of that name; raise `ProblemError` 404."""
        robot = self._robots.get(name)
        if robot is None:
            known = sorted(self._robots)
            raise ProblemError(
                404, f"there is no robot {name!r}; known: {', '.join(known) or 'none'}", known=known
            )
        return robot

    async def call(
        self, robot_name: str, path: str, body: Any, timeout_s: float | None = None
    ) -> Any:
        """Have a robot do what the resource at `path` stands for; return its answer as JSON.

        Raises:
            ProblemError: There is no such robot, resource or call.
            InputRefusedError: `body` is outside its schema or limits; the robot was not asked.
            TransportError: The robot is away, busy, late, or answered with an error.
        """
        robot = self.robot(robot_name)
        resource = robot.resource(path)
        if resource.kind != "call":
            raise ProblemError(405, f"{path!r} is a resource to read, not to call", allowed=["GET"])
        if resource.takes != _JSON:
            raise ProblemError(415, f"{path!r} takes {resource.takes}, by POST to its path")
        robot.require(resource)
        robot.checks[path].check(body, robot.limits.get(path, {}))
        deadline_s = min(timeout_s or resource.timeout_s, resource.timeout_s)
        return await self._ask_robot(resource, msgspec.json.encode(body), _JSON, deadline_s)

    async def play(self, robot_name: str, path: str, wav: bytes) -> Any:
        """Have a robot play a sound; return its answer as JSON.

        Raises:
            InputRefusedError: `wav` is no sound of 16-bit samples.
            ProblemError, TransportError: As for `call`.
        """
        robot = self.robot(robot_name)
        resource = robot.resource(path)
        robot.require(resource)
        payload, encoding = self._codecs.encode(read_wav(wav), Header(), ENCODING)
        return await self._ask_robot(resource, bytes(payload), encoding, resource.timeout_s)

    async def _ask_robot(
        self, resource: Resource, payload: bytes, encoding: str, timeout_s: float
    ) -> Any:
        reply = await self._bus.call(resource.key, payload, encoding=encoding, timeout_s=timeout_s)
        return self._read(reply.payload, reply.encoding or _JSON)

    def _read(self, payload: bytes, encoding: str) -> Any:
        if encoding.partition(";")[0] != _JSON:
            return to_json_value(self._codecs.decode(payload, encoding)[0])
        try:
            return msgspec.json.decode(payload)
        except msgspec.DecodeError as error:
            raise DecodeError(f"the robot's answer is no JSON: {error}") from error

    async def follow(self) -> None:
        """Keep all robots up to date, for ever."""
        async with asyncio.TaskGroup() as tasks:
            for robot in self._robots.values():
                tasks.create_task(self._follow(robot))

    async def _follow(self, robot: Robot) -> None:
        present: set[str] = set()
        news = asyncio.Event()
        expression = robot.profile.presence
        async with asyncio.TaskGroup() as tasks:
            if expression:
                watcher = self._bus.presence(expression)
                tasks.create_task(_watch(watcher, present, news))
            failures = 0
            while True:
                news.clear()
                away = _away(robot.profile, present)
                if expression and not present:
                    reason, limits = f"nobody is present at {expression}", robot.limits
                    self._update(robot, reason, away, limits)
                else:
                    self._update(robot, robot.reason, away, robot.limits)
                    reason, limits = await self._ask(robot)
                    failures = failures + 1 if reason else 0
                    if failures != 1 or not robot.online:  # one answer may be late
                        self._update(robot, reason, away, limits)
                well = robot.online and not failures
                try:
                    async with asyncio.timeout(_ASK_EVERY_S if well else _ASK_AGAIN_S):
                        await news.wait()
                except TimeoutError:
                    continue

    async def _ask(self, robot: Robot) -> tuple[str, dict[str, Limits]]:
        """Fetch the limits of all calls; a robot of which no part tells its limits is not online.

        A part that does not answer has no limits here: it checks commands itself, or is away. One
        that is away keeps those that it told last.
        """
        if not self._bus.info().connected:
            return "the gateway does not reach the router", robot.limits
        limited = [
            (resource, resource.limits)
            for resource in robot.profile.resources
            if resource.limits is not None
        ]
        sources = {limits.source for _, limits in limited}
        asked = sorted(source for source in sources if not robot.lacks(robot.resource(source)))
        told = await asyncio.gather(*(self._ask_limits(robot.resource(path)) for path in asked))
        answers = dict(zip(asked, told, strict=True))
        limits: dict[str, Limits] = {}
        for resource, source in limited:
            answer = answers.get(source.source)
            if isinstance(answer, bytes):
                try:
                    limits[resource.path] = read_limits(answer, source)
                except CodecError as error:
                    return str(error), robot.limits
            elif answer is None and resource.path in robot.limits:
                limits[resource.path] = robot.limits[resource.path]
        reasons = [answer for answer in told if isinstance(answer, str)]
        if reasons and len(reasons) == len(told):
            return reasons[0], robot.limits
        return "", limits

    async def _ask_limits(self, asked: Resource) -> bytes | str:
        """Return the limits that a call tells, or why it does not."""
        try:
            reply = await self._bus.call(
                asked.key, b"{}", encoding=_JSON, timeout_s=asked.timeout_s
            )
        except TransportError as error:
            return str(error)
        return reply.payload

    def _update(
        self, robot: Robot, reason: str, away: dict[str, str], limits: dict[str, Limits]
    ) -> None:
        if (reason, away, limits) == (robot.reason, robot.away, robot.limits):
            return
        if robot.reason and not reason:
            log.info("robot %s is online", robot.profile.robot)
        elif reason and robot.online:
            log.warning("robot %s is away: %s", robot.profile.robot, reason)
        if not reason and away != robot.away:
            parts = ", ".join(away) or "none"
            log.info("parts of robot %s that are away: %s", robot.profile.robot, parts)
        robot.reason, robot.away, robot.limits = reason, away, limits
        for tell in tuple(self.changed):
            tell()


def _away(profile: Profile, present: set[str]) -> dict[str, str]:
    """Return why watched parts are away, by their key."""
    return {
        part.key: f"nobody is present at {part.presence}"
        for part in profile.watched_parts()
        if part.presence not in present
    }


async def _watch(
    watcher: Subscription[PresenceEvent], present: set[str], news: asyncio.Event
) -> None:
    async with watcher:
        async for event in watcher:
            if event.present:
                present.add(event.key)
            else:
                present.discard(event.key)
            news.set()
