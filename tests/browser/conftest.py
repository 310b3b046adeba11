"""Chromium for the tests of this lane: Debian's package, driven by Playwright."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest
from playwright.async_api import Browser, ConsoleMessage, Page, async_playwright

from .lab import Lab, running_lab

ARTIFACTS: Final = Path(__file__).parents[1] / "artifacts"
NAMES: Final = ("chromium", "chromium-browser", "google-chrome")
EXPECTED_ON_CONSOLE: Final = ("Failed to load resource", "WebSocket connection to")
"""What Chromium itself writes when the gateway is away or says no."""


@pytest.fixture(scope="session")
def chromium() -> str:
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip("there is no Chromium; apt-get install chromium")
    return found


@pytest.fixture
async def browser(chromium: str) -> AsyncIterator[Browser]:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(
            executable_path=chromium,
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        yield browser
        await browser.close()


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[Lab]:
    async with running_lab(tmp_path) as lab:
        yield lab


@pytest.fixture
async def page(lab: Lab, browser: Browser) -> AsyncIterator[Page]:
    """The dashboard on a desk; whatever goes wrong in its scripts fails the test."""
    page = await browser.new_page(viewport={"width": 1280, "height": 800})
    faults = watch(page)
    await page.goto(f"{lab.gateway.url}?token={lab.gateway.token}")
    yield page
    await page.close()
    assert faults == []


def watch(page: Page) -> list[str]:
    """Return the list in which faults of this page will appear, breaches of its CSP included."""
    faults: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if message.type == "error" and not message.text.startswith(EXPECTED_ON_CONSOLE):
            faults.append(message.text)

    page.on("console", listen)
    page.on("pageerror", lambda error: faults.append(str(error)))
    return faults


async def screenshot(page: Page, name: str, *, full_page: bool = True) -> None:
    """Keep a picture of the page for people to look at."""
    path = ARTIFACTS / f"dashboard-{name}.png"
    await page.screenshot(path=path, full_page=full_page)
