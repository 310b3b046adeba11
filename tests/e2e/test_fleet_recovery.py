"""Whatever is killed or cut off comes back by itself, and whoever watches sees it go on."""

from __future__ import annotations

import asyncio
import itertools
import random
import time
from typing import Final

import httpx
import pytest

from .fleet import Fleet
from .watcher import CAMERA, FACES, Watcher, watching

SERVICES: Final = ("face_tracking", "gateway", "router", "simulator", "yarp")
RECOVERED_WITHIN_S: Final = 5.0
FIRST_WITHIN_S: Final = 15.0
CUT_OFF_S: Final = 4.0
RECONNECTED_WITHIN_S: Final = 15.0
"""Zenoh takes a peer that is silent for gone after ten seconds."""


async def see_both(watcher: Watcher, than_ns: int, *, timeout_s: float) -> None:
    """Wait for an image and for faces of a later time."""
    await asyncio.gather(
        watcher.newer(CAMERA, than_ns, timeout_s=timeout_s),
        watcher.newer(FACES, than_ns, timeout_s=timeout_s),
    )


async def command_until_obeyed(fleet: Fleet, *, until_s: float) -> None:
    """Send the robot a command again and again until it says that it obeyed."""

    def command() -> None:
        answer = "none"
        while time.monotonic() < until_s:
            try:
                with fleet.web() as web:
                    response = web.post("robots/vizzy/head/stop")
            except httpx.TransportError as error:
                answer = repr(error)
            else:
                if response.status_code == httpx.codes.OK:
                    return
                answer = response.text
            time.sleep(0.1)
        raise AssertionError(f"the robot does not obey; last answer: {answer}")

    await asyncio.to_thread(command)


async def check_recovery(fleet: Fleet, watcher: Watcher, back_ns: int) -> None:
    left_s = RECOVERED_WITHIN_S - (time.time_ns() - back_ns) / 1e9
    await asyncio.gather(
        see_both(watcher, back_ns, timeout_s=left_s),
        command_until_obeyed(fleet, until_s=time.monotonic() + left_s),
    )


@pytest.mark.parametrize("service", SERVICES)
async def test_a_service_that_crashes_is_missed_for_seconds_only(
    fleet: Fleet, service: str
) -> None:
    others = {each: fleet.started_ns(each) for each in SERVICES if each != service}
    async with watching(fleet) as watcher:
        await see_both(watcher, time.time_ns(), timeout_s=FIRST_WITHIN_S)

        await asyncio.to_thread(fleet.crash, service)

        await check_recovery(fleet, watcher, fleet.started_ns(service))
    fleet.wait_healthy(service)
    assert {each: fleet.started_ns(each) for each in others} == others, "nothing else restarted"


@pytest.mark.parametrize("killed", [*itertools.combinations(SERVICES, 2), SERVICES], ids="-".join)
async def test_services_come_back_in_any_order(fleet: Fleet, killed: tuple[str, ...]) -> None:
    async with watching(fleet) as watcher:
        await see_both(watcher, time.time_ns(), timeout_s=FIRST_WITHIN_S)
        for service in random.sample(killed, len(killed)):
            await asyncio.to_thread(fleet.kill, service)

        for service in random.sample(killed, len(killed)):
            await asyncio.to_thread(fleet.start, service)

        await check_recovery(fleet, watcher, max(map(fleet.started_ns, killed)))


@pytest.mark.parametrize("service", SERVICES)
async def test_a_service_that_is_cut_off_finds_back(fleet: Fleet, service: str) -> None:
    async with watching(fleet) as watcher:
        await see_both(watcher, time.time_ns(), timeout_s=FIRST_WITHIN_S)
        await asyncio.to_thread(fleet.disconnect, service)
        cut_off_ns = time.time_ns()
        try:
            await asyncio.sleep(CUT_OFF_S)
            missed = await watcher.collect(0.5)
        finally:
            await asyncio.to_thread(fleet.connect, service)
        back_ns = time.time_ns()

        await see_both(watcher, back_ns, timeout_s=RECONNECTED_WITHIN_S)
        await command_until_obeyed(fleet, until_s=time.monotonic() + RECONNECTED_WITHIN_S)

    assert not missed[FACES], f"it was not cut off: faces since {cut_off_ns}"
