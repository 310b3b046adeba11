"""The panel of a mobile base in a real Chromium: the pad, the keys, the map and its goals."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Final

import pytest
from playwright.async_api import Browser, Locator, Page, expect

from vertebra.errors import CommandRefusedError
from vertebra.testing.bus_suite import eventually
from vertebra_gateway.testing import FakeBase

from .conftest import screenshot, watch
from .lab import Lab, running_lab

pytestmark = pytest.mark.browser

PROFILES: Final = Path(__file__).parent / "wheels"
STILL: Final = {"linear_m_s": 0, "angular_deg_s": 0}
PERIOD_S: Final = 0.2


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[Lab]:
    async with running_lab(tmp_path, PROFILES) as lab:
        yield lab


@pytest.fixture
async def base(lab: Lab) -> AsyncIterator[FakeBase]:
    async with lab.base() as base:
        yield base


@pytest.fixture
async def panel(base: FakeBase, page: Page) -> Locator:
    """The panel of a base that can be driven."""
    assert base.drives == []
    panel = page.locator(".base[data-state=live]")
    await expect(panel.locator(".pad")).to_have_attribute("aria-disabled", "false")
    return panel


async def middle(element: Locator) -> tuple[float, float]:
    await element.scroll_into_view_if_needed()
    box = await element.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


async def hold(page: Page, panel: Locator, right: float, down: float) -> None:
    """Take the knob and hold it so many pixels from the middle."""
    x, y = await middle(panel.locator(".pad"))
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x + right, y + down, steps=3)


def stands(base: FakeBase) -> Callable[[], bool]:
    return lambda: base.drives[-1:] == [STILL]


def pushes(base: FakeBase, field: str, sign: int) -> Callable[[], bool]:
    return lambda: any(drive[field] * sign > 0 for drive in base.drives[-1:])


async def test_holding_the_pad_drives_at_5_hz_and_letting_go_stops(
    base: FakeBase, page: Page, panel: Locator
) -> None:
    await hold(page, panel, 0, -200)
    await eventually(lambda: len(base.drives) >= 2)
    assert base.drives[-1] == {"linear_m_s": 0.25, "angular_deg_s": 0, "for_s": 0.5}
    before = len(base.drives)
    await asyncio.sleep(2.0)
    assert 7 <= len(base.drives) - before <= 11
    assert base.x_m > 0.3
    await page.mouse.up()
    await eventually(stands(base))
    after = len(base.drives)
    await asyncio.sleep(3 * PERIOD_S)
    assert len(base.drives) == after
    await expect(panel.locator(".pad")).not_to_have_attribute("data-held", "")


async def test_the_knob_says_where_and_the_slider_how_fast(
    base: FakeBase, page: Page, panel: Locator
) -> None:
    await panel.locator(".speed input").fill("100")
    await expect(panel.locator(".speed output")).to_have_text("0.50 m/s, 90°/s")
    await hold(page, panel, -200, 0)
    await eventually(lambda: base.drives[-1:] != [] and base.drives[-1]["angular_deg_s"] == 90)
    assert base.drives[-1]["linear_m_s"] == 0
    x, y = await middle(panel.locator(".pad"))
    await page.mouse.move(x + 20, y + 200, steps=3)  # back, and a little to the right
    await eventually(lambda: base.drives[-1]["linear_m_s"] < -0.2)
    assert base.drives[-1]["linear_m_s"] >= -0.25
    assert -20 < base.drives[-1]["angular_deg_s"] <= 0
    await page.mouse.up()
    await eventually(stands(base))


async def test_keys_drive_only_while_the_panel_has_the_focus(
    base: FakeBase, page: Page, panel: Locator
) -> None:
    await page.locator("h2").first.click()
    await page.keyboard.down("w")
    await asyncio.sleep(2 * PERIOD_S)
    await page.keyboard.up("w")
    await panel.locator(".speed input").focus()
    await page.keyboard.press("ArrowRight")
    assert base.drives == []
    await expect(panel.locator(".speed input")).to_have_value("55")

    await panel.locator(".pad").focus()
    for key, field, sign in (
        ("ArrowUp", "linear_m_s", 1),
        ("s", "linear_m_s", -1),
        ("a", "angular_deg_s", 1),
        ("ArrowRight", "angular_deg_s", -1),
    ):
        await page.keyboard.down(key)
        await eventually(pushes(base, field, sign))
        await page.keyboard.up(key)
        await eventually(stands(base))
    await page.keyboard.down("w")
    await page.keyboard.down("d")
    await eventually(lambda: base.drives[-1]["linear_m_s"] > 0 > base.drives[-1]["angular_deg_s"])
    await page.keyboard.up("d")
    await eventually(lambda: base.drives[-1]["angular_deg_s"] == 0 < base.drives[-1]["linear_m_s"])
    await page.keyboard.up("w")
    await eventually(stands(base))


@pytest.mark.parametrize(
    "leave",
    [
        "window.dispatchEvent(new Event('blur'))",
        "document.querySelector('.joints input').focus()",
        """Object.defineProperty(document, 'hidden', { value: true });
           document.dispatchEvent(new Event('visibilitychange'))""",
    ],
)
async def test_who_looks_away_lets_go(
    lab: Lab, base: FakeBase, page: Page, panel: Locator, leave: str
) -> None:
    async with lab.robot():
        await expect(page.locator(".joints input").first).to_be_enabled()
        await panel.locator(".pad").focus()
        await page.keyboard.down("ArrowUp")
        await eventually(lambda: len(base.drives) > 1)
        await page.evaluate(leave)
        await eventually(stands(base))
        after = len(base.drives)
        await asyncio.sleep(3 * PERIOD_S)
        assert len(base.drives) == after


async def test_letting_go_overtakes_no_drive_that_is_under_way(
    base: FakeBase, page: Page, panel: Locator
) -> None:
    base.delay_s = 0.6
    await hold(page, panel, 0, -200)
    await eventually(lambda: len(base.drives) == 1)
    await page.mouse.up()
    await eventually(lambda: base.drives[1:] == [STILL, STILL])


async def test_the_stop_beats_the_pad(base: FakeBase, page: Page, panel: Locator) -> None:
    base.delay_s = 0.3
    await hold(page, panel, 0, -200)
    await eventually(lambda: len(base.drives) > 1)
    await page.keyboard.press("Escape")
    await eventually(lambda: base.stops == 2)  # and after the drive that was under way
    driven = len(base.drives)
    await asyncio.sleep(3 * PERIOD_S)
    assert (len(base.drives), base.stops) == (driven, 2)
    await expect(panel.locator(".error")).to_be_hidden()
    await page.mouse.up()


async def test_a_base_of_which_the_gateway_dies_stops_by_itself(
    lab: Lab, base: FakeBase, page: Page, panel: Locator
) -> None:
    await hold(page, panel, 0, -200)
    await eventually(lambda: len(base.drives) > 1)
    await lab.gateway.kill()
    await expect(page.locator(".pad")).to_have_attribute("aria-disabled", "true")
    await asyncio.sleep(0.6)
    x_m = base.x_m
    await asyncio.sleep(0.3)
    assert base.x_m == x_m
    await page.mouse.up()


async def test_a_refused_drive_is_shown_until_the_next(
    base: FakeBase, page: Page, panel: Locator
) -> None:
    base.failure = CommandRefusedError("the emergency stop is pressed")
    await hold(page, panel, 0, -200)
    await expect(panel.locator(".error")).to_have_text("the emergency stop is pressed")
    await page.mouse.up()
    base.failure = None
    await eventually(lambda: base.failure is None)
    await hold(page, panel, 0, -200)
    await expect(panel.locator(".error")).to_be_hidden()
    await page.mouse.up()


async def test_the_map_shows_where_the_base_is_and_what_it_sees(
    base: FakeBase, page: Page, panel: Locator
) -> None:
    base.x_m, base.y_m, base.heading_rad = 1.25, -0.5, math.radians(30)
    canvas = panel.locator("canvas")
    await expect(canvas).to_have_attribute("data-x", "1.250")
    await expect(canvas).to_have_attribute("data-y", "-0.500")
    await expect(canvas).to_have_attribute("data-hits", "180")
    await expect(panel.locator("[data-value=x]")).to_have_text("1.25 m")
    await expect(panel.locator("[data-value=y]")).to_have_text("\u22120.50 m")
    await expect(panel.locator("[data-value=heading]")).to_have_text("30°")
    colours = await canvas.evaluate(
        """(canvas) => {
          const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
          return new Set(new Uint32Array(data.buffer)).size;
        }"""
    )
    assert colours > 10, "robot, walls, grid and trail are drawn"


async def test_a_click_on_the_map_is_a_goal_that_can_be_watched_and_cancelled(
    lab: Lab, base: FakeBase, page: Page, panel: Locator
) -> None:
    async with lab.robot():
        await asyncio.sleep(1.0)  # for the view to settle
        x, y = await middle(panel.locator("canvas"))
        await page.mouse.move(x, y - 90)  # ahead is up
        await page.mouse.down()
        await page.mouse.move(x - 60, y - 90, steps=3)  # and then look to the left
        await page.mouse.up()
        await eventually(lambda: len(base.goals) == 1)
        pose = base.goals[0]["pose"]
        assert base.goals[0]["header"]["frame_id"] == "odom"
        assert pose["position"]["x"] > 1
        assert abs(pose["position"]["y"]) < pose["position"]["x"]
        heading = 2 * math.atan2(pose["orientation"]["z"], pose["orientation"]["w"])
        assert heading == pytest.approx(math.pi / 2, abs=0.05)
        state = panel.locator(".action-state")
        await expect(state).to_have_text(
            re.compile(r"^[\d.]+ m to go · \d+ s so far · about \d+ s")
        )
        before = float((await state.inner_text()).split()[0])
        await asyncio.sleep(0.5)
        assert float((await state.inner_text()).split()[0]) < before
        await screenshot(page, "base")
        await panel.get_by_role("button", name="Cancel").click()
        await expect(state).to_have_text("Cancelled")
        await expect(panel.get_by_role("button", name="Cancel")).to_be_hidden()
        x_m = base.x_m
        await asyncio.sleep(0.3)
        assert base.x_m == x_m


async def test_the_end_of_a_goal_is_told(base: FakeBase, page: Page, panel: Locator) -> None:
    await asyncio.sleep(1.0)
    x, y = await middle(panel.locator("canvas"))
    await page.mouse.click(x + 10, y - 20)
    await expect(panel.locator(".action-state")).to_have_text("Succeeded")
    assert len(base.goals) == 1


async def test_a_goal_of_somebody_else_is_watched_and_the_stop_ends_it(
    lab: Lab, base: FakeBase, page: Page, panel: Locator
) -> None:
    body = '{"pose": {"pose": {"position": {"x": 3, "y": 1}}}}'
    await page.evaluate(
        "(body) => fetch('api/robots/vizzy/base/navigate/goal', { method: 'POST', body })", body
    )
    state = panel.locator(".action-state")
    await expect(state).to_contain_text("m to go")
    await page.keyboard.press("Escape")
    await eventually(lambda: base.stops == 1)
    await expect(state).to_have_text("Cancelled")


async def test_taking_the_pad_cancels_the_goal(base: FakeBase, page: Page, panel: Locator) -> None:
    x, y = await middle(panel.locator("canvas"))
    await page.mouse.click(x, y - 90)
    await expect(panel.locator(".action-state")).to_contain_text("m to go")
    await hold(page, panel, 0, 200)
    await expect(panel.locator(".action-state")).to_have_text("Cancelled")
    await eventually(lambda: base.drives[-1:] != [] and base.drives[-1]["linear_m_s"] < 0)
    await page.mouse.up()
    await eventually(stands(base))


async def test_goals_can_be_sent_by_form_too(base: FakeBase, page: Page, panel: Locator) -> None:
    await expect(panel).to_be_visible()
    form = page.locator('.form[data-path="base/navigate/goal"]')
    await form.locator("summary").click()
    await form.get_by_label("x", exact=True).fill("0.5")
    await form.get_by_label("y", exact=True).fill("0")
    await form.get_by_role("button", name="Send").click()
    await expect(form.locator("output")).to_contain_text("goal_id")
    await expect(form.locator(".action-state")).to_have_text("Succeeded")
    assert base.goals == [
        {"header": {"frame_id": "odom"}, "pose": {"position": {"x": 0.5, "y": 0}}}
    ]


async def test_a_robot_that_lacks_a_part_says_which_and_the_others_work(
    lab: Lab, page: Page
) -> None:
    chip = page.locator(".robot .chip")
    slider = page.locator("input[data-joint=neck_yaw]")
    pad = page.locator(".pad")
    async with lab.robot() as robot:
        await expect(chip).to_have_text("online without base")
        await expect(chip).to_have_attribute("data-state", "warning")
        await expect(pad).to_have_attribute("aria-disabled", "true")
        await slider.focus()
        await page.keyboard.press("ArrowRight")
        await eventually(lambda: len(robot.moves) == 1)
        async with lab.base():
            await expect(chip).to_have_text("online")
            await expect(pad).to_have_attribute("aria-disabled", "false")
        await expect(chip).to_have_text("online without base")
        await expect(page.locator(".base .facts")).to_contain_text("The base of vizzy is away")
        await expect(slider).to_be_enabled()
        await screenshot(page, "base-away")
    async with lab.base() as base:
        await expect(chip).to_have_text("online without head", timeout=10_000)
        await expect(slider).to_be_disabled()
        await pad.focus()
        await page.keyboard.down("w")
        await eventually(lambda: len(base.drives) > 1)
        await page.keyboard.up("w")


async def test_a_finger_drives_and_sends_the_base_on_a_phone(
    lab: Lab, base: FakeBase, browser: Browser
) -> None:
    context = await browser.new_context(
        viewport={"width": 320, "height": 640},
        color_scheme="dark",
        device_scale_factor=2,
        is_mobile=True,
        has_touch=True,
    )
    page = await context.new_page()
    faults = watch(page)
    await page.goto(f"{lab.gateway.url}?token={lab.gateway.token}")
    panel = page.locator(".base[data-state=live]")
    await expect(panel.locator(".pad")).to_have_attribute("aria-disabled", "false")
    assert await page.evaluate("document.documentElement.scrollWidth") <= 320
    touch = await context.new_cdp_session(page)
    x, y = await middle(panel.locator(".pad"))
    for kind, points in (
        ("touchStart", [{"x": x, "y": y}]),
        ("touchMove", [{"x": x, "y": y - 90}]),
    ):
        await touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    await eventually(lambda: base.drives[-1:] != [] and base.drives[-1]["linear_m_s"] > 0.2)
    await screenshot(page, "base-phone-drive", full_page=False)
    await touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    await eventually(stands(base))

    x, y = await middle(panel.locator("canvas"))
    finger = {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]}
    await touch.send("Input.dispatchTouchEvent", finger)
    for step in range(1, 12):  # a swipe that scrolls the page is no goal
        finger = {"type": "touchMove", "touchPoints": [{"x": x, "y": y - 10 * step}]}
        await touch.send("Input.dispatchTouchEvent", finger)
    await touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    await asyncio.sleep(0.3)
    assert base.goals == []
    await page.touchscreen.tap(*await middle(panel.locator("canvas")))
    await eventually(lambda: len(base.goals) == 1)
    await expect(page.locator("#stop")).to_be_in_viewport()
    await page.locator("#stop").tap()
    await eventually(lambda: base.stops == 1)
    await screenshot(page, "base-phone")
    await context.close()
    assert faults == []
