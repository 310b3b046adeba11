"""All controls of the simulated robot in a real browser, down to the wires of YARP and ROS."""

from __future__ import annotations

import asyncio
import io
import os
import re
import sys
import wave
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest
from playwright.async_api import Browser, Locator, Page, expect

from vertebra.bus import ZenohBus
from vertebra.service import run_service
from vertebra.testing.ports import free_tcp_port
from vertebra_ros2.adapter import serve as adapt_ros
from vertebra_ros2.settings import Ros2Settings
from vertebra_yarp.adapter import serve as adapt
from vertebra_yarp.settings import YarpSettings

from .conftest import screenshot, watch
from .lab import Lab, running_lab

pytestmark = pytest.mark.browser

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
DOMAIN_ID: Final = 72


@pytest.fixture
async def full_lab(tmp_path: Path) -> AsyncIterator[Lab]:
    """The shipped profile and routes, the adapters, and the simulated robot on real wires."""
    async with running_lab(tmp_path, DEPLOY / "robots") as lab:
        names = f"127.0.0.1:{free_tcp_port()}"
        buses = [await ZenohBus.open(lab.router, timeout_s=5) for _ in range(2)]
        services = [
            asyncio.create_task(
                run_service(
                    "yarp",
                    YarpSettings(name_server_bind=names, routes=DEPLOY / "yarp" / "routes.yaml"),
                    adapt,
                    bus=buses[0],
                )
            ),
            asyncio.create_task(
                run_service(
                    "ros2",
                    Ros2Settings(domain_id=DOMAIN_ID, routes=DEPLOY / "ros2" / "routes.yaml"),
                    adapt_ros,
                    bus=buses[1],
                )
            ),
        ]
        simulator = await simulate(lab, tmp_path, names)
        yield lab
        simulator.terminate()
        await simulator.wait()
        for service in services:
            service.cancel()
        await asyncio.wait(services, timeout=10)
        for bus in buses:
            await bus.close()


async def simulate(lab: Lab, heartbeats: Path, names: str) -> Process:
    """Start the simulated robot: in a process of its own, as ROS nodes are."""
    environment = {
        **{name: value for name, value in os.environ.items() if "VERTEBRA" not in name},
        "VERTEBRA_ROUTER": lab.router,
        "VERTEBRA_HEARTBEAT_DIR": str(heartbeats),
        "VERTEBRA_SIMULATOR_NAME_SERVER": names,
        "VERTEBRA_SIMULATOR_ROS2": "true",
        "VERTEBRA_SIMULATOR_ROS2_DOMAIN_ID": str(DOMAIN_ID),
    }
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "vertebra_simulator", env=environment
    )


@pytest.fixture
async def full_page(full_lab: Lab, browser: Browser) -> AsyncIterator[Page]:
    page = await browser.new_page(viewport={"width": 1280, "height": 1000})
    faults = watch(page)
    await page.goto(f"{full_lab.gateway.url}?token={full_lab.gateway.token}")
    await expect(page.locator(".robot .chip-text")).to_have_text("online", timeout=20_000)
    yield page
    await page.close()
    assert faults == []


async def form(page: Page, path: str) -> Locator:
    card = page.locator(f'.form[data-path="{path}"]')
    await card.locator("summary").click()
    return card


async def send(card: Locator) -> Locator:
    await card.get_by_role("button", name="Send").click()
    return card.locator("output")


async def test_every_call_has_its_control_and_it_works(full_page: Page) -> None:
    page = full_page
    paths = await page.locator(".form").evaluate_all("all => all.map((one) => one.dataset.path)")
    assert set(paths) == {
        "head/move_by",
        "head/velocity",
        "head/direct",
        "gaze/look",
        "gaze/look_at",
        "gaze/look_at_pixel",
        "face/express",
        "speaker/play",
        "base/navigate/goal",
    }
    await expect(page.locator(".joints input[data-joint]")).to_have_count(6)

    card = await form(page, "gaze/look")
    await card.get_by_label("azimuth deg").fill("-20")
    await expect(await send(card)).to_contain_text('"reached": true', timeout=15_000)
    await expect(card.locator("output")).to_contain_text(re.compile(r'"azimuth": -(20|19.9)'))

    card = await form(page, "head/velocity")
    roll = card.get_by_label("neck_roll")
    assert (await roll.get_attribute("min"), await roll.get_attribute("max")) == ("-100", "100")
    await roll.fill("10")
    await expect(await send(card)).to_contain_text('"stops_in_s": 0.5')

    card = await form(page, "head/direct")
    await card.get_by_label("neck_yaw").fill("-30")
    output = await send(card)
    await expect(output).to_contain_text("more than 10 deg at once")
    await expect(output).to_have_attribute("data-state", "failed")

    card = await form(page, "face/express")
    await card.get_by_label("expression").select_option("happy")
    await expect(await send(card)).to_contain_text('"answer": "[ok]"')

    card = await form(page, "speaker/play")
    sound = {"name": "beep.wav", "mimeType": "audio/wav", "buffer": beep()}
    await card.get_by_label("sound").set_input_files(sound)  # type: ignore[arg-type]
    await expect(await send(card)).to_contain_text('"taken": true')

    await expect(page.locator(".camera[data-state=live]")).to_have_count(2)
    await screenshot(page, "controls")


def beep() -> bytes:
    file = io.BytesIO()
    with wave.open(file, "wb") as writer:
        writer.setnchannels(1)
        writer.setsampwidth(2)
        writer.setframerate(8000)
        writer.writeframes(b"\x00\x10\x00\xf0" * 2000)
    return file.getvalue()


async def test_the_base_is_driven_from_the_page(full_page: Page) -> None:
    panel = full_page.locator(".base[data-state=live]")
    await expect(panel.locator(".pad")).to_have_attribute("aria-disabled", "false")
    await expect(panel.locator(".speed output")).to_have_text("0.40 m/s, 45°/s")
    ahead = panel.locator("[data-value=ahead]")
    await panel.locator(".pad").focus()
    await full_page.keyboard.down("ArrowUp")
    await expect(ahead).to_have_text("0.40 m/s")
    await full_page.keyboard.up("ArrowUp")
    await expect(ahead).to_have_text("0.00 m/s")
    assert float(await panel.locator("canvas").get_attribute("data-x") or 0) > 0.1
    assert int(await panel.locator("canvas").get_attribute("data-hits") or 0) > 100


async def test_the_base_goes_where_the_map_is_clicked(full_page: Page) -> None:
    panel = full_page.locator(".base[data-state=live]")
    await expect(panel.locator("canvas")).to_have_attribute("data-aim", "")
    await asyncio.sleep(1.0)  # for the view to settle
    state = panel.locator(".action-state")
    await panel.locator("canvas").click(position={"x": 280, "y": 200})
    await expect(state).to_contain_text("m to go")
    await screenshot(full_page, "navigating")
    await panel.get_by_role("button", name="Cancel").click()
    await expect(state).to_have_text("Cancelled")
    await expect(panel.locator("[data-value=ahead]")).to_have_text("0.00 m/s")
    await panel.locator("canvas").click(position={"x": 280, "y": 200})
    await expect(state).to_have_text("Succeeded", timeout=30_000)
